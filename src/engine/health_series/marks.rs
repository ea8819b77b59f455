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
    AlarmEpisode, AlarmStep, HealthCoverage, HealthMark, MarkKind, duration_label,
};
use holdpoint_registry::{AuditFilter, StoreError, Views};

use super::clock::{RecordSpan, gaps, on_clock};
use crate::shift_note::ShiftNoteRecord;
use crate::store_metrics::record_bodies::{ActiveSet, change};

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

/// Every mark from records, except alarms; unsorted.
pub(super) fn read(
    views: &Views,
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
            let (kind, family, text) = mark_of_record(kind, record)?;
            Some(HealthMark {
                kind,
                on_clock_ms,
                at_ms: record.at_ms,
                wall_ms,
                family,
                text,
                record: record.seq,
            })
        }));
    }
    for (stamp, alone_ms) in gaps(views, span)? {
        let Some(on_clock_ms) = on_clock(span.clock, stamp.at_ms, stamp.wall_ms) else { continue };
        let text = format!(
            "no engine ran for {} before this, or the machine slept",
            duration_label(u64::try_from(alone_ms).unwrap_or(0))
        );
        marks.push(HealthMark {
            kind: MarkKind::EngineOff,
            on_clock_ms,
            at_ms: stamp.at_ms,
            wall_ms: stamp.wall_ms,
            family: None,
            text,
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
            AlarmKind::Degraded | AlarmKind::Shifted | AlarmKind::CellDegraded => MarkKind::DriftAlarm,
            AlarmKind::RolledBack
            | AlarmKind::Restricted
            | AlarmKind::Rejected
            | AlarmKind::Approval
            | AlarmKind::Unreviewed => continue,
            AlarmKind::Escalated
            | AlarmKind::Violation
            | AlarmKind::WeakRecovery
            | AlarmKind::SafeStopped
            | AlarmKind::NotRecovered
            | AlarmKind::KeptFalse
            | AlarmKind::TelemetryMissed
            | AlarmKind::CheckpointFailed
            | AlarmKind::NameTaken
            | AlarmKind::CameUpStopped
            | AlarmKind::ProfileUnauthorized
            | AlarmKind::ClockDoubted
            | AlarmKind::EngineFault => MarkKind::AlarmRaised,
        };
        let family = family_of(&key);
        let text = spell.text.as_ref().map_or_else(|| spell.alarm.clone(), holdpoint_wording::notice);
        let mut push = |kind, step: &AlarmStep, text: String| {
            if let Some(on_clock_ms) = on_clock(span.clock, step.at_ms, step.wall_ms) {
                let family = family.clone();
                let (at_ms, wall_ms) = (step.at_ms, step.wall_ms);
                marks.push(HealthMark { kind, on_clock_ms, at_ms, wall_ms, family, text, record: 0 });
            }
        };
        push(kind, &spell.raised, text);
        if let Some(reset) = &spell.reset {
            let by = reset.by.as_deref().unwrap_or("somebody");
            let why = reset.reason.as_deref().unwrap_or("");
            push(MarkKind::AlarmReset, reset, format!("{} closed by {by}: {why}", spell.alarm));
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
        AlarmKey::RolledBack(version)
        | AlarmKey::Escalated(version)
        | AlarmKey::Restricted(version)
        | AlarmKey::Violation(version)
        | AlarmKey::Degraded(version)
        | AlarmKey::WeakRecovery(version)
        | AlarmKey::Shifted(version)
        | AlarmKey::Rejected(version)
        | AlarmKey::Approval(version)
        | AlarmKey::Unreviewed(version) => Some(version.family.clone()),
        AlarmKey::SafeStopped(family) | AlarmKey::NotRecovered(family) => Some(family.clone()),
        AlarmKey::CellDegraded
        | AlarmKey::KeptFalse
        | AlarmKey::TelemetryMissed
        | AlarmKey::CheckpointFailed
        | AlarmKey::NameTaken
        | AlarmKey::CameUpStopped
        | AlarmKey::ProfileUnauthorized
        | AlarmKey::ClockDoubted
        | AlarmKey::EngineFault => None,
    }
}

/// The mark of a record; `None` if it has none, or cannot be read.
fn mark_of_record(kind: RecordKind, record: &AuditRecord) -> Option<(MarkKind, Option<Family>, String)> {
    let version = record.subject.parse::<CapabilityId>().ok();
    let family = version.as_ref().map(|version| version.family.clone());
    let person = || serde_json::from_str::<PersonActBody>(&record.body).unwrap_or_default();
    Some(match kind {
        RecordKind::ActiveSet => {
            let ActiveSet { family, active, cause } = change(record)?;
            let (kind, text) = match (cause.cause.known()?, active) {
                (ActivationCause::Gate, Some(version)) => {
                    (MarkKind::Promotion, format!("{version} took over"))
                }
                (ActivationCause::Bootstrap, Some(version)) => {
                    (MarkKind::FirstVersion, format!("{version} is the first of its family"))
                }
                (ActivationCause::Restore, Some(version)) => {
                    (MarkKind::Restored, format!("{version} took over again"))
                }
                (ActivationCause::Rearm, Some(version)) => {
                    (MarkKind::Restored, format!("{version} was made active again by a person"))
                }
                (_, None) | (ActivationCause::Vacate, _) => {
                    (MarkKind::Vacated, format!("{family} has no active version"))
                }
            };
            (kind, Some(family), text)
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
            (kind, family, format!("{}: {}", record.subject, holdpoint_wording::notice(&reason)))
        }
        RecordKind::AuditClosed => {
            let UpgradeEndMark { outcome } = serde_json::from_str(&record.body).ok()?;
            if outcome != UpgradeEnd::Confirmed {
                return None;
            }
            (MarkKind::Confirmed, family, format!("{} was confirmed", record.subject))
        }
        RecordKind::Monitor => {
            let MonitorActionMark { action, reasons } = serde_json::from_str(&record.body).ok()?;
            if action != MonitorAction::Restrict {
                return None;
            }
            let reason =
                reasons.into_iter().next().and_then(|reason| serde_json::from_value::<Reason>(reason).ok());
            let why = reason.as_ref().map_or_else(String::new, holdpoint_wording::reason);
            (MarkKind::Restriction, family, format!("{}: {why}", record.subject))
        }
        RecordKind::BreakGlass => (
            MarkKind::BreakGlass,
            family,
            act_sentence(&format!("let {} in alone", record.subject), &person()),
        ),
        RecordKind::Drift => {
            let DriftMark { kind, magnitude } = serde_json::from_str(&record.body).ok()?;
            let text = kind.map_or_else(
                || "the drift of the cell ended".to_owned(),
                |kind| format!("{kind} {magnitude} began in the simulated cell"),
            );
            (MarkKind::Drift, None, text)
        }
        RecordKind::LiveFault => {
            let text = match person().fault {
                Value::String(fault) => format!("{fault} in the simulated cell"),
                Value::Null => "the fault of the simulated cell was repaired".to_owned(),
                other => format!("{other} in the simulated cell"),
            };
            (MarkKind::LiveFault, None, text)
        }
        RecordKind::CellStopped => (MarkKind::Stopped, None, act_sentence("stopped the cell", &person())),
        RecordKind::CellReleased => (MarkKind::Released, None, act_sentence("started the cell", &person())),
        RecordKind::ShiftNote => {
            let ShiftNoteRecord { by, text } = serde_json::from_str(&record.body).ok()?;
            (MarkKind::Note, None, format!("{by}: {text}"))
        }
        RecordKind::GoalSet => {
            let act = person();
            (MarkKind::Goal, None, act_sentence(&format!("set the goal {}", act.goal), &act))
        }
        RecordKind::ContextSet => {
            let change: Value = change(record)?;
            let profile = change.get("profile").and_then(Value::as_str).unwrap_or("unknown").to_owned();
            (MarkKind::Context, None, format!("judged under the profile {profile} from here on"))
        }
        RecordKind::Commissioned => {
            let body: Value = serde_json::from_str(&record.body).ok()?;
            let number = |name: &str| body.get("normal")?.get(name)?.as_f64();
            let (tasks, failures) = (number("tasks")?, number("failures")?);
            let force_n = number("peak_force_n")?;
            let who = body.get("version").and_then(Value::as_str).unwrap_or(&record.subject).to_owned();
            let text = format!(
                "normal for {who}: {:.0} of {tasks:.0} tasks done, at most {force_n:.1} N",
                tasks - failures
            );
            (MarkKind::Commissioned, Family::new(record.subject.as_str()).ok(), text)
        }
        _ => return None,
    })
}

fn act_sentence(what: &str, act: &PersonActBody) -> String {
    let who = if act.by.is_empty() { "somebody" } else { &act.by };
    if act.reason.is_empty() { format!("{who} {what}") } else { format!("{who} {what}: {}", act.reason) }
}
