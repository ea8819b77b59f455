//! Tries are counted: how strictly the next one is tested, what it costs, and when a person has to look.
//!
//! An author who registers version after version gets an inferior one accepted at some time, by chance alone. So each try
//! is tested at a level of its own. The levels of an author in a family are a series, and so are those of the family as a
//! whole; the smaller level counts. A version is accepted only if its pairs exclude, at that level, that its success is
//! lower by the margin or more. By the union bound, the probability that such a version is ever accepted is at most the sum
//! of the levels, also where tries share their episodes. No accepted version earns anything back. A version that was fitted
//! to the values of the very episodes is outside this bound.
//!
//! Owns the series, the price in pairs, and the count of the recorded tries. Runs nothing and reads no record.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ids::{CapabilityId, Digest};
use crate::profile::{Profile, TrySettings};
use crate::stats::{PairedCounts, binary_pairs};

/// Pairs by which the price of a try rises at least: a slice of an evaluation.
const PRICE_STEP: usize = 20;

/// The most pairs of a try whose price is above the profile's budget: up to twice as many seeds are tried, and a run has
/// 2,000 of them.
const PRICE_MAX: u32 = 1_000;

/// The part of a try's level that its first look has; the second look, at more pairs, has the rest. Looking twice then errs
/// no more often than the level says, by the union bound. A large first part keeps the price of a version that needs one look.
const FIRST_PART: f64 = 0.75;

/// The second look takes so many times the pairs of the first one, within [`PRICE_MAX`].
const SECOND_LOOK_FACTOR: u32 = 3;

/// Of 100 pairs, those that a version may lose to the active one and still be accepted at the price.
const LOST_OF_100: u64 = 4;

/// Of 100 pairs, those that it wins then.
const WON_OF_100: u64 = 2;

/// The author that a try counts for: by key, because names are free. All unsigned registrations count for one.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TryAuthor {
    /// The author's name, or of a version that its author did not sign, that of the person who registered it.
    pub name: String,
    /// The public key, hexadecimal digits. Name and key are empty for unsigned registrations.
    pub key: String,
}

/// A counted try: what it is a try of, which one it is, and its terms.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CountedTry {
    /// Digest of content, active version, anchor, profile with policies, cell and build.
    pub subject: Digest,
    /// The commitment to the key that draws its episodes; absent for the seeds of a run, which are known. Other episodes are
    /// another try.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drawn: Option<Digest>,
    /// The author it counts for.
    pub author: TryAuthor,
    /// Its number among the author's tries in the family since the last review, from 1.
    pub by_author: u32,
    /// Its number among all tries in the family since the last review, from 1.
    pub in_family: u32,
    /// The level at which its pairs have to exclude the margin, of both looks together.
    pub level: f64,
    /// The pairs of its first look.
    pub pairs: u32,
    /// Tries that are left after it before a person has to review them.
    pub left: u32,
}

/// The tries of an author or of a family are used up: a person has to review them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpentTries {
    /// The author.
    pub author: TryAuthor,
    /// Tries of the author since the last review.
    pub by_author: u32,
    /// Tries in the family since the last review.
    pub in_family: u32,
}

impl CountedTry {
    /// Whether it is the try of this subject on these episodes.
    fn is_same(&self, subject: Digest, drawn: Option<Digest>) -> bool {
        self.subject == subject && self.drawn == drawn
    }

    /// The pairs of its second look, the first ones included. It has one only if they are more than those of the first.
    #[must_use]
    pub fn second_look(&self) -> u32 {
        self.pairs.saturating_mul(SECOND_LOOK_FACTOR).min(PRICE_MAX.max(self.pairs))
    }

    /// The pairs that the look has to which so many pairs belong.
    #[must_use]
    pub fn look(&self, pairs: usize) -> u32 {
        if pairs > self.pairs as usize { self.second_look() } else { self.pairs }
    }

    /// The level at which so many pairs have to exclude the margin.
    #[must_use]
    pub fn level_at(&self, pairs: usize) -> f64 {
        self.level * if pairs > self.pairs as usize { 1.0 - FIRST_PART } else { FIRST_PART }
    }
}

/// The part of a series' error rate that its `number`-th try has: `6 / (pi number)^2`. All parts together are 1.
fn part(number: u32) -> f64 {
    6.0 / (std::f64::consts::PI * f64::from(number.max(1))).powi(2)
}

/// The level of a try: the author's or the family's, whichever is smaller.
#[must_use]
pub fn level(settings: &TrySettings, by_author: u32, in_family: u32) -> f64 {
    (settings.author_alpha * part(by_author)).min(settings.family_alpha * part(in_family))
}

/// The largest loss of success that pairs do not exclude at a level; `None` without pairs. `lost` are the pairs that count.
#[must_use]
pub fn loss_bound(lost: PairedCounts, level: f64) -> Option<f64> {
    binary_pairs(lost, level).ok().map(|bound| bound.upper)
}

/// The pairs of the first look of a try at a level: the fewest, from the profile's budget on, with which it accepts a version
/// that loses 4 and wins 2 of 100. `None` if they are more than a run has seeds for.
#[must_use]
pub fn price(settings: &TrySettings, sandbox_pairs: u32, level: f64) -> Option<u32> {
    let is_enough = |pairs: &u32| {
        let pairs = u64::from(*pairs);
        let lost = (LOST_OF_100 * pairs).div_ceil(100);
        let counts = PairedCounts { pairs, candidate_only: lost, active_only: WON_OF_100 * pairs / 100 };
        loss_bound(counts, FIRST_PART * level).is_some_and(|bound| bound < settings.margin)
    };
    (sandbox_pairs..=PRICE_MAX.max(sandbox_pairs)).step_by(PRICE_STEP).find(is_enough)
}

/// The tries of a family, in the order in which they began.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TryLedger {
    tries: Vec<(CapabilityId, CountedTry)>,
    /// How many of them a person has reviewed.
    reviewed: usize,
}

impl TryLedger {
    /// Adds a recorded try of a version.
    pub fn note(&mut self, version: CapabilityId, counted: CountedTry) {
        self.tries.push((version, counted));
    }

    /// Takes in a recorded review: the count begins again.
    pub fn review(&mut self) {
        self.reviewed = self.tries.len();
    }

    /// The tries since the last review, each with its version.
    #[must_use]
    pub fn open(&self) -> &[(CapabilityId, CountedTry)] {
        self.tries.get(self.reviewed..).unwrap_or_default()
    }

    /// Whether this try of a version is counted already.
    #[must_use]
    pub fn has(&self, version: &CapabilityId, counted: &CountedTry) -> bool {
        self.open().iter().any(|(of, known)| of == version && known.is_same(counted.subject, counted.drawn))
    }

    /// The versions that a subject was tried as, the latest first, reviewed or not.
    pub fn versions_of<'a>(&'a self, subject: &'a Digest) -> impl Iterator<Item = &'a CapabilityId> {
        let of_subject = self.tries.iter().rev().filter(move |(_, counted)| counted.subject == *subject);
        of_subject.map(|(version, _)| version)
    }

    /// The try that a subject on these episodes is or would be: the one that is counted since the last review, or the next
    /// one.
    ///
    /// # Errors
    /// [`SpentTries`] if it would be one too many.
    pub fn admit(
        &self,
        (subject, drawn): (Digest, Option<Digest>),
        author: &TryAuthor,
        profile: &Profile,
    ) -> Result<CountedTry, SpentTries> {
        if let Some((_, counted)) = self.open().iter().find(|(_, known)| known.is_same(subject, drawn)) {
            return Ok(counted.clone());
        }
        let settings = &profile.tries;
        let (earlier_by_author, earlier_in_family) = (self.count(Some(author)), self.count(None));
        let spent =
            SpentTries { author: author.clone(), by_author: earlier_by_author, in_family: earlier_in_family };
        let (by_author, in_family) =
            (earlier_by_author.saturating_add(1), earlier_in_family.saturating_add(1));
        if by_author > settings.per_author || in_family > settings.per_family {
            return Err(spent);
        }
        let level = level(settings, by_author, in_family);
        let Some(pairs) = price(settings, profile.evaluation.sandbox_pairs, level) else { return Err(spent) };
        let left = (settings.per_author - by_author).min(settings.per_family - in_family);
        Ok(CountedTry { subject, drawn, author: author.clone(), by_author, in_family, level, pairs, left })
    }

    /// Tries since the last review, of an author or of all. One content under several version numbers is one try.
    fn count(&self, author: Option<&TryAuthor>) -> u32 {
        let is_of = |counted: &CountedTry| author.is_none_or(|author| author.key == counted.author.key);
        let counted = self.open().iter().map(|(_, counted)| counted).filter(|counted| is_of(counted));
        let tries: BTreeSet<_> = counted.map(|counted| (counted.subject, counted.drawn)).collect();
        u32::try_from(tries.len()).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::ProfileName;

    fn profile() -> Profile {
        Profile::builtin(ProfileName::Sim).unwrap()
    }

    /// A content on the seeds of a run.
    fn subject(name: &str) -> (Digest, Option<Digest>) {
        (Digest::of_parts("test", &[name.as_bytes()]), None)
    }

    fn version(number: usize) -> CapabilityId {
        format!("grasp@1.0.{number}").parse().unwrap()
    }

    fn author(name: &str) -> TryAuthor {
        TryAuthor { name: name.to_owned(), key: format!("key of {name}") }
    }

    /// A ledger in which these authors tried one content each, in this order.
    fn tried(authors: &[&str]) -> TryLedger {
        let mut ledger = TryLedger::default();
        for (place, name) in authors.iter().enumerate() {
            let counted = ledger.admit(subject(&place.to_string()), &author(name), &profile()).unwrap();
            ledger.note(version(place), counted);
        }
        ledger
    }

    /// The partial sum differs from the whole by less than the rest of the series, 1 / n.
    #[test]
    fn the_levels_of_a_series_add_up_to_its_error_rate() {
        let sum: f64 = (1..=10_000).map(part).sum();
        assert!(sum < 1.0 && sum > 1.0 - 1e-4, "{sum}");
        for name in ProfileName::ALL {
            let tries = Profile::builtin(name).unwrap().tries;
            let by_author: f64 = (1..=tries.per_author).map(|number| level(&tries, number, number)).sum();
            assert!(by_author < tries.author_alpha, "{name}: {by_author}");
            let in_family: f64 = (1..=tries.per_family).map(|number| level(&tries, 1, number)).sum();
            assert!(in_family < tries.family_alpha, "{name}: {in_family}");
        }
    }

    #[test]
    fn later_tries_are_tested_more_strictly_and_cost_more() {
        let profile = profile();
        let tries = profile.tries;
        let terms: Vec<(f64, u32)> = (1..=tries.per_author)
            .map(|number| {
                let level = level(&tries, number, number);
                (level, price(&tries, profile.evaluation.sandbox_pairs, level).unwrap())
            })
            .collect();
        assert!(terms.windows(2).all(|two| two[1].0 < two[0].0 && two[1].1 >= two[0].1), "{terms:?}");
        let pairs: Vec<u32> = terms.iter().map(|(_, pairs)| *pairs).collect();
        assert_eq!(pairs, [300, 300, 300, 360, 360, 400, 400, 400, 400, 420, 460, 460]);
        // The family's last one fits into a run, too.
        let last = level(&tries, 1, tries.per_family);
        assert!(price(&tries, profile.evaluation.sandbox_pairs, last).unwrap() <= PRICE_MAX);
        // A margin that chance alone reaches has no price.
        assert_eq!(price(&TrySettings { margin: 0.01, ..tries }, 300, 0.01), None);
        assert_eq!(price(&tries, 300, 0.0), None, "a level of 0 has none, either");
    }

    #[test]
    fn tries_are_counted_by_author_and_capped_by_the_family() {
        let profile = profile();
        let tries = profile.tries;
        let ledger = tried(&["mara", "mara", "tom"]);
        let next = |name: &str| ledger.admit(subject("next"), &author(name), &profile).unwrap();
        let numbers = |of: &CountedTry| (of.by_author, of.in_family, of.left);
        assert_eq!(numbers(&next("mara")), (3, 4, tries.per_author - 3));
        assert_eq!(numbers(&next("tom")), (2, 4, tries.per_author - 2));
        assert_eq!(numbers(&next("new")), (1, 4, tries.per_author - 1));
        // Another name does not buy a better level than the family has left.
        assert_eq!(next("new").level.to_bits(), (tries.family_alpha * part(4)).to_bits());
        assert!(next("mara").level < next("new").level);
        // All unsigned registrations are one author.
        let mut ledger = tried(&["mara"]);
        let unsigned = ledger.admit(subject("unsigned"), &TryAuthor::default(), &profile).unwrap();
        assert_eq!(numbers(&unsigned), (1, 2, tries.per_author - 1));
        ledger.note(version(9), unsigned);
        let unsigned = ledger.admit(subject("next"), &TryAuthor::default(), &profile).unwrap();
        assert_eq!(numbers(&unsigned), (2, 3, tries.per_author - 2));
    }

    #[test]
    fn spent_tries_wait_for_a_review_that_begins_the_count_again() {
        let profile = profile();
        let all = vec!["mara"; profile.tries.per_author as usize];
        let mut ledger = tried(&all);
        let spent = ledger.admit(subject("next"), &author("mara"), &profile).unwrap_err();
        assert_eq!((spent.by_author, spent.in_family), (12, 12));
        assert!(ledger.admit(subject("next"), &author("tom"), &profile).is_ok(), "another author has tries");
        // What is counted continues.
        assert_eq!(ledger.admit(subject("3"), &author("mara"), &profile).unwrap().by_author, 4);
        ledger.review();
        let again = ledger.admit(subject("next"), &author("mara"), &profile).unwrap();
        assert_eq!((again.by_author, again.in_family, again.left), (1, 1, 11));
        assert!(ledger.open().is_empty());
        // A crowd of names is capped by the family.
        let names: Vec<String> = (0..profile.tries.per_family).map(|number| number.to_string()).collect();
        let crowd = tried(&names.iter().map(String::as_str).collect::<Vec<_>>());
        let spent = crowd.admit(subject("next"), &author("new"), &profile).unwrap_err();
        assert_eq!((spent.by_author, spent.in_family), (0, 24));
    }

    #[test]
    fn the_same_subject_is_the_same_try_under_any_version_number() {
        let profile = profile();
        let mut ledger = tried(&["mara", "mara"]);
        let same = ledger.admit(subject("1"), &author("tom"), &profile).unwrap();
        assert_eq!((same.by_author, same.author.name.as_str()), (2, "mara"), "it counts once");
        assert!(!ledger.has(&version(7), &same));
        ledger.note(version(7), same.clone());
        assert!(ledger.has(&version(7), &same));
        assert_eq!(ledger.admit(subject("next"), &author("mara"), &profile).unwrap().by_author, 3);
        // On other episodes, it is another try.
        let other_draw = Some(Digest::of_parts("test", &[b"other key"]));
        let redrawn = ledger.admit((same.subject, other_draw), &author("mara"), &profile).unwrap();
        assert!(!ledger.has(&version(7), &redrawn));
        ledger.note(version(7), redrawn);
        assert_eq!(ledger.admit(subject("next"), &author("mara"), &profile).unwrap().by_author, 4);
        ledger.review();
        let of_subject: Vec<_> = ledger.versions_of(&same.subject).cloned().collect();
        assert_eq!(of_subject, [version(7), version(7), version(1)], "a review forgets no verdict");
    }
}
