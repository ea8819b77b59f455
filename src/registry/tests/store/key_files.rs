//! The quick check of a store's key files.

use std::fs;
use std::path::{Path, PathBuf};

use holdpoint_registry::check_store;

use crate::edits::{make_full_store, quick_folder};

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
    let cases: Vec<(&str, KeyFileDamage<'_>, &[&str])> = vec![
        ("no store.key", gone(keys.join("store.key")), &["store.key", "put it back from a backup"]),
        ("empty store.key", empty(keys.join("store.key")), &["store.key", "is not a key"]),
        ("link", link(keys.join("store.key")), &["store.key", "is a link", "put it back"]),
        ("open store.key", mode(keys.join("store.key"), 0o640), &["mode 0640", "chmod 600"]),
        ("empty store.pub", empty(keys.join("store.pub")), &["store.pub", "public key cannot be"]),
        ("another's store.pub", copied(of("ada.pub"), keys.join("store.pub")), &["does not belong to"]),
        ("open folder", mode(keys.join("identities"), 0o770), &["identities", "chmod 700"]),
        ("no ada.pub", gone(of("ada.pub")), &["public key of ada cannot be used", "ada.pub"]),
        ("empty ada.key", empty(of("ada.key")), &["The key of ada", "ada.key"]),
        ("link ada.key", link(of("ada.key")), &["ada.key", "is a link", "its place"]),
        ("open ada.key", mode(of("ada.key"), 0o604), &["ada.key", "mode 0604", "chmod 600"]),
        (
            "other ada.pub",
            copied(of("ben.pub"), of("ada.pub")),
            &["is not the key that ada is enrolled with"],
        ),
        ("two halves", copied(of("ben.key"), of("ada.key")), &["ada.pub", "do not belong together"]),
        (
            "not enrolled",
            copied(of("ben.pub"), of("eve.pub")),
            &["eve.pub", "identity enroll eve --by admin"],
        ),
        ("left over", copied(of("ben.key"), of("ben.key.new")), &["ben.key.new", "remove it"]),
    ];
    for (name, damage, expected) in cases {
        let backup_folder = quick_folder();
        let saved = backup_folder.path().join("keys");
        copy_keys(&keys, &saved);
        assert!(check_store(folder.path()).unwrap().iter().all(|looked| looked.good), "before {name}");
        damage();
        let found = check_store(folder.path()).unwrap();
        let bad: Vec<_> = found.into_iter().filter(|looked| !looked.good).map(|looked| looked.text).collect();
        let all = bad.join("\n");
        for part in expected {
            assert!(all.contains(part), "{name}: {part:?} is not in {all}");
        }
        fs::set_permissions(keys.join("identities"), fs::Permissions::from_mode(0o700)).unwrap();
        fs::remove_dir_all(&keys).unwrap();
        copy_keys(&saved, &keys);
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
