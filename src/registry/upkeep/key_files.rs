//! The key files of a store: which are missing, readable by others, or different from the enrolled key.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use crate::upkeep::info::{StoreCheck, bad, good};
use holdpoint_approvals::keyfile::{self, KeyError, Protection};
use holdpoint_approvals::{Identity, IdentityError, Person, PersonDirectory, PersonState};
use holdpoint_store::{FIRST_ADMINISTRATOR, Layout};
use holdpoint_text::Hint;

/// Endings of the files that an identity has.
const ENDINGS: [&str; 3] = ["key", "pub", "agent"];
/// Endings that a file has while it is written.
const UNFINISHED: [&str; 2] = ["part", "new"];
/// The most files read: some for each of the most persons.
const FILES_MAX: usize = 4_000;

const RESTORE: &str = "put it back from a backup of the folder keys; a store's key cannot be replaced";

/// Checks every key file. Reads secrets, and neither stores nor reports them.
pub(crate) fn check_key_files(layout: &Layout, persons: &PersonDirectory) -> Vec<StoreCheck> {
    let mut found = Vec::new();
    for folder in [layout.keys(), layout.identities()] {
        found.extend(open_folder(&folder));
    }
    found.push(store_keys(layout));
    match names(&layout.identities()) {
        Err(problem) => found.push(bad(problem)),
        Ok((names, unfinished)) => {
            found.extend(unfinished);
            let before = found.len();
            for name in &names {
                found.extend(look_at(&layout.identities(), name, persons));
            }
            if found.len() == before {
                found.push(good(format!("The key files of {} names are as they have to be.", names.len())));
            }
        }
    }
    found
}

/// A folder in which other users could put keys.
fn open_folder(folder: &Path) -> Option<StoreCheck> {
    let mode = fs::metadata(folder).ok()?.permissions().mode() & 0o7777;
    (mode & 0o022 != 0).then(|| {
        bad(format!(
            "Others may write into the folder {folder:?} (mode {mode:04o}); `chmod 700 {}` ends that.",
            folder.display()
        ))
    })
}

fn store_keys(layout: &Layout) -> StoreCheck {
    let (secret_path, public_path) = (layout.store_key(), layout.store_public_key());
    let secret = match keyfile::read_secret(&secret_path) {
        Ok(secret) => secret,
        Err(error @ KeyError::Permissions { .. }) => {
            return bad(format!("The store's secret key: {}.", sentence(&error)));
        }
        Err(error) => return bad(format!("The store's secret key cannot be used: {error}; {RESTORE}.")),
    };
    match keyfile::read_public(&public_path) {
        Err(error) => {
            bad(format!("The store's public key cannot be used: {error}; put it back from a backup."))
        }
        Ok((public, _)) if public != secret.verifying_key() => bad(format!(
            "{public_path:?} does not belong to {secret_path:?}; put back the two that belong together from a backup."
        )),
        Ok(_) => {
            good("The store's secret key is there, for its owner alone, and the public one belongs to it.")
        }
    }
}

/// The persons with files here, and incompletely written files.
fn names(folder: &Path) -> Result<(BTreeSet<String>, Vec<StoreCheck>), String> {
    let (mut names, mut unfinished) = (BTreeSet::new(), Vec::new());
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok((names, unfinished)),
        entries => entries.map_err(|error| format!("The folder {folder:?} cannot be listed: {error}."))?,
    };
    for (number, entry) in entries.enumerate() {
        if number == FILES_MAX {
            return Err(format!(
                "The folder {folder:?} holds more than {FILES_MAX} files; take away what is no key."
            ));
        }
        let path = entry.map_err(|error| format!("The folder {folder:?} cannot be listed: {error}."))?.path();
        let part = |part: Option<&std::ffi::OsStr>| {
            part.and_then(std::ffi::OsStr::to_str).unwrap_or_default().to_owned()
        };
        let ending = part(path.extension());
        if ENDINGS.contains(&ending.as_str()) {
            names.insert(part(path.file_stem()));
        } else if UNFINISHED.contains(&ending.as_str()) {
            unfinished.push(bad(format!(
                "{path:?} was not written to its end, and may hold a key; remove it, unless a key is just being written."
            )));
        }
    }
    Ok((names, unfinished))
}

/// The problems of one person's files.
fn look_at(folder: &Path, name: &str, persons: &PersonDirectory) -> Vec<StoreCheck> {
    let file = |ending: &str| folder.join(format!("{name}.{ending}"));
    let (key, public) = (file("key"), file("pub"));
    let has_key = fs::symlink_metadata(&key).is_ok();
    let mut found = Vec::new();
    let protection = Identity::protection(folder, name);
    if let Err(error) = &protection {
        found.push(bad(format!("The key of {name}: {}.", sentence(error))));
    }
    let known = match keyfile::read_public(&public) {
        Ok((known, _)) => Some(known),
        Err(error) => {
            found.push(bad(format!(
                "The public key of {name} cannot be used: {error}; put it back from a backup."
            )));
            None
        }
    };
    let plain = matches!(protection, Ok(Protection::None)) && known.is_some();
    if plain && matches!(Identity::load(folder, name), Err(IdentityError::Mismatch(_))) {
        found.push(bad(format!(
            "{key:?} and {public:?} do not belong together; put back the two that do from a backup."
        )));
    }
    match persons.named(name) {
        // No person was ever enrolled: an earlier version kept people in files alone.
        None if persons.is_empty() => {}
        None => {
            let admin =
                persons.administrators().next().map_or(FIRST_ADMINISTRATOR, |admin| admin.name.as_str());
            let path = if has_key { &key } else { &public };
            found.push(bad(format!(
                "The key {path:?} is not enrolled and decides nothing; `holdpoint identity enroll {name} --by {admin} \
                --reason TEXT` enrolls it, or remove it."
            )));
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
) -> Option<StoreCheck> {
    let other =
        person.state == PersonState::Enrolled && known.is_some_and(|known| *known != person.public_key);
    other.then(|| {
        bad(format!(
            "{public:?} is not the key that {} is enrolled with ({}); put back the files of that key from a backup, or \
             have {} revoked and another name enrolled.",
            person.name,
            keyfile::hex(person.public_key.as_bytes()),
            person.name
        ))
    })
}

/// An error with its remedy.
fn sentence(error: &impl Hint) -> String {
    match error.hint() {
        Some(hint) => format!("{error}; {hint}"),
        None => error.to_string(),
    }
}
