//! The audit log for operators: the records of a pane, telemetry runs as one row, and the raw form of a record.

use std::collections::BTreeSet;

use serde_json::Value;

use super::formatters::record_moment;
use holdpoint_governance::record::{AuditRecord, RecordGroup, RecordKind};
use holdpoint_wording::console::audit as wording;

/// Which records a pane shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AuditGroup {
    /// Those of [`RecordGroup::Events`], and so on.
    Events,
    People,
    Alarms,
    Store,
    /// Every record; runs of seals are one row.
    All,
}

impl AuditGroup {
    /// In the order of the view's panes.
    pub const ALL: [Self; 5] = [Self::Events, Self::People, Self::Alarms, Self::Store, Self::All];

    /// Of a pane of the view.
    #[must_use]
    pub fn of_pane(pane: usize) -> Self {
        Self::ALL.get(pane).copied().unwrap_or(Self::All)
    }

    /// The kinds that it does not show. They are excluded while reading, because the newest records of an old store
    /// are only telemetry digests.
    #[must_use]
    pub fn leaves_out(self) -> BTreeSet<RecordKind> {
        RecordKind::ALL.into_iter().filter(|kind| !self.shows(Some(kind))).collect()
    }

    /// Whether it shows a kind; an unknown kind appears everywhere but among people and alarms.
    #[must_use]
    pub fn shows(self, kind: Option<&RecordKind>) -> bool {
        let Some(kind) = kind else { return matches!(self, Self::Events | Self::All) };
        let group = match self {
            Self::All => return true,
            Self::Events => RecordGroup::Events,
            Self::People => RecordGroup::People,
            Self::Alarms => RecordGroup::Alarms,
            Self::Store => RecordGroup::Store,
        };
        kind.groups().contains(&group)
    }
}

/// A row of the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AuditItem<'a> {
    /// The record, the newest of a run.
    pub record: &'a AuditRecord,
    /// How many records of telemetry in a run it represents; 1 for any other.
    pub count: usize,
}

/// The records as rows: each run of sealed telemetry is one row.
#[must_use]
pub fn rows<'a>(records: impl Iterator<Item = &'a AuditRecord>) -> Vec<AuditItem<'a>> {
    let mut rows: Vec<AuditItem<'a>> = Vec::new();
    let folds =
        |record: &AuditRecord| record.kind.known().is_some_and(|kind| RecordKind::SEALS.contains(kind));
    for record in records {
        match rows.last_mut() {
            Some(last) if folds(last.record) && folds(record) => last.count += 1,
            _ => rows.push(AuditItem { record, count: 1 }),
        }
    }
    rows
}

/// The raw record, line by line: the hashed content as stored, and the same formatted for reading.
#[must_use]
pub fn raw(record: &AuditRecord) -> Vec<String> {
    let mut lines = vec![
        format!("record   {}", record.seq),
        format!("time     {} ({} ms)", record_moment(record), record.at_ms),
        format!("kind     {}", record.kind),
        format!("subject  {}", if record.subject.is_empty() { "-" } else { &record.subject }),
        format!("hash     {}", record.hash),
        format!("before   {}", record.prev),
        String::new(),
    ];
    let pretty = serde_json::from_str::<Value>(&record.body).ok();
    let pretty = pretty.and_then(|value| serde_json::to_string_pretty(&value).ok());
    let body = pretty.unwrap_or_else(|| record.body.clone());
    lines.extend(body.lines().take(RAW_LINES_MAX).map(ToOwned::to_owned));
    if body.lines().nth(RAW_LINES_MAX).is_some() {
        lines.push(wording::raw_cut(RAW_LINES_MAX));
    }
    lines
}

/// Lines of a record's content that are shown.
const RAW_LINES_MAX: usize = 5_000;

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::closed_set::Lenient;
    use holdpoint_governance::ids::Digest;
    use serde_json::json;

    fn record(kind: Lenient<RecordKind>, body: &Value) -> AuditRecord {
        let digest = Digest::of_parts("t", &[]);
        let (subject, body) = ("grasp@1.2.0".to_owned(), body.to_string());
        AuditRecord { seq: 7, prev: digest, hash: digest, at_ms: 1_500, kind, subject, body, wall_ms: 0 }
    }

    #[test]
    fn panes_show_kinds_and_telemetry_is_folded() {
        let of = |kind: RecordKind| record(kind.into(), &json!({}));
        let kinds = [
            RecordKind::TelemetryBlockSealed,
            RecordKind::TelemetryBlockSealed,
            RecordKind::StateSet,
            RecordKind::FlagsSet,
            RecordKind::TelemetrySealed,
            RecordKind::ApprovalPut,
            RecordKind::AlarmChanged,
        ];
        let records: Vec<AuditRecord> = kinds.into_iter().map(of).collect();
        let shown = |group: AuditGroup| {
            let fits = records.iter().filter(move |record| group.shows(record.kind.known()));
            rows(fits).iter().map(|row| (row.record.kind.to_string(), row.count)).collect::<Vec<_>>()
        };
        let one = |kind: RecordKind| (kind.name().to_owned(), 1);
        assert_eq!(
            shown(AuditGroup::Events),
            [one(RecordKind::StateSet), one(RecordKind::ApprovalPut), one(RecordKind::AlarmChanged)]
        );
        assert_eq!(shown(AuditGroup::People), [one(RecordKind::ApprovalPut)]);
        assert_eq!(shown(AuditGroup::Alarms), [one(RecordKind::AlarmChanged)]);
        assert_eq!(shown(AuditGroup::Store), []);
        assert_eq!(shown(AuditGroup::All)[0], ("telemetry-block-sealed".to_owned(), 2));
        assert_eq!(shown(AuditGroup::All).len(), 6);
        for kind in RecordKind::ALL {
            assert!(AuditGroup::All.shows(Some(&kind)), "{kind}");
        }
    }
}
