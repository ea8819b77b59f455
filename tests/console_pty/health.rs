//! Health over time on an attached console: read over the socket, exported to files, and both clocks in the first
//! line.

use crate::pty::Home;
use crate::{SIZE, console_on_fresh_store, quit, shows_engine};

#[test]
fn health_is_shown_on_an_attached_console_and_exported() {
    let home = Home::new();
    let mut first = console_on_fresh_store(&home, &[]);
    let mut second = home.console(&["run", "--no-tour"], SIZE);
    second.wait_for("it shows the engine", |screen| shows_engine(&screen.contents()));
    second.keys("8");
    second.wait_for_text("No live task");
    first.wait_for_text("(Health)");
    second.wait_for("both clocks and the pace", |screen| {
        let line = screen.contents().lines().next().unwrap_or_default().to_owned();
        line.contains(" UTC  pace 1x ") && line.contains(" engine 00:")
    });
    second.keys("-");
    second.wait_for_text("is 30 min");
    // What happened at the start lies in the newest column.
    second.wait_for_text("first version: ");
    second.keys("\x13");
    second.wait_for_text("exported");
    second.wait_for_text(".csv");
    second.keys("5\t");
    second.wait_for_text("Alarms of");
    second.wait_for_text("No alarm");
    second.keys("qqq");
    assert_eq!(second.end().exit_code(), 0, "{}", second.contents());
    assert_eq!(quit(&mut first), 0);
}
