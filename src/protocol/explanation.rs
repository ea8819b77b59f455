//! Why a version is in its state: every recorded decision with its rule, reasons, remedy and consequence.
//!
//! Owns the forms; the engine's `explain` fills them from the record.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::cached_result::CachedResultUse;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::permission::PermissionUse;
use holdpoint_governance::rollback::PostStatus;

/// All decisions about a version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Explanation {
    /// The version.
    pub version: CapabilityId,
    /// The lifecycle state it is in now.
    pub state: State,
    /// Identity of its author, as the submission has it.
    pub author: String,
    /// Every decision about it, in the order they were made.
    pub decisions: Vec<DecisionExplanation>,
}

/// One decision on record, with the rule and the reasons that made it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DecisionExplanation {
    /// Number of the audit record the decision stands in.
    pub record: u64,
    /// Virtual time of the decision, ms.
    pub at_ms: u64,
    /// The decider and its outcome.
    #[serde(flatten)]
    pub ruling: Ruling,
    /// The rule that decided.
    pub rule: Rule,
    /// The deciding sentences with their numbers, as they went on record with it; none in records of older builds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub said: Vec<String>,
    /// Why, the deciding reasons first.
    pub reasons: Vec<ExplainedReason>,
    /// Required changes for the next better outcome; empty if there is none.
    pub change: Vec<String>,
    /// Declared against observed permissions, after the sandbox.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub permissions: Option<PermissionUse>,
    /// The cached results in the evidence after the sandbox; absent if every episode was run for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept: Option<CachedResultUse>,
    /// What happened next, until the next decision.
    pub then: Vec<String>,
}

/// The decider and its outcome in the rule's own word: `stage` and `outcome` in JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "stage", content = "outcome", rename_all = "kebab-case")]
pub enum Ruling {
    /// On registration, before there was evidence.
    Registration(Lenient<StageOutcome>),
    /// The four compatibility checks of stage 2.
    Validation(Lenient<StageOutcome>),
    /// Sandbox episodes and recovery drills, stage 3.
    Sandbox(Lenient<StageOutcome>),
    /// Shadow deployment, stage 4.
    Shadow(Lenient<StageOutcome>),
    /// The activation gate, stage 5.
    Activation(Lenient<StageOutcome>),
    /// The monitor of the active version, stage 6.
    Monitor(Lenient<MonitorOutcome>),
    /// The rollback ladder, stage 7.
    Rollback(Lenient<PostStatus>),
    /// People, or the clock if they did not answer.
    People(PeopleRuling),
}

/// The result of an approval request, answered or expired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum PeopleRuling {
    /// A person's signed answer to a request.
    Answered(ApprovalDecision),
    /// The version was moved without an answer, to this state.
    Moved(State),
}

impl fmt::Display for PeopleRuling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Answered(answer) => answer.fmt(f),
            Self::Moved(state) => state.fmt(f),
        }
    }
}

impl Ruling {
    /// The decider, by the name of the stage.
    #[must_use]
    pub const fn stage(&self) -> &'static str {
        match self {
            Self::Registration(_) => "registration",
            Self::Validation(_) => "validation",
            Self::Sandbox(_) => "sandbox",
            Self::Shadow(_) => "shadow",
            Self::Activation(_) => "activation",
            Self::Monitor(_) => "monitor",
            Self::Rollback(_) => "rollback",
            Self::People(_) => "people",
        }
    }

    /// The decision, by the name of the outcome.
    #[must_use]
    pub fn outcome(&self) -> String {
        match self {
            Self::Registration(outcome)
            | Self::Validation(outcome)
            | Self::Sandbox(outcome)
            | Self::Shadow(outcome)
            | Self::Activation(outcome) => outcome.to_string(),
            Self::Monitor(outcome) => outcome.to_string(),
            Self::Rollback(status) => status.to_string(),
            Self::People(ruling) => ruling.to_string(),
        }
    }

    /// The rule of this stage.
    #[must_use]
    pub const fn rule(&self) -> Rule {
        match self {
            Self::Registration(_) => Rule::Lifecycle,
            Self::Validation(_) => Rule::Validation,
            Self::Sandbox(_) => Rule::Sandbox,
            Self::Shadow(_) => Rule::Shadow,
            Self::Activation(_) => Rule::Activation,
            Self::Monitor(_) => Rule::Monitor,
            Self::Rollback(_) => Rule::Ladder,
            Self::People(_) => Rule::Approval,
        }
    }
}

/// A reason with the evidence it rests on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ExplainedReason {
    /// The stable name; an empty text for a remark that no rule produced.
    #[serde(with = "blank")]
    #[schemars(with = "String")]
    pub code: Option<Lenient<ReasonCode>>,
    /// Its dimension; an empty text if an older record names none.
    #[serde(with = "blank")]
    #[schemars(with = "String")]
    pub dimension: Option<Lenient<Dimension>>,
    /// Whether it speaks for the version.
    pub in_favour: bool,
    /// The finding, one sentence as recorded.
    pub text: String,
    /// The measured value; absent if there is none.
    pub evidence: Option<f64>,
    /// The limit the value was compared with; absent if there is none.
    pub limit: Option<f64>,
    /// The rule it belongs to, which may be another than the decision's.
    pub rule: Rule,
    /// The measurement, if the stored evidence has more than the reason: n, value, interval.
    pub measured: Option<String>,
}

/// A word that may be missing, then written as an empty text.
pub(crate) mod blank {
    use serde::de::IntoDeserializer;
    use serde::de::value::StringDeserializer;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[allow(clippy::ref_option, reason = "the form that serde asks for")]
    pub(crate) fn serialize<T: Serialize, S: Serializer>(
        value: &Option<T>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        match value {
            Some(value) => value.serialize(serializer),
            None => serializer.serialize_str(""),
        }
    }

    pub(crate) fn deserialize<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<T>, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.is_empty() {
            return Ok(None);
        }
        let source: StringDeserializer<D::Error> = text.into_deserializer();
        T::deserialize(source).map(Some)
    }
}

macro_rules! rules {
    ($($(#[$doc:meta])* $member:ident = $name:literal, $source:literal;)+) => {
        /// A rule by name, with its source in the design and the paper.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Rule { $($(#[$doc])* $member),+ }

        impl Rule {
            /// Every rule, in the order of declaration.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$member),+];

            /// Its name, as records and screens have it.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$member => $name),+ }
            }

            /// Design rule and section of the paper.
            #[must_use]
            pub const fn source(self) -> &'static str {
                match self { $(Self::$member => $source),+ }
            }
        }
    };
}

rules! {
    /// Interface compatibility, `kappa_I`.
    Interface = "kappa_I", "design rule 3.2; paper section 4.3, Procedure 1";
    /// Policy compatibility, `kappa_P`.
    Policy = "kappa_P", "design rule 3.3; paper section 4.3, Procedure 1";
    /// Behavior compatibility, `kappa_B`.
    Behavior = "kappa_B", "design rule 3.4; paper section 4.3, Table 3";
    /// Recovery compatibility, `kappa_R`.
    Recovery = "kappa_R", "design rule 3.5; paper section 4.3";
    /// The rule that joins the four, `Psi`.
    Composition = "Psi", "design rule 3.6; paper Procedure 2";
    /// The shadow comparison `Delta_shadow`, for a single reason.
    Divergence = "Delta_shadow", "design rule 3.7; paper section 5.2, stage 4";
    /// The activation gate `theta_act`, for a single reason.
    Gate = "theta_act", "design rule 3.7; paper equation 10";
    /// The monitor `M`, for a single reason.
    Watch = "M", "design rule 3.8; paper equation 11";
    /// Any rule: an older record does not name it.
    Any = "the rules", "design, chapter 3";
    /// The rule of stage 2: the four checks, joined.
    Validation = "Psi over the four compatibilities",
        "design rules 3.2, 3.3, 3.6; paper section 4.3, Procedures 1 and 2";
    /// The rule of stage 3: measured behavior and drilled recovery, joined.
    Sandbox = "Psi over measured behaviour and rehearsed recovery",
        "design rules 3.4 to 3.6; paper section 4.3, Procedure 2";
    /// The rule of stage 4: the live world against its twin.
    Shadow = "Delta_shadow, live work against its twin", "design rules 3.7, 5.4; paper section 5.2, stage 4";
    /// The rule of stage 5: the activation gate.
    Activation = "theta_act, the activation gate",
        "design rule 3.7; paper equation 10, section 5.2, stage 5";
    /// The rule of stage 6: the monitor of the active version.
    Monitor = "M, the monitor", "design rule 3.8; paper equation 11, section 5.2, stage 6";
    /// The rule of stage 7: the ladder from revoked authority to the rollback target's first tasks.
    Ladder = "the rollback ladder", "design rule 3.11; paper section 5.2, stage 7, appendix F.3";
    /// The rule of a version's lifecycle states.
    Lifecycle = "the lifecycle", "design rule 3.9; paper appendix A";
    /// The rule of valid approvals and the quorum.
    Approval = "approval by people", "design rule 3.10; paper section 5.2, stage 5";
}

impl From<Dimension> for Rule {
    fn from(dimension: Dimension) -> Self {
        match dimension {
            Dimension::Interface => Self::Interface,
            Dimension::Policy => Self::Policy,
            Dimension::Behavior => Self::Behavior,
            Dimension::Recovery => Self::Recovery,
            Dimension::Composition => Self::Composition,
            Dimension::Shadow => Self::Divergence,
            Dimension::Gate => Self::Gate,
            Dimension::Approval => Self::Approval,
            Dimension::Monitor => Self::Watch,
        }
    }
}

/// The serialized rule: two fields, so that a reader needs no list of rules.
#[derive(Serialize, Deserialize, JsonSchema)]
#[schemars(rename = "Rule")]
struct RuleDocument {
    /// Name of the rule, e.g. `kappa_B`.
    name: String,
    /// Design rule and section of the paper.
    source: String,
}

impl Serialize for Rule {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        RuleDocument { name: self.name().to_owned(), source: self.source().to_owned() }.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Rule {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let written = RuleDocument::deserialize(deserializer)?;
        let known = Self::ALL.into_iter().find(|rule| rule.name() == written.name);
        known.ok_or_else(|| serde::de::Error::custom(format!("{:?} is no rule", written.name)))
    }
}

impl JsonSchema for Rule {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        RuleDocument::schema_name()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        RuleDocument::json_schema(generator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decision_keeps_its_form() {
        let reason = ExplainedReason {
            code: Some(Lenient::Known(ReasonCode::GatePassed)),
            dimension: Some(Lenient::Known(Dimension::Gate)),
            in_favour: true,
            text: "passed".to_owned(),
            evidence: Some(0.1),
            limit: None,
            rule: Rule::Gate,
            measured: None,
        };
        let beside = ExplainedReason { code: None, dimension: None, in_favour: false, ..reason.clone() };
        let decision = DecisionExplanation {
            record: 7,
            at_ms: 1_500,
            ruling: Ruling::Activation(StageOutcome::Pass.into()),
            rule: Rule::Activation,
            said: Vec::new(),
            reasons: vec![reason, beside],
            change: Vec::new(),
            permissions: None,
            kept: None,
            then: Vec::new(),
        };
        let json = serde_json::to_string(&decision).unwrap();
        assert_eq!(
            json,
            r#"{"record":7,"at_ms":1500,"stage":"activation","outcome":"pass","rule":{"name":"theta_act, the activation gate","source":"design rule 3.7; paper equation 10, section 5.2, stage 5"},"reasons":[{"code":"gate-passed","dimension":"gate","in_favour":true,"text":"passed","evidence":0.1,"limit":null,"rule":{"name":"theta_act","source":"design rule 3.7; paper equation 10"},"measured":null},{"code":"","dimension":"","in_favour":false,"text":"passed","evidence":0.1,"limit":null,"rule":{"name":"theta_act","source":"design rule 3.7; paper equation 10"},"measured":null}],"change":[],"then":[]}"#
        );
        assert_eq!(serde_json::from_str::<DecisionExplanation>(&json).unwrap(), decision);
    }

    /// Every word of every decider survives a round trip, including unknown ones.
    #[test]
    fn decisive_rulings_round_trip() {
        let stages =
            StageOutcome::ALL.map(Lenient::Known).into_iter().chain([Lenient::Unknown("later".into())]);
        let mut rulings: Vec<Ruling> = stages.map(Ruling::Shadow).collect();
        rulings.extend(MonitorOutcome::ALL.map(|outcome| Ruling::Monitor(outcome.into())));
        rulings.extend(PostStatus::ALL.map(|status| Ruling::Rollback(status.into())));
        rulings
            .extend(ApprovalDecision::ALL.map(|decision| Ruling::People(PeopleRuling::Answered(decision))));
        rulings.extend(State::ALL.map(|state| Ruling::People(PeopleRuling::Moved(state))));
        for ruling in rulings {
            let json = serde_json::to_value(&ruling).unwrap();
            assert_eq!(json["stage"], ruling.stage());
            assert_eq!(json["outcome"], ruling.outcome());
            assert_eq!(serde_json::from_value::<Ruling>(json).unwrap(), ruling);
        }
    }

    #[test]
    fn rules_have_a_name_each() {
        let names: std::collections::BTreeSet<&str> = Rule::ALL.iter().map(|rule| rule.name()).collect();
        assert_eq!(names.len(), Rule::ALL.len());
    }
}
