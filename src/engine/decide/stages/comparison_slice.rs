//! One slice of a comparison of a version with another one after its sandbox: a confirmation or a re-evaluation.

use holdpoint_governance::evidence::SandboxMode;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_runtime::capability::Capability;
use holdpoint_trials::Trials;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::evaluation::{Evaluation, EvaluationPlan};
use holdpoint_trials::seeds::SeedSource;
use holdpoint_trials::trace::{EpisodeTrace, keep_trace};

use super::closing::progress;
use super::shared_stops::alarm_since;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{trial_subject, trial_team};
use holdpoint_record::evidence_file::EvidenceFiles;

/// The comparison and its cell.
pub(super) struct ComparisonSlice<'a> {
    pub(super) id: &'a CapabilityId,
    pub(super) compared_with: &'a Capability,
    pub(super) cell: &'a Cell,
    pub(super) plan: EvaluationPlan,
    pub(super) seeds: SeedSource,
    /// The stage and the name in progress reports.
    pub(super) stage: Stage,
    pub(super) name_of: fn(WorkUnit) -> WorkUnit,
}

/// Runs one slice, stores its traces and reports progress. Returns the number of episodes run.
///
/// # Errors
/// If a worker fails, or the result cannot be written.
pub(super) fn run_slice(
    context: &Context,
    trials: &Trials,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    comparison: &ComparisonSlice<'_>,
    evaluation: &mut Evaluation,
) -> Result<u64, EngineFault> {
    let candidate = record.capability(comparison.id)?;
    let version_table = record.version_table();
    let store = version_table.store();
    let subject = |version| trial_subject(context, version_table, evidence_files, version);
    let (new, old) = (subject(&candidate), subject(comparison.compared_with));
    let team = trial_team(context, version_table, evidence_files, &candidate);
    let anchor = version_table.anchor_beside(comparison.compared_with).map(subject);
    let lab = trials.lab(comparison.cell, store, comparison.seeds).with_team(team).with_anchor(anchor);
    let known = evaluation.stops().shared.len();
    let Some(slice) = evaluation.step(&lab, &new, &old, &context.profile)? else { return Ok(0) };
    let episodes = slice.pairs.len() as u64;
    let runs: Vec<EpisodeTrace> =
        slice.pairs.into_iter().map(|pair| EpisodeTrace::new(pair.setup, &pair.candidate)).collect();
    if !runs.is_empty() {
        let now_ms = record.now_ms();
        let ComparisonSlice { cell, id, .. } = *comparison;
        keep_trace(store, cell, id, SandboxMode::Confirmation, runs, now_ms)?;
    }
    let versions = (comparison.id, &comparison.compared_with.id());
    alarm_since(context, record, versions, evaluation.stops(), known);
    let work_unit = ((comparison.name_of)(slice.what), slice.part);
    let done = (slice.done, comparison.plan.budget());
    progress(record, evidence_files, comparison.id, comparison.stage, work_unit, done);
    Ok(episodes)
}
