//! The quick check of a store's key files.

use std::fs;
use std::path::{Path, PathBuf};

use holdpoint_governance::store_finding::StoreFinding;
use holdpoint_registry::check_store;

use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;

#[test]
fn quick_check_finds_every_invalid_key_file() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = quick_folder();
    make_full_store(folder.path());
    let keys = folder.path().join("keys");
    let of = |name: &str| keys.join("identities").join(name);
    type KeyFileDamage<'a> = Box<dyn Fn() + 'a>;
    let empty = |path: PathBuf| Box::new(move || fs::write(&path, "").unwrap()) as KeyFileDamage<'_>;
    let gone = |path: PathBuf| Box::new(move || fs::remove_file(&path).unwrap()) as KeyFileDamage<'_>;
    let mode = |path: PathBuf, mode: u32| {
        Box::new(move || fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap())
            as KeyFileDamage<'_>
    };
    let link = |path: PathBuf| {
        Box::new(move || {
            fs::remove_file(&path).unwrap();
            symlink("/dev/zero", &path).unwrap();
        }) as KeyFileDamage<'_>
    };
    let copied = |from: PathBuf, to: PathBuf| {
        Box::new(move || assert!(fs::copy(&from, &to).unwrap() > 0)) as KeyFileDamage<'_>
    };
    let cases: Vec<(&str, KeyFileDamage<'_>)> = vec![
        ("no store.key", gone(keys.join("store.key"))),
        ("empty store.key", empty(keys.join("store.key"))),
        ("link store.key", link(keys.join("store.key"))),
        ("open store.key", mode(keys.join("store.key"), 0o640)),
        ("empty store.pub", empty(keys.join("store.pub"))),
        ("another's store.pub", copied(of("ada.pub"), keys.join("store.pub"))),
        ("open folder", mode(keys.join("identities"), 0o770)),
        ("no ada.pub", gone(of("ada.pub"))),
        ("empty ada.key", empty(of("ada.key"))),
        ("link ada.key", link(of("ada.key"))),
        ("open ada.key", mode(of("ada.key"), 0o604)),
        ("other ada.pub", copied(of("ben.pub"), of("ada.pub"))),
        ("two halves", copied(of("ben.key"), of("ada.key"))),
        ("not enrolled", copied(of("ben.pub"), of("eve.pub"))),
        ("left over", copied(of("ben.key"), of("ben.key.new"))),
    ];
    for (name, damage) in cases {
        let backup_folder = quick_folder();
        let saved = backup_folder.path().join("keys");
        copy_keys(&keys, &saved);
        assert!(check_store(folder.path()).unwrap().iter().all(StoreFinding::is_good), "before {name}");
        damage();
        let found = check_store(folder.path()).unwrap();
        let is_found = |one: &StoreFinding| !one.is_good() && is_expected(name, one);
        assert!(found.iter().any(is_found), "{name}: {found:#?}");
        fs::set_permissions(keys.join("identities"), fs::Permissions::from_mode(0o700)).unwrap();
        fs::remove_dir_all(&keys).unwrap();
        copy_keys(&saved, &keys);
    }
}

/// Whether a finding is the one that a damage has to cause, with the file that it names.
fn is_expected(damage: &str, found: &StoreFinding) -> bool {
    match (damage, found) {
        ("no store.key" | "empty store.key", StoreFinding::UnusableSecretKey { problem }) => {
            problem.contains("store.key")
        }
        ("link store.key", StoreFinding::UnusableSecretKey { problem }) => {
            problem.contains("store.key") && problem.contains("link")
        }
        ("open store.key", StoreFinding::OpenSecretKey { problem }) => {
            problem.contains("0640") && problem.contains("chmod 600")
        }
        ("empty store.pub", StoreFinding::UnusablePublicKey { problem }) => problem.contains("store.pub"),
        ("another's store.pub", StoreFinding::OtherStoreKey { public, secret }) => {
            public.ends_with("store.pub") && secret.ends_with("store.key")
        }
        ("open folder", StoreFinding::OpenKeyFolder { folder, mode }) => {
            folder.ends_with("identities") && *mode == 0o770
        }
        ("no ada.pub", StoreFinding::UnusablePersonKey { name, problem }) => {
            name == "ada" && problem.contains("ada.pub")
        }
        ("empty ada.key", StoreFinding::BadPersonKey { name, problem }) => {
            name == "ada" && problem.contains("ada.key")
        }
        ("link ada.key", StoreFinding::BadPersonKey { name, problem }) => {
            name == "ada" && problem.contains("ada.key") && problem.contains("link")
        }
        ("open ada.key", StoreFinding::BadPersonKey { problem, .. }) => {
            problem.contains("ada.key") && problem.contains("0604") && problem.contains("chmod 600")
        }
        ("other ada.pub", StoreFinding::OtherEnrolledKey { name, .. }) => name == "ada",
        ("two halves", StoreFinding::OtherPersonKey { key, public }) => {
            key.ends_with("ada.key") && public.ends_with("ada.pub")
        }
        ("not enrolled", StoreFinding::NotEnrolled { key, name, administrator }) => {
            key.ends_with("eve.pub") && name == "eve" && administrator == "admin"
        }
        ("left over", StoreFinding::UnfinishedKey { path }) => path.ends_with("ben.key.new"),
        _ => false,
    }
}

/// A folder of keys with its modes.
fn copy_keys(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let to = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy_keys(&path, &to);
        } else {
            fs::copy(&path, &to).unwrap();
        }
    }
}
