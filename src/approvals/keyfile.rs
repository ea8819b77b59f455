//! Key files: a secret ed25519 key in a file only its owner can read, the public one beside it.
//!
//! The secret is 64 hexadecimal digits and a line feed, or encrypted under a passphrase (`encrypted_key.rs`); it is
//! wiped from memory after use.

use std::borrow::Cow;
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use ed25519_dalek::{SigningKey, VerifyingKey};
use holdpoint_text::hex::{hex, push_hex, unhex};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use zeroize::Zeroizing;

use super::encrypted_key::{EncryptedKey, EncryptedKeyError, KdfCost, MAGIC};
use super::passphrase::{Passphrase, PassphraseCause, open_plainly};

/// A key that cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    #[error("cannot {what} the key {path:?}: {source}")]
    Io { what: &'static str, path: PathBuf, source: std::io::Error },
    /// Others can read the secret.
    #[error("the key {path:?} has mode {mode:04o}; others must have no access")]
    Permissions { path: PathBuf, mode: u32 },
    /// A link, a pipe, a folder or a device is in its place; its target is not read.
    #[error("{path:?} is {found}; a key is a regular file of its own")]
    NotAFile { path: PathBuf, found: &'static str },
    #[error("{path:?} is not a key: 64 hexadecimal digits are needed")]
    Malformed { path: PathBuf },
    #[error("{path:?} is not a key: it has more than the allowed {FILE_BYTES_MAX} bytes")]
    TooLarge { path: PathBuf },
    #[error("the system gave no random numbers for a key: {0}")]
    Random(getrandom::Error),
    #[error("the key {path:?}: {problem}")]
    Sealed { path: PathBuf, problem: EncryptedKeyError },
    #[error("the key {path:?} has a passphrase, and none was given")]
    Locked { path: PathBuf },
    #[error("the key {path:?} has no passphrase, and one was given")]
    Open { path: PathBuf },
}

holdpoint_governance::closed_set! {
    /// The protection of a secret key against readers of its file.
    Protection, "protection", {
        /// None: a reader of the file can sign.
        None = "unprotected",
        /// A passphrase.
        Passphrase = "passphrase",
        /// The secret lies elsewhere, with an unknown protection.
        Elsewhere = "elsewhere",
    }
}

/// A secret key as stored in its file.
#[derive(Debug)]
pub enum StoredKey {
    /// As it is.
    Plain(SigningKey),
    /// Under a passphrase.
    Sealed(EncryptedKey),
}

impl StoredKey {
    /// Its protection.
    #[must_use]
    pub const fn protection(&self) -> Protection {
        match self {
            Self::Plain(_) => Protection::None,
            Self::Sealed(_) => Protection::Passphrase,
        }
    }

    /// The secret; errors name `path`.
    ///
    /// # Errors
    /// [`KeyError::Locked`], [`KeyError::Open`], [`KeyError::Sealed`].
    pub fn unlock(self, path: &Path, passphrase: Option<&Passphrase>) -> Result<SigningKey, KeyError> {
        match (self, passphrase) {
            (Self::Plain(key), None) => Ok(key),
            (Self::Plain(_), Some(_)) => Err(KeyError::Open { path: path.to_owned() }),
            (Self::Sealed(_), None) => Err(KeyError::Locked { path: path.to_owned() }),
            (Self::Sealed(key), Some(passphrase)) => key.open(passphrase).map_err(sealed(path)),
        }
    }
}

/// How to write a secret key.
#[derive(Clone, Copy, Debug)]
pub enum KeyEncoding<'a> {
    /// As it is.
    Plain,
    /// Under a passphrase, at this cost per try.
    Sealed(&'a Passphrase, KdfCost),
}

impl KeyEncoding<'_> {
    fn text(self, path: &Path, key: &SigningKey) -> Result<Zeroizing<String>, KeyError> {
        match self {
            Self::Plain => {
                let mut text = Zeroizing::new(String::with_capacity(65));
                push_hex(&mut text, key.as_bytes());
                text.push('\n');
                Ok(text)
            }
            Self::Sealed(passphrase, cost) => {
                let key = EncryptedKey::seal(key, passphrase, cost).map_err(sealed(path))?;
                Ok(Zeroizing::new(key.text()))
            }
        }
    }
}

fn sealed(path: &Path) -> impl FnOnce(EncryptedKeyError) -> KeyError {
    let path = path.to_owned();
    move |problem| KeyError::Sealed { path, problem }
}

impl Hint for KeyError {
    fn details(&self) -> Option<ErrorDetails> {
        let about_passphrase =
            |cause: PassphraseCause| ErrorDetails::from(ErrorReason::Passphrase).with_cause(cause.name());
        Some(match self {
            Self::Sealed { problem: EncryptedKeyError::Passphrase, .. } => {
                about_passphrase(PassphraseCause::Wrong)
            }
            Self::Locked { .. } => about_passphrase(PassphraseCause::Needed),
            Self::Open { .. } => about_passphrase(PassphraseCause::NotSet),
            Self::Sealed { problem: EncryptedKeyError::Memory(_) | EncryptedKeyError::Random(_), .. }
            | Self::Random(_) => ErrorReason::Environment.into(),
            Self::Sealed { path, problem: EncryptedKeyError::Field { field, .. } } => {
                ErrorDetails::of_field(path.display().to_string(), *field)
            }
            Self::Sealed { path, problem: EncryptedKeyError::Kdf(_) }
            | Self::Io { path, .. }
            | Self::Permissions { path, .. }
            | Self::NotAFile { path, .. }
            | Self::Malformed { path }
            | Self::TooLarge { path } => ErrorDetails::of_path(ErrorReason::BadFile, path),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Permissions { path, .. } => {
                Some(format!("`chmod 600 {}` ends that; others may have read it", path.display()).into())
            }
            Self::NotAFile { .. } => Some("put the key's own file in its place".into()),
            Self::Sealed { problem: EncryptedKeyError::Passphrase, .. } => {
                Some("nothing was done; try again: a passphrase cannot be recovered".into())
            }
            Self::Locked { .. } => {
                Some("type it at a terminal, or name a file that has it: --passphrase-file FILE".into())
            }
            Self::Open { path } => {
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                Some(
                    format!("leave the passphrase out, or set one: `holdpoint identity passphrase {name}`")
                        .into(),
                )
            }
            Self::Sealed { .. }
            | Self::Io { .. }
            | Self::Malformed { .. }
            | Self::TooLarge { .. }
            | Self::Random(_) => None,
        }
    }
}

fn io(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> KeyError {
    let path = path.to_owned();
    move |source| KeyError::Io { what, path, source }
}

/// Makes a new key from the system's random numbers.
///
/// # Errors
/// [`KeyError::Random`].
pub fn generate() -> Result<SigningKey, KeyError> {
    let mut seed = Zeroizing::new([0u8; 32]);
    getrandom::fill(seed.as_mut()).map_err(KeyError::Random)?;
    Ok(SigningKey::from_bytes(&seed))
}

/// Writes a secret key to a new file with mode 0600.
///
/// # Errors
/// If the file exists or cannot be written.
pub fn write_secret(path: &Path, key: &SigningKey) -> Result<(), KeyError> {
    write_encoded(path, key, KeyEncoding::Plain)
}

/// Writes a secret key to a new file with mode 0600, under a passphrase or not.
///
/// # Errors
/// If the file exists or cannot be written, or the key cannot be encrypted.
pub(super) fn write_encoded(
    path: &Path,
    key: &SigningKey,
    encoding: KeyEncoding<'_>,
) -> Result<(), KeyError> {
    let text = encoding.text(path, key)?;
    put(path, text.as_bytes(), 0o600)
}

/// Writes a complete new file or none: half a key would look like a damaged one.
fn put(path: &Path, bytes: &[u8], mode: u32) -> Result<(), KeyError> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    remove_leftover("create", &part)?;
    let mut file =
        OpenOptions::new().write(true).create_new(true).mode(mode).open(&part).map_err(io("create", path))?;
    let written = file.write_all(bytes).and_then(|()| file.sync_all()).map_err(io("write", path));
    // Unlike a rename, a hard link replaces nothing.
    let placed = written.and_then(|()| fs::hard_link(&part, path).map_err(io("create", path)));
    drop(fs::remove_file(&part));
    placed.and_then(|()| force_folder(path))
}

/// Removes what an earlier crash left under a temporary name.
fn remove_leftover(what: &'static str, path: &Path) -> Result<(), KeyError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(io(what, path)(error)),
        Ok(()) | Err(_) => Ok(()),
    }
}

/// Removes a key file durably.
pub(super) fn remove(path: &Path) -> Result<(), KeyError> {
    fs::remove_file(path).map_err(io("remove", path)).and_then(|()| force_folder(path))
}

/// Syncs the folder of a file: without it, a power cut may lose the name of a synced file.
fn force_folder(path: &Path) -> Result<(), KeyError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder).and_then(|folder| folder.sync_all()).map_err(io("write the folder of", path))
}

/// Replaces a secret key atomically: after a crash the file has the old or the new form, complete. Remains of an
/// earlier crash are overwritten.
///
/// # Errors
/// If it cannot be written; the old form stays.
pub(super) fn replace_secret(
    path: &Path,
    key: &SigningKey,
    encoding: KeyEncoding<'_>,
) -> Result<(), KeyError> {
    let aside = path.with_extension("key.new");
    remove_leftover("replace", &aside)?;
    write_encoded(&aside, key, encoding)?;
    fs::rename(&aside, path).map_err(io("replace", path))?;
    force_folder(path)
}

/// Reads a secret key that has no passphrase; refuses a link and a file that others can read or write.
///
/// # Errors
/// [`KeyError`].
pub fn read_secret(path: &Path) -> Result<SigningKey, KeyError> {
    read_stored(path)?.unlock(path, None)
}

/// Reads a stored secret key, unopened; refuses a link and a file that others can read or write.
///
/// # Errors
/// [`KeyError`].
pub(super) fn read_stored(path: &Path) -> Result<StoredKey, KeyError> {
    let file = match open_plainly(path) {
        // The kernel reports a link so.
        Err(rustix::io::Errno::LOOP) => {
            return Err(KeyError::NotAFile { path: path.to_owned(), found: "a link" });
        }
        opened => opened.map_err(|error| io("read", path)(error.into()))?,
    };
    let found = file.metadata().map_err(io("read", path))?;
    let mode = found.permissions().mode() & 0o7777;
    let kind = found.file_type();
    if !kind.is_file() {
        let found = match () {
            () if kind.is_fifo() => "a named pipe",
            () if kind.is_dir() => "a folder",
            () => "a device",
        };
        return Err(KeyError::NotAFile { path: path.to_owned(), found });
    }
    if mode & 0o077 != 0 {
        return Err(KeyError::Permissions { path: path.to_owned(), mode });
    }
    let text = read_text(path, file)?;
    if text.starts_with(MAGIC) {
        return EncryptedKey::parse(&text).map(StoredKey::Sealed).map_err(sealed(path));
    }
    let bytes = unhex(text.trim_end()).map(Zeroizing::new);
    let bytes = bytes.ok_or_else(|| KeyError::Malformed { path: path.to_owned() })?;
    Ok(StoredKey::Plain(SigningKey::from_bytes(&bytes)))
}

/// Writes a public key to a new file: 64 hexadecimal digits, then `note` (a role) on the same line.
///
/// # Errors
/// If the file exists or cannot be written.
pub fn write_public(path: &Path, key: &VerifyingKey, note: &str) -> Result<(), KeyError> {
    let text = format!("{} {note}", hex(key.as_bytes()));
    put(path, format!("{}\n", text.trim_end()).as_bytes(), 0o644)
}

/// Writes a short public text to a new file beside a key.
///
/// # Errors
/// If the file exists or cannot be written.
pub(super) fn write_note(path: &Path, text: &str) -> Result<(), KeyError> {
    put(path, text.as_bytes(), 0o644)
}

/// Reads a public key and the note after it.
///
/// # Errors
/// [`KeyError`].
pub fn read_public(path: &Path) -> Result<(VerifyingKey, String), KeyError> {
    // Opening does not wait for a writer: a pipe in the place of a key is an error.
    let file = match holdpoint_text::file::open(path) {
        Err(error) if error.kind() == ErrorKind::InvalidInput => {
            return Err(KeyError::Malformed { path: path.to_owned() });
        }
        opened => opened.map_err(io("read", path))?,
    };
    let text = read_text(path, file)?;
    let (key, note) = text.trim_end().split_once(' ').unwrap_or((text.trim_end(), ""));
    Ok((parse_public(key).ok_or_else(|| KeyError::Malformed { path: path.to_owned() })?, note.to_owned()))
}

/// A public key from 64 hexadecimal digits.
#[must_use]
pub fn parse_public(text: &str) -> Option<VerifyingKey> {
    public_of(&unhex(text)?)
}

/// A public key from its 32 bytes: of full order and in canonical form. A key of small order verifies forged signatures,
/// and one with a small-order component is another key for some verifiers.
#[must_use]
pub(super) fn public_of(bytes: &[u8; 32]) -> Option<VerifyingKey> {
    let key = VerifyingKey::from_bytes(bytes).ok()?;
    let point = key.to_edwards();
    (point.compress().as_bytes() == bytes && !key.is_weak() && point.is_torsion_free()).then_some(key)
}

/// The largest key file, bytes.
const FILE_BYTES_MAX: usize = 1024;

/// Reads at most what a key file can hold.
fn read_text(path: &Path, file: File) -> Result<Zeroizing<String>, KeyError> {
    let mut text = Zeroizing::new(String::with_capacity(FILE_BYTES_MAX + 1));
    match file.take(FILE_BYTES_MAX as u64 + 1).read_to_string(&mut text) {
        Ok(_) if text.len() > FILE_BYTES_MAX => Err(KeyError::TooLarge { path: path.to_owned() }),
        Ok(_) => Ok(text),
        Err(error) if error.kind() == ErrorKind::InvalidData => {
            Err(KeyError::Malformed { path: path.to_owned() })
        }
        Err(error) => Err(io("read", path)(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_for_a_non_file_names_its_kind_and_no_mode() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        write_secret(&path("store.key"), &generate().unwrap()).unwrap();
        std::os::unix::fs::symlink(path("store.key"), path("link")).unwrap();
        rustix::fs::mkfifoat(rustix::fs::CWD, path("pipe"), rustix::fs::Mode::RUSR).unwrap();
        fs::create_dir(path("folder")).unwrap();
        for (name, kind) in [("link", "a link"), ("pipe", "a named pipe"), ("folder", "a folder")] {
            let error = read_secret(&path(name)).unwrap_err();
            assert!(matches!(&error, KeyError::NotAFile { found, .. } if *found == kind), "{name}: {error}");
        }
        fs::set_permissions(path("store.key"), fs::Permissions::from_mode(0o640)).unwrap();
        let error = read_secret(&path("store.key")).unwrap_err();
        assert!(matches!(&error, KeyError::Permissions { mode: 0o640, .. }), "{error}");
        assert!(!error.hint().unwrap().contains("new key"), "a store's own key cannot be replaced");
    }

    /// The points of small order, in all encodings.
    const SMALL: [&str; 14] = [
        "0100000000000000000000000000000000000000000000000000000000000000",
        "0100000000000000000000000000000000000000000000000000000000000080",
        "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
        "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
        "0000000000000000000000000000000000000000000000000000000000000000",
        "0000000000000000000000000000000000000000000000000000000000000080",
        "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
        "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac03fa",
        "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
        "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc85",
        "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
        "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
        "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
        "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    ];

    #[test]
    fn public_key_has_full_order_and_one_spelling() {
        let good = generate().unwrap().verifying_key();
        assert_eq!(parse_public(&hex(good.as_bytes())), Some(good));
        for small in SMALL {
            assert_eq!(parse_public(small), None, "{small}");
            // The same key for a verifier that multiplies by eight, another one otherwise.
            let small = VerifyingKey::from_bytes(&unhex(small).unwrap()).unwrap().to_edwards();
            let mixed = (good.to_edwards() + small).compress();
            let is_good = mixed.as_bytes() == good.as_bytes();
            assert_eq!(parse_public(&hex(mixed.as_bytes())).is_some(), is_good, "{mixed:?}");
        }
        // A point of full order with a coordinate that is not reduced.
        for y in 3..19_u8 {
            let (mut reduced, mut other) = ([0; 32], [0xff; 32]);
            (reduced[0], other[0], other[31]) = (y, 0xed + y, 0x7f);
            assert_eq!(public_of(&other), None, "{y}");
            let both = [reduced, other].map(|bytes| VerifyingKey::from_bytes(&bytes).is_ok());
            assert_eq!(both[0], both[1], "{y}");
        }
    }

    #[test]
    fn file_larger_than_a_key_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (secret, public) = (folder.path().join("store.key"), folder.path().join("store.pub"));
        let key = generate().unwrap();
        write_secret(&secret, &key).unwrap();
        write_public(&public, &key.verifying_key(), "").unwrap();
        for path in [&secret, &public] {
            let text = fs::read_to_string(path).unwrap();
            fs::write(path, text.clone() + &" ".repeat(FILE_BYTES_MAX - text.len())).unwrap();
        }
        assert_eq!(
            (read_secret(&secret).unwrap(), read_public(&public).unwrap().0),
            (key.clone(), key.verifying_key())
        );
        for path in [&secret, &public] {
            OpenOptions::new().append(true).open(path).unwrap().write_all(b" ").unwrap();
        }
        for error in [read_secret(&secret).unwrap_err(), read_public(&public).unwrap_err()] {
            assert!(matches!(error, KeyError::TooLarge { .. }), "{error}");
        }
    }
}
