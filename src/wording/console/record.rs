//! The sentence of each record of the audit log, made from its kind and its content.
//!
//! Reads a record's content as plain JSON and describes the fields that this build knows. Only the record itself
//! counts; the sentence helps to find it.

use serde_json::Value;

use super::shared;
use crate::count::{counted, is_or_are};
use crate::notice_sentence;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::clock_time;

/// The largest content that gets a sentence, bytes; a larger one is named by its kind.
const BODY_BYTES_MAX: usize = 64 * 1024;

/// The most values of a record that are searched.
const LOOKED_AT_MAX: usize = 400;

/// Characters of one quoted value.
const VALUE_CHARS: usize = 160;

/// A record as a sentence, without a period.
#[must_use]
pub fn record_sentence(record: &AuditRecord) -> String {
    sentence_of_record(&record.kind, &record.body)
}

/// As [`record_sentence`], of a record's kind and content.
#[must_use]
pub fn sentence_of_record(kind: &Lenient<RecordKind>, body: &str) -> String {
    let value = (body.len() <= BODY_BYTES_MAX).then(|| serde_json::from_str::<Value>(body));
    let Some(Ok(value)) = value else {
        return format!("{kind}, {} of content", counted(body.len(), "byte"));
    };
    let specific = kind.known().and_then(|kind| sentence_of_kind(*kind, &RecordFields { root: &value }));
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
    serde_json::from_value::<Notice>(value.clone()).ok().map(|notice| notice_sentence(&notice))
}

/// The sentence of a known kind; absent if a field is missing.
fn sentence_of_kind(kind: RecordKind, fields: &RecordFields<'_>) -> Option<String> {
    let by = || fields.text("by").or_else(|| fields.text("who")).filter(|by| !by.is_empty());
    let actor = || by().unwrap_or_else(|| "somebody".to_owned());
    let value = |name: &str| fields.value(name);
    let reason = value("reason");
    let reason = reason.as_deref();
    Some(match kind {
        RecordKind::VersionRegistered => submitted(
            &fields.text("author")?,
            value("provenance").as_deref(),
            value("risk").as_deref(),
            value("parent").as_deref(),
        ),
        RecordKind::StateSet => state_set(&fields.text("from")?, &fields.text("to")?, reason),
        RecordKind::FlagsSet => flags(fields.find("flags")?),
        RecordKind::ScoresSet => {
            let kappas = fields.find("kappas")?.as_array()?;
            let values =
                kappas.iter().map(|kappa| kappa.as_f64().map_or("?".to_owned(), |k| format!("{k:.3}")));
            scores(&values.collect::<Vec<_>>().join(", "))
        }
        RecordKind::ActiveSet => match fields.text("active") {
            Some(active) => has_the_arm(&active, value("cause").as_deref(), value("pinned").as_deref()),
            None => no_version_has_the_arm(value("cause").as_deref()),
        },
        RecordKind::FamilySet => family_set(fields.find("safe_stopped")?.as_bool()?, reason),
        RecordKind::FamilyVoided => format!("earlier passes are void{}", led(": ", reason)),
        RecordKind::StandingSet => "the states of its versions, for a restart".to_owned(),
        RecordKind::EvidencePut => {
            format!("evidence of the {}, digest {}", fields.text("kind")?, fields.digest("digest"))
        }
        RecordKind::ApprovalRequested => {
            let until = fields.find("deadline_ms").and_then(Value::as_u64).map(|ms| {
                let until = WallTime::from_ms(i64::try_from(ms).unwrap_or(i64::MAX));
                // Earlier versions used virtual time.
                if until < WallTime::SCRIPT_EPOCH { clock_time(ms) } else { until.label() }
            });
            to_decide(&fields.text("needed")?, until.as_deref(), value("state").as_deref())
        }
        RecordKind::ApprovalPut => {
            let decision = fields.text("decision").or_else(|| fields.text("answer"))?;
            let who = by().or_else(|| fields.text("identity")).or_else(|| fields.text("name"))?;
            done_by(&who, &format!("says {decision}"), reason)
        }
        RecordKind::ApprovalConsumed => "an approval was used; it counts only once".to_owned(),
        RecordKind::PersonEnrolled => person_sentence("enrolled", fields)?,
        RecordKind::PersonConfirmed => person_sentence("confirmed", fields)?,
        RecordKind::PersonRevoked => person_sentence("revoked", fields)?,
        RecordKind::ContextSet => {
            format!("profile {}, policy {}", fields.text("profile")?, fields.digest("policy_digest"))
        }
        RecordKind::ProfileLoaded => format!("own profile{}", led(" ", value("name").as_deref())),
        RecordKind::TelemetrySealed | RecordKind::TelemetryBlockSealed => telemetry(fields)?,
        RecordKind::TelemetryPruned => {
            format!("telemetry up to batch {} is pruned for space", fields.text("through")?)
        }
        RecordKind::TelemetryMissed => "batches of telemetry are missing, and no record says why".to_owned(),
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
            decided(stage.as_deref(), outcome.as_deref(), fields.why().as_deref())
        }
        RecordKind::Monitor => {
            let found = fields.text("decision").or_else(|| fields.text("outcome"))?;
            monitor_found(&found, fields.why().as_deref())
        }
        RecordKind::MonitorAnswer => done_by(&actor(), "answered the monitor", reason),
        RecordKind::PauseSet => done_by(&actor(), &fields.text("act")?, reason),
        RecordKind::Resumed => done_by(&actor(), "resumed it", reason),
        RecordKind::KeyCommitted => {
            format!("its seeds got a secret key{}", led(": ", value("use").as_deref()))
        }
        RecordKind::KeyRevealed => "the key of its seeds was revealed".to_owned(),
        RecordKind::AnchorSet => done_by(&actor(), "made it the anchor", reason),
        RecordKind::TryCounted => format!("its sandbox is try {} of its author", fields.text("by_author")?),
        RecordKind::TriesReviewed => done_by(&actor(), "reviewed its tries", reason),
        RecordKind::BreakGlass => done_by(&actor(), "activated it alone, by break-glass", reason),
        RecordKind::CellStopped => cell_stopped(&actor(), reason),
        RecordKind::CellReleased => done_by(&actor(), "started the cell", reason),
        RecordKind::EngineBegan => {
            format!("an engine began to run the cell{}", led(" under ", value("profile").as_deref()))
        }
        RecordKind::EngineEnded => match fields.find_that("orderly", |_| true)?.as_bool() {
            Some(true) => shared::ENGINE_SHUT_DOWN_CLEANLY.to_owned(),
            Some(false) | None => "the engine ended suddenly; the next one found it".to_owned(),
        },
        RecordKind::GoalSet => done_by(&actor(), &format!("set the goal {}", fields.text("goal")?), reason),
        RecordKind::PaceSet => shared::live_pace(fields.find_that("times", |_| true)?.as_f64()),
        RecordKind::ShiftNote => done_by(&actor(), "notes", value("text").as_deref()),
        RecordKind::ClockDoubted => {
            "the machine's clock is not trusted until a person confirms the time".to_owned()
        }
        RecordKind::ClockConfirmed => {
            done_by(&actor(), &format!("confirmed the time, {}", fields.text("time")?), reason)
        }
        RecordKind::AlarmReset => done_by(&actor(), "reset it", reason),
        RecordKind::Asked => {
            let user =
                fields.text("user").or_else(|| fields.text("uid")).unwrap_or_else(|| "somebody".to_owned());
            asked_for(&user, &fields.text("asked")?, value("process").as_deref())
        }
        RecordKind::Drift => match fields.text("kind") {
            Some(kind) => drift_sets_in(&kind, value("magnitude").as_deref()),
            None => "the drift ends".to_owned(),
        },
        RecordKind::AuditClosed => closed(value("end").as_deref()),
        RecordKind::LiveHarm => {
            let count = |name: &str| fields.find("lived")?.get(name)?.as_u64();
            tasks_past_a_limit(count("any")?, count("tasks")?)
        }
        RecordKind::Commissioned | RecordKind::SensesCommissioned => {
            let tasks = fields.text("tasks").or_else(|| fields.text("episodes"));
            normal_measured(kind == RecordKind::SensesCommissioned, tasks.as_deref())
        }
        // The names and values of its fields say enough.
        _ => return None,
    })
}

fn person_sentence(what: &str, fields: &RecordFields<'_>) -> Option<String> {
    let [role, by, reason] = ["role", "by", "reason"].map(|name| fields.value(name));
    Some(person(&fields.text("name")?, what, [role.as_deref(), by.as_deref(), reason.as_deref()]))
}

fn telemetry(fields: &RecordFields<'_>) -> Option<String> {
    let Some(batches) = fields.find("batches").and_then(Value::as_array) else {
        return Some(batches_sealed(1, fields.text("rows")?.parse().ok()?));
    };
    let rows = batches.iter().filter_map(|batch| batch.get("rows")?.as_u64());
    Some(batches_sealed(batches.len(), rows.fold(0, u64::saturating_add)))
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
    if labels.is_empty() { "nothing runs and nothing is flagged".to_owned() } else { labels.join(", ") }
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

/// A text behind the words that lead to it; empty without one.
fn led(before: &str, text: Option<&str>) -> String {
    text.map_or_else(String::new, |text| format!("{before}{text}"))
}

/// What a person did, and why.
fn done_by(actor: &str, act: &str, reason: Option<&str>) -> String {
    format!("{actor} {act}{}", led(": ", reason))
}

fn scores(values: &str) -> String {
    format!("interface, policy, behavior, recovery: {values}")
}

fn tasks_past_a_limit(any: u64, tasks: u64) -> String {
    format!("past a limit of harm: {any} of {}", counted(tasks, "live task"))
}

fn batches_sealed(batches: usize, rows: u64) -> String {
    let (sealed, rows) = (counted(batches, "batch"), counted(rows, "row"));
    format!("{sealed} of telemetry {} sealed, {rows}", is_or_are(batches))
}

fn submitted(author: &str, provenance: Option<&str>, risk: Option<&str>, parent: Option<&str>) -> String {
    let [provenance, risk, parent] =
        [led(", ", provenance), led(", estimated risk ", risk), led(", made from ", parent)];
    format!("submitted by {author}{provenance}{risk}{parent}")
}

fn state_set(from: &str, to: &str, reason: Option<&str>) -> String {
    format!("{from} -> {to}{}", led(": ", reason))
}

fn has_the_arm(active: &str, cause: Option<&str>, target: Option<&str>) -> String {
    let (cause, target) = (led(" by ", cause), led("; the rollback target is ", target));
    format!("{active} has the arm{cause}{target}")
}

fn no_version_has_the_arm(cause: Option<&str>) -> String {
    format!("no version has the arm{}", led(": ", cause))
}

fn family_set(safe_stopped: bool, reason: Option<&str>) -> String {
    let state = if safe_stopped { "safe-stopped" } else { "works" };
    format!("{state}{}", led(": ", reason))
}

fn to_decide(needed: &str, until: Option<&str>, state: Option<&str>) -> String {
    format!("{needed} to decide{}{}", led(" by ", until), led("; now ", state))
}

fn decided(stage: Option<&str>, outcome: Option<&str>, why: Option<&str>) -> String {
    let stage = stage.map_or_else(String::new, |stage| format!("{stage}: "));
    format!("{stage}decided{}{}", led(" ", outcome), led(": ", why))
}

fn monitor_found(found: &str, why: Option<&str>) -> String {
    format!("the monitor: {found}{}", led(": ", why))
}

fn cell_stopped(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "stopped the cell", reason)
}

fn asked_for(user: &str, asked: &str, process: Option<&str>) -> String {
    let process = process.map_or_else(String::new, |process| format!(" (process {process})"));
    format!("{user} asked for {asked}{process}")
}

fn drift_sets_in(kind: &str, magnitude: Option<&str>) -> String {
    format!("{kind}{} sets in", led(" ", magnitude))
}

fn closed(end: Option<&str>) -> String {
    format!("closed{}", led(" as ", end))
}

fn normal_measured(of_the_camera: bool, tasks: Option<&str>) -> String {
    let what = if of_the_camera { "for the camera check" } else { "for it" };
    let tasks = tasks.map_or_else(String::new, |tasks| format!(", over {tasks} tasks"));
    format!("what is normal {what} was measured{tasks}")
}

fn person(name: &str, what: &str, [role, by, reason]: [Option<&str>; 3]) -> String {
    format!("{name} is {what}{}{}{}", led(" as ", role), led(" by ", by), led(": ", reason))
}

#[cfg(test)]
mod tests {
    use holdpoint_governance::closed_set::Lenient;
    use holdpoint_governance::ids::Digest;
    use serde_json::json;

    use super::*;

    fn record(kind: Lenient<RecordKind>, body: &Value) -> AuditRecord {
        let digest = Digest::of_parts("t", &[]);
        let (subject, body) = ("grasp@1.2.0".to_owned(), body.to_string());
        AuditRecord { seq: 7, prev: digest, hash: digest, at_ms: 1_500, kind, subject, body, wall_ms: 0 }
    }

    #[test]
    fn records_are_shown_as_sentences() {
        let flags = json!({ "paused": true, "provisional": false, "running": "shadow" });
        let enrolled =
            json!({ "act": "enrol", "by": "admin", "name": "ana", "role": "engineer", "reason": "known" });
        let alarm = json!({ "state": "latched", "priority": "high", "json": "{\"text\":\"too hot\"}" });
        for (kind, body, expected) in [
            (
                RecordKind::StateSet,
                json!({ "change": { "from": "registered", "to": "validated", "reason": "fine" }, "rows": [] }),
                state_set("registered", "validated", Some("fine")),
            ),
            (RecordKind::FlagsSet, json!({ "change": { "flags": flags } }), "paused, in shadow".to_owned()),
            (
                RecordKind::ScoresSet,
                json!({ "change": { "kappas": [1.0, 0.5, null, null] } }),
                scores("1.000, 0.500, ?, ?"),
            ),
            (
                RecordKind::ActiveSet,
                json!({ "change": { "active": "grasp@1.2.0", "pinned": "grasp@1.1.0", "cause": { "cause": "gate" } } }),
                has_the_arm("grasp@1.2.0", Some("gate"), Some("grasp@1.1.0")),
            ),
            (
                RecordKind::PersonEnrolled,
                json!({ "change": { "act": enrolled } }),
                person("ana", "enrolled", [Some("engineer"), Some("admin"), Some("known")]),
            ),
            (
                RecordKind::TelemetryBlockSealed,
                json!({ "change": { "batches": [{ "rows": 20 }, { "rows": 30 }] } }),
                batches_sealed(2, 50),
            ),
            (RecordKind::AlarmChanged, json!({ "change": alarm }), "latched, high: too hot".to_owned()),
            (
                RecordKind::Decision,
                json!({ "stage": "sandbox", "outcome": "activate", "reasons": [{ "text": "compatible" }] }),
                decided(Some("sandbox"), Some("activate"), Some("compatible")),
            ),
            (
                RecordKind::Decision,
                json!({ "stage": "sandbox", "outcome": "reject", "reasons": [
                    { "code": "behavior-ended-early", "text": "ended after 24 of 120" },
                    { "code": "behavior-established-worse", "text": "violation is worse" }] }),
                decided(Some("sandbox"), Some("reject"), Some("violation is worse")),
            ),
            (
                RecordKind::Asked,
                json!({ "asked": "register", "caller": { "user": "root", "process": 12 } }),
                asked_for("root", "register", Some("12")),
            ),
            (
                RecordKind::CellStopped,
                json!({ "by": "ana", "reason": "a hand in the cell" }),
                cell_stopped("ana", Some("a hand in the cell")),
            ),
            (
                RecordKind::Commissioned,
                json!({ "normal": { "tasks": 40 } }),
                normal_measured(false, Some("40")),
            ),
            (RecordKind::PaceSet, json!({ "times": 10.0 }), shared::live_pace(Some(10.0))),
            (RecordKind::PaceSet, json!({ "times": null }), shared::live_pace(None)),
            (
                RecordKind::Recording,
                json!({ "file": "a.rrd", "bytes": 12 }),
                "file a.rrd, bytes 12".to_owned(),
            ),
        ] {
            assert_eq!(record_sentence(&record(kind.into(), &body)), expected, "{kind}");
        }
        // Missing fields are left out; unknown records are described as far as possible.
        let other = record(Lenient::read("of-a-later-build".to_owned()), &json!({ "color": "red" }));
        assert_eq!(record_sentence(&other), "color red");
        for kind in RecordKind::ALL {
            for body in [json!({}), json!([]), json!("x"), json!({ "change": 3 })] {
                assert!(!record_sentence(&record(kind.into(), &body)).contains("null"), "{kind} {body}");
            }
        }
    }

    /// The parts that may be missing, each once with all of them and once with none.
    #[test]
    fn sentences_of_records_leave_out_what_is_missing() {
        for (sentence, expected) in [
            (state_set("registered", "validated", Some("fine")), "registered -> validated: fine"),
            (state_set("registered", "validated", None), "registered -> validated"),
            (
                submitted("cora", Some("manual"), Some("low"), Some("grasp@1.1.0")),
                "submitted by cora, manual, estimated risk low, made from grasp@1.1.0",
            ),
            (submitted("cora", None, None, None), "submitted by cora"),
            (
                has_the_arm("grasp@1.2.0", Some("gate"), Some("grasp@1.1.0")),
                "grasp@1.2.0 has the arm by gate; the rollback target is grasp@1.1.0",
            ),
            (no_version_has_the_arm(None), "no version has the arm"),
            (family_set(true, Some("a trip")), "safe-stopped: a trip"),
            (to_decide("2", Some("noon"), Some("open")), "2 to decide by noon; now open"),
            (to_decide("2", None, None), "2 to decide"),
            (
                decided(Some("sandbox"), Some("reject"), Some("violation is worse")),
                "sandbox: decided reject: violation is worse",
            ),
            (decided(None, None, None), "decided"),
            (cell_stopped("ana", Some("a hand")), "ana stopped the cell: a hand"),
            (asked_for("root", "register", Some("12")), "root asked for register (process 12)"),
            (asked_for("root", "register", None), "root asked for register"),
            (drift_sets_in("friction", Some("small")), "friction small sets in"),
            (closed(Some("export")), "closed as export"),
            (normal_measured(false, Some("40")), "what is normal for it was measured, over 40 tasks"),
            (normal_measured(true, None), "what is normal for the camera check was measured"),
            (
                person("ana", "enrolled", [Some("engineer"), Some("admin"), Some("known")]),
                "ana is enrolled as engineer by admin: known",
            ),
            (shared::live_pace(Some(10.0)), "the live cell runs 10 simulated seconds a second"),
            (shared::live_pace(None), "the live cell runs as fast as it computes"),
        ] {
            assert_eq!(sentence, expected);
        }
    }
}
