//! The built console on its own terminal: keys in, the visible screen out, and its end.
//!
//! The tests take one store to an open approval request once; each approval or rejection gets a copy of it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test says so by failing")]

#[path = "support/agent.rs"]
#[allow(dead_code, reason = "the tests of the program use the rest")]
mod agent;
#[path = "console_pty/attached_consoles.rs"]
mod attached_consoles;
#[path = "console_pty/console_engine.rs"]
mod console_engine;
#[path = "console_pty/health.rs"]
mod health;
#[path = "console_pty/operator_settings.rs"]
mod operator_settings;
#[path = "support/pty.rs"]
#[allow(dead_code, reason = "the measurements use the rest")]
mod pty;
#[path = "console_pty/readme.rs"]
mod readme;
#[path = "console_pty/shell_approvals.rs"]
mod shell_approvals;
#[path = "console_pty/stop_only_console.rs"]
mod stop_only_console;
#[path = "console_pty/suspended_console.rs"]
mod suspended_console;

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::OnceLock;

use agent::AgentProcess;
use attached_consoles::fill_fields;
use holdpoint::wording::console::approval_screen::WAIT_A_MOMENT;
use pty::{Console, Home};
use rustix::process::Signal;
use shell_approvals::{bob_approves, engine_awaiting_approval};

/// Wide enough for every pane.
const SIZE: (u16, u16) = (120, 36);

/// The arguments of a console on a fresh store, which runs under the profile `sim`.
const FRESH_STORE_ARGUMENTS: [&str; 4] = ["run", "--no-tour", "--jobs=1", "--linger=5"];

/// Sequences that restore the terminal, in this order.
const LEAVE_SEQUENCES: [&str; 3] = ["\x1b[?2004l", "\x1b[?25h", "\x1b[?1049l"];

/// The title of the open request; the queue beside it has another title.
const REQUEST_TITLE: &str = "Decide on align@1.1.0";

/// The passphrase of the approvers' keys.
const PASSPHRASE: &str = "under the oak";

/// Exit code of a console that a signal or its closed window ended: the candidate stays on hold.
const EXIT_INTERRUPTED: u32 = 3;

/// Opens the console on a fresh store and waits for the engine.
fn console_on_fresh_store(home: &Home, variables: &[(&str, &str)]) -> Console {
    let console = home.console_with(&FRESH_STORE_ARGUMENTS, SIZE, variables);
    console.wait_for("the engine is up", |screen| shows_engine(&screen.contents()));
    console
}

/// The banner names the profile once the engine has sent a snapshot.
fn shows_engine(text: &str) -> bool {
    ["SIM", "REAL", "HUMAN"].iter().any(|profile| text.contains(profile))
}

/// The terminal is restored: the last sequences undo everything, and line mode is back.
fn assert_restored(console: &Console) {
    let raw = console.raw();
    let places: Vec<usize> = LEAVE_SEQUENCES
        .iter()
        .map(|sequence| raw.rfind(sequence).unwrap_or_else(|| panic!("{sequence:?}")))
        .collect();
    assert!(places.is_sorted(), "{places:?}");
    // Nothing is turned on or drawn after that.
    let after = &raw[places[0]..];
    assert!(!after.contains("\x1b[?1049h") && !after.contains("\x1b[?2026h"), "{after:?}");
    assert!(console.is_cooked(), "the terminal still reads key by key");
}

/// The home with a store that has two approvers.
fn with_approvers(home: Home) -> Home {
    let secret_file = passphrase_file(&home);
    for (name, role) in [("alice", "engineer"), ("bob", "safety")] {
        home.must(&["identity", "new", name, "--role", role, "--passphrase-file", &secret_file]);
    }
    home.must(&["identity", "passphrase", "admin", "--new-passphrase-file", &secret_file]);
    for name in ["alice", "bob"] {
        let by = ["--by", "admin", "--reason", "known", "--passphrase-file", &secret_file];
        home.must(&[&["identity", "confirm", name][..], &by].concat());
    }
    home
}

/// Takes a candidate to the point where it waits for approvers.
fn await_approval(home: &Home, folder: &str, version: &str) {
    let script = home.path().join("wait.toml");
    let steps = format!(
        "profile = \"human\"\n\
         [[step]]\nregister = {folder:?}\n\
         [[step]]\nwait = {{ prompt = {version:?}, timeout_s = 20000 }}\n"
    );
    std::fs::write(&script, steps).unwrap();
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).join("console-episodes");
    std::fs::create_dir_all(&cache).unwrap();
    let (script, cache) = (script.to_str().unwrap(), cache.to_str().unwrap());
    let key = format!("{cache}.key");
    let output = home.run(&["run", "--headless", "--script", script, "--cache", cache, "--cache-key", &key]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
}

/// A store with two approvers, in which a candidate waits for approval.
fn folder_awaiting_approval() -> &'static Path {
    static STORE: OnceLock<Home> = OnceLock::new();
    let home = STORE.get_or_init(|| {
        let home = with_approvers(Home::on_disk());
        await_approval(&home, "manifests/candidates/align-improved", "align@1.1.0");
        home
    });
    home.path()
}

/// A home with a copy of that store.
fn home_awaiting_approval() -> Home {
    let home = Home::new();
    copy(&folder_awaiting_approval().join("data"), &home.data());
    home
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    std::fs::set_permissions(to, std::fs::metadata(from).unwrap().permissions()).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let kind = entry.file_type().unwrap();
        if kind.is_dir() {
            copy(&entry.path(), &to.join(entry.file_name()));
        } else if kind.is_file() {
            std::fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
}

/// Opens the approval request that waits, as the named operator.
fn open_request(home: &Home, name: &str) -> Console {
    open_request_with(home, name, &[])
}

fn open_request_with(home: &Home, name: &str, variables: &[(&str, &str)]) -> Console {
    let arguments = ["run", "--profile", "human", "--as", name, "--no-tour", "--pace", "max"];
    let mut console = home.console_with(&arguments, SIZE, variables);
    console.wait_for("the engine is up", |screen| shows_engine(&screen.contents()));
    console.wait_for_text(name);
    // The queue shows the waiting request; only Enter opens it.
    console.wait_for_text("1 wait");
    console.keys("a");
    console.keys("\r");
    console.wait_for_text(REQUEST_TITLE);
    console
}

/// The digits to type, read from the approval request.
fn short_id(console: &Console) -> String {
    let text = console.contents();
    let (_, after) = text.split_once("Promote align@1.1.0 (").expect("the question");
    after.chars().take_while(char::is_ascii_hexdigit).collect()
}

/// Presses a deciding key once the request accepts it: the request ignores keys in the first moments.
fn press_until_decided(console: &mut Console, key: &str) {
    console.wait_for("the question takes answers", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    console.keys(key);
    console.wait_for("the question is answered", |screen| !screen.contents().contains(REQUEST_TITLE));
}

fn verify_audit(home: &Home) {
    home.must(&["audit", "verify"]);
}

fn state_of(home: &Home, version: &str) -> String {
    let shown = home.must(&["registry", "show", version, "--json"]);
    let value: serde_json::Value = serde_json::from_str(shown.lines().next().unwrap()).unwrap();
    value["summary"]["state"].as_str().unwrap_or_default().to_owned()
}

/// The stop of the cell; null while the cell runs.
fn stop_of(home: &Home) -> serde_json::Value {
    let shown = home.must(&["status", "--json"]);
    let mut report: serde_json::Value = serde_json::from_str(&shown).unwrap();
    report["stopped"].take()
}

/// Files of a store that contain these bytes.
fn files_containing(folder: &Path, bytes: &[u8]) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files_containing(&path, bytes));
        } else if path.is_file()
            && std::fs::read(&path).unwrap().windows(bytes.len()).any(|window| window == bytes)
        {
            found.push(path);
        }
    }
    found
}

#[test]
fn a_passphrase_is_typed_twice_and_never_shown() {
    let home = Home::new();
    let new = || home.console(&["identity", "new", "mara"], SIZE);
    let mut console = new();
    console.wait_for_text("New passphrase of ");
    console.keys("under the oak\r");
    console.wait_for_text("Repeat it:");
    console.keys("under the elm\r");
    console.wait_for_text("passphrases differ");
    assert_eq!(console.end().exit_code(), 2);
    assert!(console.is_cooked(), "the terminal reads lines again");
    let mut console = new();
    console.wait_for_text("New passphrase of ");
    console.keys("under\x03");
    console.wait_for_text("canceled;");
    assert_eq!(console.end().exit_code(), 2);
    assert_eq!(home.must(&["identity", "list", "--json"]).trim(), "[]");
    let mut console = new();
    console.wait_for_text("New passphrase of ");
    console.keys("under the oax\x7fk\r");
    console.wait_for_text("Repeat it:");
    console.keys("under the oak\r");
    console.wait_for_text("mara (operator, passphrase)");
    assert_eq!(console.end().exit_code(), 0);
    assert!(!console.raw().contains("oak") && !console.raw().contains("under"), "{}", console.raw());
    // A verb that signs asks for the passphrase, and reports a wrong one.
    assert_eq!(home.run(&["stop"]).status.code(), Some(6), "no engine is running");
    let go = || home.console(&["go", "--as", "mara", "--stops", "1", "--reason", "checked"], SIZE);
    let mut console = go();
    console.wait_for_text("Passphrase of mara:");
    console.keys("under the elm\r");
    console.wait_for_text("is wrong");
    assert_eq!(console.end().exit_code(), 2);
    assert!(stop_of(&home).is_object());
    let mut console = go();
    console.wait_for_text("Passphrase of mara:");
    console.keys("under the oak\r");
    assert_eq!(console.end().exit_code(), 0, "{}", console.contents());
    assert!(stop_of(&home).is_null());
}

/// Ends the console as an operator does.
fn quit(console: &mut Console) -> u32 {
    // From another view the key leads back first.
    console.keys("1");
    // While another console is attached, the engine is left running.
    console.wait_for("no other console is attached", |screen| {
        let views = screen.contents().lines().nth(1).map(ToOwned::to_owned).unwrap_or_default();
        views.contains("[1 Overview]") && !views.contains("with ")
    });
    console.keys("q");
    // The key counts as soon as the screen says so.
    console.wait_for_text(" y does it");
    console.keys("y");
    console.end().exit_code()
}

#[test]
fn quitting_restores_the_terminal_and_reports_the_shutdown() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[]);
    assert!(!console.is_cooked(), "keys come one by one");
    assert_eq!(quit(&mut console), 0, "{}", console.contents());
    assert_restored(&console);
    assert!(console.contents().contains("down cleanly"), "{}", console.contents());
    verify_audit(&home);
}

#[test]
fn two_approvals_activate_the_version() {
    let home = home_awaiting_approval();
    let mut console = open_request(&home, "alice");
    let id = short_id(&console);
    assert_eq!(id.len(), 4, "{}", console.contents());
    // Enter never approves: it holds, and the request stays open.
    console.keys("\r");
    console.wait_for("Enter closed the question", |screen| !screen.contents().contains(REQUEST_TITLE));
    assert_eq!(state_of(&home, "align@1.1.0"), "shadowed");
    console.keys("\r");
    console.wait_for_text(REQUEST_TITLE);
    fill_fields(&mut console, &id, "evidence read");
    console.wait_for("the question takes answers", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    console.keys("Y");
    console.wait_for_text("Passphrase of alice");
    console.keys("under the elm\r");
    console.wait_for_text("wrong passphrase");
    assert_eq!(state_of(&home, "align@1.1.0"), "shadowed");
    console.keys(PASSPHRASE);
    press_until_decided(&mut console, "\r");
    let (code, text) = bob_approves(&home);
    assert_eq!(code, Some(0), "{text}");
    console.keys("1");
    console.wait_for("the version is active", |screen| {
        screen
            .contents()
            .lines()
            .any(|line| line.contains("align@1.1.0") && line.contains("active, provisional"))
    });
    assert_eq!(quit(&mut console), 0);
    assert_eq!(state_of(&home, "align@1.1.0"), "active");
    verify_audit(&home);
    assert!(!console.raw().contains("oak"), "a passphrase was on the screen");
    assert_eq!(files_containing(&home.data(), b"under the oak"), Vec::<std::path::PathBuf>::new());
}

/// The file with the passphrase of this store's keys.
fn passphrase_file(home: &Home) -> String {
    let file = home.path().join("words");
    std::fs::write(&file, PASSPHRASE).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    file.to_str().unwrap().to_owned()
}

fn wait_until_active(home: &Home) {
    let until = std::time::Instant::now() + std::time::Duration::from_mins(2);
    while state_of(home, "align@1.1.0") != "active" {
        assert!(std::time::Instant::now() < until, "{}", state_of(home, "align@1.1.0"));
        std::thread::park_timeout(std::time::Duration::from_millis(5));
    }
}

#[test]
fn approve_exits_with_0_once_the_quorum_is_met() {
    let home = home_awaiting_approval();
    let secret_file = passphrase_file(&home);
    let (mut engine, digest) = engine_awaiting_approval(&home);
    let approve = |more: &[&str]| {
        let as_alice = [
            "approve",
            "align@1.1.0",
            "--as",
            "alice",
            "--reason",
            "read",
            "--passphrase-file",
            &secret_file,
        ];
        let output = home.run(&[&as_alice, more].concat());
        let text = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        (output.status.code(), text.into_owned())
    };
    let (code, text) = approve(&["--digest", "00000000"]);
    assert_eq!(code, Some(3), "{text}");
    assert_eq!(state_of(&home, "align@1.1.0"), "shadowed");
    let (code, text) = bob_approves(&home);
    assert_eq!(code, Some(3), "one of two is not enough: {text}");
    let (code, text) = approve(&["--digest", &digest]);
    assert_eq!(code, Some(0), "{text}");
    wait_until_active(&home);
    engine.signal(Signal::TERM);
    assert_eq!(engine.end().exit_code(), 0);
    let granted = home.must(&["audit", "list", "--kind", "approval-put", "--json"]);
    assert_eq!(granted.lines().count(), 2, "the one with another digest is on record as well: {granted}");
    verify_audit(&home);
}

/// Enrolls a person whose key an agent holds.
fn enroll_carol(home: &Home, agent: &AgentProcess) {
    let secret_file = passphrase_file(home);
    let socket = agent.socket();
    let enrol = ["identity", "enrol", "carol", "--ssh-agent", "carol@desk", "--role", "engineer"];
    let by = ["--by", "admin", "--reason", "known", "--passphrase-file", &secret_file];
    let mut console =
        home.console_with(&[&enrol[..], &by].concat(), SIZE, &[("SSH_AUTH_SOCK", socket.to_str().unwrap())]);
    console.wait_for_text("as engineer");
    assert_eq!(console.end().exit_code(), 0);
}

#[test]
fn approve_verb_signs_with_a_key_of_an_ssh_agent() {
    let home = home_awaiting_approval();
    let Some(agent) = AgentProcess::with_key(home.path(), "carol@desk") else { return };
    enroll_carol(&home, &agent);
    let (mut engine, digest) = engine_awaiting_approval(&home);
    let approve = |socket: &str| {
        let arguments = ["approve", "align@1.1.0", "--as", "carol", "--reason", "read", "--digest", &digest];
        let mut console = home.console_with(&arguments, SIZE, &[("SSH_AUTH_SOCK", socket)]);
        (console.end().exit_code(), console.contents())
    };
    let (code, text) = approve("/nobody");
    assert!(code == 2 && text.contains("ssh-agent"), "{code}: {text}");
    assert_eq!(bob_approves(&home).0, Some(3));
    let socket = agent.socket();
    let (code, text) = approve(socket.to_str().unwrap());
    assert_eq!(code, 0, "{text}");
    wait_until_active(&home);
    engine.signal(Signal::TERM);
    assert_eq!(engine.end().exit_code(), 0);
    verify_audit(&home);
}

#[test]
fn console_signs_an_approval_with_a_key_of_an_ssh_agent() {
    let home = home_awaiting_approval();
    let Some(agent) = AgentProcess::with_key(home.path(), "carol@desk") else { return };
    enroll_carol(&home, &agent);
    let socket = agent.socket();
    let mut console = open_request_with(&home, "carol", &[("SSH_AUTH_SOCK", socket.to_str().unwrap())]);
    let id = short_id(&console);
    fill_fields(&mut console, &id, "evidence read");
    press_until_decided(&mut console, "Y");
    assert!(!console.raw().contains("Passphrase of"), "only the agent is asked");
    let (code, text) = bob_approves(&home);
    assert_eq!(code, Some(0), "{text}");
    wait_until_active(&home);
    assert_eq!(quit(&mut console), 0);
    verify_audit(&home);
}

#[test]
fn rejection_needs_a_reason_and_rejects_the_version() {
    let home = home_awaiting_approval();
    let mut console = open_request(&home, "bob");
    // Without a reason the key that rejects leads to the field.
    console.wait_for("the question takes answers", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    console.keys("N");
    console.keys("night shift is alone");
    console.wait_for_text("night shift is alone");
    console.keys("\t");
    console.wait_for("the question takes answers", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    console.keys("N");
    console.wait_for_text("Passphrase of bob");
    console.keys(PASSPHRASE);
    press_until_decided(&mut console, "\r");
    console.keys("2");
    console.wait_for("the version is rejected", |screen| {
        screen.contents().lines().any(|line| line.contains("rejected"))
    });
    assert_eq!(quit(&mut console), 0);
    assert_eq!(state_of(&home, "align@1.1.0"), "rejected");
    verify_audit(&home);
}

#[test]
fn a_closed_window_approves_nothing_and_ends_in_time() {
    let home = home_awaiting_approval();
    let mut console = open_request(&home, "alice");
    let id = short_id(&console);
    fill_fields(&mut console, &id, "almost decided");
    let (took, status) = console.hang_up();
    assert!(took.as_secs_f64() < 5.0, "{took:?}");
    assert_eq!(status.exit_code(), EXIT_INTERRUPTED, "{status:?}");
    assert_eq!(state_of(&home, "align@1.1.0"), "shadowed");
    verify_audit(&home);
}

#[test]
fn termination_signals_restore_the_terminal_and_exit_with_3() {
    for signal in [Signal::TERM, Signal::INT, Signal::HUP] {
        let home = Home::new();
        let mut console = console_on_fresh_store(&home, &[]);
        console.signal(signal);
        let status = console.end();
        assert_eq!(status.exit_code(), EXIT_INTERRUPTED, "{signal:?}: {status:?}");
        assert_restored(&console);
        verify_audit(&home);
    }
}

#[test]
fn panic_of_the_screen_restores_the_terminal() {
    let home = Home::new();
    let mut console = home.console_with(&FRESH_STORE_ARGUMENTS, SIZE, &[("HOLDPOINT_TEST_PANIC", "ui")]);
    let status = console.end();
    assert_eq!(status.exit_code(), 70, "{status:?}");
    assert_restored(&console);
    assert!(console.contents().contains("HOLDPOINT_TEST_PANIC"), "{}", console.contents());
    verify_audit(&home);
}

#[test]
fn panic_of_the_engine_keeps_the_screen_and_latches_an_alarm() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[("HOLDPOINT_TEST_PANIC", "engine")]);
    console.keys(":demo\r");
    console.wait_for("the engine is halted", |screen| screen.contents().contains("ENGINE HALTED"));
    console.keys("5");
    console.wait_for_text("CRIT engine");
    // The terminal is still the console's, and its keys work.
    assert!(!console.is_cooked());
    assert!(!console.raw().contains(LEAVE_SEQUENCES[2]), "the screen was given back");
    assert!(home.engine_log().contains("on purpose"), "{}", home.engine_log());
    console.keys("1");
    quit(&mut console);
    assert_restored(&console);
    verify_audit(&home);
}

#[test]
fn no_color_variable_turns_colors_off() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[("NO_COLOR", "1"), ("COLORTERM", "truecolor")]);
    assert_eq!(quit(&mut console), 0);
    let raw = console.raw();
    let colors: Vec<&str> = raw
        .split("\x1b[")
        .skip(1)
        .filter_map(|rest| rest.split_once('m').map(|(numbers, _)| numbers))
        .filter(|numbers| numbers.chars().all(|sign| sign.is_ascii_digit() || sign == ';'))
        .filter(|numbers| numbers.split(';').any(is_color))
        .collect();
    assert!(colors.is_empty(), "{colors:?}");
}

/// Whether a number of a style sequence names a color; 39 and 49 remove one.
fn is_color(number: &str) -> bool {
    matches!(number.parse::<u16>(), Ok(30..=38 | 40..=48 | 90..=97 | 100..=107))
}

#[test]
fn console_survives_many_resizes_and_a_window_of_one_cell() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[]);
    for round in 0..40_u16 {
        console.resize(1 + (round * 37) % 200, 1 + (round * 13) % 60);
        console.keys("2");
    }
    console.resize(1, 1);
    console.keys("1j");
    console.resize(SIZE.0, SIZE.1);
    console.wait_for_repainted("the whole screen is back", SIZE, |screen| {
        let text = screen.contents();
        let has_all = ["1 Overview", "7 Audit", "Pipeline", "Robot", "Events", "q end engine"];
        shows_engine(&text) && has_all.iter().all(|label| text.contains(label))
    });
    assert_eq!(quit(&mut console), 0);
    assert_restored(&console);
}

#[test]
fn console_starts_and_ends_in_a_window_of_one_cell() {
    let home = Home::new();
    let mut console = home.console(&FRESH_STORE_ARGUMENTS, (1, 1));
    console.wait_for("a frame", vt100::Screen::alternate_screen);
    console.keys("q");
    // One cell is too small to read the question, and an unread question is never confirmed.
    console.resize(SIZE.0, SIZE.1);
    console.wait_for_text(" y does it");
    console.keys("y");
    assert_eq!(console.end().exit_code(), 0, "{}", home.log());
    assert_restored(&console);
}

#[test]
fn wrong_settings_are_reported_before_the_screen_is_used() {
    for (file, text, line, expected) in [
        ("config.toml", "ascii = true\ntheem = \"x\"\n", 2, "theem"),
        ("keys.toml", "[keys]\napprove = [\"enter\"]\n", 2, "never decide"),
    ] {
        let home = Home::new();
        let folder = home.path().join("config/holdpoint");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(file), text).unwrap();
        let mut console = home.console(&FRESH_STORE_ARGUMENTS, SIZE);
        assert_eq!(console.end().exit_code(), 2);
        let contents = console.contents().replace('\n', "");
        assert!(contents.contains(&format!("{file}:{line}")) && contents.contains(expected), "{contents}");
        assert!(!console.raw().contains("\x1b[?1049h"), "the screen was taken");
    }
}

#[test]
#[cfg(feature = "rerun")]
fn a_past_upgrade_is_replayed_on_the_terminal() {
    let home = Home::new();
    let recording = concat!(env!("CARGO_MANIFEST_DIR"), "/recordings/rolled-back.rrd");
    let mut console = home.console(&["replay", recording, "--terminal", "--to", "109500"], SIZE);
    let shows_moment = |tick: &str, text: &str| text.contains("against align@1.0.0") && text.contains(tick);
    console.wait_for("the moment asked for", |screen| shows_moment("tick 109500", &screen.contents()));
    // The next decision is the monitor's, which rolled the version back.
    console.keys("d");
    console.wait_for("the rollback", |screen| {
        let text = screen.contents();
        shows_moment("477.4 s", &text) && text.contains("align@1.1.0: rollback")
    });
    console.resize(80, 24);
    console.wait_for_repainted("a small screen", (80, 24), |screen| screen.contents().contains("REPLAY"));
    console.keys("q");
    assert_eq!(console.end().exit_code(), 0);
    assert_restored(&console);
}
