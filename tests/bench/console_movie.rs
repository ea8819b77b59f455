//! Makes the console's movie for the README: the program on its own terminal, real keys, real physics.
//!
//!     cargo build --release && cargo run --release --example console_movie [-- --out FILE]
//!
//! Writes `recordings/console.svg`, which moves by CSS alone. Each frame is a whole screen that met a condition; the
//! program waits for no time. The movie shows each frame for its own time.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a tool that shows what there is, or fails"
)]

#[path = "../support/pty.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod pty;
#[path = "console_movie/svg.rs"]
mod svg;

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use holdpoint::wording::console::form;
use pty::{Console, Home};
use svg::{Movie, SIZE};

/// The most bytes that a page may carry.
const BYTES_MAX: usize = 2_000_000;

/// Longer than any stage takes on two busy cores.
const PATIENCE: Duration = Duration::from_mins(5);

const PASSPHRASE: &str = "under the oak";

/// The people who may approve, and their roles: the demonstration needs two of them.
const APPROVERS: [(&str, &str); 2] = [("alice", "engineer"), ("bob", "safety")];

/// The stages in the order of the console's strip.
const STAGES: [&str; 7] = ["register", "validate", "sandbox", "shadow", "gate", "monitor", "confirm"];

const SANDBOX: usize = 2;
const SHADOW: usize = 3;
const MONITOR: usize = 5;

fn main() {
    let out = out_file();
    let mut movie = Movie::new("holdpoint: may this version take control of the robot?");
    in_simulation(&mut movie);
    among_people(&mut movie);
    rejected(&mut movie);
    let svg = movie.to_svg();
    assert!(svg.len() <= BYTES_MAX, "{} bytes; {BYTES_MAX} are allowed", svg.len());
    std::fs::write(&out, &svg).unwrap();
    let (frames, secs) = (movie.frame_count(), movie.secs());
    println!("{}: {} bytes, {frames} frames, {secs:.0} s", out.display(), svg.len());
}

fn out_file() -> PathBuf {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        [] => Path::new(env!("CARGO_MANIFEST_DIR")).join("recordings/console.svg"),
        ["--out", file] => PathBuf::from(file),
        _ => panic!("the only option is --out FILE"),
    }
}

/// A console, and the movie of its screens.
struct MovieScene<'a> {
    console: Console,
    movie: &'a mut Movie,
}

impl<'a> MovieScene<'a> {
    fn open(home: &Home, arguments: &[&str], movie: &'a mut Movie) -> Self {
        let console = home.console_with(arguments, SIZE, &[("COLORTERM", "truecolor")]);
        Self { console, movie }
    }

    /// Waits until a whole frame meets a condition, and shows it for this time with a caption.
    fn show(&mut self, secs: f64, caption: &str, is: impl Fn(&str) -> bool) {
        let screen = self.console.screen_when(PATIENCE, caption, |screen| is(&screen.contents()));
        self.movie.add(&screen, caption, secs);
    }

    fn wait(&self, what: &str, is: impl Fn(&str) -> bool) {
        self.console.wait_for_within(PATIENCE, what, |screen| is(&screen.contents()));
    }

    fn keys(&mut self, keys: &str) {
        self.console.keys(keys);
    }

    /// The text of a whole frame.
    fn text(&self) -> String {
        self.console.screen_when(PATIENCE, "a whole frame", |_| true).contents()
    }

    /// Shows a stage at its beginning and further on.
    fn show_stage(&mut self, stage: usize, caption: &str, shares: &[f64]) {
        for share in shares {
            self.show(1.5, caption, |text| progress(text) >= (stage, *share));
        }
    }

    /// Opens the request under the cursor: the engine gives each approver a text of their own.
    fn open_request(&mut self, approver: &str, secs: f64, caption: &str) {
        self.keys("\r");
        self.show(secs, caption, |text| text.contains(&format!("You are asked as {approver}")));
    }

    /// Scrolls to the end of the open request: only a text that was on the screen can be approved.
    fn read_to_the_end(&mut self) {
        loop {
            let text = self.text();
            let Some(unread) = text.lines().find(|line| line.contains("lines unread")) else { return };
            let unread = unread.to_owned();
            self.keys("\x1b[6~");
            self.wait("the next lines", |text| !text.contains(&unread));
        }
    }

    /// Fills the fields of the open request; then its deciding key is offered.
    fn fill_fields(&mut self, reason: &str) {
        let text = self.text();
        let (_, after) = text.split_once("short id ").expect("the request has the field");
        let (_, after) = after.split_once('(').expect("the digits are beside the field");
        let digits: String = after.chars().take_while(char::is_ascii_hexdigit).collect();
        self.keys(&format!("\t{digits}\t{reason}\t"));
    }

    /// Signs the open request with the passphrase.
    fn sign(&mut self, approver: &str, caption: &str) {
        self.keys("Y");
        self.wait("the passphrase field", |text| text.contains(&format!("Passphrase of {approver}")));
        self.keys(PASSPHRASE);
        self.show(1.5, caption, |text| text.contains(&"*".repeat(PASSPHRASE.len())));
        self.keys("\r");
        self.wait("the answered request", |text| !text.contains("Decide on"));
    }

    /// Ends the console and its engine.
    fn end(mut self) {
        self.keys("1q");
        self.wait("the question", |text| text.contains(" y does it"));
        self.keys("y");
        self.console.end();
    }
}

/// The place of the present stage of the first candidate, and the share of it that is done.
fn progress(text: &str) -> (usize, f64) {
    let stage = STAGES.iter().take_while(|stage| text.contains(&format!("✔{stage}"))).count();
    let counts = text.lines().filter(|line| line.contains(['█', '░'])).find_map(|line| {
        let parts: Vec<&str> = line.split_whitespace().collect();
        parts.windows(3).find_map(|part| match part {
            [done, "of", all] => Some(done.parse::<f64>().ok()? / all.parse::<f64>().ok()?),
            _ => None,
        })
    });
    (stage, counts.unwrap_or(0.0))
}

/// A version passes every stage, and an operator stops the cell and starts it again.
fn in_simulation(movie: &mut Movie) {
    let home = Home::new();
    home.must(&["identity", "new", "ana", "--role", "engineer", "--unprotected"]);
    let mut scene = MovieScene::open(&home, &["run", "--as", "ana", "--no-tour", "--pace", "8"], movie);
    scene.show(2.0, "The simulated cell runs its active versions. No new version waits.", |text| {
        text.contains("No candidate yet") && text.contains("ana (engineer)")
    });
    let command = ":demo align-improved";
    scene.keys(command);
    scene.show(1.5, "`:demo` submits a better version of the skill align.", |text| text.contains(command));
    scene.keys("\r");
    let caption = "Sandbox: paired episodes and recovery drills, compared with the active version.";
    scene.show_stage(SANDBOX, caption, &[0.01, 0.3, 0.6, 0.9]);
    let caption = "Shadow: the candidate sees what the live cell sees, and moves nothing.";
    scene.show_stage(SHADOW, caption, &[0.01, 0.35, 0.7]);
    scene.show(2.5, "The gate passed it: it has control, provisionally, and a monitor watches it.", |text| {
        progress(text).0 >= MONITOR && text.contains("back: 1")
    });
    scene.show(2.5, "Confirmed. The former version stays loaded as the rollback target.", |text| {
        text.contains("✔confirm")
    });
    stop_and_start(&mut scene);
    scene.end();
}

fn stop_and_start(scene: &mut MovieScene<'_>) {
    scene.keys("X");
    scene.show(3.0, "X stops the arm at once. The console asks nothing first.", |text| {
        text.contains("STOPPED by ana")
    });
    scene.keys("W");
    scene.wait("the form", |text| text.contains(form::START_THE_STOPPED_CELL));
    let reason = "the tray is clear, the fence is closed";
    scene.keys(reason);
    scene.keys("\t\t");
    scene.show(2.5, "W starts it again, with a name and a reason.", |text| {
        text.contains(reason) && text.contains(&format!("▸[{}]", form::START_THE_CELL))
    });
    scene.keys("\r");
    scene.show(2.0, "The arm moves again. Stop and start are on record.", |text| !text.contains("STOPPED"));
}

/// Two people approve a version; one is not enough.
fn among_people(movie: &mut Movie) {
    let home = home_awaiting_approval();
    let arguments = ["run", "--profile", "human", "--as", "alice", "--no-tour", "--pace", "8"];
    let mut scene = MovieScene::open(&home, &arguments, movie);
    scene.show(2.5, "Beside people: nothing is activated without signed approvals.", |text| {
        text.contains("alice (engineer)") && text.contains("1 wait") && text.contains("0 of 2")
    });
    scene.keys("a");
    scene.wait("the queue", |text| text.contains("[6 Approvals]"));
    let caption = "The request has all evidence with its limits, and what was not tested.";
    scene.open_request("alice", 3.5, caption);
    scene.read_to_the_end();
    scene.fill_fields("evidence read");
    scene.show(2.5, "An approver reads it to its end, types the short id, and gives a reason.", |text| {
        text.contains("evidence read") && text.contains("Y approve")
    });
    scene.sign("alice", "The passphrase of alice signs exactly this text.");
    scene.show(2.0, "One of two: another person has to approve as well.", |text| text.contains("1 of 2"));
    scene.keys(":as bob\r");
    scene.wait("bob", |text| text.contains("bob (safety)"));
    let caption = "bob, a safety officer, reads the same evidence.";
    scene.open_request("bob", 2.0, caption);
    scene.read_to_the_end();
    scene.fill_fields("read as well");
    scene.wait("the deciding key", |text| text.contains("Y approve"));
    scene.sign("bob", "The quorum counts two different people with two different keys.");
    scene.keys("1");
    scene.show(3.0, "Approved twice: it takes control at the end of a sequence.", |text| {
        progress(text).0 >= MONITOR && text.contains("back: 1")
    });
    scene.end();
}

/// A store with two approvers, in which a candidate waits for them.
fn home_awaiting_approval() -> Home {
    let home = Home::new();
    let file = home.path().join("passphrase");
    std::fs::write(&file, PASSPHRASE).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    let file = file.to_str().unwrap();
    for (name, role) in APPROVERS {
        home.must(&["identity", "new", name, "--role", role, "--passphrase-file", file]);
    }
    home.must(&["identity", "passphrase", "admin", "--new-passphrase-file", file]);
    for (name, _) in APPROVERS {
        let by = ["--by", "admin", "--reason", "known", "--passphrase-file", file];
        home.must(&[&["identity", "confirm", name][..], &by].concat());
    }
    let script = home.path().join("wait.toml");
    let steps = "profile = \"human\"\n\
        [[step]]\nregister = \"manifests/candidates/align-improved\"\n\
        [[step]]\nwait = { prompt = \"align@1.1.0\", timeout_s = 20000 }\n";
    std::fs::write(&script, steps).unwrap();
    let output = home.run(&["run", "--headless", "--script", script.to_str().unwrap()]);
    // On hold: it waits for its approvers.
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    home
}

/// A version that no policy permits ends before it runs.
fn rejected(movie: &mut Movie) {
    let home = Home::new();
    let mut scene = MovieScene::open(&home, &["run", "--no-tour"], movie);
    scene.wait("the engine", |text| text.contains("No candidate yet"));
    scene.keys(":demo grasp-direct-bus\r");
    scene.show(2.5, "A version that asks for direct access to the actuators is rejected.", |text| {
        text.contains("✖ rejected")
    });
    scene.keys("3");
    scene.show(4.0, "Its card names the code of the reason. It never ran an episode.", |text| {
        text.contains("[3 Candidate]") && text.contains("policy-uncovered")
    });
    scene.end();
}
