//! A stage's decision as the audit chain keeps it: what the rule came to, and beside it the words and numbers in which
//! people are told why.
//!
//! What is said decides nothing: a decision is made again from the rule's own part, and compared with that.

use holdpoint_governance::decision::Decision;
use holdpoint_protocol::detail::Difference;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::dossier::Dossier;
use crate::view::why;

/// The field of what is said; a rule's decision has none of this name.
const SAID: &str = "said";

/// The most differences to the active version that a record names; the dossier has all.
const CHANGES_MAX: usize = 20;

/// What people are told of a decision.
#[derive(Serialize)]
struct Said<'a> {
    /// The deciding sentences with their numbers, and which work shows it.
    why: Vec<String>,
    /// In what it differs from the version it was compared with: the first of them.
    changes: &'a [Difference],
    /// How many differences there are.
    differences: usize,
}

/// The body of a decision's record.
///
/// # Errors
/// If a part has no JSON form.
pub fn body<O: Serialize>(decision: &Decision<O>, dossier: &Dossier) -> Result<String, serde_json::Error> {
    let mut whole: Map<String, Value> = serde_json::from_value(serde_json::to_value(decision)?)?;
    let changes = &dossier.changes.fields;
    let said = Said {
        why: why::of_decision(dossier, decision.reasons()),
        changes: changes.get(..CHANGES_MAX).unwrap_or(changes),
        differences: changes.len(),
    };
    whole.insert(SAID.to_owned(), serde_json::to_value(said)?);
    serde_json::to_string(&whole)
}

/// What a rule came to, as the record of a decision has it, without what is said beside it.
#[must_use]
pub fn rule_part(body: &str) -> Option<Value> {
    let mut whole = serde_json::from_str::<Value>(body).ok()?;
    whole.as_object_mut()?.remove(SAID);
    Some(whole)
}

/// The deciding sentences that were put on record with a decision; none in records of older builds.
#[must_use]
pub fn sentences(body: &str) -> Vec<String> {
    let whole = serde_json::from_str::<Value>(body).ok();
    let why = whole.as_ref().and_then(|whole| whole.get(SAID)?.get("why")?.as_array());
    let texts = why.into_iter().flatten().filter_map(Value::as_str);
    texts.map(str::to_owned).collect()
}
