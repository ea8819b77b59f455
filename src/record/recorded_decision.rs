//! A stage's decision in the audit chain: the rule's result, and beside it the rationale for people.
//!
//! The rationale has no effect: a replay uses only the rule's own part, and compares with it.

use holdpoint_governance::decision::Decision;
use holdpoint_protocol::detail::FieldDiff;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::evidence_file::EvidenceFile;
use crate::rationale::check_explanation;

/// The field of the rationale; a rule's decision has no such field.
const RATIONALE_KEY: &str = "said";

/// The most differences to the active version in a record; the evidence file has all.
const CHANGES_MAX: usize = 20;

/// The rationale of a decision.
#[derive(Serialize)]
struct DecisionRationale<'a> {
    /// The deciding sentences with their numbers, and the episodes that show them.
    why: Vec<String>,
    /// The first differences from the version it was compared with.
    changes: &'a [FieldDiff],
    /// How many differences there are.
    differences: usize,
}

/// The body of a decision's record.
///
/// # Errors
/// If a part has no JSON form.
pub fn body<O: Serialize>(
    decision: &Decision<O>,
    evidence_file: &EvidenceFile,
) -> Result<String, serde_json::Error> {
    let mut whole: Map<String, Value> = serde_json::from_value(serde_json::to_value(decision)?)?;
    let changes = &evidence_file.changes.fields;
    let rationale = DecisionRationale {
        why: check_explanation::decision_sentences(evidence_file, decision.reasons()),
        changes: changes.get(..CHANGES_MAX).unwrap_or(changes),
        differences: changes.len(),
    };
    whole.insert(RATIONALE_KEY.to_owned(), serde_json::to_value(rationale)?);
    serde_json::to_string(&whole)
}

/// The rule's result in the record of a decision, without the rationale.
#[must_use]
pub fn rule_part(body: &str) -> Option<Value> {
    let mut whole = serde_json::from_str::<Value>(body).ok()?;
    whole.as_object_mut()?.remove(RATIONALE_KEY);
    Some(whole)
}

/// The deciding sentences recorded with a decision; none in records of older builds.
#[must_use]
pub fn sentences(body: &str) -> Vec<String> {
    let whole = serde_json::from_str::<Value>(body).ok();
    let why = whole.as_ref().and_then(|whole| whole.get(RATIONALE_KEY)?.get("why")?.as_array());
    let texts = why.into_iter().flatten().filter_map(Value::as_str);
    texts.map(str::to_owned).collect()
}
