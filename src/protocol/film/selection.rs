//! Why a part of an evaluation was selected for a film, why there is none, and how its re-run differs.
//!
//! Typed values of the engine that never travel: the crate `holdpoint-wording` makes the texts of a
//! [`Film`](super::Film) from them.

use holdpoint_body::CodeFault;
use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::profile::ProfileName;

use super::FilmSubject;

/// A fault of confined code, and how often it is on record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CodeFaultCount {
    /// The fault.
    pub fault: CodeFault,
    /// Tasks with this fault.
    pub failed: u64,
    /// Tasks in all.
    pub tasks: u32,
}

/// What is on record of episodes that were broken off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BreakCause {
    /// The code failed.
    Code(CodeFaultCount),
    /// A hard stop ended the evaluation.
    HardStop {
        /// The hard stop.
        stop: HardStop,
        /// The exceeded budget of the code, if there is one.
        overrun: Option<CodeFault>,
    },
}

/// Why a part of an evaluation is the worst of its kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SelectionReason {
    /// The candidate's episode was broken off, and the active version's was not.
    BrokenOff(BreakCause),
    /// The candidate does more harm by one measure.
    Harm {
        /// The measure.
        kind: HarmKind,
        /// The candidate's value.
        candidate: f64,
        /// The active version's value.
        active: f64,
    },
    /// The candidate alone exceeds a limit.
    LimitExceeded,
    /// The recovery manager takes over from the candidate alone.
    RecoveryTookOver,
    /// The watcher names a failure of the candidate alone.
    FailureNamed,
    /// The active version alone does the task.
    NotDone,
    /// The candidate needs more attempts.
    MoreAttempts {
        /// How many more.
        more: u32,
    },
    /// The candidate needs more time.
    MoreTime {
        /// How much more, s.
        more_s: f64,
    },
    /// The candidate is worse in no episode.
    NowhereWorse,
    /// The drill is of the kind that fails most often.
    MostFailingDrill {
        /// Whether the active version passes the same drill; absent where it could not be set up.
        active_passes: Option<bool>,
    },
    /// A hard stop in it ends the evaluation.
    EndsEvaluation {
        /// The hard stop.
        stop: HardStop,
        /// The exceeded budget of the code, if there is one.
        overrun: Option<CodeFault>,
    },
    /// The episode is the gravest of those with the candidate alone.
    Gravest,
}

/// Why no part of an evaluation could be selected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SelectionFailure {
    /// Nothing of this kind is on record one by one.
    NoneOnRecord(FilmSubject),
    /// The requested number is not on record.
    OutOfRange {
        /// The kind of work.
        of: FilmSubject,
        /// The requested number.
        number: u32,
        /// How many are on record one by one.
        count: u32,
    },
}

/// Why there is no film.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FilmRefusal {
    /// The version is not in the registry.
    UnknownVersion {
        /// The version.
        version: CapabilityId,
    },
    /// Nothing could be selected.
    NotSelected {
        /// The version.
        version: CapabilityId,
        /// Why.
        failure: SelectionFailure,
    },
    /// The version that it was compared with is not in the registry.
    ComparedVersionMissing {
        /// The version that was evaluated.
        version: CapabilityId,
    },
    /// The cell keeps no frames.
    CellCannotFilm,
}

/// A difference of a re-run from the original.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayDifference {
    /// The evidence was judged under another profile than the present one.
    Profile {
        /// The present profile.
        present: ProfileName,
    },
    /// The evidence was judged under other policies.
    Policies,
    /// The evidence is of another build or another cell.
    Environment,
    /// Other versions are active beside it than those that ran before a live-like pair.
    Neighbours,
    /// The run is longer than a film may be.
    CutOff,
}
