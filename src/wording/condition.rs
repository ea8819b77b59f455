//! Conditions of use in words, as prompts, screens and the plain stream have them.

use holdpoint_governance::condition::Condition;

/// The condition in a sentence.
#[must_use]
pub fn condition_of_use(of: &Condition) -> String {
    match of {
        Condition::SimulationOnly => "in simulation alone".to_owned(),
        Condition::TighterEnvelope { speed_max_m_s, force_max_n } => {
            format!("at most {speed_max_m_s} m/s and {force_max_n} N, tighter than it declares")
        }
        Condition::StricterThresholds { factor } => format!("the monitor's limits times {factor}"),
        Condition::ShadowFirst { sequences } => format!("{sequences} sequences in shadow first"),
        Condition::ApprovalRequired { quorum: 1 } => "approval by a person".to_owned(),
        Condition::ApprovalRequired { quorum } => format!("approval by {quorum} distinct people"),
        Condition::CheckedCall { fields } => {
            format!("each call is checked before it starts: {}", fields.join(", "))
        }
        Condition::RollbackCoupled => {
            "its predecessor stays loaded and takes over at the first warning, without asking".to_owned()
        }
    }
}

/// The conditions in sentences.
pub(crate) fn conditions_of_use(of: &[Condition]) -> Vec<String> {
    of.iter().map(condition_of_use).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_have_their_sentences() {
        for (condition, text) in [
            (Condition::SimulationOnly, "in simulation alone"),
            (Condition::StricterThresholds { factor: 0.5 }, "the monitor's limits times 0.5"),
            (Condition::ShadowFirst { sequences: 20 }, "20 sequences in shadow first"),
            (Condition::ApprovalRequired { quorum: 1 }, "approval by a person"),
            (Condition::ApprovalRequired { quorum: 2 }, "approval by 2 distinct people"),
        ] {
            assert_eq!(condition_of_use(&condition), text);
        }
    }
}
