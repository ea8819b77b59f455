//! What `skill` prints: a new folder, a built component, the report of a test.

use std::fmt::Display;

use holdpoint_body::CodeFault;

use crate::counted;

/// A new folder, and the next step.
#[must_use]
pub fn wrote_skill(folder: &str) -> [String; 2] {
    [
        format!("wrote {folder}: a working grasp with its manifest and sources"),
        format!("next: holdpoint skill build {folder}"),
    ]
}

/// A built component, and the next step.
#[must_use]
pub fn built(component: &str, bytes: usize, folder: &str) -> [String; 2] {
    [format!("built {component}, {}", counted(bytes, "byte")), format!("next: holdpoint skill test {folder}")]
}

/// The heading of a test: the version, its bundle, the episodes and their seeds.
#[must_use]
pub fn test_heading(
    id: impl Display,
    bundle: impl Display,
    episodes: usize,
    seeds: [impl Display; 2],
) -> String {
    let [first, last] = seeds;
    let episodes = counted(episodes, "episode");
    format!("{id}, {bundle}: {episodes} in a trial cell, seeds {first} to {last}")
}

/// The verdict of the static rules under a profile.
#[must_use]
pub fn static_verdict(profile: &str, runs: bool) -> String {
    let verdict = if runs { "admitted by the static rules" } else { "NOT ADMITTED" };
    format!("in {profile:<8} {verdict}")
}

/// The results of the episodes of a test.
#[derive(Clone, Copy, Debug)]
pub struct TestedEpisodes {
    /// Episodes that ran.
    pub all: usize,
    /// Episodes with a success.
    pub done: usize,
    /// The mean duration, s.
    pub mean_s: f64,
    /// Episodes beyond a limit.
    pub violations: usize,
    /// Episodes with another try.
    pub retried: usize,
}

/// The results of the episodes.
#[must_use]
pub fn episodes(of: &TestedEpisodes) -> String {
    let TestedEpisodes { all, done, mean_s, violations, retried } = of;
    format!(
        "episodes    {done} of {all} done, {mean_s:.1} s each; {violations} exceeded a limit; {retried} tried again"
    )
}

/// A failure of the code with a seed.
#[must_use]
pub fn code_failed(seed: impl Display, fault: CodeFault) -> String {
    format!("CODE FAILED with seed {seed}: {}", code_fault(fault))
}

/// The fuel of the largest tick, and the fuel of the budget.
#[must_use]
pub fn fuel(used: u64, declared: u64) -> String {
    format!("fuel        {used} of {declared} in the largest tick")
}

/// The used memory, and the declared one.
#[must_use]
pub fn memory(used_kib: u64, declared_kib: impl Display) -> String {
    format!("memory      {used_kib} of {declared_kib} KiB")
}

/// The time of a tick: the median, and the 99th percentile.
#[must_use]
pub fn tick_time(half_us: f64, most_us: f64) -> String {
    format!("time        {half_us:.1} us a tick, 99 of 100 within {most_us:.1} us")
}

/// The episodes that gave other commands with the same seed.
#[must_use]
pub fn same_seed(unlike: u64) -> String {
    match unlike {
        0 => "same seed   the same commands in every episode".to_owned(),
        unlike => format!("SAME SEED   OTHER COMMANDS in {}", counted(unlike, "episode")),
    }
}

const fn code_fault(fault: CodeFault) -> &'static str {
    match fault {
        CodeFault::Trap => "it trapped",
        CodeFault::Fuel => "a call needed more fuel than its budget",
        CodeFault::Memory => "it requested more memory than it declares",
        CodeFault::Answer => "it refused to start, or its answer is not a command",
        CodeFault::Machine => "the machine stalled, so the code was not tested",
    }
}

/// A build without the console.
pub const NO_SCREEN: &str = "drawing     none: this build has no screen";
