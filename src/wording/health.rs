//! Health over time in words: the marks of a series, and the titles of an exported chart.

use holdpoint_governance::calendar;
use holdpoint_governance::ids::Family;
use holdpoint_governance::stats::Interval;
use holdpoint_protocol::clock::clock_time;
use holdpoint_protocol::health::{
    AlarmEpisode, AlarmStep, HealthClock, HealthCoverage, HealthMark, HealthPanel, HealthVerdict,
    MarkContent, MarkKind, MarkedAct, SIDE_TASKS_MIN, Trend, VerdictSide, duration_label,
};

use crate::counted;

/// Why a series of a script has no buckets by the machine's clock.
pub const NO_MACHINE_TIME: &str = "this record has no time of the machine's clock: it is a script's";

/// The placeholder of a person whom the record does not name.
const UNNAMED: &str = "an unnamed person";

/// What a mark states: what, about whom, by whom and why.
#[must_use]
pub fn mark(of: &MarkContent) -> String {
    use MarkContent as M;
    match of {
        M::TookOver { version } => format!("{version} took over"),
        M::FirstOfFamily { version } => format!("{version} is the first of its family"),
        M::TookOverAgain { version } => format!("{version} took over again"),
        M::Reactivated { version } => format!("{version} was made active again by a person"),
        M::NoActiveVersion { family } => format!("{family} has no active version"),
        M::StateChanged { subject, reason } => format!("{subject}: {}", crate::notice(reason)),
        M::Confirmed { subject } => format!("{subject} was confirmed"),
        M::Restricted { subject, reason } => {
            let why = reason.as_deref().map_or_else(String::new, crate::reason);
            format!("{subject}: {why}")
        }
        M::Acted { by, act, reason } => {
            let person = if by.is_empty() { UNNAMED } else { by };
            let act = marked_act(act);
            if reason.is_empty() { format!("{person} {act}") } else { format!("{person} {act}: {reason}") }
        }
        M::DriftBegan { drift, magnitude } => format!("{drift} {magnitude} began in the live cell"),
        M::DriftEnded => "the drift of the cell ended".to_owned(),
        M::FaultBegan { fault } => format!("{fault} in the live cell"),
        M::FaultRepaired => "the fault of the live cell was repaired".to_owned(),
        M::Note { by, text } => format!("{by}: {text}"),
        M::ProfileInForce { profile } => {
            format!("judged under the profile {} from here on", profile.as_deref().unwrap_or("unknown"))
        }
        M::NormalCounted { subject, tasks, failures, force_n } => format!(
            "normal for {subject}: {:.0} of {tasks:.0} tasks done, at most {force_n:.1} N",
            tasks - failures
        ),
        M::NoEngine { ms } => {
            format!("no engine ran for {} before this, or the machine slept", duration_label(*ms))
        }
        M::AlarmRaised { alarm, text } => text.as_ref().map_or_else(|| alarm.clone(), crate::notice),
        M::AlarmClosed { alarm, by, reason } => {
            format!("{alarm} closed by {}: {reason}", by.as_deref().unwrap_or(UNNAMED))
        }
    }
}

fn marked_act(act: &MarkedAct) -> String {
    match act {
        MarkedAct::BreakGlass { subject } => format!("activated {subject} alone by break-glass"),
        MarkedAct::StoppedCell => "stopped the cell".to_owned(),
        MarkedAct::StartedCell => "started the cell".to_owned(),
        MarkedAct::SetGoal { goal } => format!("set the goal {goal}"),
    }
}

/// The comparison of the tasks before and since a moment with its numbers, one sentence.
#[must_use]
pub fn health_verdict(of: &HealthVerdict) -> String {
    let HealthVerdict { family, moment, sampled, unsealed, before, since, interval } = of;
    let share = |side: &VerdictSide| side.succeeded as f64 / side.tasks.max(1) as f64;
    let side = |side: &VerdictSide| {
        if side.tasks == 0 {
            return "no task on record".to_owned();
        }
        format!("{:.1} % of {}", 100.0 * share(side), side.tasks)
    };
    let difference = interval.as_ref().map_or_else(String::new, |Interval { lower, upper, .. }| {
        let points = 100.0 * (share(since) - share(before));
        let (low, high) = (100.0 * lower, 100.0 * upper);
        match of.trend() {
            // The direction is in the word: the numbers have no sign.
            Trend::Worse => format!(": worse by {:.1} points [{:.1}, {:.1}]", -points, -high, -low),
            Trend::Better => format!(": better by {points:.1} points [{low:.1}, {high:.1}]"),
            Trend::TooFew => format!(": too few to compare, {SIDE_TASKS_MIN} on each side are needed"),
            Trend::NotShown | Trend::NoData => {
                format!(": no difference shown, {points:+.1} points [{low:+.1}, {high:+.1}]")
            }
        }
    });
    let sample = if *sampled { ", of a sample" } else { "" };
    let uncounted = if *unsealed > 0 { format!("; {unsealed} newer not counted yet") } else { String::new() };
    format!(
        "success of {family} since {moment}: {}, before {}{difference}{sample}{uncounted}",
        side(since),
        side(before)
    )
}

/// The different versions of the two sides of a comparison, one sentence; absent if one version worked on both.
#[must_use]
pub fn confounding_versions(of: &HealthVerdict) -> Option<String> {
    let (before, since) = (&of.before.versions, &of.since.versions);
    if before.is_empty() || since.is_empty() || before.keys().eq(since.keys()) && before.len() == 1 {
        return None;
    }
    let counts = |side: &VerdictSide| {
        let all: Vec<String> =
            side.versions.iter().map(|(version, tasks)| format!("{version} ({tasks})")).collect();
        all.join(", ")
    };
    Some(format!("not the same version worked: before {}, since {}", counts(&of.before), counts(&of.since)))
}

/// What the numbers of a series omit, one sentence each; empty if they are complete.
#[must_use]
pub fn omissions(of: &HealthCoverage) -> Vec<String> {
    let mut sentences = Vec::new();
    if of.is_sample() {
        sentences.push(format!(
            "a sample: {} of {} sealed blocks of telemetry were read, spread evenly; a shorter span is read whole",
            of.blocks_read, of.blocks
        ));
    }
    for (count, noun, why) in [
        (of.not_judged, "task", "stopped by a person or without a result"),
        (of.removed, "batch", "removed for age or missing"),
        (of.late, "batch", "sealed only after the end of the engine"),
        (of.damaged, "batch", "unlike what the audit chain seals: see `holdpoint audit verify`"),
        (of.without_wall, "task", "without a time of the machine's clock"),
        (of.marks_left_off, "older mark", "left off"),
        (of.alarms_left_off, "older alarm change", "left off"),
    ] {
        if count > 0 {
            sentences.push(format!("in no number: {}, {why}", counted(count, noun)));
        }
    }
    sentences
}

/// The course of an alarm, one sentence per step without its text: the raise, people's actions with reasons, and how long
/// it was open, or is at `now_ms`.
#[must_use]
pub fn alarm_course(of: &AlarmEpisode, now_ms: u64) -> Vec<String> {
    let before = if of.began_before { ", or before" } else { "" };
    let mut sentences = vec![format!("raised by the engine {}{before}", step_time(&of.raised))];
    for (what, step) in [
        ("acknowledged", &of.acknowledged),
        ("shelved", &of.shelved),
        ("its condition was over", &of.over),
        ("reset", &of.reset),
    ] {
        let Some(step) = step else { continue };
        let by = step.by.as_ref().map_or_else(String::new, |by| format!(" by {by}"));
        let why = step.reason.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        sentences.push(format!("{what}{by} {}{why}", step_time(step)));
    }
    let duration = duration_label(of.active_ms(now_ms));
    let verb = if of.ended.is_some() { "stood" } else { "has stood" };
    sentences.push(format!("{verb} for {duration}, {} on record", counted(of.changes, "change")));
    sentences
}

/// The time of a step of an alarm, by both clocks.
fn step_time(step: &AlarmStep) -> String {
    let engine = clock_time(step.at_ms);
    match step.wall_ms {
        Some(wall_ms) => {
            let wall = calendar::day_and_time(wall_ms - wall_ms.rem_euclid(1_000));
            format!("{wall} UTC (engine {engine})")
        }
        None => format!("at {engine} of the engine's clock"),
    }
}

/// The kind of a mark.
#[must_use]
pub const fn mark_kind(of: MarkKind) -> &'static str {
    use MarkKind as K;
    match of {
        K::Promotion => "promotion",
        K::Confirmed => "confirmed",
        K::Rollback => "rollback",
        K::Demotion => "demotion",
        K::Restored => "restored",
        K::Vacated => "no active version",
        K::FirstVersion => "first version",
        K::Restriction => "restriction",
        K::BreakGlass => "break-glass",
        K::DriftAlarm => "drift alarm",
        K::AlarmRaised => "alarm",
        K::AlarmReset => "alarm reset",
        K::Drift => "drift",
        K::LiveFault => "fault of the cell",
        K::Stopped => "cell stopped",
        K::Released => "cell started",
        K::Goal => "goal",
        K::Note => "note",
        K::Context => "profile",
        K::Commissioned => "commissioned",
        K::EngineOff => "no engine",
    }
}

/// A mark in the legend of a chart: when, its kind, and what it states.
#[must_use]
pub fn mark_legend(when: &str, mark: &HealthMark) -> String {
    format!("{when}  {}: {}", mark_kind(mark.kind), mark.text)
}

/// The title of a panel: the quantity, its unit, and its band.
#[must_use]
pub const fn panel_title(panel: HealthPanel) -> &'static str {
    match panel {
        HealthPanel::Success => "success, % of tasks (band: 95 % interval)",
        HealthPanel::Violations => "violations, % of tasks (band: up to those near a limit)",
        HealthPanel::Time => "time of a task, s (median; band: to the 95th percentile)",
        HealthPanel::Force => "largest force of a task, N (median; band: to the 95th percentile)",
    }
}

/// The title of a chart; both times are texts of its clock.
#[must_use]
pub fn chart_title(family: &Family, from: &str, until: &str) -> String {
    format!("{family}: live tasks from {from} to {until}")
}

/// The title of the axis of time, with the width of a bucket.
#[must_use]
pub fn axis_title(clock: HealthClock, bucket_ms: u64) -> String {
    let width = bucket_width(bucket_ms);
    match clock {
        HealthClock::Wall => format!("time, UTC; a point stands for {width}"),
        HealthClock::Virtual => format!("the engine's time, h:min:s; a point stands for {width}"),
    }
}

fn bucket_width(ms: u64) -> String {
    match ms / 1_000 {
        secs @ 0..3_600 => format!("{} min", secs / 60),
        secs @ 3_600..86_400 => format!("{} h", secs / 3_600),
        secs => format!("{} d", secs / 86_400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::decision::{Dimension, Reason};
    use holdpoint_governance::finding::Finding;
    use holdpoint_governance::notice::NoticeOrText;

    fn acted(by: &str, act: MarkedAct, reason: &str) -> MarkContent {
        MarkContent::Acted { by: by.to_owned(), act, reason: reason.to_owned() }
    }

    #[test]
    fn a_verdict_has_a_direction_a_size_and_an_interval() {
        let side = |version: &str, tasks, succeeded| VerdictSide {
            tasks,
            succeeded,
            violated: 0,
            versions: [(version.parse().unwrap(), tasks)].into(),
        };
        let verdict = |before: VerdictSide, since: VerdictSide, bounds: Option<(f64, f64)>| HealthVerdict {
            family: Family::new("grasp").unwrap(),
            moment: "noon".to_owned(),
            sampled: false,
            unsealed: 0,
            interval: bounds.map(|(lower, upper)| Interval { lower, upper, level: 0.95 }),
            before,
            since,
        };
        let of = |before, since| (side("grasp@1.0.0", before, before), side(since, 40, 30));
        let (before, since) = of(50, "grasp@1.0.0");
        let worse = verdict(before, since, Some((-0.4, -0.1)));
        assert_eq!(
            health_verdict(&worse),
            "success of grasp since noon: 75.0 % of 40, before 100.0 % of 50: worse by 25.0 points [10.0, 40.0]"
        );
        assert_eq!(confounding_versions(&worse), None);
        let (before, since) = of(50, "grasp@1.1.0");
        let open = verdict(before, since, Some((-0.4, 0.1)));
        assert!(health_verdict(&open).ends_with("no difference shown, -25.0 points [-40.0, +10.0]"));
        assert_eq!(
            confounding_versions(&open).unwrap(),
            "not the same version worked: before grasp@1.0.0 (50), since grasp@1.1.0 (40)"
        );
        let open = HealthVerdict { unsealed: 37, ..open };
        assert!(health_verdict(&open).ends_with("+10.0]; 37 newer not counted yet"));
        let none = verdict(VerdictSide::default(), side("grasp@1.0.0", 40, 30), None);
        assert_eq!(
            health_verdict(&none),
            "success of grasp since noon: 75.0 % of 40, before no task on record"
        );
    }

    #[test]
    fn omitted_data_are_counted() {
        assert_eq!(omissions(&HealthCoverage::default()), Vec::<String>::new());
        let some = HealthCoverage { blocks: 9, blocks_read: 3, late: 2, ..HealthCoverage::default() };
        assert_eq!(
            omissions(&some),
            [
                "a sample: 3 of 9 sealed blocks of telemetry were read, spread evenly; a shorter span is read whole",
                "in no number: 2 batches, sealed only after the end of the engine"
            ]
        );
    }

    #[test]
    fn every_mark_has_its_sentence() {
        use MarkContent as M;
        let version = || "grasp@1.1.0".parse().unwrap();
        let subject = || "grasp@1.1.0".to_owned();
        let older = |text: &str| NoticeOrText::Text(text.to_owned());
        let silent = Reason::new(Dimension::Monitor, Finding::TelemetrySilent);
        for (of, text) in [
            (M::TookOver { version: version() }, "grasp@1.1.0 took over"),
            (M::FirstOfFamily { version: version() }, "grasp@1.1.0 is the first of its family"),
            (M::TookOverAgain { version: version() }, "grasp@1.1.0 took over again"),
            (M::Reactivated { version: version() }, "grasp@1.1.0 was made active again by a person"),
            (M::NoActiveVersion { family: Family::new("grasp").unwrap() }, "grasp has no active version"),
            (M::StateChanged { subject: subject(), reason: older("why") }, "grasp@1.1.0: why"),
            (M::Confirmed { subject: subject() }, "grasp@1.1.0 was confirmed"),
            (
                M::Restricted { subject: subject(), reason: Some(Box::new(silent)) },
                "grasp@1.1.0: telemetry is silent",
            ),
            (M::Restricted { subject: subject(), reason: None }, "grasp@1.1.0: "),
            (acted("ana", MarkedAct::StoppedCell, "a leak"), "ana stopped the cell: a leak"),
            (
                acted("ana", MarkedAct::BreakGlass { subject: subject() }, "now"),
                "ana activated grasp@1.1.0 alone by break-glass: now",
            ),
            (acted("ana", MarkedAct::SetGoal { goal: "sort".to_owned() }, ""), "ana set the goal sort"),
            (
                M::DriftBegan { drift: "noise".to_owned(), magnitude: "severe".to_owned() },
                "noise severe began in the live cell",
            ),
            (M::DriftEnded, "the drift of the cell ended"),
            (M::FaultBegan { fault: "tool-dead".to_owned() }, "tool-dead in the live cell"),
            (M::FaultRepaired, "the fault of the live cell was repaired"),
            (M::Note { by: "ana".to_owned(), text: "the tray is new".to_owned() }, "ana: the tray is new"),
            (
                M::ProfileInForce { profile: Some("sim".to_owned()) },
                "judged under the profile sim from here on",
            ),
            (M::ProfileInForce { profile: None }, "judged under the profile unknown from here on"),
            (
                M::NormalCounted { subject: subject(), tasks: 120.0, failures: 3.0, force_n: 21.04 },
                "normal for grasp@1.1.0: 117 of 120 tasks done, at most 21.0 N",
            ),
            (
                M::NoEngine { ms: 36_000_000 },
                "no engine ran for 10 h 0 min before this, or the machine slept",
            ),
            (M::AlarmRaised { alarm: "cell-degraded".to_owned(), text: None }, "cell-degraded"),
            (
                M::AlarmRaised { alarm: "cell-degraded".to_owned(), text: Some(older("the camera shakes")) },
                "the camera shakes",
            ),
            (
                M::AlarmClosed {
                    alarm: "cell-degraded".to_owned(),
                    by: Some("ana".to_owned()),
                    reason: "a new mount".to_owned(),
                },
                "cell-degraded closed by ana: a new mount",
            ),
        ] {
            assert_eq!(mark(&of), text);
        }
        let unnamed = acted("", MarkedAct::StartedCell, "");
        assert_eq!(mark(&unnamed), format!("{UNNAMED} started the cell"));
        let unnamed = M::AlarmClosed { alarm: "cell-degraded".to_owned(), by: None, reason: String::new() };
        assert_eq!(mark(&unnamed), format!("cell-degraded closed by {UNNAMED}: "));
    }

    #[test]
    fn an_exported_chart_names_family_span_and_bucket() {
        let family = Family::new("grasp").unwrap();
        assert_eq!(chart_title(&family, "a", "b"), "grasp: live tasks from a to b");
        for (clock, bucket_ms, text) in [
            (HealthClock::Wall, 60_000, "time, UTC; a point stands for 1 min"),
            (HealthClock::Wall, 86_400_000, "time, UTC; a point stands for 1 d"),
            (HealthClock::Virtual, 7_200_000, "the engine's time, h:min:s; a point stands for 2 h"),
        ] {
            assert_eq!(axis_title(clock, bucket_ms), text);
        }
        let promotion = HealthMark {
            kind: MarkKind::Promotion,
            on_clock_ms: 0,
            at_ms: 0,
            wall_ms: None,
            family: Some(family),
            text: "grasp@1.1.0 took over".to_owned(),
            record: 1,
        };
        assert_eq!(mark_legend("00:00:10", &promotion), "00:00:10  promotion: grasp@1.1.0 took over");
    }
}
