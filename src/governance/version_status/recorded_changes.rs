//! What the record of a version says of its present state: when it changed, and by whom or by which rule.
//!
//! A fold over the records of one version, in their order. Reads no store, and chooses no change:
//! [`VersionStatus`](super::VersionStatus) does.

use serde::Deserialize;

use crate::decision::Reason;
use crate::explanation::RecordMoment;
use crate::monitor::{MonitorAction, MonitorAnswer};
use crate::notice::{Notice, NoticeOrText, OperatorAct};
use crate::record::{AuditRecord, RecordKind, UpgradeEnd};

/// One change on record.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedChange {
    /// Its record.
    pub since: RecordMoment,
    /// The person and the reason, or the rule; absent where the record names none.
    pub cause: Option<NoticeOrText>,
}

/// The newest changes of a version, each of its kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedChanges {
    /// Its state changed, or it was registered.
    pub state: Option<RecordedChange>,
    /// Its flags changed.
    pub flags: Option<RecordedChange>,
    /// A person paused it.
    pub paused: Option<RecordedChange>,
    /// A person resumed it.
    pub resumed: Option<RecordedChange>,
    /// Approvers were asked.
    pub asked: Option<RecordedChange>,
    /// Too few approvers answered.
    pub lapsed: Option<RecordedChange>,
    /// Its envelope was tightened.
    pub restricted: Option<RecordedChange>,
    /// A person lifted that.
    pub released: Option<RecordedChange>,
    /// It was confirmed.
    pub confirmed: Option<RecordedChange>,
}

/// The body of a `state-set` record.
#[derive(Deserialize)]
struct StateSetBody {
    change: StateSetChange,
}

#[derive(Deserialize)]
struct StateSetChange {
    #[serde(default)]
    reason: NoticeOrText,
}

/// The body of an `approval-requested` record.
#[derive(Deserialize)]
struct RequestBody {
    change: RequestStateChange,
}

#[derive(Deserialize)]
struct RequestStateChange {
    state: String,
}

/// The body of a record of a person's act.
#[derive(Deserialize)]
struct ActBody {
    by: String,
    #[serde(default)]
    reason: String,
}

/// The body of a `monitor` record.
#[derive(Deserialize)]
struct MonitorBody {
    action: String,
    #[serde(default)]
    reasons: Vec<Reason>,
}

/// The body of a `monitor-answer` record.
#[derive(Deserialize)]
struct AnswerBody {
    answer: String,
    #[serde(flatten)]
    act: ActBody,
}

/// The body of an `audit-closed` record.
#[derive(Deserialize)]
struct ClosedBody {
    outcome: String,
}

impl RecordedChanges {
    /// The kinds of records that [`RecordedChanges::note`] reads, and how many of the newest ones it needs: a monitor and the
    /// people it asks have other actions, too.
    pub const READ: [(RecordKind, usize); 9] = [
        (RecordKind::VersionRegistered, 1),
        (RecordKind::StateSet, 1),
        (RecordKind::FlagsSet, 1),
        (RecordKind::PauseSet, 1),
        (RecordKind::Resumed, 1),
        (RecordKind::ApprovalRequested, 1),
        (RecordKind::Monitor, 16),
        (RecordKind::MonitorAnswer, 16),
        (RecordKind::AuditClosed, 1),
    ];

    /// Whether it reads records of this kind.
    #[must_use]
    pub fn reads(kind: RecordKind) -> bool {
        Self::READ.iter().any(|(read, _)| *read == kind)
    }

    /// Takes in the next record of the version. What cannot be read explains nothing.
    pub fn note(&mut self, record: &AuditRecord) {
        let Some(kind) = record.kind.known() else { return };
        let since = RecordMoment { record: record.seq, at_ms: record.at_ms, wall: record.wall() };
        let change = |cause: Option<NoticeOrText>| Some(RecordedChange { since, cause });
        let body = record.body.as_str();
        match kind {
            RecordKind::VersionRegistered => self.state = change(None),
            RecordKind::StateSet => {
                let read = serde_json::from_str::<StateSetBody>(body).ok();
                let cause = read.map(|read| read.change.reason);
                self.state = change(cause.filter(|cause| *cause != NoticeOrText::default()));
            }
            RecordKind::FlagsSet => self.flags = change(None),
            RecordKind::PauseSet => {
                let Ok(act) = serde_json::from_str::<NoticeOrText>(body) else { return };
                let paused = OperatorAct::Paused;
                let is_pause =
                    matches!(act.notice(), Some(Notice::OperatorDid { act, .. }) if *act == paused);
                let place = if is_pause { &mut self.paused } else { &mut self.resumed };
                *place = change(Some(act));
            }
            RecordKind::Resumed => {
                let Ok(ActBody { by, reason }) = serde_json::from_str(body) else { return };
                let act = Notice::OperatorDid { act: OperatorAct::Resumed, by, reason };
                self.resumed = change(Some(act.into()));
            }
            RecordKind::ApprovalRequested => {
                let Ok(RequestBody { change: RequestStateChange { state } }) = serde_json::from_str(body)
                else {
                    return;
                };
                match state.as_str() {
                    "open" => self.asked = change(Some(Notice::ApproversAsked.into())),
                    "expired" => self.lapsed = change(Some(Notice::ApprovalLapsed.into())),
                    _ => {}
                }
            }
            RecordKind::Monitor => {
                let Ok(MonitorBody { action, reasons }) = serde_json::from_str(body) else { return };
                if action == MonitorAction::Restrict.name() {
                    self.restricted = change(Some(Notice::decided(reasons.first()).into()));
                }
            }
            RecordKind::MonitorAnswer => {
                let Ok(AnswerBody { answer, act }) = serde_json::from_str(body) else { return };
                if answer == MonitorAnswer::Release.name() {
                    let ActBody { by, reason } = act;
                    self.released = change(Some(Notice::RestrictionLifted { by, reason }.into()));
                }
            }
            RecordKind::AuditClosed => {
                let Ok(ClosedBody { outcome }) = serde_json::from_str(body) else { return };
                if outcome == UpgradeEnd::Confirmed.name() {
                    self.confirmed = change(Some(Notice::WindowPassed.into()));
                }
            }
            // They change nothing that a status states.
            _ => {}
        }
    }

    /// Whether the newest request lapsed, and no person has resumed the version since.
    #[must_use]
    pub fn has_lapsed(&self) -> bool {
        let Some(lapsed) = &self.lapsed else { return false };
        let mut others = [&self.state, &self.asked, &self.resumed].into_iter().flatten();
        others.all(|change| change.since.record < lapsed.since.record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ids::Digest;

    fn record(seq: u64, kind: RecordKind, body: &serde_json::Value) -> AuditRecord {
        let digest = Digest::of_parts("test", &[]);
        AuditRecord {
            seq,
            prev: digest,
            hash: digest,
            at_ms: 1_000 * seq,
            kind: kind.into(),
            subject: "grasp@1.1.0".to_owned(),
            body: body.to_string(),
            wall_ms: 0,
        }
    }

    #[test]
    fn each_change_keeps_its_newest_record_with_person_and_reason() {
        let paused = |by: &str| {
            let (by, reason) = (by.to_owned(), "noise".to_owned());
            Notice::OperatorDid { act: OperatorAct::Paused, by, reason }
        };
        let mut changes = RecordedChanges::default();
        for (seq, kind, body) in [
            (1, RecordKind::VersionRegistered, serde_json::json!({})),
            (2, RecordKind::StateSet, serde_json::json!({ "change": { "reason": Notice::StageBegins } })),
            (3, RecordKind::PauseSet, serde_json::json!(paused("mia"))),
            (4, RecordKind::PauseSet, serde_json::json!(paused("ana"))),
            (5, RecordKind::Resumed, serde_json::json!({ "by": "bo", "reason": "quiet" })),
            (6, RecordKind::ApprovalRequested, serde_json::json!({ "change": { "state": "open" } })),
            (7, RecordKind::ApprovalRequested, serde_json::json!({ "change": { "state": "expired" } })),
            (8, RecordKind::Monitor, serde_json::json!({ "action": "escalate", "reasons": [] })),
            (
                9,
                RecordKind::MonitorAnswer,
                serde_json::json!({ "answer": "go-on", "by": "cy", "reason": "fine" }),
            ),
            (
                10,
                RecordKind::MonitorAnswer,
                serde_json::json!({ "answer": "release", "by": "cy", "reason": "well" }),
            ),
            (11, RecordKind::AuditClosed, serde_json::json!({ "outcome": "confirmed", "records": 3 })),
        ] {
            assert!(RecordedChanges::reads(kind), "{kind}");
            changes.note(&record(seq, kind, &body));
            assert_eq!(changes.has_lapsed(), seq >= 7, "record {seq}");
        }
        let at = |change: &Option<RecordedChange>| change.as_ref().map(|change| change.since.record);
        assert_eq!(at(&changes.state), Some(2));
        assert_eq!(at(&changes.paused), Some(4));
        assert_eq!(changes.paused.as_ref().unwrap().cause, Some(paused("ana").into()));
        let resumed = Notice::OperatorDid {
            act: OperatorAct::Resumed,
            by: "bo".to_owned(),
            reason: "quiet".to_owned(),
        };
        assert_eq!(changes.resumed.as_ref().unwrap().cause, Some(resumed.into()));
        assert_eq!((at(&changes.asked), at(&changes.lapsed)), (Some(6), Some(7)));
        assert_eq!((at(&changes.restricted), at(&changes.released)), (None, Some(10)));
        assert_eq!(at(&changes.confirmed), Some(11));
        // A later request, or a later act of a person, ends the hold.
        changes.note(&record(12, RecordKind::Resumed, &serde_json::json!({ "by": "bo", "reason": "again" })));
        assert!(!changes.has_lapsed());
    }
}
