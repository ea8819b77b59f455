//! Closed sets of words: one enum, its names in records and on screen, and how a name is read back.

/// A word that is not in its set.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is not a {what}; allowed: {allowed}")]
pub struct WordError {
    /// What the word should have been.
    pub what: &'static str,
    /// The word.
    pub found: String,
    /// The set.
    pub allowed: String,
}

impl WordError {
    /// For a word that is none of `allowed`.
    pub fn new(what: &'static str, found: &str, allowed: impl Iterator<Item = &'static str>) -> Self {
        Self { what, found: found.to_owned(), allowed: allowed.collect::<Vec<_>>().join(", ") }
    }
}

/// Makes an enum without data whose members have a name each, in records, on screen and in JSON alike.
///
/// It gets `ALL` (every member in order), `name()`, `Display`, `FromStr` with a [`WordError`] that lists the set, and
/// serde as the name.
#[macro_export]
macro_rules! words {
    ($(#[$doc:meta])* $name:ident, $what:literal, { $($(#[$member_doc:meta])* $member:ident = $text:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ::serde::Serialize, ::serde::Deserialize)]
        pub enum $name { $($(#[$member_doc])* #[serde(rename = $text)] $member),+ }

        impl $name {
            /// Every member, in order.
            pub const ALL: [Self; [$($text),+].len()] = [$(Self::$member),+];

            /// The name in records and on screen.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$member => $text),+ }
            }
        }

        impl ::std::str::FromStr for $name {
            type Err = $crate::words::WordError;
            fn from_str(text: &str) -> Result<Self, Self::Err> {
                let all = Self::ALL.into_iter();
                all.clone().find(|word| word.name() == text).ok_or_else(|| {
                    $crate::words::WordError::new($what, text, all.map(Self::name))
                })
            }
        }

        impl ::std::fmt::Display for $name {
            fn fmt(&self, f: &mut ::std::fmt::Formatter<'_>) -> ::std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}
