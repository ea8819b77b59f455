//! The trace record that every evaluation run leaves: what ran, on which inputs, with which result.
//!
//! Kept in the telemetry file, a batch a slice; the batches' digests enter the audit chain. The path of the
//! tool is left out: the same seed under the same environment gives it again. Source: paper section 6.3 and
//! appendix F.1; design rule 5.3.

use holdpoint_cell::EpisodeSetup;
use serde::{Deserialize, Serialize};

use crate::cell::Cell;
use crate::fault::TrialFault;
use holdpoint_governance::evidence::SandboxMode;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_store::{Batch, OpenStore};

/// The runs of one slice of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TraceBatch {
    /// The version that ran.
    pub version: CapabilityId,
    pub mode: SandboxMode,
    /// Digest of robot, scene, distributions and [`Cell::computed_by`].
    pub environment: Digest,
    /// The engine that ran it.
    pub engine_build: String,
    /// One a run, in seed order.
    pub runs: Vec<EpisodeTrace>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeTrace {
    /// Everything that was drawn for the episode.
    pub inputs: EpisodeSetup,
    /// What came of it: success, duration, retries, anomalies, policy hits, recovery.
    pub outputs: TaskRecord,
}

impl EpisodeTrace {
    /// The trace of a run.
    #[must_use]
    pub fn new(inputs: EpisodeSetup, record: &TaskRecord) -> Self {
        Self { inputs, outputs: TaskRecord { path: Vec::new(), ..record.clone() } }
    }
}

impl TraceBatch {
    /// The traces of a version's runs.
    #[must_use]
    pub fn new(version: CapabilityId, mode: SandboxMode, cell: &Cell, runs: Vec<EpisodeTrace>) -> Self {
        Self { version, mode, environment: cell.digest(), engine_build: cell.computed_by().to_owned(), runs }
    }

    /// As a telemetry batch of one stage, at one moment.
    ///
    /// # Errors
    /// Never for records that were measured: they are finite.
    pub fn batch(&self, stage: Stage, at_ms: u64) -> Result<Batch, serde_json::Error> {
        Ok(Batch {
            version: self.version.clone(),
            stream: stage.name().to_owned(),
            from_ms: at_ms,
            to_ms: at_ms,
            rows: self.runs.len().max(1) as u64,
            body: serde_json::to_vec(self)?,
        })
    }
}

/// Keeps the trace records of a slice; their digests enter the audit chain with the stage's decision.
///
/// # Errors
/// If the store does not take them.
pub fn keep_trace(
    store: &dyn OpenStore,
    cell: &Cell,
    id: &CapabilityId,
    mode: SandboxMode,
    runs: Vec<EpisodeTrace>,
    now_ms: u64,
) -> Result<(), TrialFault> {
    let batch = TraceBatch::new(id.clone(), mode, cell, runs);
    store.append_telemetry(&batch.batch(Stage::Sandbox, now_ms)?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pair_spot::PairSpot;
    use crate::sequences::TrialTeam;
    use holdpoint_body::TaskKind;
    use holdpoint_sim::SimCells;

    #[test]
    fn trace_holds_the_inputs_of_its_runs_and_no_path() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let record = TaskRecord { success: true, ..TaskRecord::invalid(TaskKind::Align, 1_000_007) };
        let id = "align@1.1.0".parse::<CapabilityId>().unwrap();
        let setup = PairSpot::in_sandbox(record.seed).setup(&cell, &TrialTeam::default(), record.task);
        let runs = vec![EpisodeTrace::new(setup, &record)];
        let batch = TraceBatch::new(id, SandboxMode::Perturbation, &cell, runs);
        assert_eq!(batch.runs[0].inputs.seed, 1_000_007);
        assert_eq!(batch.runs[0].inputs.distribution, "sandbox");
        let stored = batch.batch(Stage::Sandbox, 5).unwrap();
        assert_eq!((stored.rows, stored.stream.as_str()), (1, "sandbox"));
        assert_eq!(serde_json::from_slice::<TraceBatch>(&stored.body).unwrap(), batch);
    }
}
