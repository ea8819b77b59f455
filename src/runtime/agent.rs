//! The persistent agent: it is given goals and sees active capabilities, and nothing else changes it.
//!
//! Goal interpreter, planner, selector and dispatcher (paper section 6.2). The agent's identity is a
//! hash over its decision policy and identity memory; no upgrade, rollback or restart changes it.
//! It reads capabilities through [`ActiveView`] only, which has no way to name a candidate.

pub mod dispatcher;

use std::collections::VecDeque;
use std::fmt;

use holdpoint_body::TaskKind;
use serde::{Deserialize, Serialize};

use crate::capability::Capability;
use crate::start_check::StartCheck;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::start_domain::StartObservation;

/// What the agent can be asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Goal {
    /// Bring the object from the table into the tray.
    #[default]
    PickAlignPlace,
    /// Up to one primitive: those before it, and this one.
    Single(TaskKind),
}

/// A request that is no goal.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{asked:?} is no goal; there are {known}")]
pub struct GoalError {
    pub asked: String,
    /// The goals that there are.
    pub known: String,
}

impl GoalError {
    fn new(asked: &str, sequence: &[TaskKind]) -> Self {
        let quoted: Vec<String> = Goal::all(sequence).map(|goal| format!("{:?}", goal.name())).collect();
        let known = match quoted.split_last() {
            Some((last, others)) if !others.is_empty() => format!("{} and {last}", others.join(", ")),
            Some(_) | None => quoted.concat(),
        };
        Self { asked: asked.to_owned(), known }
    }
}

impl Goal {
    /// Every goal of a cell with this sequence.
    pub fn all(sequence: &[TaskKind]) -> impl Iterator<Item = Self> {
        std::iter::once(Self::PickAlignPlace).chain(sequence.iter().copied().map(Self::Single))
    }

    /// The goal interpreter of a cell with this sequence.
    ///
    /// # Errors
    /// [`GoalError`] for text that is no goal there.
    pub fn interpret(text: &str, sequence: &[TaskKind]) -> Result<Self, GoalError> {
        Self::all(sequence).find(|goal| goal.name() == text).ok_or_else(|| GoalError::new(text, sequence))
    }

    /// The word that asks for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::PickAlignPlace => "pick-align-place",
            Self::Single(task) => task.name(),
        }
    }

    /// The planner: primitives of the cell's sequence, in its order. A primitive needs those before it.
    #[must_use]
    pub fn plan(self, sequence: &[TaskKind]) -> Vec<TaskKind> {
        let count = match self {
            Self::PickAlignPlace => sequence.len(),
            Self::Single(task) => sequence.iter().position(|known| *known == task).map_or(0, |last| last + 1),
        };
        sequence.iter().copied().take(count).collect()
    }
}

/// The only view of the registry an agent is given: which version is active, and what its evidence covers.
pub trait ActiveView {
    /// The active version of a family; absent while the family is safe-stopped.
    fn active(&self, family: &Family) -> Option<&Capability>;

    /// The comparison of a task's start with the evidence of this version; `None`: its start is not compared.
    fn start_check(&self, _version: &CapabilityId) -> Option<StartCheck> {
        None
    }

    /// The version that runs a task whose start the evidence of the active version does not cover; `None`: no version
    /// does.
    fn covering(&self, _family: &Family, _seen: &StartObservation) -> Option<&Capability> {
        None
    }
}

/// What never changes about an agent.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AgentIdentity {
    pub name: String,
    /// What it was made for.
    pub purpose: String,
    /// Version of the decision policy: interpreter, planner and selector.
    pub decision_policy: u32,
}

#[derive(Clone, Debug)]
pub struct Agent {
    identity: AgentIdentity,
    /// The tasks of the cell, in their order.
    sequence: Vec<TaskKind>,
    episodes: u64,
    dispatch: DispatchState,
}

/// What the agent is about to do: invocations that are planned, and the one that was begun and not finished.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct DispatchState {
    goal: Goal,
    planned: VecDeque<TaskKind>,
    in_flight: Option<TaskKind>,
}

/// What was given up of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AbandonedGoal {
    /// The invocation that was begun under the version that left; it counts as not done.
    pub in_flight: Option<TaskKind>,
    /// Invocations that were planned after it.
    pub planned: usize,
}

impl Agent {
    /// The agent of a cell with these tasks, in their order.
    #[must_use]
    pub fn new(sequence: Vec<TaskKind>) -> Self {
        Self {
            identity: AgentIdentity {
                name: "cell-agent".to_owned(),
                purpose: "pick, align and place objects in the cell".to_owned(),
                decision_policy: 1,
            },
            sequence,
            episodes: 0,
            dispatch: DispatchState::default(),
        }
    }

    /// The tasks of its cell, in their order.
    #[must_use]
    pub fn sequence(&self) -> &[TaskKind] {
        &self.sequence
    }

    /// SHA-256 over identity and decision policy: what it calls itself, and what it decides for every goal. Upgrades
    /// never change it (paper section 3.1); another interpreter, planner or selector does.
    #[must_use]
    pub fn identity_hash(&self) -> Digest {
        let version = self.identity.decision_policy.to_le_bytes();
        let decides: Vec<String> = Goal::all(&self.sequence)
            .map(|goal| {
                let plan = goal.plan(&self.sequence).into_iter();
                let steps: Vec<String> = plan.map(|task| Self::select(task).to_string()).collect();
                format!("{}: {}", goal.name(), steps.join(", "))
            })
            .collect();
        let mut parts = vec![self.identity.name.as_bytes(), self.identity.purpose.as_bytes(), &version];
        parts.extend(decides.iter().map(String::as_bytes));
        Digest::of_parts("holdpoint.agent.v2", &parts)
    }

    /// Another agent of the built-in cell, to try what a changed one does.
    #[must_use]
    #[doc(hidden)]
    pub fn called(name: &str) -> Self {
        let mut other = Self::new(TaskKind::SEQUENCE.to_vec());
        name.clone_into(&mut other.identity.name);
        other
    }

    /// Tasks dispatched so far (episodic memory).
    #[must_use]
    pub const fn episodes(&self) -> u64 {
        self.episodes
    }

    /// The selector: the family that performs a primitive.
    #[must_use]
    pub fn select(task: TaskKind) -> Family {
        Family::from(task)
    }

    /// Takes up a goal: its primitives are planned, whatever was before.
    pub fn take_up(&mut self, goal: Goal) {
        self.dispatch = DispatchState { goal, planned: goal.plan(&self.sequence).into(), in_flight: None };
    }

    /// The next invocation, which is in flight from now on; `None` if none is planned.
    pub fn next_task(&mut self) -> Option<TaskKind> {
        let task = self.dispatch.planned.pop_front()?;
        self.dispatch.in_flight = Some(task);
        Some(task)
    }

    /// The invocation in flight was done.
    pub const fn finished(&mut self) {
        self.dispatch.in_flight = None;
    }

    /// After a rollback, gives up the task in flight and the rest of the plan. Neither can continue: between two
    /// sequences the cell is set up with another object on the table and the hand empty. The active version then runs
    /// the goal from its first primitive ([`Agent::take_up`]).
    pub fn give_up(&mut self) -> AbandonedGoal {
        let DispatchState { planned, in_flight, .. } = &mut self.dispatch;
        let given_up = AbandonedGoal { in_flight: in_flight.take(), planned: planned.len() };
        planned.clear();
        given_up
    }

    pub(super) const fn note_episode(&mut self) {
        self.episodes += 1;
    }
}

impl fmt::Display for Agent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.identity.name, self.identity_hash().short())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goal_texts_are_interpreted_and_planned() {
        let plan = |text, sequence: &[TaskKind]| Goal::interpret(text, sequence).unwrap().plan(sequence);
        let shipped = TaskKind::SEQUENCE;
        assert_eq!(plan("pick-align-place", &shipped), shipped);
        assert_eq!(plan("grasp", &shipped), [TaskKind::Grasp]);
        assert_eq!(plan("align", &shipped), [TaskKind::Grasp, TaskKind::Align]);
        assert_eq!(plan("place", &shipped), shipped);
        // Of a cell without an alignment.
        let shorter = [TaskKind::Grasp, TaskKind::Place];
        assert_eq!(plan("pick-align-place", &shorter), shorter);
        assert_eq!(plan("place", &shorter), shorter);
        for (asked, sequence) in [("align", &shorter[..]), ("pick align place", &shipped[..])] {
            let error = Goal::interpret(asked, sequence).unwrap_err();
            let names = |goal: &Goal| error.known.contains(&format!("{:?}", goal.name()));
            let named: Vec<Goal> = Goal::all(&shipped).filter(names).collect();
            assert_eq!((error.asked.as_str(), named), (asked, Goal::all(sequence).collect::<Vec<_>>()));
        }
        assert!(Goal::all(&shipped).all(|goal| Goal::interpret(goal.name(), &shipped) == Ok(goal)));
    }

    #[test]
    fn abandoned_goal_leaves_no_task_until_a_new_goal() {
        let mut agent = Agent::new(TaskKind::SEQUENCE.to_vec());
        agent.take_up(Goal::PickAlignPlace);
        assert_eq!(agent.next_task(), Some(TaskKind::Grasp));
        agent.finished();
        assert_eq!(agent.next_task(), Some(TaskKind::Align));
        assert_eq!(agent.give_up(), AbandonedGoal { in_flight: Some(TaskKind::Align), planned: 1 });
        assert_eq!(agent.next_task(), None);
        assert_eq!(agent.give_up(), AbandonedGoal { in_flight: None, planned: 0 });
        agent.take_up(Goal::PickAlignPlace);
        assert_eq!(agent.next_task(), Some(TaskKind::Grasp));
    }

    #[test]
    fn agent_identity_is_unchanged_by_its_tasks() {
        let mut agent = Agent::new(TaskKind::SEQUENCE.to_vec());
        let before = agent.identity_hash();
        agent.note_episode();
        assert_eq!(agent.identity_hash(), before);
        assert_eq!(agent.episodes(), 1);
        assert_ne!(Agent::called("another").identity_hash(), before);
        let of_another_cell = Agent::new(vec![TaskKind::Grasp, TaskKind::Place]);
        assert_ne!(of_another_cell.identity_hash(), before, "it decides another plan");
    }
}
