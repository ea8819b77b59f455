//! Stage 4: shadow. The candidate beside the live work, at two depths; no actuator handle.

use holdpoint_cell::TrialCell;
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::composition::psi_after_shadow;
use holdpoint_governance::condition::shadow_needed;
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::distribution_shift::{apply_re_evaluation, compare_with_sandbox, is_suspicious};
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::gate::assess_shadow;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{LifecycleEvent, Stage};
use holdpoint_governance::notice::Notice;
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::shared_event::SceneKind;
use holdpoint_protocol::work_unit::WorkUnit;
use holdpoint_store::{Batch, EvidenceKind, OpenStore};
use holdpoint_trials::scene_stops::SceneStops;

use super::closing::{abort_stage, progress, put_on_hold, reject, stage_note, tell_decided};
use super::shared_stops::keep_stops;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use crate::live::monitors::{Monitors, terms_of};
use crate::live::shadow::{Shadow, ShadowTrace};
use crate::live::twin_start::missing_abilities;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{binding, made_under};
use holdpoint_record::evidence_file::EvidenceFiles;

/// Live sequences tried for one usable shadow sequence: the live world may not reach the task.
const ATTEMPTS_FACTOR: u32 = 6;

/// Shadowed sequences in one telemetry batch: far below its size limit with every path kept.
const TRACES_A_BATCH: usize = 20;

/// A shadow deployment under way.
pub struct ShadowRun {
    pub(crate) id: CapabilityId,
    binding: EvidenceBinding,
    fork: Option<Box<dyn TrialCell>>,
    tried: u32,
    budget: u32,
    /// Hard stops so far, those of the sandbox included.
    stops: SceneStops,
    traces: Vec<ShadowTrace>,
}

/// Begins the shadow of a candidate. A version in doubt is looked at as long as the profile allows.
///
/// # Errors
/// If the start cannot be written, or the twin's world not be built.
pub fn begin(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    id: &CapabilityId,
) -> Result<Box<ShadowRun>, EngineFault> {
    let settings = &context.profile.evaluation;
    let plain = if evidence_files.has_open_concern(id) {
        settings.shadow_sequences_max
    } else {
        settings.shadow_sequences
    };
    let budget =
        plain.max(evidence_files.of(id).map_or(0, |evidence_file| shadow_needed(&evidence_file.conditions)));
    record.start_stage(id, Stage::Shadow, u64::from(budget))?;
    let candidate = record.capability(id)?;
    let binding = binding(context, record.version_table(), &candidate);
    let evidence_file = evidence_files.edit(id);
    evidence_file.clear_shadow();
    evidence_file.missing = missing_abilities(context.cell.spec.abilities);
    evidence_file.again = None;
    evidence_file.time_excess = None;
    // What it was suspected of when it was active before is not what this shadow shows.
    evidence_file.suspicion = None;
    evidence_file.bindings.push(binding);
    let stops = SceneStops {
        own: evidence_file.hard_stops.clone(),
        shared: evidence_file.shared_events.clone(),
        uncompared: evidence_file.uncompared_stops.clone(),
    };
    let fork = Some(context.cell.trial()?);
    Ok(Box::new(ShadowRun { id: id.clone(), binding, fork, tried: 0, budget, stops, traces: Vec::new() }))
}

/// What goes along with the next sequence; `None` if the stage cannot go on and was aborted.
///
/// # Errors
/// If the twin's world cannot be built, or the abort not be written.
pub fn take_along(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    monitors: &Monitors,
    run: &mut ShadowRun,
) -> Result<Option<Shadow>, EngineFault> {
    let candidate = record.capability(&run.id)?;
    if binding(context, record.version_table(), &candidate) != run.binding {
        abort_stage(record, evidence_files, &run.id, Notice::ActiveOrProfileChanged)?;
        return Ok(None);
    }
    let fork = match run.fork.take() {
        Some(fork) => fork,
        None => context.cell.trial()?,
    };
    let terms = terms_of(context, record.version_table(), evidence_files, monitors, &candidate);
    Ok(Some(Shadow::new(candidate, terms, fork)))
}

/// How a sequence of shadow ended.
pub enum ShadowStep {
    /// It continues.
    GoOn(Box<ShadowRun>),
    /// The candidate's behavior shifted: it is re-evaluated before any decision.
    ReEvaluate(Box<ShadowRun>),
    /// It is decided.
    Over,
}

/// Takes in what the candidate did in one sequence.
///
/// # Errors
/// If the end of the stage cannot be written.
pub fn take_in(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    mut run: Box<ShadowRun>,
    trace: Option<ShadowTrace>,
    fork: Option<Box<dyn TrialCell>>,
) -> Result<ShadowStep, EngineFault> {
    let id = run.id.clone();
    run.fork = fork;
    run.tried += 1;
    let evidence_file = evidence_files.edit(&id);
    if let Some(trace) = trace {
        evidence_file.sequences.extend(trace.values);
        evidence_file.outputs.extend(trace.outputs);
        if let Some(twin) = &trace.twin {
            evidence_file.twins.extend(twin.values());
            run.stops.note(SceneKind::Shadow, twin, &trace.live, &context.profile);
        }
        run.traces.push(trace);
    }
    if let Some(active) = record.active_of(&id.family) {
        keep_stops(context, record, evidence_file, (&id, &active.id()), &run.stops);
    }
    let stopped = !evidence_file.hard_stops.is_empty();
    let done = u32::try_from(run.traces.len()).unwrap_or(u32::MAX);
    let whole = (u64::from(done), u64::from(run.budget));
    progress(record, evidence_files, &id, Stage::Shadow, (WorkUnit::ShadowSequences, None), whole);
    if done < run.budget && run.tried < ATTEMPTS_FACTOR * run.budget && !stopped {
        return Ok(ShadowStep::GoOn(run));
    }
    decide(context, record, evidence_files, run)
}

/// Decides the shadow of a candidate that was re-evaluated, or whose re-evaluation took too long.
///
/// # Errors
/// If the end of the stage cannot be written.
pub fn decide_after_re_evaluation(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    run: Box<ShadowRun>,
) -> Result<(), EngineFault> {
    match decide(context, record, evidence_files, run)? {
        ShadowStep::Over => Ok(()),
        ShadowStep::GoOn(run) | ShadowStep::ReEvaluate(run) => {
            Err(EngineFault::Impossible(format!("{} is in shadow after its re-evaluation", run.id)))
        }
    }
}

fn decide(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_files: &mut EvidenceFiles,
    mut run: Box<ShadowRun>,
) -> Result<ShadowStep, EngineFault> {
    let id = run.id.clone();
    let profile = &context.profile;
    let evidence_file = evidence_files.edit(&id);
    let evidence = evidence_file.shadow_evidence(run.binding);
    let mut result = assess_shadow(&evidence, &run.binding, profile);
    compare_with_sandbox(&mut result, &evidence, &evidence_file.pairs, profile);
    let longest = profile.evaluation.shadow_sequences_max;
    let lengthened = run.budget >= longest;
    if result.check == CheckResult::Inconclusive
        && !lengthened
        && (evidence.sequences.len() + evidence.outputs.len()) as u64 >= u64::from(run.budget)
    {
        // Output or envelope divergence decide nothing by themselves: they make shadow longer.
        run.budget = longest;
        return Ok(ShadowStep::GoOn(run));
    }
    if is_suspicious(&result) {
        match (&evidence_file.again, &evidence_file.time_excess) {
            (Some(again), _) => apply_re_evaluation(&mut result, &again.behavior, again.pairs.pairs.len()),
            (None, Some(excess)) => excess.leave_open(&mut result, profile),
            (None, None) => return Ok(ShadowStep::ReEvaluate(run)),
        }
    }
    let candidate = record.capability(&id)?;
    evidence_file.shadow = Some(result.clone());
    let Some(kappas) = evidence_file.kappas.clone() else {
        return Err(EngineFault::Impossible(format!("{id} reached shadow without an assessment")));
    };
    let digest = evidence_file.digest()?;
    let under = made_under(context, record.version_table(), &candidate, digest);
    let decision = psi_after_shadow(&kappas, profile.has_approver(), under, result.check);
    evidence_file.reasons.clone_from(&result.reasons);
    evidence_file.progress = None;
    evidence_file.deployment = decision.answers().deployment;
    let found = (result.check.into(), result.reasons.as_slice());
    tell_decided(context, record, evidence_file, (&id, Stage::Shadow), found);
    let reason = match result.reasons.first() {
        Some(reason) => Notice::decided(Some(reason)),
        None => Notice::ShadowPassed,
    };
    let note = stage_note(evidence_file, &id, EvidenceKind::Shadow, reason, &decision)?;
    let is_shift = |reason: &&Reason| reason.code == ReasonCode::ShadowShifted;
    let reasons: Vec<Reason> = result.reasons.iter().filter(is_shift).cloned().collect();
    if !reasons.is_empty() {
        let notice = Notice::Shifted { version: Some(id.clone()), reasons };
        record.raise(AlarmKey::Shifted(id.clone()), profile.alarms.degraded, true, notice);
    }
    let store = record.version_table().store();
    keep_traces(store, &id, &run.traces, record.now_ms())?;
    let (version, _, _) = record.version_table().version(&id)?;
    match result.check {
        CheckResult::Pass | CheckResult::PassRestricted(_) => {
            record.transition(&id.family, LifecycleEvent::Pass { version, stage: Stage::Shadow }, note)?;
        }
        CheckResult::Fail => reject(record, &id, note)?,
        CheckResult::Review | CheckResult::Inconclusive | CheckResult::NoData | CheckResult::Skipped => {
            put_on_hold(record, &id, note)?;
        }
    }
    Ok(ShadowStep::Over)
}

/// Keeps every shadowed sequence with both outputs, the comparison and its context (paper appendix F.2). The
/// paths stay with the sequences in which the two worlds did not agree.
fn keep_traces(
    store: &dyn OpenStore,
    id: &CapabilityId,
    traces: &[ShadowTrace],
    at_ms: u64,
) -> Result<(), EngineFault> {
    for some in traces.chunks(TRACES_A_BATCH) {
        let rows: Vec<ShadowTrace> = some.iter().cloned().map(ShadowTrace::without_equal_paths).collect();
        let batch = Batch {
            version: id.clone(),
            stream: Stage::Shadow.name().to_owned(),
            from_ms: at_ms,
            to_ms: at_ms,
            rows: rows.len() as u64,
            body: serde_json::to_vec(&rows)?,
        };
        store.append_telemetry(&batch)?;
    }
    Ok(())
}
