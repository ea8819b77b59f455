//! Sentences about a twin or a fork that does not continue from the state of the live cell, or that is missing.

use holdpoint_governance::cell_ability::CellAbility;
use holdpoint_governance::monitor::RateTally;
use holdpoint_governance::shared_event::UncomparedReason;

/// How far the twins began from the observed state: joints in rad, the finger pads and the object in m.
pub(crate) fn observed(sequences: u64, [joints_rad, width_m]: [f64; 2], object_m: Option<f64>) -> String {
    let object = object_m.map_or_else(
        || "the object was not seen".to_owned(),
        |object_m| format!("of the object {object_m:.4} m"),
    );
    format!(
        "the live cell cannot export its state, so in {sequences} sequences the twin began at the observed one; \
         largest difference of a joint {joints_rad:.4} rad, of the finger pads {width_m:.4} m, {object}"
    )
}

/// That shadow has no twin, and for lack of which abilities.
pub(crate) fn outputs_alone(permitted: &str, missing: &[CellAbility]) -> String {
    let missing: Vec<&str> = missing.iter().copied().map(ability).collect();
    format!("shadow rests on outputs alone, {permitted}: the cell cannot {}", missing.join(" or "))
}

/// That no comparison with the rollback target shows a difference, and why.
pub(crate) const fn uncompared(reason: UncomparedReason) -> &'static str {
    match reason {
        UncomparedReason::NoExport => {
            "no difference from the rollback target is shown, because the live cell cannot export its state"
        }
        UncomparedReason::NoStart => {
            "no difference from the rollback target is shown, because no state at the start of a task was kept"
        }
        UncomparedReason::NoEvent => {
            "no difference from the rollback target is shown, because the task's record names no safety event"
        }
        UncomparedReason::NoFork => {
            "no difference from the rollback target is shown, because no trial cell took the state at the start"
        }
        UncomparedReason::InvalidFork => {
            "no difference from the rollback target is shown, because its task in the fork was invalid"
        }
        UncomparedReason::Interrupted => {
            "no difference from the rollback target is shown, because the engine ended before the comparison"
        }
    }
}

/// In how many of the same tasks a version and its rollback target were bad, rate by rate.
pub(crate) fn rate_tallies(rates: &[RateTally], target: &str) -> String {
    let tally = |of: &RateTally| {
        format!("{} in {} of {} tasks, {target} in {}", of.rate, of.version, of.tasks, of.target)
    };
    rates.iter().map(tally).collect::<Vec<_>>().join("; ")
}

const fn ability(of: CellAbility) -> &'static str {
    match of {
        CellAbility::ExportState => "export its state",
        CellAbility::SetObserved => "set a trial cell to the observed state",
    }
}
