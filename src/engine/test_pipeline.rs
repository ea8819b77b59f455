//! A pipeline on a test's own store.

use std::path::Path;

use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::Clock;
use holdpoint_registry::Store;
use holdpoint_sim::SimCells;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, EpisodeSeeds};

use crate::decide::pipeline::{Pipeline, PipelineSettings};
use crate::live::fake_cell::StubFactory;
use crate::live::stop_switch::Controls;
use holdpoint_record::version_table::VersionTable;
use holdpoint_record::wall_clock::WallClock;

/// The seeds of a test that does not ask for others.
pub(crate) const SEEDS: EpisodeSeeds = EpisodeSeeds::OfRun(CALIBRATION_FROM_RUN);

pub(crate) fn pipeline(folder: &Path, profile: ProfileName) -> Pipeline {
    let profile = Profile::builtin(profile).unwrap();
    seeded_pipeline(folder, profile, SEEDS, |_| WallClock::scripted(0, None))
}

/// As [`pipeline`], in a scripted cell: its arm never moves, so no task succeeds.
pub(crate) fn resting_pipeline(folder: &Path, profile: ProfileName) -> Pipeline {
    resting_pipeline_by(folder, Profile::builtin(profile).unwrap(), |_| WallClock::scripted(0, None))
}

/// As [`resting_pipeline`], with another wall clock, which receives the wall time of the newest record.
pub(crate) fn resting_pipeline_by(
    folder: &Path,
    profile: Profile,
    wall: impl FnOnce(Option<WallTime>) -> WallClock,
) -> Pipeline {
    pipeline_of(folder, settings_in(StubFactory::exporting().into_cell(), profile, SEEDS), wall)
}

/// Under a built-in profile in the simulated cell.
pub(crate) fn settings(profile: Profile, seeds: EpisodeSeeds) -> PipelineSettings {
    settings_in(Cell::of(&SimCells, None).unwrap(), profile, seeds)
}

/// As [`settings`], in another cell.
pub(crate) fn settings_in(cell: Cell, profile: Profile, seeds: EpisodeSeeds) -> PipelineSettings {
    PipelineSettings {
        seeds,
        jobs: 1,
        table: PolicyTable::builtin(&profile).unwrap(),
        profile,
        own: None,
        cell,
        cache: EpisodeCache::InStore,
        controls: Controls::default(),
        omitted: holdpoint_governance::ablation::AblatedParts::default(),
    }
}

/// As [`pipeline`], with other seeds and another wall clock.
pub(crate) fn seeded_pipeline(
    folder: &Path,
    profile: Profile,
    seeds: EpisodeSeeds,
    wall: impl FnOnce(Option<WallTime>) -> WallClock,
) -> Pipeline {
    pipeline_of(folder, settings(profile, seeds), wall)
}

/// As [`seeded_pipeline`], with other settings.
pub(crate) fn pipeline_of(
    folder: &Path,
    settings: PipelineSettings,
    wall: impl FnOnce(Option<WallTime>) -> WallClock,
) -> Pipeline {
    let store = Store::open(folder).unwrap();
    let clock = Clock::scripted(store.opening().head.at_ms);
    let baselines = holdpoint_trials::embedded::baselines().unwrap();
    let wall = wall(store.opening().newest_record);
    Pipeline::new(settings, VersionTable::open(Box::new(store), wall).unwrap(), clock, baselines).unwrap()
}
