//! The sentences of the audit log: one for each kind of record, and the view's own texts.

pub const STANDING_SET: &str = "the states of its versions, for a restart";
pub const APPROVAL_USED: &str = "an approval was used; it counts only once";
pub const TELEMETRY_MISSED: &str = "batches of telemetry are missing, and no record says why";
pub const KEY_REVEALED: &str = "the key of its seeds was revealed";
pub const CLOCK_NOT_TRUSTED: &str = "the machine's clock is not trusted until a person confirms the time";
pub const DRIFT_ENDS: &str = "the drift ends";
pub const NOTHING_FLAGGED: &str = "nothing runs and nothing is flagged";
pub const TOUR: &str = "Each record has the hash of the one before; v checks them";
pub const NO_RECORD_READ: &str = "No record has been read yet";
pub const NO_RECORD_OF_THIS_KIND: &str = "There is no record of this kind";
pub const NO_RECORD_OF_THIS_KIND_READ: &str = "No record of this kind among those that were read";
pub const NO_RECORD_FITS: &str = "No record fits the filter";
pub const CHECKS_IT: &str = " checks it";
pub const ENGINE_ENDED_SUDDENLY: &str = "the engine ended suddenly; the next one found it";

/// A text behind the words that lead to it; empty without one.
fn led(before: &str, text: Option<&str>) -> String {
    text.map_or_else(String::new, |text| format!("{before}{text}"))
}

/// What a person did, and why.
fn done_by(actor: &str, act: &str, reason: Option<&str>) -> String {
    format!("{actor} {act}{}", led(": ", reason))
}

#[must_use]
pub fn bytes_of_content(kind: &str, bytes: usize) -> String {
    format!("{kind}, {bytes} bytes of content")
}

#[must_use]
pub fn scores(values: &str) -> String {
    format!("interface, policy, behavior, recovery: {values}")
}

#[must_use]
pub fn telemetry_pruned(through: &str) -> String {
    format!("telemetry up to batch {through} is pruned for space")
}

#[must_use]
pub fn try_counted(number: &str) -> String {
    format!("its sandbox is try {number} of its author")
}

#[must_use]
pub fn tasks_past_a_limit(any: u64, tasks: u64) -> String {
    format!("{any} of {tasks} live tasks were past a limit of harm")
}

#[must_use]
pub fn batches_sealed(batches: usize, rows: u64) -> String {
    format!("{batches} batches of telemetry are sealed, {rows} rows")
}

#[must_use]
pub fn raw_cut(lines: usize) -> String {
    format!("… cut after {lines} lines; `holdpoint audit export` has all of it")
}

#[must_use]
pub fn run_of_telemetry(count: usize, newest: &str) -> String {
    format!("{count} records of sealed telemetry, the newest: {newest}")
}

#[must_use]
pub fn raw_place(line: usize, lines: usize, key: &str) -> String {
    format!("line {line} of {lines}, {key} closes")
}

#[must_use]
pub fn raw_title(seq: u64) -> String {
    format!("Record {seq} as it was written")
}

#[must_use]
pub fn counted(activations: u64, unsafe_activations: u64, tasks: u64, violations: u64) -> String {
    format!(
        "since this engine began: {activations} let in, {unsafe_activations} unsafe; \
         {tasks} tasks, {violations} violations"
    )
}

#[must_use]
pub fn rolled_back_safely(recovered: u64, rollbacks: u64) -> String {
    format!("; {recovered} of {rollbacks} rolled back safely")
}

#[must_use]
pub fn chain_not_checked(glyph: &str) -> String {
    format!("{glyph} chain not checked yet: ")
}

#[must_use]
pub fn chain_holds(glyph: &str, records: u64, finding: &str) -> String {
    format!("{glyph} chain holds, {records} records checked: {finding}")
}

#[must_use]
pub fn chain_broken(glyph: &str, records: u64, finding: &str) -> String {
    format!("{glyph} CHAIN BROKEN after {records} records: {finding}")
}

#[must_use]
pub fn hash_and_key(hash: &str, key: &str) -> String {
    format!("hash {hash}, {key} shows it raw")
}

#[must_use]
pub fn submitted(author: &str, provenance: Option<&str>, risk: Option<&str>, parent: Option<&str>) -> String {
    let [provenance, risk, parent] =
        [led(", ", provenance), led(", estimated risk ", risk), led(", made from ", parent)];
    format!("submitted by {author}{provenance}{risk}{parent}")
}

#[must_use]
pub fn state_set(from: &str, to: &str, reason: Option<&str>) -> String {
    format!("{from} -> {to}{}", led(": ", reason))
}

#[must_use]
pub fn has_the_arm(active: &str, cause: Option<&str>, target: Option<&str>) -> String {
    let (cause, target) = (led(" by ", cause), led("; the rollback target is ", target));
    format!("{active} has the arm{cause}{target}")
}

#[must_use]
pub fn no_version_has_the_arm(cause: Option<&str>) -> String {
    format!("no version has the arm{}", led(": ", cause))
}

#[must_use]
pub fn family_set(safe_stopped: bool, reason: Option<&str>) -> String {
    let state = if safe_stopped { "safe-stopped" } else { "works" };
    format!("{state}{}", led(": ", reason))
}

#[must_use]
pub fn passes_are_void(reason: Option<&str>) -> String {
    format!("earlier passes are void{}", led(": ", reason))
}

#[must_use]
pub fn evidence_of(kind: &str, digest: &str) -> String {
    format!("evidence of the {kind}, digest {digest}")
}

#[must_use]
pub fn to_decide(needed: &str, until: Option<&str>, state: Option<&str>) -> String {
    format!("{needed} to decide{}{}", led(" by ", until), led("; now ", state))
}

#[must_use]
pub fn says(who: &str, decision: &str, reason: Option<&str>) -> String {
    format!("{who} says {decision}{}", led(": ", reason))
}

#[must_use]
pub fn context(profile: &str, policy: &str) -> String {
    format!("profile {profile}, policy {policy}")
}

#[must_use]
pub fn own_profile(name: Option<&str>) -> String {
    format!("own profile{}", led(" ", name))
}

#[must_use]
pub fn decided(stage: Option<&str>, outcome: Option<&str>, why: Option<&str>) -> String {
    let stage = stage.map_or_else(String::new, |stage| format!("{stage}: "));
    format!("{stage}decided{}{}", led(" ", outcome), led(": ", why))
}

#[must_use]
pub fn monitor_found(found: &str, why: Option<&str>) -> String {
    format!("the monitor: {found}{}", led(": ", why))
}

#[must_use]
pub fn monitor_answered(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "answered the monitor", reason)
}

#[must_use]
pub fn resumed(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "resumed it", reason)
}

#[must_use]
pub fn anchor_set(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "made it the anchor", reason)
}

#[must_use]
pub fn tries_reviewed(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "reviewed its tries", reason)
}

#[must_use]
pub fn break_glass(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "activated it alone, by break-glass", reason)
}

#[must_use]
pub fn cell_stopped(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "stopped the cell", reason)
}

#[must_use]
pub fn cell_started(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "started the cell", reason)
}

#[must_use]
pub fn alarm_reset(actor: &str, reason: Option<&str>) -> String {
    done_by(actor, "reset it", reason)
}

#[must_use]
pub fn pause_set(actor: &str, act: &str, reason: Option<&str>) -> String {
    done_by(actor, act, reason)
}

#[must_use]
pub fn key_committed(purpose: Option<&str>) -> String {
    format!("its seeds got a secret key{}", led(": ", purpose))
}

#[must_use]
pub fn engine_began(profile: Option<&str>) -> String {
    format!("an engine began to run the cell{}", led(" under ", profile))
}

#[must_use]
pub fn goal_set(actor: &str, goal: &str, reason: Option<&str>) -> String {
    format!("{actor} set the goal {goal}{}", led(": ", reason))
}

#[must_use]
pub fn notes(actor: &str, text: Option<&str>) -> String {
    done_by(actor, "notes", text)
}

#[must_use]
pub fn clock_confirmed(actor: &str, time: &str, reason: Option<&str>) -> String {
    format!("{actor} confirmed the time, {time}{}", led(": ", reason))
}

#[must_use]
pub fn asked_for(user: &str, asked: &str, process: Option<&str>) -> String {
    let process = process.map_or_else(String::new, |process| format!(" (process {process})"));
    format!("{user} asked for {asked}{process}")
}

#[must_use]
pub fn drift_sets_in(kind: &str, magnitude: Option<&str>) -> String {
    format!("{kind}{} sets in", led(" ", magnitude))
}

#[must_use]
pub fn closed(end: Option<&str>) -> String {
    format!("closed{}", led(" as ", end))
}

#[must_use]
pub fn normal_measured(of_the_camera: bool, tasks: Option<&str>) -> String {
    let what = if of_the_camera { "for the camera check" } else { "for it" };
    let tasks = tasks.map_or_else(String::new, |tasks| format!(", over {tasks} tasks"));
    format!("what is normal {what} was measured{tasks}")
}

#[must_use]
pub fn batch_sealed(rows: &str) -> String {
    format!("a batch of telemetry is sealed, {rows} rows")
}

#[must_use]
pub fn person(name: &str, what: &str, [role, by, reason]: [Option<&str>; 3]) -> String {
    format!("{name} is {what}{}{}{}", led(" as ", role), led(" by ", by), led(": ", reason))
}
