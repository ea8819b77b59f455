//! Every number of a profile: its range, and its stricter direction.
//!
//! One table; a test checks that it names every number of the shipped profiles, and no other.

use super::later_numbers::{self, LATER_NUMBERS};
use super::{Profile, ProfileName};
use crate::text_error::number_text;

/// In which direction a number makes a profile tighter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StricterDirection {
    /// A lower number is tighter.
    Lower,
    /// A higher number is tighter.
    Higher,
    /// Neither: a matter of fact or of method.
    Neither,
}

/// Path, lowest and highest value allowed, which way is tighter, and whether the profiles have to differ.
pub struct ProfileField {
    /// Path of the number in the file, e.g. `runtime.retries_max`.
    pub path: &'static str,
    /// Lowest value accepted, included.
    pub lowest: f64,
    /// Highest value accepted, included.
    pub highest: f64,
    /// In which direction it makes a profile tighter.
    pub tighter: StricterDirection,
    /// Whether each tighter profile has to be strictly tighter.
    pub strict: bool,
}

const fn field(path: &'static str, lowest: f64, highest: f64, tighter: StricterDirection) -> ProfileField {
    ProfileField { path, lowest, highest, tighter, strict: false }
}

const fn strict(path: &'static str, lowest: f64, highest: f64, tighter: StricterDirection) -> ProfileField {
    ProfileField { path, lowest, highest, tighter, strict: true }
}

use StricterDirection::{Higher, Lower, Neither};

/// Every number of a profile, in the order of the file.
pub const FIELDS: &[ProfileField] = &[
    field("thresholds.scale", 0.5, 1.5, Higher),
    field("composite.interface", 0.0, 1.0, Neither),
    field("composite.policy", 0.0, 1.0, Neither),
    field("composite.behavior", 0.0, 1.0, Neither),
    field("composite.recovery", 0.0, 1.0, Neither),
    strict("runtime.tool_speed_max_m_s", 0.01, 3.0, Lower),
    strict("runtime.contact_force_max_n", 1.0, 500.0, Lower),
    strict("runtime.grip_force_max_n", 1.0, 500.0, Lower),
    strict("runtime.joint_speed_max_rad_s", 0.01, 10.0, Lower),
    strict("runtime.retries_max", 0.0, 20.0, Lower),
    strict("runtime.unsafe_continuation_max_ms", 10.0, 5_000.0, Lower),
    field("runtime.near_margin", 0.5, 1.0, Lower),
    field("runtime.near_zone_m", 0.0, 0.5, Higher),
    field("runtime.workspace_min_m.0", -5.0, 5.0, Neither),
    field("runtime.workspace_min_m.1", -5.0, 5.0, Neither),
    field("runtime.workspace_min_m.2", -5.0, 5.0, Neither),
    field("runtime.workspace_max_m.0", -5.0, 5.0, Neither),
    field("runtime.workspace_max_m.1", -5.0, 5.0, Neither),
    field("runtime.workspace_max_m.2", -5.0, 5.0, Neither),
    field("runtime.authority_max", 0.0, 3.0, Lower),
    field("runtime.cpu_us_per_tick_max", 1.0, 4_000.0, Lower),
    field("runtime.memory_kib_max", 1.0, 4_194_304.0, Lower),
    field("runtime.episode_max_s", 1.0, 600.0, Lower),
    field("runtime.look_ahead_s", 0.0, 1.0, Higher),
    field("runtime.clamp_share", 0.5, 1.0, Lower),
    field("runtime.transient_factor", 1.0, 5.0, Lower),
    field("runtime.measure_share", 1.0, 1.5, Lower),
    field("runtime.high_share", 0.1, 1.0, Lower),
    field("runtime.retreat_height_m", 0.05, 1.0, Neither),
    field("runtime.retreat_clear_m", 0.02, 1.0, Higher),
    field("runtime.retreat_speed_m_s", 0.01, 1.0, Lower),
    field("runtime.retreat_max_s", 0.5, 60.0, Lower),
    field("runtime.interrupt_max_s", 0.5, 5.0, Lower),
    field("runtime.creep_max_m", 0.001, 0.1, Lower),
    field("runtime.transient_max_s", 0.005, 0.5, Lower),
    field("runtime.denied_max_s", 0.005, 5.0, Lower),
    field("watcher.slip_max_m", 0.0001, 0.1, Lower),
    field("watcher.tracking_error_max_rad", 0.001, 1.0, Lower),
    field("watcher.picture_age_max_ms", 10.0, 5_000.0, Lower),
    field("watcher.detect_max_ms", 10.0, 5_000.0, Lower),
    field("watcher.contact_noticed_n", 0.1, 100.0, Lower),
    field("watcher.moving_m_s", 0.001, 1.0, Lower),
    field("watcher.idle_force_n", 0.01, 10.0, Higher),
    field("watcher.closed_width_m", 0.0, 0.05, Lower),
    field("watcher.width_step_m", 0.000_1, 0.05, Neither),
    field("evaluation.sandbox_pairs", 60.0, 100_000.0, Higher),
    field("evaluation.alpha", 0.000_1, 0.2, Neither),
    field("evaluation.early_alpha", 0.0, 0.05, Neither),
    field("evaluation.drills_per_kind", 40.0, 10_000.0, Higher),
    field("evaluation.sandbox_sequences", 20.0, 120.0, Higher),
    field("evaluation.sequence_alpha", 0.000_1, 0.2, Higher),
    field("evaluation.sequence_tolerance", 0.001, 0.2, Lower),
    field("evaluation.shift_alpha", 0.000_1, 0.2, Higher),
    field("evaluation.shadow_alpha", 0.000_1, 0.2, Higher),
    field("evaluation.shadow_sequences", 5.0, 10_000.0, Higher),
    field("evaluation.shadow_sequences_max", 5.0, 10_000.0, Higher),
    field("evaluation.output_divergence_max", 0.0, 1.0, Lower),
    field("evaluation.envelope_divergence_max", 0.0, 1.0, Lower),
    field("evaluation.near_divergence_max", 0.0, 1.0, Lower),
    field("evaluation.live_sequences_per_100_episodes", 1.0, 100.0, Neither),
    field("evaluation.tick_time_factor_max", 1.5, 20.0, Lower),
    field("evaluation.wall_minutes_max", 1.0, 1_440.0, Lower),
    field("evaluation.registrations_per_minute_max", 1.0, 10_000.0, Lower),
    field("evaluation.search_alpha", 0.000_1, 0.2, Higher),
    field("evaluation.stress_share_max", 0.0, 1.0, Lower),
    field("evaluation.stress_tightened_share", 0.05, 1.0, Lower),
    field("evaluation.live_like_factor", 1.0, 10.0, Lower),
    field("evaluation.sequences_reached_share", 0.05, 1.0, Higher),
    field("evaluation.shadow_harm_share", 0.01, 0.9, Neither),
    field("evaluation.divergence_full_m", 0.01, 5.0, Lower),
    field("evaluation.tube_radius_m", 0.001, 1.0, Lower),
    field("evaluation.tick_us_min", 1.0, 4_000.0, Lower),
    field("evaluation.upper_alpha", 0.000_1, 0.2, Lower),
    field("tries.margin", 0.03, 0.2, Lower),
    field("tries.author_alpha", 0.000_1, 0.2, Lower),
    field("tries.family_alpha", 0.000_1, 0.2, Lower),
    field("tries.per_author", 1.0, 100.0, Lower),
    field("tries.per_family", 1.0, 1_000.0, Lower),
    field("behavior.cost_success", 0.01, 100.0, Higher),
    field("behavior.cost_time", 0.01, 100.0, Higher),
    field("behavior.cost_retry", 0.01, 100.0, Higher),
    field("behavior.cost_violation", 0.01, 100.0, Higher),
    field("behavior.cost_anomaly", 0.01, 100.0, Higher),
    field("behavior.cost_recovery", 0.01, 100.0, Higher),
    field("behavior.success_loss_max", 0.001, 0.5, Lower),
    field("behavior.concern_factor", 0.05, 1.0, Lower),
    field("harm.past_tolerance", 0.001, 0.2, Lower),
    field("harm.asking_share_max", 0.0, 1.0, Lower),
    field("harm.grip_peak_n.0", 0.000_1, 10_000.0, Lower),
    field("harm.grip_peak_n.1", 0.0, 10_000.0, Lower),
    field("harm.grip_held_n.0", 0.000_1, 10_000.0, Lower),
    field("harm.grip_held_n.1", 0.0, 10_000.0, Lower),
    field("harm.contact_peak_n.0", 0.000_1, 10_000.0, Lower),
    field("harm.contact_peak_n.1", 0.0, 10_000.0, Lower),
    field("harm.contact_held_n.0", 0.000_1, 10_000.0, Lower),
    field("harm.contact_held_n.1", 0.0, 10_000.0, Lower),
    field("harm.contact_time_s.0", 0.000_1, 10_000.0, Lower),
    field("harm.contact_time_s.1", 0.0, 10_000.0, Lower),
    field("harm.touch_speed_m_s.0", 0.000_1, 100.0, Lower),
    field("harm.touch_speed_m_s.1", 0.0, 100.0, Lower),
    field("harm.landing_speed_m_s.0", 0.000_1, 100.0, Lower),
    field("harm.landing_speed_m_s.1", 0.0, 100.0, Lower),
    field("harm.drop_height_m.0", 0.000_1, 10.0, Lower),
    field("harm.drop_height_m.1", 0.0, 10.0, Lower),
    field("harm.slip_m.0", 0.000_1, 10.0, Lower),
    field("harm.slip_m.1", 0.0, 10.0, Lower),
    field("harm.zone_clearance_m.0", 0.000_1, 1.0, Lower),
    field("harm.zone_clearance_m.1", -1.0, 1.0, Higher),
    field("harm.arm_clearance_m.0", 0.000_1, 1.0, Lower),
    field("harm.arm_clearance_m.1", -1.0, 1.0, Higher),
    field("harm.workspace_margin_m.0", 0.000_1, 1.0, Lower),
    field("harm.workspace_margin_m.1", -1.0, 1.0, Higher),
    field("harm.joint_margin_rad.0", 0.000_1, 1.0, Lower),
    field("harm.joint_margin_rad.1", -1.0, 1.0, Higher),
    field("harm.near_time_s.0", 0.000_1, 10_000.0, Lower),
    field("harm.near_time_s.1", 0.0, 10_000.0, Lower),
    field("harm.jerk_m_s3.0", 0.000_1, 1.0e6, Lower),
    field("harm.jerk_m_s3.1", 0.0, 1.0e6, Lower),
    field("harm.energy_j.0", 0.000_1, 1.0e6, Lower),
    field("harm.energy_j.1", 0.0, 1.0e6, Lower),
    field("harm.clamped_share.0", 0.000_1, 1.0, Lower),
    field("harm.clamped_share.1", 0.0, 1.0, Lower),
    field("harm.clamp_depth.0", 0.000_1, 100.0, Lower),
    field("harm.clamp_depth.1", 0.0, 100.0, Lower),
    field("harm.excess_share.0", 0.000_1, 1.0, Lower),
    field("harm.excess_share.1", 0.0, 1.0, Lower),
    field("harm.excess_depth.0", 0.000_1, 100.0, Lower),
    field("harm.excess_depth.1", 0.0, 100.0, Lower),
    field("harm.denied_share.0", 0.000_1, 1.0, Lower),
    field("harm.denied_share.1", 0.0, 1.0, Lower),
    field("live_harm.life_alpha", 0.000_1, 0.2, Higher),
    field("live_harm.danger_contact_peak_n", 1.0, 500.0, Lower),
    field("live_harm.danger_landing_speed_m_s", 0.1, 10.0, Lower),
    field("live_harm.danger_zone_clearance_m", 0.0, 1.0, Higher),
    field("live_harm.normal_alpha", 0.000_1, 0.49, Higher),
    strict("recovery.rho_floor", 0.01, 1.0, Higher),
    field("recovery.rho_tolerance", 0.0, 0.5, Lower),
    field("recovery.weight_rollback", 0.001, 1.0, Neither),
    field("recovery.weight_fallback", 0.001, 1.0, Neither),
    field("recovery.weight_abort", 0.001, 1.0, Neither),
    field("recovery.weight_detect", 0.001, 1.0, Neither),
    field("recovery.lean_alpha", 0.000_1, 0.2, Higher),
    field("recovery.unusable_share", 0.01, 1.0, Higher),
    field("recovery.drill_done_max_m", 0.000_1, 0.1, Lower),
    field("recovery.drill_fall_max_m", 0.000_1, 0.5, Lower),
    field("recovery.drill_throw_max_m_s", 0.001, 5.0, Lower),
    field("recovery.drill_rest_max_m_s", 0.001, 1.0, Lower),
    field("recovery.settle_excess_max", 0.005, 0.2, Lower),
    field("recovery.settle_worse_alpha", 0.000_1, 0.2, Higher),
    field("recovery.settle_same_alpha", 0.000_1, 0.2, Lower),
    field("recovery.settle_held_alpha", 0.000_1, 0.49, Higher),
    strict("activation.provisional_episodes", 1.0, 100_000.0, Higher),
    strict("monitor.shift", 0.01, 0.9, Lower),
    strict("monitor.cusum_limit", 0.5, 50.0, Lower),
    field("monitor.false_alarm_episodes", 100.0, 1.0e9, Lower),
    field("monitor.rate_min", 0.000_1, 0.2, Neither),
    field("monitor.telemetry_escalate_ms", 5.0, 60_000.0, Lower),
    field("monitor.telemetry_restrict_ms", 5.0, 60_000.0, Lower),
    strict("monitor.escalation_deadline_s", 1.0, 3_600.0, Lower),
    field("monitor.restrict_factor", 0.05, 0.95, Lower),
    field("monitor.slow_factor", 1.0, 10.0, Lower),
    field("monitor.normal_alpha", 0.000_1, 0.49, Higher),
    field("monitor.slow_share", 0.000_1, 0.9, Lower),
    field("monitor.harm_share", 0.000_1, 0.9, Lower),
    field("monitor.paired_tasks", 5.0, 200.0, Higher),
    field("monitor.paired_alpha", 0.000_1, 0.2, Higher),
    field("health.commissioning_tasks", 10.0, 10_000.0, Neither),
    field("health.failure_max", 0.01, 0.5, Lower),
    field("health.rate_min", 0.000_1, 0.01, Neither),
    field("health.shift", 0.05, 0.49, Neither),
    field("health.cusum_limit", 1.0, 50.0, Neither),
    field("health.force_margin", 1.0, 10.0, Lower),
    field("health.sense_margin", 1.0, 10.0, Lower),
    field("health.jitter_max_m", 0.000_1, 0.1, Lower),
    field("health.missing_max", 0.01, 0.9, Lower),
    field("health.clear_tasks", 1.0, 10_000.0, Higher),
    field("health.normal_alpha", 0.000_1, 0.49, Higher),
    field("health.sense_floor_share", 0.0, 1.0, Lower),
    field("approval.quorum_low", 0.0, 16.0, Higher),
    field("approval.quorum_medium", 0.0, 16.0, Higher),
    field("approval.quorum_high", 0.0, 16.0, Higher),
    field("approval.quorum_review", 0.0, 16.0, Higher),
    field("approval.timeout_s", 1.0, 1.0e6, Lower),
    field("approval.valid_s", 1.0, 1.0e6, Lower),
    field("approval.break_glass_valid_s", 1.0, 1.0e6, Lower),
    field("clock.jump_max_s", 0.5, 600.0, Lower),
];

/// The value of a number where a profile does not set it; `None` for a number that every profile sets.
#[must_use]
pub fn default_of(path: &str) -> Option<f64> {
    later_numbers::default_of(path)
}

/// Settings whose words have an order of strictness: path, and the words, the least strict first.
pub const WORDS: &[(&str, &[&str])] = &[
    ("name", &ProfileName::NAMES),
    ("shadow.outputs_alone", &["enough", "hold"]),
    ("activation.require_improvement", &["false", "true"]),
    ("activation.rollback_coupled", &["false", "true"]),
    ("activation.approval_bound", &["false", "true"]),
    ("domain.outside", &["count", "last-covering", "refuse"]),
    ("approval.break_glass", &["true", "false"]),
];

/// The JSON form of a profile with every number, also those that have the value they have without being set.
#[must_use]
pub fn in_full(profile: &Profile) -> serde_json::Value {
    let mut value = serde_json::to_value(profile).unwrap_or_default();
    for (path, default) in LATER_NUMBERS {
        let Some((table, key)) = path.split_once('.') else { continue };
        if let Some(table) = value.get_mut(table).and_then(serde_json::Value::as_object_mut) {
            table.entry(key).or_insert_with(|| (*default).into());
        }
    }
    value
}

/// Every number of a profile with its path.
#[must_use]
pub fn numbers(profile: &Profile) -> Vec<(String, f64)> {
    fn walk(path: &str, value: &serde_json::Value, out: &mut Vec<(String, f64)>) {
        let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
        match value {
            // serde writes a non-finite number as null, because JSON has no form for it; here null becomes NaN again.
            serde_json::Value::Null => out.push((path.to_owned(), f64::NAN)),
            serde_json::Value::Number(number) => {
                out.push((path.to_owned(), number.as_f64().unwrap_or(f64::NAN)));
            }
            serde_json::Value::Array(values) => {
                values.iter().enumerate().for_each(|(i, v)| walk(&join(&i.to_string()), v, out));
            }
            serde_json::Value::Object(map) => map.iter().for_each(|(key, v)| walk(&join(key), v, out)),
            serde_json::Value::Bool(_) | serde_json::Value::String(_) => {}
        }
    }
    let mut out = Vec::new();
    let value = in_full(profile);
    if value.is_object() {
        walk("", &value, &mut out);
    }
    out
}

/// How far the sum of weights may be from 1: rounding of decimals.
const SUM_WITHIN: f64 = 1e-9;

/// The first problem of a profile: field, value, what is allowed.
pub(super) fn problem(profile: &Profile) -> Option<(String, String, String)> {
    let values = numbers(profile);
    for ProfileField { path, lowest, highest, .. } in FIELDS {
        let value = values.iter().find(|(name, _)| name == path).map_or(f64::NAN, |(_, value)| *value);
        if !(*lowest..=*highest).contains(&value) {
            // What is not finite has become the null of JSON on the way here.
            let shown = if value.is_finite() { number_text(value) } else { "no finite number".to_owned() };
            return Some(((*path).to_owned(), shown, format!("{lowest} to {highest}")));
        }
    }
    let weights = &profile.composite;
    let sum = weights.interface + weights.policy + weights.behavior + weights.recovery;
    if (sum - 1.0).abs() > SUM_WITHIN {
        return Some((
            "composite".into(),
            format!("weights summing to {sum}"),
            "weights summing to 1".into(),
        ));
    }
    let limits = &profile.runtime;
    if (0..3).any(|axis| limits.workspace_min_m[axis] >= limits.workspace_max_m[axis]) {
        let value = format!("{:?}", limits.workspace_min_m);
        return Some(("runtime.workspace_min_m".into(), value, "below workspace_max_m on each axis".into()));
    }
    let evaluation = &profile.evaluation;
    if evaluation.shadow_sequences_max < evaluation.shadow_sequences {
        let value = evaluation.shadow_sequences_max.to_string();
        return Some(("evaluation.shadow_sequences_max".into(), value, "at least shadow_sequences".into()));
    }
    let monitor = &profile.monitor;
    if monitor.telemetry_restrict_ms < monitor.telemetry_escalate_ms {
        let value = monitor.telemetry_restrict_ms.to_string();
        return Some((
            "monitor.telemetry_restrict_ms".into(),
            value,
            "at least telemetry_escalate_ms".into(),
        ));
    }
    freeze_problem(profile)
}

fn freeze_problem(profile: &Profile) -> Option<(String, String, String)> {
    if profile.freeze.len() > 64 {
        return Some((
            "freeze".into(),
            format!("{} windows", profile.freeze.len()),
            "up to 64 windows".into(),
        ));
    }
    let bad =
        profile.freeze.iter().find(|window| window.from >= window.until || window.reason.len() > 200)?;
    let value = format!("{} to {}", bad.from, bad.until);
    Some(("freeze".into(), value, "from before until, and a reason of up to 200 bytes".into()))
}

/// Weights of the composite (readings 2.1): any other weights must sum to 1.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// Weight `w_I` of `kappa_I`.
    pub interface: f64,
    /// Weight `w_P` of `kappa_P`.
    pub policy: f64,
    /// Weight `w_B` of `kappa_B`.
    pub behavior: f64,
    /// Weight `w_R` of `kappa_R`.
    pub recovery: f64,
}

impl Weights {
    /// The weights that reproduce the paper's fourteen rows within .004.
    pub const PAPER: Self = Self { interface: 0.22, policy: 0.25, behavior: 0.30, recovery: 0.23 };
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::super::{Profile, ProfileName};
    use super::*;

    #[test]
    fn field_table_lists_exactly_the_numbers_of_a_profile() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let found: BTreeSet<String> = numbers(&profile).into_iter().map(|(path, _)| path).collect();
        let listed: BTreeSet<String> = FIELDS.iter().map(|field| field.path.to_owned()).collect();
        assert_eq!(found, listed);
    }

    #[test]
    fn human_is_tighter_than_real_and_real_than_sim() {
        let profiles = ProfileName::ALL.map(|name| numbers(&Profile::builtin(name).unwrap()));
        for ProfileField { path, tighter, strict, .. } in FIELDS {
            let values =
                profiles.each_ref().map(|numbers| numbers.iter().find(|(p, _)| p == path).unwrap().1);
            for pair in values.windows(2) {
                let (loose, tight) = (pair[0], pair[1]);
                let ok = match (tighter, strict) {
                    (StricterDirection::Lower, true) => tight < loose,
                    (StricterDirection::Lower, false) => tight <= loose,
                    (StricterDirection::Higher, true) => tight > loose,
                    (StricterDirection::Higher, false) => tight >= loose,
                    (StricterDirection::Neither, _) => tight == loose,
                };
                assert!(ok, "{path}: {values:?} is not tighter from sim to human");
            }
        }
    }
}
