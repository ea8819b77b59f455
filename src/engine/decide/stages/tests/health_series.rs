//! What an engine records is in the charts of health over time.

use holdpoint_explain::health_series::HealthReader;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::health::{HealthClock, HealthQuery, MarkContent, MarkKind};
use holdpoint_wording::health::mark;

use crate::quick_folder::quick_folder;
use crate::test_pipeline::resting_pipeline;

/// First versions and notes were not on record before the first upgrade; a note requires visible text.
#[test]
fn first_versions_and_notes_are_on_record() {
    let folder = quick_folder();
    let mut engine = resting_pipeline(folder.path(), ProfileName::Sim);
    let report = engine.live().sequence(None).unwrap();
    assert_eq!(report.planned, 3);
    let note = |text: &str| Command::Note { by: "ana".to_owned(), text: text.to_owned() };
    for blank in ["", " ", "\u{200b}"] {
        let reply = engine.command(note(blank));
        assert!(matches!(reply, Reply::Refused { code: Refusal::BadInput, .. }), "{blank:?}: {reply:?}");
    }
    crate::tests::assert_accepted(&engine.command(note("the tray is new")));
    let is_note = |event: &EventKind| matches!(event, EventKind::ShiftNote { by, text } if by == "ana" && text == "the tray is new");
    assert!(engine.drain_events().iter().any(is_note));
    let reader = engine.record().version_table().store().reader();
    let (clock, bucket_ms) = (Some(HealthClock::Virtual), 60_000);
    let query = HealthQuery { clock, bucket_ms, buckets: 10, ..HealthQuery::default() };
    let series = HealthReader::open(&*reader).unwrap().read(&query, None).unwrap();
    let tasks: u64 = series.points.iter().map(|point| point.tasks).sum();
    assert_eq!(tasks, report.tasks.len() as u64, "sealed with the note: {:?}", series.coverage);
    let notes: Vec<&str> = series
        .marks
        .iter()
        .filter(|mark| mark.kind == MarkKind::Note)
        .map(|mark| mark.text.as_str())
        .collect();
    let (by, text) = ("ana".to_owned(), "the tray is new".to_owned());
    assert_eq!(notes, [mark(&MarkContent::Note { by, text })]);
}
