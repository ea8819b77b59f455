//! Stopping the cell: in the tick of the request, at any time, until a person starts it again.
//!
//! `HOLDPOINT_STOPS=50` measures: it prints the median and worst ticks from the request to the standstill.

use holdpoint_governance::notice::Notice;
use std::path::Path;
use std::process::{Command as Process, Output};
use std::time::{Duration, Instant};

use holdpoint::body::RATE_HZ;
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::{Caller, Command, Refusal, Reply, StopPersistence};
use holdpoint::protocol::event::EventKind;
use holdpoint::registry::Views;
use holdpoint::runtime::capability;
use holdpoint::service::control_socket::{Client, IDLE_MAX, OBSERVERS_MAX, socket_path};
use holdpoint::store::{AuditFilter, Layout};

use crate::host::{Front, PATIENCE, operation, refusal};
use crate::quick_folder::quick_folder;
use crate::reported_error::assert_error;

/// Braking takes a quarter of a second at most, and the measurement of the standstill a twentieth.
pub(crate) const STANDSTILL_TICKS_MAX: u64 = (RATE_HZ / 4 + RATE_HZ / 20) as u64;

fn stop() -> Command {
    Command::Stop { by: "ana".to_owned(), reason: "a person is in the cell".to_owned() }
}

fn go_command(since_ms: u64, stops: u64) -> Command {
    Command::Go { by: "ana".to_owned(), reason: "the cell is empty".to_owned(), since_ms, stops }
}

pub(crate) fn assert_accepted(reply: &Reply) {
    let done =
        matches!(reply, Reply::Accepted { .. } | Reply::Stopped { kept: StopPersistence::OnRecord, .. });
    assert!(done, "{reply:?}");
}

impl Front {
    fn submit(&mut self, candidate: &str) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("manifests/candidates").join(candidate);
        let package = capability::read(&path).unwrap();
        assert_accepted(&self.carry_out(Command::Register { package, name: candidate.to_owned(), by: None }));
    }

    /// The ticks from the request to the standstill, for the latest stop.
    fn ticks_to_standstill(&mut self) -> u64 {
        self.events.clear();
        assert_accepted(&self.carry_out(stop()));
        let event = self.until(|kind| matches!(kind, EventKind::ArmStands { .. }));
        let EventKind::ArmStands { ticks } = event.kind else { unreachable!() };
        ticks
    }

    /// Starts the cell with full knowledge of its stops.
    pub(crate) fn go(&mut self) -> Reply {
        let stopped = self.snapshot().stopped;
        let (since_ms, stops) = stopped.map_or((0, 0), |stopped| (stopped.since_ms, stopped.stops));
        self.carry_out(go_command(since_ms, stops))
    }

    /// Runs the live cell for a moment, so that the arm is on its way.
    fn run_live_cell(&mut self, duration: Duration) {
        // Part of a sequence, another one each time.
        let at_secs = 0.3 + 10.0 * duration.as_secs_f64();
        self.video_frame(|frame| !frame.stopped && frame.task.is_some() && frame.at_secs >= at_secs);
    }

    /// Stops and starts this many times, and on until a stop met a moving arm; returns the sorted ticks to the
    /// standstill.
    fn measure_stops(&mut self, times: u64, needs_moving_arm: bool) -> Vec<u64> {
        let mut ticks = Vec::new();
        let until = Instant::now() + PATIENCE;
        for index in 0.. {
            // On a busy machine the camera frame arrives late, and a sequence may be over by then.
            let met = !needs_moving_arm || ticks.iter().any(|ticks| *ticks > 0);
            if index >= times && (met || Instant::now() >= until) {
                break;
            }
            self.run_live_cell(Duration::from_millis(7 * (1 + index % 11)));
            ticks.push(self.ticks_to_standstill());
            assert_accepted(&self.go());
        }
        ticks.sort_unstable();
        ticks
    }
}

#[test]
fn the_arm_stops_at_every_stage() {
    let times = std::env::var("HOLDPOINT_STOPS").ok().and_then(|text| text.parse().ok()).unwrap_or(2);
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    let mut measured = vec![("idle", front.measure_stops(times, true))];
    front.submit("align-improved");
    front.until(|kind| matches!(kind, EventKind::StageStarted { stage, .. } if stage.name() == "sandbox"));
    measured.push(("in sandbox", front.measure_stops(times, true)));
    assert_accepted(&front.carry_out(Command::Pause(operation("align@1.1.0"))));
    measured.push(("held", front.measure_stops(times, false)));
    assert_accepted(&front.carry_out(Command::Resume(operation("align@1.1.0"))));
    front.until(|kind| matches!(kind, EventKind::StageStarted { stage, .. } if stage.name() == "shadow"));
    measured.push(("in shadow", front.measure_stops(times, true)));
    front.until(|kind| matches!(kind, EventKind::Activated { .. }));
    measured.push(("provisional", front.measure_stops(times, true)));
    for (state, ticks) in &measured {
        let (median, worst) = (ticks[ticks.len() / 2], ticks[ticks.len() - 1]);
        println!("{state}: median {median}, worst {worst} of {} ticks to the standstill", ticks.len());
        assert!(worst <= STANDSTILL_TICKS_MAX, "{state}: {ticks:?}");
        assert!(*state == "held" || ticks.iter().any(|ticks| *ticks > 0), "{state}: the arm never moved");
    }
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn nothing_runs_until_a_person_starts_the_cell_again() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    front.run_live_cell(Duration::from_millis(20));
    assert!(front.ticks_to_standstill() <= STANDSTILL_TICKS_MAX);
    let stopped = front.snapshot().stopped.unwrap();
    assert_eq!((stopped.by.as_str(), stopped.reason.as_str()), ("ana", "a person is in the cell"));
    assert!(
        matches!(stopped.caller, Caller::Process { process: Some(own), .. } if own == std::process::id()),
        "{stopped:?}"
    );
    // A second stop may have another reason: it is recorded, too, once, and triggers no second stop.
    front.events.clear();
    assert_accepted(
        &front.carry_out(Command::Stop { by: "bo".to_owned(), reason: "there is a second one".to_owned() }),
    );
    front.until(|kind| matches!(kind, EventKind::CellStopped { by, .. } if by == "bo"));
    let stop_authors = |front: &mut Front| {
        let stopped = front.snapshot().stopped.unwrap();
        let again =
            stopped.again.iter().map(|stop| (stop.by.clone(), stop.reason.clone())).collect::<Vec<_>>();
        (stopped.by, again)
    };
    let both = ("ana".to_owned(), vec![("bo".to_owned(), "there is a second one".to_owned())]);
    assert_eq!(stop_authors(&mut front), both);
    let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
    let stops = Views::open(&Layout::new(folder.path()).database()).unwrap().audit(&stops).unwrap();
    assert_eq!(stops.len(), 2, "{stops:?}");
    let sequences = front.snapshot().live.sequences;
    front.host.stop(PATIENCE).unwrap();

    let mut front = Front::start(folder.path(), None);
    assert_eq!(stop_authors(&mut front), both, "and so they are after a restart");
    front.submit("grasp-tool-frame");
    // Each answer comes between two slices, of which there are none.
    let snapshot = (0..50).map(|_| front.snapshot()).last().unwrap();
    assert_eq!(
        (snapshot.live.sequences, snapshot.candidates[0].state.name()),
        (0, "registered"),
        "after {sequences}"
    );
    let since = front.snapshot().stopped.unwrap().since_ms;
    let blank = Command::Go { by: "ana".to_owned(), reason: " ".to_owned(), since_ms: since, stops: 2 };
    assert_eq!(refusal(&front.carry_out(blank)), Refusal::BadInput);
    // A person who knows of one stop cannot release the second.
    for (since, known) in [(since, 0), (since, 1), (since, 3), (since + 1, 2), (0, 2)] {
        assert_eq!(refusal(&front.carry_out(go_command(since, known))), Refusal::NotNow);
    }
    assert_accepted(&front.carry_out(go_command(since, 2)));
    front.until(|kind| matches!(kind, EventKind::Sequence { .. }));
    assert_eq!(front.snapshot().stopped, None);
    assert_eq!(refusal(&front.go()), Refusal::NotNow);
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn a_version_can_be_rolled_back_at_standstill() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    front.run_live_cell(Duration::from_millis(20));
    front.ticks_to_standstill();
    let reply = front.carry_out(Command::Vacate(operation("grasp@1.0.0")));
    assert_accepted(&reply);
    // The baseline has no rollback target: the family is safe-stopped, and the arm does not move on the way.
    let event = front.until(|kind| matches!(kind, EventKind::Rung { rung, .. } if rung.name() == "retract"));
    let EventKind::Rung { text, ms, .. } = event.kind else { unreachable!() };
    assert!(ms == 0 && matches!(text.notice(), Some(Notice::RetreatSkipped { .. })), "{text:?}");
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn a_halted_engine_stops_as_well() {
    let output = Process::new(std::env::current_exe().unwrap())
        .args(["--exact", "stop::inside_a_hold", "--nocapture"])
        .env("HOLDPOINT_TEST_PANIC", "engine")
        .output()
        .unwrap();
    let stdout = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && stdout.contains("1 passed"), "{stdout}");
}

/// Run by the test above, with the panic armed.
#[test]
fn inside_a_hold() {
    if !cfg!(debug_assertions) || std::env::var_os("HOLDPOINT_TEST_PANIC").is_none() {
        return;
    }
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), Some(1.0));
    front.run_live_cell(Duration::from_millis(20));
    front.submit("align-improved");
    front.until(|kind| matches!(kind, EventKind::Fault { .. }));
    // The sequence of the failed engine is still running at the pace of the clock; on a busy machine it has ended
    // by now, and the arm is at standstill already.
    let ticks = front.ticks_to_standstill();
    println!("holding: {ticks} ticks to the standstill");
    assert!(ticks <= STANDSTILL_TICKS_MAX, "{ticks}");
    assert_eq!(front.snapshot().stopped.map(|stopped| stopped.by), Some("ana".to_owned()));
    assert_eq!(refusal(&front.go()), Refusal::Holding);
    front.host.stop(PATIENCE).unwrap();
}

fn holdpoint(data: &Path, arguments: &[&str]) -> Output {
    Process::new(env!("CARGO_BIN_EXE_holdpoint")).arg("--data").arg(data).args(arguments).output().unwrap()
}

fn output_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// The last mark was made after its stop was on record: it was never removed, and the cell could not be started.
#[test]
fn simultaneous_stops_leave_no_stale_stop_mark() {
    let folder = quick_folder();
    let data = folder.path().join("store");
    let mut front = Front::start(&data, None);
    for _ in 0..3 {
        front.run_live_cell(Duration::from_millis(20));
        let stops: Vec<_> = (0..8)
            .map(|number| {
                let data = data.clone();
                std::thread::spawn(move || holdpoint(&data, &["stop", "--as", &format!("person-{number}")]))
            })
            .collect();
        for thread in stops {
            let output = thread.join().unwrap();
            assert_eq!(output.status.code(), Some(0), "{}", output_text(&output));
        }
        let stopped = front.snapshot().stopped.unwrap();
        assert_eq!(stopped.stops, 8, "{stopped:?}");
        assert_accepted(&front.go());
        assert!(!Layout::new(&data).stop_request().exists());
    }
    front.host.stop(PATIENCE).unwrap();
}

/// With a mistyped folder it once created a store, stopped that cell, and reported success.
#[test]
fn a_stop_without_an_engine_is_not_confirmed() {
    let folder = quick_folder();
    let missing = folder.path().join("mistyped");
    let error = assert_error(&holdpoint(&missing, &["stop", "--as", "ana", "--json"]), 6, "no-answer");
    for part in ["emergency stop", "--data DIR"] {
        assert!(error["hint"].as_str().unwrap().contains(part), "{part:?}: {error}");
    }
    assert!(!missing.exists(), "no store is made");
    let data = folder.path().join("store");
    let front = Front::start(&data, None);
    front.host.stop(PATIENCE).unwrap();
    let error = assert_error(&holdpoint(&data, &["stop", "--as", "ana", "--json"]), 6, "no-answer");
    // The code is the same without a store: the sentence tells whether the stop is stored.
    assert!(error["error"].as_str().unwrap().contains("starts stopped"), "{error}");
    let mut front = Front::start(&data, None);
    assert_eq!(front.snapshot().stopped.map(|stopped| stopped.by), Some("ana".to_owned()));
    front.host.stop(PATIENCE).unwrap();
}

#[test]
fn the_verbs_stop_and_start_with_and_without_an_engine() {
    let folder = quick_folder();
    let data = folder.path().join("store");
    assert_eq!(
        holdpoint(&data, &["identity", "new", "ana", "--role", "operator", "--unprotected"]).status.code(),
        Some(0)
    );
    let output = holdpoint(&data, &["stop"]);
    assert_eq!(output.status.code(), Some(6), "{}", output_text(&output));
    assert!(output_text(&holdpoint(&data, &["status"])).contains("unnamed person"));
    // A start needs an identity.
    let unknown = holdpoint(&data, &["go", "--as", "ben", "--reason", "checked", "--json"]);
    assert_error(&unknown, 2, "not-found");
    let arguments = ["go", "--as", "ana", "--reason", "checked"];
    let with_stops = [&arguments[..], &["--stops", "1"]].concat();
    // Another person stopped it, and the operator has not confirmed reading who and why.
    let output = holdpoint(&data, &arguments);
    assert_eq!(output.status.code(), Some(3), "{}", output_text(&output));
    assert!(
        output_text(&output).contains("unnamed person") && output_text(&output).contains("--stops 1"),
        "{}",
        output_text(&output)
    );
    assert!(output_text(&holdpoint(&data, &["status"])).contains("STOPPED"));
    assert_eq!(holdpoint(&data, &with_stops).status.code(), Some(0));
    assert!(!output_text(&holdpoint(&data, &["status"])).contains("STOPPED"));
    // The operator knows their own stop.
    assert_eq!(holdpoint(&data, &["stop", "--as", "ana"]).status.code(), Some(6));
    assert_eq!(holdpoint(&data, &arguments).status.code(), Some(0));
    // It is not stopped.
    assert_error(&holdpoint(&data, &[&arguments[..], &["--json"]].concat()), 3, "not-now");

    let mut front = Front::start(&data, None);
    front.run_live_cell(Duration::from_millis(20));
    let output = holdpoint(&data, &["stop", "--as", "bo"]);
    assert_eq!(output.status.code(), Some(0), "{}", output_text(&output));
    let stop_view = front.snapshot().stopped.unwrap();
    let own = rustix::process::geteuid().as_raw();
    let Caller::Process { uid, process, .. } = stop_view.caller else { panic!("{stop_view:?}") };
    assert_eq!((stop_view.by.as_str(), uid), ("bo", own));
    assert_ne!(process, Some(std::process::id()), "the system names the process");
    // A second unknown stop keeps the cell stopped, and its author is printed.
    assert_eq!(holdpoint(&data, &["stop", "--as", "cy", "--reason", "smoke"]).status.code(), Some(0));
    let output = holdpoint(&data, &arguments);
    assert_eq!(output.status.code(), Some(3), "{}", output_text(&output));
    assert!(
        output_text(&output).contains("as \"bo\"") && output_text(&output).contains(": \"smoke\""),
        "{}",
        output_text(&output)
    );
    assert!(front.snapshot().stopped.is_some());
    front.events.clear();
    assert_eq!(holdpoint(&data, &[&arguments[..], &["--stops", "2"]].concat()).status.code(), Some(0));
    let released = front.until(|kind| matches!(kind, EventKind::CellReleased { .. }));
    let EventKind::CellReleased { caller: Caller::Process { uid, process, .. }, .. } = released.kind else {
        panic!("{released:?}")
    };
    assert_eq!(uid, own);
    assert_ne!(process, Some(std::process::id()), "the caller is not the engine");
    let filter = AuditFilter { kind: Some(RecordKind::Asked), ..AuditFilter::default() };
    let records = Views::open(&Layout::new(&data).database()).unwrap().audit(&filter).unwrap();
    let found =
        records.iter().filter(|record| record.body.contains(&format!("\"process\":{}", process.unwrap())));
    assert_eq!(found.count(), 1, "the request is on record with its process: {records:?}");
    front.host.stop(PATIENCE).unwrap();
}

/// Silent connections and the most subscribers do not keep an operator from stopping the cell or a version.
#[test]
fn idle_connections_lock_no_client_out() {
    let folder = quick_folder();
    let mut front = Front::start(folder.path(), None);
    let layout = Layout::new(folder.path());
    let connect = || Client::connect(&layout).unwrap().unwrap();
    let subscriptions: Vec<_> = (0..OBSERVERS_MAX).map(|_| connect().subscribe().unwrap()).collect();
    let idle: Vec<_> = (0..2 * IDLE_MAX)
        .map(|_| std::os::unix::net::UnixStream::connect(socket_path(&layout)).unwrap())
        .collect();
    assert_accepted(&connect().send(stop()).unwrap());
    assert_eq!(front.snapshot().stopped.map(|stopped| stopped.by), Some("ana".to_owned()));
    let rolled_back = connect().send(Command::Rollback(operation("grasp@1.0.0"))).unwrap();
    assert_eq!(refusal(&rolled_back), Refusal::NotNow, "it is the last one: {rolled_back:?}");
    assert!(
        format!("{rolled_back:?}").contains("last version"),
        "the engine itself answered: {rolled_back:?}"
    );
    drop((subscriptions, idle));
    front.host.stop(PATIENCE).unwrap();
}
