//! What the console says about an engine that is missing or does not answer.

pub const HELD_ELSEWHERE: &str =
    "another engine has the store: `holdpoint status` shows it, stop stops its arm, quit ends this console";
pub const START_ONE: &str = "`holdpoint` in a shell starts one; `holdpoint status` shows what is in the store, quit ends this console";

#[must_use]
pub fn starts_in_a_shell(shell: &str) -> String {
    format!("{shell} in another shell starts one, and this console attaches to it")
}

#[must_use]
pub fn ends_and_starts(quit: &str, shell: &str) -> String {
    format!("{quit} ends this console, and {shell} in the shell starts an engine")
}

#[must_use]
pub fn then_start(key: &str) -> String {
    format!("; look at the cell, then {key} starts it")
}

#[must_use]
pub fn no_engine_runs(how: &str, then: &str) -> String {
    format!("NO ENGINE RUNS, and nothing watches the arm: {how}{then}")
}

#[must_use]
pub fn use_the_physical_stop(key: &str, shell: &str) -> String {
    format!("use the physical stop of the cell NOW; {key} asks again, {shell} does so in a shell")
}

#[must_use]
pub fn stop_not_answered(secs: u64, advice: &str) -> String {
    format!("STOP NOT ANSWERED for {secs} s: {advice}")
}

#[must_use]
pub fn stop_not_confirmed(secs: u64, advice: &str, why: &str) -> String {
    format!("STOP NOT CONFIRMED for {secs} s: {advice} ({why})")
}

#[must_use]
pub fn looks_again(tries: u32, most: u32, result: &str) -> String {
    format!("looks for an engine again, {tries} of {most}: {result}")
}

#[must_use]
pub fn none_found(looks: u32, result: &str) -> String {
    format!("the console found no engine in {looks} tries: start `holdpoint` again ({result})")
}

#[must_use]
pub fn no_key_works(stop: &str) -> String {
    format!(
        "NO KEY WORKS: the terminal is in line mode; `fg` in its shell gives it back, \
         {stop} in another shell stops the arm"
    )
}
