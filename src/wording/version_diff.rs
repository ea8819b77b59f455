//! The difference between two versions in words: one line a permission, parameter or part of the interface.
//!
//! Approval requests, the plain stream and stored requests all use these lines.

use serde_json::Value;

use holdpoint_protocol::detail::{FieldDiff, VersionDiff};
use holdpoint_text::Untrusted;

/// The longest value in a line, columns; the record and JSON have all of it.
const VALUE_WIDTH_MAX: usize = 60;

/// The most lines beside those of permissions; the text states how many more there are.
const LINES_MAX: usize = 60;

/// The most parameters in an approval request; one more line counts the others.
const PARAMETERS_MAX: usize = 12;

/// The topic of a field, in the order of the lines.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum DiffTopic {
    /// Where the code is.
    Bundle,
    Permission,
    Parameter,
    Interface,
    Recovery,
    Deployment,
}

impl DiffTopic {
    const fn name(self) -> &'static str {
        match self {
            Self::Permission => "permission",
            Self::Parameter => "parameter",
            Self::Interface => "interface",
            Self::Recovery => "recovery",
            Self::Bundle | Self::Deployment => "deployment",
        }
    }

    /// The topic of a field, and its name within it; absent for name and version, which the title has.
    fn of(field: &str) -> Option<(Self, &str)> {
        let within = |topic, rest| Some((topic, rest));
        if let Some(rest) = field.strip_prefix("params.") {
            return within(Self::Parameter, rest);
        }
        let field = field.strip_prefix("manifest.").unwrap_or(field);
        match field.split_once('.') {
            Some(("permissions", rest)) => within(Self::Permission, rest),
            Some(("inputs" | "outputs" | "invocation", _)) => within(Self::Interface, field),
            Some(("recovery", rest)) => within(Self::Recovery, rest),
            Some(("deployment", "bundle")) => within(Self::Bundle, "bundle"),
            Some(("deployment", rest)) => within(Self::Deployment, rest),
            _ if field == "name" || field == "version" => None,
            _ => within(Self::Interface, field),
        }
    }
}

/// The difference, line by line: the place of the code and every permission first, then parameters with both values,
/// the interface, and what the author declared of it.
#[must_use]
pub fn lines(of: &VersionDiff) -> Vec<String> {
    limited(of, changes(of).into_iter().map(|(topic, change)| (topic, line(topic, &change))).collect())
}

/// As [`lines`], with the first parameters alone: the last line of them counts the others.
#[must_use]
pub fn folded_lines(of: &VersionDiff) -> Vec<String> {
    let (mut lines, mut parameters) = (Vec::new(), 0_usize);
    for (topic, change) in changes(of) {
        parameters += usize::from(topic == DiffTopic::Parameter);
        if topic != DiffTopic::Parameter || parameters <= PARAMETERS_MAX {
            lines.push((topic, line(topic, &change)));
        }
    }
    if let Some(more) = parameters.checked_sub(PARAMETERS_MAX).filter(|more| *more > 0) {
        let text = format!("{more} more parameters, which the candidate's view and the record have");
        lines.push((DiffTopic::Parameter, text));
        lines.sort_by_key(|(topic, _)| *topic);
    }
    limited(of, lines)
}

/// The changes without their topic's name, in the order of the topics.
fn changes(of: &VersionDiff) -> Vec<(DiffTopic, String)> {
    let mut changes: Vec<(DiffTopic, String)> = of
        .fields
        .iter()
        .filter_map(|difference| {
            DiffTopic::of(&difference.field).map(|(topic, name)| (topic, change(name, difference)))
        })
        .collect();
    changes.sort_by_key(|(topic, _)| *topic);
    changes
}

/// The lines of the changes, in this order, up to the most; then what the author declared.
fn limited(of: &VersionDiff, changes: Vec<(DiffTopic, String)>) -> Vec<String> {
    let always = changes.iter().filter(|(topic, _)| *topic <= DiffTopic::Permission).count();
    let shown = changes.len().min(always + LINES_MAX);
    let more = changes.len() - shown;
    let mut lines: Vec<String> = changes.into_iter().take(shown).map(|(_, line)| line).collect();
    if more > 0 {
        lines.push(format!("and {more} more differences, which the candidate's view and the record have"));
    }
    lines.extend(of.declared.iter().map(|change| format!("declared by its author: {change}")));
    lines
}

fn line(topic: DiffTopic, change: &str) -> String {
    format!("{} {change}", topic.name())
}

fn change(name: &str, difference: &FieldDiff) -> String {
    match (&difference.old, &difference.new) {
        (None, Some(new)) => format!("added: {name} {}", value(new)),
        (Some(old), None) => format!("removed: {name} {}", value(old)),
        (old, new) => {
            let both = [old, new].map(|side| side.as_ref().map_or_else(|| "nothing".to_owned(), value));
            format!("{name}: {} -> {}", both[0], both[1])
        }
    }
}

fn value(value: &Value) -> String {
    let text = match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    Untrusted::new(text).display(VALUE_WIDTH_MAX).into_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn permissions_come_first_and_none_is_left_out() {
        let field = |field: &str, old: Option<Value>, new: Option<Value>| FieldDiff {
            field: field.to_owned(),
            old,
            new,
        };
        let mut fields: Vec<FieldDiff> = (0..80)
            .map(|n| field(&format!("params.p{n:02}"), Some(1.0.into()), Some(f64::from(n).into())))
            .collect();
        fields.push(field("manifest.version", Some("1.0.0".into()), Some("1.1.0".into())));
        fields.push(field("manifest.permissions.zones", None, Some("human".into())));
        fields.push(field("manifest.permissions.sensors", Some("camera".into()), None));
        fields.push(field("manifest.permissions.max_speed_m_s", Some(0.2.into()), Some(0.5.into())));
        let lines = lines(&VersionDiff { fields, declared: Vec::new() });
        assert_eq!(
            lines[..4],
            [
                "permission added: zones human",
                "permission removed: sensors camera",
                "permission max_speed_m_s: 0.2 -> 0.5",
                "parameter p00: 1.0 -> 0.0"
            ]
        );
        assert_eq!(lines.len(), 3 + LINES_MAX + 1);
        assert!(lines.last().unwrap().contains("20 more differences"), "{lines:?}");
    }

    #[test]
    fn the_place_of_the_code_comes_first_and_a_request_counts_parameters_beyond_the_most() {
        let field = |field: &str, old: f64, new: f64| FieldDiff {
            field: field.to_owned(),
            old: Some(old.into()),
            new: Some(new.into()),
        };
        let bundle = FieldDiff {
            field: "manifest.deployment.bundle".to_owned(),
            old: Some("native:grasp".into()),
            new: Some("c-grasp.wasm".into()),
        };
        let of = |parameters: u32| {
            let mut fields: Vec<FieldDiff> =
                (0..parameters).map(|n| field(&format!("params.p{n}"), 1.0, 2.0)).collect();
            fields.push(field("manifest.permissions.max_force_n", 15.0, 20.0));
            fields.push(field("manifest.recovery.max_ms", 1.0, 2.0));
            fields.push(bundle.clone());
            VersionDiff { fields, declared: Vec::new() }
        };
        let [code, force] =
            ["deployment bundle: native:grasp -> c-grasp.wasm", "permission max_force_n: 15.0 -> 20.0"];
        let rest = "recovery max_ms: 1.0 -> 2.0";
        // Up to the most, each has a line: of four, one was left out.
        for count in [4, 12] {
            let few = of(count);
            assert_eq!(folded_lines(&few), lines(&few));
            assert_eq!(lines(&few)[..3], [code, force, "parameter p0: 1.0 -> 2.0"]);
        }
        let folded = folded_lines(&of(20));
        assert_eq!(folded[..14], lines(&of(20))[..14]);
        assert_eq!(folded[14..], ["8 more parameters, which the candidate's view and the record have", rest]);
        assert_eq!(lines(&of(20)).len(), 23, "the full difference counts none");
    }
}
