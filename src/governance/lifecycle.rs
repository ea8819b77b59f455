//! The life of a family's versions: nine states, flags, and the one transition function.
//!
//! State = the last stage passed; a stage that runs is a flag. `apply` is total, pure and the only place
//! where a state changes. Sources: paper appendix A; design rule 3.9; readings X51 to X54.

use serde::{Deserialize, Serialize};

mod apply;
mod rules;

pub use apply::apply;
pub use rules::Refusal;

crate::words! {
    /// Where a version stands. Eight states of the paper and `superseded`, without which the paper's rules
    /// cannot roll back to the baseline.
    State, "lifecycle state", {
        /// Taken in; nothing checked yet.
        Registered = "registered",
        /// `kappa_I`, `kappa_P` and the static part of `kappa_R` passed.
        Validated = "validated",
        /// The sandbox is passed.
        Sandboxed = "sandboxed",
        /// Shadow is passed.
        Shadowed = "shadowed",
        /// The one version that may act.
        Active = "active",
        /// Held back for re-evaluation.
        Demoted = "demoted",
        /// Refused for good.
        Rejected = "rejected",
        /// Was active, was taken off.
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
            Self::Demoted => matches!(to, Self::Sandboxed | Self::Shadowed | Self::Rejected),
            Self::Superseded => matches!(to, Self::Active | Self::Rejected),
            Self::Rejected | Self::RolledBack => false,
        }
    }

    /// Whether nothing leads on from here.
    #[must_use]
    pub const fn is_terminal(self) -> bool {
        matches!(self, Self::Rejected | Self::RolledBack)
    }
}

crate::words! {
    /// A stage that can be running.
    Stage, "stage", {
        /// Compatibility validation.
        Validation = "validation",
        /// Sandbox evaluation with drills.
        Sandbox = "sandbox",
        /// Shadow deployment.
        Shadow = "shadow",
        /// The gate, approvals included.
        Activation = "activation",
    }
}

/// A version by its place in the family (registration order, 0 = the first).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct VersionRef(pub u16);

/// What a piece of evidence, a gate pass or an approval was made under; any change voids it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stamp {
    /// Counts changes of profile, policy or threshold, and changes of the active version.
    pub context: u32,
    /// The version's re-evaluations at that time.
    pub round: u32,
}

/// Flags of one version.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    schemars::JsonSchema,
)]
#[serde(deny_unknown_fields)]
pub struct Flags {
    /// The stage that runs.
    pub running: Option<Stage>,
    /// Held by a person: only reject, demote, rollback and resume go through.
    pub paused: bool,
    /// Waits for people.
    pub awaiting_approval: bool,
    /// Active, not yet confirmed.
    pub provisional: bool,
    /// Active under a tighter envelope set by the monitor.
    pub restricted: bool,
    /// Being rolled back: the ladder is under way.
    pub rollback_pending: bool,
}

/// One version of a family.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Version {
    /// Where it stands.
    pub state: State,
    /// Its flags.
    pub flags: Flags,
    /// Counts every change; approvals name it.
    pub row_version: u64,
    /// Re-evaluations and repeats.
    pub round: u32,
    /// The version it replaced: pinned while this one is active or superseded.
    pub predecessor: Option<VersionRef>,
    /// Under what its sandbox evidence was gathered.
    pub sandbox: Option<Stamp>,
    /// Under what its shadow evidence was gathered.
    pub shadow: Option<Stamp>,
    /// Under what its gate was passed.
    pub gate: Option<Stamp>,
    /// Under what the approvals that the profile needs were completed.
    pub approval: Option<Stamp>,
}

/// A family: its versions and what holds for all of them.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FamilyState {
    /// In registration order.
    pub versions: Vec<Version>,
    /// No version acts until an operator re-arms the family.
    pub safe_stopped: bool,
    /// Counts changes of profile, policy, threshold and active version.
    pub context: u32,
    /// Whether the profile needs people's approval before an activation.
    pub needs_approval: bool,
}

/// The most versions of a family.
pub const VERSIONS_MAX: usize = 10_000;

/// How an active version leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Leave {
    /// Hard rollback: terminal.
    RolledBack,
    /// Soft demotion: back to evaluation.
    Demoted,
}

/// What can happen to a family.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "event", deny_unknown_fields)]
pub enum LifecycleEvent {
    /// The first version is made active by an explicit record, without a gate.
    Bootstrap,
    /// A new version is taken in.
    Register,
    /// A stage begins.
    Start {
        /// The version.
        version: VersionRef,
        /// The stage.
        stage: Stage,
    },
    /// The running stage is passed (activation: the gate is).
    Pass {
        /// The version.
        version: VersionRef,
        /// The stage.
        stage: Stage,
    },
    /// The running stage ended without a result; it can be started again.
    Abort {
        /// The version.
        version: VersionRef,
    },
    /// The running stage was not passed for lack of evidence, or a person or the profile holds the version back.
    Demote {
        /// The version, not active.
        version: VersionRef,
    },
    /// Refused for good.
    Reject {
        /// The version, not active.
        version: VersionRef,
    },
    /// A stage that was passed is to be run again; or a demoted version goes back to the sandbox.
    Repeat {
        /// The version.
        version: VersionRef,
        /// Sandbox or shadow.
        stage: Stage,
    },
    /// People are asked.
    RequestApproval {
        /// The version.
        version: VersionRef,
    },
    /// All approvals the profile needs are there.
    Approved {
        /// The version.
        version: VersionRef,
        /// The row version they name.
        row_version: u64,
    },
    /// The approval ran out or nobody answered: held.
    ApprovalExpired {
        /// The version.
        version: VersionRef,
    },
    /// The binding moves: old active -> superseded, this -> active, in one transaction.
    Activate {
        /// The version.
        version: VersionRef,
    },
    /// The provisional window passed.
    Confirm {
        /// The version.
        version: VersionRef,
    },
    /// The monitor narrows the envelope.
    Restrict {
        /// The version.
        version: VersionRef,
    },
    /// People lift the restriction.
    Release {
        /// The version.
        version: VersionRef,
    },
    /// The ladder starts; from here on the version has no command authority.
    BeginRollback {
        /// The version.
        version: VersionRef,
    },
    /// The ladder is done: this -> rolled-back or demoted, predecessor -> active, in one transaction.
    FinishRollback {
        /// The version.
        version: VersionRef,
        /// How it leaves.
        leave: Leave,
    },
    /// A rung failed or there is no target: this -> demoted, family safe-stopped.
    FailRollback {
        /// The version.
        version: VersionRef,
    },
    /// An operator re-arms a safe-stopped family with a superseded or demoted version that was active before.
    Rearm {
        /// The version.
        version: VersionRef,
    },
    /// Held by a person.
    Pause {
        /// The version.
        version: VersionRef,
    },
    /// Let go again.
    Resume {
        /// The version.
        version: VersionRef,
    },
    /// Profile, policy or thresholds changed.
    ContextChanged {
        /// Whether the new profile needs approvals.
        needs_approval: bool,
    },
    /// The engine came up again: what ran is marked as not done.
    Restart,
}

/// One change that has to be written, with its audit record, in the transaction of the event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "change", deny_unknown_fields)]
pub enum LifecycleChange {
    /// A version entered.
    Added {
        /// The version.
        version: VersionRef,
        /// Its first state.
        state: State,
    },
    /// A version's state changed.
    State {
        /// The version.
        version: VersionRef,
        /// Before.
        from: State,
        /// After.
        to: State,
    },
    /// A version's flags changed.
    Flags {
        /// The version.
        version: VersionRef,
        /// Before.
        from: Flags,
        /// After.
        to: Flags,
    },
    /// The active binding changed.
    Active {
        /// Before.
        from: Option<VersionRef>,
        /// After.
        to: Option<VersionRef>,
    },
    /// A gate pass, approval or evidence was recorded or voided.
    Standing {
        /// The version.
        version: VersionRef,
    },
    /// The family was stopped or re-armed.
    SafeStopped {
        /// After.
        stopped: bool,
    },
    /// Gate passes, approvals and comparative evidence of earlier contexts are void.
    Context {
        /// The new count.
        context: u32,
    },
}

impl FamilyState {
    /// A family without versions.
    #[must_use]
    pub const fn empty(needs_approval: bool) -> Self {
        Self { versions: Vec::new(), safe_stopped: false, context: 0, needs_approval }
    }

    /// The active version.
    #[must_use]
    pub fn active(&self) -> Option<VersionRef> {
        let index = self.versions.iter().position(|version| version.state == State::Active)?;
        u16::try_from(index).ok().map(VersionRef)
    }

    /// A version.
    #[must_use]
    pub fn get(&self, version: VersionRef) -> Option<&Version> {
        self.versions.get(usize::from(version.0))
    }

    /// A version's state.
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

    /// The version's predecessor, if it can still be restored.
    fn restorable_predecessor(&self, version: VersionRef) -> Option<VersionRef> {
        self.get(version)?.predecessor.filter(|target| self.state(*target) == Some(State::Superseded))
    }
}

#[cfg(test)]
mod walk;
