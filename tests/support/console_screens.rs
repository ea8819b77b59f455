//! Prints the console's main views as a user sees them: the program on its own terminal, real keys, real physics. The
//! README's screens come from here.
//!
//!     cargo build --release && cargo run --release --example console_screens
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a tool that shows what there is, or fails"
)]

#[path = "pty.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod pty;

use pty::{Console, Home};

/// Wide enough for every pane.
const WIDE: (u16, u16) = (120, 36);

/// A common terminal.
const COMMON: (u16, u16) = (80, 24);

fn main() {
    in_simulation();
    among_people();
}

/// The demonstration, from the first screen to the twin beside the live arm.
fn in_simulation() {
    let home = Home::new();
    home.must(&["identity", "new", "ana", "--role", "engineer", "--unprotected"]);
    let mut console = home.console(&["run", "--as", "ana", "--pace", "8"], WIDE);
    console.wait_for_text(":demo");
    show("first use", &console);
    console.keys(":demo\r");
    console.keys(".");
    console.wait_for("a third of the sandbox", |screen| screen.contents().contains("160 of 480"));
    show("overview, a candidate in the sandbox", &console);
    console.wait_for("most of the sandbox", |screen| screen.contents().contains("380 of 480"));
    console.wait_for("some of the shadow", |screen| screen.contents().contains("8 of 20"));
    console.wait_for("the twin beside the arm", |screen| screen.contents().contains("twin, dashed"));
    show("overview, a candidate in shadow", &console);
    for (key, title, filled) in [
        ("4", "[4 Shadow]", "Output divergence"),
        ("3", "[3 Candidate]", "Timeline"),
        ("2", "[2 Registry]", "versions"),
        ("7", "[7 Audit]", "Record"),
    ] {
        console.keys(key);
        console.wait_for(title, |screen| {
            let text = screen.contents();
            text.contains(title) && text.contains(filled) && text.contains("1.1.0")
        });
        show(title, &console);
    }
    console.resize(COMMON.0, COMMON.1);
    console.keys("1");
    console.wait_for_repainted("the small overview", COMMON, |screen| {
        let text = screen.contents();
        text.contains("[1 Overview]") && text.contains("q quit")
    });
    show("overview at 80x24", &console);
    end(console);
}

/// A candidate that waits for two approvers, and an open prompt.
fn among_people() {
    let home = Home::new();
    for name in ["ana", "bo"] {
        home.must(&["identity", "new", name, "--role", "engineer", "--unprotected"]);
    }
    let script = home.path().join("wait.toml");
    let steps = "profile = \"human\"\n\
        [[step]]\nregister = \"manifests/candidates/align-improved\"\n\
        [[step]]\nwait = { prompt = \"align@1.1.0\", timeout_s = 20000 }\n";
    std::fs::write(&script, steps).unwrap();
    let output = home.run(&["run", "--headless", "--script", script.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let mut console = home.console(&["run", "--profile", "human", "--as", "ana", "--no-tour"], WIDE);
    console.wait_for_text("1 wait");
    console.keys("a");
    console.wait_for_text("[6 Approvals]");
    show("approvals", &console);
    console.keys("\r");
    console.wait_for_text("Decide on");
    show("the prompt, profile human", &console);
    console.keys("\x1b");
    console.wait_for("the prompt is closed", |screen| !screen.contents().contains("Decide on"));
    console.keys("5");
    console.wait_for_text("[5 Alarms]");
    show("alarms", &console);
    end(console);
}

fn show(name: &str, console: &Console) {
    // Never half a frame: each ends with the end of a synchronized update.
    console.wait_for_bytes("a whole frame", |bytes| bytes.ends_with(b"\x1b[?2026l"));
    println!("## {name}\n\n```text");
    for line in console.contents().lines() {
        println!("{}", line.trim_end());
    }
    println!("```\n");
}

fn end(mut console: Console) {
    console.keys("1q");
    console.wait_for_text(" y does it");
    console.keys("y");
    console.end();
}
