//! The decisions of a store with secret keys are made again from a copy without its secret, and a changed result is named.

use std::path::Path;

use rusqlite::Connection;
use serde_json::Value;

use crate::decide::pipeline::{Pipeline, SliceOutcome};
use crate::decide::stages::activation::tests::package;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::seeded_pipeline;
use holdpoint_explain::store_metrics::RulesInForce;
use holdpoint_explain::store_metrics::rerun::{RerunSettings, StoreRerun, rerun};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::metrics::store_metrics::{NotReplayable, ReplayOutcome};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_protocol::command::{Command, Reply};
use holdpoint_record::wall_clock::WallClock;
use holdpoint_registry::{BackupParts, Views, backup};
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

/// The slices within which a sandbox must end.
const SLICES_MAX: usize = 20_000;

/// The profile `sim` with budgets that run in seconds.
fn small() -> Profile {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = 40;
    // So wide that every try takes these pairs.
    profile.tries.margin = 0.5;
    profile.evaluation.drills_per_kind = 10;
    profile
}

/// Registers a candidate, and runs it until its sandbox is decided.
fn decided(pipeline: &mut Pipeline, name: &str) -> (CapabilityId, State) {
    let command = Command::Register { package: package(name, &[]), name: name.to_owned(), by: None };
    let Reply::Accepted { version: Some(id), .. } = pipeline.command(command) else { panic!("{name}") };
    for _ in 0..SLICES_MAX {
        let state = pipeline.record().version_table().version(&id).unwrap().1.state;
        if !matches!(state, State::Registered | State::Validated) {
            return (id, state);
        }
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
        assert_eq!(pipeline.record().holding(), None);
    }
    panic!("the sandbox of {id} does not end");
}

/// Makes the decisions of a store again, with at most `most` evaluations, in this cell or as if in another one.
fn made_again(folder: &Path, most: u64, environment: Option<Digest>) -> StoreRerun {
    let views = Views::open(&folder.join("holdpoint.db")).unwrap();
    let cell = Cell::of(&SimCells, None).unwrap();
    let settings = RerunSettings {
        environment: environment.unwrap_or_else(|| cell.digest()),
        cell,
        frames: vec![RulesInForce::of(small()).unwrap()],
        jobs: 2,
        most,
        tell: &|_, _, _| {},
    };
    rerun(&views, settings).unwrap()
}

/// The causes for which decisions were not made again.
fn causes(of: &StoreRerun) -> Vec<NotReplayable> {
    let cause = |replay: &ReplayOutcome| match replay {
        ReplayOutcome::NotReplayed { why } => Some(*why),
        ReplayOutcome::Equal | ReplayOutcome::Differs { .. } => None,
    };
    of.decisions.iter().filter_map(|decision| cause(&decision.replay)).collect()
}

#[test]
fn decisions_of_secret_keys_are_made_again_elsewhere_and_a_flipped_result_is_named() {
    let [store, elsewhere] = [(); 2].map(|()| quick_folder());
    let copy = elsewhere.path().join("copy");
    let wall = |newest| WallClock::scripted(0, newest);
    let mut pipeline = seeded_pipeline(store.path(), small(), EpisodeSeeds::Secret, wall);
    let (rejected, state) = decided(&mut pipeline, "align-no-stop");
    assert_eq!(state, State::Rejected);
    // Its seeds are new in each run of this test, so chance can put it on hold or reject it.
    let (improved, _) = decided(&mut pipeline, "align-improved");
    drop(pipeline);
    backup(store.path(), &copy, BackupParts { keys: false, recordings: None }).unwrap();
    store.close().unwrap();

    let again = made_again(&copy, u64::MAX, None);
    assert!(again.is_equal(), "{:?}", again.decisions);
    let runs: Vec<(&CapabilityId, bool)> =
        again.decisions.iter().map(|decision| (&decision.version, decision.runs > 0)).collect();
    // Each has a decision of its validation, without an episode, and one of its sandbox.
    assert_eq!(runs, [(&rejected, false), (&rejected, true), (&improved, false), (&improved, true)]);
    assert_eq!(again.evaluations, 2);

    // What cannot be run says why; nothing is taken for the same.
    let limited = made_again(&copy, 0, None);
    assert_eq!(causes(&limited), [NotReplayable::BeyondLimit; 2], "{:?}", limited.decisions);
    let other_cell = Digest::of_parts("test", &[b"another cell"]);
    let other_cell = made_again(&copy, u64::MAX, Some(other_cell));
    assert_eq!(causes(&other_cell), [NotReplayable::OtherCell; 2], "{:?}", other_cell.decisions);
    assert_eq!((limited.evaluations, other_cell.evaluations), (0, 0));

    let seed = flip_success(&copy, 3);
    let found = made_again(&copy, 1, None);
    assert_eq!(causes(&found), [NotReplayable::BeyondLimit], "the other evaluation was not asked for");
    let different = found.decisions.iter().filter_map(|decision| match &decision.replay {
        ReplayOutcome::Differs { what } => Some((&decision.version, what.as_str())),
        ReplayOutcome::Equal | ReplayOutcome::NotReplayed { .. } => None,
    });
    let different: Vec<(&CapabilityId, &str)> = different.collect();
    let [(version, what)] = different[..] else { panic!("{different:?}") };
    assert_eq!(*version, rejected);
    assert!(what.starts_with(&format!("pair 4 (seed {seed}).candidate.success is ")), "{what}");
}

/// Flips the recorded success of the candidate in a pair of the first sandbox. Returns the pair's seed.
fn flip_success(folder: &Path, place: usize) -> u64 {
    let connection = Connection::open(folder.join("holdpoint.db")).unwrap();
    let read = "SELECT seq, json FROM evidence WHERE kind = 'sandbox' ORDER BY seq LIMIT 1";
    let (seq, json): (u64, String) =
        connection.query_row(read, [], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    let mut evidence: Value = serde_json::from_str(&json).unwrap();
    let pair = &mut evidence["pairs"][place];
    let success = pair["candidate"]["success"].as_bool().unwrap();
    pair["candidate"]["success"] = (!success).into();
    let seed = pair["seed"].as_u64().unwrap();
    let write = "UPDATE evidence SET json = ?1 WHERE seq = ?2";
    assert_eq!(connection.execute(write, (evidence.to_string(), seq)).unwrap(), 1);
    seed
}
