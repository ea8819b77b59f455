//! The numbers that profiles did not have from the start, and the value of each where a file does not set it.
//!
//! A profile without them means what it meant before they were fields. A number that equals its value here is left out
//! of the profile's JSON form, so that the digests of older profiles stay. The reasons are in `profiles/*.toml`.

/// For each number its path, its value, and the two functions that serde asks.
macro_rules! later_numbers {
    ($($path:literal = $value:literal, $default:ident, $is_default:ident;)*) => {
        /// Path and value of each, in the order of the file.
        pub(super) const LATER_NUMBERS: &[(&str, f64)] = &[$(($path, $value)),*];

        $(
            pub(crate) const fn $default() -> f64 {
                $value
            }

            #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
            pub(crate) fn $is_default(value: &f64) -> bool {
                *value == $value
            }
        )*
    };
}

later_numbers! {
    "runtime.look_ahead_s" = 0.08, look_ahead_s, is_look_ahead_s;
    "runtime.clamp_share" = 0.95, clamp_share, is_clamp_share;
    "runtime.transient_factor" = 2.0, transient_factor, is_transient_factor;
    "runtime.measure_share" = 1.05, measure_share, is_measure_share;
    "runtime.high_share" = 0.8, high_share, is_high_share;
    "runtime.retreat_height_m" = 0.2, retreat_height_m, is_retreat_height_m;
    "runtime.retreat_clear_m" = 0.15, retreat_clear_m, is_retreat_clear_m;
    "runtime.retreat_speed_m_s" = 0.2, retreat_speed_m_s, is_retreat_speed_m_s;
    "runtime.retreat_max_s" = 4.0, retreat_max_s, is_retreat_max_s;
    "runtime.interrupt_max_s" = 1.0, interrupt_max_s, is_interrupt_max_s;
    "runtime.creep_max_m" = 0.02, creep_max_m, is_creep_max_m;
    "runtime.transient_max_s" = 0.05, transient_max_s, is_transient_max_s;
    "runtime.denied_max_s" = 0.1, denied_max_s, is_denied_max_s;
    "watcher.contact_noticed_n" = 2.0, contact_noticed_n, is_contact_noticed_n;
    "watcher.moving_m_s" = 0.03, moving_m_s, is_moving_m_s;
    "watcher.idle_force_n" = 0.5, idle_force_n, is_idle_force_n;
    "watcher.closed_width_m" = 0.004, closed_width_m, is_closed_width_m;
    "watcher.width_step_m" = 0.002, width_step_m, is_width_step_m;
    "evaluation.search_alpha" = 0.01, search_alpha, is_search_alpha;
    "evaluation.stress_share_max" = 0.2, stress_share_max, is_stress_share_max;
    "evaluation.stress_tightened_share" = 0.7, stress_tightened_share, is_stress_tightened_share;
    "evaluation.live_like_factor" = 2.0, live_like_factor, is_live_like_factor;
    "evaluation.sequences_reached_share" = 0.25, sequences_reached_share, is_sequences_reached_share;
    "evaluation.shadow_harm_share" = 0.1, shadow_harm_share, is_shadow_harm_share;
    "evaluation.divergence_full_m" = 0.2, divergence_full_m, is_divergence_full_m;
    "evaluation.tube_radius_m" = 0.03, tube_radius_m, is_tube_radius_m;
    "evaluation.tick_us_min" = 200.0, tick_us_min, is_tick_us_min;
    "evaluation.upper_alpha" = 0.05, upper_alpha, is_upper_alpha;
    "behavior.success_loss_max" = 0.05, success_loss_max, is_success_loss_max;
    "behavior.concern_factor" = 0.5, concern_factor, is_concern_factor;
    "live_harm.normal_alpha" = 0.1, live_normal_alpha, is_live_normal_alpha;
    "recovery.lean_alpha" = 0.05, lean_alpha, is_lean_alpha;
    "recovery.unusable_share" = 0.5, unusable_share, is_unusable_share;
    "recovery.drill_done_max_m" = 0.003, drill_done_max_m, is_drill_done_max_m;
    "recovery.drill_fall_max_m" = 0.01, drill_fall_max_m, is_drill_fall_max_m;
    "recovery.drill_throw_max_m_s" = 0.25, drill_throw_max_m_s, is_drill_throw_max_m_s;
    "recovery.drill_rest_max_m_s" = 0.05, drill_rest_max_m_s, is_drill_rest_max_m_s;
    "recovery.settle_excess_max" = 0.02, settle_excess_max, is_settle_excess_max;
    "recovery.settle_worse_alpha" = 0.025, settle_worse_alpha, is_settle_worse_alpha;
    "recovery.settle_same_alpha" = 0.05, settle_same_alpha, is_settle_same_alpha;
    "recovery.settle_held_alpha" = 0.1, settle_held_alpha, is_settle_held_alpha;
    "monitor.normal_alpha" = 0.1, monitor_normal_alpha, is_monitor_normal_alpha;
    "monitor.slow_share" = 0.12, slow_share, is_slow_share;
    "monitor.harm_share" = 0.05, harm_share, is_harm_share;
    "monitor.paired_tasks" = 40.0, paired_tasks, is_paired_tasks;
    "monitor.paired_alpha" = 0.05, paired_alpha, is_paired_alpha;
    "health.normal_alpha" = 0.05, health_normal_alpha, is_health_normal_alpha;
    "health.sense_floor_share" = 0.1, sense_floor_share, is_sense_floor_share;
}

/// The value of a number where a profile does not set it; `None` for a number that every profile sets.
pub(super) fn default_of(path: &str) -> Option<f64> {
    LATER_NUMBERS.iter().find(|(known, _)| *known == path).map(|(_, value)| *value)
}

#[cfg(test)]
mod tests {
    use super::super::{Profile, ProfileName};
    use super::*;

    /// A profile of an earlier version parses, means the same and has the same digest.
    #[test]
    fn a_profile_without_the_later_numbers_has_the_digest_of_the_shipped_one() {
        for name in ProfileName::ALL {
            let (file, text) = Profile::builtin_text(name);
            let (mut table, mut left_out) = (String::new(), 0);
            let mut earlier = String::new();
            for line in text.lines() {
                if let Some(name) = line.strip_prefix('[') {
                    name.split(']').next().unwrap_or_default().clone_into(&mut table);
                }
                let key = line.split('=').next().unwrap_or_default().trim();
                if default_of(&format!("{table}.{key}")).is_some() {
                    left_out += 1;
                } else {
                    earlier.push_str(line);
                    earlier.push('\n');
                }
            }
            assert_eq!(left_out, LATER_NUMBERS.len(), "{file} gives a reason for each of them");
            let (earlier, shipped) =
                (Profile::parse(file, &earlier).unwrap(), Profile::builtin(name).unwrap());
            assert_eq!(earlier, shipped);
            assert_eq!(earlier.digest().unwrap(), shipped.digest().unwrap());
            let json = serde_json::to_value(&shipped).unwrap();
            for (path, value) in LATER_NUMBERS {
                let pointer = format!("/{}", path.replace('.', "/"));
                assert_eq!(json.pointer(&pointer), None, "{path} would change the digest");
                let (table, key) = path.split_once('.').unwrap();
                let mut changed = json.clone();
                changed[table][key] = (1.5 * value).into();
                let changed: Profile = serde_json::from_value(changed).unwrap();
                assert_ne!(changed.digest().unwrap(), shipped.digest().unwrap(), "{path} counts");
            }
        }
    }
}
