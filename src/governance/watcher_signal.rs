//! What the task anomaly detector of the runtime names, as records have it.

crate::closed_set! {
    /// What the watcher can name.
    WatcherSignal, "signal of the watcher", {
        /// The object moves in the hand.
        ObjectSlip = "object-slip",
        /// The hand was closed on the object and is empty now.
        ObjectLost = "object-lost",
        /// A joint is far from where the servo wants it.
        TrackingError = "tracking-error",
        /// Contact outside the phase it belongs to.
        UnexpectedContact = "unexpected-contact",
        /// The arm moves on camera frames that are too old.
        StaleInput = "stale-input",
        /// The gripper does not answer.
        ToolLost = "tool-lost",
        /// The gripper does not follow its command.
        GripFault = "grip-fault",
        /// The task takes too long.
        Overrun = "overrun",
        /// A sensor gives no number.
        TelemetryInvalid = "telemetry-invalid",
    }
}

impl WatcherSignal {
    /// Whether the recovery manager is to act at once; the others are noted as anomalies.
    #[must_use]
    pub const fn needs_recovery(self) -> bool {
        match self {
            Self::TrackingError
            | Self::UnexpectedContact
            | Self::StaleInput
            | Self::Overrun
            | Self::TelemetryInvalid => true,
            // The skill may repair these itself (a new attempt, a wait).
            Self::ObjectSlip | Self::ObjectLost | Self::ToolLost | Self::GripFault => false,
        }
    }

    /// Whether the signal counts as an anomaly of the episode.
    ///
    /// A tool that is away for a moment is a state of the cell, not of the skill.
    #[must_use]
    pub const fn is_anomaly(self) -> bool {
        !matches!(self, Self::ToolLost)
    }
}
