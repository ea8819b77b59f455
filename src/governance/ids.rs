//! Names and digests: the newtypes everything else refers to.
//!
//! Parsed once at the edge; a value of one of these types is always well formed.

use std::fmt;
use std::str::FromStr;

use holdpoint_text::hex::{hex, unhex};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

/// The form in records and JSON: the text that `Display` writes and `FromStr` reads.
macro_rules! text_form {
    ($type:ident, $error:ident) => {
        impl TryFrom<String> for $type {
            type Error = $error;
            fn try_from(text: String) -> Result<Self, $error> {
                text.parse()
            }
        }

        impl From<$type> for String {
            fn from(value: $type) -> Self {
                value.to_string()
            }
        }
    };
}

pub(crate) use text_form;

/// The longest name of a family, identity or channel, in bytes.
pub const NAME_LEN_MAX: usize = 64;

/// A name that is not of the form `[a-z0-9][a-z0-9._-]*`, or longer than [`NAME_LEN_MAX`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the name {0:?} is not allowed: 1 to 64 characters of a-z, 0-9, '.', '_' and '-', starting with a letter or digit"
)]
pub struct NameError(pub String);

/// Whether `name` has the form every name in Holdpoint has.
#[must_use]
pub fn is_name(name: &str) -> bool {
    let head = name.bytes().next().is_some_and(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
    head && name.len() <= NAME_LEN_MAX
        && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b"._-".contains(&b))
}

/// A capability family, e.g. `grasp`: the versions of one skill.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct Family(String);

impl Family {
    /// Parses a family name.
    ///
    /// # Errors
    /// [`NameError`]: empty, longer than allowed, or with a character outside `[a-z0-9._-]`.
    pub fn new(name: impl Into<String>) -> Result<Self, NameError> {
        let name = name.into();
        if is_name(&name) { Ok(Self(name)) } else { Err(NameError(name)) }
    }

    /// The name, `[a-z0-9._-]`, at most 64 characters.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<holdpoint_body::TaskKind> for Family {
    /// The family that performs a primitive bears its name.
    fn from(task: holdpoint_body::TaskKind) -> Self {
        Self(task.name().to_owned())
    }
}

impl TryFrom<String> for Family {
    type Error = NameError;
    fn try_from(name: String) -> Result<Self, NameError> {
        Self::new(name)
    }
}

impl From<Family> for String {
    fn from(family: Family) -> Self {
        family.0
    }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// One version of one family, written `grasp@1.2.0`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct CapabilityId {
    /// The skill's family; its versions replace one another.
    pub family: Family,
    /// The declared semantic version; part of the name, proven by nothing.
    pub version: semver::Version,
}

/// Text that is not `<family>@<semver>`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a capability version; write <family>@<version>, e.g. grasp@1.2.0")]
pub struct CapabilityIdError(pub String);

impl FromStr for CapabilityId {
    type Err = CapabilityIdError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let bad = || CapabilityIdError(text.to_owned());
        let (family, version) = text.split_once('@').ok_or_else(bad)?;
        let family = Family::new(family).map_err(|_| bad())?;
        let version = semver::Version::parse(version).map_err(|_| bad())?;
        Ok(Self { family, version })
    }
}

text_form! { CapabilityId, CapabilityIdError }

impl fmt::Display for CapabilityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.family, self.version)
    }
}

/// Bytes of a digest's parts that are handed to the hash at once.
const SHORT_BYTES: usize = 256;

/// A SHA-256 digest, shown and stored as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct Digest([u8; 32]);

/// Text that is not 64 hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a digest: 64 hexadecimal digits in lower case are needed")]
pub struct DigestError(pub String);

impl Digest {
    /// The digest of all parts, each preceded by its length, so that no two lists of parts collide.
    #[must_use]
    pub fn of_parts(domain: &str, parts: &[&[u8]]) -> Self {
        let mut hasher = Sha256::new();
        // What is short goes to the hash together: each call of it costs as much as a block.
        let (mut short, mut used) = ([0; SHORT_BYTES], 0);
        for part in std::iter::once(domain.as_bytes()).chain(parts.iter().copied()) {
            for bytes in [(part.len() as u64).to_le_bytes().as_slice(), part] {
                if short.len() - used < bytes.len() {
                    hasher.update(&short[..used]);
                    used = 0;
                }
                if let Some(place) = short.get_mut(used..used + bytes.len()) {
                    place.copy_from_slice(bytes);
                    used += bytes.len();
                } else {
                    hasher.update(bytes);
                }
            }
        }
        hasher.update(&short[..used]);
        Self(hasher.finalize().into())
    }

    /// The digest of a value's canonical JSON (see [`canonical_json`]).
    ///
    /// # Errors
    /// A value without a JSON form, e.g. a map whose keys are no strings.
    pub fn of_json<T: Serialize>(domain: &str, value: &T) -> Result<Self, serde_json::Error> {
        Ok(Self::of_parts(domain, &[canonical_json(value)?.as_bytes()]))
    }

    /// The 32 bytes of the hash, as they go into other digests and signatures.
    #[must_use]
    pub const fn bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Takes 32 bytes for a digest that was computed elsewhere, e.g. read from a store; nothing is verified.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The first eight hexadecimal digits, for people.
    #[must_use]
    pub fn short(&self) -> String {
        self.to_string().chars().take(8).collect()
    }
}

/// JSON with sorted keys and no spaces: equal values give equal bytes.
///
/// # Errors
/// A value without a JSON form, e.g. a map whose keys are no strings. A number that is not finite is written `null`.
pub fn canonical_json<T: Serialize>(value: &T) -> Result<String, serde_json::Error> {
    // A dependency may turn on `preserve_order`, so the order is not left to the map type.
    let mut value = serde_json::to_value(value)?;
    value.sort_all_objects();
    serde_json::to_string(&value)
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&hex(&self.0))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Digest({self})")
    }
}

impl FromStr for Digest {
    type Err = DigestError;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        unhex(text).map(Self).ok_or_else(|| DigestError(text.to_owned()))
    }
}

text_form! { Digest, DigestError }

#[cfg(test)]
mod tests {
    use super::*;

    /// As the definition says it, part by part, wherever a part begins and ends in what is handed over together.
    #[test]
    fn digest_covers_every_part_with_its_length() {
        let bytes: Vec<u8> = (0..=u8::MAX).cycle().take(2 * SHORT_BYTES).collect();
        let lengths =
            [0, 1, 31, 32, SHORT_BYTES - 9, SHORT_BYTES - 8, SHORT_BYTES, SHORT_BYTES + 1, 2 * SHORT_BYTES];
        for first in lengths {
            for second in lengths {
                let parts = [&bytes[..first], &bytes[..second], &bytes[..7]];
                let mut hasher = Sha256::new();
                for part in [b"d".as_slice()].into_iter().chain(parts) {
                    hasher.update((part.len() as u64).to_le_bytes());
                    hasher.update(part);
                }
                let expected: [u8; 32] = hasher.finalize().into();
                assert_eq!(Digest::of_parts("d", &parts).bytes(), &expected, "{first} {second}");
            }
        }
    }

    #[test]
    fn names_are_checked() {
        for (name, ok) in [
            ("grasp", true),
            ("a.b-c_1", true),
            ("", false),
            ("Grasp", false),
            ("../x", false),
            ("-a", false),
        ] {
            assert_eq!(is_name(name), ok, "{name}");
        }
        assert!(!is_name(&"a".repeat(65)));
    }

    #[test]
    fn capability_ids_round_trip() {
        let id: CapabilityId = "grasp@1.2.0".parse().unwrap();
        assert_eq!(id.to_string(), "grasp@1.2.0");
        assert!("grasp".parse::<CapabilityId>().is_err());
        assert!("grasp@one".parse::<CapabilityId>().is_err());
    }

    #[test]
    fn digests_round_trip_and_separate_parts() {
        let digest = Digest::of_parts("test", &[b"ab", b"c"]);
        assert_eq!(digest.to_string().parse::<Digest>().unwrap(), digest);
        assert_ne!(digest, Digest::of_parts("test", &[b"a", b"bc"]));
        assert_ne!(digest, Digest::of_parts("other", &[b"ab", b"c"]));
        let text = digest.to_string();
        let signed = format!("+{}", &text[1..]);
        for other in [text.to_uppercase(), signed, format!(" {}", &text[1..]), text[1..].to_owned()] {
            assert!(other.parse::<Digest>().is_err(), "{other}");
        }
    }
}
