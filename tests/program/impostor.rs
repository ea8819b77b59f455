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

use holdpoint::engine::control_socket::{
    AnswerOrigin, Client, StopCall, StopOutcome, UnverifiedOrigin, socket_path,
};
use holdpoint::governance::record::RecordKind;
use holdpoint::protocol::command::{Command, Reply};
use holdpoint::protocol::wire::PROTOCOL;
use holdpoint::registry::{AuditFilter, Layout, LockHolder, Views, lock_holder, verify};
use serde_json::{Value, json};

use crate::host::PATIENCE;

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
        std::thread::yield_now();
    }
}

/// An engine in another process, and its output.
struct Served {
    child: Child,
    told: Receiver<(Instant, Value)>,
    data: PathBuf,
}

impl Served {
    fn start(data: &Path) -> Self {
        let mut serve = Process::new(env!("CARGO_BIN_EXE_holdpoint"));
        serve.args(["serve", "--json", "--pace", "1", "--no-recording", "--data"]).arg(data);
        Self::of(serve, data)
    }

    fn of(mut serve: Process, data: &Path) -> Self {
        let mut child = serve.stdout(Stdio::piped()).spawn().unwrap();
        let (tell, told) = channel();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        std::thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                let told = (Instant::now(), serde_json::from_str(&line).unwrap());
                drop(tell.send(told));
            }
        });
        let served = Self { child, told, data: data.to_owned() };
        until("the engine does not start", || served.is_up());
        served
    }

    fn is_up(&self) -> bool {
        let Ok(Some(mut client)) = Client::connect(&self.layout()) else { return false };
        let shown = client.ask(Command::Snapshot);
        client.unverified_origin().is_none()
            && matches!(shown, Ok(Reply::Snapshot { snapshot }) if snapshot.reading.is_none())
    }

    fn layout(&self) -> Layout {
        Layout::new(&self.data)
    }

    fn verb(&self, words: &[&str]) -> Output {
        Process::new(env!("CARGO_BIN_EXE_holdpoint"))
            .args(words)
            .arg("--data")
            .arg(&self.data)
            .output()
            .unwrap()
    }

    /// The time of the engine's next event of this kind.
    fn tells(&self, kind: &str) -> Instant {
        loop {
            let (at, told) = self.told.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no {kind}"));
            if told["event"] == kind {
                return at;
            }
        }
    }

    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Process::new("kill").args([name, &pid]).status().unwrap().success());
    }

    /// Starts the cell, over the engine's own socket, wherever that is by now.
    fn go(socket: &Path) {
        let until = Instant::now() + PATIENCE;
        loop {
            let stopped = ask(socket, &json!({ "command": "snapshot" }));
            let stopped = &stopped["reply"]["snapshot"]["stopped"];
            let since = stopped["since_ms"].as_u64().unwrap_or(0);
            let known = stopped["stops"].as_u64().unwrap_or(0);
            let reply = ask(
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

impl Drop for Served {
    fn drop(&mut self) {
        // An ended process has been waited for, and this then does nothing.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// Sends a raw request; a missing answer is null.
fn ask(socket: &Path, command: &Value) -> Value {
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
    taken: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
    /// The current path of the engine's own socket.
    real: PathBuf,
}

impl Impostor {
    fn start(layout: &Layout) -> Self {
        let (over, taken) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
        let (end, ended) = channel::<()>();
        let path = socket_path(layout);
        let (real, own) = (layout.folder().join(".x"), layout.folder().join(".y"));
        let (ends, counts, keeps) = (Arc::clone(&over), Arc::clone(&taken), real.clone());
        let work = move || {
            let mut mine = None;
            while ended.recv_timeout(TAKES_EVERY) == Err(RecvTimeoutError::Timeout) {
                let there = fs::symlink_metadata(&path).ok().map(|found| found.ino());
                if there.is_some() && there != mine {
                    drop(fs::rename(&path, &keeps));
                    drop(fs::remove_file(&own));
                    let listener = UnixListener::bind(&own).unwrap();
                    fs::set_permissions(&own, Permissions::from_mode(0o600)).unwrap();
                    mine = fs::symlink_metadata(&own).ok().map(|found| found.ino());
                    fs::rename(&own, &path).unwrap();
                    counts.fetch_add(1, Ordering::AcqRel);
                    let over = Arc::clone(&ends);
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
        let impostor = Self { end: Some(end), over, taken, thread: Some(std::thread::spawn(work)), real };
        until("there is no name to take", || impostor.taken() > 0);
        impostor
    }

    fn taken(&self) -> usize {
        self.taken.load(Ordering::Acquire)
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

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

#[test]
fn a_stop_stops_the_arm_while_an_impostor_has_the_name() {
    let stops = count("HOLDPOINT_IMPOSTOR_STOPS", 3);
    let measured = std::env::var_os("HOLDPOINT_IMPOSTOR_STOPS").is_some();
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let impostor = Impostor::start(&served.layout());
    let mut worst = Duration::ZERO;
    for nth in 1..=stops {
        served.tells("sequence");
        let begun = Instant::now();
        let stopped = served.verb(&["stop", "--reason", "a hand is in the cell"]);
        assert_eq!(stopped.status.code(), Some(0), "{nth}: {}", said(&stopped));
        assert!(!said(&stopped).contains(LIE), "{nth}: {}", said(&stopped));
        let stands = served.tells("arm-stands") - begun;
        worst = worst.max(stands);
        assert!(!measured || stands < Duration::from_secs(1), "{nth}: {stands:?}");
        Served::go(&impostor.real);
        served.tells("cell-released");
    }
    println!("impostor: {stops} of {stops} stops confirmed, verb to standing arm at worst {worst:?}");
    assert_eq!(served.stops_on_record(), stops);
    drop(impostor);
    served.end();
}

#[test]
fn what_an_impostor_answers_is_never_taken_for_the_engines() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let impostor = Impostor::start(&served.layout());
    let holds = i32::try_from(served.child.id()).unwrap();
    assert_eq!(lock_holder(folder.path()), LockHolder::Process(holds));
    let client = Client::connect(&served.layout()).unwrap().unwrap();
    let answers = i32::try_from(std::process::id()).unwrap();
    assert_eq!(client.unverified_origin(), AnswerOrigin::Other { answers, holds: Some(holds) }.unverified());
    // A verb that changes authority reports it and ends with its own exit code, whatever the answer.
    let words = ["demote", "grasp@1.0.0", "--as", "ana", "--reason", "it drops parts"];
    for json in [&[][..], &["--json"]] {
        let demoted = served.verb(&[&words[..], json].concat());
        assert_eq!(demoted.status.code(), Some(6), "{}", said(&demoted));
        assert!(said(&demoted).contains("not known to come from the engine"), "{}", said(&demoted));
        if !json.is_empty() {
            let reply: Value = serde_json::from_slice(&demoted.stdout).unwrap();
            assert_eq!((&reply["text"], &reply["unverified"]), (&json!(LIE), &json!(UnverifiedOrigin::CODE)));
        }
    }
    // So does one that only reads.
    let status = served.verb(&["status"]);
    assert!(said(&status).contains("not known to come from the engine"), "{}", said(&status));
    let status = served.verb(&["status", "--json"]);
    assert!(said(&status).contains(UnverifiedOrigin::CODE), "{}", said(&status));
    drop(impostor);
    served.end();
}

/// A program that took the name and removed the mark at the same moment once defeated the stop.
#[test]
fn a_stop_stops_the_arm_while_its_mark_is_removed_as_fast_as_it_is_made() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let impostor = Impostor::start(&served.layout());
    let (over, removed) = (Arc::<AtomicBool>::default(), Arc::<AtomicUsize>::default());
    let (ends, counts, mark) = (Arc::clone(&over), Arc::clone(&removed), served.layout().stop_asked());
    let remover = std::thread::spawn(move || {
        while !ends.load(Ordering::Acquire) {
            if fs::remove_file(&mark).is_ok() {
                counts.fetch_add(1, Ordering::AcqRel);
            }
        }
    });
    for _ in 0..count("HOLDPOINT_IMPOSTOR_STOPS", 3) {
        let asked = Instant::now();
        let stopped = served.verb(&["stop"]);
        let told = served.tells("cell-stopped");
        served.tells("arm-stands");
        println!("{} ms, exit code {:?}", told.duration_since(asked).as_millis(), stopped.status.code());
        // Confirmed by the kernel, or not reported.
        match stopped.status.code() {
            Some(0) => {
                assert!(said(&stopped).contains("the process that has the store"), "{}", said(&stopped));
            }
            code => assert_eq!(code, Some(6), "{}", said(&stopped)),
        }
        Served::go(&impostor.real);
        served.tells("cell-released");
    }
    over.store(true, Ordering::Release);
    remover.join().unwrap();
    assert!(removed.load(Ordering::Acquire) > 0);
    drop(impostor);
    served.end();
}

#[test]
fn a_stop_that_nobody_confirms_is_no_stop_and_is_made_good() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let impostor = Impostor::start(&served.layout());
    served.signal("-STOP");
    for json in [&[][..], &["--json"]] {
        let stopped = served.verb(&[&["stop"][..], json].concat());
        let said = said(&stopped);
        assert_eq!(stopped.status.code(), Some(6), "{said}");
        assert!(said.contains("NOT CONFIRMED") && said.contains("press the emergency stop"), "{said}");
        assert!(!said.contains("is stopped;") && !said.contains(LIE), "{said}");
        assert!(json.is_empty() || said.contains("\"code\":6"), "{said}");
    }
    // The mark is there: the engine continues and stops because of it.
    served.signal("-CONT");
    served.tells("cell-stopped");
    until("the mark stays", || !served.layout().stop_asked().exists());
    assert_eq!(served.stops_on_record(), 1, "two requests with the same mark are one stop");
    drop(impostor);
    served.end();
}

/// Without attack the engine itself confirms every stop, which counts once.
#[test]
fn every_stop_is_confirmed_and_counts_once() {
    let stops = count("HOLDPOINT_CONFIRMED_STOPS", 20);
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let mut took = Vec::new();
    for nth in 0..stops {
        let call = StopCall::new("ana".to_owned(), format!("the {nth}th")).unwrap();
        let begun = Instant::now();
        let outcome = call.ask(&served.layout());
        took.push(begun.elapsed());
        assert!(
            matches!(&outcome, StopOutcome::Answered(Reply::Stopped { text, .. }) if text.contains("is stopped")),
            "{nth}: {outcome:?}"
        );
        if nth % 10 == 9 {
            Served::go(&socket_path(&served.layout()));
        }
    }
    took.sort_unstable();
    let at = |part: usize| took[(took.len() * part / 100).min(took.len() - 1)];
    println!("{stops} of {stops} stops confirmed, p50 {:?}, p99 {:?}, worst {:?}", at(50), at(99), at(100));
    assert_eq!(served.stops_on_record(), stops);
    assert!(!served.layout().stop_asked().exists());
    served.end();
}

/// The cost of a verified answer: connections that read the snapshot.
#[test]
fn a_verified_answer_is_quick() {
    let looks = count("HOLDPOINT_VERIFIED_ANSWERS", 50);
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let mut took: Vec<Duration> = (0..looks)
        .map(|_| {
            let begun = Instant::now();
            let mut client = Client::connect(&served.layout()).unwrap().unwrap();
            assert_eq!(client.unverified_origin(), None);
            assert!(matches!(client.ask(Command::Snapshot).unwrap(), Reply::Snapshot { .. }));
            begun.elapsed()
        })
        .collect();
    took.sort_unstable();
    println!("{looks} verified answers: p50 {:?}, p99 {:?}", took[looks / 2], took[looks * 99 / 100]);
    let mut looked: Vec<Duration> = (0..looks)
        .map(|_| {
            let begun = Instant::now();
            assert!(matches!(lock_holder(folder.path()), LockHolder::Process(_)));
            begun.elapsed()
        })
        .collect();
    looked.sort_unstable();
    println!(
        "of these, to find the holder of the store: p50 {:?}, p99 {:?}",
        looked[looks / 2],
        looked[looks * 99 / 100]
    );
    served.end();
}

/// Each time the name is taken there is an alarm of high priority, and nothing accumulates in the folder.
#[test]
fn a_name_that_was_taken_is_an_alarm_and_leaves_no_heap() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let impostor = Impostor::start(&served.layout());
    let alarmed = |served: &Served| {
        loop {
            let (_, told) = served.told.recv_timeout(PATIENCE).expect("an alarm");
            if told["alarm"] == "name-taken" && told["state"] == "unacknowledged" {
                assert_eq!(told["priority"], "high", "{told}");
                return;
            }
        }
    };
    alarmed(&served);
    alarmed(&served);
    assert!(impostor.taken() >= 2);
    drop(impostor);
    drop(fs::remove_file(folder.path().join(".x")));
    let socket = socket_path(&served.layout());
    for displaced in 0..3 {
        // A foreign folder that is not empty.
        until(&format!("{displaced}: the name is not the engine's"), || served.is_up());
        fs::remove_file(&socket).unwrap();
        fs::write(&socket, "kept").unwrap();
        alarmed(&served);
    }
    until("the name is not the engine's", || served.is_up());
    let mut names: Vec<String> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with("engine."))
        .collect();
    names.sort();
    assert_eq!(names, ["engine.lock", "engine.sock", "engine.sock.aside"]);
    served.end();
}

/// Any object in the place of the mark stops the cell, which can start once the object is gone.
#[test]
fn whatever_lies_in_the_place_of_the_mark_is_a_stop() {
    let folder = tempfile::tempdir().unwrap();
    let served = Served::start(folder.path());
    let mark = served.layout().stop_asked();
    let socket = socket_path(&served.layout());
    let link = || symlink("/dev/zero", &mark).unwrap();
    let empty = || fs::write(&mark, "").unwrap();
    let long = || fs::write(&mark, "x".repeat(1 << 20)).unwrap();
    let pipe = || assert!(Process::new("mkfifo").arg(&mark).status().unwrap().success());
    let folder_there = || fs::create_dir(&mark).unwrap();
    let ways: [(&str, &dyn Fn()); 5] = [
        ("a link", &link),
        ("empty", &empty),
        ("long", &long),
        ("a pipe", &pipe),
        ("a folder", &folder_there),
    ];
    for (what, plant) in ways {
        plant();
        served.tells("cell-stopped");
        until(&format!("{what} stays"), || fs::symlink_metadata(&mark).is_err());
        Served::go(&socket);
        served.tells("cell-released");
    }
    // An object that cannot be removed keeps the cell stopped.
    fs::create_dir(&mark).unwrap();
    fs::write(mark.join("inside"), "").unwrap();
    served.tells("cell-stopped");
    let refused = ask(&socket, &json!({ "command": "snapshot" }));
    let stopped = &refused["reply"]["snapshot"]["stopped"];
    let reply = ask(
        &socket,
        &json!({ "command": "go", "by": "ana", "reason": "checked", "since_ms": stopped["since_ms"], "stops": stopped["stops"] }),
    );
    assert!(reply["reply"]["text"].as_str().unwrap().contains("stop.asked"), "{reply}");
    fs::remove_dir_all(&mark).unwrap();
    Served::go(&socket);
    served.end();
}

/// A mark left without an engine stops the next engine, which records it once.
#[test]
fn a_mark_that_was_left_stops_the_next_engine() {
    let folder = tempfile::tempdir().unwrap();
    Served::start(folder.path()).end();
    let layout = Layout::new(folder.path());
    fs::write(layout.stop_asked(), r#"{"id":"left","by":"ana","reason":"a hand is in the cell"}"#).unwrap();
    let served = Served::start(folder.path());
    let stopped = ask(&socket_path(&layout), &json!({ "command": "snapshot" }));
    let stopped = &stopped["reply"]["snapshot"]["stopped"];
    assert_eq!((&stopped["by"], &stopped["stops"]), (&json!("ana"), &json!(1)), "{stopped}");
    assert!(!layout.stop_asked().exists(), "it is on record");
    assert_eq!(served.stops_on_record(), 1);
    let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
    let stop = Views::open(&layout.database()).unwrap().audit(&stops).unwrap().remove(0);
    let body: Value = serde_json::from_str(&stop.body).unwrap();
    assert_eq!(body["code"], "unrecorded-stop", "{body}");
    served.end();
}

/// A console of another account: it stops the cell over the socket of its group alone, and no account outside that
/// group is accepted. Only root can run this, because only root starts programs of other accounts.
#[test]
fn a_seat_of_another_account_stops_the_cell_and_a_stranger_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let (data, seats) = (folder.path().join("store"), folder.path().join("seats"));
    fs::create_dir(&seats).unwrap();
    fs::set_permissions(&seats, Permissions::from_mode(0o770)).unwrap();
    let serve = || {
        let mut serve = Process::new(env!("CARGO_BIN_EXE_holdpoint"));
        serve.args(["serve", "--json", "--no-recording", "--data"]).arg(&data).arg("--seats").arg(&seats);
        serve
    };
    // A folder that others may write to is refused.
    let refused = serve().output().unwrap();
    assert_eq!(refused.status.code(), Some(2), "{}", said(&refused));
    assert!(said(&refused).contains("may be written to by others"), "{}", said(&refused));
    fs::set_permissions(&seats, Permissions::from_mode(0o750)).unwrap();
    let is_root = rustix::process::geteuid().is_root();
    let (group, member, stranger) = (61_001, 61_002, 61_003);
    if is_root {
        std::os::unix::fs::chown(&seats, None, Some(group)).unwrap();
        fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
    }
    let served = Served::of(serve(), &data);
    let socket = socket_path(&Layout::new(&seats)).metadata().unwrap();
    assert_eq!((socket.mode() & 0o777, socket.gid()), (0o660, fs::metadata(&seats).unwrap().gid()));
    let words = ["stop", "--as", "night", "--data"];
    // The build folder may be closed to other accounts. A program that this process had open for writing could not
    // be started while another test starts one.
    let program = folder.path().join("holdpoint");
    let copied = Process::new("cp").arg(env!("CARGO_BIN_EXE_holdpoint")).arg(&program).status().unwrap();
    assert!(copied.success(), "{copied}");
    let stop_as = |uid: u32, gid: u32| {
        let mut verb = Process::new(&program);
        verb.args(words).arg(&seats);
        if is_root {
            verb.uid(uid).gid(gid);
        }
        verb.output().unwrap()
    };
    if is_root {
        let shut_out = stop_as(stranger, stranger);
        assert_eq!(shut_out.status.code(), Some(6), "{}", said(&shut_out));
        assert_eq!(served.stops_on_record(), 0);
    }
    let stopped = stop_as(member, group);
    assert_eq!(stopped.status.code(), Some(0), "{}", said(&stopped));
    assert!(said(&stopped).contains("the cell is stopped, by night"), "{}", said(&stopped));
    served.tells("cell-stopped");
    assert_eq!(served.stops_on_record(), 1);
    if is_root {
        let stops = AuditFilter { kind: Some(RecordKind::CellStopped), ..AuditFilter::default() };
        let stops = Views::open(&Layout::new(&data).database()).unwrap().audit(&stops).unwrap();
        assert!(stops[0].body.contains(&format!("\"uid\":{member}")), "{}", stops[0].body);
    }
    served.end();
    assert!(!socket_path(&Layout::new(&seats)).exists());
}
