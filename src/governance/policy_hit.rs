//! Why the guard denies or clamps a command, and which measured values exceed a limit.

use super::evidence::HardStop;
use super::past_limit::LimitedQuantity;

crate::closed_set! {
    /// Why the guard denied or clamped a command, or which measured value exceeded a limit.
    PolicyHit, "finding of the guard", {
        /// No policy determines the mode.
        ModeUncovered = "mode-uncovered",
        /// A policy forbids the mode.
        ModeForbidden = "mode-forbidden",
        /// The mode needs a review that was not given.
        ModeUnreviewed = "mode-unreviewed",
        /// A number in the command is not finite or not positive.
        NotFinite = "not-finite",
        /// The target lies outside every zone or outside the workspace.
        OutsideWorkspace = "outside-workspace",
        /// The target or the way to it lies in the keep-out zone.
        KeepOut = "keep-out",
        /// The tool was measured in the keep-out zone, which the manifest does not declare.
        KeepOutEntered = "keep-out-entered",
        /// The motion is predicted to strike the table or the arm itself.
        PredictedCollision = "predicted-collision",
        /// A speed was reduced.
        SpeedClamped = "speed-clamped",
        /// A force was reduced.
        ForceClamped = "force-clamped",
        /// The tool was measured faster than allowed.
        SpeedMeasured = "speed-measured",
        /// A force was measured larger than allowed.
        ForceMeasured = "force-measured",
        /// The version retried more often than allowed.
        RetriesExceeded = "retries-exceeded",
        /// The version's own manifest does not declare this kind of command, or the tool it moves.
        CommandUndeclared = "command-undeclared",
        /// The target lies in a zone that the manifest does not declare, or the tool was measured to enter one.
        ZoneUndeclared = "zone-undeclared",
        /// The version used more ticks or commands than its manifest declares, or its code too much time or memory.
        BudgetExceeded = "budget-exceeded",
        /// After a stop was due, the arm kept moving for longer than allowed.
        UnsafeContinuation = "unsafe-continuation",
        /// A stress test withdrew every permission for a while, to see how the version reacts.
        PermissionWithdrawn = "permission-withdrawn",
    }
}

impl PolicyHit {
    /// Whether the hit makes the episode a violation. A clamp, or a denial without the version's fault, is a warning.
    #[must_use]
    pub const fn is_violation(self) -> bool {
        !matches!(self, Self::SpeedClamped | Self::ForceClamped | Self::PermissionWithdrawn)
    }

    /// The hard stop that the hit causes, if any: for a non-finite number, for a command or zone that the version's
    /// manifest does not declare, or for an exceeded budget. The keep-out zone moves with people, and no manifest is to
    /// declare it for them.
    #[must_use]
    pub const fn hard_stop(self) -> Option<HardStop> {
        match self {
            Self::NotFinite => Some(HardStop::NonFiniteOutput),
            Self::CommandUndeclared | Self::ZoneUndeclared => Some(HardStop::CommandPastGuard),
            Self::BudgetExceeded => Some(HardStop::BudgetBreach),
            Self::ModeUncovered
            | Self::ModeForbidden
            | Self::ModeUnreviewed
            | Self::OutsideWorkspace
            | Self::KeepOut
            | Self::KeepOutEntered
            | Self::PredictedCollision
            | Self::SpeedClamped
            | Self::ForceClamped
            | Self::SpeedMeasured
            | Self::ForceMeasured
            | Self::RetriesExceeded
            | Self::UnsafeContinuation
            | Self::PermissionWithdrawn => None,
        }
    }

    /// The quantity that was measured past its limit; absent if the hit is about no measured value.
    #[must_use]
    pub const fn quantity(self) -> Option<LimitedQuantity> {
        match self {
            Self::ForceMeasured => Some(LimitedQuantity::Force),
            Self::SpeedMeasured => Some(LimitedQuantity::Speed),
            Self::UnsafeContinuation => Some(LimitedQuantity::Motion),
            Self::RetriesExceeded => Some(LimitedQuantity::Retries),
            Self::ModeUncovered
            | Self::ModeForbidden
            | Self::ModeUnreviewed
            | Self::NotFinite
            | Self::OutsideWorkspace
            | Self::KeepOut
            | Self::KeepOutEntered
            | Self::PredictedCollision
            | Self::SpeedClamped
            | Self::ForceClamped
            | Self::CommandUndeclared
            | Self::ZoneUndeclared
            | Self::BudgetExceeded
            | Self::PermissionWithdrawn => None,
        }
    }
}
