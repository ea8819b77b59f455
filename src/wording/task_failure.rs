//! Why a task failed, in words: the same ones in events, explanations and replays.

use holdpoint_governance::failure_cause::FailureCause;

/// What happened to the object, the target or the arm, a few words: `dropped the object`.
#[must_use]
pub const fn failure_cause(of: FailureCause) -> &'static str {
    match of {
        FailureCause::Missed => "missed the object",
        FailureCause::Slipped => "the object slipped",
        FailureCause::Dropped => "dropped the object",
        FailureCause::Pressed => "pressed too hard or touched something",
        FailureCause::Misplaced => "misplaced the object",
        FailureCause::Unseen => "did not see the target",
        FailureCause::OutOfReach => "the target was out of reach",
        FailureCause::Refused => "a request was refused",
        FailureCause::Hardware => "the arm or the gripper did not follow",
        FailureCause::Code => "its code failed",
        FailureCause::Late => "took too long",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cause_has_words_of_its_own() {
        let texts: std::collections::BTreeSet<_> = FailureCause::ALL.map(failure_cause).into_iter().collect();
        assert_eq!(texts.len(), FailureCause::ALL.len());
        assert_eq!(failure_cause(FailureCause::Dropped), "dropped the object");
    }
}
