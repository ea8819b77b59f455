//! The result of a filmed run and the events in it.
//!
//! Typed values of the engine that never travel: the crate `holdpoint-wording` makes the texts of a
//! [`FilmedRun`](super::FilmedRun) from them.

use holdpoint_body::{CodeFault, FailureSignal};
use holdpoint_governance::evidence::{DrillKind, HardStop};
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::policy_hit::PolicyHit;
use holdpoint_governance::watcher_signal::WatcherSignal;

/// A value past its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ExceededValue {
    /// The force of the pads on the object, past the limit of the guard.
    Grip {
        /// The largest value, N.
        most_n: f32,
    },
    /// The speed of the tool, past the limit of the guard.
    Speed {
        /// The largest value, m/s.
        most_m_s: f32,
    },
    /// A measure of harm, past the limit of the profile.
    Harm {
        /// The measure.
        kind: HarmKind,
        /// The measured value.
        value: f64,
        /// The limit.
        limit: f64,
    },
}

/// A limit that a run exceeded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExceededLimit {
    /// When first, ticks; the end where only the whole episode shows it.
    pub tick: u64,
    /// How many times the limit the value is; not finite where the limit is 0.
    pub times: f64,
    /// The value.
    pub value: ExceededValue,
}

/// A part of the result of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum OutcomePart {
    /// The simulator failed.
    SimulatorFailed,
    /// The dispatcher refused the call, because a precondition does not hold.
    CallRefused,
    /// A hard stop ended the run.
    HardStop {
        /// The hard stop.
        stop: HardStop,
        /// How the code failed, if it did.
        fault: Option<CodeFault>,
    },
    /// The code failed.
    CodeFault(CodeFault),
    /// The run is a violation.
    Violation {
        /// The findings of the guard that make it one; none if a measured value makes it one.
        hits: Vec<PolicyHit>,
    },
    /// The run exceeded a limit.
    Exceeded(ExceededLimit),
    /// The run exceeded further limits.
    MoreExceeded {
        /// How many.
        limits: usize,
    },
    /// The arm moved on after a demanded stop.
    MovedOn {
        /// For how long, ms.
        ms: u64,
    },
    /// The recovery manager took over.
    RecoveryTookOver,
    /// The time limit of the task was reached.
    TimedOut,
    /// The task was done, or it was not.
    Task {
        /// Whether it was done.
        done: bool,
        /// Why it was not, physically; absent where it was done, or nothing is known.
        cause: Option<FailureCause>,
    },
    /// The version made further attempts.
    Attempts {
        /// How many.
        more: u32,
    },
    /// The duration.
    Took {
        /// The duration, s.
        secs: f64,
    },
    /// The version passed a drill, or it failed it.
    Drill {
        /// The kind of drill.
        kind: DrillKind,
        /// Whether it passed.
        passed: bool,
    },
    /// The drill could not be set up.
    DrillNotSetUp,
}

/// An event of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum MarkedEvent {
    /// A finding of the guard.
    Guard(PolicyHit),
    /// A signal of the watcher.
    Watcher(WatcherSignal),
    /// The skill declared a failure.
    Declared(FailureSignal),
    /// The abort hook stopped the arm.
    StoppedByHook,
    /// The interrupt stopped the arm.
    StoppedByInterrupt,
    /// Nothing stopped the arm.
    NotStopped,
    /// The task ended.
    TaskEnded {
        /// Whether it was done.
        done: bool,
        /// Why it was not, physically; absent where it was done, or nothing is known.
        cause: Option<FailureCause>,
    },
    /// A drill began.
    DrillBegan(DrillKind),
    /// A part of the result.
    Outcome(OutcomePart),
}
