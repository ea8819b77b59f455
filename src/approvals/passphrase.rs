//! A passphrase: read from a file, wiped after use, never shown.

use std::borrow::Cow;
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use rustix::fs::{Mode, OFlags};
use zeroize::Zeroizing;

pub const PASSPHRASE_BYTES_MAX: usize = 1024;
/// The shortest for a new key, characters.
pub const PASSPHRASE_CHARS_MIN: usize = 8;

holdpoint_governance::closed_set! {
    /// What is wrong with a passphrase, for programs.
    PassphraseCause, "problem with a passphrase", {
        /// The key has one, and none was given.
        Needed = "needed",
        /// It does not open the key.
        Wrong = "wrong",
        /// One was given, and the key has none.
        NotSet = "not-set",
        /// It is empty.
        Empty = "empty",
        /// It is longer than allowed.
        TooLong = "too-long",
        /// It is too short for a new key.
        TooShort = "too-short",
        /// It is not one line of text.
        NotALine = "not-a-line",
        /// The repetition is another one.
        NotRepeated = "not-repeated",
    }
}

/// A passphrase that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PassphraseError {
    #[error("the passphrase is empty")]
    Empty,
    /// Longer than a person types.
    #[error("the passphrase has more than {PASSPHRASE_BYTES_MAX} bytes")]
    TooLong,
    #[error("the passphrase has {0} characters; at least {PASSPHRASE_CHARS_MIN} are needed")]
    TooShort(usize),
    /// It has a line end or another control character, which cannot be typed at a terminal.
    #[error("the passphrase has control characters; one line of text is needed")]
    Control,
    #[error("cannot read the passphrase file {path:?}: {source}")]
    Io { path: PathBuf, source: std::io::Error },
    #[error("the passphrase file {0:?} is not a regular file")]
    Kind(PathBuf),
    #[error("the passphrase file {path:?} has mode {mode:04o}; others must have no access")]
    Permissions { path: PathBuf, mode: u32 },
    /// Its content is not a passphrase.
    #[error("the passphrase file {path:?} cannot be used: {problem}")]
    Content {
        path: PathBuf,
        /// The problem with its text, which is not shown.
        problem: Box<Self>,
    },
}

impl Hint for PassphraseError {
    fn details(&self) -> Option<ErrorDetails> {
        let of =
            |cause: PassphraseCause| ErrorDetails::from(ErrorReason::Passphrase).with_cause(cause.name());
        Some(match self {
            Self::Empty => of(PassphraseCause::Empty),
            Self::TooLong => of(PassphraseCause::TooLong),
            Self::TooShort(_) => of(PassphraseCause::TooShort),
            Self::Control => of(PassphraseCause::NotALine),
            Self::Io { path, .. } | Self::Kind(path) | Self::Permissions { path, .. } => {
                ErrorDetails::of_path(ErrorReason::BadFile, path)
            }
            Self::Content { path, problem } => {
                let place = ErrorDetails::of_path(ErrorReason::Passphrase, path).place;
                ErrorDetails { place, ..problem.details()? }
            }
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Permissions { path, .. } => Some(format!("`chmod 600 {}`", path.display()).into()),
            Self::Kind(_) => Some("name a regular file of mode 0600 with the passphrase on one line".into()),
            Self::TooShort(_) => Some("several words make a good one".into()),
            Self::Content { problem, .. } => problem.hint(),
            Self::Empty | Self::TooLong | Self::Control | Self::Io { .. } => None,
        }
    }
}

/// The passphrase of a key. Never shown, and wiped from memory on drop.
#[derive(Clone, PartialEq, Eq)]
pub struct Passphrase(Zeroizing<String>);

impl std::fmt::Debug for Passphrase {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Passphrase(..)")
    }
}

impl Passphrase {
    /// A passphrase for an existing key.
    ///
    /// # Errors
    /// If it is empty, too long, or has control characters.
    pub fn new(text: Zeroizing<String>) -> Result<Self, PassphraseError> {
        if text.is_empty() {
            return Err(PassphraseError::Empty);
        }
        if text.len() > PASSPHRASE_BYTES_MAX {
            return Err(PassphraseError::TooLong);
        }
        if text.chars().any(char::is_control) {
            return Err(PassphraseError::Control);
        }
        Ok(Self(text))
    }

    /// A passphrase for a new key.
    ///
    /// # Errors
    /// [`PassphraseError::TooShort`].
    pub fn strong_enough(self) -> Result<Self, PassphraseError> {
        let chars = self.0.chars().count();
        if chars < PASSPHRASE_CHARS_MIN { Err(PassphraseError::TooShort(chars)) } else { Ok(self) }
    }

    /// The passphrase in a file: regular, readable by its owner alone, one line.
    ///
    /// # Errors
    /// [`PassphraseError`].
    pub fn read(path: &Path) -> Result<Self, PassphraseError> {
        let io = |source| PassphraseError::Io { path: path.to_owned(), source };
        let file = match open_plainly(path) {
            // The kernel reports a symbolic link with this error.
            Err(rustix::io::Errno::LOOP) => return Err(PassphraseError::Kind(path.to_owned())),
            opened => opened.map_err(|error| io(error.into()))?,
        };
        let found = file.metadata().map_err(io)?;
        if !found.is_file() {
            return Err(PassphraseError::Kind(path.to_owned()));
        }
        let mode = found.permissions().mode() & 0o7777;
        if mode & 0o077 != 0 {
            return Err(PassphraseError::Permissions { path: path.to_owned(), mode });
        }
        let content =
            |problem| PassphraseError::Content { path: path.to_owned(), problem: Box::new(problem) };
        if found.size() > PASSPHRASE_BYTES_MAX as u64 + 2 {
            return Err(content(PassphraseError::TooLong));
        }
        // Full capacity from the start, because growing would leave a copy behind.
        let mut text = Zeroizing::new(String::with_capacity(PASSPHRASE_BYTES_MAX + 2));
        match file.take(PASSPHRASE_BYTES_MAX as u64 + 2).read_to_string(&mut text) {
            Ok(_) => {}
            Err(error) if error.kind() == std::io::ErrorKind::InvalidData => {
                return Err(content(PassphraseError::Control));
            }
            Err(error) => return Err(io(error)),
        }
        let line = text.strip_suffix('\n').unwrap_or(&text);
        let len = line.strip_suffix('\r').unwrap_or(line).len();
        text.truncate(len);
        Self::new(text).map_err(content)
    }

    pub(super) fn bytes(&self) -> &[u8] {
        self.0.as_bytes()
    }
}

/// Opens a file for reading; follows no link and waits for no pipe.
pub(super) fn open_plainly(path: &Path) -> rustix::io::Result<File> {
    let how = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    rustix::fs::open(path, how, Mode::empty()).map(File::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passphrase_is_read_only_from_a_private_regular_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("words");
        let write = |text: &[u8], mode: u32| {
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            Passphrase::read(&path)
        };
        let plain = Passphrase::new("under the oak".to_owned().into()).unwrap();
        for text in ["under the oak", "under the oak\n", "under the oak\r\n"] {
            assert_eq!(write(text.as_bytes(), 0o600).unwrap(), plain);
        }
        assert_eq!(write(b"under the oak\n", 0o400).unwrap(), plain);
        assert_eq!(format!("{plain:?}"), "Passphrase(..)");
        let long = vec![b'a'; PASSPHRASE_BYTES_MAX + 1];
        for mode in [0o640, 0o604] {
            let error = write(b"under the oak", mode).unwrap_err();
            let is_due = matches!(error, PassphraseError::Permissions { mode: found, .. } if found == mode);
            assert!(is_due && !error.to_string().contains("oak"), "{error}");
        }
        let cases: [(&[u8], PassphraseCause); 5] = [
            (b"", PassphraseCause::Empty),
            (b"\n", PassphraseCause::Empty),
            (b"two\nlines\n", PassphraseCause::NotALine),
            (b"\xff\xfe", PassphraseCause::NotALine),
            (&long, PassphraseCause::TooLong),
        ];
        for (text, cause) in cases {
            let details = write(text, 0o600).unwrap_err().details();
            assert_eq!(details.and_then(|details| details.cause), Some(cause.name()));
        }
    }

    #[test]
    fn links_pipes_devices_and_folders_are_refused_without_waiting() {
        let folder = tempfile::tempdir().unwrap();
        let (link, pipe) = (folder.path().join("link"), folder.path().join("pipe"));
        std::os::unix::fs::symlink("/etc/hostname", &link).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
            .unwrap();
        for path in [link.as_path(), &pipe, folder.path(), Path::new("/dev/zero")] {
            let error = Passphrase::read(path).unwrap_err();
            assert!(matches!(error, PassphraseError::Kind(_)), "{path:?}: {error}");
        }
        let none = Passphrase::read(&folder.path().join("none")).unwrap_err();
        assert!(none.to_string().contains("none"), "{none}");
    }

    #[test]
    fn short_passphrase_protects_no_key() {
        let of = |text: &str| Passphrase::new(text.to_owned().into()).unwrap().strong_enough();
        assert!(matches!(of("seven c"), Err(PassphraseError::TooShort(7))));
        assert!(of("eight ch").is_ok());
        assert!(of("ächtzehn").is_ok());
    }
}
