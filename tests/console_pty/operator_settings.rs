//! The operator's own settings: a name, keys and themes that change while the console is open, the mouse.

use crate::pty::Home;
use crate::{console_on_fresh_store, quit};

#[test]
fn as_command_creates_an_identity_and_switches_to_it() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[]);
    console.keys(":as zoe\r");
    console.wait_for_text("the identity zoe");
    console.keys("n");
    console.wait_for("the form is closed", |screen| !screen.contents().contains("Make the"));
    assert_eq!(home.must(&["identity", "list", "--json"]).matches("zoe").count(), 0);
    console.keys(":as zoe\r");
    console.wait_for_text("y does it");
    console.wait_for("the form takes keys", |screen| screen.contents().contains("Make it"));
    // Keys of the first moments confirm nothing.
    let until = std::time::Instant::now() + crate::pty::PATIENCE;
    while !console.contents().contains("zoe (operator)") {
        assert!(std::time::Instant::now() < until, "{}", console.contents());
        if console.contents().contains("y does it") {
            console.keys("y");
        }
        std::thread::park_timeout(std::time::Duration::from_millis(5));
    }
    console.wait_for_text("zoe (operator)");
    assert!(home.must(&["identity", "list", "--json"]).contains("zoe"));
    assert_eq!(quit(&mut console), 0);
}

#[test]
fn changed_keys_and_themes_are_reloaded_and_a_broken_file_changes_nothing() {
    let home = Home::new();
    let own = home.path().join("config/holdpoint");
    std::fs::create_dir_all(own.join("themes")).unwrap();
    let mut console = console_on_fresh_store(&home, &[]);
    std::fs::write(own.join("keys.toml"), "[keys]\nalarms = [\"f5\"]\n").unwrap();
    std::fs::write(own.join("themes/dusk.toml"), "inherits = \"mono\"\n").unwrap();
    console.wait_for_text("are reloaded");
    console.keys("\x1b[15~");
    console.wait_for_text("[5 Alarms]");
    console.keys(":theme dusk\r");
    console.keys("1");
    std::fs::write(own.join("keys.toml"), "[keys]\nfly = [\"f6\"]\n# another length\n").unwrap();
    console.wait_for_text("not loaded");
    console.keys("\x1b[15~");
    console.wait_for_text("[5 Alarms]");
    assert_eq!(quit(&mut console), 0);
}

#[test]
fn click_opens_a_view_once_the_mouse_is_enabled() {
    let home = Home::new();
    let mut console = console_on_fresh_store(&home, &[]);
    console.keys("M");
    console.wait_for_bytes("the mouse is taken", |bytes| {
        let taken = b"\x1b[?1006h";
        bytes.windows(taken.len()).any(|window| window == taken)
    });
    let line = console.contents().lines().nth(1).unwrap_or_default().to_owned();
    let column = line.find("7 Audit").expect("the views' line") + 2;
    console.keys(&format!("\x1b[<0;{column};2M\x1b[<0;{column};2m"));
    console.wait_for_text("[7 Audit]");
    assert_eq!(quit(&mut console), 0);
}

#[test]
fn a_path_is_completed_through_a_menu() {
    let home = Home::new();
    for name in ["grasp-a", "grasp-b"] {
        std::fs::create_dir_all(home.path().join("shop").join(name)).unwrap();
    }
    let mut console = console_on_fresh_store(&home, &[]);
    console.keys(":register shop/gr");
    console.keys("\t");
    console.wait_for_text(":register shop/grasp-a/");
    console.keys("\t");
    console.wait_for_text(":register shop/grasp-b/");
    console.keys("\x1b");
    console.wait_for("what was typed stands there again", |screen| {
        screen
            .contents()
            .lines()
            .any(|line| line.trim_start().starts_with(":register shop/gr") && !line.contains("grasp"))
    });
    console.keys("\x03");
    assert_eq!(quit(&mut console), 0);
}
