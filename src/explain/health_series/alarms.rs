//! Alarms over time: from each raise until the return to normal, with the persons who acted.

use std::collections::BTreeMap;

use serde::Deserialize;

use holdpoint_governance::alarms::{Alarm, AlarmState, Priority};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_protocol::health::{AlarmEpisode, AlarmStep, HealthCoverage};
use holdpoint_store::{AuditFilter, RecordViews, StoreError};

use super::clock::RecordSpan;

/// The most changes of alarms read, the newest ones.
const CHANGES_MAX: usize = 4_000;

#[derive(Deserialize)]
struct AlarmChangeBody {
    change: AlarmChangeEntry,
}

#[derive(Deserialize)]
struct AlarmChangeEntry {
    alarm: String,
    priority: Lenient<Priority>,
    state: Lenient<AlarmState>,
    /// The alarm itself; absent where the record does not repeat it.
    json: Option<String>,
}

#[derive(Deserialize)]
struct AlarmResetBody {
    alarm: String,
    by: String,
    reason: String,
}

/// The person and reason of the last reset of each alarm.
type AlarmResets = BTreeMap<String, Vec<(u64, String, String)>>;

/// Every episode of an alarm that overlaps a span, the newest first.
pub(super) fn read(
    views: &dyn RecordViews,
    span: &RecordSpan,
    coverage: &mut HealthCoverage,
) -> Result<Vec<AlarmEpisode>, StoreError> {
    let of = |kind| AuditFilter {
        from_seq: span.first,
        before_seq: Some(span.after),
        kind: Some(kind),
        limit: CHANGES_MAX,
        newest_first: true,
        ..AuditFilter::default()
    };
    let mut resets = AlarmResets::new();
    for record in views.audit(&of(RecordKind::AlarmReset))? {
        if let Ok(AlarmResetBody { alarm, by, reason }) = serde_json::from_str(&record.body) {
            resets.entry(alarm).or_default().push((record.seq, by, reason));
        }
    }
    let mut records = views.audit(&of(RecordKind::AlarmChanged))?;
    if records.len() >= CHANGES_MAX {
        let all = views.numbers_of(RecordKind::AlarmChanged, span.first, span.after)?.len();
        coverage.alarms_left_off = all.saturating_sub(records.len()) as u64;
    }
    records.reverse();
    let mut open: BTreeMap<String, (AlarmEpisode, Option<Alarm>)> = BTreeMap::new();
    let mut done = Vec::new();
    for record in &records {
        let Ok(AlarmChangeBody { change }) = serde_json::from_str::<AlarmChangeBody>(&record.body) else {
            continue;
        };
        let (Some(priority), Some(state)) = (change.priority.known(), change.state.known()) else { continue };
        let alarm = change.json.as_deref().and_then(|json| serde_json::from_str::<Alarm>(json).ok());
        let (spell, before) = open.entry(change.alarm.clone()).or_insert_with(|| {
            // An episode begins with its first raise; if that is not here, it began before.
            let first_ms = alarm.as_ref().map_or(record.at_ms, |alarm| alarm.first_ms);
            (begun(&change.alarm, record, *priority, first_ms, *state), None)
        });
        spell.changes += 1;
        spell.state = *state;
        spell.priority = spell.priority.min(*priority);
        if let Some(alarm) = &alarm {
            spell.text = Some(alarm.text.clone());
        }
        follow(spell, before.as_ref(), alarm.as_ref(), record);
        if let Some((_, by, reason)) = reset_of(&resets, &change.alarm, record.seq).filter(|_| !state.calls())
        {
            let mut reset = step(record);
            (reset.by, reset.reason) = (Some(by.clone()), Some(reason.clone()));
            spell.reset = Some(reset);
        }
        *before = alarm;
        if *state == AlarmState::Normal {
            let Some((mut spell, _)) = open.remove(&change.alarm) else { continue };
            spell.ended = Some(step(record));
            spell.over.get_or_insert_with(|| step(record));
            done.push(spell);
        }
    }
    done.extend(open.into_values().map(|(spell, _)| spell));
    done.sort_by(|one, other| other.raised.at_ms.cmp(&one.raised.at_ms).then(one.alarm.cmp(&other.alarm)));
    Ok(done)
}

fn step(record: &AuditRecord) -> AlarmStep {
    let wall_ms = (record.wall_ms > 0).then_some(record.wall_ms);
    AlarmStep { at_ms: record.at_ms, wall_ms, by: None, reason: None }
}

fn begun(
    name: &str,
    record: &AuditRecord,
    priority: Priority,
    first_ms: u64,
    state: AlarmState,
) -> AlarmEpisode {
    let mut raised = step(record);
    let began_before = first_ms < record.at_ms || state != AlarmState::Unacknowledged;
    if began_before {
        // Both clocks advanced together from then to here, unless no engine ran in between.
        let back = i64::try_from(record.at_ms.saturating_sub(first_ms)).unwrap_or(0);
        raised.wall_ms = raised.wall_ms.map(|wall_ms| wall_ms - back);
        raised.at_ms = first_ms.min(record.at_ms);
    }
    AlarmEpisode {
        alarm: name.to_owned(),
        priority,
        text: None,
        raised,
        began_before,
        acknowledged: None,
        shelved: None,
        over: None,
        reset: None,
        ended: None,
        state,
        changes: 0,
    }
}

/// The difference of a change from the one before.
fn follow(spell: &mut AlarmEpisode, before: Option<&Alarm>, now: Option<&Alarm>, record: &AuditRecord) {
    let Some(now) = now else {
        // Records of earlier builds contain only the state.
        match spell.state {
            AlarmState::Acknowledged | AlarmState::Latched => {
                spell.acknowledged.get_or_insert_with(|| step(record));
            }
            AlarmState::Shelved => spell.shelved = Some(step(record)),
            AlarmState::ReturnedUnacknowledged => spell.over = Some(step(record)),
            AlarmState::Unacknowledged | AlarmState::Normal => {}
        }
        return;
    };
    let known = before.and_then(|before| before.acknowledged_by.as_ref());
    if let Some(by) = now.acknowledged_by.as_ref().filter(|by| known != Some(*by)) {
        spell.acknowledged = Some(AlarmStep { by: Some(by.clone()), ..step(record) });
    }
    let shelved = before.and_then(|before| before.shelf.as_ref());
    if let Some(shelf) = now.shelf.as_ref().filter(|shelf| shelved != Some(*shelf)) {
        let (by, reason) = (Some(shelf.by.clone()), Some(shelf.reason.raw().to_owned()));
        spell.shelved = Some(AlarmStep { by, reason, ..step(record) });
    }
    if now.condition {
        spell.over = None;
    } else if spell.over.is_none() {
        spell.over = Some(step(record));
    }
}

/// The reset that caused a change: its record follows the change in the same transaction.
fn reset_of<'a>(resets: &'a AlarmResets, alarm: &str, seq: u64) -> Option<&'a (u64, String, String)> {
    resets.get(alarm)?.iter().find(|(at, ..)| (seq..seq.saturating_add(8)).contains(at))
}
