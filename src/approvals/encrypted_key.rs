//! The key file of a passphrase-protected secret key.
//!
//! Eight lines of text, each ended by a line feed, the fields in this order:
//!
//! ```text
//! holdpoint-key 1          what it is, and the version of this form
//! kdf argon2id             RFC 9106, version 0x13
//! memory-kib 65536         its three parameters
//! passes 3
//! lanes 4
//! salt  <32 digits>        16 random bytes
//! nonce <48 digits>        24 random bytes
//! key   <96 digits>        XChaCha20-Poly1305 over the 32 bytes of the ed25519 secret, with its tag of 16 bytes
//! ```
//!
//! Digits are hexadecimal, and one blank stands between a field and its value. Every line before the last is
//! authenticated with the secret, so a parameter cannot be changed under a passphrase that still fits. Each encryption
//! uses a new salt and a new nonce.

use argon2::{Algorithm, Argon2, Block, Params, Version};
use chacha20poly1305::aead::AeadInOut;
use chacha20poly1305::{KeyInit, XChaCha20Poly1305};
use ed25519_dalek::SigningKey;
use zeroize::{Zeroize, Zeroizing};

use super::passphrase::Passphrase;
use holdpoint_text::hex::{hex, unhex};

/// The beginning of an encrypted key; an unencrypted one has 64 hexadecimal digits there.
pub(super) const MAGIC: &str = "holdpoint-key";
const VERSION: &str = "1";
const KDF: &str = "argon2id";
const TAG_BYTES: usize = 16;

/// The cost of trying one passphrase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct KdfCost {
    /// Memory, KiB.
    pub memory_kib: u32,
    /// Passes over it.
    pub passes: u32,
    /// Lanes it is divided into.
    pub lanes: u32,
}

impl KdfCost {
    /// The second recommended choice of RFC 9106, section 4: 64 MiB, 3 passes, 4 lanes.
    pub const USUAL: Self = Self { memory_kib: 64 * 1024, passes: 3, lanes: 4 };
    /// The least that is accepted.
    pub const LEAST: Self = Self { memory_kib: 8 * 1024, passes: 1, lanes: 1 };
    /// The most that is accepted from a file: a file must not exhaust the machine.
    pub const MOST: Self = Self { memory_kib: 1024 * 1024, passes: 16, lanes: 16 };

    fn check(self) -> Result<Self, EncryptedKeyError> {
        let fields = [
            ("memory-kib", self.memory_kib, Self::LEAST.memory_kib, Self::MOST.memory_kib),
            ("passes", self.passes, Self::LEAST.passes, Self::MOST.passes),
            ("lanes", self.lanes, Self::LEAST.lanes, Self::MOST.lanes),
        ];
        for (field, value, least, most) in fields {
            if !(least..=most).contains(&value) {
                return Err(EncryptedKeyError::field(
                    field,
                    &value.to_string(),
                    format!("{least} to {most}"),
                ));
            }
        }
        Ok(self)
    }
}

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum EncryptedKeyError {
    #[error("{field} is {value:?}; allowed: {allowed}")]
    Field {
        field: &'static str,
        /// The value found, cut to a line.
        value: String,
        allowed: String,
    },
    /// The passphrase does not open it. A wrong passphrase and a modified key look the same.
    #[error("the passphrase is wrong, or the file was changed")]
    Passphrase,
    /// The machine lacks the memory that the parameters require.
    #[error("there is not enough memory to try the passphrase: {0} KiB are needed")]
    Memory(u32),
    #[error("the key derivation refuses its parameters: {0}")]
    Kdf(argon2::Error),
    #[error("the system gave no random numbers for a key: {0}")]
    Random(getrandom::Error),
}

impl EncryptedKeyError {
    fn field(field: &'static str, value: &str, allowed: impl Into<String>) -> Self {
        Self::Field { field, value: value.chars().take(80).collect(), allowed: allowed.into() }
    }
}

/// A secret key that a passphrase opens.
pub struct EncryptedKey {
    cost: KdfCost,
    salt: [u8; 16],
    nonce: [u8; 24],
    sealed: [u8; 32 + TAG_BYTES],
}

impl std::fmt::Debug for EncryptedKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SealedKey").field("cost", &self.cost).finish_non_exhaustive()
    }
}

impl EncryptedKey {
    /// Encrypts a secret.
    ///
    /// # Errors
    /// [`EncryptedKeyError`].
    pub fn seal(key: &SigningKey, passphrase: &Passphrase, cost: KdfCost) -> Result<Self, EncryptedKeyError> {
        let mut made = Self { cost: cost.check()?, salt: [0; 16], nonce: [0; 24], sealed: [0; 48] };
        getrandom::fill(&mut made.salt).map_err(EncryptedKeyError::Random)?;
        getrandom::fill(&mut made.nonce).map_err(EncryptedKeyError::Random)?;
        let cipher = made.cipher(passphrase)?;
        let mut secret = Zeroizing::new(key.to_bytes());
        let tag = cipher
            .encrypt_inout_detached(&made.nonce.into(), made.head().as_bytes(), secret.as_mut_slice().into())
            .map_err(|_| EncryptedKeyError::Passphrase)?;
        made.sealed[..32].copy_from_slice(secret.as_slice());
        made.sealed[32..].copy_from_slice(&tag);
        Ok(made)
    }

    /// The secret.
    ///
    /// # Errors
    /// [`EncryptedKeyError::Passphrase`], or why it cannot be tried.
    pub fn open(&self, passphrase: &Passphrase) -> Result<SigningKey, EncryptedKeyError> {
        let cipher = self.cipher(passphrase)?;
        let mut secret = Zeroizing::new([0; 32]);
        secret.copy_from_slice(&self.sealed[..32]);
        let mut tag = [0; TAG_BYTES];
        tag.copy_from_slice(&self.sealed[32..]);
        cipher
            .decrypt_inout_detached(
                &self.nonce.into(),
                self.head().as_bytes(),
                secret.as_mut_slice().into(),
                &tag.into(),
            )
            .map_err(|_| EncryptedKeyError::Passphrase)?;
        Ok(SigningKey::from_bytes(&secret))
    }

    fn cipher(&self, passphrase: &Passphrase) -> Result<XChaCha20Poly1305, EncryptedKeyError> {
        let KdfCost { memory_kib, passes, lanes } = self.cost;
        let params = Params::new(memory_kib, passes, lanes, Some(32)).map_err(EncryptedKeyError::Kdf)?;
        // Without enough memory, this is an error and does not abort the program.
        let mut memory: Vec<Block> = Vec::new();
        let blocks = params.block_count();
        memory.try_reserve_exact(blocks).map_err(|_| EncryptedKeyError::Memory(memory_kib))?;
        memory.resize(blocks, Block::new());
        let mut key = Zeroizing::new([0; 32]);
        let made = Argon2::new(Algorithm::Argon2id, Version::V0x13, params).hash_password_into_with_memory(
            passphrase.bytes(),
            &self.salt,
            key.as_mut_slice(),
            &mut memory,
        );
        memory.iter_mut().for_each(Zeroize::zeroize);
        made.map_err(EncryptedKeyError::Kdf)?;
        XChaCha20Poly1305::new_from_slice(key.as_slice()).map_err(|_| EncryptedKeyError::Passphrase)
    }

    /// Every line before the last.
    fn head(&self) -> String {
        let KdfCost { memory_kib, passes, lanes } = self.cost;
        format!(
            "{MAGIC} {VERSION}\nkdf {KDF}\nmemory-kib {memory_kib}\npasses {passes}\nlanes {lanes}\nsalt {}\nnonce {}\n",
            hex(&self.salt),
            hex(&self.nonce)
        )
    }

    pub(super) fn text(&self) -> String {
        format!("{}key {}\n", self.head(), hex(&self.sealed))
    }

    /// Reads exactly the form that [`Self::text`] writes.
    ///
    /// # Errors
    /// [`EncryptedKeyError::Field`].
    pub(super) fn parse(text: &str) -> Result<Self, EncryptedKeyError> {
        let mut lines = text.split_terminator('\n');
        let mut next = |field: &'static str, allowed: &'static str| {
            let line = lines.next().unwrap_or_default();
            match line.split_once(' ') {
                Some((name, value)) if name == field => Ok(value),
                _ => Err(EncryptedKeyError::field(field, line, format!("a line `{field} {allowed}`"))),
            }
        };
        let version = next(MAGIC, VERSION)?;
        if version != VERSION {
            return Err(EncryptedKeyError::field(MAGIC, version, VERSION));
        }
        let kdf = next("kdf", KDF)?;
        if kdf != KDF {
            return Err(EncryptedKeyError::field("kdf", kdf, KDF));
        }
        let mut number = |field: &'static str| -> Result<u32, EncryptedKeyError> {
            let value = next(field, "NUMBER")?;
            let plain = !value.is_empty() && value.bytes().all(|byte| byte.is_ascii_digit());
            let number = value.parse().ok().filter(|_| plain && !value.starts_with('0'));
            number.ok_or_else(|| EncryptedKeyError::field(field, value, "a whole number"))
        };
        let cost =
            KdfCost { memory_kib: number("memory-kib")?, passes: number("passes")?, lanes: number("lanes")? }
                .check()?;
        let salt = digits("salt", next("salt", "32 digits")?)?;
        let nonce = digits("nonce", next("nonce", "48 digits")?)?;
        let sealed = digits("key", next("key", "96 digits")?)?;
        if let Some(line) = lines.next() {
            return Err(EncryptedKeyError::field("the end of the file", line, "nothing more"));
        }
        Ok(Self { cost, salt, nonce, sealed })
    }
}

fn digits<const N: usize>(field: &'static str, value: &str) -> Result<[u8; N], EncryptedKeyError> {
    unhex(value)
        .ok_or_else(|| EncryptedKeyError::field(field, value, format!("{} hexadecimal digits", 2 * N)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passphrase(text: &str) -> Passphrase {
        Passphrase::new(text.to_owned().into()).unwrap()
    }

    fn sealed() -> (SigningKey, EncryptedKey) {
        let key = SigningKey::from_bytes(&[7; 32]);
        let sealed = EncryptedKey::seal(&key, &passphrase("under the oak"), KdfCost::LEAST).unwrap();
        (key, sealed)
    }

    #[test]
    fn encrypted_key_opens_only_with_its_passphrase() {
        let (key, sealed) = sealed();
        let text = sealed.text();
        assert!(!text.contains(&hex(&key.to_bytes())));
        let read = EncryptedKey::parse(&text).unwrap();
        assert_eq!(read.text(), text);
        assert_eq!(read.open(&passphrase("under the oak")).unwrap(), key);
        for wrong in ["under the oaK", "under the oak ", "x"] {
            assert_eq!(read.open(&passphrase(wrong)).unwrap_err(), EncryptedKeyError::Passphrase, "{wrong}");
        }
        let again = EncryptedKey::seal(&key, &passphrase("under the oak"), KdfCost::LEAST).unwrap();
        assert_ne!(again.salt, sealed.salt);
        assert_ne!(again.nonce, sealed.nonce);
    }

    /// Made by another implementation of both (Python's `cryptography` 48, with `HChaCha20` after its draft).
    #[test]
    fn key_encrypted_by_another_implementation_opens() {
        let text = "\
            holdpoint-key 1\n\
            kdf argon2id\n\
            memory-kib 8192\n\
            passes 2\n\
            lanes 4\n\
            salt 000102030405060708090a0b0c0d0e0f\n\
            nonce 6465666768696a6b6c6d6e6f707172737475767778797a7b\n\
            key 768c9c7d27174318c899fac72dc7708ad8d0100f8610e71340233e8e839cc9aa\
            4f269940140bb423333b57b1a60fddb4\n";
        let read = EncryptedKey::parse(text).unwrap();
        assert_eq!(read.open(&passphrase("under the oak")).unwrap(), SigningKey::from_bytes(&[7; 32]));
    }

    #[test]
    fn every_line_is_authenticated() {
        let (_, sealed) = sealed();
        let text = sealed.text();
        let opens = |text: &str| {
            EncryptedKey::parse(text)
                .map_err(|_| ())
                .and_then(|read| read.open(&passphrase("under the oak")).map_err(|_| ()))
        };
        assert!(opens(&text).is_ok());
        for (from, to) in
            [("memory-kib 8192", "memory-kib 8200"), ("passes 1", "passes 2"), ("lanes 1", "lanes 2")]
        {
            let changed = text.replacen(from, to, 1);
            assert_ne!(changed, text);
            assert!(opens(&changed).is_err(), "{to}");
        }
        for field in ["salt ", "nonce ", "key "] {
            let at = text.find(field).unwrap() + field.len();
            let digit = if text.as_bytes()[at] == b'0' { "1" } else { "0" };
            let mut changed = text.clone();
            changed.replace_range(at..=at, digit);
            assert!(opens(&changed).is_err(), "{field}");
        }
    }

    #[test]
    fn invalid_field_is_refused_with_its_value_and_the_allowed_range() {
        let (_, sealed) = sealed();
        let text = sealed.text();
        let cases = [
            ("holdpoint-key 1", "holdpoint-key 2", MAGIC, "2"),
            ("kdf argon2id", "kdf scrypt", "kdf", "scrypt"),
            ("memory-kib 8192", "memory-kib 4294967295", "memory-kib", "4294967295"),
            ("memory-kib 8192", "memory-kib 99999999999", "memory-kib", "99999999999"),
            ("memory-kib 8192", "memory-kib 8", "memory-kib", "8"),
            ("passes 1", "passes 0", "passes", "0"),
            ("passes 1", "passes 1000000", "passes", "1000000"),
            ("passes 1", "passes +1", "passes", "+1"),
            ("lanes 1", "lanes 17", "lanes", "17"),
            ("lanes 1\n", "", "lanes", "salt "),
            ("salt ", "salt x", "salt", "x"),
            ("\nkey ", "\nkey 00", "key", "00"),
        ];
        let refused = |text: &str| match EncryptedKey::parse(text) {
            Err(EncryptedKeyError::Field { field, value, .. }) => (field, value),
            Err(error) => panic!("{error}"),
            Ok(_) => panic!("it is taken"),
        };
        for (from, to, field, value) in cases {
            let changed = text.replacen(from, to, 1);
            assert_ne!(changed, text, "{from}");
            let (named, found) = refused(&changed);
            assert!(named == field && found.starts_with(value), "{to}: {named}, {found}");
        }
        assert_eq!(refused(&format!("{text}x\n")).1, "x");
        let weak = EncryptedKey::seal(
            &SigningKey::from_bytes(&[1; 32]),
            &passphrase("x"),
            KdfCost { passes: 99, ..KdfCost::LEAST },
        );
        assert!(weak.is_err());
    }
}
