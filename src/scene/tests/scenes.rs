//! Recordings: written through the queue as the engine does, and read back.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]

#[path = "../../../tests/support/shift.rs"]
#[allow(dead_code, reason = "the console's screens use the rest")]
mod support;

use std::path::{Path, PathBuf};
use std::time::Duration;

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::submission::{Provenance, Risk};
use holdpoint_protocol::clock::tick_of;
use holdpoint_protocol::event::{Event, EventKind, TaskSummary};
use holdpoint_protocol::sink::{ClosedRecording, SinkReport};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::{BlockRole, Contact, SceneBlock, Twin, VideoFrame};
use holdpoint_recordings::recording::{Recording, Series};
use holdpoint_recordings::recording_folder::file_stem;
use holdpoint_scene::feed::Feed;
use holdpoint_scene::{ReadError, SceneConfig, SceneSink, read, until};
use holdpoint_text::Hint as _;
use support::{digest, id, snapshot};

const VERSION: &str = "place@1.1.0";
const PATIENCE: Duration = Duration::from_mins(1);
/// Half a step of the grid, and what is lost in adding.
const GRID_M: f32 = 3.2e-5;

/// The items of an upgrade of some sequences.
struct SceneScript {
    frames: Vec<VideoFrame>,
    events: Vec<Event>,
    at_ms: u64,
    seq: u64,
}

impl SceneScript {
    const fn new() -> Self {
        Self { frames: Vec::new(), events: Vec::new(), at_ms: 500_000, seq: 0 }
    }

    fn event(&mut self, feed: &Feed, kind: EventKind, shown: Option<Snapshot>) {
        self.seq += 1;
        let event = Event { seq: self.seq, at_ms: self.at_ms, kind };
        let shown = Snapshot { at_ms: self.at_ms, ..shown.unwrap_or_else(snapshot) };
        feed.events(std::slice::from_ref(&event), || shown);
        self.events.push(event);
    }

    /// A sequence of the live cell with its twin, thirty frames a second.
    fn sequence(&mut self, feed: &Feed, index: u64, secs: u64, success: bool, twin: bool) {
        for step in 0..secs * 30 {
            self.at_ms += 33 + u64::from(step % 3 == 0);
            let frame = video_frame(index, self.at_ms, step, twin);
            // A slow reader drops frames; the test waits for it.
            offer(feed, &frame);
            self.frames.push(frame);
        }
        let task = TaskSummary {
            version: id("place@1.0.0"),
            success,
            violation: false,
            past: None,
            anomaly: false,
            recovery: !success,
            retries: 0,
            time_secs: secs as f64,
            uncovered: false,
            failure: None,
        };
        let kind = EventKind::Sequence { index, success, tasks: vec![task], refused: None };
        let mut shown = snapshot();
        for view in &mut shown.candidates {
            if let Some(shadow) = &mut view.shadow {
                shadow.series.truncate(1 + usize::try_from(index % 14).unwrap());
                shadow.disagreements.clear();
            }
        }
        self.event(feed, kind, Some(shown));
    }
}

/// Hands a frame over and waits until it is taken.
fn offer(feed: &Feed, frame: &VideoFrame) {
    loop {
        let (dropped, _) = feed.dropped();
        feed.video_frame(frame.clone());
        if feed.dropped().0 == dropped {
            return;
        }
        std::thread::park_timeout(std::time::Duration::from_millis(1));
    }
}

fn video_frame(sequence: u64, at_ms: u64, step: u64, twin: bool) -> VideoFrame {
    let mut frame = support::video_frame();
    let phase = step as f32 / 40.0;
    frame.sequence = sequence;
    frame.at_ms = at_ms;
    frame.at_secs = step as f64 / 30.0;
    frame.speed_m_s = phase.sin().abs() * 0.4;
    let sway = |index: usize| (phase + index as f32 * 0.3).sin() * 0.05 * index as f32;
    for (index, link) in frame.body.links.iter_mut().enumerate() {
        link[1] += sway(index);
    }
    frame.body.object[2] += phase.cos().abs() * 0.1;
    frame.body.hand = [0.0, (phase / 2.0).sin(), 0.0, (phase / 2.0).cos()];
    if step.is_multiple_of(5) {
        frame.contacts = vec![Contact { at: frame.body.object, force_n: [0.5, -1.25, 4.0] }];
    }
    frame.blocks = vec![SceneBlock {
        role: BlockRole::Tray,
        at: [0.5, 0.2, 0.01 * sequence as f32],
        half_m: [0.1, 0.1, 0.005],
        turn: frame.body.object_turn,
    }];
    frame.twin = twin.then(|| {
        let mut body = frame.body.clone();
        body.links.iter_mut().for_each(|link| link[0] += 0.02);
        Twin { version: id(VERSION), body }
    });
    frame
}

fn config(folder: &Path) -> SceneConfig {
    SceneConfig { recordings: Some(folder.to_owned()), ..SceneConfig::default() }
}

fn registered() -> EventKind {
    EventKind::Registered {
        version: id(VERSION),
        digest: digest(VERSION),
        author: "ada".to_owned(),
        requester: holdpoint_governance::approval::Requester::Script,
        provenance: Provenance::Optimiser,
        risk: Risk::Medium,
        parent: Some("place@1.0.0".to_owned()),
        interface_changes: Vec::new(),
        notices: Vec::new(),
    }
}

/// A whole upgrade: some shadowed sequences, a decision, some monitored ones.
fn upgrade(
    folder: &Path,
    shadowed: u64,
    monitored: u64,
    fail: &[u64],
) -> (SceneScript, ClosedRecording, PathBuf) {
    let scenes = SceneSink::start(config(folder)).unwrap();
    let feed = scenes.feed();
    let mut script = SceneScript::new();
    script.event(&feed, registered(), None);
    script.event(
        &feed,
        EventKind::StageStarted { version: id(VERSION), stage: Stage::Shadow, budget: shadowed },
        None,
    );
    for index in 0..shadowed {
        script.sequence(&feed, index, 17, !fail.contains(&index), true);
    }
    let view = snapshot().candidates.into_iter().find(|view| view.version == id(VERSION)).unwrap();
    let decided = EventKind::Decided {
        version: id(VERSION),
        stage: Stage::Shadow,
        outcome: StageOutcome::Pass,
        dimensions: view.dimensions,
        composite: view.composite,
        reasons: view.reasons,
        conditions: Vec::new(),
        deployment: None,
    };
    script.event(&feed, decided, None);
    let activated = EventKind::Activated {
        version: id(VERSION),
        replaced: Some(id("place@1.0.0")),
        modes: Vec::new(),
        conditions: Vec::new(),
        provisional_episodes: 60,
    };
    script.event(&feed, activated, None);
    for index in shadowed..shadowed + monitored {
        script.sequence(&feed, index, 17, !fail.contains(&index), false);
    }
    let closed = EventKind::AuditClosed { version: id(VERSION), outcome: UpgradeEnd::Confirmed, records: 12 };
    script.event(&feed, closed, None);
    let reports = scenes.finish(PATIENCE);
    let [SinkReport::Closed(closed)] = reports.as_slice() else { panic!("{reports:?}") };
    let path = folder.join(&closed.file);
    (script, closed.clone(), path)
}

fn near(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= GRID_M)
}

fn same(read: &VideoFrame, wrote: &VideoFrame) {
    let exact = |frame: &VideoFrame| {
        (
            frame.sequence,
            frame.at_ms,
            frame.at_secs,
            frame.task,
            frame.version.clone(),
            (frame.speed_m_s, frame.force_n, frame.contact_n),
            frame.envelope,
            (frame.unexpected_contact, frame.stopped, frame.body.held),
            frame.twin.as_ref().map(|twin| twin.version.clone()),
        )
    };
    assert_eq!(exact(read), exact(wrote));
    let bodies = |frame: &VideoFrame| {
        let twin = frame.twin.as_ref().map(|twin| twin.body.clone());
        std::iter::once(frame.body.clone()).chain(twin).collect::<Vec<_>>()
    };
    for (read, wrote) in bodies(read).iter().zip(bodies(wrote)) {
        assert_eq!(read.links.len(), wrote.links.len());
        assert!(read.links.iter().zip(&wrote.links).all(|(read, wrote)| near(*read, *wrote)));
        assert!(near(read.pads[0], wrote.pads[0]) && near(read.pads[1], wrote.pads[1]));
        assert!(near(read.object, wrote.object));
        assert!(read.hand.iter().zip(wrote.hand).all(|(read, wrote)| (read - wrote).abs() <= GRID_M));
        assert_eq!(read.object_half_m, wrote.object_half_m);
    }
    assert_eq!(read.blocks, wrote.blocks, "a value is written once for the whole sequence");
    assert_eq!(read.contacts.len(), wrote.contacts.len());
    for (read, wrote) in read.contacts.iter().zip(&wrote.contacts) {
        assert!(near(read.at, wrote.at));
        assert_eq!(read.force_n, wrote.force_n);
    }
}

fn series<'a>(recording: &'a Recording, name: &str) -> &'a Series {
    let found = recording.series.iter().find(|series| series.name == name);
    found.unwrap_or_else(|| {
        panic!("no {name} in {:?}", recording.series.iter().map(|s| &s.name).collect::<Vec<_>>())
    })
}

#[test]
fn recording_round_trips_through_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let (script, closed, path) = upgrade(folder.path(), 2, 1, &[1]);
    assert_eq!(closed.file, format!("{}.rrd", file_stem(&id(VERSION), &digest(VERSION))));
    assert_eq!(closed.bytes, std::fs::metadata(&path).unwrap().len());
    let recording = read(&path).unwrap();
    assert_eq!(recording.about.version, id(VERSION));
    assert_eq!(recording.about.predecessor, Some(id("place@1.0.0")));
    assert_eq!(recording.scenery, snapshot().scenery);
    assert_eq!(recording.outcome, Some(UpgradeEnd::Confirmed.into()));
    assert_eq!(recording.events, script.events);
    assert_eq!(recording.pictures.len() as u64, closed.frames);
    for frame in &recording.pictures {
        let wrote = script.frames.iter().find(|wrote| wrote.at_ms == frame.at_ms).unwrap();
        same(frame, wrote);
    }
    // The failed sequence is there whole, the others are not.
    let of = |sequence| recording.pictures.iter().filter(|frame| frame.sequence == sequence).count();
    assert_eq!(of(1), 17 * 30);
    assert!((100..=200).contains(&of(0)), "{}", of(0));
    let speed = series(&recording, "tool/speed");
    assert_eq!(speed.points.len(), recording.pictures.len());
    assert!(speed.points.iter().zip(&recording.pictures).all(|((at_ms, value), frame)| {
        tick_of(*at_ms) == tick_of(frame.at_ms) && *value == f64::from(frame.speed_m_s)
    }));
    assert!(series(&recording, "tool/speed/limit").points.iter().all(|(_, limit)| *limit == 0.5));
    assert_eq!(series(&recording, "kappa/B").points[0].1, 0.931);
    assert!(!series(&recording, "shadow/output").points.is_empty());
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let digests = [0, 1].map(|_| {
        let folder = tempfile::tempdir().unwrap();
        upgrade(folder.path(), 1, 1, &[1]).1.digest
    });
    assert_eq!(digests[0], digests[1]);
}

#[test]
fn copy_until_a_tick_has_no_later_data() {
    let folder = tempfile::tempdir().unwrap();
    let (script, _, path) = upgrade(folder.path(), 1, 1, &[]);
    let middle_ms = script.frames[script.frames.len() / 2].at_ms;
    let out = folder.path().join("copy");
    until(&path, tick_of(middle_ms), &out).unwrap();
    let (whole, copy) = (read(&path).unwrap(), read(&out).unwrap());
    let before: Vec<&VideoFrame> =
        whole.pictures.iter().filter(|frame| tick_of(frame.at_ms) <= tick_of(middle_ms)).collect();
    assert!(!before.is_empty() && before.len() < whole.pictures.len());
    assert_eq!(copy.pictures.iter().collect::<Vec<_>>(), before);
    assert!(copy.events.iter().all(|event| event.at_ms <= middle_ms + 4));
    assert_eq!(copy.outcome, None);
}

#[test]
fn a_whole_upgrade_is_small() {
    let folder = tempfile::tempdir().unwrap();
    let (script, closed, _) = upgrade(folder.path(), 20, 60, &[3, 11, 25, 40, 55, 70]);
    let minutes = (script.at_ms - 500_000) as f64 / 60_000.0;
    let mebibytes = closed.bytes as f64 / f64::from(1 << 20);
    assert!(mebibytes < 2.0, "{mebibytes:.2} MiB, {} frames, {minutes:.1} min", closed.frames);
    assert!(closed.frames > 2_000);
}

#[test]
fn other_files_are_not_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.rrd");
    let missing = read(&path).unwrap_err();
    assert!(matches!(&missing, ReadError::File { path, .. } if path.contains("x.rrd")), "{missing}");
    assert!(missing.hint().is_some());
    std::fs::write(&path, b"not a recording at all, but long enough to look at").unwrap();
    let foreign = read(&path).unwrap_err();
    assert!(matches!(foreign, ReadError::Foreign { .. }), "{foreign}");
}

#[test]
fn viewer_is_served_and_the_server_ends_promptly() {
    let view = Some("127.0.0.1:0".parse().unwrap());
    let scenes = SceneSink::start(SceneConfig { view, ..SceneConfig::default() }).unwrap();
    let mut script = SceneScript::new();
    script.event(&scenes.feed(), registered(), None);
    script.sequence(&scenes.feed(), 0, 5, true, true);
    let reports = scenes.finish(PATIENCE);
    let [SinkReport::Serving { url }] = reports.as_slice() else { panic!("{reports:?}") };
    assert!(url.starts_with("rerun+http://127.0.0.1:") && url.ends_with("/proxy"), "{url}");
}
