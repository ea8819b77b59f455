//! What the verbs and the plain stream print about engines: none that runs, notes of a run, marks for a service manager.

use std::fmt::Display;

use crate::counted;
use holdpoint_protocol::snapshot::StartupProgressView;

/// A repeated stage waits for an engine.
pub const STAGE_WAITS: &str = "no engine is running; `holdpoint run` runs the stage";

/// A registered candidate waits for an engine.
pub const CANDIDATE_WAITS: &str =
    "no engine is running; `holdpoint run` or `holdpoint serve` takes it through the stages";

/// A started cell waits for an engine.
pub const START_WAITS: &str = "no engine is running; the cell runs once one starts";

/// A version that takes control when the cell runs.
#[must_use]
pub fn takes_control(version: impl Display) -> String {
    format!("{version} is approved and takes control once the cell runs")
}

/// A console that uses the engine of another one, so the options of a start have no effect.
#[must_use]
pub fn attached_to_other(options: &str) -> String {
    format!("attached to an engine that another console started first; {options} has no effect")
}

/// A console that has its engine in its own process.
#[must_use]
pub fn engine_inside_console(error: impl Display) -> String {
    format!("the engine runs inside this console and ends with it: cannot start a process ({error})")
}

/// The page for typed commands.
pub const TYPE_COMMANDS: &str = "enter commands here, one verb a line: `help` lists them, `quit` ends";

/// The help for typed commands.
#[must_use]
pub fn typed_commands(verbs: &[&str]) -> String {
    format!("a line is a verb of holdpoint with its arguments: {}; `quit` ends this run", verbs.join(", "))
}

/// An end that waits for earlier commands.
pub const ENDS_AFTER_COMMANDS: &str = "the run ends after the earlier commands";

/// Lines of a verb that are not printed.
#[must_use]
pub fn more_lines(more: usize) -> String {
    format!("  and {}", counted(more, "more line"))
}

/// The end of a verb with a failure.
#[must_use]
pub fn ended_with(verb: &str, code: Option<i32>) -> String {
    let code = code.map_or_else(|| "a signal".to_owned(), |code| format!("code {code}"));
    format!("  {verb}: ended with {code}")
}

/// A record that is still read.
#[must_use]
pub fn verifying(reading: Option<StartupProgressView>) -> String {
    format!("the record is being verified; {}", startup_progress(reading))
}

/// How far a starting engine has read its record; empty if it is unknown.
#[must_use]
pub fn startup_progress(of: Option<StartupProgressView>) -> String {
    of.map_or_else(String::new, |StartupProgressView { read, of }| {
        format!("not verified yet: {read} of {of} records read")
    })
}

/// An engine that was ended while it read its record.
pub const ENDED_BEFORE_START: &str = "ended before the engine started; no command ran";

/// An engine that ended on request.
pub const ENDED_CLEANLY: &str = "ended cleanly";

/// An engine that ended on request after a fault.
pub const ENDED_HALTED: &str = "ended; the engine had halted because of a fault";

/// A demonstration without a candidate that is left.
pub const NO_DEMONSTRATION_LEFT: &str =
    "every demonstration candidate is registered; `holdpoint candidate register` registers others";

/// The candidate of a demonstration.
#[must_use]
pub fn submits_demonstration(name: &str) -> String {
    format!("submitting the demonstration candidate {name}")
}

/// A run without a version to judge.
pub const NO_VERSION_WAITS: &str =
    "nothing was judged: no version waits; `holdpoint candidate register` submits one";

/// A scenario without a version to judge.
pub const NO_VERSION_SUBMITTED: &str = "nothing was judged: no version was submitted";

/// A step of a scenario whose time is over.
#[must_use]
pub fn timed_out(step: usize) -> String {
    format!("step {step} timed out")
}

/// A version that an interrupted scenario registered.
#[must_use]
pub fn registered_by_interrupted(version: impl Display, state: impl Display) -> String {
    format!("{version} is already registered by an interrupted run; it continues from {state}")
}

/// Events that the reader of a stream did not take in time.
#[must_use]
pub fn missed_events(missed: u64) -> String {
    format!("not printed: {}, as the reader is too slow", counted(missed, "event"))
}

/// The mark of an engine that ends, in the protocol of service managers.
pub const SERVICE_STOPPING: &str = "STOPPING=1\nSTATUS=ending cleanly";

/// The state of a halted engine, for a service manager.
#[must_use]
pub fn halted(why: impl Display) -> String {
    format!("halted after a fault: {why}")
}

/// The state of an engine, for a service manager.
#[derive(Clone, Copy, Debug)]
pub struct ServiceCounts {
    /// Families with an active version.
    pub active: usize,
    /// All families.
    pub families: usize,
    /// Candidates without an end.
    pub open: usize,
    /// Requests and questions that wait for people.
    pub waiting: usize,
    /// Open alarms.
    pub alarms: usize,
}

/// The state of an engine with its profile, for a service manager.
#[must_use]
pub fn service_status(profile: &str, of: ServiceCounts) -> String {
    let ServiceCounts { active, families, open, waiting, alarms } = of;
    format!(
        "{profile}, {active} of {families} families active, {} open, {waiting} waiting for approval, {}",
        counted(open, "candidate"),
        counted(alarms, "alarm")
    )
}

/// The line of a benchmark that names the build.
#[must_use]
pub fn bench_heading(version: &str, build: &str, robot: &str) -> String {
    format!("holdpoint {version}, {build} build, robot {robot}, rules f64, one worker")
}

/// The pages of the manual in a folder.
#[must_use]
pub fn wrote_pages(pages: usize, folder: impl Display) -> String {
    format!("wrote {pages} pages to {folder}")
}
