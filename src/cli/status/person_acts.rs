//! What people did to the cell as a whole and why, in `holdpoint status`: its goal, its last start, and the last note.
//!
//! Reads the newest record of each kind. What people did to a version is a part of its status.

use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::Views;
use holdpoint_store::{AuditFilter, StoreError};
use holdpoint_text::Untrusted;
use holdpoint_wording::program::status::{CellAct, cell_act};
use holdpoint_wording::record_time;
use serde::{Deserialize, Serialize};

/// One act of a person.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct PersonActRow {
    /// The kind of its record.
    pub(super) kind: RecordKind,
    pub(super) by: Untrusted,
    /// The goal, if it set one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) goal: Option<Untrusted>,
    /// The reason, or the text of a note.
    pub(super) reason: Untrusted,
    /// The number of its record.
    pub(super) record: u64,
    pub(super) at_ms: u64,
    /// Absent in scripts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) wall: Option<WallTime>,
}

/// The body of such a record.
#[derive(Deserialize)]
struct SignedActRow {
    by: String,
    #[serde(default)]
    goal: Option<String>,
    #[serde(default, alias = "text")]
    reason: String,
}

/// The acts on record; the last start only while the cell runs.
pub(super) fn person_acts(views: &Views, is_stopped: bool) -> Result<Vec<PersonActRow>, StoreError> {
    let mut acts = Vec::new();
    for kind in [RecordKind::GoalSet, RecordKind::CellReleased, RecordKind::ShiftNote] {
        if is_stopped && kind == RecordKind::CellReleased {
            continue;
        }
        let Some(record) = views.audit(&AuditFilter::newest(kind))?.pop() else { continue };
        let Ok(SignedActRow { by, goal, reason }) = serde_json::from_str(&record.body) else { continue };
        acts.push(PersonActRow {
            kind,
            by: by.into(),
            goal: goal.map(Untrusted::from),
            reason: reason.into(),
            record: record.seq,
            at_ms: record.at_ms,
            wall: record.wall(),
        });
    }
    Ok(acts)
}

impl PersonActRow {
    pub(super) fn line(&self) -> String {
        let when = record_time(self.at_ms, self.wall);
        let (by, reason) = (self.by.line(), self.reason.line());
        match (self.kind, &self.goal) {
            (RecordKind::GoalSet, Some(goal)) => {
                cell_act(CellAct::Goal(&goal.line().into_string()), by, &when, reason)
            }
            (RecordKind::CellReleased, _) => cell_act(CellAct::Start, by, &when, reason),
            _ => cell_act(CellAct::Note, by, &when, reason),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_act_names_person_time_and_reason() {
        let row = |kind, goal: Option<&str>| PersonActRow {
            kind,
            by: "mia".into(),
            goal: goal.map(Untrusted::from),
            reason: "the tray is\u{1b}[2J new".into(),
            record: 7,
            at_ms: 3_723_000,
            wall: None,
        };
        let reason = Untrusted::from("the tray is\u{1b}[2J new");
        for (kind, goal, act) in [
            (RecordKind::GoalSet, Some("grasp"), CellAct::Goal("grasp")),
            (RecordKind::CellReleased, None, CellAct::Start),
            (RecordKind::ShiftNote, None, CellAct::Note),
        ] {
            let line = row(kind, goal).line();
            assert_eq!(line, cell_act(act, "mia", "01:02:03", reason.line()));
            assert!(!line.contains('\u{1b}'), "{line:?}");
        }
    }

    #[test]
    fn goals_notes_and_starts_have_one_form() {
        for body in [
            r#"{"goal":"grasp","by":"mia","reason":"a new tray"}"#,
            r#"{"by":"mia","text":"a new tray"}"#,
            r#"{"by":"mia","caller":{"kind":"script"},"reason":"a new tray"}"#,
        ] {
            let SignedActRow { by, reason, .. } = serde_json::from_str(body).unwrap();
            assert_eq!((by.as_str(), reason.as_str()), ("mia", "a new tray"), "{body}");
        }
    }
}
