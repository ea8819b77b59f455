//! What a search for the worst episode found, and what doubt it leaves.

use serde::{Deserialize, Serialize};

use super::decision::{Dimension, Reason, ReasonCode};
use super::stats::{PairedCounts, binary_pairs};

/// What was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Searched {
    /// Places that were tried, a pair of episodes each.
    pub tried: u32,
    /// The worst one: its values by axis, in the words and units of the distribution.
    pub place: Vec<(String, f64)>,
    /// How much worse the candidate's episode was there; a number without unit, for the search alone.
    pub excess: f64,
    /// Pairs of episodes on fresh noise at that place, in which a limit was passed.
    pub repeats: PairedCounts,
}

/// One-sided error rate of the doubt: an equally good version is doubted so often at most. The pairs were worked after
/// the place was chosen, so that the number of places tried does not count.
const ALPHA: f64 = 0.01;

impl Searched {
    /// The doubt, if it is established that the candidate passes a limit there more often than the active version.
    #[must_use]
    pub fn doubt(&self) -> Option<Reason> {
        let PairedCounts { pairs, candidate_only, active_only } = self.repeats;
        let bound = binary_pairs(self.repeats, ALPHA).ok()?;
        if bound.lower <= 0.0 {
            return None;
        }
        let place: Vec<String> =
            self.place.iter().map(|(axis, value)| format!("{axis} {value:.4}")).collect();
        let text = format!(
            "a search found a place where it alone passes a limit in {candidate_only} of {pairs} pairs, the active \
             version alone in {active_only}: {}",
            place.join(", ")
        );
        let reason = Reason::new(ReasonCode::BehaviorSuspicious, Dimension::Behavior, text);
        Some(reason.with(bound.lower, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(candidate_only: u64, active_only: u64) -> Searched {
        let repeats = PairedCounts { pairs: 12, candidate_only, active_only };
        Searched { tried: 48, place: vec![("object.mass_kg".into(), 0.35)], excess: 1.0, repeats }
    }

    #[test]
    fn a_doubt_is_established_or_none() {
        assert_eq!(found(0, 0).doubt(), None);
        assert_eq!(found(6, 6).doubt(), None);
        assert_eq!(found(3, 0).doubt(), None, "three of twelve may be chance");
        let reason = found(10, 0).doubt().unwrap();
        assert!(reason.text.contains("object.mass_kg 0.3500"), "{reason}");
        assert!(reason.text.contains("in 10 of 12 pairs, the active version alone in 0"), "{reason}");
    }
}
