//! Identities: a name, a role and an ed25519 key in `keys/identities/<name>.{key,pub}`.

use std::borrow::Cow;
use std::fs;
use std::path::{Path, PathBuf};

use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};

use super::agent::{AgentError, SshAgent, fingerprint};
use super::keyfile::{self, KeyEncoding, KeyError, Protection, StoredKey};
use super::passphrase::Passphrase;
use super::signed_approval::{Approval, ApprovalError, SignedApproval};
use super::signed_call::{CallClaim, SignedCall};
use holdpoint_governance::approval::Role;
use holdpoint_governance::closed_set::ClosedSetError;
use holdpoint_governance::ids::{Digest, is_name};
use holdpoint_text::hex::hex;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// What helps with a key file that is missing or damaged.
const SEE_KEYS: &str = "`holdpoint identity list` shows every identity; put this key back from a backup";
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
    #[error("the identity {name:?} cannot decide anything: {source}")]
    Role {
        name: String,
        /// The unknown role and the valid ones.
        source: ClosedSetError,
    },
    #[error("there is an identity {0:?} already")]
    Exists(String),
    /// The name is unknown.
    #[error("there is no identity {name:?} in {folder:?}")]
    Unknown {
        name: String,
        /// The folder searched.
        folder: PathBuf,
    },
    #[error("the key of {name:?} is that of {other:?} already; one key is one person")]
    KeyTaken { name: String, other: String },
    #[error("the secret and the public key of {0:?} do not belong together")]
    Mismatch(String),
    #[error("{0:?} holds more than 1000 identities")]
    TooMany(PathBuf),
    #[error("the key of {0:?} is with an ssh-agent, and has no passphrase here")]
    WithAgent(String),
    #[error("the ssh-agent does not hold the key of {name:?} ({fingerprint})")]
    NotWithAgent { name: String, fingerprint: String },
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error(transparent)]
    Key(#[from] KeyError),
}

impl Hint for IdentityError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::Name(_) => ErrorReason::Usage.into(),
            Self::Role { .. } => ErrorDetails::from(ErrorReason::NotAllowed).with_cause("unknown-role"),
            Self::Exists(_) | Self::KeyTaken { .. } => ErrorReason::Exists.into(),
            Self::Unknown { .. } => ErrorReason::NotFound.into(),
            Self::Mismatch(_) => ErrorReason::BadFile.into(),
            Self::TooMany(folder) => ErrorDetails::of_path(ErrorReason::BadFile, folder),
            Self::WithAgent(_) => ErrorReason::NotNow.into(),
            Self::NotWithAgent { .. } => ErrorDetails::from(ErrorReason::SshAgent).with_cause("no-key"),
            Self::Agent(error) => return error.details(),
            Self::Key(error) => return error.details(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Role { .. } => Some("make another identity with one of these".into()),
            Self::Exists(_) => Some("choose another name; keys are never replaced".into()),
            Self::Unknown { name, .. } => {
                Some(format!("make one with `holdpoint identity new {name}`").into())
            }
            Self::KeyTaken { other, .. } => Some(format!("sign as {other}").into()),
            Self::WithAgent(_) => Some("`ssh-keygen -p -f FILE` changes that of the key's own file".into()),
            Self::NotWithAgent { .. } => {
                Some("`ssh-add FILE` adds it; `ssh-add -l` lists what it holds".into())
            }
            Self::Agent(error) => error.hint(),
            Self::Name(_) | Self::Mismatch(_) | Self::TooMany(_) => None,
            Self::Key(error) => error.hint().or(Some(SEE_KEYS.into())),
        }
    }
}

/// An identity without its secret.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IdentityInfo {
    pub name: String,
    pub role: Role,
    pub public_key: VerifyingKey,
}

#[derive(Debug, Default)]
pub struct IdentityFolder {
    /// The valid identities, by name.
    pub known: Vec<IdentityInfo>,
    /// Identities with an unknown role (older versions took any word): they can decide nothing.
    pub without_role: Vec<IdentityError>,
}

/// An identity that can sign. The secret is never shown, and wiped from memory on drop.
pub struct Identity {
    info: IdentityInfo,
    secret: Secret,
    /// The protection of the secret when it was opened or made.
    protection: Protection,
}

/// The place of a secret.
enum Secret {
    /// In memory, opened.
    Here(Box<SigningKey>),
    /// In an ssh-agent, which signs.
    Agent(SshAgent),
}

impl std::fmt::Debug for Identity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Identity")
            .field("name", &self.info.name)
            .field("role", &self.info.role)
            .finish_non_exhaustive()
    }
}

/// An identity with its stored, unopened secret.
#[derive(Debug)]
pub struct LockedIdentity {
    info: IdentityInfo,
    path: PathBuf,
    key: StoredSecret,
}

#[derive(Debug)]
enum StoredSecret {
    /// In its file.
    File(Box<StoredKey>),
    /// In an ssh-agent, as a note file states.
    Agent,
}

impl LockedIdentity {
    #[must_use]
    pub const fn info(&self) -> &IdentityInfo {
        &self.info
    }

    /// The protection of the secret.
    #[must_use]
    pub const fn protection(&self) -> Protection {
        match &self.key {
            StoredSecret::File(key) => key.protection(),
            StoredSecret::Agent => Protection::Elsewhere,
        }
    }

    /// Opens the secret for signing.
    ///
    /// # Errors
    /// If the passphrase is wrong, missing or superfluous, or the two files do not belong together.
    pub fn unlock(self, passphrase: Option<&Passphrase>) -> Result<Identity, IdentityError> {
        let protection = self.protection();
        let Self { info, path, key } = self;
        let secret = match key {
            StoredSecret::File(key) => key.unlock(&path, passphrase)?,
            StoredSecret::Agent => return Identity::of_agent(info, SshAgent::named()?),
        };
        if secret.verifying_key() != info.public_key {
            return Err(IdentityError::Mismatch(info.name));
        }
        Ok(Identity { info, secret: Secret::Here(Box::new(secret)), protection })
    }
}

impl Identity {
    /// Makes an identity with a new unencrypted key and writes it into `folder`.
    ///
    /// # Errors
    /// If the name is not allowed or taken, or the files cannot be written.
    pub fn create(folder: &Path, name: &str, role: Role) -> Result<Self, IdentityError> {
        Self::create_encoded(folder, name, role, KeyEncoding::Plain)
    }

    /// Makes an identity with a new key and writes it into `folder`, with or without a passphrase.
    ///
    /// # Errors
    /// If the name is not allowed or taken, or the files cannot be written.
    pub fn create_encoded(
        folder: &Path,
        name: &str,
        role: Role,
        encoding: KeyEncoding<'_>,
    ) -> Result<Self, IdentityError> {
        Self::create_with(folder, name, role, keyfile::generate()?, encoding)
    }

    fn create_with(
        folder: &Path,
        name: &str,
        role: Role,
        secret: SigningKey,
        encoding: KeyEncoding<'_>,
    ) -> Result<Self, IdentityError> {
        let (secret_path, public_path) = paths(folder, name)?;
        if fs::symlink_metadata(&secret_path).is_ok() || fs::symlink_metadata(&public_path).is_ok() {
            return Err(IdentityError::Exists(name.to_owned()));
        }
        if let Some(other) = Self::names_of(folder, &secret.verifying_key())?.into_iter().next() {
            return Err(IdentityError::KeyTaken { name: name.to_owned(), other });
        }
        let protection = match encoding {
            KeyEncoding::Plain => Protection::None,
            KeyEncoding::Sealed(..) => Protection::Passphrase,
        };
        keyfile::write_encoded(&secret_path, &secret, encoding)?;
        if let Err(error) = keyfile::write_public(&public_path, &secret.verifying_key(), role.name()) {
            // Half an identity would block the name.
            drop(fs::remove_file(&secret_path));
            return Err(error.into());
        }
        Ok(Self {
            info: IdentityInfo { name: name.to_owned(), role, public_key: secret.verifying_key() },
            secret: Secret::Here(Box::new(secret)),
            protection,
        })
    }

    /// Reads an identity with its unencrypted secret.
    ///
    /// # Errors
    /// If there is none, others can read the secret, it has a passphrase, or the two files do not belong together.
    pub fn load(folder: &Path, name: &str) -> Result<Self, IdentityError> {
        Self::open(folder, name)?.unlock(None)
    }

    /// Reads an identity with its stored, unopened secret.
    ///
    /// # Errors
    /// If there is none, or others can read the secret.
    pub fn open(folder: &Path, name: &str) -> Result<LockedIdentity, IdentityError> {
        let info = Self::find(folder, name)?;
        let path = paths(folder, name)?.0;
        let key = if fs::symlink_metadata(&path).is_err() && fs::symlink_metadata(agent_file(&path)).is_ok() {
            StoredSecret::Agent
        } else {
            StoredSecret::File(Box::new(keyfile::read_stored(&path)?))
        };
        Ok(LockedIdentity { info, path, key })
    }

    /// An identity whose key an agent holds now.
    ///
    /// # Errors
    /// [`IdentityError::NotWithAgent`], or the error of the agent.
    pub fn of_agent(info: IdentityInfo, agent: SshAgent) -> Result<Self, IdentityError> {
        let holds = agent.keys()?.iter().any(|key| key.public_key == info.public_key);
        if !holds {
            return Err(IdentityError::NotWithAgent {
                name: info.name,
                fingerprint: fingerprint(&info.public_key),
            });
        }
        Ok(Self { info, secret: Secret::Agent(agent), protection: Protection::Elsewhere })
    }

    /// Notes that an ssh-agent holds the key of an identity: signing as this identity asks the agent.
    ///
    /// # Errors
    /// If there is a key of that name already, or the files cannot be written.
    pub fn note_agent(folder: &Path, who: &IdentityInfo) -> Result<(), IdentityError> {
        let (secret_path, public_path) = paths(folder, &who.name)?;
        let note = agent_file(&secret_path);
        if Self::find(folder, &who.name).is_ok_and(|known| known == *who) && note.is_file() {
            return Ok(());
        }
        for path in [&secret_path, &public_path, &note] {
            if fs::symlink_metadata(path).is_ok() {
                return Err(IdentityError::Exists(who.name.clone()));
            }
        }
        if let Some(other) = Self::names_of(folder, &who.public_key)?.into_iter().next() {
            return Err(IdentityError::KeyTaken { name: who.name.clone(), other });
        }
        keyfile::write_note(&note, &format!("ssh-agent {}\n", fingerprint(&who.public_key)))?;
        Ok(keyfile::write_public(&public_path, &who.public_key, who.role.name())?)
    }

    /// The protection of an identity's secret in this folder; copies elsewhere may be unprotected.
    ///
    /// # Errors
    /// If the key file is damaged, or others can read it.
    pub fn protection(folder: &Path, name: &str) -> Result<Protection, IdentityError> {
        let path = paths(folder, name)?.0;
        match fs::symlink_metadata(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(Protection::Elsewhere),
            Ok(_) | Err(_) => Ok(keyfile::read_stored(&path)?.protection()),
        }
    }

    /// Rewrites a secret under another passphrase or none; the old file stays until the new one is complete.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn rewrite_key(&self, folder: &Path, encoding: KeyEncoding<'_>) -> Result<(), IdentityError> {
        match &self.secret {
            Secret::Here(secret) => {
                Ok(keyfile::replace_secret(&paths(folder, &self.info.name)?.0, secret, encoding)?)
            }
            Secret::Agent(_) => Err(IdentityError::WithAgent(self.info.name.clone())),
        }
    }

    /// Removes the files of a new key that no store uses, so that the name is free again.
    ///
    /// # Errors
    /// If they cannot be removed.
    pub fn discard(self, folder: &Path) -> Result<(), IdentityError> {
        let (secret, public) = paths(folder, &self.info.name)?;
        for path in [secret, public] {
            keyfile::remove(&path)?;
        }
        Ok(())
    }

    /// All identities with this key, by name and whatever their role: they are the same person.
    ///
    /// # Errors
    /// If the folder cannot be read, a file in it is damaged, or there are more than 1000.
    pub fn names_of(folder: &Path, key: &VerifyingKey) -> Result<Vec<String>, IdentityError> {
        let mut names = Vec::new();
        for name in names_in(folder)? {
            if keyfile::read_public(&folder.join(format!("{name}.pub")))?.0 == *key {
                names.push(name);
            }
        }
        Ok(names)
    }

    /// Reads an identity without its secret.
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

    /// All identities, by name.
    ///
    /// # Errors
    /// If the folder cannot be read, a file in it is damaged, or there are more than 1000.
    pub fn list(folder: &Path) -> Result<IdentityFolder, IdentityError> {
        let mut people = IdentityFolder::default();
        for name in names_in(folder)? {
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

    /// Whether signing as this identity took more than reading a file of the store, when the secret was opened or made.
    pub(super) const fn is_guarded(&self) -> bool {
        match self.protection {
            Protection::Passphrase | Protection::Elsewhere => true,
            Protection::None => false,
        }
    }

    /// Signs a decision. Its `who` and `role` are replaced by this identity's.
    ///
    /// # Errors
    /// If the agent that holds the key signs nothing.
    pub fn sign(&self, mut approval: Approval) -> Result<SignedApproval, ApprovalError> {
        approval.who.clone_from(&self.info.name);
        approval.role = self.info.role;
        let signature = self.raw(&approval.bytes())?;
        Ok(SignedApproval::new(approval, self.info.public_key, signature))
    }

    /// Signs a request. Its `who` and `role` are replaced by this identity's.
    ///
    /// # Errors
    /// If the agent that holds the key signs nothing.
    pub fn sign_call(&self, claim: CallClaim) -> Result<SignedCall, ApprovalError> {
        SignedCall::by(self, claim)
    }

    /// Its signature over a digest, as hexadecimal digits.
    pub(super) fn signature(&self, digest: &Digest) -> Result<String, ApprovalError> {
        Ok(hex(&self.raw(digest.bytes())?.to_bytes()))
    }

    fn raw(&self, bytes: &[u8]) -> Result<Signature, ApprovalError> {
        match &self.secret {
            Secret::Here(secret) => Ok(secret.sign(bytes)),
            Secret::Agent(agent) => Ok(agent.sign(&self.info.public_key, bytes)?),
        }
    }
}

/// The names that have a public file.
fn names_in(folder: &Path) -> Result<Vec<String>, IdentityError> {
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
    Ok(names)
}

/// The note beside the key file that an agent holds the key.
fn agent_file(secret_path: &Path) -> PathBuf {
    secret_path.with_extension("agent")
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
    use crate::{EncryptedKeyError, KdfCost};

    #[test]
    fn identities_are_created_listed_and_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        Identity::create(folder.path(), "bob", Role::Safety).unwrap();
        assert_eq!(Identity::load(folder.path(), "ada").unwrap().info(), ada.info());
        let names: Vec<_> =
            Identity::list(folder.path()).unwrap().known.into_iter().map(|info| info.name).collect();
        assert_eq!(names, ["ada", "bob"]);
        assert!(!format!("{ada:?}").contains("secret"));
    }

    fn passphrase(text: &str) -> Passphrase {
        Passphrase::new(text.to_owned().into()).unwrap()
    }

    #[test]
    fn a_passphrase_is_set_changed_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let (old, new) = (passphrase("under the oak"), passphrase("over the hill"));
        let open = |phrase: Option<&Passphrase>| Identity::open(folder, "ada").unwrap().unlock(phrase);
        let ada = Identity::create_encoded(
            folder,
            "ada",
            Role::Operator,
            KeyEncoding::Sealed(&old, KdfCost::LEAST),
        )
        .unwrap();
        assert_eq!(Identity::protection(folder, "ada").unwrap(), Protection::Passphrase);
        assert_eq!(open(Some(&old)).unwrap().info(), ada.info());
        let wrong = open(Some(&new)).unwrap_err();
        let IdentityError::Key(KeyError::Sealed { problem, .. }) = &wrong else { panic!("{wrong}") };
        assert_eq!(*problem, EncryptedKeyError::Passphrase);
        assert!(Identity::load(folder, "ada").unwrap_err().hint().unwrap().contains("--passphrase-file"));
        // The remains of an interrupted change do not block this one.
        std::fs::write(folder.join("ada.key.new"), "holdpoint-key 1\nkdf").unwrap();
        assert_eq!(open(Some(&old)).unwrap().info(), ada.info());
        open(Some(&old)).unwrap().rewrite_key(folder, KeyEncoding::Sealed(&new, KdfCost::LEAST)).unwrap();
        assert!(open(Some(&old)).is_err());
        open(Some(&new)).unwrap().rewrite_key(folder, KeyEncoding::Plain).unwrap();
        assert_eq!(Identity::protection(folder, "ada").unwrap(), Protection::None);
        assert!(matches!(open(Some(&new)), Err(IdentityError::Key(KeyError::Open { .. }))));
        assert_eq!(Identity::load(folder, "ada").unwrap().info(), ada.info());
        assert!(!folder.join("ada.key.new").exists());
        let mode = std::fs::metadata(folder.join("ada.key")).unwrap().permissions().mode();
        assert_eq!(mode & 0o7777, 0o600);
        std::fs::remove_file(folder.join("ada.key")).unwrap();
        assert_eq!(Identity::protection(folder, "ada").unwrap(), Protection::Elsewhere);
    }

    #[test]
    fn a_change_that_cannot_be_written_leaves_the_key_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        let before = std::fs::read(folder.path().join("ada.key")).unwrap();
        // The folder is read-only.
        std::fs::create_dir(folder.path().join("ada.key.new")).unwrap();
        let phrase = passphrase("under the oak");
        assert!(ada.rewrite_key(folder.path(), KeyEncoding::Sealed(&phrase, KdfCost::LEAST)).is_err());
        assert_eq!(std::fs::read(folder.path().join("ada.key")).unwrap(), before);
    }

    #[test]
    fn second_identity_with_one_key_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let ada = Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        let Secret::Here(again) = &ada.secret else { panic!("it is here") };
        let again = SigningKey::from_bytes(&again.to_bytes());
        let error =
            Identity::create_with(folder.path(), "eve", Role::Safety, again, KeyEncoding::Plain).unwrap_err();
        assert!(matches!(&error, IdentityError::KeyTaken { other, .. } if other == "ada"), "{error}");
        assert!(!folder.path().join("eve.key").exists());
        // Older stores may have it under two names, one of them with a role that no longer exists.
        keyfile::write_public(&folder.path().join("eve.pub"), &ada.info().public_key, "boss").unwrap();
        assert_eq!(Identity::names_of(folder.path(), &ada.info().public_key).unwrap(), ["ada", "eve"]);
    }

    #[test]
    fn invalid_names_and_readable_keys_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        Identity::create(folder.path(), "ada", Role::Operator).unwrap();
        let created = |name: &str| Identity::create(folder.path(), name, Role::Operator);
        assert!(matches!(created("ada"), Err(IdentityError::Exists(_))));
        for name in ["../eve", "", "Eve"] {
            assert!(matches!(created(name), Err(IdentityError::Name(_))), "{name}");
        }
        assert!(matches!(Identity::load(folder.path(), "nobody"), Err(IdentityError::Unknown { .. })));
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
        // A pipe is refused without waiting.
        std::fs::remove_file(folder.path().join("ada.pub")).unwrap();
        let (kind, mode) = (rustix::fs::FileType::Fifo, rustix::fs::Mode::RUSR);
        rustix::fs::mknodat(rustix::fs::CWD, folder.path().join("ada.pub"), kind, mode, 0).unwrap();
        assert!(Identity::list(folder.path()).is_err());
    }
}
