//! The prebuilt components match the stored digests one to one.
#![allow(clippy::unwrap_used, reason = "a test says what it expects by failing")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use holdpoint_builder::EncodeError;
use sha2::{Digest as _, Sha256};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk/prebuilt")
}

#[test]
fn the_digests_are_those_of_the_files() {
    let listed: BTreeMap<String, String> = fs::read_to_string(folder().join("SHA256SUMS"))
        .unwrap()
        .lines()
        .map(|line| line.split_once("  ").unwrap())
        .map(|(digest, name)| (name.to_owned(), digest.to_owned()))
        .collect();
    let actual: BTreeMap<String, String> = fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "wasm"))
        .map(|path| {
            let digest: String = Sha256::digest(fs::read(&path).unwrap())
                .iter()
                .fold(String::new(), |text, byte| format!("{text}{byte:02x}"));
            (path.file_name().unwrap().display().to_string(), digest)
        })
        .collect();
    assert_eq!(listed, actual);
    assert_eq!(listed.len(), 4);
}

#[test]
fn a_component_is_encoded_unchanged_and_others_rejected() {
    let component = fs::read(folder().join("template-c.wasm")).unwrap();
    assert_eq!(holdpoint_builder::encode(component.clone()).unwrap(), component);
    let other = holdpoint_builder::encode(b"\x7fELF\x02\x01\x01\x00".to_vec());
    assert!(matches!(other, Err(EncodeError::NotWasm)));
    // A module that exports nothing does not fit the contract.
    let module = holdpoint_builder::encode(b"\0asm\x01\0\0\0".to_vec());
    assert!(matches!(module, Err(EncodeError::Module(_))));
}
