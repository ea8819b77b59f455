//! The life of a family's versions: nine states, flags, and the one transition function.
//!
//! State = the last stage passed; a stage that runs is a flag. `apply` is total, pure and the only place
//! where a state changes. Sources: paper appendix A; design rule 3.9; readings X51 to X54.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::profile::ProfileName;
use super::wall_time::{WallTime, as_ms};

mod apply;
mod changes;
mod pausing;
mod rules;

pub use apply::apply;
pub use rules::LifecycleRefusal;

crate::closed_set! {
    /// The state of a version. Eight states of the paper and `superseded`, without which the paper's rules cannot roll
    /// back to the baseline.
    State, "lifecycle state", {
        /// In the store and nothing checked yet.
        Registered = "registered",
        /// `kappa_I`, `kappa_P` and the static part of `kappa_R` passed.
        Validated = "validated",
        /// The sandbox is passed: paired episodes and drills were run.
        Sandboxed = "sandboxed",
        /// Shadow is passed: it ran beside the live cell without a handle to the arm.
        Shadowed = "shadowed",
        /// The one version of its family that may act.
        Active = "active",
        /// Returned to evaluation.
        Demoted = "demoted",
        /// Rejected; terminal.
        Rejected = "rejected",
        /// Was active and was rolled back; terminal.
        RolledBack = "rolled-back",
        /// Was active, was replaced; the rollback target while its successor is active.
        Superseded = "superseded",
    }
}

impl State {
    /// Whether a version can go from here to `to` at all (design rule 3.9, the table).
    #[must_use]
    pub const fn may_become(self, to: Self) -> bool {
        match self {
            Self::Registered => matches!(to, Self::Validated | Self::Rejected),
            Self::Validated => matches!(to, Self::Sandboxed | Self::Demoted | Self::Rejected),
            Self::Sandboxed => matches!(to, Self::Shadowed | Self::Demoted | Self::Rejected),
            Self::Shadowed => matches!(to, Self::Active | Self::Demoted | Self::Rejected),
            Self::Active => matches!(to, Self::Superseded | Self::RolledBack | Self::Demoted),
            // Active again only by reactivation, where a stopped family has no other rollback target.
            Self::Demoted => matches!(to, Self::Sandboxed | Self::Shadowed | Self::Rejected | Self::Active),
            Self::Superseded => matches!(to, Self::Active | Self::Rejected),
            Self::Rejected | Self::RolledBack => false,
        }
    }

    /// Whether no event leads on from here.
    #[must_use]
    pub const fn is_terminal(self) -> bool {
        matches!(self, Self::Rejected | Self::RolledBack)
    }
}

crate::closed_set! {
    /// A stage that can be running.
    Stage, "stage", {
        /// Compatibility validation: interface, policy and the static part of recovery; nothing is run.
        Validation = "validation",
        /// Sandbox evaluation: paired episodes and recovery drills.
        Sandbox = "sandbox",
        /// Shadow deployment beside the live cell, without control.
        Shadow = "shadow",
        /// The gate, approvals included.
        Activation = "activation",
    }
}

/// A version by its place in the family (registration order, 0 = the first).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct VersionRef(pub u16);

/// The circumstances of evidence, a gate pass or an approval; any change voids it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValidityStamp {
    /// Counts changes of profile, policy or threshold, and changes of the active version.
    pub context: u32,
    /// The version's [`Version::round`] at that time.
    pub round: u32,
}

/// The flags of a version beside its state.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(deny_unknown_fields)]
pub struct VersionFlags {
    /// The stage that is running; at most one at a time.
    pub running: Option<Stage>,
    /// Paused by a person: only reject, demote, rollback and resume are accepted.
    pub paused: bool,
    /// An approval request is open; nothing else may be assumed.
    pub awaiting_approval: bool,
    /// Active and monitored; not yet confirmed.
    pub provisional: bool,
    /// Active under a tighter envelope set by the monitor.
    pub restricted: bool,
    /// The rollback ladder is running.
    pub rollback_pending: bool,
}

/// One version of a family, as the transition function knows it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Version {
    /// The last stage passed, or how it left.
    pub state: State,
    /// Its present flags.
    pub flags: VersionFlags,
    /// Counts every change; approvals name it.
    pub row_version: u64,
    /// How often sandbox or shadow was repeated; each time voids the gate pass and the approvals.
    pub round: u32,
    /// The version it replaced: pinned while this one is active or superseded.
    pub predecessor: Option<VersionRef>,
    /// Under what its sandbox evidence was gathered.
    pub sandbox: Option<ValidityStamp>,
    /// Under what its shadow evidence was gathered.
    pub shadow: Option<ValidityStamp>,
    /// Under what its gate was passed; absent before, and when voided.
    pub gate: Option<ValidityStamp>,
    /// The circumstances under which the required approvals were completed.
    pub approval: Option<ValidityStamp>,
    /// Whether it was in control before. Absent in older stores, where this is known only of a family's first version.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub acted: bool,
    /// Whether it was restricted when last in control: without the gate it returns to control restricted. Absent in
    /// older stores.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub left_restricted: bool,
    /// Whether it was provisional when last in control: its window still has to pass when it returns. Absent in older
    /// stores.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub left_provisional: bool,
    /// Profiles under which a profile demotion blocks it: the gate holds it there. Absent in older stores.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub closed: BTreeSet<ProfileName>,
}

/// The review of an emergency activation (design rule 3.10): open until people have looked at it, whatever has become
/// of the version meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Review {
    /// The version that one person activated.
    pub version: VersionRef,
    /// Deadline of the review, also while no engine runs: after it the version is rolled back.
    #[serde(rename = "until_ms", with = "as_ms")]
    pub until: WallTime,
}

/// A family: its versions and their common state.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FamilyState {
    /// In registration order; [`VersionRef`] is an index into it.
    pub versions: Vec<Version>,
    /// No version is active until an operator reactivates one.
    pub safe_stopped: bool,
    /// Counts changes of profile, policy, threshold and active version.
    pub context: u32,
    /// Whether the profile needs people's approval before an activation.
    pub needs_approval: bool,
    /// The open review; nothing is promoted before it is closed. Absent in older stores.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub review: Option<Review>,
}

/// The most versions a family may have over its whole life.
pub const VERSIONS_MAX: usize = 10_000;

/// How an active version leaves control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeactivationKind {
    /// Hard rollback: terminal, the version never runs again (paper section 5.2, stage 7).
    RolledBack,
    /// Soft demotion: back to evaluation (paper section 5.2, stage 7).
    Demoted,
}

/// An event of a family; it is refused or applied as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "event", deny_unknown_fields)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum LifecycleEvent {
    /// The first version is made active by an explicit record, without a gate.
    Bootstrap,
    /// A new version is registered.
    Register,
    /// A stage begins on a version in the state before it; no other may be running and the version must not be
    /// paused.
    Start { version: VersionRef, stage: Stage },
    /// The running stage is passed (activation: the gate is).
    Pass { version: VersionRef, stage: Stage },
    /// The running stage ended without a result; it can be started again.
    Abort { version: VersionRef },
    /// The version lacks evidence for the running stage, or a person or the profile holds it back. An active one
    /// leaves by rollback.
    Demote { version: VersionRef },
    /// Rejected by a rule or by a person; neither an active version nor a pinned rollback target is.
    Reject { version: VersionRef },
    /// Sandbox or shadow, once passed, is to run again, with no stage running; or a demoted version returns to the
    /// sandbox. Shadow takes current sandbox evidence.
    Repeat { version: VersionRef, stage: Stage },
    /// An approval request about a version is made.
    RequestApproval { version: VersionRef },
    /// All approvals the profile needs are there, of an open request; the row version that they name must be the
    /// present one.
    Approved { version: VersionRef, row_version: u64 },
    /// The approval expired or no approver answered: on hold, and the gate pass is void too.
    ApprovalExpired { version: VersionRef },
    /// The binding moves: old active -> superseded, this -> active, in one transaction. It takes a shadowed version
    /// with a current gate pass and, if the profile requires them, current approvals.
    Activate { version: VersionRef },
    /// As [`LifecycleEvent::Activate`], by one person's break-glass approval, which opens a review and expires at
    /// `until`.
    ActivateUnreviewed { version: VersionRef, until: WallTime },
    /// The break-glass activation of a version, in any state, was reviewed; the verdict changes nothing here.
    Reviewed { version: VersionRef },
    /// A version that is not terminal is blocked under a profile: the gate holds it there.
    Close { version: VersionRef, profile: ProfileName },
    /// A version is unblocked under a profile.
    Open { version: VersionRef, profile: ProfileName },
    /// The provisional window passed without a trip and no concern is open; the version is unrestricted and reviewed.
    Confirm { version: VersionRef },
    /// The monitor narrows the envelope of an active version that is not being rolled back.
    Restrict { version: VersionRef },
    /// People lift the restriction.
    Release { version: VersionRef },
    /// The ladder starts; from here on the version has no command authority.
    BeginRollback { version: VersionRef },
    /// The ladder is done: this -> rolled-back or demoted, rollback target -> active, in one transaction.
    FinishRollback { version: VersionRef, leave: DeactivationKind },
    /// A rung failed or there is no target: this -> demoted, family safe-stopped.
    FailRollback { version: VersionRef },
    /// An operator reactivates a superseded or demoted version of a safe-stopped family that was active before. Where
    /// people decide, the only demoted version allowed is the family's first.
    Rearm { version: VersionRef },
    /// Paused by a person; only reject, demote, rollback and resume are accepted.
    Pause { version: VersionRef },
    /// The pause ends.
    Resume { version: VersionRef },
    /// Profile, policy or thresholds changed: gate passes and approvals are void. `needs_approval`: whether the new
    /// profile needs people's approval before an activation.
    ContextChanged { needs_approval: bool },
    /// The engine came up again: what ran is marked as not done.
    Restart,
}

/// One change that has to be written, with its audit record, in the transaction of the event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "change", deny_unknown_fields)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum LifecycleChange {
    /// A version entered the family at the next free place, by registration or bootstrap.
    Added { version: VersionRef, state: State },
    /// A version's state changed.
    State { version: VersionRef, from: State, to: State },
    /// A version's flags changed.
    Flags { version: VersionRef, from: VersionFlags, to: VersionFlags },
    /// The active pointer moved, or was emptied.
    Active { from: Option<VersionRef>, to: Option<VersionRef> },
    /// A gate pass, approval, evidence, the round or the predecessor of a version was recorded or voided.
    Standing { version: VersionRef },
    /// The family was safe-stopped or reactivated.
    SafeStopped { stopped: bool },
    /// The review of a break-glass activation was opened or closed. `open`: the version under review from now on.
    Review { open: Option<VersionRef> },
    /// Gate passes, approvals and comparative evidence of earlier contexts are void: what bears an older count no
    /// longer counts.
    Context { context: u32 },
}

impl FamilyState {
    /// A family as it is before its bootstrap.
    #[must_use]
    pub const fn empty(needs_approval: bool) -> Self {
        Self { versions: Vec::new(), safe_stopped: false, context: 0, needs_approval, review: None }
    }

    /// The version in control; `None` in a new or safe-stopped family.
    #[must_use]
    pub fn active(&self) -> Option<VersionRef> {
        let index = self.versions.iter().position(|version| version.state == State::Active)?;
        u16::try_from(index).ok().map(VersionRef)
    }

    /// The version at this place; `None` past the last.
    #[must_use]
    pub fn get(&self, version: VersionRef) -> Option<&Version> {
        self.versions.get(usize::from(version.0))
    }

    /// State of the version at this place; `None` past the last.
    #[must_use]
    pub fn state(&self, version: VersionRef) -> Option<State> {
        self.get(version).map(|version| version.state)
    }

    /// Whether an active or superseded version would be rolled back to this one.
    #[must_use]
    pub fn is_pinned(&self, version: VersionRef) -> bool {
        let holds = |state| matches!(state, State::Active | State::Superseded);
        self.versions.iter().any(|other| holds(other.state) && other.predecessor == Some(version))
    }

    /// Whether a version was in control before.
    #[must_use]
    pub fn has_acted(&self, version: VersionRef) -> bool {
        version.0 == 0 || self.get(version).is_some_and(|found| found.acted)
    }

    /// Whether people still have to review how this version became active.
    #[must_use]
    pub fn is_unreviewed(&self, version: VersionRef) -> bool {
        self.review.is_some_and(|review| review.version == version)
    }

    /// The version's predecessor, if it can still be restored.
    #[must_use]
    pub fn restorable_predecessor(&self, version: VersionRef) -> Option<VersionRef> {
        self.get(version)?.predecessor.filter(|target| self.state(*target) == Some(State::Superseded))
    }
}

impl Version {
    /// A version without history.
    #[must_use]
    pub fn new(state: State) -> Self {
        Self {
            state,
            flags: VersionFlags::default(),
            row_version: 1,
            round: 0,
            predecessor: None,
            sandbox: None,
            shadow: None,
            gate: None,
            approval: None,
            acted: false,
            left_restricted: false,
            left_provisional: false,
            closed: BTreeSet::new(),
        }
    }

    /// Whether a profile demotion blocks it under `profile`.
    #[must_use]
    pub fn is_blocked_under(&self, profile: ProfileName) -> bool {
        self.closed.contains(&profile)
    }

    /// Leaves for a state in which none of its flags applies.
    fn leave(&mut self, to: State) {
        let keep = if to == State::Demoted && self.state != State::Active { self.sandbox } else { None };
        let paused = self.flags.paused && !to.is_terminal();
        let (left_restricted, left_provisional) = match self.state {
            _ if to.is_terminal() => (false, false),
            State::Active => (self.flags.restricted, self.flags.provisional),
            _ => (self.left_restricted, self.left_provisional),
        };
        *self = Self {
            flags: VersionFlags { paused, ..VersionFlags::default() },
            row_version: self.row_version,
            round: self.round,
            sandbox: keep,
            acted: self.acted || self.state == State::Active,
            left_restricted,
            left_provisional,
            closed: std::mem::take(&mut self.closed),
            ..Self::new(to)
        };
    }
}

#[cfg(test)]
mod walk;

#[cfg(test)]
mod tests {
    use super::*;

    /// Only a person could end it, by a re-evaluation and a demotion.
    #[test]
    fn flags_of_a_demoted_version_survive_its_re_evaluation() {
        let mut version = Version::new(State::Active);
        (version.flags.restricted, version.flags.provisional) = (true, true);
        for to in [State::Demoted, State::Sandboxed, State::Demoted] {
            match to {
                State::Sandboxed => version.state = to,
                _ => version.leave(to),
            }
            assert!(version.left_restricted && version.left_provisional, "{to}");
        }
        version.leave(State::Rejected);
        assert!(!version.left_restricted && !version.left_provisional);
    }
}
