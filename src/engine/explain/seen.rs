//! What is read from records, leniently: a field that is not there is absent, one that is not known is passed over.
//!
//! Owns the forms; says nothing about them. Records are older and newer than this build.

use serde::Deserialize;
use serde_json::Value;

/// The body of a `decision` record.
#[derive(Debug, Deserialize)]
pub(super) struct Decision {
    pub(super) outcome: Value,
    #[serde(default)]
    pub(super) reasons: Vec<Reason>,
}

/// The body of a `monitor` record.
#[derive(Debug, Deserialize)]
pub(super) struct Monitored {
    pub(super) action: String,
    #[serde(default)]
    pub(super) reasons: Vec<Reason>,
}

/// A reason.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Reason {
    pub(super) code: String,
    #[serde(default)]
    pub(super) dimension: String,
    #[serde(default)]
    pub(super) text: String,
    #[serde(default)]
    pub(super) evidence: Option<f64>,
    #[serde(default)]
    pub(super) limit: Option<f64>,
}

/// The body of a `state-set` record.
#[derive(Debug, Deserialize)]
pub(super) struct Change {
    pub(super) change: Decided,
}

/// A state that changed.
#[derive(Debug, Deserialize)]
pub(super) struct Decided {
    pub(super) from: String,
    pub(super) to: String,
    #[serde(default)]
    pub(super) reason: String,
}

/// A dossier, as far as it is explained.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Dossier {
    pub(super) kappas: Option<Value>,
    pub(super) behavior: Option<Behavior>,
    pub(super) drills: Option<(Drills, Drills)>,
    pub(super) shadow: Option<Shadow>,
    pub(super) pairs: Vec<Pair>,
}

impl Dossier {
    /// Whether the text was a dossier: one that was assessed has its four values.
    pub(super) const fn is_one(&self) -> bool {
        self.kappas.is_some()
    }
}

/// `kappa_B` with its components.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Behavior {
    pub(super) components: Vec<Component>,
    pub(super) pairs: u64,
}

/// One component.
#[derive(Debug, Deserialize)]
pub(super) struct Component {
    pub(super) name: String,
    #[serde(default)]
    pub(super) worsening: f64,
    #[serde(default)]
    pub(super) lower: f64,
    #[serde(default)]
    pub(super) upper: Option<f64>,
    #[serde(default)]
    pub(super) tolerance: f64,
}

/// Outcomes of the drills of one version.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Drills {
    pub(super) rollback: Tally,
    pub(super) fallback: Tally,
    pub(super) abort: Tally,
    pub(super) detect: Tally,
}

impl Drills {
    /// Kinds with their names.
    pub(super) const fn each(&self) -> [(&'static str, &Tally); 4] {
        [
            ("rollback", &self.rollback),
            ("fallback", &self.fallback),
            ("abort", &self.abort),
            ("detect", &self.detect),
        ]
    }
}

/// Drills of one kind.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Tally {
    pub(super) passed: u64,
    pub(super) failed: u64,
}

impl Tally {
    /// Drills that say something.
    pub(super) const fn feasible(&self) -> u64 {
        self.passed.saturating_add(self.failed)
    }
}

/// What shadow came to.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Shadow {
    pub(super) check: Value,
    pub(super) reasons: Vec<Reason>,
    pub(super) sequences: u64,
}

/// One episode of both versions.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Pair {
    pub(super) active: Values,
    pub(super) candidate: Values,
}

/// What an episode gave, as far as it is counted.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Values {
    pub(super) success: bool,
    pub(super) violation: bool,
    pub(super) anomaly: bool,
    pub(super) recovery: bool,
}

/// A unit variant's name, or that of a variant with content.
pub(super) fn word(value: &Value) -> String {
    match value {
        Value::String(word) => word.clone(),
        Value::Object(fields) => fields.keys().next().cloned().unwrap_or_else(|| "unknown".to_owned()),
        _ => "unknown".to_owned(),
    }
}
