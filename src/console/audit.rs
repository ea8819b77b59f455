//! The audit log for operators: the records of a pane, telemetry runs as one row, and a sentence for each record.
//!
//! Reads a record's content as plain JSON and describes the fields that this build knows. Only the record itself
//! counts; the sentence helps to find it.

use std::collections::BTreeSet;

use serde::Deserialize;
use serde_json::Value;

use super::formatters::{record_moment, seconds};
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::{AuditRecord, RecordGroup, RecordKind};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_wording::console::audit as wording;
use holdpoint_wording::console::shared;
use holdpoint_wording::notice_sentence;

/// The largest content that gets a sentence, bytes; a larger one is named by its kind.
const BODY_BYTES_MAX: usize = 64 * 1024;

/// The most values of a record that are searched.
const LOOKED_AT_MAX: usize = 400;

/// Characters of one quoted value.
const VALUE_CHARS: usize = 160;

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

/// A record as a sentence, without a period.
#[must_use]
pub fn sentence(record: &AuditRecord) -> String {
    let value = (record.body.len() <= BODY_BYTES_MAX).then(|| serde_json::from_str::<Value>(&record.body));
    let Some(Ok(value)) = value else {
        return wording::bytes_of_content(&record.kind.to_string(), record.body.len());
    };
    let specific =
        record.kind.known().and_then(|kind| sentence_of_kind(*kind, &RecordFields { root: &value }));
    specific.unwrap_or_else(|| generic(&value))
}

/// A record's content, looked up by name at any depth, the shallowest first.
struct RecordFields<'a> {
    root: &'a Value,
}

impl RecordFields<'_> {
    fn find(&self, name: &str) -> Option<&Value> {
        self.find_that(name, |value| !value.is_null())
    }

    fn find_that(&self, name: &str, fits: impl Fn(&Value) -> bool) -> Option<&Value> {
        let mut open = std::collections::VecDeque::from([self.root]);
        // Stored content is small; a hostile nesting ends here.
        for _ in 0..LOOKED_AT_MAX {
            match open.pop_front()? {
                Value::Object(fields) => {
                    if let Some(found) = fields.get(name).filter(|value| fits(value)) {
                        return Some(found);
                    }
                    open.extend(fields.values());
                }
                Value::Array(items) => open.extend(items.iter().take(20)),
                _ => {}
            }
        }
        None
    }

    /// A value as text; absent if it is neither a plain value nor a notice.
    fn text(&self, name: &str) -> Option<String> {
        let plain = |value: &Value| {
            value.is_string() || value.is_number() || value.is_boolean() || noticed(value).is_some()
        };
        match self.find_that(name, plain)? {
            Value::String(text) => Some(text.chars().take(VALUE_CHARS).collect()),
            notice @ Value::Object(_) => Some(noticed(notice)?.chars().take(VALUE_CHARS).collect()),
            other => Some(other.to_string()),
        }
    }

    /// As [`Self::text`]; absent if it is empty.
    fn value(&self, name: &str) -> Option<String> {
        self.text(name).filter(|text| !text.trim().is_empty())
    }

    /// The text of the reason with the finding.
    fn why(&self) -> Option<String> {
        let reasons = self.find("reasons").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let tells = |reason: &&Value| {
            let code = reason.get("code").and_then(|code| code.as_str()?.parse::<ReasonCode>().ok());
            code.is_none_or(ReasonCode::is_finding)
        };
        let first = reasons.iter().find(tells).or_else(|| reasons.first());
        let text = first.and_then(|reason| reason.get("text").unwrap_or(reason).as_str());
        text.map(|text| text.chars().take(VALUE_CHARS).collect())
    }

    fn digest(&self, name: &str) -> String {
        self.text(name).map_or_else(String::new, |text| text.chars().take(8).collect())
    }
}

/// The sentence of a notice; absent for another value.
fn noticed(value: &Value) -> Option<String> {
    value.get("notice")?;
    Notice::deserialize(value).ok().map(|notice| notice_sentence(&notice))
}

/// The sentence of a known kind; absent if a field is missing.
fn sentence_of_kind(kind: RecordKind, fields: &RecordFields<'_>) -> Option<String> {
    let by = || fields.text("by").or_else(|| fields.text("who")).filter(|by| !by.is_empty());
    let actor = || by().unwrap_or_else(|| "somebody".to_owned());
    let value = |name: &str| fields.value(name);
    let reason = value("reason");
    let reason = reason.as_deref();
    Some(match kind {
        RecordKind::VersionRegistered => wording::submitted(
            &fields.text("author")?,
            value("provenance").as_deref(),
            value("risk").as_deref(),
            value("parent").as_deref(),
        ),
        RecordKind::StateSet => wording::state_set(&fields.text("from")?, &fields.text("to")?, reason),
        RecordKind::FlagsSet => flags(fields.find("flags")?),
        RecordKind::ScoresSet => {
            let kappas = fields.find("kappas")?.as_array()?;
            let values =
                kappas.iter().map(|kappa| kappa.as_f64().map_or("?".to_owned(), |k| format!("{k:.3}")));
            wording::scores(&values.collect::<Vec<_>>().join(", "))
        }
        RecordKind::ActiveSet => match fields.text("active") {
            Some(active) => {
                wording::has_the_arm(&active, value("cause").as_deref(), value("pinned").as_deref())
            }
            None => wording::no_version_has_the_arm(value("cause").as_deref()),
        },
        RecordKind::FamilySet => wording::family_set(fields.find("safe_stopped")?.as_bool()?, reason),
        RecordKind::FamilyVoided => wording::passes_are_void(reason),
        RecordKind::StandingSet => wording::STANDING_SET.to_owned(),
        RecordKind::EvidencePut => wording::evidence_of(&fields.text("kind")?, &fields.digest("digest")),
        RecordKind::ApprovalRequested => {
            let until = fields.find("deadline_ms").and_then(Value::as_u64).map(|ms| {
                let until = WallTime::from_ms(i64::try_from(ms).unwrap_or(i64::MAX));
                // Earlier versions used virtual time.
                if until < WallTime::SCRIPT_EPOCH { seconds(ms) } else { until.label() }
            });
            wording::to_decide(&fields.text("needed")?, until.as_deref(), value("state").as_deref())
        }
        RecordKind::ApprovalPut => {
            let decision = fields.text("decision").or_else(|| fields.text("answer"))?;
            let who = by().or_else(|| fields.text("identity")).or_else(|| fields.text("name"))?;
            wording::says(&who, &decision, reason)
        }
        RecordKind::ApprovalConsumed => wording::APPROVAL_USED.to_owned(),
        RecordKind::PersonEnrolled => person_sentence("enrolled", fields)?,
        RecordKind::PersonConfirmed => person_sentence("confirmed", fields)?,
        RecordKind::PersonRevoked => person_sentence("revoked", fields)?,
        RecordKind::ContextSet => wording::context(&fields.text("profile")?, &fields.digest("policy_digest")),
        RecordKind::ProfileLoaded => wording::own_profile(value("name").as_deref()),
        RecordKind::TelemetrySealed | RecordKind::TelemetryBlockSealed => telemetry(fields)?,
        RecordKind::TelemetryPruned => wording::telemetry_pruned(&fields.text("through")?),
        RecordKind::TelemetryMissed => wording::TELEMETRY_MISSED.to_owned(),
        RecordKind::AlarmChanged => {
            let whole = fields.text("json").is_some().then(|| fields.find("json")).flatten();
            let inner =
                whole.and_then(Value::as_str).and_then(|text| serde_json::from_str::<Value>(text).ok());
            let text = inner
                .as_ref()
                .and_then(|inner| RecordFields { root: inner }.text("text"))
                .unwrap_or_default();
            let gap = if text.is_empty() { "" } else { ": " };
            format!("{}, {}{gap}{text}", fields.text("state")?, fields.text("priority")?)
        }
        RecordKind::Decision => {
            let (stage, outcome) = (fields.text("stage"), fields.text("outcome"));
            wording::decided(stage.as_deref(), outcome.as_deref(), fields.why().as_deref())
        }
        RecordKind::Monitor => {
            let found = fields.text("decision").or_else(|| fields.text("outcome"))?;
            wording::monitor_found(&found, fields.why().as_deref())
        }
        RecordKind::MonitorAnswer => wording::monitor_answered(&actor(), reason),
        RecordKind::PauseSet => wording::pause_set(&actor(), &fields.text("act")?, reason),
        RecordKind::Resumed => wording::resumed(&actor(), reason),
        RecordKind::KeyCommitted => wording::key_committed(value("use").as_deref()),
        RecordKind::KeyRevealed => wording::KEY_REVEALED.to_owned(),
        RecordKind::AnchorSet => wording::anchor_set(&actor(), reason),
        RecordKind::TryCounted => wording::try_counted(&fields.text("by_author")?),
        RecordKind::TriesReviewed => wording::tries_reviewed(&actor(), reason),
        RecordKind::BreakGlass => wording::break_glass(&actor(), reason),
        RecordKind::CellStopped => wording::cell_stopped(&actor(), reason),
        RecordKind::CellReleased => wording::cell_started(&actor(), reason),
        RecordKind::EngineBegan => wording::engine_began(value("profile").as_deref()),
        RecordKind::EngineEnded => match fields.find_that("orderly", |_| true)?.as_bool() {
            Some(true) => shared::ENGINE_SHUT_DOWN_CLEANLY.to_owned(),
            Some(false) | None => wording::ENGINE_ENDED_SUDDENLY.to_owned(),
        },
        RecordKind::GoalSet => wording::goal_set(&actor(), &fields.text("goal")?, reason),
        RecordKind::PaceSet => shared::live_pace(fields.find_that("times", |_| true)?.as_f64()),
        RecordKind::ShiftNote => wording::notes(&actor(), value("text").as_deref()),
        RecordKind::ClockDoubted => wording::CLOCK_NOT_TRUSTED.to_owned(),
        RecordKind::ClockConfirmed => wording::clock_confirmed(&actor(), &fields.text("time")?, reason),
        RecordKind::AlarmReset => wording::alarm_reset(&actor(), reason),
        RecordKind::Asked => {
            let user =
                fields.text("user").or_else(|| fields.text("uid")).unwrap_or_else(|| "somebody".to_owned());
            wording::asked_for(&user, &fields.text("asked")?, value("process").as_deref())
        }
        RecordKind::Drift => match fields.text("kind") {
            Some(kind) => wording::drift_sets_in(&kind, value("magnitude").as_deref()),
            None => wording::DRIFT_ENDS.to_owned(),
        },
        RecordKind::AuditClosed => wording::closed(value("end").as_deref()),
        RecordKind::LiveHarm => {
            let count = |name: &str| fields.find("lived")?.get(name)?.as_u64();
            wording::tasks_past_a_limit(count("any")?, count("tasks")?)
        }
        RecordKind::Commissioned | RecordKind::SensesCommissioned => {
            let tasks = fields.text("tasks").or_else(|| fields.text("episodes"));
            wording::normal_measured(kind == RecordKind::SensesCommissioned, tasks.as_deref())
        }
        // The names and values of its fields say enough.
        _ => return None,
    })
}

fn person_sentence(what: &str, fields: &RecordFields<'_>) -> Option<String> {
    let [role, by, reason] = ["role", "by", "reason"].map(|name| fields.value(name));
    Some(wording::person(&fields.text("name")?, what, [role.as_deref(), by.as_deref(), reason.as_deref()]))
}

fn telemetry(fields: &RecordFields<'_>) -> Option<String> {
    let Some(batches) = fields.find("batches").and_then(Value::as_array) else {
        return Some(wording::batch_sealed(&fields.text("rows")?));
    };
    let rows: u64 = batches.iter().filter_map(|batch| batch.get("rows")?.as_u64()).sum();
    Some(wording::batches_sealed(batches.len(), rows))
}

/// The flags that are set.
fn flags(flags: &Value) -> String {
    let Some(fields) = flags.as_object() else { return "flags".to_owned() };
    let mut labels: Vec<String> = Vec::new();
    for (name, value) in fields {
        match value {
            Value::Bool(true) => labels.push(name.replace('_', " ")),
            Value::String(stage) => labels.push(format!("in {stage}")),
            _ => {}
        }
    }
    if labels.is_empty() { wording::NOTHING_FLAGGED.to_owned() } else { labels.join(", ") }
}

/// Names and plain values, for kinds without a sentence.
fn generic(value: &Value) -> String {
    let Some(fields) = value.as_object() else {
        return value.to_string().chars().take(VALUE_CHARS).collect();
    };
    let record = RecordFields { root: value };
    let names = fields.keys().filter(|name| *name != "change" && *name != "rows");
    let parts: Vec<String> = names
        .filter_map(|name| Some(format!("{} {}", name.replace('_', " "), record.text(name)?)))
        .take(6)
        .collect();
    if parts.is_empty() { value.to_string().chars().take(VALUE_CHARS).collect() } else { parts.join(", ") }
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
    fn records_are_shown_as_sentences() {
        let flags = json!({ "paused": true, "provisional": false, "running": "shadow" });
        let person =
            json!({ "act": "enrol", "by": "admin", "name": "ana", "role": "engineer", "reason": "known" });
        let alarm = json!({ "state": "latched", "priority": "high", "json": "{\"text\":\"too hot\"}" });
        for (kind, body, expected) in [
            (
                RecordKind::StateSet,
                json!({ "change": { "from": "registered", "to": "validated", "reason": "fine" }, "rows": [] }),
                wording::state_set("registered", "validated", Some("fine")),
            ),
            (RecordKind::FlagsSet, json!({ "change": { "flags": flags } }), "paused, in shadow".to_owned()),
            (
                RecordKind::ScoresSet,
                json!({ "change": { "kappas": [1.0, 0.5, null, null] } }),
                wording::scores("1.000, 0.500, ?, ?"),
            ),
            (
                RecordKind::ActiveSet,
                json!({ "change": { "active": "grasp@1.2.0", "pinned": "grasp@1.1.0", "cause": { "cause": "gate" } } }),
                wording::has_the_arm("grasp@1.2.0", Some("gate"), Some("grasp@1.1.0")),
            ),
            (
                RecordKind::PersonEnrolled,
                json!({ "change": { "act": person } }),
                wording::person("ana", "enrolled", [Some("engineer"), Some("admin"), Some("known")]),
            ),
            (
                RecordKind::TelemetryBlockSealed,
                json!({ "change": { "batches": [{ "rows": 20 }, { "rows": 30 }] } }),
                wording::batches_sealed(2, 50),
            ),
            (RecordKind::AlarmChanged, json!({ "change": alarm }), "latched, high: too hot".to_owned()),
            (
                RecordKind::Decision,
                json!({ "stage": "sandbox", "outcome": "activate", "reasons": [{ "text": "compatible" }] }),
                wording::decided(Some("sandbox"), Some("activate"), Some("compatible")),
            ),
            (
                RecordKind::Decision,
                json!({ "stage": "sandbox", "outcome": "reject", "reasons": [
                    { "code": "behavior-ended-early", "text": "ended after 24 of 120" },
                    { "code": "behavior-established-worse", "text": "violation is worse" }] }),
                wording::decided(Some("sandbox"), Some("reject"), Some("violation is worse")),
            ),
            (
                RecordKind::Asked,
                json!({ "asked": "register", "caller": { "user": "root", "process": 12 } }),
                wording::asked_for("root", "register", Some("12")),
            ),
            (
                RecordKind::CellStopped,
                json!({ "by": "ana", "reason": "a hand in the cell" }),
                wording::cell_stopped("ana", Some("a hand in the cell")),
            ),
            (
                RecordKind::Commissioned,
                json!({ "normal": { "tasks": 40 } }),
                wording::normal_measured(false, Some("40")),
            ),
            (RecordKind::PaceSet, json!({ "times": 10.0 }), shared::live_pace(Some(10.0))),
            (RecordKind::PaceSet, json!({ "times": null }), shared::live_pace(None)),
            (
                RecordKind::Recording,
                json!({ "file": "a.rrd", "bytes": 12 }),
                "file a.rrd, bytes 12".to_owned(),
            ),
        ] {
            assert_eq!(sentence(&record(kind.into(), &body)), expected, "{kind}");
        }
        // Missing fields are left out; unknown records are described as far as possible.
        let other = record(Lenient::read("of-a-later-build".to_owned()), &json!({ "color": "red" }));
        assert_eq!(sentence(&other), "color red");
        for kind in RecordKind::ALL {
            for body in [json!({}), json!([]), json!("x"), json!({ "change": 3 })] {
                assert!(!sentence(&record(kind.into(), &body)).contains("null"), "{kind} {body}");
            }
        }
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
