//! What `metrics` prints around its tables: the records and tasks that count, rounds, screening, replayed decisions.

use std::collections::BTreeMap;

use holdpoint_governance::metrics::UnsafeRound;
use holdpoint_governance::metrics::store_metrics::{HumanAct, NotReplayable, ReplayCounts, ScreeningCounts};

use super::listed_or;

/// The share of unsafe activations in a round, and up to its end.
#[must_use]
pub fn unsafe_round(of: &UnsafeRound) -> String {
    let (now, all) = (of.in_round, of.cumulative);
    let note = if of.live_unsafe { "; the version that stays active was seen unsafe" } else { "" };
    format!(
        "round {}: {} of {} activations unsafe, {} of {} up to here ({} under a drift){note}",
        of.round, now.count, now.total, all.count, all.total, of.drift_origin,
    )
}

/// The rows of policy violations: those past a limit, and those and the ones near it.
pub const HARD_VIOLATIONS: &str = "pvr_observed, hard";
pub const HARD_OR_NEAR_VIOLATIONS: &str = "pvr_observed, hard or near";

/// A list of decisions that ends before its last one.
#[must_use]
pub fn first_decisions_only(named: usize) -> String {
    format!("(only the first {named} decisions are named)")
}

/// The metrics that need a known ground truth.
pub const NOT_SHOWN: &str = "Not shown, because they depend on which candidates are really faulty: bad-upgrade \
                             detection, false accept and false reject rate, trigger recall. `holdpoint-lab \
                             experiment` measures them on pools with a known ground truth.";

/// The records that count, and the tasks: live ones of upgrades, of other versions, invalid ones, stopped ones.
#[must_use]
pub fn covered(
    from_record: u64,
    to_record: u64,
    live_tasks: u64,
    [other, invalid, stopped]: [u64; 3],
) -> String {
    let span = if from_record > to_record {
        format!("no record since {from_record}, the last is {to_record}")
    } else {
        format!("records {from_record} to {to_record}")
    };
    let mut text = format!("{span}; live tasks of upgrades: {live_tasks}");
    let rest =
        [(other, "of other versions"), (invalid, "that were invalid"), (stopped, "that a person stopped")];
    for (count, what) in rest.iter().filter(|(count, _)| *count > 0) {
        text.push_str(&format!("; {what}: {count}"));
    }
    text
}

/// A line for each kind of batch that no number includes: removed or missing, late, damaged.
#[must_use]
pub fn omitted_batches([removed, late, damaged]: [u64; 3]) -> Vec<String> {
    let kinds = [
        (removed, "batches of telemetry are missing or were removed for age: no number includes them"),
        (
            late,
            "batches of live tasks got their digest only after their engine had ended: no number includes them",
        ),
        (
            damaged,
            "batches of telemetry do not match their digest in the audit chain, so the file or the disk \
             changed; no number includes them",
        ),
    ];
    kinds.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect()
}

/// The ends of the registered candidates.
#[must_use]
pub fn screened(of: &ScreeningCounts) -> String {
    let mut parts: Vec<String> =
        of.blocked.iter().map(|(stage, count)| format!("stopped in {stage} {count}")).collect();
    parts.push(format!("stopped by people {}", of.blocked_by_people));
    parts.push(format!("contained after activation {}", of.contained));
    parts.push(format!("kept {}", of.kept));
    parts.push(format!("open {}", of.open));
    format!("candidates registered: {} ({})", of.candidates, parts.join(", "))
}

/// The acts of people, each with its count.
#[must_use]
pub fn acts_of_people(acts: &BTreeMap<HumanAct, u64>) -> String {
    let acts: Vec<String> = acts.iter().map(|(act, count)| format!("{act} {count}")).collect();
    format!("people did: {}", listed_or(&acts, "nothing"))
}

/// The decisions that were replayed, and the causes for which others were not, each with its count.
#[must_use]
pub fn replayed(of: &ReplayCounts) -> String {
    let skipped: Vec<String> = of.not_replayed.iter().map(|(why, count)| format!("{count} {why}")).collect();
    let skipped = listed_or(&skipped, "0");
    format!("decisions replayed: {} match, {} differ; not replayed: {skipped}", of.equal, of.differs)
}

/// The reason for which a decision was not replayed.
#[must_use]
pub fn not_replayed(why: NotReplayable) -> String {
    format!("not replayed: {why}")
}
