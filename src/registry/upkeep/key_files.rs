//! The key files of a store: which are missing, readable by others, or different from the enrolled key.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use holdpoint_approvals::keyfile::{self, KeyError, Protection};
use holdpoint_approvals::{Identity, IdentityError, Person, PersonDirectory, PersonState};
use holdpoint_governance::store_finding::StoreFinding;
use holdpoint_store::{FIRST_ADMINISTRATOR, Layout};
use holdpoint_text::Hint;
use holdpoint_text::hex::hex;

/// Endings of the files that an identity has.
const ENDINGS: [&str; 3] = ["key", "pub", "agent"];
/// Endings that a file has while it is written.
const UNFINISHED: [&str; 2] = ["part", "new"];
/// The most files read: some for each of the most persons.
const FILES_MAX: usize = 4_000;

/// Checks every key file. Reads secrets, and neither stores nor reports them.
pub(crate) fn check_key_files(layout: &Layout, persons: &PersonDirectory) -> Vec<StoreFinding> {
    let mut found = Vec::new();
    for folder in [layout.keys(), layout.identities()] {
        found.extend(open_folder(&folder));
    }
    found.push(store_keys(layout));
    match names(&layout.identities()) {
        Err(problem) => found.push(problem),
        Ok((names, unfinished)) => {
            found.extend(unfinished);
            let before = found.len();
            for name in &names {
                found.extend(look_at(&layout.identities(), name, persons));
            }
            if found.len() == before {
                found.push(StoreFinding::KeyFiles { names: names.len() });
            }
        }
    }
    found
}

/// A folder in which other users could put keys.
fn open_folder(folder: &Path) -> Option<StoreFinding> {
    let mode = fs::metadata(folder).ok()?.permissions().mode() & 0o7777;
    (mode & 0o022 != 0).then(|| StoreFinding::OpenKeyFolder { folder: folder.to_owned(), mode })
}

fn store_keys(layout: &Layout) -> StoreFinding {
    let (secret_path, public_path) = (layout.store_key(), layout.store_public_key());
    let secret = match keyfile::read_secret(&secret_path) {
        Ok(secret) => secret,
        Err(error @ KeyError::Permissions { .. }) => {
            return StoreFinding::OpenSecretKey { problem: sentence(&error) };
        }
        Err(error) => return StoreFinding::UnusableSecretKey { problem: error.to_string() },
    };
    match keyfile::read_public(&public_path) {
        Err(error) => StoreFinding::UnusablePublicKey { problem: error.to_string() },
        Ok((public, _)) if public != secret.verifying_key() => {
            StoreFinding::OtherStoreKey { public: public_path, secret: secret_path }
        }
        Ok(_) => StoreFinding::StoreKeys,
    }
}

/// The persons with files here, and incompletely written files.
fn names(folder: &Path) -> Result<(BTreeSet<String>, Vec<StoreFinding>), StoreFinding> {
    let (mut names, mut unfinished) = (BTreeSet::new(), Vec::new());
    let unlisted = |error: std::io::Error| StoreFinding::UnlistedKeyFolder {
        folder: folder.to_owned(),
        problem: error.to_string(),
    };
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok((names, unfinished)),
        entries => entries.map_err(unlisted)?,
    };
    for (number, entry) in entries.enumerate() {
        if number == FILES_MAX {
            return Err(StoreFinding::TooManyKeyFiles { folder: folder.to_owned(), most: FILES_MAX });
        }
        let path = entry.map_err(unlisted)?.path();
        let part = |part: Option<&std::ffi::OsStr>| {
            part.and_then(std::ffi::OsStr::to_str).unwrap_or_default().to_owned()
        };
        let ending = part(path.extension());
        if ENDINGS.contains(&ending.as_str()) {
            names.insert(part(path.file_stem()));
        } else if UNFINISHED.contains(&ending.as_str()) {
            unfinished.push(StoreFinding::UnfinishedKey { path });
        }
    }
    Ok((names, unfinished))
}

/// The problems of one person's files.
fn look_at(folder: &Path, name: &str, persons: &PersonDirectory) -> Vec<StoreFinding> {
    let file = |ending: &str| folder.join(format!("{name}.{ending}"));
    let (key, public) = (file("key"), file("pub"));
    let has_key = fs::symlink_metadata(&key).is_ok();
    let mut found = Vec::new();
    let protection = Identity::protection(folder, name);
    if let Err(error) = &protection {
        found.push(StoreFinding::BadPersonKey { name: name.to_owned(), problem: sentence(error) });
    }
    let known = match keyfile::read_public(&public) {
        Ok((known, _)) => Some(known),
        Err(error) => {
            found.push(StoreFinding::UnusablePersonKey { name: name.to_owned(), problem: error.to_string() });
            None
        }
    };
    let plain = matches!(protection, Ok(Protection::None)) && known.is_some();
    if plain && matches!(Identity::load(folder, name), Err(IdentityError::Mismatch(_))) {
        found.push(StoreFinding::OtherPersonKey { key: key.clone(), public: public.clone() });
    }
    match persons.named(name) {
        // No person was ever enrolled: an earlier version kept people in files alone.
        None if persons.is_empty() => {}
        None => {
            let admin =
                persons.administrators().next().map_or(FIRST_ADMINISTRATOR, |admin| admin.name.as_str());
            found.push(StoreFinding::NotEnrolled {
                key: if has_key { key } else { public },
                name: name.to_owned(),
                administrator: admin.to_owned(),
            });
        }
        Some(person) => found.extend(key_mismatch(person, known.as_ref(), &public)),
    }
    found
}

/// A person whose enrolled key differs from this file.
fn key_mismatch(
    person: &Person,
    known: Option<&ed25519_dalek::VerifyingKey>,
    public: &Path,
) -> Option<StoreFinding> {
    let other =
        person.state == PersonState::Enrolled && known.is_some_and(|known| *known != person.public_key);
    other.then(|| StoreFinding::OtherEnrolledKey {
        public: public.to_owned(),
        name: person.name.clone(),
        enrolled: hex(person.public_key.as_bytes()),
    })
}

/// An error with its remedy.
fn sentence(error: &impl Hint) -> String {
    match error.hint() {
        Some(hint) => format!("{error}; {hint}"),
        None => error.to_string(),
    }
}
