//! What the reducer wants done. It does none of it itself; the run loop does, and answers with a message.
//!
//! Nothing dangerous can be made here: [`Effect::Decide`] takes a [`PromptAnswer`] and [`Effect::Operate`] a
//! [`Confirmed`], which only an open prompt and a filled form can make.

use super::audit::AuditGroup;
use super::form::Confirmed;
use super::model::{AskedFor, View};
use super::prompt::PromptAnswer;
use holdpoint_approvals::Passphrase;
use holdpoint_body::rehearsal::Drift;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::film::FilmAsked;
use holdpoint_protocol::health::HealthAsked;
use holdpoint_protocol::snapshot::Purpose;

#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Ask the engine something that decides nothing.
    Ask {
        id: String,
        question: Question,
    },
    /// Have the engine do what a person confirmed.
    Operate {
        id: String,
        confirmed: Box<Confirmed>,
        /// Opens the key of who confirmed it, if it is signed and the key is under one; wiped after the signature.
        passphrase: Option<Passphrase>,
    },
    /// Sign a decision and hand it to the engine.
    Decide {
        id: String,
        decision: Box<PromptAnswer>,
        /// Opens the key of who decides, if it is under one; wiped after the signature.
        passphrase: Option<Passphrase>,
    },
    /// Read a candidate's folder, or an embedded one, and submit it.
    Register {
        id: String,
        /// The folder; absent for the next demonstration candidate.
        folder: Option<String>,
        /// As for an operation.
        passphrase: Option<Passphrase>,
    },
    /// Read who could sit here.
    ReadIdentities,
    /// Somebody else sits down; the name is checked against the identities.
    UseIdentity(String),
    /// Read what a folder holds that a typed path could become.
    ReadFolder {
        /// The whole line, which the answer names.
        typed: String,
        /// The path as far as it is typed.
        path: String,
    },
    /// Make an identity without a passphrase, and sit down as it.
    MakeIdentity(String),
    /// Put text on the clipboard (OSC 52).
    Copy(String),
    /// Write a view as text and JSON.
    Export(View),
    /// Show the recording of an upgrade.
    OpenRecording(CapabilityId),
    /// Show the live scene.
    OpenLive,
    UseTheme(String),
    /// Look whether the operator's own files, keys and themes, changed.
    LookAtOwnFiles,
    /// Take the mouse, or give it back.
    TakeMouse(bool),
    /// Call for attention once.
    Bell,
    /// End the engine in an orderly way, then the program.
    End,
    /// End the program alone: the engine works on.
    Leave,
    /// As that, and tell the engine to go on with nobody.
    Detach,
}

/// What can be asked without a confirmation: it reads, or is undone as easily.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    /// Everything about a version.
    Detail(CapabilityId),
    Registry {
        group: VersionGroup,
        /// Whose name contains this.
        text: String,
    },
    /// A question to people, as one of them gets it.
    Asked {
        version: CapabilityId,
        purpose: Purpose,
        who: String,
    },
    /// A piece of a version's evaluation, worked again.
    Film {
        version: CapabilityId,
        asked: FilmAsked,
    },
    /// What a pane of the log shows, the newest first.
    Audit(AuditGroup),
    /// What live tasks came to over time.
    Health(HealthAsked),
    /// The course of alarms.
    AlarmHistory(HealthAsked),
    Verify,
    /// Note that an alarm was seen. Resumes nothing.
    Acknowledge {
        alarm: String,
        by: String,
    },
    /// End the shelving of an alarm.
    Unshelve {
        alarm: String,
        by: String,
    },
    /// Stop the arm; needs no confirmation, because it is always safe to.
    Stop {
        by: String,
    },
    /// How fast the simulated cell works.
    Pace(Option<f64>),
    /// Start a drift of the simulated cell, or end it.
    Drift(Option<Drift>),
}

/// Rows asked for at once.
const PAGE_ROWS: u64 = 10_000;

/// Records of the log asked for at once.
const AUDIT_ROWS: u64 = 1_000;

impl Question {
    /// What kind of answer it awaits.
    #[must_use]
    pub const fn about(&self) -> AskedFor {
        match self {
            Self::Detail(_) => AskedFor::Detail,
            Self::Registry { .. } => AskedFor::Registry,
            Self::Asked { .. } => AskedFor::Question,
            Self::Film { .. } => AskedFor::Film,
            Self::Audit(_) => AskedFor::Audit,
            Self::Health(_) => AskedFor::Health,
            Self::AlarmHistory(_) => AskedFor::AlarmHistory,
            Self::Verify => AskedFor::Verification,
            Self::Acknowledge { .. } | Self::Unshelve { .. } => AskedFor::Alarm,
            Self::Stop { .. } => AskedFor::Operation,
            Self::Pace(_) => AskedFor::Pace,
            Self::Drift(_) => AskedFor::Drift,
        }
    }

    /// The engine's command for it.
    #[must_use]
    pub fn into_command(self) -> Command {
        match self {
            Self::Detail(version) => Command::Detail { version },
            Self::Registry { group, text } => Command::Registry { group, text, offset: 0, limit: PAGE_ROWS },
            Self::Asked { version, purpose, who } => Command::Question { version, purpose, who },
            Self::Film { version, asked } => Command::Film { version, asked },
            Self::Audit(group) => Command::Audit {
                before: None,
                subject: String::new(),
                without: group.leaves_out(),
                limit: AUDIT_ROWS,
            },
            Self::Health(asked) | Self::AlarmHistory(asked) => Command::Health { asked },
            Self::Verify => Command::VerifyAudit,
            Self::Acknowledge { alarm, by } => Command::AcknowledgeAlarm { alarm, by },
            Self::Unshelve { alarm, by } => Command::UnshelveAlarm { alarm, by },
            Self::Stop { by } => Command::Stop { by, reason: String::new() },
            Self::Pace(times) => Command::Pace { times },
            Self::Drift(drift) => Command::Drift {
                kind: drift.map(|drift| drift.kind),
                magnitude: drift.map(|drift| drift.magnitude),
            },
        }
    }
}
