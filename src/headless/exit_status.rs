//! The results of versions as exit codes: for a version by name, for a run the worst of its versions.

use crate::error::Exit;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::snapshot::CandidateView;

/// A version and its result.
pub(super) struct FollowedVersion {
    pub(super) version: CapabilityId,
    pub(super) exit: Exit,
}

impl std::fmt::Display for FollowedVersion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "outcome: {} {}", self.version, self.exit.outcome_label())
    }
}

/// The result of a version, from its state.
pub(super) fn outcome_of(view: &CandidateView) -> Exit {
    match view.state {
        State::Active if view.confirmed && !view.flags.provisional => Exit::Confirmed,
        // It was confirmed before a newer version replaced it.
        State::Superseded if view.confirmed => Exit::Confirmed,
        State::Rejected => Exit::Rejected,
        State::RolledBack => Exit::RolledBack,
        State::Demoted if view.left == Some(State::Active) => Exit::RolledBack,
        State::Registered
        | State::Validated
        | State::Sandboxed
        | State::Shadowed
        | State::Active
        | State::Demoted
        | State::Superseded => Exit::Held,
    }
}

/// The exit code of a run: the worst of its versions. A run without versions judged nothing.
pub(super) fn worst_outcome(followed: &[FollowedVersion]) -> Exit {
    let weight = |exit: Exit| match exit {
        Exit::NothingJudged | Exit::NotConfirmed => 0,
        Exit::Confirmed => 1,
        Exit::Rejected => 2,
        Exit::Held => 3,
        Exit::RolledBack => 4,
        Exit::Usage | Exit::Unmet | Exit::Busy => 5,
        Exit::Internal => 6,
    };
    followed
        .iter()
        .map(|version| version.exit)
        .max_by_key(|exit| weight(*exit))
        .unwrap_or(Exit::NothingJudged)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn run_exits_with_the_worst_result_of_its_versions() {
        let followed = |exits: &[Exit]| {
            exits
                .iter()
                .map(|exit| FollowedVersion { version: "grasp@1.1.0".parse().unwrap(), exit: *exit })
                .collect::<Vec<_>>()
        };
        for (exits, expected) in [
            (&[][..], Exit::NothingJudged),
            (&[Exit::Confirmed], Exit::Confirmed),
            (&[Exit::Confirmed, Exit::Rejected], Exit::Rejected),
            (&[Exit::Held, Exit::Rejected, Exit::Confirmed], Exit::Held),
            (&[Exit::RolledBack, Exit::Held], Exit::RolledBack),
        ] {
            assert_eq!(worst_outcome(&followed(exits)), expected, "{exits:?}");
        }
        assert_eq!(followed(&[Exit::Rejected])[0].to_string(), "outcome: grasp@1.1.0 rejected");
    }
}
