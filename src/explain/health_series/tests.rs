//! A store with tasks, a promotion, a rollback and alarms in two sessions, counted again by hand.

use std::path::Path;

use super::*;
use holdpoint_body::TaskKind;
use holdpoint_governance::alarms::{AlarmBook, AlarmChange, AlarmEvent, AlarmKey, Priority, apply};
use holdpoint_governance::ids::Family;
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::health::{HealthClock, MarkContent, MarkKind, Trend};
use holdpoint_record::live_task_record::{LIVE, LiveTaskMarks, LiveTaskRecord};
use holdpoint_registry::{SqliteReader, Store};
use holdpoint_runtime::task::TaskRecord;
use holdpoint_store::{AuditBody, Batch, Change, OpenStore, Transaction};
use holdpoint_wording::health::mark;

#[path = "../../registry/tests/store/support.rs"]
#[allow(dead_code, clippy::duplicate_mod, reason = "the tests of the store use the rest")]
mod store;

/// Tue 17 Nov 2026, 08:00 UTC.
const TUESDAY_MS: i64 = 1_794_902_400_000;
const MINUTE_MS: u64 = 60_000;

/// A store that is written to at moments of two clocks.
struct Shift {
    store: Store,
    at_ms: u64,
    /// By how much the machine's clock is ahead of the engine's.
    ahead_ms: i64,
    commands: u32,
}

impl Shift {
    fn new(folder: &Path) -> Self {
        let store = Store::open(folder).unwrap();
        Self { store, at_ms: 0, ahead_ms: TUESDAY_MS, commands: 0 }
    }

    fn commit(&mut self, changes: Vec<Change>, audit: Vec<AuditBody>) {
        self.commands += 1;
        let command_id = format!("shift-{}-{}", self.at_ms, self.commands);
        let wall_ms = self.ahead_ms + i64::try_from(self.at_ms).unwrap();
        let at_ms = self.at_ms;
        self.store.commit_sealing(Transaction { command_id, at_ms, wall_ms, changes, audit }).unwrap();
    }

    fn note(&mut self, kind: RecordKind, subject: &str, body: &str) {
        self.commit(Vec::new(), vec![AuditBody { kind, subject: subject.to_owned(), body: body.to_owned() }]);
    }

    /// Adds tasks, one every ten seconds, of which every `fails`th fails (0: none).
    fn work(&mut self, version: &str, tasks: u64, fails: u64) {
        for nth in 1..=tasks {
            self.at_ms += 10_000;
            let success = fails == 0 || nth % fails != 0;
            self.task(version, success, LiveTaskMarks::default());
            if nth % 20 == 0 || nth == tasks {
                self.commit(Vec::new(), Vec::new());
            }
        }
    }

    fn task(&mut self, version: &str, success: bool, marks: LiveTaskMarks) {
        let record = TaskRecord {
            invalid: false,
            success,
            violation: !success,
            time_secs: if success { 4.0 } else { 7.0 },
            peak_force_n: 20.0,
            ..TaskRecord::invalid(TaskKind::Grasp, 1)
        };
        let body = serde_json::to_vec(&LiveTaskRecord { record: &record, marks }).unwrap();
        let version = version.parse().unwrap();
        let (from_ms, to_ms) = (self.at_ms - 4_000, self.at_ms);
        let batch = Batch { version, stream: LIVE.to_owned(), from_ms, to_ms, rows: 1, body };
        self.store.append_telemetry(&batch).unwrap();
    }

    fn alarm(&mut self, book: &mut AlarmBook, event: &AlarmEvent) {
        let wall = holdpoint_governance::wall_time::WallTime::SCRIPT_EPOCH.plus_ms(self.at_ms);
        let changes = apply(book, event, self.at_ms, wall).unwrap();
        let stored = changes.iter().filter_map(|change| match change {
            AlarmChange::Set { alarm, .. } => Some(Change::AlarmChange {
                alarm: alarm.key.to_string(),
                subject: "monitor".to_owned(),
                state: alarm.state(),
                priority: alarm.priority,
                json: serde_json::to_string(alarm).unwrap(),
            }),
            AlarmChange::Dropped { .. } | AlarmChange::Flood { .. } => None,
        });
        let audit = match event {
            AlarmEvent::Reset { key, by, reason } => {
                let body = serde_json::json!({ "alarm": key, "by": by, "reason": reason.raw() }).to_string();
                vec![AuditBody { kind: RecordKind::AlarmReset, subject: key.to_string(), body }]
            }
            _ => Vec::new(),
        };
        let stored = stored.collect();
        self.commit(stored, audit);
        book.absorb(&changes);
    }

    fn read(&self, query: &HealthQuery) -> HealthSeries {
        HealthReader::open(&*self.store.reader()).unwrap().read(query, None).unwrap()
    }
}

fn grasp() -> Family {
    Family::new("grasp").unwrap()
}

/// Two hours: the first version with its record only, the second well and then badly, a night, the second again.
fn shift(folder: &Path) -> Shift {
    let mut shift = Shift::new(folder);
    shift.at_ms = 1;
    shift.commit(store::bootstrapping("grasp"), Vec::new());
    shift.commit(store::shadowing("grasp@1.1.0"), Vec::new());
    shift.at_ms = 10 * MINUTE_MS;
    let row = |shift: &Shift, name: &str| {
        let found = shift.store.views().unwrap().version(&name.parse().unwrap()).unwrap();
        found.unwrap().summary.row_version
    };
    let old = row(&shift, "grasp@1.0.0");
    shift.commit(store::activation("grasp@1.1.0", ("grasp@1.0.0", old), 0), Vec::new());
    // 240 tasks in 40 minutes, and as many of which every third fails.
    shift.work("grasp@1.1.0", 240, 0);
    shift.note(RecordKind::Drift, "", r#"{"kind":"camera_bias","magnitude":"severe"}"#);
    shift.work("grasp@1.1.0", 240, 3);
    shift
}

#[test]
fn tasks_count_in_their_bucket_and_give_the_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let shift = shift(folder.path());
    let query = HealthQuery { bucket_ms: 10 * MINUTE_MS, buckets: 12, ..HealthQuery::default() };
    let series = shift.read(&query);
    assert_eq!((series.clock, series.coverage.is_sample()), (HealthClock::Wall, false));
    assert_eq!(series.coverage.tasks, 480, "{:?}", series.coverage);
    assert_eq!(series.until_ms() % 600_000, 0, "buckets begin at whole multiples");
    let bucket = series.bucket_of(TUESDAY_MS + 50 * 60_000).unwrap();
    let verdict = series.verdict(&grasp(), bucket);
    // A task that ends as a bucket begins is that bucket's.
    assert_eq!((verdict.before.tasks, verdict.before.succeeded), (239, 239));
    assert_eq!((verdict.since.tasks, verdict.since.succeeded), (241, 161));
    assert_eq!(verdict.trend(), Trend::Worse);
    assert_eq!(verdict.moment, "Tue 17 Nov 08:50");
    let family = grasp();
    let full = series.at(&family, bucket + 1).next().unwrap();
    assert_eq!((full.tasks, full.violated), (60, 20));
    assert_eq!(full.time_s, [4.0, 7.0]);
    assert_eq!((series.unsealed.len(), verdict.unsealed), (0, 0));
    // The same by the engine's own clock.
    let by_engine = shift.read(&HealthQuery { clock: Some(HealthClock::Virtual), ..query });
    assert_eq!(by_engine.coverage.tasks, 480);
    assert_eq!(by_engine.time_text(by_engine.start_ms(by_engine.bucket_of(0).unwrap())), "00:00:00");
}

#[test]
fn marks_name_events_and_engine_downtime() {
    let folder = tempfile::tempdir().unwrap();
    let mut shift = shift(folder.path());
    // A night: the machine's clock advances alone.
    shift.ahead_ms += 10 * 3_600_000;
    shift.work("grasp@1.1.0", 20, 0);
    shift.note(RecordKind::CellStopped, "", r#"{"by":"ana","reason":"a \u001b[31mleak"}"#);
    let query = HealthQuery { bucket_ms: 30 * MINUTE_MS, buckets: 40, ..HealthQuery::default() };
    let series = shift.read(&query);
    let kinds: Vec<MarkKind> = series.marks.iter().map(|mark| mark.kind).collect();
    assert_eq!(
        kinds,
        [
            MarkKind::Context,
            MarkKind::FirstVersion,
            MarkKind::Promotion,
            MarkKind::Drift,
            MarkKind::EngineOff,
            MarkKind::Stopped
        ],
        "{:#?}",
        series.marks
    );
    let took_over = MarkContent::TookOver { version: "grasp@1.1.0".parse().unwrap() };
    assert_eq!(series.marks[2].text, mark(&took_over));
    assert_eq!(series.marks[4].text, mark(&MarkContent::NoEngine { ms: 10 * 3_600_000 }));
    assert_eq!(series.coverage.tasks, 500);
    // The tasks of the morning lie in the morning.
    let last = series.points.last().unwrap();
    assert!(series.start_ms(last.bucket) >= TUESDAY_MS + 10 * 3_600_000);
    // By the engine's clock there was no night.
    let by_engine = shift.read(&HealthQuery { clock: Some(HealthClock::Virtual), ..query });
    assert_eq!(by_engine.coverage.tasks, 500);
    let svg = svg(&series, &grasp(), &["a note".to_owned()]);
    assert!(svg.contains(&mark(&took_over)) && !svg.contains('\u{1b}'), "{svg}");
    let csv = csv(&series);
    let columns = csv.lines().next().unwrap().split(',').count();
    for line in csv.lines().filter(|line| !line.contains('"')) {
        assert_eq!(line.split(',').count(), columns, "{line}");
    }
    let mark = csv.lines().find(|line| line.starts_with("mark,")).unwrap();
    assert_eq!(mark.split(',').count(), columns, "{mark}");
    assert!(!csv.contains('\u{1b}'));
}

#[test]
fn altered_telemetry_counts_nowhere_and_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut shift = shift(folder.path());
    shift.task("grasp@1.1.0", true, LiveTaskMarks { cut_short: true, ..LiveTaskMarks::default() });
    shift.commit(Vec::new(), Vec::new());
    let layout = shift.store.layout().clone();
    drop(shift);
    let telemetry = rusqlite::Connection::open(layout.telemetry()).unwrap();
    let edit = "UPDATE batch SET body = cast(replace(body, '\"success\":false', '\"success\":true ') AS BLOB)
        WHERE id > 240";
    telemetry.execute(edit, []).unwrap();
    telemetry.execute("DELETE FROM batch WHERE id <= 20", []).unwrap();
    drop(telemetry);
    let query = HealthQuery { bucket_ms: 10 * MINUTE_MS, buckets: 24, ..HealthQuery::default() };
    let series = HealthReader::open(&SqliteReader::new(layout)).unwrap().read(&query, None).unwrap();
    let coverage = series.coverage;
    assert_eq!((coverage.damaged, coverage.removed, coverage.not_judged), (80, 20, 1), "{coverage:?}");
    assert_eq!(coverage.tasks, 480 - 80 - 20);
    assert_eq!(holdpoint_wording::health::omissions(&coverage).len(), 3);
}

#[test]
fn tasks_that_no_record_seals_yet_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let mut shift = shift(folder.path());
    for _ in 0..7 {
        shift.at_ms += 10_000;
        shift.task("grasp@1.1.0", false, LiveTaskMarks::default());
    }
    let query = HealthQuery { bucket_ms: 10 * MINUTE_MS, buckets: 12, ..HealthQuery::default() };
    let series = shift.read(&query);
    assert_eq!((series.coverage.tasks, series.unsealed.get(&grasp())), (480, Some(&7)));
    assert_eq!(series.verdict(&grasp(), 0).unsealed, 7);
    let before = HealthQuery { until_ms: Some(TUESDAY_MS + 60 * 60_000), ..query };
    assert!(shift.read(&before).unsealed.is_empty(), "a span that ends earlier has none of them");
    shift.commit(Vec::new(), Vec::new());
    let series = shift.read(&query);
    assert_eq!((series.coverage.tasks, series.unsealed.len()), (487, 0));
}

#[test]
fn a_long_span_is_sampled_and_a_short_one_is_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut shift = shift(folder.path());
    shift.work("grasp@1.1.0", 2_000, 10);
    let reader = HealthReader::open(&*shift.store.reader()).unwrap();
    let query = HealthQuery { bucket_ms: 60 * MINUTE_MS, buckets: 12, ..HealthQuery::default() };
    let whole = reader.read(&query, None).unwrap();
    assert_eq!((whole.coverage.tasks, whole.coverage.is_sample()), (2_480, false));
    let sample = reader.read_bounded(&query, None, 500).unwrap();
    assert!(
        sample.coverage.is_sample() && (500..1_000).contains(&sample.coverage.tasks),
        "{:?}",
        sample.coverage
    );
    let buckets = |series: &HealthSeries| series.points.iter().map(|point| point.bucket).collect::<Vec<_>>();
    // Without the last block, which is in a later pass.
    assert!(
        buckets(&sample).len() + 1 >= buckets(&whole).len(),
        "spread over all of it: {:?}",
        buckets(&sample)
    );
    let last = HealthQuery { bucket_ms: MINUTE_MS, buckets: 20, ..query };
    let zoomed = reader.read_bounded(&last, None, 500).unwrap();
    assert!(!zoomed.coverage.is_sample() && zoomed.coverage.tasks > 100, "{:?}", zoomed.coverage);
}

#[test]
fn an_alarm_history_has_persons_acts_and_duration() {
    let folder = tempfile::tempdir().unwrap();
    let mut shift = shift(folder.path());
    let mut book = AlarmBook::new();
    let key = AlarmKey::Degraded("grasp@1.1.0".parse().unwrap());
    let event = |text: &str| AlarmEvent::Raise {
        key: key.clone(),
        priority: Priority::High,
        latching: true,
        text: NoticeOrText::Text(text.to_owned()),
    };
    let raised_ms = shift.at_ms;
    shift.alarm(&mut book, &event("works worse"));
    shift.at_ms += MINUTE_MS;
    shift.alarm(&mut book, &AlarmEvent::Acknowledge { key: key.clone(), by: "ana".to_owned() });
    shift.at_ms += MINUTE_MS;
    let until = holdpoint_governance::wall_time::WallTime::SCRIPT_EPOCH.plus_ms(shift.at_ms + MINUTE_MS);
    let shelve = AlarmEvent::Shelve {
        key: key.clone(),
        by: "bo".to_owned(),
        until,
        reason: "the mount is on its way".into(),
    };
    shift.alarm(&mut book, &shelve);
    shift.at_ms += 2 * MINUTE_MS;
    shift.alarm(&mut book, &AlarmEvent::Tick);
    shift.alarm(&mut book, &AlarmEvent::Clear { key: key.clone() });
    shift.at_ms += MINUTE_MS;
    let reset = AlarmEvent::Reset { key: key.clone(), by: "ana".to_owned(), reason: "a new mount".into() };
    shift.alarm(&mut book, &reset);
    let ended_ms = shift.at_ms;
    shift.at_ms += MINUTE_MS;
    shift.alarm(&mut book, &event("again"));
    let query = HealthQuery { bucket_ms: 60 * MINUTE_MS, buckets: 24, ..HealthQuery::default() };
    let series = shift.read(&HealthQuery { only_alarms: true, ..query });
    assert!(series.points.is_empty() && series.marks.is_empty());
    let [newest, first] = series.alarms.as_slice() else { panic!("{:#?}", series.alarms) };
    let again = NoticeOrText::Text("again".to_owned());
    assert_eq!((newest.text.as_ref(), newest.ended.is_none()), (Some(&again), true));
    assert_eq!((first.alarm.as_str(), first.raised.at_ms), ("degraded:grasp@1.1.0", raised_ms));
    assert_eq!(first.acknowledged.as_ref().unwrap().by.as_deref(), Some("ana"));
    let shelved = first.shelved.as_ref().unwrap();
    assert_eq!((shelved.by.as_deref(), shelved.at_ms), (Some("bo"), raised_ms + 2 * MINUTE_MS));
    assert_eq!(first.over.as_ref().unwrap().at_ms, raised_ms + 4 * MINUTE_MS);
    assert_eq!(first.reset.as_ref().unwrap().reason.as_deref(), Some("a new mount"));
    assert_eq!((first.active_ms(u64::MAX), first.began_before), (ended_ms - raised_ms, false));
    let marks = shift.read(&query).marks;
    let of = |kind| marks.iter().filter(|mark| mark.kind == kind).count();
    assert_eq!((of(MarkKind::DriftAlarm), of(MarkKind::AlarmReset)), (2, 1));
}

#[test]
fn an_empty_record_and_a_bad_question_are_answered_plainly() {
    let folder = tempfile::tempdir().unwrap();
    let mut shift = Shift::new(folder.path());
    shift.at_ms = 1;
    shift.commit(store::bootstrapping("grasp"), Vec::new());
    let query = HealthQuery { bucket_ms: MINUTE_MS, buckets: 1, ..HealthQuery::default() };
    let series = shift.read(&query);
    assert!(series.points.is_empty() && series.families().is_empty());
    assert_eq!(series.verdict(&grasp(), 0).trend(), Trend::NoData);
    assert!(svg(&series, &grasp(), &[]).contains(holdpoint_wording::program::health::EMPTY_PANEL));
    let reader = HealthReader::open(&*shift.store.reader()).unwrap();
    for (bucket_ms, buckets) in
        [(0, 1), (MINUTE_MS - 1, 1), (86_400_001, 1), (MINUTE_MS, 0), (MINUTE_MS, 481)]
    {
        let query = HealthQuery { bucket_ms, buckets, ..HealthQuery::default() };
        assert!(matches!(reader.read(&query, None), Err(HealthError::InvalidQuery(_))), "{query:?}");
    }
    for until_ms in [i64::MIN, -1, 0, i64::MAX] {
        let query = HealthQuery { until_ms: Some(until_ms), ..query };
        assert!(reader.read(&query, None).unwrap().points.is_empty(), "{until_ms}");
    }
}
