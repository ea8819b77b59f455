//! The engine of a console that found none: a separate process. It ends with its last console, keeps running only on
//! request, and does not outlive a killed console.

use std::fs;
use std::time::{Duration, Instant};

use holdpoint::store::{Layout, lock_owner};
use rustix::process::{Pid, Signal, kill_process};

use crate::pty::{Console, Home, PATIENCE};
use crate::{SIZE, assert_restored, quit, shows_engine, verify_audit};

/// A console that starts an engine which keeps running without a console for `linger` seconds.
fn start_with_linger(home: &Home, linger: &str) -> Console {
    let console = home.console(&["run", "--no-tour", "--jobs=1", "--linger", linger], SIZE);
    console.wait_for("the engine is up", |screen| shows_engine(&screen.contents()));
    console
}

/// The engine's process, from the lock of its store.
fn engine_process(home: &Home) -> i32 {
    let owner = fs::read_to_string(home.data().join("engine.lock")).unwrap();
    owner.split(' ').nth(1).unwrap().parse().unwrap()
}

/// State, session and terminal of a process; absent if there is none.
fn process_state(id: i32) -> Option<(String, i32, i32)> {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    Some((fields[0].to_owned(), fields[3].parse().ok()?, fields[4].parse().ok()?))
}

fn is_gone(id: i32) -> bool {
    process_state(id).is_none_or(|(state, ..)| state == "Z")
}

/// Waits for the end of the engine, and looks at the store meanwhile as a user would.
fn wait_for_end(home: &Home, id: i32) {
    let until = Instant::now() + PATIENCE;
    while !is_gone(id) {
        assert!(Instant::now() < until, "the engine keeps running without a console");
        home.run(&["status"]);
    }
}

fn send_signal(id: i32, signal: Signal) {
    kill_process(Pid::from_raw(id).unwrap(), signal).unwrap();
}

#[test]
fn a_console_starts_an_engine_in_a_session_of_its_own_and_ends_it() {
    let home = Home::new();
    let mut console = start_with_linger(&home, "60");
    let id = engine_process(&home);
    assert_ne!(u32::try_from(id).unwrap(), console.id());
    assert_eq!(process_state(id).map(|(_, session, terminal)| (session, terminal)), Some((id, 0)));
    console.wait_for_text("q end engine");
    assert_eq!(quit(&mut console), 0, "{}", console.contents());
    assert!(console.contents().contains("down cleanly"), "{}", console.contents());
    assert_restored(&console);
    let owner = lock_owner(&Layout::new(home.data())).unwrap();
    assert_eq!(owner, None, "the store is free when the console has ended");
    wait_for_end(&home, id);
    verify_audit(&home);
    // It can be started again at once.
    let mut again = start_with_linger(&home, "60");
    assert_eq!(quit(&mut again), 0);
}

#[test]
fn a_detached_engine_runs_without_a_console() {
    let home = Home::new();
    let mut console = start_with_linger(&home, "1");
    let id = engine_process(&home);
    console.keys(":detach\r");
    assert_eq!(console.end().exit_code(), 0);
    assert!(console.contents().contains("engine running"), "{}", console.contents());
    assert_restored(&console);
    let until = Instant::now() + Duration::from_secs(3);
    while Instant::now() < until {
        home.must(&["status"]);
        assert!(!is_gone(id), "it was asked to keep running");
    }
    // A returning console attaches to the same engine, and leaves it running.
    let mut back = home.console(&["run", "--no-tour"], SIZE);
    back.wait_for_text("q leave");
    assert_eq!(engine_process(&home), id);
    back.keys("q");
    assert_eq!(back.end().exit_code(), 0);
    assert!(!is_gone(id));
    send_signal(id, Signal::TERM);
    wait_for_end(&home, id);
    verify_audit(&home);
}

#[test]
fn engine_ends_after_its_console_is_killed_or_loses_its_terminal() {
    for is_killed in [true, false] {
        let home = Home::new();
        let mut console = start_with_linger(&home, "1");
        let id = engine_process(&home);
        if is_killed {
            console.signal(Signal::KILL);
            console.end();
        } else {
            console.hang_up();
        }
        wait_for_end(&home, id);
        verify_audit(&home);
    }
}

#[test]
fn only_the_last_console_ends_the_engine() {
    let home = Home::new();
    let mut first = start_with_linger(&home, "60");
    let id = engine_process(&home);
    let mut second = home.console(&["run", "--no-tour"], SIZE);
    second.wait_for_text("q leave");
    first.wait_for_text("q leave");
    first.keys("q");
    assert_eq!(first.end().exit_code(), 0);
    assert!(first.contents().contains("engine running"), "{}", first.contents());
    second.wait_for_text("q end engine");
    assert_eq!(quit(&mut second), 0);
    // The engine is not the console's child: the console asks it to end, and does not wait for the process.
    wait_for_end(&home, id);
    verify_audit(&home);
}

/// Of two consoles started at once, one reported that no engine was running, and stayed with that.
#[test]
fn consoles_started_together_attach_to_one_engine() {
    let home = Home::new();
    let arguments = ["run", "--no-tour", "--jobs=1"];
    let both = [home.console(&arguments, SIZE), home.console(&arguments, SIZE)];
    for console in &both {
        console.wait_for("it is up", |screen| {
            shows_engine(&screen.contents()) && screen.contents().contains("with seat")
        });
    }
    let [mut one, mut other] = both;
    one.keys("q");
    assert_eq!(one.end().exit_code(), 0);
    other.wait_for_text("q end engine");
    assert_eq!(quit(&mut other), 0);
    verify_audit(&home);
}

#[test]
fn a_dead_engine_is_shown_and_the_next_one_is_attached_to() {
    let home = Home::new();
    let mut console = start_with_linger(&home, "60");
    let id = engine_process(&home);
    console.keys("7");
    console.wait_for_text("[7 Audit]");
    send_signal(id, Signal::KILL);
    console.wait_for_text("ENGINE GONE");
    console.wait_for_text("looks again");
    let mut service = home.console(&["serve", "--quiet", "--jobs=1"], SIZE);
    console.wait_for_text("attached to");
    console.wait_for("it shows the engine, and the place is the same", |screen| {
        let text = screen.contents();
        shows_engine(&text) && !text.contains("ENGINE GONE") && text.contains("[7 Audit]")
    });
    console.keys("1q");
    assert_eq!(console.end().exit_code(), 0, "{}", console.contents());
    service.signal(Signal::TERM);
    service.end();
    verify_audit(&home);
}

#[test]
fn error_of_an_engine_that_does_not_start_is_shown() {
    let home = Home::new();
    let mut console = home.console(&["run", "--no-tour", "--robot", "nowhere.urdf"], SIZE);
    console.wait_for_text("No engine");
    console.wait_for_text("nowhere.urdf");
    console.keys("q");
    assert_eq!(console.end().exit_code(), 2);
    let contents = console.contents().replace('\n', "");
    assert!(contents.contains("not come") && contents.contains("nowhere.urdf"), "{contents}");
    assert_restored(&console);
}

/// A stop sent to a hung engine was shown as under way, and then forgotten; when the engine continued, the arm moved
/// and the stop was never carried out.
#[test]
fn hung_engine_is_named_and_carries_out_the_stop_once_it_answers() {
    let home = Home::new();
    let mut console = start_with_linger(&home, "60");
    let id = engine_process(&home);
    send_signal(id, Signal::STOP);
    console.keys("X");
    console.wait_for_text("NOT ANSWERED");
    console.wait_for_text("physical stop");
    console.wait_for_text("NOT CONFIRMED");
    // A new console shows which engine holds the store, and what stopped it.
    let mut other = home.console(&["run", "--no-tour"], SIZE);
    other.wait_for_text("No engine");
    other.wait_for_text(&format!("process {id}, "));
    other.wait_for_text("signal stopped");
    send_signal(id, Signal::CONT);
    other.wait_for("it attaches after all", |screen| shows_engine(&screen.contents()));
    console.wait_for("it is stopped, and the screen shows it", |screen| {
        let text = screen.contents();
        text.contains("STOPPED by") && !text.contains("STOP NOT")
    });
    other.keys("q");
    assert_eq!(other.end().exit_code(), 0);
    assert_eq!(quit(&mut console), 0);
    verify_audit(&home);
}

/// A read-only console started an engine, whose arm moved, and ended it.
#[test]
fn a_read_only_console_starts_and_ends_no_engine() {
    let home = Home::new();
    let mut alone = home.console(&["run", "--no-tour", "--read-only"], SIZE);
    alone.wait_for_text("a read-only console starts none");
    alone.keys("q");
    assert_eq!(alone.end().exit_code(), 2);
    assert!(!home.data().join("engine.lock").exists(), "no engine was started");
    let mut first = start_with_linger(&home, "60");
    let id = engine_process(&home);
    let mut reader = home.console(&["run", "--no-tour", "--read-only"], SIZE);
    reader.wait_for_text("q leave");
    first.signal(Signal::KILL);
    first.end();
    reader.wait_for("it is the last console", |screen| {
        screen.contents().lines().nth(1).is_some_and(|views| !views.contains("with "))
    });
    reader.keys("q");
    assert_eq!(reader.end().exit_code(), 0);
    assert!(!is_gone(id), "the engine keeps running");
    send_signal(id, Signal::TERM);
    wait_for_end(&home, id);
}
