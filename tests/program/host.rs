//! The engine on a thread of its own: it answers, runs the live cell, stops in flight, ends, and survives a panic.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use holdpoint::body::TaskKind;
use holdpoint::body::disturbance::{DriftKind, Magnitude};
use holdpoint::governance::alarms::AlarmState;
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::{Command, Operation, Refusal, Reply, Request};
use holdpoint::protocol::event::{Event, EventKind};
use holdpoint::protocol::snapshot::Snapshot;
use holdpoint::protocol::video_frame::VideoFrame;
use holdpoint::registry::Store;
use holdpoint::runtime::capability;
use holdpoint::scenes::SceneOptions;
use holdpoint::service::engine_handle::{EngineHandle, EngineUpdate, LaunchConfig, OUTSTANDING_MAX};
use holdpoint_sim::SimCells;
use tokio::runtime::Runtime;
use tokio::time::timeout;

use crate::quick_folder::quick_folder;

/// A generous time limit.
pub(crate) const PATIENCE: Duration = Duration::from_mins(2);

/// A front end without a screen.
pub(crate) struct Front {
    pub(crate) host: EngineHandle,
    runtime: Runtime,
    pub(crate) events: Vec<Event>,
    answers: Vec<(String, Reply)>,
    request_count: u64,
}

impl Front {
    pub(crate) fn start(folder: &Path, pace: Option<f64>) -> Self {
        Self::start_at(LaunchConfig {
            data: folder.to_owned(),
            profile: ProfileName::Sim.into(),
            seeds: holdpoint_trials::seeds::EpisodeSeeds::OfRun(1),
            jobs: 1,
            cells: std::sync::Arc::new(SimCells),
            robot: None,
            site: None,
            pace,
            sinks: SceneOptions::default().sinks().unwrap(),
            alone_max: None,
            console_access: None,
        })
    }

    pub(crate) fn start_at(config: LaunchConfig) -> Self {
        let host = EngineHandle::start(config);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let mut front = Self { host, runtime, events: Vec::new(), answers: Vec::new(), request_count: 0 };
        assert!(matches!(front.next(), EngineUpdate::Started));
        front
    }

    fn next(&mut self) -> EngineUpdate {
        let next = async { timeout(PATIENCE, self.host.updates.recv()).await };
        let update = self.runtime.block_on(next).expect("in time").expect("an update");
        match &update {
            EngineUpdate::Events(events) => self.events.extend(events.iter().cloned()),
            EngineUpdate::Answer { id, reply } => self.answers.push((id.clone(), reply.clone())),
            EngineUpdate::Started
            | EngineUpdate::Past { .. }
            | EngineUpdate::Lagged { .. }
            | EngineUpdate::Returned(_) => {}
            EngineUpdate::Ended(result) => panic!("the engine ended: {result:?}"),
        }
        update
    }

    fn send(&mut self, command: Command) -> String {
        self.request_count += 1;
        let id = format!("test-{}", self.request_count);
        self.host.submit(Request::unsigned(id.clone(), command)).unwrap();
        id
    }

    fn answer(&mut self, id: &str) -> Reply {
        loop {
            if let Some((_, reply)) = self.answers.iter().find(|(known, _)| known == id) {
                return reply.clone();
            }
            self.next();
        }
    }

    pub(crate) fn carry_out(&mut self, command: Command) -> Reply {
        let id = self.send(command);
        self.answer(&id)
    }

    /// The first event of the kind, received already or still to come.
    pub(crate) fn until(&mut self, predicate: impl Fn(&EventKind) -> bool) -> Event {
        loop {
            if let Some(found) = self.events.iter().find(|event| predicate(&event.kind)) {
                return found.clone();
            }
            self.next();
        }
    }

    pub(crate) fn snapshot(&mut self) -> Snapshot {
        match self.carry_out(Command::Snapshot) {
            Reply::Snapshot { snapshot } => *snapshot,
            other => panic!("{other:?}"),
        }
    }

    pub(crate) fn video_frame(&mut self, predicate: impl Fn(&VideoFrame) -> bool) -> Arc<VideoFrame> {
        let frames = &mut self.host.frames;
        let matches_frame = |frame: &Option<Arc<VideoFrame>>| frame.as_deref().is_some_and(&predicate);
        let next_frame = async {
            let seen = timeout(PATIENCE, frames.wait_for(matches_frame));
            seen.await.expect("in time").expect("a camera frame").clone()
        };
        self.runtime.block_on(next_frame).unwrap()
    }
}

pub(crate) fn operation(version: &str) -> Operation {
    Operation {
        version: version.parse().unwrap(),
        by: "ada".to_owned(),
        reason: "it does not look right".to_owned(),
    }
}

pub(crate) fn refusal(reply: &Reply) -> Refusal {
    match reply {
        Reply::Refused { code, .. } => *code,
        other => panic!("not refused: {other:?}"),
    }
}

#[test]
fn it_starts_answers_runs_sequences_and_ends() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    let sequence = front.until(|kind| matches!(kind, EventKind::Sequence { .. }));
    assert!(matches!(sequence.kind, EventKind::Sequence { index: 0, .. }));
    let frame = front.video_frame(|_| true);
    assert!(frame.body.links.len() > 2, "{frame:?}");
    let snapshot = front.snapshot();
    assert!(snapshot.live.sequences >= 1);
    assert_eq!(snapshot.live.pace, None);
    assert!(snapshot.scenery.workspace.is_some());
    assert!(snapshot.thresholds.iter().all(|limit| *limit > 0.0), "{:?}", snapshot.thresholds);
    let published = front.host.snapshots.borrow().clone().expect("a snapshot is published");
    assert!(published.live.sequences >= 1);
    let detail = front.carry_out(Command::Detail { version: "grasp@1.0.0".parse().unwrap() });
    assert!(matches!(detail, Reply::Detail { .. }), "{detail:?}");
    let too_fast = front.carry_out(Command::Pace { times: Some(1_000.0) });
    assert_eq!(refusal(&too_fast), Refusal::BadInput);
    assert!(front.host.identities().starts_with(folder.path()));
    front.host.stop(PATIENCE).unwrap();
    // Its store is free again.
    drop(Store::open(folder.path()).unwrap());
}

#[test]
fn an_abort_stops_the_arm_in_flight() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(1.0));
    front.video_frame(|frame| frame.task == Some(TaskKind::Grasp) && frame.speed_m_s > 0.02);
    let start = Instant::now();
    let reply = front.carry_out(Command::Vacate(operation("grasp@1.0.0")));
    let took = start.elapsed();
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    // The aim is half a second on a machine that is not shared; a whole sequence takes more than ten.
    assert!(took < Duration::from_secs(5), "{took:?}");
    let rollback = front.until(|kind| matches!(kind, EventKind::RolledBack { .. }));
    let EventKind::RolledBack { record, .. } = rollback.kind else { unreachable!() };
    assert!(record.in_flight, "{record:?}");
    assert!(record.time_to_safe_ms.is_some_and(|ms| ms < 1_000), "{record:?}");
    let sequence = front.until(|kind| matches!(kind, EventKind::Sequence { .. }));
    assert!(
        matches!(&sequence.kind, EventKind::Sequence { success: false, refused: Some(why), .. } if why.contains("stopped")),
        "{sequence:?}"
    );
    let snapshot = front.snapshot();
    let grasp = snapshot.families.iter().find(|family| family.family.as_str() == "grasp").unwrap();
    assert!(grasp.safe_stopped && grasp.active.is_none());
    // The next sequence is refused for lack of a grasp, which is a failure, and may have been by now.
    let stopped = |refused: &Option<String>| refused.as_ref().is_some_and(|why| why.contains("was stopped"));
    let others = front
        .events
        .iter()
        .filter(|event| matches!(&event.kind, EventKind::Sequence { refused, .. } if !stopped(refused)));
    assert_eq!(snapshot.live.outcomes.len(), others.count(), "a stopped sequence is neither done nor failed");
    // An alarm whose condition persists cannot be reset.
    let alarm = "safe-stopped:grasp".to_owned();
    let by = "ada".to_owned();
    let reset = Command::ResetAlarm { alarm, by, reason: "looked at it".to_owned() };
    assert_eq!(refusal(&front.carry_out(reset)), Refusal::NotNow);
    front.host.stop(PATIENCE).unwrap();
}

/// 512 rejected versions once filled the alarms, and the engine halted.
#[test]
fn one_person_registers_as_many_versions_in_a_minute_as_the_profile_permits() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(1.0));
    let most = Profile::builtin(ProfileName::Sim).unwrap().evaluation.registrations_per_minute_max;
    let submitted = capability::read(Path::new("manifests/candidates/grasp-tool-frame")).unwrap();
    let mut register = |number: u32| {
        let mut package = submitted.clone();
        let version = format!("version = \"7.0.{number}\"");
        package.manifest = package.manifest.replacen("version = \"1.2.0\"", &version, 1);
        front.carry_out(Command::Register { package, name: "grasp-tool-frame".to_owned(), by: None })
    };
    for number in 0..most {
        let reply = register(number);
        assert!(matches!(reply, Reply::Accepted { .. }), "{number}: {reply:?}");
    }
    assert_eq!(refusal(&register(most)), Refusal::NotNow);
    assert!(front.snapshot().holding.is_none());
    let stop = Command::Stop { by: "ana".to_owned(), reason: String::new() };
    assert!(matches!(front.carry_out(stop), Reply::Stopped { .. }));
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn only_a_drift_waits_for_the_end_of_a_sequence() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(4.0));
    front.video_frame(|frame| frame.task.is_some());
    let drift =
        front.send(Command::Drift { kind: Some(DriftKind::SensorNoise), magnitude: Some(Magnitude::Mild) });
    let audit = front.send(Command::Audit {
        before: None,
        subject: String::new(),
        without: std::collections::BTreeSet::new(),
        limit: 3,
    });
    let Reply::Audit { page } = front.answer(&audit) else { panic!("no page") };
    assert_eq!(page.rows.len(), 3);
    assert!(page.rows.windows(2).all(|rows| rows[0].seq > rows[1].seq));
    assert!(front.answers.iter().all(|(id, _)| *id != drift), "the drift waits for the end of the sequence");
    let fast = front.carry_out(Command::Pace { times: Some(50.0) });
    assert!(matches!(fast, Reply::Accepted { .. }), "{fast:?}");
    // The cell's actions in an hour follow from its pace: they are on record before their requester.
    let without = RecordKind::ALL.into_iter().filter(|kind| *kind != RecordKind::PaceSet).collect();
    let paces = Command::Audit { before: None, subject: String::new(), without, limit: 10 };
    let Reply::Audit { page } = front.carry_out(paces) else { panic!("no page") };
    let bodies: Vec<&str> = page.rows.iter().map(|row| row.body.as_str()).collect();
    assert_eq!(bodies, [r#"{"times":50.0}"#]);
    assert!(matches!(front.answer(&drift), Reply::Accepted { .. }));
    let order: Vec<&EventKind> = front
        .events
        .iter()
        .map(|event| &event.kind)
        .filter(|kind| matches!(kind, EventKind::Sequence { .. } | EventKind::Drift { .. }))
        .collect();
    assert!(
        matches!(order.as_slice(), [EventKind::Sequence { .. }, EventKind::Drift { .. }, ..]),
        "{order:?}"
    );
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn a_lost_front_end_ends_the_engine() {
    let folder = quick_folder();
    let front = Front::start(folder.path(), Some(1.0));
    drop(front);
    let until = Instant::now() + PATIENCE;
    while Store::open(folder.path()).is_err() {
        assert!(Instant::now() < until, "the engine still has its store");
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

#[test]
fn requests_are_bounded() {
    let folder = quick_folder();
    let front = Front::start(folder.path(), Some(1.0));
    // The answers are not read, so no more requests are accepted than fit.
    let accepted_count = (0..4 * OUTSTANDING_MAX)
        .filter(|number| {
            let id = format!("flood-{number}");
            front.host.submit(Request::unsigned(id, Command::VerifyAudit)).is_ok()
        })
        .count();
    assert!((OUTSTANDING_MAX..4 * OUTSTANDING_MAX).contains(&accepted_count), "{accepted_count}");
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn a_panic_halts_only_the_pipeline() {
    let output = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "host::inside_a_panic", "--nocapture"])
        .env("HOLDPOINT_TEST_PANIC", "engine")
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{stdout}{}", String::from_utf8_lossy(&output.stderr));
    assert!(stdout.contains("1 passed"), "{stdout}");
}

/// Run by the test above, with the panic armed; by itself it only registers.
#[test]
fn inside_a_panic() {
    let armed = cfg!(debug_assertions) && std::env::var_os("HOLDPOINT_TEST_PANIC").is_some();
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(1.0));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates/align-improved");
    let package = capability::read(&path).unwrap();
    let reply = front.carry_out(Command::Register { package, name: "align-improved".to_owned(), by: None });
    assert!(matches!(reply, Reply::Accepted { .. }), "{reply:?}");
    if armed {
        front.until(|kind| matches!(kind, EventKind::Fault { .. }));
        let snapshot = front.snapshot();
        assert!(snapshot.holding.as_deref().is_some_and(|why| why.contains("on purpose")), "{snapshot:?}");
        let alarm = snapshot.alarms.iter().find(|alarm| alarm.alarm == "engine-fault").unwrap();
        assert!(alarm.latching);
        assert_eq!(alarm.state, AlarmState::Unacknowledged);
        let pause = front.carry_out(Command::Pause(operation("align@1.1.0")));
        assert_eq!(refusal(&pause), Refusal::Holding);
        let acknowledge =
            Command::AcknowledgeAlarm { alarm: "engine-fault".to_owned(), by: "ada".to_owned() };
        assert!(
            matches!(front.carry_out(acknowledge), Reply::Accepted { .. }),
            "a halted engine acknowledges"
        );
    } else {
        front.until(|kind| matches!(kind, EventKind::StageStarted { .. }));
    }
    front.host.stop(PATIENCE).unwrap();
}
