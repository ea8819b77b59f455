//! Measured values past a limit in words: value and limit with their unit, and the sequence.

use holdpoint_governance::past_limit::{ForcePlace, LimitedQuantity, MeasuredInTask, PastLimit};

use crate::check::number;

/// Value and limit: `force 71 N at the pads, limit 35 N`.
pub(crate) fn past_limit(of: &PastLimit) -> String {
    let PastLimit { quantity, value, limit, place } = *of;
    let place = match place {
        Some(ForcePlace::Pads) => " at the pads",
        Some(ForcePlace::Surroundings) => " on its surroundings",
        None => "",
    };
    format!("{quantity} {}{place}, limit {}", in_unit(quantity, value), in_unit(quantity, limit))
}

/// Value and limit, if one was measured, and the sequence: `force 71 N at the pads, limit 35 N, sequence 153 since its
/// engine began`.
pub(crate) fn measured(of: &MeasuredInTask) -> String {
    let past = of.past.as_ref().map_or_else(String::new, |past| format!("{}, ", past_limit(past)));
    format!("{past}{}", sequence_of_engine(of.sequence))
}

/// The number of a recorded sequence. Each engine counts its own from 0, and the record outlives it.
pub(crate) fn sequence_of_engine(sequence: u64) -> String {
    format!("sequence {sequence} since its engine began")
}

/// What follows a sentence about an event: nothing if nothing was measured.
pub(crate) fn after_event(of: Option<&MeasuredInTask>) -> String {
    of.map_or_else(String::new, |of| format!("; {}", measured(of)))
}

fn in_unit(quantity: LimitedQuantity, value: f64) -> String {
    let (value, unit) = (number(value), quantity.unit());
    if unit.is_empty() { value } else { format!("{value} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;

    #[test]
    fn a_violation_is_told_by_value_limit_and_sequence() {
        let forced = PastLimit {
            quantity: LimitedQuantity::Force,
            value: 71.04,
            limit: 35.0,
            place: Some(ForcePlace::Pads),
        };
        let tried = PastLimit { quantity: LimitedQuantity::Retries, value: 4.0, limit: 3.0, place: None };
        for (past, text) in [
            (Some(forced), "force 71 N at the pads, limit 35 N, sequence 153 since its engine began"),
            (
                Some(PastLimit { place: Some(ForcePlace::Surroundings), ..forced }),
                "force 71 N on its surroundings, limit 35 N, sequence 153 since its engine began",
            ),
            (Some(tried), "retries 4, limit 3, sequence 153 since its engine began"),
            (None, "sequence 153 since its engine began"),
        ] {
            assert_eq!(measured(&MeasuredInTask { sequence: 153, task: TaskKind::Grasp, past }), text);
        }
    }
}
