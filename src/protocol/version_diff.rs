//! The difference between two versions in words: one line a permission, parameter or part of the interface.
//!
//! Approval requests, the plain stream and stored requests all use these lines.

use serde_json::Value;

use super::detail::{FieldDiff, VersionDiff};
use holdpoint_text::Untrusted;

/// The longest value in a line, columns; the record and JSON have all of it.
const VALUE_WIDTH_MAX: usize = 60;

/// The most lines beside those of permissions; the text states how many more there are.
const LINES_MAX: usize = 60;

/// The topic of a field, in the order of the lines.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum DiffTopic {
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
            Self::Deployment => "deployment",
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
            Some(("deployment", rest)) => within(Self::Deployment, rest),
            _ if field == "name" || field == "version" => None,
            _ => within(Self::Interface, field),
        }
    }
}

impl VersionDiff {
    /// The difference, line by line: every permission first, then parameters with both values, the interface, and what
    /// the author declared of it.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        let mut known: Vec<(DiffTopic, String)> = self
            .fields
            .iter()
            .filter_map(|difference| {
                DiffTopic::of(&difference.field).map(|(topic, name)| (topic, name, difference))
            })
            .map(|(topic, name, difference)| (topic, change_line(topic, name, difference)))
            .collect();
        known.sort_by_key(|(topic, _)| *topic);
        let permissions = known.iter().filter(|(topic, _)| *topic == DiffTopic::Permission).count();
        let shown = known.len().min(permissions + LINES_MAX);
        let more = known.len() - shown;
        let mut lines: Vec<String> = known.into_iter().take(shown).map(|(_, line)| line).collect();
        if more > 0 {
            lines
                .push(format!("and {more} more differences, which the candidate's view and the record have"));
        }
        lines.extend(self.declared.iter().map(|change| format!("declared by its author: {change}")));
        lines
    }
}

fn change_line(topic: DiffTopic, name: &str, difference: &FieldDiff) -> String {
    let topic = topic.name();
    match (&difference.old, &difference.new) {
        (None, Some(new)) => format!("{topic} added: {name} {}", value(new)),
        (Some(old), None) => format!("{topic} removed: {name} {}", value(old)),
        (old, new) => {
            let both = [old, new].map(|side| side.as_ref().map_or_else(|| "nothing".to_owned(), value));
            format!("{topic} {name}: {} -> {}", both[0], both[1])
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
        let lines = VersionDiff { fields, declared: Vec::new() }.lines();
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
}
