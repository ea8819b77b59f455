//! `holdpoint alarms`: the alarms of a store, open ones or their whole history.
//!
//! Reads only the store, so it answers with and without an engine. Changes nothing.

use clap::Args;
use serde::Serialize;

use super::data;
use super::metrics::SinceArg;
use super::time_arg::{TimeArg, when_help};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_explain::health_series::{HealthError, HealthReader};
use holdpoint_governance::alarms::{Alarm, AlarmState, Priority, Shelving};
use holdpoint_governance::calendar;
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_protocol::health::{AlarmEpisode, BUCKET_MS_MAX, BUCKETS_MAX, HealthClock, HealthQuery};
use holdpoint_registry::{SqliteReader, Views};
use holdpoint_store::{AuditFilter, Layout, ReadableStore};
use holdpoint_wording::alarm as wording;
use holdpoint_wording::program::alarms as sentences;

/// The arguments of `alarms`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = concat!(
    when_help!(),
    "
Examples:
  holdpoint alarms
  holdpoint alarms --history --since 24h
  holdpoint alarms --history --courses
  holdpoint alarms --history --alarm degraded:grasp@1.0.0"
))]
pub struct AlarmsArgs {
    /// Shows every change of every alarm, newest first, instead of the open alarms.
    #[arg(long)]
    pub history: bool,
    /// With --history: shows each raising of an alarm once, with the people who acted and its duration.
    #[arg(long, requires = "history")]
    pub courses: bool,
    /// Shows only this alarm.
    #[arg(long, value_name = "NAME")]
    pub alarm: Option<String>,
    /// Shows only what changed since then; with --courses, what was open since then.
    #[arg(long, value_name = "WHEN")]
    pub since: Option<TimeArg>,
    /// Shows at most N lines.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u16).range(1..=10_000))]
    pub limit: u16,
}

/// An alarm, or a change of one.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct AlarmLine {
    /// Virtual time, ms.
    at_ms: u64,
    /// The machine's time, ms since 1970; absent in scripts.
    #[serde(skip_serializing_if = "Option::is_none")]
    wall_ms: Option<i64>,
    alarm: String,
    priority: Priority,
    state: AlarmState,
    /// The latest text of the alarm as a sentence; absent if the store no longer has it.
    text: Option<String>,
    /// The same with its values; absent for the text of an older build.
    #[serde(skip_serializing_if = "Option::is_none")]
    notice: Option<Notice>,
    #[serde(flatten)]
    open: Option<OpenAlarm>,
}

/// What an operator has to know of an open alarm beside its text.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct OpenAlarm {
    /// What follows without an action.
    consequence: &'static str,
    /// What to look at first.
    look_at: &'static str,
    /// The person who shelved it, until when, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    shelf: Option<Shelving>,
}

impl OpenAlarm {
    fn new(alarm: Alarm) -> Self {
        let kind = alarm.key.kind();
        Self { consequence: wording::consequence(kind), look_at: wording::look_at(kind), shelf: alarm.shelf }
    }

    fn line(&self) -> String {
        sentences::open_alarm(self.shelf.as_ref(), self.consequence, self.look_at)
    }
}

/// The course of an alarm, with its text as a sentence and with its values.
#[derive(Serialize)]
struct AlarmCourse<'a> {
    #[serde(flatten)]
    course: AlarmEpisode,
    /// Absent for the text of an older build.
    #[serde(skip_serializing_if = "Option::is_none")]
    notice: Option<&'a Notice>,
}

impl<'a> AlarmCourse<'a> {
    fn new(spell: &'a AlarmEpisode) -> Self {
        let text = spell.text.as_ref().map(|text| NoticeOrText::Text(holdpoint_wording::notice(text)));
        let notice = spell.text.as_ref().and_then(NoticeOrText::notice);
        Self { course: AlarmEpisode { text, ..spell.clone() }, notice }
    }
}

impl AlarmLine {
    fn new(
        (at_ms, wall_ms): (u64, Option<i64>),
        (alarm, priority, state): (String, Priority, AlarmState),
        text: Option<NoticeOrText>,
    ) -> Self {
        let notice = text.as_ref().and_then(NoticeOrText::notice).cloned();
        let text = text.as_ref().map(holdpoint_wording::notice);
        Self { at_ms, wall_ms, alarm, priority, state, text, notice, open: None }
    }

    fn line(&self) -> String {
        let time = match self.wall_ms {
            Some(wall_ms) => calendar::day_and_time(wall_ms - wall_ms.rem_euclid(1_000)),
            None => format!("{:>8} s", self.at_ms / 1000),
        };
        let line = format!("{time}  {} {}, {}", self.priority, self.alarm, self.state);
        match &self.text {
            Some(text) => format!("{line}: {text}"),
            None => line,
        }
    }
}

/// Prints the alarms.
///
/// # Errors
/// [`CliError`] if the store cannot be read.
pub(super) fn run(
    context: &CliContext,
    args: &AlarmsArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = data::open_checked(&context.data)?;
    let (first, from_ms) = beginning(&views, args.since.as_ref())?;
    if args.courses {
        return courses(views, context, (args, from_ms), out);
    }
    let alarms = views.alarms().map_err(CliError::usage)?;
    let stored = |name: &str| {
        let entry = alarms.iter().find(|entry| entry.alarm == name)?;
        serde_json::from_str::<Alarm>(&entry.json).ok()
    };
    let text_of = |name: &str| stored(name).map(|alarm| alarm.text);
    let changes = |from_seq: u64| {
        let kind = Some(RecordKind::AlarmChanged);
        let filter = AuditFilter { from_seq, kind, newest_first: true, ..AuditFilter::default() };
        views.audit(&filter).map_err(CliError::usage)
    };
    let wanted = |name: &str| args.alarm.as_ref().is_none_or(|alarm| alarm == name);
    let mut lines: Vec<AlarmLine> = if args.history {
        changes(first)?.iter().filter_map(|record| changed(record, &text_of)).collect()
    } else {
        let open =
            alarms.iter().filter(|entry| entry.state != AlarmState::Normal && entry.changed_ms >= from_ms);
        let newest: Vec<AlarmLine> =
            changes(0)?.iter().filter_map(|record| changed(record, &|_| None)).collect();
        open.map(|entry| {
            let at_ms = entry.changed_ms;
            let change = newest.iter().find(|change| change.alarm == entry.alarm && change.at_ms == at_ms);
            let times = (at_ms, change.and_then(|change| change.wall_ms));
            let shown = (entry.alarm.clone(), entry.priority, entry.state);
            AlarmLine {
                open: stored(&entry.alarm).map(OpenAlarm::new),
                ..AlarmLine::new(times, shown, text_of(&entry.alarm))
            }
        })
        .collect()
    };
    lines.retain(|line| wanted(&line.alarm));
    lines.truncate(usize::from(args.limit));
    for line in &lines {
        out.answer(line, |out| {
            out.line(&line.line())?;
            line.open.iter().try_for_each(|open| out.paragraph("  ", &open.line()))
        })?;
    }
    if lines.is_empty() && !out.is_json() {
        out.line(sentences::no_change(args.since.is_some(), args.history))?;
    }
    Ok(Exit::Confirmed)
}

/// The first record since the moment, and when it was written, virtual ms; the whole history without a moment.
fn beginning(views: &Views, since: Option<&TimeArg>) -> Result<(u64, u64), CliError> {
    let Some(since) = since else { return Ok((0, 0)) };
    let first = SinceArg::Time(since.clone()).first_record(views)?;
    let written = views.stamp(first).map_err(CliError::usage)?;
    Ok((first, written.map_or(u64::MAX, |written| written.at_ms)))
}

/// The course of each alarm that was open at `from_ms` or later, newest first.
fn courses(
    views: Views,
    context: &CliContext,
    (args, from_ms): (&AlarmsArgs, u64),
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let store = SqliteReader::new(Layout::new(&context.data));
    let reader = HealthReader::new(Box::new(views), store.telemetry().map_err(CliError::usage)?);
    let end = reader.end().map_err(CliError::usage)?;
    // Records are ordered by the engine's clock.
    let query = HealthQuery {
        clock: Some(HealthClock::Virtual),
        only_alarms: true,
        bucket_ms: BUCKET_MS_MAX,
        buckets: BUCKETS_MAX,
        ..HealthQuery::default()
    };
    let series = reader.read(&query, Some(end)).map_err(|error| match error {
        HealthError::Store(error) => CliError::usage(error),
        HealthError::InvalidQuery(text) => CliError::usage(text),
    })?;
    let wanted = |spell: &&AlarmEpisode| {
        args.alarm.as_ref().is_none_or(|alarm| *alarm == spell.alarm)
            && spell.ended.as_ref().is_none_or(|ended| ended.at_ms >= from_ms)
    };
    let mut count = 0;
    for spell in series.alarms.iter().filter(wanted).take(usize::from(args.limit)) {
        count += 1;
        out.answer(&AlarmCourse::new(spell), |out| {
            out.paragraph("", &format!("{} {}, {}", spell.priority, spell.alarm, spell.state))?;
            if let Some(text) = &spell.text {
                out.paragraph("  ", &holdpoint_wording::notice(text))?;
            }
            holdpoint_wording::health::alarm_course(spell, end.at_ms)
                .iter()
                .try_for_each(|text| out.paragraph("  ", text))
        })?;
    }
    if count == 0 && !out.is_json() {
        out.line(sentences::no_course(args.since.is_some()))?;
    }
    let sentences =
        if out.is_json() { Vec::new() } else { holdpoint_wording::health::omissions(&series.coverage) };
    sentences.iter().try_for_each(|text| out.paragraph("", text))?;
    Ok(Exit::Confirmed)
}

/// A change of an alarm, from its record in the chain.
fn changed(record: &AuditRecord, text_of: &dyn Fn(&str) -> Option<NoticeOrText>) -> Option<AlarmLine> {
    let body: serde_json::Value = serde_json::from_str(&record.body).ok()?;
    let field = |name: &str| body.get("change")?.get(name)?.as_str();
    let alarm = field("alarm")?.to_owned();
    let (priority, state) = (field("priority")?.parse().ok()?, field("state")?.parse().ok()?);
    let text = text_of(&alarm);
    let times = (record.at_ms, (record.wall_ms > 0).then_some(record.wall_ms));
    Some(AlarmLine::new(times, (alarm, priority, state), text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::alarms::AlarmKind;
    use holdpoint_governance::wall_time::WallTime;

    #[test]
    fn an_alarm_has_its_time_of_day_and_in_a_script_the_time_of_the_engine() {
        let line = |wall_ms| {
            let shown = ("violation:grasp@1.0.0".to_owned(), Priority::High, AlarmState::Unacknowledged);
            AlarmLine::new((123_456, wall_ms), shown, None).line()
        };
        let wall_ms = calendar::read("2026-11-27T18:12:29").unwrap() + 500;
        let rest = "high violation:grasp@1.0.0, unacknowledged";
        assert_eq!(line(Some(wall_ms)), format!("Fri 27 Nov 18:12:29  {rest}"));
        assert_eq!(line(None), format!("     123 s  {rest}"));
    }

    #[test]
    fn an_open_alarm_names_the_person_who_shelved_it_the_end_and_the_reason() {
        let until = WallTime::from_ms(calendar::read("2026-11-27T18:30:00").unwrap());
        let (by, reason) = ("ana".to_owned(), "a sensor is replaced".into());
        let kind = AlarmKind::Degraded;
        let shelf = Shelving { until, by, reason };
        let shelving = sentences::shelving(&shelf);
        let (consequence, look_at) = (wording::consequence(kind), wording::look_at(kind));
        let open = OpenAlarm { consequence, look_at, shelf: Some(shelf) };
        let line = open.line();
        assert!(line.starts_with(&shelving) && shelving.contains("ana"), "{line}");
        assert!(shelving.ends_with("a sensor is replaced") && line.contains(consequence), "{line}");
        assert_eq!(
            OpenAlarm { shelf: None, ..open }.line(),
            sentences::open_alarm(None, consequence, look_at)
        );
    }
}
