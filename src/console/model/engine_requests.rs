//! The console's requests to the engine, and the queries that are due.

use std::collections::BTreeMap;

use super::undo::UndoChange;

/// The subject of a request of this console.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum RequestSubject {
    /// A page of the registry.
    Registry,
    /// Everything about one version.
    Detail,
    /// The re-run of a part of an evaluation.
    Film,
    /// A page of the audit log.
    Audit,
    /// Health over time.
    Health,
    /// The course of alarms.
    AlarmHistory,
    /// A check of the whole audit chain.
    Verification,
    /// A submission of a candidate.
    Registration,
    /// A confirmed operation.
    Operation,
    /// An approval request as the operator at this console gets it.
    Question,
    /// A signed decision.
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
    /// The expected kind of answer.
    pub about: RequestSubject,
    /// The operation as a refusal repeats it; empty for the console's own queries.
    pub what: String,
    /// What it does to the actions that can be undone, once it is accepted.
    pub undo: Option<UndoChange>,
    /// Whether it went to the engine after it was signed; until then it can be taken back.
    pub is_sent: bool,
}

/// See the module's head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EngineRequests {
    /// Requests without an answer yet, by id.
    pub pending: BTreeMap<String, PendingRequest>,
    /// Number of the next request.
    pub next_request: u64,
    /// Counts changes that answers of the engine may depend on.
    pub changes: u64,
    /// Console time of the last check of the operator's own files, ms.
    pub own_files_ms: u64,
    /// The count at the last query of each kind.
    pub changes_at_query: BTreeMap<RequestSubject, u64>,
    /// Alarms that were changed while changes of others still wait for an answer.
    pub alarms_changed: usize,
}

impl Default for EngineRequests {
    fn default() -> Self {
        Self {
            pending: BTreeMap::new(),
            next_request: 1,
            changes: 0,
            own_files_ms: 0,
            changes_at_query: BTreeMap::new(),
            alarms_changed: 0,
        }
    }
}

impl EngineRequests {
    /// Notes that a signed request goes to the engine; false if it was taken back, and must not.
    #[must_use]
    pub fn hand_over(&mut self, id: &str) -> bool {
        self.pending.get_mut(id).is_some_and(|pending| {
            pending.is_sent = true;
            true
        })
    }
}
