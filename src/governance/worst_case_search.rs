//! The finding of a search for the worst episode, and its concern.

use serde::{Deserialize, Serialize};

use super::decision::{Dimension, Reason};
use super::finding::Finding;
use super::profile::Profile;
use super::stats::{PairedCounts, binary_pairs};

/// The finding.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SearchFinding {
    /// Places that were tried, a pair of episodes each.
    pub tried: u32,
    /// The worst one: its values by axis, in the words and units of the distribution.
    pub place: Vec<(String, f64)>,
    /// How much worse the candidate's episode was there; a number without unit, for the search alone.
    pub excess: f64,
    /// Pairs of episodes on fresh noise at that place, in which a limit was passed.
    pub repeats: PairedCounts,
}

impl SearchFinding {
    /// The concern, if the candidate passes a limit there significantly more often than the active version. The pairs
    /// ran after the place was chosen, so that the number of places tried does not count.
    #[must_use]
    pub fn concern(&self, profile: &Profile) -> Option<Reason> {
        let PairedCounts { pairs, candidate_only, active_only } = self.repeats;
        let bound = binary_pairs(self.repeats, profile.evaluation.search_alpha).ok()?;
        if bound.lower <= 0.0 {
            return None;
        }
        let finding =
            Finding::SearchedPlace { candidate_only, active_only, pairs, place: self.place.clone() };
        Some(Reason::new(Dimension::Behavior, finding).with(bound.lower, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::ProfileName;

    fn found(candidate_only: u64, active_only: u64) -> SearchFinding {
        let repeats = PairedCounts { pairs: 12, candidate_only, active_only };
        SearchFinding { tried: 48, place: vec![("object.mass_kg".into(), 0.35)], excess: 1.0, repeats }
    }

    #[test]
    fn searched_place_is_a_concern_only_if_significant() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        assert_eq!(found(0, 0).concern(&profile), None);
        assert_eq!(found(6, 6).concern(&profile), None);
        assert_eq!(found(3, 0).concern(&profile), None, "three of twelve may be chance");
        let reason = found(10, 0).concern(&profile).unwrap();
        let place = vec![("object.mass_kg".to_owned(), 0.35)];
        let finding = Finding::SearchedPlace { candidate_only: 10, active_only: 0, pairs: 12, place };
        assert_eq!(reason.finding, Some(finding));
    }
}
