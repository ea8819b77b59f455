//! The effects that the reducer requests. The run loop carries them out and answers with a message.
//!
//! Nothing dangerous can be made here: [`Effect::Decide`] takes an [`ApprovalAnswer`] and [`Effect::Operate`] a
//! [`ConfirmedOperation`], which only an open prompt and a filled form can make.

use super::approval_screen::ApprovalAnswer;
use super::audit::AuditGroup;
use super::form::ConfirmedOperation;
use super::model::{RequestSubject, View};
use holdpoint_approvals::Passphrase;
use holdpoint_body::disturbance::Drift;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::VersionGroup;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::film::FilmRequest;
use holdpoint_protocol::health::HealthQuery;
use holdpoint_protocol::snapshot::RequestKind;

#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// Send the engine a query that decides nothing.
    Ask {
        id: String,
        question: EngineQuery,
    },
    /// Have the engine carry out a confirmed operation.
    Operate {
        id: String,
        confirmed: Box<ConfirmedOperation>,
        /// Opens the person's key, if it is signed and the key has a passphrase; wiped after the signature.
        passphrase: Option<Passphrase>,
    },
    /// Sign a decision and hand it to the engine.
    Decide {
        id: String,
        decision: Box<ApprovalAnswer>,
        /// Opens the person's key, if it has a passphrase; wiped after the signature.
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
    /// Read the identities that this console could use.
    ReadIdentities,
    /// Change the operator; the name is checked against the identities.
    UseIdentity(String),
    /// Read a folder for completions of a typed path.
    ReadFolder {
        /// The whole line, which the answer names.
        typed: String,
        /// The path as far as it is typed.
        path: String,
    },
    /// Make an identity without a passphrase, and use it.
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
    /// Check whether the operator's own files, keys and themes, changed.
    CheckOperatorFiles,
    /// Take the mouse, or give it back.
    TakeMouse(bool),
    /// Call for attention once.
    Bell,
    /// Shut the engine down, then end the program.
    End,
    /// End only the program: the engine keeps running.
    Leave,
    /// End the console and tell the engine to keep running without one.
    Detach,
}

/// Queries without a confirmation: each reads, or is easily undone.
#[derive(Clone, Debug, PartialEq)]
pub enum EngineQuery {
    /// Everything about a version.
    Detail(CapabilityId),
    Registry {
        group: VersionGroup,
        /// Whose name contains this.
        text: String,
    },
    /// An approval request, as one person gets it.
    ApprovalRequest {
        version: CapabilityId,
        purpose: RequestKind,
        who: String,
    },
    /// Re-run a part of a version's evaluation with video.
    Film {
        version: CapabilityId,
        request: FilmRequest,
    },
    /// The records of a pane of the log, the newest first.
    Audit(AuditGroup),
    /// The results of live tasks over time.
    Health(HealthQuery),
    /// The course of alarms.
    AlarmHistory(HealthQuery),
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
    /// Stop the arm; needs no confirmation, because it is always safe.
    Stop {
        by: String,
    },
    /// The speed of the simulated cell.
    Pace(Option<f64>),
    /// Start a drift of the simulated cell, or end it.
    Drift(Option<Drift>),
}

/// Rows asked for at once.
const PAGE_ROWS: u64 = 10_000;

/// Records of the log asked for at once.
const AUDIT_ROWS: u64 = 1_000;

impl EngineQuery {
    /// What kind of answer it awaits.
    #[must_use]
    pub const fn about(&self) -> RequestSubject {
        match self {
            Self::Detail(_) => RequestSubject::Detail,
            Self::Registry { .. } => RequestSubject::Registry,
            Self::ApprovalRequest { .. } => RequestSubject::Question,
            Self::Film { .. } => RequestSubject::Film,
            Self::Audit(_) => RequestSubject::Audit,
            Self::Health(_) => RequestSubject::Health,
            Self::AlarmHistory(_) => RequestSubject::AlarmHistory,
            Self::Verify => RequestSubject::Verification,
            Self::Acknowledge { .. } | Self::Unshelve { .. } => RequestSubject::Alarm,
            Self::Stop { .. } => RequestSubject::Operation,
            Self::Pace(_) => RequestSubject::Pace,
            Self::Drift(_) => RequestSubject::Drift,
        }
    }

    /// The engine's command for it.
    #[must_use]
    pub fn into_command(self) -> Command {
        match self {
            Self::Detail(version) => Command::Detail { version },
            Self::Registry { group, text } => Command::Registry { group, text, offset: 0, limit: PAGE_ROWS },
            Self::ApprovalRequest { version, purpose, who } => Command::Question { version, purpose, who },
            Self::Film { version, request } => Command::Film { version, asked: request },
            Self::Audit(group) => Command::Audit {
                before: None,
                subject: String::new(),
                without: group.leaves_out(),
                limit: AUDIT_ROWS,
            },
            Self::Health(query) | Self::AlarmHistory(query) => Command::Health { asked: query },
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
