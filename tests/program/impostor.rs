//! A program of the same account that repeatedly takes the name of the engine's socket and answers in its place;
//! only the store's lock stays with the engine. Stops do not depend on it, and no answer of it counts as the
//! engine's.
//!
//! `HOLDPOINT_IMPOSTOR_STOPS` is the number of stops under attack (3); if set, each must stop the arm within a
//! second. `HOLDPOINT_CONFIRMED_STOPS` is the number without attack (20).

mod signing;

use std::fs::{self, Permissions};
use std::io::{BufRead, BufReader, Write};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, symlink};
use std::os::unix::net::{UnixListener, UnixStream};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::{Command, Reply};
use holdpoint::protocol::wire::PROTOCOL;
use holdpoint::registry::{Views, verify};
use holdpoint::service::control_socket::{
    AnswerOrigin, Client, StopCall, StopOutcome, UnverifiedOrigin, socket_path,
};
use holdpoint::store::{AuditFilter, Layout, LockHolder, lock_holder};
use serde_json::{Value, json};

use crate::{host::PATIENCE, quick_folder::quick_folder, reported_error::assert_error};

/// The interval at which the impostor takes the name again.
const TAKES_EVERY: Duration = Duration::from_millis(2);

/// The impostor's answer to every request.
const LIE: &str = "all is well, says the impostor";

fn count(name: &str, otherwise: usize) -> usize {
    std::env::var(name).map_or(otherwise, |text| text.parse().unwrap())
}

/// Waits for a condition without an event.
fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let until = Instant::now() + PATIENCE;
    while !holds() {
        assert!(Instant::now() < until, "{what}");
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

/// An engine in another process, and its output.
struct GenuineEngine {
    child: Child,
    events: Receiver<(Instant, Value)>,
    data: PathBuf,
}

impl GenuineEngine {
    fn start(data: &Path) -> Self {
        Self::start_at("1", data)
    }

    /// At a pace of the live cell: only a measurement needs the clock's, `1`, in which a sequence takes eight seconds.
    fn start_at(pace: &str, data: &Path) -> Self {
        let mut serve = Process::new(env!("CARGO_BIN_EXE_holdpoint"));
        serve.args(["serve", "--json", "--pace", pace, "--no-recording", "--data"]).arg(data);
        Self::of(serve, data)
    }

    fn of(mut serve: Process, data: &Path) -> Self {
        let mut child = serve.stdout(Stdio::piped()).spawn().unwrap();
        let (sender, events) = channel();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let event = (Instant::now(), serde_json::from_str(&line).unwrap());
                drop(sender.send(event));
            }
        });
        let engine = Self { child, events, data: data.to_owned() };
        until("the engine does not start", || engine.is_up());
        engine
    }

    fn is_up(&self) -> bool {
        let Ok(Some(mut client)) = Client::connect(&self.layout()) else { return false };
        let shown = client.send(Command::Snapshot);
        client.unverified_origin().is_none()
            && matches!(shown, Ok(Reply::Snapshot { snapshot }) if snapshot.reading.is_none())
    }

    fn layout(&self) -> Layout {
        Layout::new(&self.data)
    }

    fn verb(&self, arguments: &[&str]) -> Output {
        Process::new(env!("CARGO_BIN_EXE_holdpoint"))
            .args(arguments)
            .arg("--data")
            .arg(&self.data)
            .output()
            .unwrap()
    }

    /// The time of the engine's next event of this kind.
    fn await_event(&self, kind: &str) -> Instant {
        loop {
            let (at, event) = self.events.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no {kind}"));
            if event["event"] == kind {
                return at;
            }
        }
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Process::new("kill").args([name, &pid]).status().unwrap().success());
    }

    /// Starts the cell, over the engine's own socket, wherever that is by now.
    fn start_cell(socket: &Path) {
        let until = Instant::now() + PATIENCE;
        loop {
            let answer = send_request(socket, &json!({ "command": "snapshot" }));
            let stopped = &answer["reply"]["snapshot"]["stopped"];
            let since = stopped["since_ms"].as_u64().unwrap_or(0);
            let known = stopped["stops"].as_u64().unwrap_or(0);
            let reply = send_request(
                socket,
                &json!({ "command": "go", "by": "ana", "reason": "checked", "since_ms": since, "stops": known }),
            );
            if reply["reply"]["reply"] == "accepted" {
                return;
            }
            assert!(Instant::now() < until, "{reply}");
        }
    }

    fn stops_on_record(&self) -> usize {
        let stops =
            AuditFilter { kind: Some(RecordKind::CellStopped), limit: 5000, ..AuditFilter::default() };
        Views::open(&self.layout().database()).unwrap().audit(&stops).unwrap().len()
    }

    fn end(mut self) {
        self.signal("-TERM");
        assert_eq!(self.child.wait().unwrap().code(), Some(0));
        verify(&self.layout().database(), None).unwrap();
    }
}

impl Drop for GenuineEngine {
    fn drop(&mut self) {
        // An ended process has been waited for, and this then does nothing.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// Sends a raw request; a missing answer is null.
fn send_request(socket: &Path, command: &Value) -> Value {
    let Ok(mut stream) = UnixStream::connect(socket) else { return Value::Null };
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut id = [0; 8];
    fs::File::open("/dev/urandom")
        .and_then(|mut file| std::io::Read::read_exact(&mut file, &mut id))
        .unwrap();
    let request = json!({ "id": format!("by-hand-{}", u64::from_ne_bytes(id)), "command": command });
    let call = json!({ "call": "ask", "request": request });
    drop(stream.write_all(format!("{call}\n").as_bytes()));
    let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
    let _hello = lines.next();
    lines.next().map_or(Value::Null, |line| serde_json::from_str(&line).unwrap())
}

/// See the module comment. It lives in this process, which is not the engine's.
struct Impostor {
    /// Ends the thread.
    end: Option<Sender<()>>,
    /// Whether it answers nothing any more.
    over: Arc<AtomicBool>,
    takeovers: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
    /// The current path of the engine's own socket.
    real: PathBuf,
}

impl Impostor {
    fn start(layout: &Layout) -> Self {
        let (over, takeovers) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let (end, end_signal) = channel::<()>();
        let path = socket_path(layout);
        let (real, own) = (layout.folder().join(".x"), layout.folder().join(".y"));
        let (thread_over, thread_takeovers, real_path) =
            (Arc::clone(&over), Arc::clone(&takeovers), real.clone());
        let work = move || {
            let mut own_inode = None;
            while end_signal.recv_timeout(TAKES_EVERY) == Err(RecvTimeoutError::Timeout) {
                let inode = fs::symlink_metadata(&path).ok().map(|found| found.ino());
                if inode.is_some() && inode != own_inode {
                    drop(fs::rename(&path, &real_path));
                    drop(fs::remove_file(&own));
                    let listener = UnixListener::bind(&own).unwrap();
                    fs::set_permissions(&own, Permissions::from_mode(0o600)).unwrap();
                    own_inode = fs::symlink_metadata(&own).ok().map(|found| found.ino());
                    fs::rename(&own, &path).unwrap();
                    thread_takeovers.fetch_add(1, Ordering::AcqRel);
                    let over = Arc::clone(&thread_over);
                    std::thread::spawn(move || {
                        for stream in listener.incoming().map_while(Result::ok) {
                            if over.load(Ordering::Acquire) {
                                return;
                            }
                            std::thread::spawn(move || lie(stream));
                        }
                    });
                }
            }
        };
        let impostor = Self { end: Some(end), over, takeovers, thread: Some(std::thread::spawn(work)), real };
        until("there is no name to take", || impostor.takeovers() > 0);
        impostor
    }

    fn takeovers(&self) -> usize {
        self.takeovers.load(Ordering::Acquire)
    }
}

impl Drop for Impostor {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Release);
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// Speaks the engine's protocol and accepts every request.
fn lie(stream: UnixStream) -> Option<()> {
    let hello =
        json!({ "answer": "hello", "protocol": PROTOCOL, "version": "0.1.0", "process": std::process::id() });
    let mut writer = stream.try_clone().ok()?;
    writeln!(writer, "{hello}").ok()?;
    let reply = json!({ "reply": "accepted", "text": LIE, "version": null });
    for _line in BufReader::new(stream).lines().map_while(Result::ok) {
        writeln!(writer, "{}", json!({ "answer": "reply", "reply": reply })).ok()?;
    }
    None
}

fn output_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn a_stop_stops_the_arm_while_an_impostor_has_the_name() {
    let stops = count("HOLDPOINT_IMPOSTOR_STOPS", 3);
    let measured = std::env::var_os("HOLDPOINT_IMPOSTOR_STOPS").is_some();
    let folder = quick_folder();
    let engine = GenuineEngine::start_at(if measured { "1" } else { "10" }, folder.path());
    let impostor = Impostor::start(&engine.layout());
    let mut worst = Duration::ZERO;
    for nth in 1..=stops {
        engine.await_event("sequence");
        let begun = Instant::now();
        let output = engine.verb(&["stop", "--reason", "a hand is in the cell"]);
        assert_eq!(output.status.code(), Some(0), "{nth}: {}", output_text(&output));
        assert!(!output_text(&output).contains(LIE), "{nth}: {}", output_text(&output));
        let standstill = engine.await_event("arm-stands") - begun;
        worst = worst.max(standstill);
        assert!(!measured || standstill < Duration::from_secs(1), "{nth}: {standstill:?}");
        GenuineEngine::start_cell(&impostor.real);
        engine.await_event("cell-released");
    }
    println!("impostor: {stops} of {stops} stops confirmed, verb to standing arm at worst {worst:?}");
    assert_eq!(engine.stops_on_record(), stops);
    drop(impostor);
    engine.end();
}

#[test]
fn no_answer_of_an_impostor_counts_as_the_engines() {
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let impostor = Impostor::start(&engine.layout());
    let engine_pid = i32::try_from(engine.child.id()).unwrap();
    assert_eq!(lock_holder(folder.path()), LockHolder::Process(engine_pid));
    let client = Client::connect(&engine.layout()).unwrap().unwrap();
    let own_pid = i32::try_from(std::process::id()).unwrap();
    let origin = AnswerOrigin::Other { answers: own_pid, holds: Some(engine_pid) };
    assert_eq!(client.unverified_origin(), origin.unverified());
    // A verb that changes authority reports it and ends with its own exit code, whatever the answer.
    let arguments = ["demote", "grasp@1.0.0", "--as", "ana", "--reason", "it drops parts"];
    for json in [&[][..], &["--json"]] {
        let output = engine.verb(&[&arguments[..], json].concat());
        assert_eq!(output.status.code(), Some(6), "{}", output_text(&output));
        if !json.is_empty() {
            assert_error(&output, 6, &format!("not-confirmed/{}", UnverifiedOrigin::CODE));
            let reply: Value = serde_json::from_slice(&output.stdout).unwrap();
            assert_eq!((&reply["text"], &reply["unverified"]), (&json!(LIE), &json!(UnverifiedOrigin::CODE)));
        }
    }
    // So does one that only reads.
    let status = engine.verb(&["status", "--json"]);
    assert!(output_text(&status).contains(UnverifiedOrigin::CODE), "{}", output_text(&status));
    drop(impostor);
    engine.end();
}

/// A program that took the name and removed the mark at the same moment once defeated the stop.
#[test]
fn a_stop_stops_the_arm_while_its_mark_is_removed_as_fast_as_it_is_made() {
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let impostor = Impostor::start(&engine.layout());
    let (over, removals) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
    let (thread_over, thread_removals, mark) =
        (Arc::clone(&over), Arc::clone(&removals), engine.layout().stop_request());
    let remover = std::thread::spawn(move || {
        while !thread_over.load(Ordering::Acquire) {
            if fs::remove_file(&mark).is_ok() {
                thread_removals.fetch_add(1, Ordering::AcqRel);
            }
        }
    });
    for _ in 0..count("HOLDPOINT_IMPOSTOR_STOPS", 3) {
        let start = Instant::now();
        let output = engine.verb(&["stop", "--json"]);
        let stopped_at = engine.await_event("cell-stopped");
        engine.await_event("arm-stands");
        println!("{} ms, exit code {:?}", stopped_at.duration_since(start).as_millis(), output.status.code());
        // Confirmed by the kernel, or not reported.
        match output.status.code() {
            Some(0) => {
                let reply: Value = serde_json::from_slice(&output.stdout).unwrap();
                assert_eq!(reply["kept"], "in-mark", "{reply}");
            }
            code => assert_eq!(code, Some(6), "{}", output_text(&output)),
        }
        GenuineEngine::start_cell(&impostor.real);
        engine.await_event("cell-released");
    }
    over.store(true, Ordering::Release);
    remover.join().unwrap();
    assert!(removals.load(Ordering::Acquire) > 0);
    drop(impostor);
    engine.end();
}

#[test]
fn unconfirmed_stop_is_reported_and_carried_out_later() {
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let impostor = Impostor::start(&engine.layout());
    engine.signal("-STOP");
    for json in [&[][..], &["--json"]] {
        let output = engine.verb(&[&["stop"][..], json].concat());
        let text = output_text(&output);
        assert_eq!(output.status.code(), Some(6), "{text}");
        assert!(text.contains("NOT CONFIRMED") && text.contains("emergency stop"), "{text}");
        assert!(!text.contains("is stopped;") && !text.contains(LIE), "{text}");
        if !json.is_empty() {
            assert_error(&output, 6, "not-confirmed");
        }
    }
    // The mark is there: the engine continues and stops because of it.
    engine.signal("-CONT");
    engine.await_event("cell-stopped");
    // So does the one that waited behind it: who starts the cell has to know of both.
    until("a stop is lost", || engine.stops_on_record() == 2);
    until("the mark stays", || !engine.layout().stop_request().exists());
    drop(impostor);
    engine.end();
}

/// Without attack the engine itself confirms every stop, which counts once.
#[test]
fn every_stop_is_confirmed_and_counts_once() {
    let stops = count("HOLDPOINT_CONFIRMED_STOPS", 20);
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let mut times = Vec::new();
    for nth in 0..stops {
        let call = StopCall::new("ana".to_owned(), format!("the {nth}th")).unwrap();
        let begun = Instant::now();
        let outcome = call.send(&engine.layout());
        times.push(begun.elapsed());
        assert!(matches!(&outcome, StopOutcome::Answered(Reply::Stopped { .. })), "{nth}: {outcome:?}");
        if nth % 10 == 9 {
            GenuineEngine::start_cell(&socket_path(&engine.layout()));
        }
    }
    times.sort_unstable();
    let at = |part: usize| times[(times.len() * part / 100).min(times.len() - 1)];
    println!("{stops} of {stops} stops confirmed, p50 {:?}, p99 {:?}, worst {:?}", at(50), at(99), at(100));
    assert_eq!(engine.stops_on_record(), stops);
    assert!(!engine.layout().stop_request().exists());
    engine.end();
}

/// The cost of a verified answer: connections that read the snapshot.
#[test]
fn a_verified_answer_is_quick() {
    let reads = count("HOLDPOINT_VERIFIED_ANSWERS", 50);
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let mut times: Vec<Duration> = (0..reads)
        .map(|_| {
            let begun = Instant::now();
            let mut client = Client::connect(&engine.layout()).unwrap().unwrap();
            assert_eq!(client.unverified_origin(), None);
            assert!(matches!(client.send(Command::Snapshot).unwrap(), Reply::Snapshot { .. }));
            begun.elapsed()
        })
        .collect();
    times.sort_unstable();
    println!("{reads} verified answers: p50 {:?}, p99 {:?}", times[reads / 2], times[reads * 99 / 100]);
    let mut lookup_times: Vec<Duration> = (0..reads)
        .map(|_| {
            let begun = Instant::now();
            assert!(matches!(lock_holder(folder.path()), LockHolder::Process(_)));
            begun.elapsed()
        })
        .collect();
    lookup_times.sort_unstable();
    println!(
        "of these, to find the holder of the store: p50 {:?}, p99 {:?}",
        lookup_times[reads / 2],
        lookup_times[reads * 99 / 100]
    );
    engine.end();
}

/// Each time the name is taken there is an alarm of high priority, and nothing accumulates in the folder.
#[test]
fn taken_socket_name_raises_one_alarm() {
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let impostor = Impostor::start(&engine.layout());
    let await_alarm = |engine: &GenuineEngine| {
        loop {
            let (_, event) = engine.events.recv_timeout(PATIENCE).expect("an alarm");
            if event["alarm"] == "name-taken" && event["state"] == "unacknowledged" {
                assert_eq!(event["priority"], "high", "{event}");
                return;
            }
        }
    };
    await_alarm(&engine);
    await_alarm(&engine);
    assert!(impostor.takeovers() >= 2);
    drop(impostor);
    drop(fs::remove_file(folder.path().join(".x")));
    let socket = socket_path(&engine.layout());
    for attempt in 0..3 {
        // A foreign folder that is not empty.
        until(&format!("{attempt}: the name is not the engine's"), || engine.is_up());
        fs::remove_file(&socket).unwrap();
        fs::write(&socket, "kept").unwrap();
        await_alarm(&engine);
    }
    until("the name is not the engine's", || engine.is_up());
    let mut names: Vec<String> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with("engine."))
        .collect();
    names.sort();
    assert_eq!(names, ["engine.lock", "engine.sock", "engine.sock.aside"]);
    engine.end();
}

/// Any object in the place of the mark stops the cell, which can start once the object is gone.
#[test]
fn any_object_in_place_of_the_mark_is_a_stop() {
    let folder = quick_folder();
    let engine = GenuineEngine::start(folder.path());
    let mark = engine.layout().stop_request();
    let socket = socket_path(&engine.layout());
    let link = || symlink("/dev/zero", &mark).unwrap();
    let empty = || fs::write(&mark, "").unwrap();
    let long = || fs::write(&mark, "x".repeat(1 << 20)).unwrap();
    let pipe = || assert!(Process::new("mkfifo").arg(&mark).status().unwrap().success());
    let subfolder = || fs::create_dir(&mark).unwrap();
    let objects: [(&str, &dyn Fn()); 5] =
        [("a link", &link), ("empty", &empty), ("long", &long), ("a pipe", &pipe), ("a folder", &subfolder)];
    for (what, plant) in objects {
        plant();
        engine.await_event("cell-stopped");
        until(&format!("{what} stays"), || fs::symlink_metadata(&mark).is_err());
        GenuineEngine::start_cell(&socket);
        engine.await_event("cell-released");
    }
    // An object that cannot be removed keeps the cell stopped.
    let planted = folder.path().join("planted");
    fs::create_dir(&planted).unwrap();
    fs::write(planted.join("inside"), "").unwrap();
    fs::rename(&planted, &mark).unwrap();
    engine.await_event("cell-stopped");
    let answer = send_request(&socket, &json!({ "command": "snapshot" }));
    let stopped = &answer["reply"]["snapshot"]["stopped"];
    let reply = send_request(
        &socket,
        &json!({ "command": "go", "by": "ana", "reason": "checked", "since_ms": stopped["since_ms"], "stops": stopped["stops"] }),
    );
    assert!(reply["reply"]["text"].as_str().unwrap().contains("stop.asked"), "{reply}");
    fs::remove_dir_all(&mark).unwrap();
    GenuineEngine::start_cell(&socket);
    engine.end();
}

/// A mark left without an engine stops the next engine, which records it once.
#[test]
fn a_mark_that_was_left_stops_the_next_engine() {
    let folder = quick_folder();
    GenuineEngine::start(folder.path()).end();
    let layout = Layout::new(folder.path());
    fs::write(layout.stop_request(), r#"{"id":"left","by":"ana","reason":"a hand is in the cell"}"#).unwrap();
    let engine = GenuineEngine::start(folder.path());
    let answer = send_request(&socket_path(&layout), &json!({ "command": "snapshot" }));
    let stopped = &answer["reply"]["snapshot"]["stopped"];
    assert_eq!((&stopped["by"], &stopped["stops"]), (&json!("ana"), &json!(1)), "{stopped}");
    assert!(!layout.stop_request().exists(), "it is on record");
    assert_eq!(engine.stops_on_record(), 1);
    let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
    let stop = Views::open(&layout.database()).unwrap().audit(&stops).unwrap().remove(0);
    let body: Value = serde_json::from_str(&stop.body).unwrap();
    assert_eq!(body["code"], "unrecorded-stop", "{body}");
    engine.end();
}

/// A console of another account: it stops the cell over the socket of its group alone, and no account outside that
/// group is accepted. Only root can run this, because only root starts programs of other accounts.
#[test]
fn console_of_another_account_stops_the_cell_and_a_stranger_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let (data, console_folder) = (folder.path().join("store"), folder.path().join("seats"));
    fs::create_dir(&console_folder).unwrap();
    fs::set_permissions(&console_folder, Permissions::from_mode(0o770)).unwrap();
    let serve = || {
        let mut serve = Process::new(env!("CARGO_BIN_EXE_holdpoint"));
        serve
            .args(["serve", "--json", "--no-recording", "--data"])
            .arg(&data)
            .arg("--seats")
            .arg(&console_folder);
        serve
    };
    // A folder that others may write to is refused.
    assert_error(&serve().output().unwrap(), 2, "control-socket/taken");
    fs::set_permissions(&console_folder, Permissions::from_mode(0o750)).unwrap();
    let is_root = rustix::process::geteuid().is_root();
    let (group, member, stranger) = (61_001, 61_002, 61_003);
    if is_root {
        std::os::unix::fs::chown(&console_folder, None, Some(group)).unwrap();
        fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
    }
    let engine = GenuineEngine::of(serve(), &data);
    let socket = socket_path(&Layout::new(&console_folder)).metadata().unwrap();
    assert_eq!((socket.mode() & 0o777, socket.gid()), (0o660, fs::metadata(&console_folder).unwrap().gid()));
    let arguments = ["stop", "--as", "night", "--json", "--data"];
    // The build folder may be closed to other accounts. A program that this process had open for writing could not
    // be started while another test starts one.
    let program = folder.path().join("holdpoint");
    let status = Process::new("cp").arg(env!("CARGO_BIN_EXE_holdpoint")).arg(&program).status().unwrap();
    assert!(status.success(), "{status}");
    let stop_as = |uid: u32, gid: u32| {
        let mut verb = Process::new(&program);
        verb.args(arguments).arg(&console_folder);
        if is_root {
            verb.uid(uid).gid(gid);
        }
        verb.output().unwrap()
    };
    if is_root {
        let stranger_output = stop_as(stranger, stranger);
        assert_eq!(stranger_output.status.code(), Some(6), "{}", output_text(&stranger_output));
        assert_eq!(engine.stops_on_record(), 0);
    }
    let output = stop_as(member, group);
    assert_eq!(output.status.code(), Some(0), "{}", output_text(&output));
    let reply: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(reply["reply"], "stopped", "{reply}");
    engine.await_event("cell-stopped");
    assert_eq!(engine.stops_on_record(), 1);
    if is_root {
        let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
        let stops = Views::open(&Layout::new(&data).database()).unwrap().audit(&stops).unwrap();
        assert!(stops[0].body.contains(&format!("\"uid\":{member}")), "{}", stops[0].body);
    }
    engine.end();
    assert!(!socket_path(&Layout::new(&console_folder)).exists());
}
