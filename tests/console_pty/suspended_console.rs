//! A console whose terminal another program changed, as a shell does while the console is suspended.

use rustix::process::Signal;

use crate::pty::{Console, Home};
use crate::{assert_restored, console_on_fresh_store, quit};

/// After `fg` the screen offered `X stop`, while the terminal collected lines and no key arrived.
#[test]
fn a_suspended_console_takes_the_terminal_back() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[]);
    let screens = |console: &Console| console.raw().matches("\x1b[?1049h").count();
    let before = screens(&console);
    console.signal(Signal::STOP);
    console.cook();
    console.signal(Signal::CONT);
    console.wait_for_bytes("the screen is taken again", |raw| {
        String::from_utf8_lossy(raw).matches("\x1b[?1049h").count() > before
    });
    assert!(!console.is_cooked(), "keys come one by one");
    // Another program may change the settings without a signal.
    let before = screens(&console);
    console.cook();
    console.wait_for_bytes("the screen is taken once more", |raw| {
        String::from_utf8_lossy(raw).matches("\x1b[?1049h").count() > before
    });
    assert!(!console.is_cooked(), "keys come one by one");
    console.keys("X");
    console.wait_for_text("STOPPED by");
    assert_eq!(quit(&mut console), 0);
    assert_restored(&console);
}
