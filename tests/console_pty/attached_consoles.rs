//! Several consoles at one engine: their names, the effects of each, and the end of one of them.

use std::path::Path;

use holdpoint::wording::console::approval_screen::WAIT_A_MOMENT;
use rustix::process::Signal;

use crate::pty::{Console, Home};
use crate::{
    PASSPHRASE, SIZE, assert_restored, await_approval, console_on_fresh_store, home_awaiting_approval,
    open_request, press_until_decided, quit, short_id, shows_engine, state_of, verify_audit, with_approvers,
};

/// A console attached to a running engine.
fn attach(home: &Home, more: &[&str]) -> Console {
    let console = home.console(&[&["run", "--no-tour"], more].concat(), SIZE);
    console.wait_for("it shows the engine", |screen| shows_engine(&screen.contents()));
    console
}

#[test]
fn second_console_attaches_to_the_running_engine() {
    let home = Home::new();
    let mut first = console_on_fresh_store(&home, &[]);
    home.must(&["identity", "new", "mara", "--unprotected"]);
    let mut refused = home.console(&["run", "--no-tour", "--jobs", "1"], SIZE);
    refused.wait_for_text("--jobs applies");
    assert_eq!(refused.end().exit_code(), 2);
    let mut second = attach(&home, &["--as", "mara"]);
    second.wait_for_text("with seat 1 (Overview)");
    first.wait_for_text("with mara (Overview)");
    second.keys("7");
    first.wait_for_text("with mara (Audit)");
    second.keys("1");
    // Each console sees the actions of the other.
    second.keys("X");
    first.wait_for_text("STOPPED by mara");
    second.wait_for_text("STOPPED by mara");
    home.must(&["go", "--as", "mara", "--reason", "the next key"]);
    second.wait_for("the cell runs again", |screen| !screen.contents().contains("STOPPED"));
    second.keys(":pace 2\r");
    second.wait_for("the answer came", |screen| screen.contents().contains("pace"));
    // Leaving asks no question and ends nothing.
    second.keys("q");
    assert_eq!(second.end().exit_code(), 0, "{}", second.contents());
    assert!(second.contents().contains("engine running"), "{}", second.contents());
    assert_restored(&second);
    first.wait_for("mara is gone", |screen| !screen.contents().contains("with mara"));
    assert!(home.must(&["status"]).contains("sim"));
    // A new console gets the events from before it attached.
    let mut third = attach(&home, &[]);
    third.wait_for_text("the cell is stopped by");
    first.wait_for_text("with seat");
    third.keys("q");
    third.end();
    assert_eq!(quit(&mut first), 0);
    verify_audit(&home);
}

#[test]
fn killed_console_detaches_and_the_end_of_the_engine_is_shown() {
    let home = Home::new();
    let mut first = home.console(&["run", "--no-tour", "--jobs=1", "--in-process"], SIZE);
    first.wait_for("the engine is up", |screen| shows_engine(&screen.contents()));
    let mut second = attach(&home, &["--read-only"]);
    first.wait_for_text("with seat 2");
    let third = attach(&home, &[]);
    first.wait_for_text("seat 3");
    third.signal(Signal::KILL);
    first.wait_for("seat 3 is free", |screen| !screen.contents().contains("seat 3"));
    second.keys(":demo\r");
    second.wait_for_text("read-only");
    // This engine ends with its console. That is no crash, and the message names the console.
    first.keys("q");
    first.wait_for_text(" y does it");
    first.keys("y");
    assert_eq!(first.end().exit_code(), 0);
    second.wait_for("whose doing it was", |screen| {
        let text = screen.contents();
        text.contains("ENGINE ENDED") && text.contains("seat 1 ended")
    });
    second.keys("q");
    assert_eq!(second.end().exit_code(), 0, "{}", second.contents());
    let contents = second.contents().replace('\n', "");
    assert!(contents.contains("is gone: "), "{contents}");
}

#[test]
fn a_decision_at_another_console_closes_the_request_and_names_it() {
    let home = home_awaiting_approval();
    let mut alice = open_request(&home, "alice");
    let mut bob = attach(&home, &["--as", "bob"]);
    bob.wait_for_text("1 wait");
    bob.keys("a\r");
    bob.wait_for_text("alice is reading");
    alice.wait_for_text("bob is reading");
    bob.wait_for("the question takes answers", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    bob.keys("N");
    bob.keys("night shift is alone");
    bob.wait_for_text("night shift is alone");
    bob.keys("\t");
    // The letters came as a burst.
    bob.wait_for("the question takes answers again", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    bob.keys("N");
    bob.wait_for_text("Passphrase of bob");
    bob.keys(PASSPHRASE);
    press_until_decided(&mut bob, "\r");
    alice.wait_for_text("bob rejected");
    alice.wait_for_text("CLOSED");
    assert_eq!(state_of(&home, "align@1.1.0"), "rejected");
    bob.keys("1q");
    assert_eq!(bob.end().exit_code(), 0);
    alice.keys("\r");
    assert_eq!(quit(&mut alice), 0);
    verify_audit(&home);
}

/// A store in which a candidate that asks for more authority waits for two approvers.
fn home_awaiting_two_approvals() -> Home {
    let home = with_approvers(Home::new());
    let candidate = home.path().join("wider");
    std::fs::create_dir(&candidate).unwrap();
    for file in ["manifest.toml", "params.toml", "submission.toml"] {
        let text = std::fs::read_to_string(Path::new("manifests/candidates/align-improved").join(file));
        std::fs::write(candidate.join(file), text.unwrap().replace("authority = 1", "authority = 2"))
            .unwrap();
    }
    await_approval(&home, candidate.to_str().unwrap(), "align@1.1.0");
    home
}

/// Fills the fields of the open request and reads it to its end; then Later has the keys again.
pub fn fill_fields(console: &mut Console, id: &str, reason: &str) {
    console.keys("\t");
    console.keys(id);
    console.keys("\t");
    console.keys(reason);
    console.wait_for_text(reason);
    console.keys("\t");
    while console.contents().contains("lines unread") {
        let before = console.contents();
        console.keys("\x1b[6~");
        console.wait_for("the text moves", |screen| screen.contents() != before);
    }
}

/// Approves the open request, with the required digits.
fn promote(console: &mut Console) {
    let id = short_id(console);
    fill_fields(console, &id, "evidence read");
    console.wait_for("the question takes answers", |screen| !screen.contents().contains(WAIT_A_MOMENT));
    console.keys("Y");
    console.wait_for_text("Passphrase of");
    console.keys(PASSPHRASE);
    console.keys("\r");
}

#[test]
fn two_approvers_at_two_consoles_activate_a_version() {
    let home = home_awaiting_two_approvals();
    let mut alice = open_request(&home, "alice");
    let mut bob = attach(&home, &["--as", "bob"]);
    bob.wait_for_text("1 wait");
    bob.keys("a\r");
    bob.wait_for_text("alice is reading");
    promote(&mut bob);
    // One approval of two is not enough, and the other console shows who was first.
    alice.wait_for("the first approval is shown", |screen| {
        screen.contents().split_whitespace().collect::<Vec<_>>().join(" ").contains("1 of 2 (bob)")
    });
    assert_eq!(state_of(&home, "align@1.1.0"), "shadowed");
    promote(&mut alice);
    // A rollback may follow at once at this pace, so only the activation counts.
    let until = std::time::Instant::now() + std::time::Duration::from_mins(2);
    while state_of(&home, "align@1.1.0") == "shadowed" {
        assert!(std::time::Instant::now() < until, "{}", alice.contents());
        std::thread::park_timeout(std::time::Duration::from_millis(50));
    }
    let granted = home.must(&["audit", "list", "--kind", "approval-put", "--json"]);
    let by: Vec<bool> = ["alice", "bob"].map(|name| granted.contains(name)).to_vec();
    assert_eq!((granted.lines().count(), by), (2, vec![true, true]), "{granted}");
    bob.keys("1q");
    assert_eq!(bob.end().exit_code(), 0);
    assert_eq!(quit(&mut alice), 0);
    verify_audit(&home);
}
