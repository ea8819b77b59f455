//! A second console on a store that another engine holds: it shows nothing of it, and what stops reaches that engine.

use crate::pty::Home;
use crate::{SIZE, assert_restored, fresh, quit};

/// Exit code of whatever cannot use the store.
const USAGE: u32 = 2;

#[test]
fn a_second_console_stops_the_engine_that_has_the_store_and_does_nothing_else() {
    let home = Home::new();
    let mut first = fresh(&home, &[]);
    home.must(&["identity", "new", "mara", "--unprotected"]);
    let mut second = home.console(&["run", "--no-tour", "--jobs=1", "--as", "mara"], SIZE);
    second.wait_for_text("NO ENGINE HERE: another one holds the store");
    second.wait_for_text("is in use by");
    // Whoever was named sits here, with or without an engine.
    second.wait_for_text("mara (operator)");
    second.keys(":demo\r");
    second.wait_for_text("no engine is at work here");
    assert!(!home.must(&["status"]).contains("STOPPED"));
    for key in ["X", "\x1b[20~"] {
        second.keys(key);
        second.wait_for_text("the engine at work, in another process: the cell is stopped, by mara");
        first.wait_for_text("STOPPED by mara");
        assert!(home.must(&["status"]).contains("STOPPED  by mara"));
        home.must(&["go", "--as", "mara", "--reason", "the next key"]);
        second.keys(":pace 2\r");
        second.wait_for_text("no engine is at work here");
    }
    // The other one ends, and there is nobody left to stop anything.
    assert_eq!(quit(&mut first), 0);
    second.keys("X");
    second.wait_for_text("no engine is at work on this store");
    second.keys("q");
    assert_eq!(second.end().exit_code(), USAGE, "{}", second.contents());
    assert!(second.contents().contains("the engine did not come up"), "{}", second.contents());
    assert_restored(&second);
}
