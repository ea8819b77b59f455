//! The result of the governance layer when a part of it fails while a version degrades (the paper's appendix H).
//!
//! Each drift of the drift experiment that worsens its version is re-run from the same activation, with a monitor that
//! does not see it or without a rollback target. Counts the final state of the family, and the episodes until then.

use std::path::Path;

use holdpoint_body::disturbance::LiveFault;
use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_engine::build_digest::decided_by;
use holdpoint_engine::decide::pipeline::Pipeline;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::monitor::Rate;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::rollback::RungFailure;
use holdpoint_protocol::command::{Command, Operation, Reply};
use holdpoint_store::Layout;
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use super::drift::cached_run;
use super::drift_run::{ActivatedRun, DriftSetting, PartWork, WatchedRun, activate, candidate_of, drifts};
use super::{DriftOptions, ExperimentError, ProgressFn, baselines, cached_result};
use crate::side_by_side::side_by_side;
use crate::wording::{packages, progress};

holdpoint_governance::closed_set! {
    /// The part of the layer that fails while a version is in control.
    LayerFailure, "failure of the layer", {
        /// Nothing: the reference for the others.
        Nothing = "nothing",
        /// The monitor does not see whether tasks are done.
        BlindToFailures = "blind-to-failures",
        /// The monitor sees no rate; it sees immediate triggers.
        BlindToRates = "blind-to-rates",
        /// Nothing of the arm reaches the monitor.
        Silent = "telemetry-lost",
        /// The rollback target is blocked under the profile.
        TargetBlocked = "predecessor-closed",
        /// The store's data of the rollback target is not what was written.
        TargetChanged = "predecessor-changed",
    }
}

holdpoint_governance::closed_set! {
    /// The state of a family after a drift.
    Stance, "stance of a family", {
        /// Its rollback target is in control.
        RolledBack = "rolled-back",
        /// None of its versions is active until an operator reactivates one.
        SafeStopped = "safe-stopped",
        /// The version stays active in a tighter envelope.
        Restricted = "restricted",
        /// The version stays active as before.
        InControl = "in-control",
    }
}

impl LayerFailure {
    /// Rates that the monitor does not see.
    pub(super) const fn unseen(self) -> &'static [Rate] {
        match self {
            Self::BlindToFailures => &[Rate::Failure],
            Self::BlindToRates => &Rate::ALL,
            Self::Nothing | Self::Silent | Self::TargetBlocked | Self::TargetChanged => &[],
        }
    }

    /// Makes a pipeline with an active version, and its store, fail in this way.
    pub(super) fn sets_in(
        self,
        pipeline: &mut Pipeline,
        version: &CapabilityId,
        store: &Path,
    ) -> Result<(), ExperimentError> {
        let command = match self {
            Self::Nothing | Self::BlindToFailures | Self::BlindToRates => return Ok(()),
            Self::TargetChanged => return change(store, &rollback_target(version)?),
            Self::Silent => Command::LiveFault { fault: Some(LiveFault::TelemetryLost) },
            Self::TargetBlocked => {
                let (by, reason) = ("an operator".to_owned(), packages::BLOCKED.to_owned());
                let operation = Operation { version: rollback_target(version)?, by, reason };
                Command::Demote { operation, profiles: vec![ProfileName::Sim] }
            }
        };
        match pipeline.command(command) {
            Reply::Accepted { .. } => Ok(()),
            other => Err(ExperimentError::Unexpected(format!("{self} does not set in: {other:?}"))),
        }
    }
}

/// The rollback target of a family's first upgrade.
fn rollback_target(version: &CapabilityId) -> Result<CapabilityId, ExperimentError> {
    let first = baselines()?.into_iter().map(|first| first.id());
    let mut of_family = first.filter(|first| first.family == version.family);
    of_family.next().ok_or_else(|| ExperimentError::Unexpected(format!("{version} has no predecessor")))
}

/// Changes the stored data of a version, as an attacker with write access to the file can.
fn change(store: &Path, version: &CapabilityId) -> Result<(), ExperimentError> {
    let work = || -> rusqlite::Result<usize> {
        let database = rusqlite::Connection::open(Layout::new(store).database())?;
        let guards: Vec<String> = database
            .prepare("SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'version'")?
            .query_map([], |row| row.get(0))?
            .collect::<rusqlite::Result<_>>()?;
        for guard in guards {
            database.execute_batch(&format!("DROP TRIGGER \"{guard}\""))?;
        }
        let sql = "UPDATE version SET submission = submission || ' ' WHERE name = ?1";
        database.execute(sql, [version.to_string()])
    };
    match work() {
        Ok(1) => Ok(()),
        Ok(rows) => Err(ExperimentError::Unexpected(format!("{version} stands in {rows} rows"))),
        Err(error) => Err(ExperimentError::Unexpected(format!("{version} cannot be changed: {error}"))),
    }
}

/// The result of a failure under one drift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayerRow {
    pub seed: u64,
    pub candidate: String,
    pub kind: DriftKind,
    pub magnitude: Magnitude,
    pub failure: LayerFailure,
    pub stance: Stance,
    /// Why the family was stopped, if a rung of the ladder failed.
    pub stopped_by: Option<RungFailure>,
    /// An alarm named the version that is not its monitor's.
    pub told: bool,
    /// Tasks of the version under the drift until the rollback, or until the horizon.
    pub under: PartWork,
    /// Tasks of the family in the ten sequences after the rollback.
    pub after: PartWork,
}

impl LayerRow {
    fn of(piece: LayerJob, run: WatchedRun) -> Self {
        let LayerJob { seed, drift: Drift { kind, magnitude }, failure } = piece;
        let WatchedRun { under, after, record, restricted, has_alarm: told, .. } = run;
        let stance = match &record {
            Some(record) if record.predecessor.is_some() => Stance::RolledBack,
            Some(_) => Stance::SafeStopped,
            None if restricted => Stance::Restricted,
            None => Stance::InControl,
        };
        let stopped_by =
            record.filter(|_| stance == Stance::SafeStopped).and_then(|record| record.stopped_by());
        let candidate = candidate_of(seed).to_owned();
        Self { seed, candidate, kind, magnitude, failure, stance, stopped_by, told, under, after }
    }
}

/// One piece of work.
#[derive(Clone, Copy)]
struct LayerJob {
    seed: u64,
    drift: Drift,
    failure: LayerFailure,
}

impl LayerJob {
    fn key(self, setting: &Digest) -> Digest {
        let Self { seed, drift: Drift { kind, magnitude }, failure } = self;
        let decided_by = decided_by(holdpoint_sim::BUILD);
        let parts = [
            setting.bytes().as_slice(),
            &seed.to_le_bytes(),
            kind.name().as_bytes(),
            magnitude.name().as_bytes(),
            failure.name().as_bytes(),
            decided_by.as_bytes(),
        ];
        Digest::of_parts("holdpoint.layer-cell.v1", &parts)
    }
}

/// Runs every failure under every drift that worsens its version, by the finished cells of the drift experiment. The
/// rows come in the order of runs, drifts and failures.
///
/// # Errors
/// If the versions are not activated as they were, a failure does not occur, or a result cannot be cached.
pub fn run(options: &DriftOptions, tell: &ProgressFn<'_>) -> Result<Vec<LayerRow>, ExperimentError> {
    let setting = DriftSetting::new(options)?;
    let digest = setting.digest()?;
    let seeds: Vec<u64> = (options.seed..options.seed + options.runs).collect();
    let rows = side_by_side(
        options.jobs,
        seeds.len(),
        |_, at| of_run(&setting, digest, seeds[at], tell),
        |at, _| progress::run(seeds[at]),
        tell,
    )?;
    Ok(rows.into_iter().flatten().collect())
}

fn of_run(
    setting: &DriftSetting,
    digest: Digest,
    seed: u64,
    tell: &ProgressFn<'_>,
) -> Result<Vec<LayerRow>, ExperimentError> {
    let is_worse = |drift: &Drift| {
        let run = cached_run(&setting.cache, &digest, seed, *drift).and_then(|run| run.result);
        run.is_some_and(|result| result.effect.needs_trigger)
    };
    let pieces: Vec<LayerJob> = drifts()
        .filter(is_worse)
        .flat_map(|drift| LayerFailure::ALL.map(|failure| LayerJob { seed, drift, failure }))
        .collect();
    let found: Vec<Option<LayerRow>> =
        pieces.iter().map(|piece| cached_result(&setting.cache, &piece.key(&digest))).collect();
    if found.iter().all(Option::is_some) {
        return Ok(found.into_iter().flatten().collect());
    }
    let activated = activate(setting, seed)?
        .ok_or_else(|| ExperimentError::Unexpected(format!("the version of run {seed} is active no more")))?;
    side_by_side(
        setting.workers,
        pieces.len(),
        |_: &mut Worker, at| match &found[at] {
            Some(row) => Ok(row.clone()),
            None => work(setting, &activated, pieces[at], digest),
        },
        |_, row| progress::layer_failure(row),
        tell,
    )
}

fn work(
    setting: &DriftSetting,
    activated: &ActivatedRun,
    piece: LayerJob,
    digest: Digest,
) -> Result<LayerRow, ExperimentError> {
    let row = LayerRow::of(piece, activated.run_monitored(setting, piece.drift, piece.failure)?);
    setting.cache.put(&piece.key(&digest), &serde_json::to_vec(&row)?)?;
    Ok(row)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline_experiments::scratch;
    use holdpoint_store::{CacheSecret, ResultCache};

    /// A seed of calibration whose version a drift of everything worsens within a few tasks.
    const SEED: u64 = 1_002;

    fn options(folder: &Path) -> DriftOptions {
        DriftOptions {
            runs: 1,
            seed: SEED,
            jobs: 2,
            out: folder.join("drift"),
            cache: ResultCache::in_folder(folder.join("kept"), CacheSecret::fresh().unwrap()),
            horizon: 30,
            pairs: 5,
        }
    }

    /// Every failure under one drift: an unseen version stays in control. Without a usable rollback target the family
    /// stops, and none of its versions gets the arm.
    #[test]
    fn failing_layer_stops_a_family_and_a_blind_layer_does_not() {
        let folder = scratch().unwrap();
        let options = options(folder.path());
        let setting = DriftSetting::new(&options).unwrap();
        let activated = activate(&setting, SEED).unwrap().unwrap();
        let drift = Drift { kind: DriftKind::Combined, magnitude: Magnitude::Middle };
        let row = |failure| {
            let piece = LayerJob { seed: SEED, drift, failure };
            LayerRow::of(piece, activated.run_monitored(&setting, drift, failure).unwrap())
        };
        let nothing = row(LayerFailure::Nothing);
        assert_eq!(nothing.stance, Stance::RolledBack);
        assert!(nothing.after.tasks > 0, "the predecessor works: {nothing:?}");
        for (failure, why) in [
            (LayerFailure::TargetBlocked, RungFailure::PredecessorMissing),
            (LayerFailure::TargetChanged, RungFailure::StoreFailed),
        ] {
            let row = row(failure);
            assert_eq!((row.stance, row.stopped_by), (Stance::SafeStopped, Some(why)), "{row:?}");
            assert_eq!(row.under, nothing.under, "it is rolled back as soon");
            assert_eq!(row.after.tasks, 0, "no version of a stopped family has the arm: {row:?}");
        }
        let silent = row(LayerFailure::Silent);
        assert_eq!(silent.stance, Stance::RolledBack, "silence is acted on: {silent:?}");
        let blind = row(LayerFailure::BlindToRates);
        assert_eq!(blind.stance, Stance::InControl, "{blind:?}");
        assert_eq!(blind.under.sequences, options.horizon);
        assert!(blind.under.tasks > nothing.under.tasks);
    }

    #[test]
    fn a_row_is_read_back_unchanged() {
        for failure in LayerFailure::ALL {
            for stance in Stance::ALL {
                let row = LayerRow {
                    seed: 40,
                    candidate: candidate_of(40).to_owned(),
                    kind: DriftKind::Combined,
                    magnitude: Magnitude::Mild,
                    failure,
                    stance,
                    stopped_by: (stance == Stance::SafeStopped).then_some(RungFailure::StoreFailed),
                    told: true,
                    under: PartWork { sequences: 9, tasks: 8, done: 4, unsafe_tasks: 1 },
                    after: PartWork::default(),
                };
                let bytes = serde_json::to_vec(&row).unwrap();
                assert_eq!(serde_json::from_slice::<LayerRow>(&bytes).unwrap(), row);
            }
        }
    }
}
