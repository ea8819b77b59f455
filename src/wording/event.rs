//! One line per event: the plain stream, also for screen readers.
//!
//! Foreign text is sanitized; nothing here moves a cursor or draws a box.

use std::fmt::Write as _;

use crate::condition::conditions_of_use;
use crate::console::record::sentence_of_record;
use crate::harm::harm_past;
use crate::past_limit::{after_event, past_limit};
use crate::twin::{rate_tallies, uncompared};
use crate::{counted, failure_cause, notice, notice_sentence, version_diff};
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::profile::titled;
use holdpoint_protocol::clock::ms_of;
use holdpoint_protocol::command::Caller;
use holdpoint_protocol::event::{DimensionResult, Event, EventKind, TaskSummary};
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_text::{SafeText, Untrusted};

/// The longest line, columns; longer ones are cut.
pub const LINE_WIDTH_MAX: usize = 4_000;

/// The line of an event, without its end.
#[must_use]
pub fn line(event: &Event) -> String {
    let secs = event.at_ms / 1000;
    let tenths = event.at_ms / 100 % 10;
    format!("{secs:>6}.{tenths} {}", sentence(event, LINE_WIDTH_MAX).as_str())
}

/// The text of an event, without its time, on one line of at most `width_max` columns.
#[must_use]
pub fn sentence(event: &Event, width_max: usize) -> SafeText {
    Untrusted::new(text(&event.kind)).display(width_max)
}

fn text(kind: &EventKind) -> String {
    match kind {
        EventKind::EngineStarted { profile, site, robot, seed, policy, agent, .. } => format!(
            "engine   up: profile {}, robot {robot}, {}, policy {}, agent {}",
            titled(*profile, site.as_ref()),
            crate::seeds::named(*seed),
            policy.short(),
            agent.short()
        ),
        EventKind::Recovered { version, text } => format!("recover  {version}: {}", notice(text)),
        EventKind::Registered {
            version,
            digest,
            author,
            requester,
            provenance,
            risk,
            parent,
            interface_changes,
            notices,
        } => {
            let parent = parent.as_ref().map_or_else(String::new, |parent| format!(", from {parent}"));
            let mut line = format!(
                "register {version} {} by {author} ({provenance}, estimated risk {risk}{parent}), requested by {}",
                digest.short(),
                requester.name()
            );
            if !interface_changes.is_empty() {
                let changes: Vec<String> = interface_changes.iter().map(ToString::to_string).collect();
                let _ = write!(line, "; declares: {}", changes.join(", "));
            }
            for notice in notices {
                let _ = write!(line, "; {}", notice_sentence(notice));
            }
            line
        }
        EventKind::StageStarted { version, stage, budget } => {
            format!("stage    {version}: {} begins, budget {budget}", stage.name())
        }
        EventKind::Progress { version, what, done, budget, part: None, .. } => {
            format!("progress {version}: {what} {done}/{budget}")
        }
        EventKind::Progress { version, what, done, budget, part: Some(part), .. } => {
            format!("progress {version}: {what} {}/{}, in all {done}/{budget}", part.done, part.budget)
        }
        EventKind::Decided {
            version,
            stage,
            outcome,
            dimensions,
            composite: _,
            reasons,
            conditions,
            deployment,
        } => {
            let outcome = match *outcome {
                // Shadow and the gate are still ahead.
                StageOutcome::Activate => "eligible for activation",
                other => other.name(),
            };
            let mut line = format!("decide   {version}: {} -> {outcome}", stage.name());
            if let Some(deployment) = deployment {
                let _ = write!(line, " ({deployment})");
            }
            for dimension in dimensions {
                let _ = write!(line, ", {}", kappa(dimension));
            }
            for reason in reasons.iter().take(4) {
                let _ = write!(line, "; {}", crate::line(reason));
            }
            if !conditions.is_empty() {
                let _ = write!(line, "; conditions: {}", listed(&conditions_of_use(conditions)));
            }
            line
        }
        EventKind::StateChanged { version, from, to, reason } => {
            format!("state    {version}: {from} -> {to} ({})", notice(reason))
        }
        EventKind::ApprovalRequested {
            version,
            replaces,
            needed,
            until,
            evidence,
            author,
            new_permissions,
            changes,
            conditions,
            untested,
            on_drift,
            purpose,
        } => {
            let replaces = replaces.as_ref().map_or_else(String::new, |id| format!(" in place of {id}"));
            if *purpose != RequestKind::Activation {
                let short = evidence.short();
                return format!(
                    "ask      {version}: {needed} to decide on its {purpose} by {}, evidence {short}; {on_drift}",
                    until.label()
                );
            }
            format!(
                "ask      {version}{replaces}: {needed} to approve by {}, evidence {}, made by {author}; new \
                 permissions: {}; changes: {}; conditions: {}; if it gets worse: {on_drift}; not tested: {}",
                until.label(),
                evidence.short(),
                listed(new_permissions),
                listed(&version_diff::lines(changes)),
                listed(&conditions_of_use(conditions)),
                listed(untested)
            )
        }
        EventKind::ApprovalReceived { version, by, decision, reason, have, needed } => {
            format!("answer   {version}: {by} says {decision} ({reason}); {have} of {needed}")
        }
        EventKind::Activated { version, replaced, modes, conditions, provisional_episodes } => {
            let replaced = replaced.as_ref().map_or_else(String::new, |id| format!(" in place of {id}"));
            let modes: Vec<&str> = modes.iter().map(|mode| mode.name()).collect();
            format!(
                "activate {version}{replaced}: {}, provisional for {}; conditions: {}",
                modes.join("+"),
                counted(*provisional_episodes, "episode"),
                listed(&conditions_of_use(conditions))
            )
        }
        EventKind::Confirmed { version, episodes } => {
            format!("confirm  {version}: {} without a trip", counted(*episodes, "episode"))
        }
        EventKind::Sequence { index, success, tasks, refused } => {
            // A task that a stop cut short has no cause of a failure.
            let is_cut_short =
                |task: &TaskSummary| refused.is_some() && !task.success && task.failure.is_none();
            let is_stopped = tasks.last().is_some_and(is_cut_short);
            let result = match (*success, is_stopped) {
                (true, _) => "done",
                (false, true) => "stopped",
                (false, false) => "not done",
            };
            let mut line = format!("work     sequence {index}: {result}");
            for task in tasks {
                let mark = if task.success {
                    "ok"
                } else if is_cut_short(task) {
                    "cut short"
                } else {
                    "failed"
                };
                let cause =
                    task.failure.map_or_else(String::new, |cause| format!(" ({})", failure_cause(cause)));
                let _ = write!(line, ", {} {mark}{cause} {:.1} s", task.version, task.time_secs);
                if task.violation {
                    line.push_str(" VIOLATION");
                }
                if let Some(past) = &task.past {
                    let _ = write!(line, " ({})", past_limit(past));
                }
                if task.anomaly {
                    line.push_str(" anomaly");
                }
                if task.uncovered {
                    line.push_str(" uncovered");
                }
            }
            if let Some(refused) = refused {
                let what = if is_stopped { "" } else { "not started: " };
                let _ = write!(line, "; {what}{refused}");
            }
            line
        }
        EventKind::Monitor { version, decision, reasons } => {
            let why: Vec<String> = reasons.iter().map(crate::line).collect();
            format!("monitor  {version}: {decision}; {}", why.join("; "))
        }
        EventKind::Rung { version, rung, failure, ms, text, .. } => {
            let ended = failure.map_or_else(|| "held".to_owned(), |why| format!("FAILED ({})", why.name()));
            format!("ladder   {version}: {} {ended} in {ms} ms: {}", rung.name(), notice(text))
        }
        EventKind::RolledBack {
            version,
            restored,
            trigger,
            time_to_safe_ms,
            time_to_rollback_ms,
            recovered,
            record,
        } => {
            let after =
                |ms: &Option<u64>| ms.map_or_else(|| "never".to_owned(), |ms| format!("after {ms} ms"));
            let restored = restored.as_ref().map_or_else(|| "no version".to_owned(), ToString::to_string);
            let compared = record.rates.as_ref().map_or_else(String::new, |rates| {
                format!("; in the same tasks {}", rate_tallies(&rates.tallies(), "the rollback target"))
            });
            let unproven = record.uncompared.map_or_else(String::new, |why| format!("; {}", uncompared(why)));
            format!(
                "rollback {version} -> {restored}: {}{}; safe {}, restored {}, {}{compared}{unproven}",
                notice(trigger),
                after_event(record.trigger.measured.as_ref()),
                after(time_to_safe_ms),
                after(time_to_rollback_ms),
                if *recovered { "recovered" } else { "NOT recovered" }
            )
        }
        EventKind::Drift { kind, magnitude } => match kind {
            Some(kind) => {
                let much = magnitude.map_or_else(String::new, |magnitude| format!(" {magnitude}"));
                format!("drift    {kind}{much} sets in")
            }
            None => "drift    ends".to_owned(),
        },
        EventKind::LiveFault { fault } => match fault {
            Some(fault) => format!("fault    {fault} in the live world"),
            None => "fault    repaired in the live world".to_owned(),
        },
        EventKind::ShiftNote { by, text } => format!("note     {by}: {text}"),
        EventKind::GoalSet { goal, by, reason } => format!("goal     {goal}: set by {by} ({reason})"),
        EventKind::Continued { version, by, reason } => {
            format!("goes on  {version}: answered by {by} ({reason})")
        }
        EventKind::Commissioned { version, tasks, failures, timeouts, peak_force_n } => format!(
            "normal   {version}: {failures} of {tasks} tasks failed, {timeouts} ran out of time, at most \
             {peak_force_n:.1} N; stored as normal for {}",
            version.family
        ),
        EventKind::HarmPastLimit { version, task, sequence, past, danger, tasks_past } => {
            let measures: Vec<String> = past.iter().map(harm_past).collect();
            let of_sequence = sequence.map_or_else(String::new, |sequence| format!(", sequence {sequence}"));
            // A safety event opens an alarm; a task past a limit alone does not, and the line says so.
            let then = if *danger { "DANGER to people" } else { "counted, no alarm by itself" };
            format!(
                "harm     {version}: {} in live task {task}{of_sequence}; {tasks_past} of {task} tasks past a \
                 harm limit; {then}",
                measures.join("; ")
            )
        }
        EventKind::SensesCommissioned { tasks, picture_jitter_m, pictures_missing } => format!(
            "normal   camera: jitter up to {:.1} mm, up to {:.0} % of camera frames missing in {tasks} \
             tasks; stored as normal for the cell",
            picture_jitter_m * 1e3,
            pictures_missing * 100.0
        ),
        EventKind::CellStopped { by, caller, reason } => {
            let why = if reason.is_empty() { String::new() } else { format!(": {reason:?}") };
            format!("STOP     the cell is stopped by {}{why}", stop_author(by, caller))
        }
        EventKind::ArmStands { ticks } => {
            format!("stands   at standstill {} ms after the stop", ms_of(*ticks))
        }
        EventKind::CellReleased { by, caller, reason } => {
            format!("go       the cell is started by {by}, {caller} ({reason})")
        }
        EventKind::Released { version, by, reason } => {
            format!("release  {version}: restriction lifted by {by} ({reason})")
        }
        EventKind::Resumed { version, by, reason } => {
            format!("resume   {version}: resumed by {by} ({reason})")
        }
        EventKind::AnchorSet { version, by, reason } => {
            format!("anchor   {version}: anchor of its family; set by {by} ({reason})")
        }
        EventKind::TriesReviewed { version, by, reason } => {
            format!("tries    {version}: the tries of its family are reviewed by {by} ({reason})")
        }
        EventKind::ProfilesSet { version, closed, by, reason } => {
            let closed: Vec<&str> = closed.iter().map(|profile| profile.name()).collect();
            let closed = if closed.is_empty() { "none".to_owned() } else { closed.join(", ") };
            format!("profiles {version}: blocked under: {closed}; set by {by} ({reason})")
        }
        EventKind::BreakGlass { version, by, reason, until } => format!(
            "EMERGENCY {version}: {by} activates it alone ({reason}); rolled back without two reviews by {}",
            until.label()
        ),
        EventKind::Reviewed { version, upheld, by } => {
            let found = if *upheld { "upheld" } else { "NOT upheld" };
            format!("review   {version}: its emergency activation is {found} by {}", by.join(", "))
        }
        EventKind::Pace { times } => match times {
            Some(times) => format!("pace     {times} simulated seconds in a second"),
            None => "pace     as fast as it computes".to_owned(),
        },
        EventKind::Alarm { alarm, state, priority, text, .. } => {
            format!("alarm    {alarm} [{priority}, {state}] {}", notice(text))
        }
        EventKind::Voided { family, reason } => format!("void     {family}: {}", notice(reason)),
        EventKind::Recorded { kind, version, body } => {
            let about = version.as_ref().map_or_else(String::new, |version| format!("{version}: "));
            format!("record   {about}{kind}: {}", sentence_of_record(kind, body))
        }
        EventKind::AuditClosed { version, outcome, records } => {
            format!("closed   {version}: {outcome}, {}", counted(*records, "audit record"))
        }
        EventKind::RecordingKept { version, file, digest, bytes, pictures: frames, dropped } => {
            let mut line = format!(
                "kept     {version}: recording {file}, {:.2} MiB, {}, {}",
                *bytes as f64 / f64::from(1 << 20),
                counted(*frames, "video frame"),
                digest.short()
            );
            if dropped.iter().any(|count| *count > 0) {
                let [frames, events] = [(dropped[0], "video frame"), (dropped[1], "event")]
                    .map(|(count, of)| counted(count, of));
                let _ = write!(line, "; {frames} and {events} DROPPED");
            }
            line
        }
        EventKind::Scene { text, failed } => {
            format!("scene    {}{text}", if *failed { "NOT SHOWN: " } else { "" })
        }
        EventKind::CommandRefused { id, text } => format!("refused  {id}: {text}"),
        EventKind::Fault { text } => format!("FAULT    {text}; the engine is halted"),
    }
}

/// The phase of an upgrade after an event; absent if it does not change.
#[must_use]
pub fn upgrade_phase(kind: &EventKind) -> Option<String> {
    Some(match kind {
        EventKind::StageStarted { stage, .. } => stage.name().to_owned(),
        EventKind::StateChanged { to, .. } => to.name().to_owned(),
        EventKind::ApprovalRequested { .. } => "waits for people".to_owned(),
        EventKind::Activated { .. } => "active, provisional".to_owned(),
        EventKind::Confirmed { .. } => "active, confirmed".to_owned(),
        EventKind::Monitor { decision, .. } => format!("active, {decision}"),
        EventKind::Rung { .. } => "rollback ladder".to_owned(),
        EventKind::RolledBack { .. } => "rolled back".to_owned(),
        _ => return None,
    })
}

/// Whether a family works after a rollback.
#[must_use]
pub const fn family_after_rollback(recovered: bool) -> &'static str {
    if recovered { "the family runs again" } else { "the family does not work" }
}

fn listed<T: ToString>(items: &[T]) -> String {
    if items.is_empty() {
        return "none".to_owned();
    }
    let texts: Vec<String> = items.iter().map(ToString::to_string).collect();
    texts.join(", ")
}

fn kappa(dimension: &DimensionResult) -> String {
    let name = dimension.dimension.name();
    let estimate = if dimension.measured { "" } else { "~" };
    match dimension.kappa {
        Some(value) => format!("{name} {estimate}{value:.2} ({})", dimension.outcome),
        None => format!("{name} ({})", dimension.outcome),
    }
}

/// The author of a stop: the process that the system reports, and then the name that it states. A stop needs no identity, so
/// the name is quoted: it must not read as a statement of the program.
#[must_use]
pub fn stop_author(by: &str, caller: &Caller) -> String {
    if by.is_empty() { format!("{caller}, an unnamed person") } else { format!("{caller} as {by:?}") }
}

#[cfg(test)]
mod tests {
    use holdpoint_governance::shared_event::UncomparedReason;

    use super::*;

    /// Regression: a failed task was `failed 3.4 s anomaly`, and nothing said why.
    #[test]
    fn a_failed_task_names_its_cause_and_an_older_event_reads_without_it() {
        let task = |cause: &str| -> TaskSummary {
            let json = format!(
                r#"{{"version":"grasp@1.0.0","success":false,"violation":false,"anomaly":true,"recovery":true,
                    "retries":0,"time_secs":3.4{cause}}}"#
            );
            serde_json::from_str(&json).unwrap()
        };
        for (cause, text) in [
            (r#","failure":"dropped""#, "failed (dropped the object) 3.4 s anomaly"),
            ("", "grasp@1.0.0 failed 3.4 s anomaly"),
        ] {
            let kind =
                EventKind::Sequence { index: 3, success: false, tasks: vec![task(cause)], refused: None };
            let line = sentence(&Event { seq: 1, at_ms: 0, kind }, LINE_WIDTH_MAX);
            assert!(line.as_str().ends_with(text), "{}", line.as_str());
        }
    }

    /// Regression: an unsigned registration was "requested by not known".
    #[test]
    fn an_unsigned_registration_names_no_one() {
        let digest = "a".repeat(64);
        let json = format!(
            r#"{{"event":"registered","version":"align@1.1.0","digest":"{digest}","author":"cora",
                "provenance":"manual","risk":"low","parent":null}}"#
        );
        let kind: EventKind = serde_json::from_str(&json).unwrap();
        let line = sentence(&Event { seq: 1, at_ms: 0, kind }, LINE_WIDTH_MAX);
        assert!(line.as_str().ends_with("requested by no one on record"), "{}", line.as_str());
    }

    #[test]
    fn a_rollback_without_a_comparison_says_why() {
        let told = |more: &str| {
            let json = format!(
                r#"{{"event":"rolled-back","version":"align@1.1.0","restored":"align@1.0.0","trigger":"a force",
                    "time_to_safe_ms":100,"time_to_rollback_ms":200,"recovered":true,"record":{{
                    "candidate":"align@1.1.0","predecessor":"align@1.0.0","trigger":{{"kind":"safety-event",
                    "event":"force-limit","text":"a force","tick":3}},"in_flight":true,"time_to_safe_ticks":24,
                    "time_to_safe_ms":100,"time_to_restored_ticks":48,"time_to_restored_ms":200,
                    "unsafe_continuation_ms":0,"rungs":[],"post_status":"rolled-back","recovered":true,
                    "resumed_tasks":1{more}}}}}"#
            );
            let kind: EventKind = serde_json::from_str(&json).unwrap();
            sentence(&Event { seq: 1, at_ms: 0, kind }, LINE_WIDTH_MAX).as_str().to_owned()
        };
        assert!(told("").ends_with("restored after 200 ms, recovered"), "{}", told(""));
        let rates = r#","rates":{"alpha":0.05,"rates":[{"rate":"failure","tasks":[
            {"seed":1,"version":true,"target":true},{"seed":2,"version":true,"target":false}],
            "version_alone":1,"target_alone":0,"p":0.5}]}"#;
        let line = told(rates);
        let tally = "; in the same tasks failure in 2 of 2 tasks, the rollback target in 1";
        assert!(line.ends_with(tally), "{line}");
        for why in UncomparedReason::ALL {
            let line = told(&format!(r#","uncompared":"{why}""#));
            assert!(line.ends_with(&format!("recovered; {}", uncompared(why))), "{line}");
        }
    }

    #[test]
    fn a_recorded_event_has_the_sentence_of_its_record() {
        let json = r#"{"event":"recorded","kind":"shift-note","version":"grasp@1.0.0",
            "body":"{\"by\":\"ana\",\"text\":\"lens cleaned\"}"}"#;
        let kind: EventKind = serde_json::from_str(json).unwrap();
        let version = kind.version().map(ToString::to_string);
        assert_eq!(version.as_deref(), Some("grasp@1.0.0"));
        let line = sentence(&Event { seq: 1, at_ms: 0, kind }, LINE_WIDTH_MAX);
        assert!(
            line.as_str().contains("shift-note") && line.as_str().contains("lens cleaned"),
            "{}",
            line.as_str()
        );
    }

    /// Regression: a stopped task read as failed, and a decision of the sandbox as an activation.
    #[test]
    fn a_stop_is_told_as_a_stop_and_a_decision_in_plain_words() {
        let line = |kind: &str| {
            let kind: EventKind = serde_json::from_str(kind).unwrap();
            sentence(&Event { seq: 1, at_ms: 0, kind }, LINE_WIDTH_MAX).as_str().to_owned()
        };
        let sequence = |refused: &str| {
            line(&format!(
                r#"{{"event":"sequence","index":3,"success":false,"refused":{refused},"tasks":[{{"version":"grasp@1.0.0",
                    "success":false,"violation":false,"anomaly":false,"recovery":false,"retries":0,"time_secs":3.4}}]}}"#
            ))
        };
        assert_eq!(
            sequence(r#""the arm was stopped""#),
            "work     sequence 3: stopped, grasp@1.0.0 cut short 3.4 s; the arm was stopped"
        );
        assert_eq!(sequence("null"), "work     sequence 3: not done, grasp@1.0.0 failed 3.4 s");
        let decided = r#"{"event":"decided","version":"grasp@1.1.0","stage":"sandbox","outcome":"activate","dimensions":
            [{"dimension":"behavior","outcome":"compatible","kappa":0.93,"interval":null,"threshold":0.85,"measured":true}],
            "composite":0.9,"reasons":[],"conditions":[]}"#;
        assert_eq!(
            line(decided),
            "decide   grasp@1.1.0: sandbox -> eligible for activation, behavior 0.93 (compatible)"
        );
        assert_eq!(
            line(r#"{"event":"arm-stands","ticks":17}"#),
            "stands   at standstill 71 ms after the stop"
        );
    }

    #[test]
    fn live_task_past_a_limit_names_measures_values_and_counts() {
        let line = |json: &str| {
            let kind: EventKind = serde_json::from_str(json).unwrap();
            sentence(&Event { seq: 1, at_ms: 0, kind }, LINE_WIDTH_MAX).as_str().to_owned()
        };
        let json = r#"{"event":"harm-past-limit","version":"place@1.0.0","task":107,"danger":true,"tasks_past":3,
            "past":[{"measure":"landing-speed","value":2.31,"limit":0.3,"unit":"m/s"},
                    {"measure":"drop-height","value":0.27,"limit":0.01,"unit":"m"}]}"#;
        assert_eq!(
            line(json),
            "harm     place@1.0.0: speed of the object at landing 2.310 m/s, above its harm limit 0.300 m/s; fall of \
             the object 0.2700 m, above its harm limit 0.0100 m in live task 107; 3 of 107 tasks past a harm limit; \
             DANGER to people"
        );
        // A distance is past its limit where it is less; and no alarm stands beside the line.
        let json = r#"{"event":"harm-past-limit","version":"place@1.0.0","task":9,"danger":false,"tasks_past":1,
            "past":[{"measure":"joint-margin","value":0.02,"limit":0.05,"unit":"rad"}]}"#;
        assert_eq!(
            line(json),
            "harm     place@1.0.0: distance to a joint's limit 0.020 rad, below its harm limit 0.050 rad in live \
             task 9; 1 of 9 tasks past a harm limit; counted, no alarm by itself"
        );
    }

    /// An observer stopped the cell as `ana, root (uid 0), since 10:00; the fence is closed, start it`.
    #[test]
    fn the_author_of_a_stop_is_the_process_and_a_stated_name_is_quoted() {
        let caller = Caller::Process { uid: 8, user: None, process: Some(5) };
        let author = stop_author("ana, root (uid 0)\"; start it", &caller);
        assert_eq!(author, r#"uid 8 (without a name, process 5) as "ana, root (uid 0)\"; start it""#);
        assert_eq!(stop_author("", &Caller::Script), "a script, an unnamed person");
    }

    /// Sanitizing a text twice changes nothing.
    #[test]
    fn what_is_safe_stays_as_it_is() {
        let text = "\u{1b}[2J\u{7}\r\n\u{202e}evom\u{200b} a \\u{41} \u{e9}".to_owned();
        let event = Event { seq: 1, at_ms: 0, kind: EventKind::Scene { text, failed: false } };
        let once = sentence(&event, 80);
        assert!(!once.as_str().contains(char::is_control));
        assert_eq!(Untrusted::new(once.as_str()).display(80).as_str(), once.as_str());
    }
}
