//! Proofs of the chain that are checked without the store.

use std::fs;
use std::path::{Path, PathBuf};

use ed25519_dalek::VerifyingKey;
use holdpoint_approvals::keyfile;
use holdpoint_audit::checkpoint::Checkpoint;
use holdpoint_audit::proof::{Proof, ProofError, ProofFault};
use holdpoint_registry::{ProveError, Store, prove_consistency, prove_record, stored_head, verify};
use holdpoint_store::RefusalCause;

use crate::edits::make_full_store;
use crate::quick_folder::quick_folder;
use crate::released::schema_1;
use crate::support::*;

pub fn public_key(folder: &Path) -> VerifyingKey {
    keyfile::read_public(&folder.join("keys").join("store.pub")).unwrap().0
}

/// The checkpoints beside a store, oldest first.
pub fn heads(folder: &Path) -> Vec<(PathBuf, Checkpoint)> {
    let all = fs::read_dir(folder.join("checkpoints")).unwrap().map(|entry| entry.unwrap().path());
    let mut all: Vec<_> = all.filter(|path| path.extension().is_some_and(|it| it == "json")).collect();
    all.sort();
    all.into_iter().map(|path| (path.clone(), Checkpoint::read(&path).unwrap())).collect()
}

/// Why there is no proof.
fn fault<T: std::fmt::Debug>(result: Result<T, ProveError>) -> ProofFault {
    match result.unwrap_err() {
        ProveError::Impossible(fault) => fault,
        other @ ProveError::Unreadable(_) => panic!("{other}"),
    }
}

/// Every byte of a proof, changed in several ways, makes it invalid or false.
fn every_byte_counts(proof: &Proof, key: &VerifyingKey) {
    let text = proof.text().unwrap();
    let holds = |text: &str| Proof::parse(text).is_ok_and(|proof| proof.check(key).is_ok());
    assert!(holds(&text) && !holds(&format!("{text}\n")));
    for at in 0..text.len() {
        for flip in [1, 2, 4, 0x20, 0x40] {
            let mut bytes = text.clone().into_bytes();
            bytes[at] ^= flip;
            let Ok(edited) = String::from_utf8(bytes) else { continue };
            assert!(!holds(&edited), "byte {at}: {edited}");
        }
        let mut cut = text.clone();
        cut.remove(at);
        assert!(!holds(&cut), "without byte {at}: {cut}");
        let mut longer = text.clone();
        longer.insert(at, ' ');
        assert!(!holds(&longer), "with a space at {at}");
    }
}

#[test]
fn every_record_has_a_proof_that_needs_no_store() {
    let (folder, other) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    make_full_store(other.path());
    let (database, key) = (folder.path().join("holdpoint.db"), public_key(folder.path()));
    let records = verify(&database, Some(&key)).unwrap().records;
    assert!(records > 20, "{records}");
    for seq in 1..=records {
        let proof = prove_record(&database, seq).unwrap();
        proof.check(&key).unwrap();
        proof.check(&public_key(other.path())).unwrap_err();
        let Proof::Inclusion { record, path, head, .. } = &proof else { panic!("{proof:?}") };
        assert!(record.seq == seq && head.seq == records && path.len() <= 8, "{proof:?}");
    }
    every_byte_counts(&prove_record(&database, 7).unwrap(), &key);
    for missing in [0, records + 1, u64::MAX >> 1] {
        let expected = ProofFault::NoRecord { seq: missing, end: records };
        assert_eq!(fault(prove_record(&database, missing)), expected);
    }
    // A record with the path of another record.
    let (one, two) = (prove_record(&database, 3).unwrap(), prove_record(&database, 4).unwrap());
    let (Proof::Inclusion { record, head, .. }, Proof::Inclusion { path, .. }) = (one, two) else { panic!() };
    let mixed = Proof::Inclusion { version: 1, record, path, head };
    let error = mixed.check(&key).unwrap_err();
    assert!(matches!(&error, ProofError::Wrong(problem) if problem.contains("record 3 ")), "{error}");
}

#[test]
fn consistency_proofs_hold_for_each_checkpoint() {
    let (folder, other) = (quick_folder(), quick_folder());
    make_full_store(folder.path());
    make_full_store(other.path());
    let (database, key) = (folder.path().join("holdpoint.db"), public_key(folder.path()));
    let checkpoints = heads(folder.path());
    assert!(checkpoints.len() >= 3);
    for (_, head) in &checkpoints {
        assert_eq!(stored_head(folder.path(), head.seq).unwrap(), *head);
        let proof = prove_consistency(&database, head).unwrap();
        proof.check(&key).unwrap();
        assert_eq!(proof.heads()[0], head);
    }
    every_byte_counts(&prove_consistency(&database, &checkpoints[0].1).unwrap(), &key);
    let first = checkpoints[0].1.seq;
    let found = fault(stored_head(folder.path(), first + 1));
    assert!(matches!(&found, ProofFault::NoHead { near, .. } if near[0] == first), "{found}");
    let theirs = &heads(other.path())[0].1;
    assert_eq!(fault(prove_consistency(&database, theirs)), ProofFault::OtherStore(theirs.store_id.clone()));
    // Restored to an earlier state, and continued differently.
    let before = fs::read(&database).unwrap();
    let store = open(folder.path());
    shadowed(&store, "place@1.2.0");
    drop(store);
    let (_, later) = heads(folder.path()).pop().unwrap();
    fs::write(&database, &before).unwrap();
    let found = fault(prove_consistency(&database, &later));
    assert!(matches!(found, ProofFault::CutOff { seq, .. } if seq == later.seq), "{found}");
    fs::remove_file(folder.path().join("checkpoints").join(format!("{:012}.json", later.seq))).unwrap();
    let store = open(folder.path());
    shadowed(&store, "place@1.3.0");
    shadowed(&store, "place@1.4.0");
    drop(store);
    assert_eq!(fault(prove_consistency(&database, &later)), ProofFault::Rewritten);
}

#[test]
fn store_of_an_earlier_version_has_no_proof_before_its_tree_is_signed() {
    let folder = quick_folder();
    let store = schema_1(folder.path());
    let database = store.join("holdpoint.db");
    assert_eq!(fault(prove_record(&database, 1)), ProofFault::EndWithoutTree);
    let (_, earlier) = heads(&store).pop().unwrap();
    drop(open(&store));
    let proof = prove_record(&database, 1).unwrap();
    proof.check(&public_key(&store)).unwrap();
    assert!(proof.text().unwrap().len() < 64 << 10);
    assert_eq!(fault(prove_consistency(&database, &earlier)), ProofFault::HeadWithoutTree);
    // That end names the checkpoints before it: each is expected from then on.
    for (file, _) in heads(&store) {
        let text = fs::read(&file).unwrap();
        fs::remove_file(&file).unwrap();
        let error = unless_in_use(|| Store::open(&store)).map(drop).unwrap_err();
        assert_eq!(refusal(&error).0, RefusalCause::Unsigned, "{error}");
        verify(&database, None).unwrap_err();
        fs::write(&file, text).unwrap();
    }
    drop(open(&store));
}

#[test]
fn records_behind_a_checkpoint_of_an_earlier_version_cannot_be_forged() {
    let folder = quick_folder();
    let store = schema_1(folder.path());
    let checkpoints = heads(&store);
    // Cut back to an unlinked checkpoint, with the records after it left unsigned.
    let (newest, _) = checkpoints.last().unwrap();
    fs::remove_file(newest).unwrap();
    let error = unless_in_use(|| Store::open(&store)).map(drop).unwrap_err();
    let (cause, problem) = refusal(&error);
    let signed_to = format!(" {}", heads(&store).pop().unwrap().1.seq);
    assert!(cause == RefusalCause::Unsigned && problem.ends_with(&signed_to), "{error}");
    verify(&store.join("holdpoint.db"), None).unwrap_err();
}
