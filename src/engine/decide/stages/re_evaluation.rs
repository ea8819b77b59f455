//! Re-evaluates a version whose behavior shifted, in the conditions of the live cell.
//!
//! Two kinds shift: a candidate that differs in its longest shadow from the sandbox, and an active version that
//! differs from its shadow (governance's `distribution_shift`). The cause may be noise, by which a skill can recognize
//! the sandbox, or chance. So the sandbox's pairs and sequences are run again, on fresh seeds, under the live cell's
//! present distribution, drift included: the candidate beside the active version before any decision, the active one
//! beside its predecessor. A first version has no predecessor to compare with or to activate.

use holdpoint_body::disturbance::Drift;
use holdpoint_governance::cached_result::CacheLocation;
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::distribution_shift::{is_cleared, re_evaluation_reasons};
use holdpoint_governance::evaluation_key::KeyUse;
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::notice::Notice;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_runtime::capability::Capability;
use holdpoint_trials::Trials;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::evaluation::{Evaluation, EvaluationPlan};
use holdpoint_trials::scene_stops::SceneStops;
use holdpoint_trials::seeds::SeedSource;

use super::cache_mismatch::invalidate_cache;
use super::closing::{abort_stage, note_spent_time, progress};
use super::comparison_slice::{ComparisonSlice, run_slice};
use super::shadow::{self, ShadowRun};
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::station::LiveStation;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::binding;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_concern::ReEvaluationEvidence;
use holdpoint_record::version_table::VersionTable;

/// A version under re-evaluation.
pub struct ReEvaluationRun {
    pub(crate) id: CapabilityId,
    before: Capability,
    binding: EvidenceBinding,
    cell: Cell,
    drift: Option<Drift>,
    seeds: SeedSource,
    evaluation: Evaluation,
    /// The shadow that found a candidate suspicious; absent for an active version.
    shadow: Option<Box<ShadowRun>>,
}

impl ReEvaluationRun {
    /// Whether nothing is left but to conclude it.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.evaluation.is_over()
    }

    /// Whether it is part of a candidate's shadow.
    #[must_use]
    pub const fn is_of_shadow(&self) -> bool {
        self.shadow.is_some()
    }
}

/// The first active version with an open concern that has not been re-evaluated. After a restart a confirmed one has no monitor.
#[must_use]
pub fn next(version_table: &VersionTable, evidence_files: &EvidenceFiles) -> Option<CapabilityId> {
    let active = version_table.families().filter_map(|(_, entry)| entry.active());
    active.map(|member| member.capability.id()).find(|id| evidence_files.is_suspicious(id))
}

/// Begins it: of a candidate with the shadow that found it suspicious, of an active version without. Absent if there is no
/// version to compare it with.
///
/// # Errors
/// If there is no such version.
pub fn begin(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    live: &LiveStation,
    id: &CapabilityId,
    shadow: Option<Box<ShadowRun>>,
) -> Result<Option<Box<ReEvaluationRun>>, EngineFault> {
    let candidate = record.capability(id)?;
    let entry = record.version_table().family(&id.family)?;
    let (_, lifecycle, _) = record.version_table().version(id)?;
    let before = match (&shadow, lifecycle.predecessor) {
        (Some(_), _) => entry.active().map(|active| active.capability.clone()),
        (None, Some(predecessor)) => {
            entry.members.get(usize::from(predecessor.0)).map(|member| member.capability.clone())
        }
        (None, None) => None,
    };
    let Some(before) = before else { return Ok(None) };
    let binding = EvidenceBinding {
        active: Some(before.digest()),
        ..binding(context, record.version_table(), &candidate)
    };
    let seeds = record.evaluation_seeds(KeyUse::ReEvaluation, id, &binding)?;
    let plan = EvaluationPlan::re_evaluation(&context.profile);
    if shadow.is_none() {
        // The time of its promotion is over.
        evidence_files.edit(id).worked_ms = 0;
    }
    progress(record, evidence_files, id, Stage::Shadow, (WorkUnit::ReEvaluation, None), (0, plan.budget()));
    Ok(Some(Box::new(ReEvaluationRun {
        id: id.clone(),
        before,
        binding,
        cell: context.cell.with_live_sandbox(live.distribution()),
        drift: live.drift().copied(),
        seeds,
        evaluation: Evaluation::new(plan, binding, SceneStops::default()),
        shadow,
    })))
}

/// How a slice ended.
pub enum ReEvaluationStep {
    /// It continues; the number of episodes run.
    GoOn(Box<ReEvaluationRun>, u64),
    /// The version, or the one to compare it with, is gone.
    Gone,
    /// The candidate's shadow is decided.
    Decided,
    /// The concern about the active version is settled.
    Cleared(CapabilityId),
    /// The active version is not cleared, for this reason.
    NotCleared(CapabilityId, Option<Box<Reason>>),
    /// The evaluation of the active version has taken the wall time that the profile allows.
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
    mut run: Box<ReEvaluationRun>,
) -> Result<ReEvaluationStep, EngineFault> {
    let id = run.id.clone();
    if run.shadow.is_none() && record.version_table().version(&id)?.1.state != State::Active {
        return Ok(ReEvaluationStep::Gone);
    }
    let candidate = record.capability(&id)?;
    if run.shadow.is_some() && binding(context, record.version_table(), &candidate) != run.binding {
        abort_stage(record, evidence_files, &id, Notice::ActiveOrProfileChanged)?;
        return Ok(ReEvaluationStep::Gone);
    }
    if let Some(excess) = evidence_files.spent_time(&id, &context.profile) {
        trials.drop_announced()?;
        let Some(shadow) = run.shadow else {
            let reason = note_spent_time(context, record, evidence_files, &id, &excess);
            return Ok(ReEvaluationStep::TimeSpent(id, Box::new(reason)));
        };
        evidence_files.edit(&id).time_excess = Some(excess);
        shadow::decide_after_re_evaluation(context, record, evidence_files, shadow)?;
        return Ok(ReEvaluationStep::Decided);
    }
    if run.evaluation.is_refuted() {
        invalidate_cache(record, trials, &id, &run.before.id(), run.evaluation.reuse())?;
        run.evaluation = Evaluation::new(
            EvaluationPlan::re_evaluation(&context.profile),
            run.binding,
            SceneStops::default(),
        );
        return Ok(ReEvaluationStep::GoOn(run, 0));
    }
    if run.is_over() {
        let place = trials.result_cache(record.version_table().store()).place();
        return conclude(context, record, evidence_files, run, place);
    }
    let comparison = ComparisonSlice {
        id: &id,
        compared_with: &run.before,
        cell: &run.cell,
        plan: EvaluationPlan::re_evaluation(&context.profile),
        seeds: run.seeds,
        stage: Stage::Shadow,
        name_of: WorkUnit::of_re_evaluation,
    };
    let episodes = run_slice(context, trials, record, evidence_files, &comparison, &mut run.evaluation)?;
    Ok(ReEvaluationStep::GoOn(run, episodes))
}

/// Keeps what came of it, and decides shadow if it is part of one.
fn conclude(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    run: Box<ReEvaluationRun>,
    place: CacheLocation,
) -> Result<ReEvaluationStep, EngineFault> {
    let ReEvaluationRun { id, drift, evaluation, shadow, .. } = *run;
    let pairs = evaluation.paired();
    let (behavior, _) = evaluation.assess(&context.profile);
    let handovers = evaluation.sequences().cloned();
    let again =
        ReEvaluationEvidence { drift, pairs, handovers, behavior, kept: evaluation.reuse().on_record(place) };
    let evidence_file = evidence_files.edit(&id);
    evidence_file.progress = None;
    if let Some(shadow) = shadow {
        evidence_file.again = Some(again);
        shadow::decide_after_re_evaluation(context, record, evidence_files, shadow)?;
        return Ok(ReEvaluationStep::Decided);
    }
    let Some(suspicion) = &mut evidence_file.suspicion else {
        return Err(EngineFault::Impossible(format!("{id} was re-evaluated and has no concern")));
    };
    suspicion.again = Some(again.clone());
    record.write(vec![suspicion.evidence(&id)?], Vec::new())?;
    let count = again.pairs.pairs.len();
    let reasons = re_evaluation_reasons(&again.behavior, count, Dimension::Monitor);
    let cleared = is_cleared(&again.behavior);
    let decision = if cleared { MonitorOutcome::Settled } else { MonitorOutcome::DoubtRemains };
    let why = reasons.first().cloned().map(Box::new);
    record.tell(EventKind::Monitor { version: id.clone(), decision, reasons: reasons.clone() });
    if cleared {
        return Ok(ReEvaluationStep::Cleared(id));
    }
    evidence_files.edit(&id).reasons = reasons;
    Ok(ReEvaluationStep::NotCleared(id, why))
}
