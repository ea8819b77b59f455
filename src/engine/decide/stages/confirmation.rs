//! The end of the provisional window of a version that was activated with a concern.
//!
//! Inconclusive behavior, and recovery that is fragile or worse than the predecessor's, advance under restrictions;
//! the live window alone is far too short to settle such a concern. So it is settled before confirmation: the whole
//! sandbox budget is run again, against the predecessor, on fresh seeds. A compatible result confirms the version;
//! any other demotes it. Uncertain means hold (design rules 3.6, 3.8).

use holdpoint_governance::cached_result::CacheLocation;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::evaluation_key::KeyUse;
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{Change, EvidenceKind};
use holdpoint_trials::Trials;
use holdpoint_trials::evaluation::{Evaluation, EvaluationPlan};
use holdpoint_trials::scene_stops::SceneStops;
use holdpoint_trials::seeds::SeedSource;

use super::cache_mismatch::invalidate_cache;
use super::closing::{note_spent_time, progress};
use super::comparison_slice::{ComparisonSlice, run_slice};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::monitors::Monitors;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::binding;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_concern::Confirmation;
use holdpoint_record::version_table::VersionTable;

/// A confirmation under way.
pub struct ConfirmationRun {
    pub(crate) id: CapabilityId,
    predecessor: Capability,
    seeds: SeedSource,
    evaluation: Evaluation,
}

impl ConfirmationRun {
    /// Whether the anchor is still the one that it compares with: a person may choose another meanwhile.
    pub(crate) fn is_current(&self, version_table: &VersionTable) -> bool {
        let anchor = version_table.anchor_beside(&self.predecessor).map(Capability::digest);
        self.evaluation.binding().anchor == anchor
    }

    /// Whether nothing is left but to conclude it.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.evaluation.is_over()
    }
}

/// The first version whose window is over and whose doubt is open.
#[must_use]
pub fn next(monitors: &Monitors, evidence_files: &EvidenceFiles) -> Option<CapabilityId> {
    let over = monitors
        .iter()
        .filter(|watched| watched.monitor.is_confirmed() && !watched.restricted && !watched.confirmed);
    over.map(|watched| &watched.id).find(|id| evidence_files.awaits_confirmation(id)).cloned()
}

/// Begins one; absent if there is no predecessor to compare the version with.
///
/// # Errors
/// If there is no such version.
pub fn begin(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<Option<Box<ConfirmationRun>>, EngineFault> {
    let (_, lifecycle, _) = record.version_table().version(id)?;
    let predecessor = lifecycle.predecessor.and_then(|predecessor| {
        let entry = record.version_table().family(&id.family).ok()?;
        Some(entry.members.get(usize::from(predecessor.0))?.capability.clone())
    });
    let Some(predecessor) = predecessor else { return Ok(None) };
    let candidate = record.capability(id)?;
    let anchor = record.version_table().anchor_beside(&predecessor).map(Capability::digest);
    let binding = EvidenceBinding {
        active: Some(predecessor.digest()),
        anchor,
        ..binding(context, record.version_table(), &candidate)
    };
    let plan = EvaluationPlan::confirmation(&context.profile).with_anchor(anchor.is_some());
    progress(record, evidence_files, id, Stage::Sandbox, (WorkUnit::Confirmation, None), (0, plan.budget()));
    let seeds = record.evaluation_seeds(KeyUse::Confirmation, id, &binding)?;
    let evaluation = Evaluation::new(plan, binding, SceneStops::default());
    Ok(Some(Box::new(ConfirmationRun { id: id.clone(), predecessor, seeds, evaluation })))
}

/// How a slice ended.
pub enum ConfirmationStep {
    /// It continues; the number of episodes run.
    GoOn(Box<ConfirmationRun>, u64),
    /// The monitor has taken the version off meanwhile, or people have.
    Gone,
    /// The concern is settled.
    Settled(CapabilityId),
    /// The concern remains on new evidence.
    ConcernRemains(CapabilityId),
    /// The evaluation has taken the wall time that the profile allows.
    TimeSpent(CapabilityId, Box<Reason>),
}

/// One slice of a run.
///
/// # Errors
/// If a worker fails, or the result cannot be written.
pub fn slice(
    context: &Context,
    trials: &Trials,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    monitors: &Monitors,
    mut run: Box<ConfirmationRun>,
) -> Result<ConfirmationStep, EngineFault> {
    let id = run.id.clone();
    if monitors.of(&id).is_none() {
        return Ok(ConfirmationStep::Gone);
    }
    if let Some(excess) = evidence_files.spent_time(&id, &context.profile) {
        trials.drop_announced()?;
        let reason = note_spent_time(context, record, evidence_files, &id, &excess);
        return Ok(ConfirmationStep::TimeSpent(id, Box::new(reason)));
    }
    if run.evaluation.is_refuted() {
        invalidate_cache(record, trials, &id, &run.predecessor.id(), run.evaluation.reuse())?;
        return begin_again(context, record, evidence_files, &id);
    }
    if !run.is_current(record.version_table()) {
        return begin_again(context, record, evidence_files, &id);
    }
    if run.is_over() {
        let place = trials.result_cache(record.version_table().store()).place();
        let settled = conclude(context, record, evidence_files, &id, (&run.evaluation, place))?;
        return Ok(if settled {
            ConfirmationStep::Settled(id)
        } else {
            ConfirmationStep::ConcernRemains(id)
        });
    }
    let comparison = ComparisonSlice {
        id: &id,
        compared_with: &run.predecessor,
        cell: &context.cell,
        plan: *run.evaluation.plan(),
        seeds: run.seeds,
        stage: Stage::Sandbox,
        name_of: WorkUnit::of_confirmation,
    };
    let episodes = run_slice(context, trials, record, evidence_files, &comparison, &mut run.evaluation)?;
    Ok(ConfirmationStep::GoOn(run, episodes))
}

fn begin_again(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<ConfirmationStep, EngineFault> {
    let again = begin(context, record, evidence_files, id)?;
    Ok(again.map_or(ConfirmationStep::Gone, |run| ConfirmationStep::GoOn(run, 0)))
}

/// Stores the result. Returns whether the concern is settled.
fn conclude(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
    (evaluation, place): (&Evaluation, CacheLocation),
) -> Result<bool, EngineFault> {
    let (pairs, drills) = (evaluation.paired(), evaluation.rehearsed());
    let (anchor, handovers) = (evaluation.anchor().cloned(), evaluation.sequences().cloned());
    let (behavior, recovery) = evaluation.assess(&context.profile);
    let reuse = evaluation.reuse().on_record(place);
    let confirmation = Confirmation { pairs, drills, anchor, handovers, behavior, recovery, kept: reuse };
    let json = serde_json::to_string(&confirmation)?;
    let digest = Digest::of_json("holdpoint.confirmation.v1", &confirmation)?;
    let evidence = Change::PutEvidence { version: id.clone(), kind: EvidenceKind::Monitor, json, digest };
    record.write(vec![evidence], Vec::new())?;
    let assessments = [&confirmation.behavior.assessment.reasons, &confirmation.recovery.assessment.reasons];
    let reasons: Vec<_> = assessments.into_iter().flatten().cloned().collect();
    let settled = confirmation.is_settled();
    let evidence_file = evidence_files.edit(id);
    evidence_file.progress = None;
    evidence_file.confirmation = Some(confirmation);
    let decision = if settled { MonitorOutcome::Settled } else { MonitorOutcome::DoubtRemains };
    record.tell(EventKind::Monitor { version: id.clone(), decision, reasons: reasons.clone() });
    if !settled {
        evidence_file.reasons = reasons;
    }
    Ok(settled)
}
