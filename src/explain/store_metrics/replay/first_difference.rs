//! The first difference between a record and its replay. Codes and numbers count; sentences do not, for their wording may improve.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

use holdpoint_wording::program::replay::differs;

const QUOTED_CHARS: usize = 60;

/// The first difference of two values, with both; `None` if they are equal.
pub fn differing(at: &str, recorded: &Value, again: &Value) -> Option<String> {
    if recorded == again {
        return None;
    }
    match (recorded, again) {
        (Value::Object(a), Value::Object(b)) => {
            let is_compared = |key: &str| !is_sentence(a, key);
            let keys: BTreeSet<&String> = a.keys().chain(b.keys()).filter(|key| is_compared(key)).collect();
            keys.into_iter().find_map(|key| match (a.get(key), b.get(key)) {
                (Some(a), Some(b)) => differing(&format!("{at}.{key}"), a, b),
                _ => Some(described(at, recorded, again)),
            })
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(index, (a, b))| differing(&format!("{at}[{index}]"), a, b))
        }
        _ => Some(described(at, recorded, again)),
    }
}

/// Whether a field holds a sentence of an older build: the text of a reason without a finding, or an answer of a decision.
fn is_sentence(recorded: &Map<String, Value>, key: &str) -> bool {
    let is_older_reason = ["code", "dimension", "text"].iter().all(|field| recorded.contains_key(*field))
        && !recorded.contains_key("finding");
    match key {
        "text" | "finding" => is_older_reason,
        "monitoring" | "rollback_when" => recorded.contains_key("admitted"),
        _ => false,
    }
}

fn described(at: &str, recorded: &Value, again: &Value) -> String {
    let quoted = |value: &Value| {
        let text = value.to_string();
        let mut short: String = text.chars().take(QUOTED_CHARS).collect();
        if short.len() < text.len() {
            short.push('…');
        }
        short
    };
    differs(at, quoted(recorded), quoted(again))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_first_difference_is_named_with_both_sides() {
        let recorded = json!({ "outcome": "reject", "reasons": [{ "evidence": 0.1 }] });
        assert_eq!(differing("decision", &recorded, &recorded), None);
        for (again, expected) in [
            (
                json!({ "outcome": "reject", "reasons": [{ "evidence": 0.2 }] }),
                "decision.reasons[0].evidence is 0.1 on record and 0.2 when replayed",
            ),
            (
                json!({ "outcome": "reject", "reasons": [] }),
                "decision.reasons is [{\"evidence\":0.1}] on record and [] when replayed",
            ),
            (
                json!("x"),
                "decision is {\"outcome\":\"reject\",\"reasons\":[{\"evidence\":0.1}]} on record and \"x\" when replayed",
            ),
        ] {
            assert_eq!(differing("decision", &recorded, &again).as_deref(), Some(expected));
        }
    }
    /// An older reason has a sentence in place of the finding; a reason without either differs, and so does a changed finding.
    #[test]
    fn changed_finding_is_a_difference_and_an_older_sentence_is_not() {
        let replayed =
            json!({ "code": "c", "dimension": "d", "finding": { "finding": "f", "n": 1 }, "limit": 2.0 });
        let differs = |recorded: &Value| differing("reason", recorded, &replayed);
        assert_eq!(
            differs(&json!({ "code": "c", "dimension": "d", "text": "so it was", "limit": 2.0 })),
            None
        );
        for recorded in [
            json!({ "code": "c", "dimension": "d", "text": "so it was", "limit": 3.0 }),
            json!({ "code": "e", "dimension": "d", "text": "so it was", "limit": 2.0 }),
            json!({ "code": "c", "dimension": "d", "limit": 2.0 }),
            json!({ "code": "c", "dimension": "d", "finding": { "finding": "f", "n": 2 }, "limit": 2.0 }),
            json!({ "code": "c", "dimension": "d", "finding": { "finding": "f", "n": 1 }, "text": "", "limit": 2.0 }),
        ] {
            assert!(differs(&recorded).is_some(), "{recorded}");
        }
        let answers = |when: &str, admitted: bool| json!({ "admitted": admitted, "rollback_when": when });
        assert_eq!(differing("answers", &answers("then", true), &answers("later", true)), None);
        assert!(differing("answers", &answers("then", true), &answers("then", false)).is_some());
    }
}
