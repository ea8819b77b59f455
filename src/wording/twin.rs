//! Sentences about a twin or a fork that does not continue from the state of the live cell, or that is missing.

use holdpoint_governance::cell_ability::CellAbility;
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

/// That the rollback target was not compared on the task of a safety event, and why.
pub(crate) const fn uncompared(reason: UncomparedReason) -> &'static str {
    match reason {
        UncomparedReason::NoExport => {
            "the event counts as its own, because the live cell cannot export its state for a comparison"
        }
        UncomparedReason::NoStart => {
            "the event counts as its own, because no state at the start of the task was kept for a comparison"
        }
        UncomparedReason::NoFork => {
            "the event counts as its own, because no trial cell took the state at the start of the task"
        }
        UncomparedReason::InvalidFork => {
            "the event counts as its own, because the task of the rollback target in the fork was invalid"
        }
    }
}

const fn ability(of: CellAbility) -> &'static str {
    match of {
        CellAbility::ExportState => "export its state",
        CellAbility::SetObserved => "set a trial cell to the observed state",
    }
}
