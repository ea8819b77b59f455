//! Budgets and error rates of a profile for sandbox, shadow and drills.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::later_numbers as later;

/// Budgets and error rates of sandbox, shadow and drills.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationSettings {
    /// Paired episodes of a full sandbox evaluation.
    pub sandbox_pairs: u32,
    /// Family-wise error of the six lower bounds.
    pub alpha: f64,
    /// Most rejections by the finite-population rules that the full budget would not have made; 0 = off.
    pub early_alpha: f64,
    /// Feasible drills of each kind, per version.
    pub drills_per_kind: u32,
    /// Pairs of whole sequences, run if the paired episodes reject nothing.
    pub sandbox_sequences: u32,
    /// Largest rate at which an equally good version raises a concern by its sequences.
    pub sequence_alpha: f64,
    /// The accepted rise of the share of failed sequences.
    pub sequence_tolerance: f64,
    /// Error rate of calling an unchanged version shifted: in both looks of shadow together, and in those of its live
    /// tasks together (see [`shift`](crate::distribution_shift)).
    pub shift_alpha: f64,
    /// Error rate of the shadow comparison, shared by its signals and looks.
    pub shadow_alpha: f64,
    /// Whole sequences a shadow deployment has to work.
    pub shadow_sequences: u32,
    /// Most sequences shadow is lengthened to.
    pub shadow_sequences_max: u32,
    /// Output divergence from which shadow is lengthened.
    pub output_divergence_max: f64,
    /// Envelope divergence from which shadow is lengthened.
    pub envelope_divergence_max: f64,
    /// By how much more of its time the twin may be near a limit before shadow is lengthened, share of ticks.
    pub near_divergence_max: f64,
    /// Sequences of the live world per sandbox episode pair, in hundredths.
    pub live_sequences_per_100_episodes: u32,
    /// Factor on the declared processor time of a tick; a component whose median tick takes longer is demoted.
    pub tick_time_factor_max: f64,
    /// Longest wall time that the evaluation of one candidate may take, minutes; then the candidate is demoted.
    pub wall_minutes_max: u32,
    /// Most versions that one person registers within a minute; a further one is refused.
    pub registrations_per_minute_max: u32,
    /// Largest rate at which an equally good version raises a concern by the place that the search found.
    #[serde(default = "later::search_alpha", skip_serializing_if = "later::is_search_alpha")]
    pub search_alpha: f64,
    /// Largest share of unsafe episodes under stress without a concern.
    #[serde(default = "later::stress_share_max", skip_serializing_if = "later::is_stress_share_max")]
    pub stress_share_max: f64,
    /// Share of speed and force that the stress of a tightened envelope leaves.
    #[serde(
        default = "later::stress_tightened_share",
        skip_serializing_if = "later::is_stress_tightened_share"
    )]
    pub stress_tightened_share: f64,
    /// Factor on every margin for the live-like pairs by themselves.
    #[serde(default = "later::live_like_factor", skip_serializing_if = "later::is_live_like_factor")]
    pub live_like_factor: f64,
    /// Least share of the wanted sequences in which both versions come to what is judged.
    #[serde(
        default = "later::sequences_reached_share",
        skip_serializing_if = "later::is_sequences_reached_share"
    )]
    pub sequences_reached_share: f64,
    /// Share of `shadow_alpha` for the measures of harm.
    #[serde(default = "later::shadow_harm_share", skip_serializing_if = "later::is_shadow_harm_share")]
    pub shadow_harm_share: f64,
    /// Distance of two arm setpoints that counts as a full divergence, m.
    #[serde(default = "later::divergence_full_m", skip_serializing_if = "later::is_divergence_full_m")]
    pub divergence_full_m: f64,
    /// Distance from the active version's path from which a point of the twin is outside, m.
    #[serde(default = "later::tube_radius_m", skip_serializing_if = "later::is_tube_radius_m")]
    pub tube_radius_m: f64,
    /// Processor time of a median tick up to which no version is too slow, microseconds.
    #[serde(default = "later::tick_us_min", skip_serializing_if = "later::is_tick_us_min")]
    pub tick_us_min: f64,
    /// Error rate of the one-sided upper bounds by which a version counts as compatible.
    #[serde(default = "later::upper_alpha", skip_serializing_if = "later::is_upper_alpha")]
    pub upper_alpha: f64,
}
