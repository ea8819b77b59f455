//! A suspicious version is worked again, in the live world's conditions.
//!
//! Suspicious is a candidate that is in its longest shadow not what the sandbox showed, and an active version that is live
//! not what its shadow showed (governance's `shift`). What differs may be the noise, which a skill can know the sandbox by,
//! or chance. So the sandbox's pairs and sequences are worked once more, on seeds nobody has seen, under the live world's
//! distribution as it is then, drift included: the candidate beside the active version before anything is decided, the active
//! one beside its predecessor. There is nothing to compare a first version with, and nobody to give the arm to.

use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::evidence::Binding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::kept::KeptPlace;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::shift::{is_cleared, worked_again};
use holdpoint_protocol::event::EventKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_sim::distribution::Drift;

use super::closing::{abort_stage, progress};
use super::compared::{Compared, work_slice};
use super::shadow::{self, ShadowRun};
use super::voided::void;
use crate::binding::binding;
use crate::cell::{Cell, Conditions};
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::doubt::WorkedAgain;
use crate::fault::Fault;
use crate::monitors::Monitors;
use crate::record::Record;
use crate::trial::Trials;
use crate::trial::evaluation::{Evaluation, Plan};
use crate::world::live::LiveCell;

/// What it is called in a progress.
const WHAT: &str = "suspicious: worked again";

/// A suspicious version that is being worked again.
pub struct AgainRun {
    id: CapabilityId,
    before: Capability,
    binding: Binding,
    cell: Cell,
    drift: Option<Drift>,
    evaluation: Evaluation,
    /// The shadow that found a candidate suspicious; absent for an active version.
    shadow: Option<Box<ShadowRun>>,
}

impl AgainRun {
    #[must_use]
    pub const fn id(&self) -> &CapabilityId {
        &self.id
    }

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

/// The first active version that is suspicious, and has not been worked again yet.
#[must_use]
pub fn next(monitors: &Monitors, dossiers: &Dossiers) -> Option<CapabilityId> {
    monitors.iter().map(|watched| &watched.id).find(|id| dossiers.is_suspicious(id)).cloned()
}

/// Begins it: of a candidate with the shadow that found it suspicious, of an active version without. Absent if there is no
/// version to compare it with.
///
/// # Errors
/// If there is no such version.
pub fn begin(
    context: &Context,
    record: &mut Record,
    dossiers: &mut Dossiers,
    live: &LiveCell,
    id: &CapabilityId,
    shadow: Option<Box<ShadowRun>>,
) -> Result<Option<Box<AgainRun>>, Fault> {
    let candidate = record.capability(id)?;
    let entry = record.ledger().family(&id.family)?;
    let (_, standing, _) = record.ledger().version(id)?;
    let before = match (&shadow, standing.predecessor) {
        (Some(_), _) => entry.active().map(|active| active.capability.clone()),
        (None, Some(predecessor)) => {
            entry.members.get(usize::from(predecessor.0)).map(|member| member.capability.clone())
        }
        (None, None) => None,
    };
    let Some(before) = before else { return Ok(None) };
    let binding = Binding { active: Some(before.digest()), ..binding(context, record.ledger(), &candidate) };
    let plan = Plan::again(&context.profile);
    progress(record, dossiers, id, Stage::Shadow, WHAT, (0, plan.budget()));
    Ok(Some(Box::new(AgainRun {
        id: id.clone(),
        before,
        binding,
        cell: context.cell.with_live_sandbox(live.distribution()),
        drift: live.drift().copied(),
        evaluation: Evaluation::new(plan, binding, Vec::new()),
        shadow,
    })))
}

/// How a slice ended.
pub enum AgainStep {
    /// It goes on, with so many episodes worked.
    GoOn(Box<AgainRun>, u64),
    /// What the version was to be compared with, or the version itself, is gone.
    Gone,
    /// The candidate's shadow is decided.
    Decided,
    /// The active version is what it was taken for.
    Cleared(CapabilityId),
    /// The active version is not cleared, for this reason.
    NotCleared(CapabilityId, String),
}

/// One slice of a run.
///
/// # Errors
/// If a worker fails, or what came of it cannot be written.
pub fn slice(
    context: &Context,
    trials: &Trials,
    record: &mut Record,
    dossiers: &mut Dossiers,
    monitors: &Monitors,
    mut run: Box<AgainRun>,
) -> Result<AgainStep, Fault> {
    let id = run.id.clone();
    if run.shadow.is_none() && monitors.of(&id).is_none() {
        return Ok(AgainStep::Gone);
    }
    let candidate = record.capability(&id)?;
    if run.shadow.is_some() && binding(context, record.ledger(), &candidate) != run.binding {
        abort_stage(record, dossiers, &id, "the active version or the profile changed meanwhile")?;
        return Ok(AgainStep::Gone);
    }
    if run.evaluation.is_refuted() {
        void(record, trials, &id, &run.before.id(), run.evaluation.reuse())?;
        run.evaluation = Evaluation::new(Plan::again(&context.profile), run.binding, Vec::new());
        return Ok(AgainStep::GoOn(run, 0));
    }
    if run.is_over() {
        let place = trials.cells(record.ledger().store()).place();
        return conclude(context, record, dossiers, run, place);
    }
    let compared = Compared {
        id: &id,
        with: &run.before,
        cell: &run.cell,
        conditions: Conditions::Live,
        plan: Plan::again(&context.profile),
        stage: Stage::Shadow,
        what: WHAT,
    };
    let worked = work_slice(context, trials, record, dossiers, &compared, &mut run.evaluation)?;
    Ok(AgainStep::GoOn(run, worked))
}

/// Keeps what came of it, and decides shadow if it is part of one.
fn conclude(
    context: &Context,
    record: &mut Record,
    dossiers: &mut Dossiers,
    run: Box<AgainRun>,
    place: KeptPlace,
) -> Result<AgainStep, Fault> {
    let AgainRun { id, drift, evaluation, shadow, .. } = *run;
    let pairs = evaluation.paired();
    let (behavior, _) = evaluation.assess(&context.profile);
    let handovers = evaluation.sequences().cloned();
    let again = WorkedAgain { drift, pairs, handovers, behavior, kept: evaluation.reuse().on_record(place) };
    let dossier = dossiers.edit(&id);
    dossier.progress = None;
    if let Some(shadow) = shadow {
        dossier.again = Some(again);
        shadow::decide_again(context, record, dossiers, shadow)?;
        return Ok(AgainStep::Decided);
    }
    let Some(suspicion) = &mut dossier.suspicion else {
        return Err(Fault::Impossible(format!("{id} was worked again and is not suspicious")));
    };
    suspicion.again = Some(again.clone());
    record.write(vec![suspicion.evidence(&id)?], Vec::new())?;
    let (code, count) = (ReasonCode::MonitorWorkedAgain, again.pairs.pairs.len());
    let reasons = worked_again(&again.behavior, count, code, Dimension::Monitor);
    let cleared = is_cleared(&again.behavior);
    let decision = if cleared { MonitorOutcome::Settled } else { MonitorOutcome::DoubtRemains };
    let why = reasons.first().map(|reason| reason.text.clone()).unwrap_or_default();
    record.tell(EventKind::Monitor { version: id.clone(), decision, reasons: reasons.clone() });
    if cleared {
        return Ok(AgainStep::Cleared(id));
    }
    dossiers.edit(&id).reasons = reasons;
    Ok(AgainStep::NotCleared(id, why))
}
