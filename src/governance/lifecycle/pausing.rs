//! The rule of pauses, for every front end and the engine.

use super::{State, VersionFlags};

impl State {
    /// Whether a person may pause a version in this state: a candidate stays where it is; a provisional version keeps
    /// running, and only its confirmation waits. A confirmed version has nothing to pause.
    #[must_use]
    pub const fn may_pause(self, flags: &VersionFlags) -> bool {
        let pausable = match self {
            Self::Registered | Self::Validated | Self::Sandboxed | Self::Shadowed | Self::Demoted => true,
            Self::Active => flags.provisional,
            Self::Rejected | Self::RolledBack | Self::Superseded => false,
        };
        pausable && !flags.paused
    }

    /// Whether a person may resume a version in this state: it was paused, or it is a candidate on hold by the gate or
    /// an unanswered request (`held`).
    #[must_use]
    pub const fn may_resume(self, flags: &VersionFlags, held: bool) -> bool {
        match self {
            Self::Registered | Self::Validated | Self::Sandboxed | Self::Shadowed | Self::Demoted => {
                flags.paused || held
            }
            Self::Active => flags.paused,
            Self::Rejected | Self::RolledBack | Self::Superseded => false,
        }
    }

    /// The name of a pause in this state: an active version keeps the arm.
    #[must_use]
    pub const fn paused_label(self) -> &'static str {
        match self {
            Self::Active => "promotion paused",
            Self::Registered
            | Self::Validated
            | Self::Sandboxed
            | Self::Shadowed
            | Self::Demoted
            | Self::Rejected
            | Self::RolledBack
            | Self::Superseded => "paused",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_paused_version_can_resume_and_a_resumed_one_runs() {
        for state in State::ALL {
            for provisional in [false, true] {
                let free = VersionFlags { provisional, ..VersionFlags::default() };
                let paused = VersionFlags { paused: true, ..free };
                assert!(!state.may_pause(&paused), "{state}: twice");
                if state.may_pause(&free) {
                    assert!(state.may_resume(&paused, false), "{state}: a pause without an end");
                }
                assert!(!state.may_resume(&free, false), "{state}: nothing holds it");
            }
        }
        let (provisional, confirmed) =
            (VersionFlags { provisional: true, ..VersionFlags::default() }, VersionFlags::default());
        assert!(State::Active.may_pause(&provisional) && !State::Active.may_pause(&confirmed));
        assert!(State::Shadowed.may_resume(&confirmed, true), "the gate holds it");
        assert!(!State::Active.may_resume(&provisional, true), "it works");
    }
}
