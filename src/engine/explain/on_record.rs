//! What is read from records, leniently: records are older and newer than this build.
//!
//! The forms are governance's own. What a record lacks is absent; a part that this build cannot read is as if it were
//! not there, and a word it does not know is kept as it is.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use holdpoint_governance::behavior::BehaviorAssessment;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::evidence::{Drills, Pair};
use holdpoint_governance::gate::ShadowAssessment;
use holdpoint_governance::kept::KeptUse;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::words::Word;

/// The body of a `decision` record.
#[derive(Debug, Deserialize)]
pub(super) struct DecisionRecord {
    /// A word, or a word with content.
    pub(super) outcome: Value,
    #[serde(default)]
    pub(super) reasons: Vec<Noted>,
}

/// The body of a `monitor` record.
#[derive(Debug, Deserialize)]
pub(super) struct Monitored {
    pub(super) action: Word<MonitorOutcome>,
    #[serde(default)]
    pub(super) reasons: Vec<Noted>,
}

/// A reason as it was noted.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Noted {
    pub(super) code: Word<ReasonCode>,
    #[serde(default)]
    pub(super) dimension: Option<Word<Dimension>>,
    #[serde(default)]
    pub(super) text: String,
    #[serde(default)]
    pub(super) evidence: Option<f64>,
    #[serde(default)]
    pub(super) limit: Option<f64>,
}

impl From<&Reason> for Noted {
    fn from(reason: &Reason) -> Self {
        Self {
            code: reason.code.into(),
            dimension: Some(reason.dimension.into()),
            text: reason.text.clone(),
            evidence: reason.evidence,
            limit: reason.limit,
        }
    }
}

impl Noted {
    /// Whether it is about this part of the rules.
    pub(super) fn is_about(&self, dimension: Dimension) -> bool {
        self.dimension.as_ref().is_some_and(|about| *about == dimension)
    }
}

/// The body of a `state-set` record.
#[derive(Debug, Deserialize)]
pub(super) struct StateSetRecord {
    pub(super) change: MoveRecord,
}

/// A state that changed.
#[derive(Debug, Deserialize)]
pub(super) struct MoveRecord {
    pub(super) from: State,
    pub(super) to: State,
    #[serde(default)]
    pub(super) reason: String,
}

/// A dossier, as far as it is explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct DossierRecord {
    pub(super) kappas: Option<Value>,
    #[serde(deserialize_with = "readable")]
    pub(super) behavior: Option<BehaviorAssessment>,
    #[serde(deserialize_with = "readable")]
    pub(super) drills: Option<(Drills, Drills)>,
    #[serde(deserialize_with = "readable")]
    pub(super) shadow: Option<ShadowAssessment>,
    #[serde(deserialize_with = "readable")]
    pub(super) pairs: Option<Vec<Pair>>,
    #[serde(deserialize_with = "readable")]
    pub(super) permissions: Option<PermissionUse>,
    #[serde(deserialize_with = "readable")]
    pub(super) kept: Option<KeptUse>,
}

/// The evidence of a confirmation, as far as it is explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct ConfirmationRecord {
    #[serde(deserialize_with = "readable")]
    pub(super) kept: Option<KeptUse>,
}

impl DossierRecord {
    /// Whether the text was a dossier: one that was assessed has its four values.
    pub(super) const fn is_one(&self) -> bool {
        self.kappas.is_some()
    }
}

/// A part that this build can read; absent otherwise.
fn readable<'de, T: DeserializeOwned, D: Deserializer<'de>>(deserializer: D) -> Result<Option<T>, D::Error> {
    Value::deserialize(deserializer).map(|value| serde_json::from_value(value).ok())
}

/// A unit variant's name, or that of a variant with content.
pub(super) fn word(value: &Value) -> String {
    match value {
        Value::String(word) => word.clone(),
        Value::Object(fields) => fields.keys().next().cloned().unwrap_or_else(|| "unknown".to_owned()),
        _ => "unknown".to_owned(),
    }
}
