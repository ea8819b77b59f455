//! Held-out evaluation: whole sequences by the active versions, on episodes that no stage uses, watched by the referee.

use holdpoint_governance::ids::Digest;
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use super::PaperSetup;
use super::active_families::ActiveFamilies;
use crate::ground_truth::{HarmClass, HarmScale, JudgedVersion, TruthBench, observe_sequence};
use crate::pipeline_experiments::{ExperimentError, cached_result};

/// First seed of these episodes: above those of the truth's channels and of any run.
const FROM: u64 = 3 << 61;

/// Seeds of one run seed, and of one round of it.
const SEED_STEP: u64 = 1 << 24;
const ROUND_STEP: u64 = 1 << 16;

/// The result of one sequence: the referee's verdict, and the tasks' own records beside it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutSequence {
    /// All three tasks were done, by inspection.
    pub done: bool,
    /// How bad it was by the published scale, true forces and poses.
    pub harm: HarmClass,
    /// A measured quantity went past its limit, or the guard denied a command (the paper's hard violation).
    pub violation: bool,
    /// A quantity passed the near margin of its limit, or went past it.
    pub near: bool,
    pub anomaly: bool,
    /// The arm moved when it was due to be at standstill, by the referee.
    pub moved_on: bool,
    /// How long motion went on after declared failures and stops, ms, by the tasks' own records.
    pub continued_ms: u64,
    /// New attempts after failed ones.
    pub retries: u32,
    /// How long the tasks took together, s.
    pub time_s: f64,
}

/// Runs the sequences of a round, or reads them from the cache: one place each, `None` where its world failed, so that
/// the sequences of two teams stay pairs.
///
/// # Errors
/// If a result cannot be cached.
pub fn evaluate(
    setup: &PaperSetup,
    worker: &mut Worker,
    in_force: &ActiveFamilies,
    seed: u64,
    round: u32,
    sequences: u64,
) -> Result<Vec<Option<HeldOutSequence>>, ExperimentError> {
    let from = FROM + seed * SEED_STEP + u64::from(round) * ROUND_STEP;
    let at = format!("{from}|{sequences}");
    let parts = [
        setup.cell.digest().bytes().as_slice(),
        setup.cell.computed_by().as_bytes(),
        setup.profile.digest()?.bytes().as_slice(),
        in_force.digest().bytes().as_slice(),
        at.as_bytes(),
    ]
    .map(<[u8]>::to_vec);
    let key = Digest::of_parts("holdpoint.held-out.v1", &parts.iter().map(Vec::as_slice).collect::<Vec<_>>());
    let whole = cached_result::<Vec<Option<HeldOutSequence>>>(&setup.cache, &key);
    if let Some(known) = whole.filter(|known| known.len() as u64 == sequences) {
        return Ok(known);
    }
    let scale = HarmScale::builtin().map_err(ExperimentError::unexpected)?;
    let bench = TruthBench::with_team(setup.cell.clone(), setup.cache.clone(), Vec::new(), 0)?;
    let tightened = setup.profile.monitor.restrict_factor;
    let team: Vec<JudgedVersion> = in_force
        .members()
        .map(|member| {
            let judged = bench.judged_version(member.version.clone());
            if member.restricted {
                JudgedVersion { terms: judged.terms.tightened(tightened), ..judged }
            } else {
                judged
            }
        })
        .collect();
    let mut found = Vec::new();
    for index in from..from + sequences {
        let (seen, records) = match observe_sequence(worker, &setup.cell, &team, index) {
            Ok(observed) => observed,
            Err(error) => {
                worker.note_failure(error);
                found.push(None);
                continue;
            }
        };
        found.push(Some(HeldOutSequence {
            done: seen.done,
            harm: scale.class(&seen),
            violation: records.iter().any(|record| record.violation),
            near: records.iter().any(|record| record.violation || record.near),
            anomaly: records.iter().any(|record| record.anomaly),
            moved_on: seen.moved_on_ticks > 0,
            continued_ms: records.iter().map(|record| record.unsafe_continuation_ms).sum(),
            retries: records.iter().map(|record| record.retries).sum(),
            time_s: records.iter().map(|record| record.time_secs).sum(),
        }));
    }
    setup.cache.put(&key, &serde_json::to_vec(&found)?)?;
    Ok(found)
}
