//! The router with files that fail, tear and continue.

use std::fs::File;
use std::io;

use super::*;
use crate::frame_sampling::tests::video_frame;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::submission::{Provenance, Risk};

fn id(text: &str) -> CapabilityId {
    text.parse().unwrap()
}

fn event(seq: u64, at_ms: u64, kind: EventKind) -> Event {
    Event { seq, at_ms, kind }
}

fn registered(version: &str, parent: Option<&str>) -> EventKind {
    EventKind::Registered {
        version: id(version),
        digest: Digest::of_parts("test", &[version.as_bytes()]),
        author: "ada".to_owned(),
        requester: holdpoint_governance::approval::Requester::Script,
        provenance: Provenance::Optimiser,
        risk: Risk::Low,
        parent: parent.map(ToOwned::to_owned),
        interface_changes: Vec::new(),
        notices: Vec::new(),
    }
}

fn shadow(version: &str) -> EventKind {
    EventKind::StageStarted { version: id(version), stage: Stage::Shadow, budget: 20 }
}

fn closed(version: &str) -> EventKind {
    EventKind::AuditClosed { version: id(version), outcome: UpgradeEnd::Confirmed, records: 3 }
}

fn router(folder: &Path, open: Box<OpenFile>) -> Router {
    Router::new(folder.to_owned(), BTreeSet::new(), false, open)
}

fn plain() -> Box<OpenFile> {
    Box::new(|path| File::create(path))
}

/// An upgrade of a few seconds.
fn work(router: &mut Router, version: &str, flush: bool) {
    router.events(&[event(1, 0, registered(version, Some("grasp@1.0.0")))], None, (0, 0));
    router.events(&[event(2, 10, shadow(version))], None, (0, 0));
    for step in 1..200 {
        router.video_frame(video_frame(0, step * 33));
        if flush && step % 7 == 0 {
            router.flush();
        }
    }
}

#[test]
fn version_without_new_events_has_no_recording() {
    let folder = tempfile::tempdir().unwrap();
    let mut router = router(folder.path(), plain());
    router.events(&[event(1, 0, registered("grasp@1.0.0", None))], None, (0, 0));
    router.video_frame(video_frame(0, 33));
    router.end((0, 0));
    assert!(recordings(folder.path()).is_empty());
    assert!(router.reports().is_empty());
}

/// 16 versions in the queue took every place, and what was evaluated later had no recording.
#[test]
fn a_queued_version_opens_no_file_and_its_recording_begins_with_its_registration() {
    let folder = tempfile::tempdir().unwrap();
    let mut router = router(folder.path(), plain());
    for number in 1..=40 {
        let queued = registered(&format!("grasp@1.{number}.0"), Some("grasp@1.0.0"));
        router.events(&[event(number, 5, queued)], None, (0, 0));
    }
    assert!(recordings(folder.path()).is_empty());
    router.events(&[event(41, 10, shadow("grasp@1.40.0"))], None, (0, 0));
    router.events(&[event(42, 20, closed("grasp@1.40.0"))], None, (0, 0));
    let reports = router.reports();
    let [SinkReport::Closed(ended)] = reports.as_slice() else { panic!("{reports:?}") };
    let events = crate::read(&folder.path().join(&ended.file)).unwrap().events;
    let numbers: Vec<u64> = events.iter().map(|event| event.seq).collect();
    assert_eq!(numbers, [40, 41, 42]);
}

#[test]
fn a_full_disk_ends_one_recording_with_one_report() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: &Path| -> io::Result<File> {
        let full = path.to_string_lossy().contains("1.1.0");
        if full { File::options().write(true).open("/dev/full") } else { File::create(path) }
    };
    let mut router = router(folder.path(), Box::new(open));
    work(&mut router, "grasp@1.1.0", true);
    work(&mut router, "grasp@1.2.0", true);
    router.events(
        &[event(9, 9_000, closed("grasp@1.1.0")), event(10, 9_000, closed("grasp@1.2.0"))],
        None,
        (0, 0),
    );
    let reports = router.reports();
    let failed: Vec<&SinkReport> =
        reports.iter().filter(|report| matches!(report, SinkReport::Failed { .. })).collect();
    let [SinkReport::Failed { version: Some(version), text }] = failed.as_slice() else {
        panic!("{reports:?}")
    };
    assert_eq!(*version, id("grasp@1.1.0"));
    assert!(text.contains("Hint:"), "{text}");
    assert!(reports.iter().any(
        |report| matches!(report, SinkReport::Closed(closed) if closed.version == id("grasp@1.2.0") && closed.frames > 30)
    ));
}

#[test]
fn flush_interval_changes_no_byte_of_a_recording() {
    let digests: Vec<Digest> = [false, true]
        .into_iter()
        .map(|flush| {
            let folder = tempfile::tempdir().unwrap();
            let mut router = router(folder.path(), plain());
            work(&mut router, "grasp@1.1.0", flush);
            router.events(&[event(9, 9_000, closed("grasp@1.1.0"))], None, (0, 0));
            let reports = router.reports();
            let [SinkReport::Closed(closed)] = reports.as_slice() else { panic!("{reports:?}") };
            closed.digest
        })
        .collect();
    assert_eq!(digests.first(), digests.last());
}

#[test]
fn torn_recording_is_repaired_continued_and_joined() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = router(folder.path(), plain());
    work(&mut first, "grasp@1.1.0", true);
    first.flush();
    // As a kill leaves it: without an end, and torn in the last message.
    let (name, path) = recordings(folder.path()).pop().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    drop(first);
    std::fs::write(&path, &bytes[..bytes.len() - 37]).unwrap();
    let torn = crate::read(&path).unwrap();
    assert!(torn.pictures.len() > 20 && torn.outcome.is_none());

    let mut second = router(folder.path(), plain());
    second.recover();
    assert!(second.reports().is_empty());
    let mended = crate::read(&path).unwrap();
    assert_eq!(mended, torn);
    assert_eq!(compact::mend("x", &path, (0, 0)).unwrap(), FileAtStart::Open);
    let same = std::fs::read(&path).unwrap();

    second.events(&[event(1, 20_000, registered("grasp@1.1.0", None))], None, (0, 0));
    second.events(&[event(2, 20_010, shadow("grasp@1.1.0"))], None, (0, 0));
    second.video_frame(video_frame(5, 20_033));
    assert_eq!(std::fs::read(&path).unwrap(), same);
    assert_eq!(recordings(folder.path()).len(), 2);
    second.events(&[event(3, 21_000, closed("grasp@1.1.0"))], None, (4, 2));
    let reports = second.reports();
    let [SinkReport::Closed(closed)] = reports.as_slice() else { panic!("{reports:?}") };
    assert_eq!(closed.file, name);
    assert_eq!(recordings(folder.path()).len(), 1);
    let whole = crate::read(&path).unwrap();
    assert_eq!(whole.pictures.len(), torn.pictures.len() + 1);
    assert_eq!(whole.pictures.len() as u64, closed.frames);
    assert_eq!((whole.outcome, whole.dropped), (Some(UpgradeEnd::Confirmed.into()), (4, 2)));
}

#[test]
fn a_recorded_file_is_not_touched_and_another_is_reported_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = router(folder.path(), plain());
    work(&mut first, "grasp@1.1.0", false);
    first.events(&[event(9, 9_000, closed("grasp@1.1.0"))], None, (0, 0));
    let reports = first.reports();
    let [SinkReport::Closed(ended)] = reports.as_slice() else { panic!("{reports:?}") };
    let path = folder.path().join(&ended.file);
    let bytes = std::fs::read(&path).unwrap();

    let mut second = router(folder.path(), plain());
    second.recover();
    assert_eq!(second.reports(), reports);
    let on_record = BTreeSet::from([ended.file.clone()]);
    let mut third = Router::new(folder.path().to_owned(), on_record, false, plain());
    third.recover();
    assert!(third.reports().is_empty());
    work(&mut third, "grasp@1.1.0", false);
    third.events(&[event(9, 9_000, closed("grasp@1.1.0"))], None, (0, 0));
    let [SinkReport::Closed(again)] = &third.reports()[..] else { panic!() };
    assert_eq!(again.file, ended.file.replace(".rrd", ".2.rrd"));
    assert_eq!(std::fs::read(&path).unwrap(), bytes);
}

#[test]
fn a_segment_is_read_from_its_file_name() {
    for (name, wanted) in [
        ("grasp-1.0.2-0a1b2c3d.rrd", ("grasp-1.0.2-0a1b2c3d", 1)),
        ("grasp-1.0.2-0a1b2c3d.2.rrd", ("grasp-1.0.2-0a1b2c3d", 2)),
        ("grasp-1.0.2.rrd", ("grasp-1.0.2", 1)),
    ] {
        assert_eq!(segment_of(name), wanted);
    }
}
