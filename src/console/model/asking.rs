//! What this console asked the engine, and what it still has to ask.

use std::collections::BTreeMap;

/// What a request of this console is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AskedFor {
    /// A page of the registry.
    Registry,
    /// Everything about one version.
    Detail,
    /// A piece of an evaluation, worked again.
    Film,
    /// A page of the audit log.
    Audit,
    /// Health over time.
    Health,
    /// The course of alarms.
    AlarmHistory,
    /// A check of the whole audit chain.
    Verification,
    /// A candidate that is submitted.
    Registration,
    /// An operation that a person confirmed.
    Operation,
    /// A question to people, as who sits here gets it.
    Question,
    /// A decision that a person signed.
    Decision,
    /// A change of one alarm that needs no reason.
    Alarm,
    /// The pace of the simulated cell.
    Pace,
    /// A drift of the simulated cell.
    Drift,
}

/// A request that the engine has not answered yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PendingRequest {
    /// What kind of answer is awaited.
    pub about: AskedFor,
    /// What a person asked for, as a refusal repeats it; empty for what the console asks by itself.
    pub what: String,
}

/// See the module's head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asking {
    /// Requests without an answer yet, by id.
    pub pending: BTreeMap<String, PendingRequest>,
    /// Number of the next request.
    pub next_request: u64,
    /// Counts what happened that answers of the engine may depend on.
    pub changes: u64,
    /// Console time at which the operator's own files were looked at last, ms.
    pub own_files_ms: u64,
    /// The count at which each kind of answer was last asked for.
    pub asked: BTreeMap<AskedFor, u64>,
}

impl Default for Asking {
    fn default() -> Self {
        Self {
            pending: BTreeMap::new(),
            next_request: 1,
            changes: 0,
            own_files_ms: 0,
            asked: BTreeMap::new(),
        }
    }
}
