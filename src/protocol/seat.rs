//! Who looks at an engine beside others, and what they have before them. Grants nothing.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use holdpoint_governance::ids::{CapabilityId, is_name};

/// The longest name of a person or a view, bytes.
pub const SEAT_BYTES_MAX: usize = 64;

/// What somebody at a console says of themselves. Nothing is decided by it: a decision is signed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sitting {
    /// The operator's name, as they chose it; absent as long as they chose none.
    #[serde(default)]
    pub who: Option<String>,
    /// The view they are in.
    pub view: String,
    /// The question they have open; absent if none.
    #[serde(default)]
    pub reading: Option<CapabilityId>,
    /// They only look: nothing is asked from there.
    #[serde(default)]
    pub read_only: bool,
}

impl Sitting {
    /// What is wrong with it: a name that could be no identity's, so that it cannot be a sentence on somebody's screen, or a
    /// view that is too long or no plain text.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        if self.who.as_deref().is_some_and(|who| !is_name(who)) {
            return Some("who is a name: 1 to 64 characters of a-z, 0-9, '.', '_' and '-'".to_owned());
        }
        let bad = self.view.len() > SEAT_BYTES_MAX || self.view.chars().any(char::is_control);
        bad.then(|| format!("view has at most {SEAT_BYTES_MAX} bytes of plain text"))
    }
}

/// A seat at an engine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SeatView {
    /// Its number, by the order of sitting down; never given twice by one engine.
    pub seat: u64,
    /// Process id of the console; absent if the system does not tell.
    #[serde(default)]
    pub process: Option<u32>,
    /// What they say of themselves.
    pub sitting: Sitting,
    /// They take nothing of what is shown: a console that was stopped, or a line that is dead. Such a seat is let go soon.
    #[serde(default)]
    pub not_reading: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_a_seat_is_short_and_plain() {
        let sitting = |who: &str, view: &str| Sitting {
            who: Some(who.to_owned()),
            view: view.to_owned(),
            ..Sitting::default()
        };
        assert_eq!(sitting("bert", "overview").problem(), None);
        assert_eq!(Sitting::default().problem(), None);
        for (who, view, field) in [
            ("a\u{1b}[2J", "overview", "who"),
            ("ana promoted it; nobody", "overview", "who"),
            ("", "overview", "who"),
            ("bert", &"v".repeat(65), "view"),
        ] {
            assert!(sitting(who, view).problem().is_some_and(|text| text.starts_with(field)));
        }
    }
}
