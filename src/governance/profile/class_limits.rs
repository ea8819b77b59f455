//! What the class of a profile requires of it, whatever its author.
//!
//! The paper names three settings and says what is stricter in each (section on deployment profiles, appendix D); it
//! gives no numbers. So where the paper calls a setting stricter, its profile must be at least as strict as the
//! shipped profile of the next less strict setting. Requirements of the paper, or of plain sense, apply directly. The
//! site chooses everything else within the ranges of [`fields`](super::fields).

use super::fields::{FIELDS, StricterDirection, numbers};
use super::{Profile, ProfileName};
use crate::mode::ZoneName;

/// A field, its value, and what is allowed.
pub(super) type FieldProblem = (String, String, String);

/// A number in which a class is stricter, with its source.
struct ClassLimit {
    path: &'static str,
    /// From this class on.
    from: ProfileName,
    phrase: &'static str,
}

const fn real(path: &'static str, phrase: &'static str) -> ClassLimit {
    ClassLimit { path, from: ProfileName::Real, phrase }
}

const fn human(path: &'static str, phrase: &'static str) -> ClassLimit {
    ClassLimit { path, from: ProfileName::Human, phrase }
}

const MOTION: &str = "tighter motion thresholds";
const RETRIES: &str = "tighter retry thresholds";
const ANOMALIES: &str = "lower anomaly tolerance";
const ROLLBACK: &str = "stronger rollback sensitivity";
const ENVELOPE: &str = "the narrowest admissibility envelope";
const CONTINUATION: &str = "a stricter unsafe-continuation policy";
const ESCALATION: &str = "faster escalation";

/// Where the paper says that a class is stricter than the one before it.
const STRICTER: &[ClassLimit] = &[
    real("runtime.tool_speed_max_m_s", MOTION),
    real("runtime.contact_force_max_n", MOTION),
    real("runtime.grip_force_max_n", MOTION),
    real("runtime.joint_speed_max_rad_s", MOTION),
    real("runtime.retries_max", RETRIES),
    real("behavior.cost_anomaly", ANOMALIES),
    real("watcher.slip_max_m", ANOMALIES),
    real("watcher.tracking_error_max_rad", ANOMALIES),
    real("watcher.picture_age_max_ms", ANOMALIES),
    real("watcher.detect_max_ms", ANOMALIES),
    real("monitor.shift", ROLLBACK),
    real("monitor.cusum_limit", ROLLBACK),
    real("activation.provisional_episodes", ROLLBACK),
    real("recovery.rho_floor", ROLLBACK),
    human("thresholds.scale", ENVELOPE),
    human("runtime.authority_max", ENVELOPE),
    human("runtime.unsafe_continuation_max_ms", CONTINUATION),
    human("monitor.escalation_deadline_s", ESCALATION),
    human("monitor.telemetry_escalate_ms", ESCALATION),
    human("monitor.telemetry_restrict_ms", ESCALATION),
];

/// The class before this one.
fn less_strict_class(class: ProfileName) -> Option<ProfileName> {
    ProfileName::ALL.into_iter().rev().find(|before| *before < class)
}

/// A contradiction within a profile, or with its class.
pub(super) fn problem(profile: &Profile) -> Option<FieldProblem> {
    contradiction(profile).or_else(|| demand(profile))
}

/// Numbers that contradict each other, in any class.
fn contradiction(profile: &Profile) -> Option<FieldProblem> {
    let wrong = |field: &str, value: f64, allowed: &str| {
        Some((field.to_owned(), value.to_string(), allowed.to_owned()))
    };
    let (approval, runtime, watcher) = (&profile.approval, &profile.runtime, &profile.watcher);
    if approval.quorum_medium < approval.quorum_low {
        let allowed = "at least quorum_low: more risk never takes fewer people";
        return wrong("approval.quorum_medium", approval.quorum_medium.into(), allowed);
    }
    if approval.quorum_high < approval.quorum_medium {
        let allowed = "at least quorum_medium: more risk never takes fewer people";
        return wrong("approval.quorum_high", approval.quorum_high.into(), allowed);
    }
    if profile.activation.approval_bound && approval.quorum_low == 0 {
        let allowed = "1 to 16 where activation.approval_bound is true: no approver would be asked";
        return wrong("approval.quorum_low", approval.quorum_low.into(), allowed);
    }
    if approval.quorum_low > 0 && approval.quorum_review == 0 {
        let allowed =
            "at least 1 where every activation is approved: with 0 the profile has no approver for reviews";
        return wrong("approval.quorum_review", approval.quorum_review.into(), allowed);
    }
    if approval.break_glass_valid_s > approval.valid_s {
        let allowed = "at most valid_s: an emergency approval is no better than any other";
        return wrong("approval.break_glass_valid_s", approval.break_glass_valid_s, allowed);
    }
    if runtime.grip_force_max_n > runtime.contact_force_max_n {
        let allowed = "at most contact_force_max_n: closing the hand would pass it";
        return wrong("runtime.grip_force_max_n", runtime.grip_force_max_n, allowed);
    }
    if watcher.detect_max_ms > runtime.unsafe_continuation_max_ms {
        let allowed = "at most runtime.unsafe_continuation_max_ms: a failure is named before motion must end";
        return wrong("watcher.detect_max_ms", watcher.detect_max_ms, allowed);
    }
    None
}

/// The requirements of a class.
fn demand(profile: &Profile) -> Option<FieldProblem> {
    let wrong = |field: &str, value: &str, allowed: &str| {
        Some((
            field.to_owned(),
            value.to_owned(),
            format!("{allowed} in a profile of class {}", profile.name),
        ))
    };
    let activation = &profile.activation;
    if profile.name >= ProfileName::Real && !activation.rollback_coupled {
        return wrong("activation.rollback_coupled", "false", "true");
    }
    if profile.name < ProfileName::Human {
        return None;
    }
    let approval = &profile.approval;
    if approval.quorum_low == 0 {
        return wrong("approval.quorum_low", "0", "1 to 16");
    }
    if !activation.approval_bound {
        return wrong("activation.approval_bound", "false", "true");
    }
    if approval.break_glass {
        return wrong("approval.break_glass", "true", "false");
    }
    if !profile.runtime.keep_out.contains(&ZoneName::Human) {
        let zones: Vec<&str> = profile.runtime.keep_out.iter().map(ZoneName::name).collect();
        return wrong("runtime.keep_out", &zones.join(", "), "a list with \"human\"");
    }
    None
}

/// Where a profile is less strict than the shipped one of the preceding class, though the paper says that it is
/// stricter.
pub(crate) fn less_strict_than_allowed(profile: &Profile) -> Option<FieldProblem> {
    let before = Profile::builtin(less_strict_class(profile.name)?).ok()?;
    let (own, bounds) = (numbers(profile), numbers(&before));
    let value = |numbers: &[(String, f64)], path: &str| {
        numbers.iter().find(|(name, _)| name == path).map_or(f64::NAN, |(_, value)| *value)
    };
    STRICTER.iter().filter(|one| profile.name >= one.from).find_map(|ClassLimit { path, phrase, .. }| {
        let (own, bound) = (value(&own, path), value(&bounds, path));
        let tighter = FIELDS.iter().find(|field| field.path == *path).map(|field| field.tighter);
        let (fits, relation) = match tighter {
            Some(StricterDirection::Lower) => (own <= bound, "at most"),
            Some(StricterDirection::Higher) => (own >= bound, "at least"),
            Some(StricterDirection::Neither) | None => (false, "nothing but"),
        };
        let (class, before) = (profile.name, before.name);
        let allowed =
            format!("{relation} {bound}, the number of {before}: {phrase} are what makes the class {class}");
        (!fits).then(|| ((*path).to_owned(), own.to_string(), allowed))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_names_numbers_that_have_a_direction() {
        for one in STRICTER {
            let field = FIELDS.iter().find(|field| field.path == one.path);
            assert!(field.is_some_and(|field| field.tighter != StricterDirection::Neither), "{}", one.path);
        }
    }

    #[test]
    fn shipped_profiles_meet_the_limits_of_their_class() {
        for name in ProfileName::ALL {
            let profile = Profile::builtin(name).unwrap();
            assert_eq!(problem(&profile), None);
            assert_eq!(less_strict_than_allowed(&profile), None);
        }
    }

    #[test]
    fn setting_below_the_class_limit_is_refused_by_its_field() {
        type ProfileCorruption = fn(&mut Profile);
        let cases: [(ProfileName, &str, ProfileCorruption); 13] = [
            (ProfileName::Human, "approval.quorum_low", |p| p.approval.quorum_low = 0),
            (ProfileName::Human, "approval.quorum_medium", |p| p.approval.quorum_medium = 0),
            (ProfileName::Human, "approval.quorum_high", |p| p.approval.quorum_high = 1),
            (ProfileName::Human, "approval.quorum_review", |p| p.approval.quorum_review = 0),
            (ProfileName::Human, "activation.approval_bound", |p| p.activation.approval_bound = false),
            (ProfileName::Human, "activation.rollback_coupled", |p| p.activation.rollback_coupled = false),
            (ProfileName::Human, "approval.break_glass", |p| p.approval.break_glass = true),
            (ProfileName::Human, "runtime.keep_out", |p| p.runtime.keep_out.clear()),
            (ProfileName::Real, "activation.rollback_coupled", |p| p.activation.rollback_coupled = false),
            (ProfileName::Real, "approval.quorum_low", |p| p.activation.approval_bound = true),
            (ProfileName::Sim, "approval.break_glass_valid_s", |p| p.approval.break_glass_valid_s = 1.0e5),
            (ProfileName::Sim, "runtime.grip_force_max_n", |p| p.runtime.grip_force_max_n = 61.0),
            (ProfileName::Sim, "watcher.detect_max_ms", |p| p.watcher.detect_max_ms = 501.0),
        ];
        for (name, field, spoil) in cases {
            let mut profile = Profile::builtin(name).unwrap();
            spoil(&mut profile);
            let found = problem(&profile).map(|(field, _, _)| field);
            assert_eq!(found.as_deref(), Some(field), "{name}");
        }
    }

    #[test]
    fn a_class_is_never_less_strict_than_the_one_before_it() {
        for one in STRICTER {
            let field = FIELDS.iter().find(|field| field.path == one.path).unwrap();
            let mut value = serde_json::to_value(Profile::builtin(ProfileName::Human).unwrap()).unwrap();
            let (table, key) = one.path.split_once('.').unwrap();
            let loose = if field.tighter == StricterDirection::Lower { field.highest } else { field.lowest };
            // A whole number is written, and read, as one.
            value[table][key] = serde_json::from_str(&loose.to_string()).unwrap();
            let profile: Profile = serde_json::from_value(value).unwrap();
            let found = less_strict_than_allowed(&profile).map(|(field, _, _)| field);
            assert_eq!(found.as_deref(), Some(one.path));
        }
    }
}
