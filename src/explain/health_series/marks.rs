//! The marks of a series: version changes, alarms, drifts, stops, and times without a running engine.

use serde::Deserialize;
use serde_json::Value;

use holdpoint_governance::alarms::{AlarmKey, AlarmKind};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::MonitorAction;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::record::{ActivationCause, AuditRecord, RecordKind, UpgradeEnd};
use holdpoint_protocol::health::{
    AlarmEpisode, AlarmStep, HealthCoverage, HealthMark, MarkContent, MarkKind, MarkedAct,
};
use holdpoint_store::{AuditFilter, RecordViews, StoreError};
use holdpoint_wording::health::mark;

use super::clock::{RecordSpan, gaps, on_clock};
use crate::store_metrics::record_bodies::{ActiveSet, change};
use holdpoint_record::shift_note::ShiftNoteRecord;

/// The most marks of one answer.
const MARKS_MAX: usize = 400;

/// The most records of one kind read for them, the newest ones.
const RECORDS_MAX: usize = 2_000;

/// Kinds of records that may be a mark.
const KINDS: [RecordKind; 13] = [
    RecordKind::ActiveSet,
    RecordKind::StateSet,
    RecordKind::AuditClosed,
    RecordKind::Monitor,
    RecordKind::BreakGlass,
    RecordKind::Drift,
    RecordKind::LiveFault,
    RecordKind::CellStopped,
    RecordKind::CellReleased,
    RecordKind::GoalSet,
    RecordKind::ShiftNote,
    RecordKind::ContextSet,
    RecordKind::Commissioned,
];

#[derive(Deserialize)]
struct StateSetMark {
    to: State,
    #[serde(default)]
    reason: NoticeOrText,
}

#[derive(Deserialize)]
struct UpgradeEndMark {
    outcome: Lenient<UpgradeEnd>,
}

#[derive(Deserialize)]
struct MonitorActionMark {
    action: Lenient<MonitorAction>,
    #[serde(default)]
    reasons: Vec<Value>,
}

#[derive(Deserialize)]
struct DriftMark {
    kind: Option<String>,
    #[serde(default)]
    magnitude: String,
}

/// The person of a record, if it names one.
#[derive(Default, Deserialize)]
#[serde(default)]
struct PersonActBody {
    by: String,
    reason: String,
    goal: String,
    fault: Value,
}

impl PersonActBody {
    fn of(self, act: MarkedAct) -> MarkContent {
        MarkContent::Acted { by: self.by, act, reason: self.reason }
    }
}

/// Every mark from records, except alarms; unsorted.
pub(super) fn read(
    views: &dyn RecordViews,
    span: &RecordSpan,
    coverage: &mut HealthCoverage,
) -> Result<Vec<HealthMark>, StoreError> {
    let mut marks = Vec::new();
    for kind in KINDS {
        let filter = AuditFilter {
            from_seq: span.first,
            before_seq: Some(span.after),
            kind: Some(kind),
            limit: RECORDS_MAX,
            newest_first: true,
            ..AuditFilter::default()
        };
        let records = views.audit(&filter)?;
        if records.len() >= RECORDS_MAX {
            let all = views.numbers_of(kind, span.first, span.after)?.len();
            coverage.marks_left_off += all.saturating_sub(records.len()) as u64;
        }
        marks.extend(records.iter().filter_map(|record| {
            let wall_ms = (record.wall_ms > 0).then_some(record.wall_ms);
            let on_clock_ms = on_clock(span.clock, record.at_ms, wall_ms)?;
            let (kind, family, content) = mark_of_record(kind, record)?;
            Some(HealthMark {
                kind,
                on_clock_ms,
                at_ms: record.at_ms,
                wall_ms,
                family,
                text: mark(&content),
                record: record.seq,
            })
        }));
    }
    for (stamp, alone_ms) in gaps(views, span)? {
        let Some(on_clock_ms) = on_clock(span.clock, stamp.at_ms, stamp.wall_ms) else { continue };
        let content = MarkContent::NoEngine { ms: u64::try_from(alone_ms).unwrap_or(0) };
        marks.push(HealthMark {
            kind: MarkKind::EngineOff,
            on_clock_ms,
            at_ms: stamp.at_ms,
            wall_ms: stamp.wall_ms,
            family: None,
            text: mark(&content),
            record: stamp.seq,
        });
    }
    Ok(marks)
}

/// Marks of alarms: those raised in the span, and those closed by a person. Alarms with another mark are omitted.
pub(super) fn of_alarms(span: &RecordSpan, alarms: &[AlarmEpisode]) -> Vec<HealthMark> {
    let mut marks = Vec::new();
    for spell in alarms {
        let Ok(key) = spell.alarm.parse::<AlarmKey>() else { continue };
        let kind = match key.kind() {
            AlarmKind::Degraded | AlarmKind::Shifted | AlarmKind::OutsideDomain | AlarmKind::CellDegraded => {
                MarkKind::DriftAlarm
            }
            AlarmKind::RolledBack
            | AlarmKind::Restricted
            | AlarmKind::Rejected
            | AlarmKind::Approval
            | AlarmKind::Unreviewed => continue,
            AlarmKind::Escalated
            | AlarmKind::Violation
            | AlarmKind::SharedEvent
            | AlarmKind::Harm
            | AlarmKind::WeakRecovery
            | AlarmKind::SafeStopped
            | AlarmKind::NotRecovered
            | AlarmKind::KeptFalse
            | AlarmKind::TelemetryMissed
            | AlarmKind::CheckpointFailed
            | AlarmKind::NameTaken
            | AlarmKind::CameUpStopped
            | AlarmKind::CellLost
            | AlarmKind::ProfileUnauthorized
            | AlarmKind::ClockDoubted
            | AlarmKind::EngineFault => MarkKind::AlarmRaised,
        };
        let family = family_of(&key);
        let alarm = || spell.alarm.clone();
        let mut push = |kind, step: &AlarmStep, content: &MarkContent| {
            if let Some(on_clock_ms) = on_clock(span.clock, step.at_ms, step.wall_ms) {
                let (family, text) = (family.clone(), mark(content));
                let (at_ms, wall_ms) = (step.at_ms, step.wall_ms);
                marks.push(HealthMark { kind, on_clock_ms, at_ms, wall_ms, family, text, record: 0 });
            }
        };
        push(kind, &spell.raised, &MarkContent::AlarmRaised { alarm: alarm(), text: spell.text.clone() });
        if let Some(reset) = &spell.reset {
            let (by, reason) = (reset.by.clone(), reset.reason.clone().unwrap_or_default());
            push(MarkKind::AlarmReset, reset, &MarkContent::AlarmClosed { alarm: alarm(), by, reason });
        }
    }
    marks
}

/// Marks within the span, sorted. Beyond the limit the least important ones are dropped, the oldest first.
pub(super) fn bounded(
    mut marks: Vec<HealthMark>,
    span: &RecordSpan,
    coverage: &mut HealthCoverage,
) -> Vec<HealthMark> {
    marks.retain(|mark| span.contains(mark.on_clock_ms));
    if marks.len() > MARKS_MAX {
        coverage.marks_left_off += (marks.len() - MARKS_MAX) as u64;
        marks.sort_by_key(|mark| (mark.kind.weight(), std::cmp::Reverse(mark.on_clock_ms)));
        marks.truncate(MARKS_MAX);
    }
    marks.sort_by_key(|mark| (mark.on_clock_ms, mark.record, mark.kind.weight()));
    marks
}

fn family_of(key: &AlarmKey) -> Option<Family> {
    match key {
        AlarmKey::SafeStopped(family) | AlarmKey::NotRecovered(family) => Some(family.clone()),
        _ => key.version().map(|version| version.family.clone()),
    }
}

/// The mark of a record; `None` if it has none, or cannot be read.
fn mark_of_record(kind: RecordKind, record: &AuditRecord) -> Option<(MarkKind, Option<Family>, MarkContent)> {
    let version = record.subject.parse::<CapabilityId>().ok();
    let family = version.as_ref().map(|version| version.family.clone());
    let subject = || record.subject.clone();
    let person = || serde_json::from_str::<PersonActBody>(&record.body).unwrap_or_default();
    Some(match kind {
        RecordKind::ActiveSet => {
            let ActiveSet { family, active, cause } = change(record)?;
            let (kind, content) = match (cause.cause.known()?, active) {
                (ActivationCause::Gate, Some(version)) => {
                    (MarkKind::Promotion, MarkContent::TookOver { version })
                }
                (ActivationCause::Bootstrap, Some(version)) => {
                    (MarkKind::FirstVersion, MarkContent::FirstOfFamily { version })
                }
                (ActivationCause::Restore, Some(version)) => {
                    (MarkKind::Restored, MarkContent::TookOverAgain { version })
                }
                (ActivationCause::Rearm, Some(version)) => {
                    (MarkKind::Restored, MarkContent::Reactivated { version })
                }
                (_, None) | (ActivationCause::Vacate, _) => {
                    (MarkKind::Vacated, MarkContent::NoActiveVersion { family: family.clone() })
                }
            };
            (kind, Some(family), content)
        }
        RecordKind::StateSet => {
            let StateSetMark { to, reason } = change(record)?;
            let kind = match to {
                State::RolledBack => MarkKind::Rollback,
                State::Demoted => MarkKind::Demotion,
                State::Registered
                | State::Validated
                | State::Sandboxed
                | State::Shadowed
                | State::Active
                | State::Superseded
                | State::Rejected => return None,
            };
            (kind, family, MarkContent::StateChanged { subject: subject(), reason })
        }
        RecordKind::AuditClosed => {
            let UpgradeEndMark { outcome } = serde_json::from_str(&record.body).ok()?;
            if outcome != UpgradeEnd::Confirmed {
                return None;
            }
            (MarkKind::Confirmed, family, MarkContent::Confirmed { subject: subject() })
        }
        RecordKind::Monitor => {
            let MonitorActionMark { action, reasons } = serde_json::from_str(&record.body).ok()?;
            if action != MonitorAction::Restrict {
                return None;
            }
            let first = reasons.into_iter().next();
            let reason = first.and_then(|reason| serde_json::from_value::<Box<Reason>>(reason).ok());
            (MarkKind::Restriction, family, MarkContent::Restricted { subject: subject(), reason })
        }
        RecordKind::BreakGlass => {
            (MarkKind::BreakGlass, family, person().of(MarkedAct::BreakGlass { subject: subject() }))
        }
        RecordKind::Drift => {
            let DriftMark { kind, magnitude } = serde_json::from_str(&record.body).ok()?;
            let content =
                kind.map_or(MarkContent::DriftEnded, |drift| MarkContent::DriftBegan { drift, magnitude });
            (MarkKind::Drift, None, content)
        }
        RecordKind::LiveFault => {
            let content = match person().fault {
                Value::String(fault) => MarkContent::FaultBegan { fault },
                Value::Null => MarkContent::FaultRepaired,
                other => MarkContent::FaultBegan { fault: other.to_string() },
            };
            (MarkKind::LiveFault, None, content)
        }
        RecordKind::CellStopped => (MarkKind::Stopped, None, person().of(MarkedAct::StoppedCell)),
        RecordKind::CellReleased => (MarkKind::Released, None, person().of(MarkedAct::StartedCell)),
        RecordKind::ShiftNote => {
            let ShiftNoteRecord { by, text } = serde_json::from_str(&record.body).ok()?;
            (MarkKind::Note, None, MarkContent::Note { by, text })
        }
        RecordKind::GoalSet => {
            let body = person();
            let goal = body.goal.clone();
            (MarkKind::Goal, None, body.of(MarkedAct::SetGoal { goal }))
        }
        RecordKind::ContextSet => {
            let change: Value = change(record)?;
            let profile = change.get("profile").and_then(Value::as_str).map(str::to_owned);
            (MarkKind::Context, None, MarkContent::ProfileInForce { profile })
        }
        RecordKind::Commissioned => {
            let body: Value = serde_json::from_str(&record.body).ok()?;
            let number = |name: &str| body.get("normal")?.get(name)?.as_f64();
            let (tasks, failures) = (number("tasks")?, number("failures")?);
            let force_n = number("peak_force_n")?;
            let subject = body.get("version").and_then(Value::as_str).map_or_else(subject, str::to_owned);
            let content = MarkContent::NormalCounted { subject, tasks, failures, force_n };
            (MarkKind::Commissioned, Family::new(record.subject.as_str()).ok(), content)
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::ids::Digest;

    fn mark_of(kind: RecordKind, subject: &str, body: &str) -> Option<(MarkKind, MarkContent)> {
        let digest = Digest::of_parts("test", &[]);
        let record = AuditRecord {
            seq: 1,
            prev: digest,
            hash: digest,
            at_ms: 0,
            kind: Lenient::Known(kind),
            subject: subject.to_owned(),
            body: body.to_owned(),
            wall_ms: 0,
        };
        mark_of_record(kind, &record).map(|(kind, _, content)| (kind, content))
    }

    #[test]
    fn records_become_marks_with_their_values() {
        use MarkContent as M;
        let acted =
            |by: &str, act, reason: &str| M::Acted { by: by.to_owned(), act, reason: reason.to_owned() };
        for (kind, body, mark) in [
            (
                RecordKind::CellStopped,
                r#"{"by":"ana","reason":"a leak"}"#,
                (MarkKind::Stopped, acted("ana", MarkedAct::StoppedCell, "a leak")),
            ),
            (RecordKind::CellReleased, "{}", (MarkKind::Released, acted("", MarkedAct::StartedCell, ""))),
            (
                RecordKind::GoalSet,
                r#"{"by":"ana","goal":"sort","reason":"late"}"#,
                (MarkKind::Goal, acted("ana", MarkedAct::SetGoal { goal: "sort".to_owned() }, "late")),
            ),
            (RecordKind::Drift, r#"{"kind":null,"magnitude":""}"#, (MarkKind::Drift, M::DriftEnded)),
            (
                RecordKind::Drift,
                r#"{"kind":"noise","magnitude":"severe"}"#,
                (
                    MarkKind::Drift,
                    M::DriftBegan { drift: "noise".to_owned(), magnitude: "severe".to_owned() },
                ),
            ),
            (RecordKind::LiveFault, r#"{"fault":null}"#, (MarkKind::LiveFault, M::FaultRepaired)),
            (
                RecordKind::LiveFault,
                r#"{"fault":{"joint":3}}"#,
                (MarkKind::LiveFault, M::FaultBegan { fault: r#"{"joint":3}"#.to_owned() }),
            ),
            (
                RecordKind::ContextSet,
                r#"{"change":{"profile":"real"}}"#,
                (MarkKind::Context, M::ProfileInForce { profile: Some("real".to_owned()) }),
            ),
            (
                RecordKind::Commissioned,
                r#"{"normal":{"tasks":120,"failures":3,"peak_force_n":21.0},"version":"grasp@1.0.0"}"#,
                (
                    MarkKind::Commissioned,
                    M::NormalCounted {
                        subject: "grasp@1.0.0".to_owned(),
                        tasks: 120.0,
                        failures: 3.0,
                        force_n: 21.0,
                    },
                ),
            ),
        ] {
            assert_eq!(mark_of(kind, "", body), Some(mark), "{kind}: {body}");
        }
        assert_eq!(mark_of(RecordKind::ShiftNote, "", "{}"), None, "a record that cannot be read is no mark");
    }
}
