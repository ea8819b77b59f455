//! Scenario files: a scripted operator as data.
//!
//! ```toml
//! profile = "human"
//! seed = 1
//!
//! [[step]]
//! register = "manifests/candidates/grasp-improved"
//! [[step]]
//! wait = { prompt = "grasp@1.1.0", timeout_s = 600 }
//! [[step]]
//! approve = { as = "alice", reason = "evidence read" }
//! [[step]]
//! expect = { state = "active", reason = "approval-granted" }
//! ```

use serde::Deserialize;

use holdpoint_body::disturbance::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::alarms::AlarmKind;
use holdpoint_governance::approval::Role;
use holdpoint_governance::closed_set::ClosedSetError;
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::text_error::{self, TextError};
use holdpoint_protocol::scenario_state::{Decider, ScenarioState};

/// The largest scenario file, bytes.
pub const SCRIPT_BYTES_MAX: usize = 64 * 1024;

pub const STEPS_MAX: usize = 256;

/// The most sequences of one step.
pub const SEQUENCES_MAX: u32 = 10_000;

/// The longest wait, virtual s.
pub const WAIT_MAX_SECS: f64 = 1.0e6;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// Its purpose, for readers.
    #[serde(default)]
    pub about: String,
    pub profile: ProfileName,
    /// The run's seed; the command line overrides it.
    #[serde(default)]
    pub seed: Option<u32>,
    /// The steps, in order.
    #[serde(rename = "step")]
    pub steps: Vec<ScriptStep>,
}

/// One step: exactly one of its fields.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScriptStep {
    /// Submit the candidate in this folder (an embedded one, or a path from the working folder).
    pub register: Option<ScriptRegistration>,
    /// Wait for a state or a prompt.
    pub wait: Option<WaitStep>,
    pub approve: Option<DecisionStep>,
    pub reject: Option<DecisionStep>,
    /// Activate the last candidate by break-glass, as one person.
    pub break_glass: Option<DecisionStep>,
    /// Return the last candidate to evaluation, or block it under profiles.
    pub demote: Option<ProfileStep>,
    /// Lift its restriction, or unblock it under profiles.
    pub release: Option<ProfileStep>,
    /// Run one of its stages again.
    pub repeat: Option<RepeatStep>,
    /// Tighten its envelope.
    pub restrict: Option<DecisionStep>,
    /// Roll it back.
    pub rollback: Option<DecisionStep>,
    /// Pause it.
    pub pause: Option<DecisionStep>,
    /// Resume it.
    pub resume: Option<DecisionStep>,
    /// Answer its escalation: it continues.
    #[serde(rename = "continue")]
    pub go_on: Option<DecisionStep>,
    /// Make it its family's anchor.
    pub anchor: Option<DecisionStep>,
    /// The goal of the live cell's agent from its next sequence on.
    pub goal: Option<String>,
    /// Begin a drift.
    pub drift: Option<DriftStep>,
    /// Inject a fault into the live cell.
    pub fault: Option<FaultStep>,
    /// Stop the cell.
    pub stop: Option<DecisionStep>,
    /// Start the stopped cell.
    pub go: Option<DecisionStep>,
    /// Let time pass.
    pub pass: Option<TimeStep>,
    /// Run the live cell for this many sequences, with or without an evaluation.
    pub work: Option<LiveStep>,
    /// Check the result.
    pub expect: Option<ExpectStep>,
}

/// A submitted candidate: its folder alone, or with the person who requests it.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum ScriptRegistration {
    /// Its requester is the script, which approves nothing.
    Folder(String),
    /// Its requester is a person, who cannot approve it.
    By(RegistrationBy),
}

/// A candidate that a person submits.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegistrationBy {
    /// Its folder, as in the plain form.
    pub folder: String,
    /// The person who requests it.
    #[serde(rename = "as")]
    pub who: String,
}

impl ScriptRegistration {
    /// The candidate's folder.
    #[must_use]
    pub fn folder(&self) -> &str {
        match self {
            Self::Folder(folder) => folder,
            Self::By(by) => &by.folder,
        }
    }

    /// The person who requests it; absent if the step names none.
    #[must_use]
    pub fn requester(&self) -> Option<&str> {
        match self {
            Self::Folder(_) => None,
            Self::By(by) => Some(&by.who),
        }
    }
}

/// The awaited condition.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WaitStep {
    /// Until the candidate has this state.
    #[serde(default)]
    pub state: Option<ScenarioState>,
    /// Until such an approval request is open.
    #[serde(default)]
    pub prompt: Option<AwaitedRequest>,
    /// Until a drift monitor escalates for such a version.
    #[serde(default)]
    pub question: Option<AwaitedRequest>,
    /// Longest wait, virtual s.
    pub timeout_s: f64,
}

/// A decision on a waiting version.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionStep {
    #[serde(rename = "as")]
    pub who: String,
    pub reason: String,
    /// The role to enroll the person in, if the store does not know them; a role other than engineer takes
    /// precedence.
    #[serde(default = "engineer")]
    pub role: Role,
}

const fn engineer() -> Role {
    Role::Engineer
}

/// Sequences for the live cell to run.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveStep {
    pub sequences: u32,
    /// An alarm of this kind that must be raised meanwhile; it ends the step.
    #[serde(default)]
    pub until: Option<AlarmKind>,
}

/// Time that passes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeStep {
    /// Virtual s.
    pub for_s: f64,
}

/// A person's act on a version, and the profiles it applies to.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileStep {
    #[serde(rename = "as")]
    pub who: String,
    pub reason: String,
    /// Empty: for the version as a whole.
    #[serde(default)]
    pub profiles: Vec<ProfileName>,
}

/// A stage to run again.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RepeatStep {
    #[serde(rename = "as")]
    pub who: String,
    pub reason: String,
    /// Sandbox or shadow.
    pub stage: Stage,
}

/// A drift of the live cell.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftStep {
    pub kind: DriftKind,
    pub magnitude: Magnitude,
}

/// A lasting fault of the live cell.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultStep {
    pub kind: LiveFault,
}

/// The expected result of the last candidate.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExpectStep {
    pub state: ScenarioState,
    /// A reason code that must be among those given for it.
    #[serde(default)]
    pub reason: Option<ReasonCode>,
    #[serde(default)]
    pub stage: Option<Decider>,
    /// The dimension of the reason.
    #[serde(default)]
    pub dimension: Option<Dimension>,
}

/// The awaited request: `any`, or one for a version.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum AwaitedRequest {
    Any,
    For(CapabilityId),
}

impl AwaitedRequest {
    /// Whether a request for `version` matches.
    #[must_use]
    pub fn is_about(&self, version: &CapabilityId) -> bool {
        match self {
            Self::Any => true,
            Self::For(awaited) => awaited == version,
        }
    }
}

impl TryFrom<String> for AwaitedRequest {
    type Error = ClosedSetError;
    fn try_from(text: String) -> Result<Self, ClosedSetError> {
        if text == "any" {
            return Ok(Self::Any);
        }
        let wrong =
            |_| ClosedSetError::new("prompt to wait for", &text, ["any", "<family>@<version>"].into_iter());
        text.parse().map(Self::For).map_err(wrong)
    }
}

impl Script {
    /// Parses a scenario; `file` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`] with file and line: an unknown key, a step with none or several of its fields, or a time that
    /// is not a number.
    pub fn parse(file: &str, text: &str) -> Result<Self, TextError> {
        text_error::check_size(file, text, SCRIPT_BYTES_MAX)?;
        let script: Self = text_error::parse_toml(file, text)?;
        let problem = |field: &str, value: &str, allowed: &str| {
            Err(TextError::value(file, text, field, value, allowed))
        };
        if script.steps.is_empty() || script.steps.len() > STEPS_MAX {
            return problem("step", &format!("{} steps", script.steps.len()), "1 to 256 steps");
        }
        for (index, step) in script.steps.iter().enumerate() {
            let at = format!("step[{index}]");
            let given = [
                step.register.is_some(),
                step.wait.is_some(),
                step.approve.is_some(),
                step.reject.is_some(),
                step.break_glass.is_some(),
                step.demote.is_some(),
                step.release.is_some(),
                step.repeat.is_some(),
                step.restrict.is_some(),
                step.rollback.is_some(),
                step.pause.is_some(),
                step.resume.is_some(),
                step.go_on.is_some(),
                step.anchor.is_some(),
                step.goal.is_some(),
                step.drift.is_some(),
                step.fault.is_some(),
                step.stop.is_some(),
                step.go.is_some(),
                step.pass.is_some(),
                step.work.is_some(),
                step.expect.is_some(),
            ];
            let count = given.into_iter().filter(|given| *given).count();
            if count != 1 {
                let allowed = "exactly one of register, wait, approve, reject, break_glass, demote, release, \
                               repeat, restrict, rollback, pause, resume, continue, anchor, goal, drift, fault, \
                               stop, go, pass, work, expect";
                return problem(&at, &format!("{count} of them"), allowed);
            }
            if let Some(pass) = step.pass.filter(|pass| !(pass.for_s > 0.0 && pass.for_s <= WAIT_MAX_SECS)) {
                let allowed = "above 0 and at most 1000000 s";
                return problem(&format!("{at}.pass.for_s"), &pass.for_s.to_string(), allowed);
            }
            if let Some(work) =
                step.work.as_ref().filter(|work| !(1..=SEQUENCES_MAX).contains(&work.sequences))
            {
                let allowed = "1 to 10000";
                return problem(&format!("{at}.work.sequences"), &work.sequences.to_string(), allowed);
            }
            if let Some(wait) = &step.wait {
                let awaited = [wait.state.is_some(), wait.prompt.is_some(), wait.question.is_some()];
                let awaited = awaited.into_iter().filter(|given| *given).count();
                if awaited != 1 {
                    let found = format!("{awaited} of them");
                    let allowed = "exactly one of state, prompt and question";
                    return problem(&format!("{at}.wait"), &found, allowed);
                }
                if !(wait.timeout_s > 0.0 && wait.timeout_s <= WAIT_MAX_SECS) {
                    let allowed = "above 0 and at most 1000000 s";
                    return problem(&format!("{at}.wait.timeout_s"), &wait.timeout_s.to_string(), allowed);
                }
            }
        }
        Ok(script)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn script_with_every_kind_of_step_is_read() {
        let text = r#"
            profile = "human"
            [[step]]
            register = "manifests/candidates/grasp-improved"
            [[step]]
            register = { folder = "manifests/candidates/align-improved", as = "mara" }
            [[step]]
            wait = { prompt = "any", timeout_s = 600 }
            [[step]]
            approve = { as = "alice", reason = "read", role = "safety" }
            [[step]]
            drift = { kind = "combined", magnitude = "strong" }
            [[step]]
            fault = { kind = "telemetry-lost" }
            [[step]]
            stop = { as = "ana", reason = "a person is in the cell" }
            [[step]]
            pass = { for_s = 60 }
            [[step]]
            go = { as = "ana", reason = "the cell is empty" }
            [[step]]
            work = { sequences = 10, until = "rolled-back" }
            [[step]]
            wait = { question = "any", timeout_s = 600 }
            [[step]]
            continue = { as = "alice", reason = "the link is known" }
            [[step]]
            restrict = { as = "alice", reason = "a visitor" }
            [[step]]
            release = { as = "alice", reason = "the visitor left" }
            [[step]]
            demote = { as = "alice", reason = "too fast", profiles = ["human"] }
            [[step]]
            repeat = { as = "alice", reason = "repaired", stage = "sandbox" }
            [[step]]
            break_glass = { as = "alice", reason = "the old one drops parts" }
            [[step]]
            wait = { state = "confirmed", timeout_s = 600 }
            [[step]]
            anchor = { as = "alice", reason = "slower on purpose" }
            [[step]]
            expect = { state = "confirmed", reason = "approval-granted" }
        "#;
        assert_eq!(Script::parse("a.toml", text).unwrap().steps.len(), 20);
    }

    #[test]
    fn script_with_unknown_fields_is_refused() {
        for (text, field, value) in [
            // The parser refuses these.
            ("profile = \"sim\"\n[[step]]\nregsiter = \"x\"", "", "`regsiter`"),
            ("profile = \"sim\"\n[[step]]\nwait = { state = \"activ\", timeout_s = 1 }", "", "activ"),
            ("profile = \"sim\"\n[[step]]\nwait = { prompt = \"grasp\", timeout_s = 1 }", "", "grasp"),
            ("profile = \"sim\"\n[[step]]\nexpect = { state = \"active\", stage = \"gate\" }", "", "`gate`"),
            (
                "profile = \"sim\"\n[[step]]\nrepeat = { as = \"a\", reason = \"b\", stage = \"gate\" }",
                "",
                "gate",
            ),
            ("profile = \"moon\"\n[[step]]\nregister = \"x\"", "", "moon"),
            (
                "profile = \"sim\"\n[[step]]\nregister = \"x\"\nwait = { state = \"active\", timeout_s = 1 }",
                "step[0]",
                "2",
            ),
            (
                "profile = \"sim\"\n[[step]]\nwait = { state = \"active\", timeout_s = nan }",
                "step[0].wait.timeout_s",
                "NaN",
            ),
            ("profile = \"sim\"\n[[step]]\nwork = { sequences = 0 }", "step[0].work.sequences", "0"),
            ("profile = \"sim\"\n[[step]]\npass = { for_s = 0 }", "step[0].pass.for_s", "0"),
            ("profile = \"sim\"\nstep = []", "step", "0"),
        ] {
            match Script::parse("a.toml", text).unwrap_err() {
                TextError::Value { file, field: named, value: shown, .. } => {
                    assert_eq!((file.as_str(), named.as_str()), ("a.toml", field));
                    assert!(shown.starts_with(value), "{text}: {shown}");
                }
                TextError::Syntax { file, message, .. } => {
                    assert_eq!((file.as_str(), ""), ("a.toml", field), "{message}");
                    assert!(message.contains(value), "{text}: {message}");
                }
                error @ TextError::TooLarge { .. } => panic!("{error}"),
            }
        }
    }
}
