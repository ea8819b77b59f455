//! Conditions under which a version may be used.

use serde::{Deserialize, Serialize};

/// A typed condition of use, never free text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Condition {
    /// It may be activated under the profile `sim` only.
    SimulationOnly,
    /// The guard enforces this envelope, tighter than the one declared.
    TighterEnvelope {
        /// Largest tool speed, m/s.
        speed_max_m_s: f64,
        /// Largest force on anything touched, N.
        force_max_n: f64,
    },
    /// The levels of the monitor's charts and its longest unsafe continuation are scaled by this factor until the
    /// version is confirmed.
    StricterThresholds {
        /// Factor in (0, 1); the smaller, the stricter.
        factor: f64,
    },
    /// Shadow must run at this length first.
    ShadowFirst {
        /// Whole sequences that shadow has to work before the gate.
        sequences: u32,
    },
    /// This many distinct people have to approve, also where the profile requires no approval.
    ApprovalRequired {
        /// Distinct people needed, 1 or more.
        quorum: u8,
    },
    /// The dispatcher measures these inputs before each call and starts no task where the stronger precondition does
    /// not hold. It is the one adaptation there is: calls carry no values that could be filled in or converted. What
    /// acts is the dispatcher's check, which every declared precondition of every version gets, in sandbox, shadow and
    /// live cell alike; the condition records that this version's is stronger. A call that is refused counts as a task
    /// that was not done, so that a precondition that seldom holds costs the version its activation.
    #[serde(alias = "interface-adapter")]
    CheckedCall {
        /// Names of the input fields, in alphabetical order.
        fields: Vec<String>,
    },
    /// The predecessor stays loaded and takes over at the first warning of a chart, without asking, until the version
    /// is confirmed.
    RollbackCoupled,
}

impl Condition {
    /// Whether it bounds how the version is used once it is active, so that the activation is a conditional one. The
    /// others were met before (shadow, approval) or are a mode of their own.
    #[must_use]
    pub const fn bounds_use(&self) -> bool {
        match self {
            Self::SimulationOnly
            | Self::TighterEnvelope { .. }
            | Self::StricterThresholds { .. }
            | Self::CheckedCall { .. } => true,
            Self::ShadowFirst { .. } | Self::ApprovalRequired { .. } | Self::RollbackCoupled => false,
        }
    }

    /// Whether it still applies to a confirmed version: a condition for a concern ends with the concern.
    #[must_use]
    pub const fn outlives_confirmation(&self) -> bool {
        match self {
            Self::StricterThresholds { .. } | Self::RollbackCoupled => false,
            Self::SimulationOnly
            | Self::TighterEnvelope { .. }
            | Self::ShadowFirst { .. }
            | Self::ApprovalRequired { .. }
            | Self::CheckedCall { .. } => true,
        }
    }
}

/// The sequences that shadow has to work before the gate by these conditions; 0 without such a condition.
#[must_use]
pub fn shadow_needed(conditions: &[Condition]) -> u32 {
    let sequences = conditions.iter().map(|condition| match condition {
        Condition::ShadowFirst { sequences } => *sequences,
        Condition::SimulationOnly
        | Condition::TighterEnvelope { .. }
        | Condition::StricterThresholds { .. }
        | Condition::ApprovalRequired { .. }
        | Condition::CheckedCall { .. }
        | Condition::RollbackCoupled => 0,
    });
    sequences.max().unwrap_or(0)
}

/// The quorum of these conditions; 0 without such a condition.
#[must_use]
pub fn people_needed(conditions: &[Condition]) -> u8 {
    let quorums = conditions.iter().map(|condition| match condition {
        Condition::ApprovalRequired { quorum } => *quorum,
        Condition::SimulationOnly
        | Condition::TighterEnvelope { .. }
        | Condition::StricterThresholds { .. }
        | Condition::ShadowFirst { .. }
        | Condition::CheckedCall { .. }
        | Condition::RollbackCoupled => 0,
    });
    quorums.max().unwrap_or(0)
}
