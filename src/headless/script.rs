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

use holdpoint_body::rehearsal::{DriftKind, LiveFault, Magnitude};
use holdpoint_governance::alarms::AlarmKind;
use holdpoint_governance::approval::Role;
use holdpoint_governance::decision::{Dimension, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::text_error::{self, TextError};
use holdpoint_governance::words::WordError;
use holdpoint_protocol::standing::{Decider, Stands};

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
    /// What it shows, for readers.
    #[serde(default)]
    pub about: String,
    pub profile: ProfileName,
    /// The run's seed; the command line's wins.
    #[serde(default)]
    pub seed: Option<u64>,
    /// What is done, in order.
    #[serde(rename = "step")]
    pub steps: Vec<Step>,
}

/// One step: exactly one of its fields.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// Submit the candidate in this folder (an embedded one, or a path from the working folder).
    pub register: Option<Registration>,
    /// Wait for a state or a prompt.
    pub wait: Option<Wait>,
    pub approve: Option<Say>,
    pub reject: Option<Say>,
    /// One person lets the last candidate in by the emergency door.
    pub break_glass: Option<Say>,
    /// Send the last candidate back to evaluation, or close profiles to it.
    pub demote: Option<Profiles>,
    /// Lift its restriction, or open profiles to it again.
    pub release: Option<Profiles>,
    /// Evaluate it again.
    pub repeat: Option<Again>,
    /// Tighten its envelope.
    pub restrict: Option<Say>,
    /// Take it off.
    pub rollback: Option<Say>,
    /// Hold it.
    pub pause: Option<Say>,
    /// Let it go on where it is held.
    pub resume: Option<Say>,
    /// Answer its monitor's question: it goes on.
    #[serde(rename = "continue")]
    pub go_on: Option<Say>,
    /// What the live world's agent works towards from its next sequence on.
    pub goal: Option<String>,
    /// Let a drift set in.
    pub drift: Option<DriftStep>,
    /// Break something in the live world.
    pub fault: Option<FaultStep>,
    /// Stop the cell.
    pub stop: Option<Say>,
    /// Let the stopped cell work again.
    pub go: Option<Say>,
    /// Let time pass.
    pub pass: Option<Pass>,
    /// Let the live cell work so many sequences, whether or not anything is evaluated.
    pub work: Option<LiveWork>,
    /// Check what has come of it.
    pub expect: Option<Expect>,
}

/// A candidate that is submitted: its folder alone, or with the person on whose behalf.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum Registration {
    /// Its requester is the script, which approves nothing.
    Folder(String),
    /// Its requester is a person, who cannot approve it.
    By(RegistrationBy),
}

/// A candidate that is submitted on a person's behalf.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegistrationBy {
    /// Its folder, as in the plain form.
    pub folder: String,
    /// Who asks for it.
    #[serde(rename = "as")]
    pub who: String,
}

impl Registration {
    /// The candidate's folder.
    #[must_use]
    pub fn folder(&self) -> &str {
        match self {
            Self::Folder(folder) => folder,
            Self::By(by) => &by.folder,
        }
    }

    /// Who asks for it; absent where the step names nobody.
    #[must_use]
    pub fn who(&self) -> Option<&str> {
        match self {
            Self::Folder(_) => None,
            Self::By(by) => Some(&by.who),
        }
    }
}

/// What is waited for.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wait {
    /// Until it stands there.
    #[serde(default)]
    pub state: Option<Stands>,
    /// Until such a prompt is open.
    #[serde(default)]
    pub prompt: Option<AwaitedPrompt>,
    /// Until a monitor asks about such a version.
    #[serde(default)]
    pub question: Option<AwaitedPrompt>,
    /// Longest wait, virtual s.
    pub timeout_s: f64,
}

/// A decision on what waits.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Say {
    #[serde(rename = "as")]
    pub who: String,
    pub reason: String,
    /// The role in which the person is enrolled, if the store does not know them; a step that names another than engineer counts.
    #[serde(default = "engineer")]
    pub role: Role,
}

const fn engineer() -> Role {
    Role::Engineer
}

/// Sequences that the live cell works.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveWork {
    pub sequences: u32,
    /// An alarm of this kind that has to be raised meanwhile; the step ends with it.
    #[serde(default)]
    pub until: Option<AlarmKind>,
}

/// Time that passes, whatever comes of it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pass {
    /// Virtual s.
    pub for_s: f64,
}

/// What somebody says about a version, and the profiles it is about.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profiles {
    #[serde(rename = "as")]
    pub who: String,
    pub reason: String,
    /// Empty: about the version as a whole.
    #[serde(default)]
    pub profiles: Vec<ProfileName>,
}

/// A stage that somebody wants repeated.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Again {
    #[serde(rename = "as")]
    pub who: String,
    pub reason: String,
    /// Sandbox or shadow.
    pub stage: Stage,
}

/// A drift of the live world.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriftStep {
    pub kind: DriftKind,
    pub magnitude: Magnitude,
}

/// A fault of the live world, which stays.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultStep {
    pub kind: LiveFault,
}

/// What must have come of the last candidate.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    pub state: Stands,
    /// A reason code that must be among those given for it.
    #[serde(default)]
    pub reason: Option<ReasonCode>,
    #[serde(default)]
    pub stage: Option<Decider>,
    /// The dimension of the reason.
    #[serde(default)]
    pub dimension: Option<Dimension>,
}

/// The prompt that is waited for: `any`, or one for a version.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub enum AwaitedPrompt {
    Any,
    For(CapabilityId),
}

impl AwaitedPrompt {
    /// Whether a prompt about `version` is meant.
    #[must_use]
    pub fn is_about(&self, version: &CapabilityId) -> bool {
        match self {
            Self::Any => true,
            Self::For(awaited) => awaited == version,
        }
    }
}

impl TryFrom<String> for AwaitedPrompt {
    type Error = WordError;
    fn try_from(text: String) -> Result<Self, WordError> {
        if text == "any" {
            return Ok(Self::Any);
        }
        let wrong =
            |_| WordError::new("prompt to wait for", &text, ["any", "<family>@<version>"].into_iter());
        text.parse().map(Self::For).map_err(wrong)
    }
}

impl Script {
    /// Parses a scenario; `file` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`] with file and line: a key that is not known, a step with none or several of its
    /// fields, a time that is no number.
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
                               repeat, restrict, rollback, pause, resume, continue, goal, drift, fault, stop, go, \
                               pass, work, expect";
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
    fn reads_every_kind_of_step() {
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
            stop = { as = "ana", reason = "somebody is in the cell" }
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
            repeat = { as = "alice", reason = "mended", stage = "sandbox" }
            [[step]]
            break_glass = { as = "alice", reason = "the old one drops parts" }
            [[step]]
            wait = { state = "confirmed", timeout_s = 600 }
            [[step]]
            expect = { state = "confirmed", reason = "approval-granted" }
        "#;
        assert_eq!(Script::parse("a.toml", text).unwrap().steps.len(), 19);
    }

    #[test]
    fn refuses_what_it_does_not_know() {
        for (text, names) in [
            ("profile = \"sim\"\n[[step]]\nregsiter = \"x\"", "regsiter"),
            (
                "profile = \"sim\"\n[[step]]\nregister = \"x\"\nwait = { state = \"active\", timeout_s = 1 }",
                "exactly one",
            ),
            ("profile = \"sim\"\n[[step]]\nwait = { state = \"activ\", timeout_s = 1 }", "activ"),
            (
                "profile = \"sim\"\n[[step]]\nwait = { prompt = \"grasp\", timeout_s = 1 }",
                "any, <family>@<version>",
            ),
            (
                "profile = \"sim\"\n[[step]]\nexpect = { state = \"active\", stage = \"gate\" }",
                "`validation`, `sandbox`, `shadow`, `activation`, `monitor`",
            ),
            ("profile = \"sim\"\n[[step]]\nwait = { state = \"active\", timeout_s = nan }", "timeout_s"),
            ("profile = \"sim\"\n[[step]]\nwork = { sequences = 0 }", "sequences"),
            ("profile = \"sim\"\n[[step]]\npass = { for_s = 0 }", "for_s"),
            (
                "profile = \"sim\"\n[[step]]\nrepeat = { as = \"a\", reason = \"b\", stage = \"gate\" }",
                "sandbox",
            ),
            ("profile = \"moon\"\n[[step]]\nregister = \"x\"", "moon"),
            ("profile = \"sim\"\nstep = []", "0 steps"),
        ] {
            let error = Script::parse("a.toml", text).unwrap_err().to_string();
            assert!(error.contains("a.toml") && error.contains(names), "{error}");
        }
    }
}
