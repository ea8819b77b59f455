//! The live world: the cell that works on under the active versions while candidates are judged.
//!
//! It differs from the sandbox by design (held-out seeds, asynchronous observations, longer latency,
//! correlated noise, clutter, whole sequences). Shadow and monitoring both listen here.

use std::sync::Arc;

use holdpoint_body::disturbance::Drift;
pub use holdpoint_body::disturbance::LiveFault;
use holdpoint_body::{BodyError, Interrupt, TaskKind};
use holdpoint_cell::{
    CellCopy, CellError, Distribution, InjectedFault, LiveCell, RefereeLimits, RefereeReport, WorkCall,
};
use serde::{Deserialize, Serialize};

use super::instrumented::InstrumentedWorld;
use super::listener::Listener;
use super::stop_switch::StopSwitch;
use super::supervisor::SequenceSupervisor;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::start_domain::DomainMiss;
use holdpoint_protocol::clock::ms_of;
use holdpoint_runtime::agent::dispatcher::{DispatchError, DispatchRefusal, DispatchedTask};
use holdpoint_runtime::agent::{AbandonedGoal, ActiveView, Agent, Goal};
use holdpoint_runtime::arm::{ActuatorHandle, Arm};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::{Supervision, TaskRecord, Tick};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell::Cell;

/// Ground truth of a task: its sequence, the version at work, what the referee saw.
pub type TaskTruth = (u64, CapabilityId, RefereeReport);

/// The most verdicts kept until they are read.
const VERDICTS_MAX: usize = 100_000;

/// One sequence of the live world.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SequenceReport {
    pub seed: u64,
    /// The tasks that were called for, in order; a failed one ends the sequence, and so does one that was refused or in
    /// which the cell failed.
    pub tasks: Vec<DispatchedTask>,
    /// Why a task was not started.
    pub refused: Option<DispatchRefusal>,
    /// Tasks that the active version was not given, because its evidence does not cover their start.
    pub outside: Vec<OutsideStart>,
    /// The cell failed; what came before still counts.
    pub failed: bool,
    /// Why the cell does not answer any more, or stopped by itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost: Option<String>,
    /// Simulated time, ms.
    pub duration_ms: u64,
    /// Primitives the agent had planned for it.
    pub planned: usize,
}

/// A task that the active version was not given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutsideStart {
    /// The active version.
    pub id: CapabilityId,
    /// How the start lies outside the domain of its evidence.
    pub missed: Vec<DomainMiss>,
    /// The version that ran the task in its place; absent if the task was refused.
    pub run_by: Option<CapabilityId>,
}

impl SequenceReport {
    /// The record of a primitive, if it was worked.
    #[must_use]
    pub fn task(&self, task: TaskKind) -> Option<&DispatchedTask> {
        self.tasks.iter().find(|dispatched| dispatched.record.task == task)
    }

    /// Whether the whole sequence was done.
    #[must_use]
    pub fn succeeded(&self) -> bool {
        self.planned > 0
            && self.tasks.len() == self.planned
            && self.tasks.iter().all(|done| done.record.success)
    }
}

/// The arm with its body and the agent, which run a sequence. There is one, held by its [`LiveStation`] or by the
/// [`RunningSequence`].
pub(crate) struct Rig {
    arm: Arm<InstrumentedWorld>,
    agent: Agent,
    verdicts: Vec<TaskTruth>,
}

impl Rig {
    /// The body, for the ladder between tasks.
    pub(crate) const fn arm_mut(&mut self) -> &mut Arm<InstrumentedWorld> {
        &mut self.arm
    }

    /// The body, to look at.
    pub(crate) fn world(&self) -> &dyn LiveCell {
        self.arm.body().world()
    }

    /// As [`Agent::give_up`].
    pub(crate) fn give_up(&mut self) -> AbandonedGoal {
        self.agent.give_up()
    }
}

/// The live cell with its arm and its agent.
pub struct LiveStation {
    cell: Cell,
    rig: Option<Box<Rig>>,
    switch: Arc<StopSwitch>,
    agent: Digest,
    distribution: Arc<Distribution>,
    drift: Option<Drift>,
    pub(crate) fault: Option<LiveFault>,
    /// The agent's goal from the next sequence on.
    pub(crate) goal: Goal,
    sequences: u64,
}

/// A sequence about to be worked, with all it takes; it may be worked on another thread.
pub(crate) struct RunningSequence {
    rig: Box<Rig>,
    distribution: Arc<Distribution>,
    fault: Option<LiveFault>,
    goal: Goal,
    sequence: u64,
    starts: Vec<TaskStart>,
}

/// The live world where a version began a task.
pub(crate) struct TaskStart {
    pub(crate) id: CapabilityId,
    pub(crate) task: TaskKind,
    pub(crate) world: Arc<CellCopy>,
}

impl LiveStation {
    /// A live cell at rest.
    ///
    /// # Errors
    /// If the world cannot be built.
    pub fn new(cell: Cell) -> Result<Self, CellError> {
        Self::with(cell, Arc::default())
    }

    /// As [`Self::new`], stopped by this switch.
    pub(crate) fn with(cell: Cell, switch: Arc<StopSwitch>) -> Result<Self, CellError> {
        let arm = Arm::new(InstrumentedWorld::new(cell.live_cell()?, Arc::clone(&switch)));
        let distribution = Arc::clone(&cell.live);
        let rig = Rig { arm, agent: Agent::new(cell.spec.tasks.clone()), verdicts: Vec::new() };
        Ok(Self {
            cell,
            agent: rig.agent.identity_hash(),
            rig: Some(Box::new(rig)),
            switch,
            distribution,
            drift: None,
            fault: None,
            goal: Goal::default(),
            sequences: 0,
        })
    }

    /// Stops the arm, from any thread.
    pub(crate) fn switch(&self) -> Arc<StopSwitch> {
        Arc::clone(&self.switch)
    }

    /// Whether the arm's telemetry reaches the monitors.
    #[must_use]
    pub fn link_is_up(&self) -> bool {
        self.fault != Some(LiveFault::TelemetryLost)
    }

    /// From now on a referee looks on, for a report.
    pub fn call_referee(&mut self, limits: RefereeLimits) {
        if let Some(rig) = &mut self.rig {
            rig.arm.body_mut().call_referee(limits);
        }
    }

    /// Ground truth since the last call, task by task; empty if no referee looks on.
    pub fn take_verdicts(&mut self) -> Vec<TaskTruth> {
        self.rig.as_mut().map(|rig| std::mem::take(&mut rig.verdicts)).unwrap_or_default()
    }

    /// Goes on with another sequence number, so that a copy of a store meets episodes of its own.
    pub const fn skip_to(&mut self, sequence: u64) {
        self.sequences = sequence;
    }

    /// Lets a drift set in, or ends it, from the next sequence on.
    ///
    /// # Errors
    /// If the drifted distribution is not valid.
    pub fn set_drift(&mut self, drift: Option<Drift>) -> Result<(), CellError> {
        self.distribution = match &drift {
            None => Arc::clone(&self.cell.live),
            Some(drift) => Arc::new(self.cell.with_drift(&self.cell.live, drift)?),
        };
        self.drift = drift;
        Ok(())
    }

    /// The conditions of the next sequence.
    #[must_use]
    pub(crate) const fn distribution(&self) -> &Arc<Distribution> {
        &self.distribution
    }

    /// The drift that has set in.
    #[must_use]
    pub const fn drift(&self) -> Option<&Drift> {
        self.drift.as_ref()
    }

    /// Hash of the identity of the agent that dispatches; of the one that set out, while a sequence has it.
    #[must_use]
    pub fn agent_hash(&self) -> Digest {
        self.rig.as_ref().map_or(self.agent, |rig| rig.agent.identity_hash())
    }

    /// Another agent, to try what a changed one does.
    #[cfg(test)]
    pub(crate) fn replace_agent(&mut self, agent: Agent) {
        if let Some(rig) = &mut self.rig {
            rig.agent = agent;
        }
    }

    /// The tasks of the cell, in their order.
    #[must_use]
    pub fn tasks(&self) -> &[TaskKind] {
        &self.cell.spec.tasks
    }

    /// Sequences begun so far.
    #[must_use]
    pub const fn sequences(&self) -> u64 {
        self.sequences
    }

    /// Arm and agent; absent while a sequence has them.
    pub(crate) fn rig_mut(&mut self) -> Option<&mut Rig> {
        self.rig.as_deref_mut()
    }

    /// Gives arm and agent to one sequence; `None` if another has them.
    pub(crate) fn start_sequence(&mut self) -> Option<RunningSequence> {
        let rig = self.rig.take()?;
        let sequence = self.sequences;
        self.sequences += 1;
        Some(RunningSequence {
            rig,
            distribution: Arc::clone(&self.distribution),
            fault: self.fault,
            goal: self.goal,
            sequence,
            starts: Vec::new(),
        })
    }

    /// Takes arm and agent back.
    pub(crate) fn take_back(&mut self, running: RunningSequence) {
        self.rig = Some(running.rig);
    }

    /// Works one pick-align-place sequence, under the monitors if a supervisor stands for them.
    pub fn run_sequence<V: ActiveView>(
        &mut self,
        view: &V,
        terms: &dyn Fn(&Capability) -> SkillTerms,
        seed: u64,
        listener: &mut dyn Listener,
        supervisor: Option<&mut SequenceSupervisor>,
    ) -> SequenceReport {
        let Some(mut running) = self.start_sequence() else {
            return SequenceReport { seed, failed: true, ..SequenceReport::default() };
        };
        let report = running.run(view, terms, seed, listener, supervisor);
        self.take_back(running);
        report
    }
}

impl RunningSequence {
    pub(crate) fn run<V: ActiveView>(
        &mut self,
        view: &V,
        terms: &dyn Fn(&Capability) -> SkillTerms,
        seed: u64,
        listener: &mut dyn Listener,
        mut supervisor: Option<&mut SequenceSupervisor>,
    ) -> SequenceReport {
        let mut report = SequenceReport { seed, ..SequenceReport::default() };
        let Rig { arm, agent, verdicts } = &mut *self.rig;
        let world = arm.body_mut().world_mut();
        let presented = world.await_work(&WorkCall { conditions: &self.distribution, seed });
        let lost = self.fault == Some(LiveFault::CameraLost);
        let ready =
            presented.and_then(|()| if lost { world.inject(InjectedFault::CameraLost) } else { Ok(()) });
        if let Err(error) = ready {
            report.failed = true;
            if let CellError::Body(BodyError::Lost(reason)) = error {
                report.lost = Some(reason);
            }
            let first = self.goal.plan(agent.sequence()).first().copied();
            let called = first.and_then(|task| Some((task, view.active(&Agent::select(task))?)));
            report.tasks.extend(called.map(|(task, active)| DispatchedTask {
                id: active.id(),
                record: TaskRecord::invalid(task, seed),
            }));
            return report;
        }
        arm.body_mut().verdict();
        agent.take_up(self.goal);
        report.planned = self.goal.plan(agent.sequence()).len();
        while let Some(task) = agent.next_task() {
            arm.body_mut().world_mut().begin_task(task);
            let world = arm.body().world();
            listener.before_task(world, task, seed);
            let mut at_work = view.active(&Agent::select(task)).map(Capability::id);
            if supervisor.is_some()
                && let Some(id) = &at_work
                && let Ok(world) = world.copy()
            {
                self.starts.push(TaskStart { id: id.clone(), task, world: Arc::new(world) });
            }
            // The version in place of the active one, where the evidence of that one does not cover the start.
            let mut in_place: Option<&Capability> = None;
            let worked = loop {
                let started = arm.body().world().tick();
                let mut supervise = |handle: &mut ActuatorHandle<'_, InstrumentedWorld>,
                                     passed: &Tick<'_>| {
                    let halted = handle.body().is_halted();
                    let supervision = listener.tick(handle.body().world(), task, passed);
                    let watched = match (&mut supervisor, &at_work) {
                        (Some(supervisor), Some(id)) => supervisor.tick(id, started + passed.tick, passed),
                        _ => Supervision::Continue,
                    };
                    match (supervision, watched) {
                        // The body of a stopped cell takes no command, not even from a hook.
                        _ if halted => Supervision::StepIn,
                        (_, Supervision::Interrupt) => Supervision::Interrupt,
                        // Who steps in is on record as such, whatever else the monitor says in the same tick.
                        (Supervision::StepIn, _) => Supervision::StepIn,
                        (_, watched) if watched.stops() => watched,
                        (supervision, _) => supervision,
                    }
                };
                let worked = match in_place {
                    None => agent.dispatch(view, arm, terms, task, seed, &mut supervise),
                    Some(version) => {
                        let start = view.start_check(&version.id());
                        agent.dispatch_to((version, start), arm, terms, (task, seed), &mut supervise)
                    }
                };
                let Err(DispatchError::Refused(DispatchRefusal::OutsideDomain { id, missed, seen })) =
                    &worked
                else {
                    break worked;
                };
                if in_place.is_some() {
                    if let Some(outside) = report.outside.last_mut() {
                        outside.run_by = None;
                    }
                    break worked;
                }
                in_place = view.covering(&id.family, seen).filter(|_| !arm.body().is_halted());
                let run_by = in_place.map(Capability::id);
                let (id, missed) = (id.clone(), missed.clone());
                report.outside.push(OutsideStart { id, missed, run_by: run_by.clone() });
                if run_by.is_none() {
                    break worked;
                }
                at_work = run_by;
                arm.handle().interrupt(Interrupt::Release);
                arm.body_mut().world_mut().begin_task(task);
            };
            arm.body_mut().world_mut().end_task();
            let verdict = arm.body_mut().verdict();
            // A task that was not done counts against the version called, for any cause of failure.
            let mut not_done = |record: TaskRecord| {
                report.tasks.extend(at_work.clone().map(|id| DispatchedTask { id, record }));
            };
            match worked {
                Ok(dispatched) => {
                    if let Some(supervisor) = &mut supervisor {
                        supervisor.ended(&dispatched.id, &dispatched.record);
                    }
                    if verdicts.len() < VERDICTS_MAX {
                        let entry = verdict.map(|verdict| (self.sequence, dispatched.id.clone(), verdict));
                        verdicts.extend(entry);
                    }
                    let done = dispatched.record.success && !arm.body().is_halted();
                    report.tasks.push(dispatched);
                    if !done {
                        break;
                    }
                    agent.finished();
                }
                Err(DispatchError::Refused(refused)) => {
                    // A start that no evidence covers is the cell's, and speaks against no version.
                    if !matches!(refused, DispatchRefusal::OutsideDomain { .. }) {
                        not_done(TaskRecord::refused(task, seed));
                    }
                    report.refused = Some(refused);
                    break;
                }
                Err(DispatchError::Body(error)) => {
                    not_done(TaskRecord::invalid(task, seed));
                    report.failed = true;
                    if let BodyError::Lost(reason) = error {
                        report.lost = Some(reason);
                    }
                    break;
                }
            }
        }
        // Monitors count ticks: a clock behind them would be silence to them.
        report.duration_ms = ms_of(self.world().tick());
        report
    }

    /// The body, to look at.
    pub(crate) fn world(&self) -> &dyn LiveCell {
        self.rig.world()
    }

    pub(crate) const fn sequence(&self) -> u64 {
        self.sequence
    }

    /// The tasks of the cell, in their order.
    pub(crate) fn tasks(&self) -> &[TaskKind] {
        self.rig.agent.sequence()
    }

    /// Where the watched versions began their tasks, in order.
    pub(crate) fn take_starts(&mut self) -> Vec<TaskStart> {
        std::mem::take(&mut self.starts)
    }
}

#[cfg(test)]
mod tests;
