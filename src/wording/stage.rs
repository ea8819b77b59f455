//! The progress of a stage in words.

use holdpoint_governance::lifecycle::Stage;

/// What can end a stage before its budget is used up; empty if nothing can.
#[must_use]
pub const fn early_end(of: Stage) -> &'static str {
    match of {
        Stage::Validation | Stage::Activation => "",
        Stage::Sandbox => {
            "a hard stop, or an outcome that the rest of the budget cannot change, ends it early"
        }
        Stage::Shadow => "a hard stop of the twin ends it at once; an unsettled concern extends it once",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_that_measure_can_end_early() {
        for (stage, text) in [
            (Stage::Validation, ""),
            (
                Stage::Sandbox,
                "a hard stop, or an outcome that the rest of the budget cannot change, ends it early",
            ),
            (Stage::Shadow, "a hard stop of the twin ends it at once; an unsettled concern extends it once"),
            (Stage::Activation, ""),
        ] {
            assert_eq!(early_end(stage), text);
        }
    }
}
