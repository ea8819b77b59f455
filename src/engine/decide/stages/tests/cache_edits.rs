//! Cached episodes and drills that were edited, and a whole evaluation that meets them.

use std::path::Path;
use std::sync::OnceLock;

use holdpoint_governance::alarms::{Alarm, AlarmKey};
use holdpoint_governance::cached_result::{
    CacheLocation, CachedResultMismatch, CachedResultUse, RerunSampleCounts,
};
use holdpoint_governance::explanation::Consequence;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::Store;
use holdpoint_store::{AuditFilter, CacheSecret, ResultCache};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, EpisodeSeeds};
use rusqlite::Connection;
use tempfile::TempDir;

use crate::decide::pipeline::{Pipeline, PipelineSettings, SliceOutcome};
use crate::decide::stages::activation::tests::package;
use crate::folder_copy::FolderCopy;
use crate::quick_folder::quick_folder;
use crate::test_pipeline::{pipeline_of, settings};
use holdpoint_record::wall_clock::WallClock;

const PAIRS: u32 = 60;
const DRILLS: u32 = 10;

/// Whose sandbox keeps what the active version did: it works its whole budget.
const FIRST: &str = "grasp-improved";
/// The one of the attack: too much force, which a baseline that always fails would excuse.
const SECOND: &str = "grasp-hard-grip";

fn pipeline(folder: &Path, cache: EpisodeCache, jobs: usize) -> Pipeline {
    let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
    profile.evaluation.sandbox_pairs = PAIRS;
    // So wide that every try takes these pairs.
    profile.tries.margin = 0.5;
    profile.evaluation.drills_per_kind = DRILLS;
    let seeds = EpisodeSeeds::OfRun(CALIBRATION_FROM_RUN + 3);
    let settings = PipelineSettings { jobs, cache, ..settings(profile, seeds) };
    pipeline_of(folder, settings, |_| WallClock::scripted(0, None))
}

/// The sandbox result of a candidate, and the events until then.
fn sandbox(pipeline: &mut Pipeline, name: &str) -> (CapabilityId, StageOutcome, Vec<EventKind>) {
    let reply =
        pipeline.command(Command::Register { package: package(name, &[]), name: name.to_owned(), by: None });
    let Reply::Accepted { version: Some(id), .. } = reply else { panic!("{reply:?}") };
    let mut events = Vec::new();
    for _ in 0..2_000 {
        assert_eq!(pipeline.advance(), SliceOutcome::Ran);
        assert_eq!(pipeline.record().holding(), None);
        events.extend(pipeline.drain_events());
        let decided = events.iter().find_map(|event| match event {
            EventKind::Decided { version, stage: Stage::Sandbox, outcome, .. } if *version == id => {
                Some(*outcome)
            }
            _ => None,
        });
        if let Some(outcome) = decided {
            return (id, outcome, events);
        }
    }
    panic!("the sandbox of {name} does not end");
}

fn cache_use(pipeline: &mut Pipeline, id: &CapabilityId) -> Option<CachedResultUse> {
    pipeline.live().evidence_files.of(id).unwrap().kept.clone()
}

fn records(pipeline: &Pipeline, kind: RecordKind) -> Vec<String> {
    let all =
        pipeline.record().version_table().store().views().unwrap().audit(&AuditFilter::default()).unwrap();
    all.into_iter().filter(|record| record.kind == kind).map(|record| record.body).collect()
}

/// A new folder with a copy of the store of [`fill`], which is worked once in a process.
fn filled_store() -> TempDir {
    static FILLED: OnceLock<FolderCopy> = OnceLock::new();
    let filled = FILLED.get_or_init(|| {
        let folder = quick_folder();
        fill(folder.path(), EpisodeCache::InStore);
        FolderCopy::of(folder.path())
    });
    filled.folder()
}

/// Makes a store whose active versions' results are kept, and that nothing waits in.
fn fill(folder: &Path, cache: EpisodeCache) {
    let mut pipeline = pipeline(folder, cache, 2);
    let (id, _, _) = sandbox(&mut pipeline, FIRST);
    assert_eq!(cache_use(&mut pipeline, &id), None, "there was nothing yet");
    let operation = Operation { version: id, by: "ada".to_owned(), reason: "a test".to_owned() };
    assert!(matches!(pipeline.command(Command::Reject(operation)), Reply::Accepted { .. }));
}

/// A result that says that the active version failed and was unsafe, or could not be recovered.
fn falsified(body: &str) -> String {
    let edited = body
        .replace("\"success\":true", "\"success\":false")
        .replace("\"violation\":false", "\"violation\":true")
        .replace("\"anomaly\":false", "\"anomaly\":true")
        .replace("\"recovery\":false", "\"recovery\":true")
        .replace("\"near\":false", "\"near\":true")
        .replace("\"passed\"", "\"failed\"");
    assert_ne!(edited, body, "nothing of it was edited");
    edited
}

/// Every cached cell of a store: its key and its content.
fn cells(folder: &Path) -> Vec<(String, String)> {
    let connection = Connection::open(folder.join("telemetry.db")).unwrap();
    let mut select = connection.prepare("SELECT key, CAST(body AS TEXT) FROM cell").unwrap();
    let rows = select.query_map([], |row| Ok((row.get(0)?, row.get(1)?))).unwrap();
    rows.collect::<Result<_, _>>().unwrap()
}

/// The second candidate's result and events in a store of its own, without cached results.
fn honest() -> &'static (StageOutcome, Vec<EventKind>) {
    static HONEST: OnceLock<(StageOutcome, Vec<EventKind>)> = OnceLock::new();
    HONEST.get_or_init(|| {
        let folder = quick_folder();
        let (_, outcome, events) = sandbox(&mut pipeline(folder.path(), EpisodeCache::InStore, 2), SECOND);
        // A baseline that always fails would let it into the shadow stage.
        assert_eq!(outcome, StageOutcome::Sandbox);
        (outcome, events)
    })
}

fn stage_events(events: &[EventKind]) -> Vec<String> {
    let of_stage = |event: &&EventKind| {
        matches!(
            event,
            EventKind::Decided { .. } | EventKind::Progress { .. } | EventKind::StageStarted { .. }
        )
    };
    events.iter().filter(of_stage).map(|event| serde_json::to_string(event).unwrap()).collect()
}

fn place_of(alarm: &Alarm) -> Option<CacheLocation> {
    match alarm.text.notice() {
        Some(Notice::CacheMismatch { place, .. }) => Some(*place),
        _ => None,
    }
}

/// Unedited results: the decision is the same, a spot check precedes it, and the record names the cached results.
#[test]
fn cached_results_count_after_a_spot_check_and_change_no_event() {
    let folder = filled_store();
    let (outcome, expected) = honest();
    let mut second = pipeline(folder.path(), EpisodeCache::InStore, 1);
    let (id, cached_outcome, events) = sandbox(&mut second, SECOND);
    assert_eq!(cached_outcome, *outcome);
    assert_eq!(stage_events(&events), stage_events(expected));
    let used = cache_use(&mut second, &id).unwrap();
    assert_eq!((used.place, used.refused), (CacheLocation::Store, 0));
    let [episodes, drills, _] = used.sample_counts();
    assert!(episodes.foreign >= 20 && episodes.rerun >= 19, "{episodes:?}");
    assert!(drills.foreign >= 10 && drills.rerun >= 10, "{drills:?}");
    assert_eq!(records(&second, RecordKind::KeptVoided), Vec::<String>::new());

    // What this process worked itself is known to it.
    let (id, _, _) = sandbox(&mut second, "grasp-robust");
    let samples = cache_use(&mut second, &id).unwrap().sample_counts();
    let all = RerunSampleCounts { foreign: u64::from(PAIRS), rerun: 0 };
    assert!(samples[0].foreign < all.foreign, "what the process ran again is its own: {samples:?}");

    let views = second.record().version_table().store().views().unwrap();
    let explained = holdpoint_explain::why::explain(&*views, &id).unwrap().unwrap();
    let uses = explained.decisions.iter().filter_map(|decision| decision.kept.as_ref());
    assert_eq!(uses.count(), 1, "with the sandbox's decision");
}

/// Rows edited by a user with write access: an episode without a MAC does not count, and every episode is run again.
#[test]
fn edited_rows_do_not_count() {
    let folder = filled_store();
    let connection = Connection::open(folder.path().join("telemetry.db")).unwrap();
    for (key, body) in cells(folder.path()) {
        let body = falsified(&body).into_bytes();
        let digest = Digest::of_parts("holdpoint/episode/v1", &[key.as_bytes(), &body]).to_string();
        connection
            .execute(
                "UPDATE cell SET body = ?2, bytes = length(?2), mac = ?3 WHERE key = ?1",
                (key, body, digest),
            )
            .unwrap();
    }
    drop(connection);
    let mut second = pipeline(folder.path(), EpisodeCache::InStore, 2);
    let (id, outcome, _) = sandbox(&mut second, SECOND);
    assert_eq!(outcome, honest().0);
    let used = cache_use(&mut second, &id).unwrap();
    assert!(used.blocks.is_empty() && used.refused > 0, "{used:?}");
}

/// The same by who has the secret too: the spot check finds it, nothing that was kept counts, and it is on record.
#[test]
fn cache_mismatch_with_a_valid_mac_is_found_before_it_counts() {
    let folder = filled_store();
    let all = cells(folder.path());
    let store = Store::open(folder.path()).unwrap();
    for (key, body) in &all {
        store.result_cache().put(&key.parse::<Digest>().unwrap(), falsified(body).as_bytes()).unwrap();
    }
    drop(store);
    let mut second = pipeline(folder.path(), EpisodeCache::InStore, 2);
    let (id, outcome, events) = sandbox(&mut second, SECOND);
    assert_eq!(outcome, honest().0);
    assert_eq!(cache_use(&mut second, &id), None, "it ran everything itself");
    let [record] = &records(&second, RecordKind::KeptVoided)[..] else { panic!("one record") };
    let found: CachedResultMismatch = serde_json::from_str(record).unwrap();
    assert_eq!(found.active.to_string(), "grasp@1.0.0");
    assert!(!found.differing.is_empty(), "{found:?}");
    let alarm = second.record().alarms().get(&AlarmKey::KeptFalse).expect("an alarm is raised");
    assert_eq!(place_of(alarm), Some(CacheLocation::Store));
    let begun =
        events.iter().filter(|event| matches!(event, EventKind::StageStarted { stage: Stage::Sandbox, .. }));
    assert_eq!(begun.count(), 2, "it began again");
    let views = second.record().version_table().store().views().unwrap();
    let detail = views.version(&id).unwrap().unwrap();
    let decisions = holdpoint_explain::why::decisions(&*views, &id, &detail).unwrap();
    let mut consequences = decisions.iter().flat_map(|decision| &decision.consequences);
    let is_void =
        |of: &Consequence| matches!(of, Consequence::CacheVoided { place: CacheLocation::Store, .. });
    assert!(consequences.any(|(_, consequence)| is_void(consequence)), "{decisions:?}");
    drop(second);
    let now = cells(folder.path());
    assert!(!now.is_empty(), "later results are cached");
    assert!(
        all.iter().all(|(key, body)| !now.contains(&(key.clone(), falsified(body)))),
        "a false one stays"
    );
}

/// The same in a folder that runs share: half of the results edited without the secret, half with it.
#[test]
fn shared_folder_with_a_cache_mismatch_is_not_used_again() {
    let (folder, store, shared) = (quick_folder(), quick_folder(), quick_folder());
    let secret = CacheSecret::fresh().unwrap();
    let cells = || ResultCache::in_folder(shared.path().to_owned(), secret.clone());
    fill(folder.path(), EpisodeCache::Shared(cells()));
    // Everything is edited, every second with the secret.
    let forger = cells();
    let mut names: Vec<_> =
        std::fs::read_dir(shared.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.sort();
    for (path, place) in names.iter().zip(0..) {
        let whole = std::fs::read(path).unwrap();
        let body = falsified(std::str::from_utf8(&whole[32..]).unwrap());
        if place % 2 == 0 {
            std::fs::write(path, [&whole[..32], body.as_bytes()].concat()).unwrap();
        } else {
            let key: Digest = path.file_name().unwrap().to_str().unwrap().parse().unwrap();
            forger.put(&key, body.as_bytes()).unwrap();
        }
    }
    // Results edited without the secret are refused and run again.
    let forged = || names.iter().skip(1).step_by(2);
    let content = || forged().map(|path| std::fs::read(path).unwrap()).collect::<Vec<_>>();
    let edited = content();
    let mut second = pipeline(store.path(), EpisodeCache::Shared(cells()), 2);
    let (id, outcome, _) = sandbox(&mut second, SECOND);
    assert_eq!(outcome, honest().0);
    assert_eq!(cache_use(&mut second, &id), None);
    let alarm = second.record().alarms().get(&AlarmKey::KeptFalse).expect("an alarm is raised");
    assert_eq!(place_of(alarm), Some(CacheLocation::Folder));
    assert_eq!(content(), edited, "what is false stays as it is");
}
