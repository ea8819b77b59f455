//! Identities: a name, a role and an ed25519 key in `keys/identities/<name>.{key,pub}`.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use ed25519_dalek::{Signer, SigningKey, VerifyingKey};

use super::keyfile::{self, KeyError};
use super::signed::{Approval, SignedApproval};
use holdpoint_governance::approval::Role;
use holdpoint_governance::ids::is_name;
use holdpoint_governance::words::WordError;
use holdpoint_text::Hint;

/// The longest identity or role name, bytes.
pub const WORD_LEN_MAX: usize = holdpoint_governance::ids::NAME_LEN_MAX;
/// The most identities a store lists.
const IDENTITIES_MAX: usize = 1000;

/// An identity that cannot be made or used.
#[derive(Debug, thiserror::Error)]
pub enum IdentityError {
    /// The name is not of the allowed form.
    #[error(
        "the identity {0:?} is not allowed: 1 to 64 of a-z, 0-9, '.', '_', '-', starting with a letter or digit"
    )]
    Name(String),
    /// Its public file names a role that does not exist.
    #[error("the identity {name:?} cannot decide anything: {source}")]
    Role {
        name: String,
        /// Which role, and which there are.
        source: WordError,
    },
    /// There is one of that name.
    #[error("there is an identity {0:?} already")]
    Exists(String),
    /// There is none of that name.
    #[error("there is no identity {name:?} in {folder:?}")]
    Unknown {
        name: String,
        /// Where it was looked for.
        folder: PathBuf,
    },
    /// The secret and the public key do not belong together.
    #[error("the secret and the public key of {0:?} do not belong together")]
    Mismatch(String),
    /// There are too many.
    #[error("{0:?} holds more than 1000 identities")]
    TooMany(PathBuf),
    /// A key file cannot be used.
    #[error(transparent)]
    Key(#[from] KeyError),
}

impl Hint for IdentityError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Role { .. } => Some("make another identity with one of these".into()),
            Self::Exists(_) => Some("choose another name; keys are never replaced".into()),
            Self::Unknown { name, .. } => {
                Some(format!("make one with `holdpoint identity new {name}`").into())
            }
            Self::Name(_) | Self::Mismatch(_) | Self::TooMany(_) => None,
            Self::Key(error) => error.hint(),
        }
    }
}

/// Who someone is, without the secret.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdentityInfo {
    pub name: String,
    pub role: Role,
    pub public_key: VerifyingKey,
}

/// The identities of a store.
#[derive(Debug, Default)]
pub struct People {
    /// Who may decide, by name.
    pub known: Vec<IdentityInfo>,
    /// Those whose role does not exist (older versions took any word): they can decide nothing.
    pub without_role: Vec<IdentityError>,
}

/// Someone who can sign. The secret is wiped from memory when this is dropped and never shown.
pub struct Identity {
    info: IdentityInfo,
    secret: SigningKey,
}

impl std::fmt::Debug for Identity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Identity")
            .field("name", &self.info.name)
            .field("role", &self.info.role)
            .finish_non_exhaustive()
    }
}

impl Identity {
    /// Makes an identity with a fresh key and writes it into `folder`.
    ///
    /// # Errors
    /// If the name is not allowed or taken, or the files cannot be written.
    pub fn create(folder: &Path, name: &str, role: Role) -> Result<Self, IdentityError> {
        Self::create_with(folder, name, role, keyfile::generate()?)
    }

    fn create_with(folder: &Path, name: &str, role: Role, secret: SigningKey) -> Result<Self, IdentityError> {
        let (secret_path, public_path) = paths(folder, name)?;
        if fs::symlink_metadata(&secret_path).is_ok() || fs::symlink_metadata(&public_path).is_ok() {
            return Err(IdentityError::Exists(name.to_owned()));
        }
        keyfile::write_secret(&secret_path, &secret)?;
        keyfile::write_public(&public_path, &secret.verifying_key(), role.name())?;
        Ok(Self {
            info: IdentityInfo { name: name.to_owned(), role, public_key: secret.verifying_key() },
            secret,
        })
    }

    /// Reads an identity with its secret.
    ///
    /// # Errors
    /// If there is none, others can read the secret, or the two files do not belong together.
    pub fn load(folder: &Path, name: &str) -> Result<Self, IdentityError> {
        let info = Self::find(folder, name)?;
        let secret = keyfile::read_secret(&paths(folder, name)?.0)?;
        if secret.verifying_key() != info.public_key {
            return Err(IdentityError::Mismatch(name.to_owned()));
        }
        Ok(Self { info, secret })
    }

    /// Reads who someone is, without the secret.
    ///
    /// # Errors
    /// If there is no such identity or its public file is damaged.
    pub fn find(folder: &Path, name: &str) -> Result<IdentityInfo, IdentityError> {
        let (_, public_path) = paths(folder, name)?;
        if fs::symlink_metadata(&public_path).is_err() {
            return Err(IdentityError::Unknown { name: name.to_owned(), folder: folder.to_owned() });
        }
        let (public_key, role) = keyfile::read_public(&public_path)?;
        Ok(IdentityInfo {
            name: name.to_owned(),
            role: role.parse().map_err(|source| IdentityError::Role { name: name.to_owned(), source })?,
            public_key,
        })
    }

    /// Everyone known, by name.
    ///
    /// # Errors
    /// If the folder cannot be read, a file in it is damaged, or there are more than 1000.
    pub fn list(folder: &Path) -> Result<People, IdentityError> {
        let unreadable = |source| KeyError::Io { what: "list", path: folder.to_owned(), source };
        let mut names = Vec::new();
        for entry in fs::read_dir(folder).map_err(unreadable)? {
            let name = entry.map_err(unreadable)?.file_name();
            if let Some(name) = name.to_str().and_then(|name| name.strip_suffix(".pub")) {
                names.push(name.to_owned());
            }
            if names.len() > IDENTITIES_MAX {
                return Err(IdentityError::TooMany(folder.to_owned()));
            }
        }
        names.sort();
        let mut people = People::default();
        for name in names {
            match Self::find(folder, &name) {
                Ok(info) => people.known.push(info),
                Err(error @ IdentityError::Role { .. }) => people.without_role.push(error),
                Err(error) => return Err(error),
            }
        }
        Ok(people)
    }

    #[must_use]
    pub const fn info(&self) -> &IdentityInfo {
        &self.info
    }

    /// Signs a decision. Its `who` and `role` are replaced by this identity's.
    #[must_use]
    pub fn sign(&self, mut approval: Approval) -> SignedApproval {
        approval.who.clone_from(&self.info.name);
        approval.role = self.info.role;
        let signature = self.secret.sign(&approval.bytes());
        SignedApproval::new(approval, self.info.public_key, signature)
    }
}

fn paths(folder: &Path, name: &str) -> Result<(PathBuf, PathBuf), IdentityError> {
    if !is_name(name) {
        return Err(IdentityError::Name(name.to_owned()));
    }
    Ok((folder.join(format!("{name}.key")), folder.join(format!("{name}.pub"))))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn made_listed_and_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        Identity::create(folder.path(), "bob", Role::Safety).unwrap();
        assert_eq!(Identity::load(folder.path(), "ada").unwrap().info(), ada.info());
        let names: Vec<_> =
            Identity::list(folder.path()).unwrap().known.into_iter().map(|info| info.name).collect();
        assert_eq!(names, ["ada", "bob"]);
        assert!(!format!("{ada:?}").contains("secret"));
    }

    #[test]
    fn refused() {
        let folder = tempfile::tempdir().unwrap();
        Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        for (name, message) in
            [("ada", "already"), ("../eve", "not allowed"), ("", "not allowed"), ("Eve", "not allowed")]
        {
            let error = Identity::create(folder.path(), name, Role::Operator).unwrap_err().to_string();
            assert!(error.contains(message), "{name}: {error}");
        }
        assert!(Identity::load(folder.path(), "nobody").unwrap_err().to_string().contains("no identity"));
        for mode in [0o640, 0o604, 0o660, 0o777] {
            let key = folder.path().join("ada.key");
            std::fs::set_permissions(&key, std::fs::Permissions::from_mode(mode)).unwrap();
            let error = Identity::load(folder.path(), "ada").unwrap_err();
            assert!(error.to_string().contains(&format!("{mode:04o}")), "{error}");
            assert!(error.hint().unwrap().contains("chmod 600"), "{error}");
        }
    }

    #[test]
    fn swapped_or_broken_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        Identity::create(folder.path(), "bob", Role::Operator).unwrap();
        std::fs::rename(folder.path().join("bob.key"), folder.path().join("ada.key")).unwrap();
        assert!(matches!(Identity::load(folder.path(), "ada"), Err(IdentityError::Mismatch(_))));
        for text in ["", "zz", "\u{feff}", &"f".repeat(300), &"0".repeat(63)] {
            std::fs::write(folder.path().join("ada.pub"), text).unwrap();
            assert!(Identity::find(folder.path(), "ada").is_err(), "{text:?}");
        }
        std::fs::write(folder.path().join("ada.pub"), [0xff, 0xfe]).unwrap();
        assert!(Identity::list(folder.path()).is_err());
    }
}
