//! The submission beside a manifest: author, origin, parent and estimated risk.
//!
//! Owns the text form of `submission.toml`. Trusts nothing in it: declared traces give an estimate only.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::component::ComponentBytes;
use super::evidence::Signature;
use super::ids::is_name;
use super::text_error::{TextError, check_size, parse_toml};

/// The submitted parts of a version: three texts, and its own code if any.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Package {
    /// Text of `manifest.toml`: what the version declares about itself.
    pub manifest: String,
    /// Text of `submission.toml`: author, provenance, parent and estimated risk.
    pub submission: String,
    /// The parameter file the manifest names; empty if it names none.
    pub params: String,
    /// The component the manifest names; absent for a controller that is compiled in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub component: Option<ComponentBytes>,
    /// Text of `author.sig`: the author's signature over the version; absent where the author did not sign it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub author_signature: Option<String>,
}

/// The largest text of an author's signature, bytes.
pub const AUTHOR_SIGNATURE_BYTES_MAX: usize = 4 * 1024;

/// The largest submission text, bytes; checked before it is parsed.
pub const SUBMISSION_BYTES_MAX: usize = 16 * 1024;

/// The longest summary of a submission, characters.
pub const SUMMARY_CHARS_MAX: usize = 500;

crate::closed_set! {
    /// How a version came about; site policies may treat provenances differently.
    Provenance, "provenance", {
        /// Trained by reinforcement learning.
        Rl = "rl",
        /// Trained by imitation of demonstrations.
        Imitation = "imitation",
        /// Written by a language model.
        Llm = "llm",
        /// Written by a person.
        Manual = "manual",
        /// Found by a parameter optimiser.
        Optimiser = "optimiser",
    }
}

/// The most interface changes a submission declares.
pub const INTERFACE_CHANGES_MAX: usize = 64;

crate::closed_set! {
    /// The part of a version's interface that a change is about (manifest I, O and phi).
    InterfacePart, "part of an interface", {
        /// A field a caller gives.
        Input = "input",
        /// A field it gives back.
        Output = "output",
        /// A setting of the parameter file, typed like an input.
        Parameter = "parameter",
        /// A name by which it can be called.
        EntryPoint = "entry-point",
        /// The preconditions of a call.
        Precondition = "precondition",
        /// The postconditions of a successful call.
        Postcondition = "postcondition",
    }
}

crate::closed_set! {
    /// The kind of change of a part of the interface.
    InterfaceChangeKind, "change of an interface", {
        /// The active version does not have it.
        Added = "added",
        /// Only the active version has it.
        Removed = "removed",
        /// Both have it, and it differs: type, unit, frame, range, default or bound.
        Changed = "changed",
    }
}

/// A change of the interface against the active version, as an author declares it or as it was found.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct InterfaceChange {
    /// The part of the interface.
    pub part: InterfacePart,
    /// Name of the field, parameter, entry point or observable.
    pub name: String,
    /// The kind of change.
    pub change: InterfaceChangeKind,
}

impl std::fmt::Display for InterfaceChange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {} {}", self.part, self.name, self.change)
    }
}

crate::closed_set! {
    /// Risk tier; estimated by the author, raised (never lowered) by what the checks find.
    Risk, "risk", {
        /// An operator's approval counts, and so does an engineer's or a safety officer's.
        Low = "low",
        /// An engineer's or a safety officer's approval counts, an operator's does not.
        Medium = "medium",
        /// As for medium, and a safety officer has to be among the approvers.
        High = "high",
    }
}

/// The contents of `submission.toml`: an author's statements about a version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Submission {
    /// The author (an identity's name).
    pub author: String,
    /// How it came about.
    pub provenance: Provenance,
    /// The version it was made from; absent for a first version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(with = "Option<String>")]
    pub parent: Option<semver::Version>,
    /// The author's estimate of the risk tier; checks may raise it and never lower it.
    pub estimated_risk: Risk,
    /// The changes, in a sentence or two.
    #[serde(default)]
    pub summary: String,
    /// The interface changes that its author declares; compared with those found.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub interface_changes: Vec<InterfaceChange>,
    /// A signature the author claims; shown as an estimate, never used by the gate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub declared_traces: Option<Signature>,
}

impl Submission {
    /// Parses and checks a submission; `file` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`]: text over 16 KiB, TOML that does not parse, unknown fields, a name or number not allowed.
    pub fn parse(file: &str, text: &str) -> Result<Self, TextError> {
        check_size(file, text, SUBMISSION_BYTES_MAX)?;
        let submission: Self = parse_toml(file, text)?;
        let bad = |field: &str, value: &str, allowed: &str| {
            Err(TextError::value(file, text, field, value, allowed))
        };
        if !is_name(&submission.author) {
            return bad("author", &submission.author, "a name of a-z, 0-9, '.', '_' and '-'");
        }
        let chars = submission.summary.chars().count();
        if chars > SUMMARY_CHARS_MAX {
            return bad("summary", &format!("{chars} characters"), "up to 500 characters");
        }
        let declared = submission.interface_changes.len();
        if declared > INTERFACE_CHANGES_MAX {
            return bad("interface_changes", &format!("{declared} changes"), "up to 64 changes");
        }
        if let Some(bad_name) = submission.interface_changes.iter().find(|change| !is_name(&change.name)) {
            return bad("interface_changes.name", &bad_name.name, "a name of a-z, 0-9, '.', '_' and '-'");
        }
        if let Some((field, value, allowed)) = submission.declared_traces.as_ref().and_then(signature_problem)
        {
            return bad(&format!("declared_traces.{field}"), &value.to_string(), allowed);
        }
        Ok(submission)
    }
}

fn signature_problem(s: &Signature) -> Option<(&'static str, f64, &'static str)> {
    let shares = [
        ("success", s.success),
        ("violation", s.violation),
        ("anomaly", s.anomaly),
        ("recovery", s.recovery),
        ("intervention", s.intervention),
        ("timeout", s.timeout),
        ("policy_warning", s.policy_warning),
        ("near_limit", s.near_limit),
    ];
    let means = [("time_s", s.time_s), ("retry", s.retry), ("time_p95_s", s.time_p95_s)];
    let share = shares.into_iter().find(|(_, v)| !(0.0..=1.0).contains(v)).map(|(f, v)| (f, v, "0 to 1"));
    share.or_else(|| {
        means.into_iter().find(|(_, v)| !(0.0..=1.0e4).contains(v)).map(|(f, v)| (f, v, "0 to 10000"))
    })
}
