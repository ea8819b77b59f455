//! Events of a candidate that the version it is compared with has in the same scene: they speak against neither.
//!
//! A hard stop or a safety event stops a version at once. The version it is compared with then works the same scene:
//! same seed, same injected person, same moment. An event of both counts against neither of them, and the active version
//! gets an alarm. Source: the comparison under shared disturbances of the paper's section 6.6, for single events too.

use serde::{Deserialize, Serialize};

use super::evidence::HardStop;
use super::monitor::SafetyEvent;
use super::past_limit::PastLimit;

crate::closed_set! {
    /// Where two versions work the same scene.
    SceneKind, "kind of scene", {
        /// An unperturbed episode of the sandbox.
        Canonical = "canonical",
        /// An episode of the sandbox under stress.
        Adversarial = "adversarial",
        /// A paired episode.
        Pair = "pair",
        /// A place of the search for the worst episode.
        Search = "search",
        /// A whole sequence of the sandbox.
        Sequence = "sequence",
        /// A sequence in shadow: the twin beside the live world.
        Shadow = "shadow",
        /// A live task, and the rollback target in a fork of it.
        Live = "live",
    }
}

crate::closed_set! {
    /// Why the rollback target did not work the scene of a live event, or the tasks of a rate that decided. No difference is
    /// shown, and the version is demoted.
    UncomparedReason, "reason without a comparison", {
        /// The live cell exports no state, so a live task has no fork.
        NoExport = "no-export",
        /// No state at the start of a task was kept.
        NoStart = "no-start",
        /// The record of the task names no event to look for.
        NoEvent = "no-event",
        /// No trial cell took the state at the start of the task.
        NoFork = "no-fork",
        /// The task of the rollback target in the fork was invalid.
        InvalidFork = "invalid-fork",
        /// The engine ended before the comparison, and a later one finished the rollback.
        Interrupted = "interrupted",
    }
}

/// An event that stops a version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StoppingEvent {
    /// Of an evaluation.
    HardStop(HardStop),
    /// Of a live task.
    Safety(SafetyEvent),
}

impl StoppingEvent {
    /// Its name in records.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::HardStop(stop) => stop.name(),
            Self::Safety(event) => event.name(),
        }
    }
}

/// An event of both versions in one scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SharedEvent {
    /// The kind of scene.
    pub scene: SceneKind,
    /// Seed of the scene.
    pub seed: u64,
    /// The event.
    pub event: StoppingEvent,
    /// The value of the version compared with, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub past: Option<PastLimit>,
}

/// A candidate's hard stop where the other version, in the same scene, has not the same.
#[must_use]
pub fn one_sided(candidate: Option<HardStop>, other: Option<HardStop>) -> Option<HardStop> {
    candidate.filter(|stop| other != Some(*stop))
}
