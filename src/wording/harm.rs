//! Comparisons of harm and of whole sequences in words.

use holdpoint_governance::behavior::{HarmComparison, HarmDecider, SequenceMeasure};
use holdpoint_governance::harm::{HarmKind, HarmPast};

pub(crate) fn percent(rate: f64) -> String {
    format!("{:.1} %", 100.0 * rate)
}

pub(crate) const fn more(measure: HarmKind) -> &'static str {
    if measure.is_worse_when_lower() { "less" } else { "more" }
}

/// The name of a measure of harm in running text.
pub(crate) const fn harm_measure(of: HarmKind) -> &'static str {
    match of {
        HarmKind::GripPeak => "peak grip force on the object",
        HarmKind::GripHeld => "sustained grip force on the object",
        HarmKind::ContactPeak => "peak force on the surroundings",
        HarmKind::ContactHeld => "sustained force on the surroundings",
        HarmKind::ContactTime => "time in contact with the surroundings",
        HarmKind::TouchSpeed => "speed at a touch",
        HarmKind::LandingSpeed => "speed of the object at landing",
        HarmKind::DropHeight => "fall of the object",
        HarmKind::Slip => "motion of the object in the hand",
        HarmKind::ZoneClearance => "distance to a keep-out zone",
        HarmKind::ArmClearance => "clearance of the arm",
        HarmKind::WorkspaceMargin => "distance to the edge of the workspace",
        HarmKind::JointMargin => "distance to a joint's limit",
        HarmKind::NearTime => "time near a limit",
        HarmKind::Jerk => "peak jerk of the tool",
        HarmKind::Energy => "energy of the motors",
        HarmKind::ClampedShare => "share of commands the guard reduced",
        HarmKind::ClampDepth => "excess of a command over what the guard let through",
        HarmKind::ExcessShare => "share of commands beyond the declaration",
        HarmKind::ExcessDepth => "excess of a command over the declaration",
        HarmKind::DeniedShare => "share of commands the guard refused",
    }
}

/// A measure past its limit: on which side, and of which kind the limit is. A limit of harm is no limit of the envelope.
pub(crate) fn harm_past(past: &HarmPast) -> String {
    let HarmPast { measure, value, limit, .. } = past;
    let side = if measure.is_worse_when_lower() { "below" } else { "above" };
    format!(
        "{} {}, {side} its harm limit {}",
        harm_measure(*measure),
        measure.format(*value),
        measure.format(*limit)
    )
}

/// Both means with their unit and the tolerance.
#[must_use]
pub fn harm_comparison(found: &HarmComparison) -> String {
    let HarmComparison { kind, candidate, active, tolerance, .. } = *found;
    means(kind, [candidate, active, tolerance])
}

pub(crate) fn means(kind: HarmKind, [candidate, active, tolerance]: [f64; 3]) -> String {
    format!(
        "{} against {}, at most {} {} is allowed",
        kind.format(candidate),
        kind.format(active),
        kind.format(tolerance),
        more(kind)
    )
}

/// What makes the verdict where the mean is within the tolerance; `None` where the mean makes it or nothing was found.
#[must_use]
pub fn harm_decider(found: &HarmComparison) -> Option<String> {
    let (kind, past) = (found.kind, found.past);
    let rare = |verb: &str| {
        format!(
            "its rare episodes {verb}: past {} in {} of them against {}, at most {} more is allowed",
            kind.format(past.limit),
            percent(past.candidate),
            percent(past.active),
            percent(past.tolerance)
        )
    };
    Some(match found.deciding()? {
        HarmDecider::Bound(Some(upper)) => {
            format!("its bound decides: up to {} {} is not excluded", kind.format(upper), more(kind))
        }
        HarmDecider::Bound(None) => "its bound decides: so few episodes exclude nothing".to_owned(),
        HarmDecider::RareEpisodes => rare("decide"),
        HarmDecider::RareEpisodesOpen => rare("leave it open"),
    })
}

/// What is compared of sequences, with its unit.
#[must_use]
pub fn sequence_measure(measure: SequenceMeasure) -> String {
    match measure {
        SequenceMeasure::NotDone => "not done".to_owned(),
        SequenceMeasure::Violation => "a violation after it".to_owned(),
        SequenceMeasure::Anomaly => "an anomaly after it".to_owned(),
        SequenceMeasure::PastLimit => "past a limit of harm after it".to_owned(),
        SequenceMeasure::Time => "time after it, s".to_owned(),
        SequenceMeasure::Harm(kind) => match kind.unit() {
            "" => format!("{} after it", harm_measure(kind)),
            unit => format!("{} after it, {unit}", harm_measure(kind)),
        },
    }
}
