//! A console on a store whose engine shows itself to no console (a plain stream's): only a stop reaches that engine.

use rustix::process::Signal;

use crate::{SIZE, assert_restored, home_awaiting_approval, passphrase_file, stop_of};

/// Exit code of a program that cannot use the store.
const EXIT_USAGE: u32 = 2;

#[test]
fn second_console_can_only_stop_the_engine_of_a_plain_stream() {
    let home = home_awaiting_approval();
    let secret_file = passphrase_file(&home);
    let mut first = home.console(&["run", "--plain", "--profile", "human", "--jobs=1", "--pace", "1"], SIZE);
    first.wait_for_text("align@1.1.0");
    let mut second = home.console(&["run", "--no-tour", "--as", "alice"], SIZE);
    second.wait_for_text("NO ENGINE");
    second.wait_for_text("in use by");
    // The named operator is shown, with or without an engine.
    second.wait_for_text("alice (engineer)");
    second.keys(":demo\r");
    second.wait_for_text("here. Hint:");
    assert!(stop_of(&home).is_null());
    for key in ["X", "\x1b[20~"] {
        second.keys(key);
        second.wait_for_text("the cell is stopped");
        assert_eq!(stop_of(&home)["by"], "alice");
        let go = [
            "go",
            "--stops",
            "1",
            "--as",
            "alice",
            "--reason",
            "the next key",
            "--passphrase-file",
            &secret_file,
        ];
        home.must(&go);
        second.keys(":pace 2\r");
        second.wait_for_text("here. Hint:");
    }
    // The other engine ends: there is no arm left to stop.
    first.signal(Signal::TERM);
    first.end();
    second.keys("X");
    second.wait_for_text("on this store");
    second.keys("q");
    assert_eq!(second.end().exit_code(), EXIT_USAGE, "{}", second.contents());
    assert!(second.contents().contains("not come"), "{}", second.contents());
    assert_restored(&second);
}
