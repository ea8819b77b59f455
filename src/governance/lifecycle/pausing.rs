//! What a pause may hold, and what it holds: one rule for every front end and the engine.

use super::{Flags, State};

impl State {
    /// Whether a person may pause a version that stands here: a candidate is held where it is; of a provisional
    /// version the promotion is held, while it goes on working. What is confirmed has nothing to be kept from.
    #[must_use]
    pub const fn may_pause(self, flags: &Flags) -> bool {
        let on_its_way = match self {
            Self::Registered | Self::Validated | Self::Sandboxed | Self::Shadowed | Self::Demoted => true,
            Self::Active => flags.provisional,
            Self::Rejected | Self::RolledBack | Self::Superseded => false,
        };
        on_its_way && !flags.paused
    }

    /// Whether a person may let a version that stands here go on: it was paused, or it is a candidate that the gate
    /// or an unanswered question holds (`held`).
    #[must_use]
    pub const fn may_resume(self, flags: &Flags, held: bool) -> bool {
        match self {
            Self::Registered | Self::Validated | Self::Sandboxed | Self::Shadowed | Self::Demoted => {
                flags.paused || held
            }
            Self::Active => flags.paused,
            Self::Rejected | Self::RolledBack | Self::Superseded => false,
        }
    }

    /// What a pause of a version that stands here is called: an active one has the arm all the same.
    #[must_use]
    pub const fn paused_word(self) -> &'static str {
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
    fn what_is_paused_can_go_on_and_what_goes_on_is_not_paused() {
        for state in State::ALL {
            for provisional in [false, true] {
                let free = Flags { provisional, ..Flags::default() };
                let paused = Flags { paused: true, ..free };
                assert!(!state.may_pause(&paused), "{state}: twice");
                if state.may_pause(&free) {
                    assert!(state.may_resume(&paused, false), "{state}: a pause without an end");
                }
                assert!(!state.may_resume(&free, false), "{state}: nothing holds it");
            }
        }
        let (provisional, confirmed) = (Flags { provisional: true, ..Flags::default() }, Flags::default());
        assert!(State::Active.may_pause(&provisional) && !State::Active.may_pause(&confirmed));
        assert!(State::Shadowed.may_resume(&confirmed, true), "the gate holds it");
        assert!(!State::Active.may_resume(&provisional, true), "it works");
    }
}
