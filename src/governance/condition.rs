//! Conditions under which a version may be used.

use serde::{Deserialize, Serialize};

/// A typed condition of use; none of them is free text.
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
    /// The monitor's thresholds are scaled by this factor, below 1.
    StricterThresholds {
        /// Factor in (0, 1); the smaller, the stricter.
        factor: f64,
    },
    /// Shadow has to be worked at this length first.
    ShadowFirst {
        /// Whole sequences that shadow has to work before the gate.
        sequences: u32,
    },
    /// This many distinct people have to approve.
    ApprovalRequired {
        /// Distinct people needed, 1 or more.
        quorum: u8,
    },
    /// Callers go through an adapter that supplies these fields with their defaults.
    InterfaceAdapter {
        /// Names of the input fields, in alphabetical order.
        fields: Vec<String>,
    },
    /// The predecessor stays loaded and takes over at the first trip.
    RollbackCoupled,
}
