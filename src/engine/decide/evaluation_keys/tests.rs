//! Secret seeds of whole evaluations: committed to before, the same after an interruption, revealed at the end.

use std::path::Path;

use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_store::AuditFilter;

use super::key_check::{KeyCheck, check_keys};
use super::*;
use crate::decide::pipeline::{Pipeline, SliceOutcome};
use crate::decide::stages::activation::tests::package;
use crate::live::fake_cell::StubFactory;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::{pipeline_of, settings_in};
use holdpoint_record::wall_clock::WallClock;
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::Cell;

/// In a scripted cell.
fn pipeline(folder: &Path) -> Pipeline {
    pipeline_in(StubFactory::exporting().into_cell(), folder)
}

fn pipeline_in(cell: Cell, folder: &Path) -> Pipeline {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = 40;
    profile.evaluation.drills_per_kind = 10;
    let settings = settings_in(cell, profile, EpisodeSeeds::Secret);
    pipeline_of(folder, settings, |newest| WallClock::scripted(0, newest))
}

fn register(pipeline: &mut Pipeline, name: &str) -> CapabilityId {
    let command = Command::Register { package: package(name, &[]), name: name.to_owned(), by: None };
    let reply = pipeline.command(command);
    let Reply::Accepted { version: Some(id), .. } = reply else { panic!("{reply:?}") };
    id
}

/// Runs slices until the candidate has this many pairs; the seeds of them.
fn seeds_of(pipeline: &mut Pipeline, id: &CapabilityId, pairs: usize) -> Vec<u64> {
    for _ in 0..3_000 {
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
        assert_eq!(pipeline.record().holding(), None);
        let live = pipeline.live();
        let found = live.evidence_files.of(id).map(|file| &file.pairs).filter(|found| found.len() >= pairs);
        if let Some(found) = found {
            return found.iter().map(|pair| pair.seed).collect();
        }
    }
    panic!("{id} has no {pairs} pairs");
}

/// The records of keys, in order.
fn key_records(pipeline: &Pipeline) -> Vec<AuditRecord> {
    let views = pipeline.record().version_table().store().views().unwrap();
    let all = views.audit(&AuditFilter { limit: 10_000, ..AuditFilter::default() }).unwrap();
    let is_of_keys = |record: &AuditRecord| {
        record.kind == RecordKind::KeyCommitted || record.kind == RecordKind::KeyRevealed
    };
    all.into_iter().filter(is_of_keys).collect()
}

fn checked(pipeline: &Pipeline) -> KeyCheck {
    check_keys(&*pipeline.record().version_table().store().views().unwrap()).unwrap().unwrap()
}

/// Neither a kill nor a restart gives a candidate other seeds; another store has others.
#[test]
fn interrupted_evaluation_continues_with_its_key() {
    let folders = [quick_folder(), quick_folder()];
    let mut first = pipeline(folders[0].path());
    let id = register(&mut first, "grasp-improved");
    let before = seeds_of(&mut first, &id, 20);
    drop(first);
    let mut again = pipeline(folders[0].path());
    let after = seeds_of(&mut again, &id, 20);
    assert_eq!(before, after);
    let of_version = |record: &AuditRecord| record.subject == id.to_string();
    assert_eq!(key_records(&again).into_iter().filter(of_version).count(), 1);

    let mut other = pipeline(folders[1].path());
    let id = register(&mut other, "grasp-improved");
    let elsewhere = seeds_of(&mut other, &id, 20);
    assert!(before.iter().all(|seed| !elsewhere.contains(seed)));
}

/// A person who demotes a candidate and repeats its sandbox gets other episodes, and that counts as another try.
#[test]
fn a_sandbox_that_is_repeated_on_other_episodes_is_another_try() {
    let folder = quick_folder();
    let mut pipeline = pipeline(folder.path());
    let id = register(&mut pipeline, "grasp-improved");
    let before = seeds_of(&mut pipeline, &id, 20);
    let operation =
        Operation { version: id.clone(), by: "ada".to_owned(), reason: "a second draw".to_owned() };
    let demote = Command::Demote { operation: operation.clone(), profiles: Vec::new() };
    assert!(matches!(pipeline.command(demote), Reply::Accepted { .. }));
    assert_eq!(pipeline.advance(), SliceOutcome::Ran);
    let repeat = Command::Repeat { operation, stage: Stage::Sandbox };
    assert!(matches!(pipeline.command(repeat), Reply::Accepted { .. }));
    let numbers = |pipeline: &Pipeline| -> Vec<u32> {
        let tries = pipeline.record().version_table().tries(&id.family).unwrap();
        tries.open().iter().map(|(_, counted)| counted.by_author).collect()
    };
    for _ in 0..3_000 {
        if numbers(&pipeline).len() > 1 {
            break;
        }
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
    }
    assert_eq!(numbers(&pipeline), [1, 2]);
    let after = seeds_of(&mut pipeline, &id, 20);
    assert!(before.iter().all(|seed| !after.contains(seed)));
}

#[test]
fn key_is_committed_before_the_first_pair_and_revealed_after_the_last() {
    let folder = quick_folder();
    let mut pipeline = pipeline_in(Cell::of(&SimCells, None).unwrap(), folder.path());
    let id = register(&mut pipeline, "grasp-improved");
    let early = seeds_of(&mut pipeline, &id, 20);
    let [.., committed] = &key_records(&pipeline)[..] else { panic!("no key is on record") };
    assert_eq!((committed.subject.as_str(), checked(&pipeline).revealed), (id.to_string().as_str(), 0));
    // The sandbox ends, and the version enters shadow.
    let seeds = seeds_of(&mut pipeline, &id, 40);
    assert_eq!(early, seeds[..20]);
    let is_revealed =
        |record: &AuditRecord| record.kind == RecordKind::KeyRevealed && record.subject == id.to_string();
    let state = |pipeline: &Pipeline| pipeline.record().version_table().version(&id).unwrap().1.state;
    for _ in 0..3_000 {
        // The records are read only where the sandbox is over.
        if state(&pipeline) != State::Validated && key_records(&pipeline).iter().any(is_revealed) {
            break;
        }
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
    }
    let reveal = key_records(&pipeline).into_iter().find(is_revealed).expect("it is revealed");
    let reveal: KeyReveal = read(&reveal).unwrap();
    assert!(reveal.is_sound());
    let given: Vec<u64> = (0..200)
        .map(|index| {
            SeedSource::Keyed(reveal.key).seed(holdpoint_trials::seeds::SeedPurpose::Perturbation, index)
        })
        .collect();
    assert!(seeds.iter().all(|seed| given.contains(seed)), "the key gives the seeds again");
    let found = checked(&pipeline);
    assert_eq!((found.follow, found.pending, found.replaced), (1, 0, 0));
}

/// A version that people reject in the middle leaves no secret behind.
#[test]
fn key_of_a_rejected_version_is_revealed() {
    let folder = quick_folder();
    let mut pipeline = pipeline(folder.path());
    let id = register(&mut pipeline, "grasp-improved");
    seeds_of(&mut pipeline, &id, 20);
    let operation = Operation { version: id.clone(), by: "ada".to_owned(), reason: "a test".to_owned() };
    assert!(matches!(pipeline.command(Command::Reject(operation)), Reply::Accepted { .. }));
    pipeline.advance();
    let revealed =
        |record: &AuditRecord| record.kind == RecordKind::KeyRevealed && record.subject == id.to_string();
    assert_eq!(key_records(&pipeline).into_iter().filter(revealed).count(), 1);
}

#[test]
fn live_seeds_rotate_and_are_revealed_one_rotation_later() {
    let folder = quick_folder();
    let mut pipeline = pipeline(folder.path());
    let live = pipeline.live();
    let mut sources = Vec::new();
    for _ in 0..=LIVE_KEY_SEQUENCES * 2 {
        let source = live.record.live_seeds().unwrap();
        if sources.last() != Some(&source) {
            sources.push(source);
        }
    }
    assert_eq!(sources.len(), 3);
    let kinds: Vec<bool> =
        key_records(&pipeline).iter().map(|record| record.kind == RecordKind::KeyCommitted).collect();
    assert_eq!(kinds, [true, true, false, true], "the first is revealed as the third begins");
    drop(pipeline);
    // After a restart the live world goes on under a key of its own.
    let mut pipeline = self::pipeline(folder.path());
    let next = pipeline.live().record.live_seeds().unwrap();
    assert!(!sources.contains(&next));
}
