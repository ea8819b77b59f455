//! The live world: the cell that works on under the active versions while candidates are judged.
//!
//! It differs from the sandbox by design (held-out seeds, asynchronous observations, longer latency,
//! correlated noise, clutter, whole sequences). Shadow and monitoring both listen here.

use holdpoint_sim::SimError;
use holdpoint_sim::distribution::{Distribution, Drift};
use holdpoint_sim::episode::EpisodeSetup;
use holdpoint_sim::io::TaskKind;
use holdpoint_sim::world::World;
use serde::{Deserialize, Serialize};

use super::cell::Cell;
use crate::runtime::agent::dispatcher::{DispatchError, Dispatched, Refused};
use crate::runtime::agent::{ActiveView, Agent, Goal};
use crate::runtime::arm::Arm;
use crate::runtime::capability::Capability;
use crate::runtime::task::{Supervision, Tick};
use crate::runtime::terms::Terms;

/// One sequence of the live world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SequenceReport {
    /// The seed.
    pub seed: u64,
    /// The tasks that were worked, in order; a failed one ends the sequence.
    pub tasks: Vec<Dispatched>,
    /// Why a task was not started.
    pub refused: Option<Refused>,
    /// The simulator failed; what came before still counts.
    pub failed: bool,
    /// Simulated time, ms.
    pub duration_ms: u64,
}

impl SequenceReport {
    /// The record of a primitive, where it was worked.
    #[must_use]
    pub fn task(&self, task: TaskKind) -> Option<&Dispatched> {
        self.tasks.iter().find(|dispatched| dispatched.record.task == task)
    }

    /// Whether the whole sequence was done.
    #[must_use]
    pub fn succeeded(&self) -> bool {
        self.tasks.len() == TaskKind::SEQUENCE.len() && self.tasks.iter().all(|done| done.record.success)
    }
}

/// Called around the live tasks.
pub trait Listener {
    /// A task is about to start on this world.
    fn before_task(&mut self, world: &World, task: TaskKind, seed: u64);
    /// One tick of it passed.
    fn tick(&mut self, task: TaskKind, passed: &Tick<'_>) -> Supervision;
}

/// Listens to nothing.
pub struct Nobody;

impl Listener for Nobody {
    fn before_task(&mut self, _: &World, _: TaskKind, _: u64) {}
    fn tick(&mut self, _: TaskKind, _: &Tick<'_>) -> Supervision {
        Supervision::Continue
    }
}

/// The live cell with its arm and its agent.
pub struct LiveCell {
    cell: Cell,
    arm: Arm<World>,
    agent: Agent,
    distribution: Distribution,
    drift: Option<Drift>,
    sequences: u64,
}

impl LiveCell {
    /// A live cell at rest.
    ///
    /// # Errors
    /// Where the world cannot be built.
    pub fn new(cell: Cell) -> Result<Self, SimError> {
        let arm = Arm::new(cell.world()?);
        let distribution = (*cell.live).clone();
        Ok(Self { cell, arm, agent: Agent::default(), distribution, drift: None, sequences: 0 })
    }

    /// Sets in a drift, or ends it.
    ///
    /// # Errors
    /// Where the drifted distribution is not valid.
    pub fn set_drift(&mut self, drift: Option<Drift>) -> Result<(), SimError> {
        self.distribution = match &drift {
            None => (*self.cell.live).clone(),
            Some(drift) => self.cell.live.with_drift(drift)?,
        };
        self.drift = drift;
        Ok(())
    }

    /// The drift that has set in.
    #[must_use]
    pub const fn drift(&self) -> Option<&Drift> {
        self.drift.as_ref()
    }

    /// The agent.
    #[must_use]
    pub const fn agent(&self) -> &Agent {
        &self.agent
    }

    /// Sequences worked so far.
    #[must_use]
    pub const fn sequences(&self) -> u64 {
        self.sequences
    }

    /// The body, for the ladder between tasks.
    pub(super) const fn body_mut(&mut self) -> &mut World {
        self.arm.body_mut()
    }

    /// The body, to look at.
    #[must_use]
    pub const fn world(&self) -> &World {
        self.arm.body()
    }

    /// Works one pick-align-place sequence.
    pub fn run_sequence<V: ActiveView>(
        &mut self,
        view: &V,
        terms: &dyn Fn(&Capability) -> Terms,
        seed: u64,
        listener: &mut dyn Listener,
    ) -> SequenceReport {
        let mut report =
            SequenceReport { seed, tasks: Vec::new(), refused: None, failed: false, duration_ms: 0 };
        let setup = EpisodeSetup::sample(TaskKind::Grasp, &self.cell.scene, &self.distribution, seed);
        self.sequences += 1;
        if self.arm.body_mut().reset(&setup).is_err() {
            report.failed = true;
            return report;
        }
        for task in Goal::PickAlignPlace.plan() {
            self.arm.body_mut().begin_task(task);
            listener.before_task(self.arm.body(), task, seed);
            let worked = self.agent.dispatch(view, &mut self.arm, terms, task, seed, &mut |_, passed| {
                listener.tick(task, passed)
            });
            match worked {
                Ok(dispatched) => {
                    let done = dispatched.record.success;
                    report.tasks.push(dispatched);
                    if !done {
                        break;
                    }
                }
                Err(DispatchError::Refused(refused)) => {
                    report.refused = Some(refused);
                    break;
                }
                Err(DispatchError::Body(_)) => {
                    report.failed = true;
                    break;
                }
            }
        }
        // Simulated seconds of one sequence are far below the range of the conversion.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let duration_ms = (self.arm.body().sim_secs() * 1000.0) as u64;
        report.duration_ms = duration_ms;
        report
    }
}
