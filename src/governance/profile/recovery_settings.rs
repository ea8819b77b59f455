//! The settings of a profile for recovery drills.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::later_numbers as later;

/// Floors, tolerances and weights of `rho` and `kappa_R`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecoverySettings {
    /// Least `rho` that is not fragile; also the least pass rate of rollback drills.
    pub rho_floor: f64,
    /// Difference to the active version's `rho` that is still compatible.
    pub rho_tolerance: f64,
    /// Weight of `r_rollback` in `rho`.
    pub weight_rollback: f64,
    /// Weight of `r_fallback` in `rho`.
    pub weight_fallback: f64,
    /// Weight of `r_abort` in `rho`.
    pub weight_abort: f64,
    /// Weight of `r_detect` in `rho`.
    pub weight_detect: f64,
    /// Error rate at which a kind of drill leans toward worse, so that more drills settle it.
    #[serde(default = "later::lean_alpha", skip_serializing_if = "later::is_lean_alpha")]
    pub lean_alpha: f64,
    /// Share of `rho_floor` below which recovery is unusable.
    #[serde(default = "later::unusable_share", skip_serializing_if = "later::is_unusable_share")]
    pub unusable_share: f64,
    /// Farthest that the tool may move after a hook reports that it is done, m.
    #[serde(default = "later::drill_done_max_m", skip_serializing_if = "later::is_drill_done_max_m")]
    pub drill_done_max_m: f64,
    /// Farthest that the object may fall in a drill, m.
    #[serde(default = "later::drill_fall_max_m", skip_serializing_if = "later::is_drill_fall_max_m")]
    pub drill_fall_max_m: f64,
    /// Highest speed of the object when the hand loses it in a drill, m/s.
    #[serde(default = "later::drill_throw_max_m_s", skip_serializing_if = "later::is_drill_throw_max_m_s")]
    pub drill_throw_max_m_s: f64,
    /// Highest speed at which the object is at rest after a drill, m/s.
    #[serde(default = "later::drill_rest_max_m_s", skip_serializing_if = "later::is_drill_rest_max_m_s")]
    pub drill_rest_max_m_s: f64,
    /// How much more often than the active version a candidate may fail alone in the drills that settle a failure.
    #[serde(default = "later::settle_excess_max", skip_serializing_if = "later::is_settle_excess_max")]
    pub settle_excess_max: f64,
    /// Error rate of calling an equally good hook worse by those drills, for one kind.
    #[serde(default = "later::settle_worse_alpha", skip_serializing_if = "later::is_settle_worse_alpha")]
    pub settle_worse_alpha: f64,
    /// Error rate of calling a hook settled whose excess is `settle_excess_max` or more, for one kind.
    #[serde(default = "later::settle_same_alpha", skip_serializing_if = "later::is_settle_same_alpha")]
    pub settle_same_alpha: f64,
    /// Error rate of the hold of an equally good hook that the most drills have not settled, for one kind.
    #[serde(default = "later::settle_held_alpha", skip_serializing_if = "later::is_settle_held_alpha")]
    pub settle_held_alpha: f64,
}
