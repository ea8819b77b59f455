//! The bodies of exported records about persons, witnesses, profiles, approvals and rebuilds. Each has one text, as
//! [`canonical_json`] writes it, and the fields of its form.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::profile_history::ContextRules;
use super::rebuild_report::RebuildRecordChange;
use super::recorded_approval::RecordedApproval;
use holdpoint_approvals::{SignedPersonAct, SignedProfileAct, SignedWitnessAct};
use holdpoint_governance::ids::{Digest, canonical_json};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;

/// The most commas and opening brackets of a body, which bounds its values.
const BODY_MARKS_MAX: usize = 1 << 20;
/// The deepest nesting of brackets.
const BODY_DEPTH_MAX: usize = 32;

/// The judged content of a record.
pub(crate) enum RecordStatement {
    Put(RecordedApproval),
    /// An act about a person, and the name of the change.
    Act {
        change: String,
        signed: Box<SignedPersonAct>,
    },
    Witness(ExportedWitness),
    Profile(ExportedProfileAct),
    Context(ExportedContext),
    /// Nonces of approvals that a rebuild gave up.
    Lost(Vec<String>),
    Nothing,
}

/// A witness that was added or removed.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExportedWitness {
    change: String,
    pub(crate) folder: String,
    pub(crate) present: bool,
    by: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) act: Option<Box<SignedWitnessAct>>,
}

/// A change of profile that was authorized.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExportedProfileAct {
    change: String,
    pub(crate) profile: ProfileName,
    by: String,
    pub(crate) act: Box<SignedProfileAct>,
}

/// A profile that came into force.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExportedContext {
    change: String,
    /// Its content, which records of earlier versions lack.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    json: Option<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(crate) looser_by_word: bool,
    policy_digest: Digest,
    pub(crate) profile: ProfileName,
    /// Its requirements, which records of earlier versions lack.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) rules: Option<ContextRules>,
}

/// A body of a record that the store writes itself.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ExportedBody<C> {
    change: C,
    rows: Vec<(String, String, Digest)>,
}

pub(crate) fn read(kind: Option<&RecordKind>, text: &str) -> Result<RecordStatement, String> {
    match kind {
        Some(RecordKind::ApprovalPut) => {
            let change: RecordedApproval = change_of(text)?;
            named(&change.change, "put-approval")?;
            Ok(RecordStatement::Put(change))
        }
        Some(RecordKind::PersonEnrolled | RecordKind::PersonConfirmed | RecordKind::PersonRevoked) => {
            let mut change: Value = change_of(text)?;
            let name = change.as_object_mut().and_then(|fields| fields.remove("change"));
            let Some(Value::String(name)) = name else {
                return Err("it is no act about a person".to_owned());
            };
            Ok(RecordStatement::Act { change: name, signed: Box::new(typed(change)?) })
        }
        Some(RecordKind::WitnessSet) => {
            let change: ExportedWitness = change_of(text)?;
            named(&change.change, "set-witness")?;
            Ok(RecordStatement::Witness(change))
        }
        Some(RecordKind::ProfileAllowed) => {
            let change: ExportedProfileAct = change_of(text)?;
            named(&change.change, "allow-profile")?;
            Ok(RecordStatement::Profile(change))
        }
        Some(RecordKind::ContextSet) => {
            let change: ExportedContext = change_of(text)?;
            named(&change.change, "set-context")?;
            Ok(RecordStatement::Context(change))
        }
        Some(RecordKind::StoreRebuilt) => {
            let ExportedBody { change, rows } = typed::<ExportedBody<RebuildRecordChange>>(value_of(text)?)?;
            named(&change.change, "store-rebuilt")?;
            let approvals = rows.into_iter().filter(|(table, ..)| table == "approval");
            Ok(RecordStatement::Lost(approvals.map(|(_, nonce, _)| nonce).collect()))
        }
        Some(_) | None => Ok(RecordStatement::Nothing),
    }
}

fn named(found: &str, expected: &str) -> Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("its change is {found:?}, not {expected:?}")) }
}

fn change_of<C: Serialize + DeserializeOwned>(text: &str) -> Result<C, String> {
    typed(value_of(text)?).map(|body: ExportedBody<C>| body.change)
}

/// A value with the fields of its form: all of them, and optional ones only with content.
pub(crate) fn typed<T: Serialize + DeserializeOwned>(value: Value) -> Result<T, String> {
    let typed = T::deserialize(&value).map_err(|error| error.to_string())?;
    if serde_json::to_value(&typed).map_err(|error| error.to_string())? == value {
        return Ok(typed);
    }
    Err("its fields are not those of its form".to_owned())
}

/// Parses a text that must be the canonical text of its value.
pub(crate) fn value_of(text: &str) -> Result<Value, String> {
    if text.bytes().filter(|byte| matches!(byte, b',' | b'[' | b'{')).count() > BODY_MARKS_MAX {
        return Err(format!(
            "it has more than {BODY_MARKS_MAX} commas and brackets, and so many are allowed"
        ));
    }
    let value: Value = serde_json::from_str(text).map_err(|error| error.to_string())?;
    check(&value, BODY_DEPTH_MAX)?;
    if canonical_json(&value).map_err(|error| error.to_string())? == text {
        return Ok(value);
    }
    Err("it is not as it was written".to_owned())
}

/// Whole numbers only, and a limited nesting.
fn check(value: &Value, depth: usize) -> Result<(), String> {
    let deeper = || depth.checked_sub(1).ok_or(format!("it has brackets deeper than {BODY_DEPTH_MAX}"));
    match value {
        Value::Number(number) if !number.is_u64() && !number.is_i64() => {
            Err(format!("{number} is no whole number"))
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => Ok(()),
        Value::Array(values) => {
            let depth = deeper()?;
            values.iter().try_for_each(|value| check(value, depth))
        }
        Value::Object(fields) => {
            let depth = deeper()?;
            fields.values().try_for_each(|value| check(value, depth))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn export_body_has_one_spelling() {
        let deep = |count: usize| "[".repeat(count) + &"]".repeat(count);
        for good in ["{\"a\":1,\"b\":[-9223372036854775808,18446744073709551615]}", "\"\u{7f}é\"", &deep(32)]
        {
            assert!(value_of(good).is_ok(), "{good}");
        }
        let marks = format!("[{}0]", "0,".repeat(BODY_MARKS_MAX));
        for bad in [
            "{\"b\":1,\"a\":1}",
            "{\"a\":1,\"a\":1}",
            "{\"a\": 1}",
            "[1.0]",
            "[1e2]",
            "[-0]",
            "[18446744073709551616]",
            "[-9223372036854775809]",
            "[NaN]",
            "\"\\u0041\"",
            "\"\\/\"",
            "1\n",
            "\u{feff}1",
            &deep(33),
            &deep(1000),
            &marks,
        ] {
            assert!(value_of(bad).is_err(), "{bad:.60}");
        }
    }
}
