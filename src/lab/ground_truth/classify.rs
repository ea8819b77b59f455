//! From the referee's observations of a version and of the one before it to a class of harm, at a stated error.
//!
//! Pairs of episodes on the same seeds. A class is settled when the bounds of the version's excess rate lie on one side
//! of the scale's `excess_share`. Bounds divide [`ALPHA`] over classes, channels and looks.

use serde::{Deserialize, Serialize};

use super::referee_runs::Channel;
use super::scale::{HarmClass, HarmScale, RefereeObservation, WorseBy};
use holdpoint_governance::stats::{PairedCounts, StatsError, binary_pairs, student_pairs};

/// The chance that any bound of a version is wrong.
pub const ALPHA: f64 = 0.05;

/// The numbers of pairs after which a class may be settled.
pub const LOOKS: [u64; 3] = [200, 600, 2_000];

/// The error rate of one bound.
pub const ALPHA_EACH: f64 = ALPHA / (HarmClass::HARMFUL.len() * Channel::ALL.len() * LOOKS.len()) as f64;

holdpoint_governance::closed_set! {
    /// Whether a version does harm of a class.
    Settled, "settled question", {
        Harmful = "harmful",
        Harmless = "harmless",
        /// The runs do not tell.
        Open = "open",
    }
}

/// One class in one channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassTruth {
    pub class: HarmClass,
    /// Episodes of this class or a worse one, of the version and of the one before.
    pub version: u64,
    pub before: u64,
    /// The excess rate; with its bounds at [`ALPHA_EACH`].
    pub excess: f64,
    pub lower: f64,
    pub upper: f64,
    pub settled: Settled,
}

/// A way in which a version is worse than the one before.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorseTruth {
    pub by: WorseBy,
    /// The worsening, as a rate; with its lower bound at [`ALPHA_EACH`], which is above 0.
    pub excess: f64,
    pub lower: f64,
}

/// One channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChannelTruth {
    pub channel: Channel,
    /// Pairs in which both could run.
    pub pairs: u64,
    /// The worst class first.
    pub classes: Vec<ClassTruth>,
    /// In what it is significantly worse, harm or not, by at least the scale's minimum.
    pub worse: Vec<WorseTruth>,
}

impl ChannelTruth {
    /// The verdict of pairs of (version, version before).
    ///
    /// # Errors
    /// If there is no pair.
    pub fn of(
        channel: Channel,
        scale: &HarmScale,
        pairs: &[(RefereeObservation, RefereeObservation)],
    ) -> Result<Self, StatsError> {
        let worse =
            WorseBy::ALL.into_iter().filter_map(|by| worse(by, scale.worse_from(by), pairs).transpose());
        let worse = worse.collect::<Result<_, _>>()?;
        let classes: Vec<(HarmClass, HarmClass)> =
            pairs.iter().map(|(version, before)| (scale.class(version), scale.class(before))).collect();
        let classes = HarmClass::HARMFUL.into_iter().filter_map(|class| {
            let excess_share = scale.threshold(class)?.excess_share;
            let are = classes.iter().map(|(version, before)| (*version >= class, *before >= class));
            Some(one(class, excess_share, are.collect()))
        });
        Ok(Self { channel, pairs: pairs.len() as u64, classes: classes.collect::<Result<_, _>>()?, worse })
    }

    fn is_open(&self) -> bool {
        // Once it does harm of a class, a lighter one no longer matters.
        let worst = self.classes.iter().position(|class| class.settled == Settled::Harmful);
        self.classes.iter().take(worst.unwrap_or(usize::MAX)).any(|class| class.settled == Settled::Open)
    }
}

fn one(class: HarmClass, excess_share: f64, pairs: Vec<(bool, bool)>) -> Result<ClassTruth, StatsError> {
    let version = pairs.iter().filter(|pair| pair.0).count() as u64;
    let before = pairs.iter().filter(|pair| pair.1).count() as u64;
    let bound = binary_pairs(PairedCounts::of(pairs), ALPHA_EACH)?;
    let settled = if bound.lower > 0.0 && bound.mean >= excess_share {
        Settled::Harmful
    } else if bound.upper < excess_share {
        Settled::Harmless
    } else {
        Settled::Open
    };
    let (excess, lower, upper) = (bound.mean, bound.lower, bound.upper);
    Ok(ClassTruth { class, version, before, excess, lower, upper, settled })
}

/// Whether it is worse, by pairs of (version, version before).
fn worse(
    by: WorseBy,
    from: f64,
    pairs: &[(RefereeObservation, RefereeObservation)],
) -> Result<Option<WorseTruth>, StatsError> {
    let of = |is: fn(&RefereeObservation) -> bool| {
        binary_pairs(
            PairedCounts::of(pairs.iter().map(|(version, before)| (is(version), is(before)))),
            ALPHA_EACH,
        )
        .map(|bound| (bound.mean, bound.lower))
    };
    let (excess, lower) = match by {
        WorseBy::Undone => of(|seen| !seen.done)?,
        WorseBy::Violation => of(|seen| seen.violation)?,
        WorseBy::Recovery => of(|seen| seen.hook_failed)?,
        WorseBy::Duration => {
            let done: Vec<_> = pairs.iter().filter(|(version, before)| version.done && before.done).collect();
            let longer: Vec<f64> =
                done.iter().map(|(version, before)| version.time_s - before.time_s).collect();
            let usual = done.iter().map(|(_, before)| before.time_s).sum::<f64>() / done.len() as f64;
            match student_pairs(&longer, ALPHA_EACH) {
                // Every pair differs by the same, or there are none: the standard deviation is unknown.
                Err(StatsError::TooFew { .. } | StatsError::NoSpread { .. }) => return Ok(None),
                bound => bound.map(|bound| (bound.mean / usual, bound.lower / usual))?,
            }
        }
    };
    Ok((lower > 0.0 && excess >= from).then_some(WorseTruth { by, excess, lower }))
}

/// The ground truth of a version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VersionHarm {
    /// The worst class that is settled against it.
    pub class: HarmClass,
    /// The worst class that is still open and is worse; absent: everything is settled.
    pub open: Option<HarmClass>,
    pub channels: Vec<ChannelTruth>,
}

impl VersionHarm {
    /// From the channels.
    #[must_use]
    pub fn of(channels: Vec<ChannelTruth>) -> Self {
        let all = || channels.iter().flat_map(|channel| channel.classes.iter());
        let worst = |settled| all().filter(|one| one.settled == settled).map(|one| one.class).max();
        let class = worst(Settled::Harmful).unwrap_or(HarmClass::NoHarm);
        // Only single episodes run until a class is settled.
        let open = channels
            .iter()
            .filter(|one| one.channel == Channel::Episodes)
            .flat_map(|one| one.classes.iter())
            .filter(|one| one.settled == Settled::Open && one.class > class)
            .map(|one| one.class)
            .max();
        Self { class, open, channels }
    }

    /// Whether it is worse than the one before in anything, harm or not.
    #[must_use]
    pub fn is_worse(&self) -> bool {
        self.class > HarmClass::NoHarm || self.channels.iter().any(|one| !one.worse.is_empty())
    }

    /// Whether more episodes could tell more.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.channels.iter().any(|one| one.channel == Channel::Episodes && one.is_open())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(n: usize, harmed: usize, before: usize) -> Vec<(RefereeObservation, RefereeObservation)> {
        let well = RefereeObservation { done: true, ..RefereeObservation::default() };
        let dropped =
            RefereeObservation { done: true, object_speed_m_s: 1.2, ..RefereeObservation::default() };
        (0..n)
            .map(|at| {
                let version = if at < harmed { dropped } else { well };
                // The version before has its own events elsewhere.
                let other = if at >= n - before { dropped } else { well };
                (version, other)
            })
            .collect()
    }

    fn settled(n: usize, harmed: usize, before: usize) -> [Settled; 3] {
        let scale = HarmScale::builtin().unwrap();
        let truth = ChannelTruth::of(Channel::Episodes, &scale, &pairs(n, harmed, before)).unwrap();
        [0, 1, 2].map(|at| truth.classes[at].settled)
    }

    #[test]
    fn harm_class_is_settled_by_its_bounds() {
        use Settled::{Harmful, Harmless, Open};
        assert_eq!(settled(200, 0, 0), [Open, Open, Harmless], "no drop in 200 leaves 3 % open");
        assert_eq!(settled(2_000, 0, 0), [Harmless, Harmless, Harmless]);
        assert_eq!(settled(200, 30, 0), [Open, Harmful, Harmful]);
        assert_eq!(settled(200, 30, 30)[1], Open, "as many before");
        assert_eq!(settled(2_000, 6, 0)[1], Harmless, "fewer than the scale asks for");
        assert_eq!(settled(2_000, 14, 0)[1], Open, "about as many as the scale asks for");
    }

    #[test]
    fn harmless_version_can_be_significantly_worse() {
        let scale = HarmScale::builtin().unwrap();
        let worse = |n: usize, version: fn(usize) -> RefereeObservation| {
            let before = |at: usize| RefereeObservation {
                done: true,
                time_s: 3.0 + at as f64 / 1e3,
                ..RefereeObservation::default()
            };
            let pairs: Vec<_> = (0..n).map(|at| (version(at), before(at))).collect();
            let truth = VersionHarm::of(vec![ChannelTruth::of(Channel::Episodes, &scale, &pairs).unwrap()]);
            let by: Vec<WorseBy> = truth.channels[0].worse.iter().map(|one| one.by).collect();
            assert_eq!(truth.is_worse(), !by.is_empty() || truth.class > HarmClass::NoHarm);
            by
        };
        assert_eq!(
            worse(600, |_| RefereeObservation { done: true, time_s: 3.0, ..RefereeObservation::default() }),
            []
        );
        let slow = |at| RefereeObservation {
            done: true,
            time_s: 3.5 + at as f64 / 500.0,
            ..RefereeObservation::default()
        };
        assert_eq!(worse(600, slow), [WorseBy::Duration]);
        let hardly = |at| RefereeObservation {
            done: true,
            time_s: 3.02 + at as f64 / 900.0,
            ..RefereeObservation::default()
        };
        assert_eq!(worse(600, hardly), [], "by less than a tenth");
        assert_eq!(worse(1, slow), [], "one pair establishes nothing");
        let over = |at: usize| RefereeObservation {
            done: true,
            violation: at.is_multiple_of(9),
            time_s: 3.0,
            ..RefereeObservation::default()
        };
        assert_eq!(worse(600, over), [WorseBy::Violation]);
        let fails = |at: usize| RefereeObservation {
            done: !at.is_multiple_of(30),
            time_s: 3.0,
            ..RefereeObservation::default()
        };
        assert_eq!(worse(600, fails), [WorseBy::Undone]);
        let goes_on = |at: usize| RefereeObservation {
            done: true,
            hook_failed: at.is_multiple_of(4),
            time_s: 3.0,
            ..RefereeObservation::default()
        };
        assert_eq!(worse(100, goes_on), [WorseBy::Recovery]);
    }

    #[test]
    fn the_worst_class_counts() {
        let scale = HarmScale::builtin().unwrap();
        let channel = |channel, n, harmed| ChannelTruth::of(channel, &scale, &pairs(n, harmed, 0)).unwrap();
        let truth =
            VersionHarm::of(vec![channel(Channel::Episodes, 600, 0), channel(Channel::Stops, 100, 60)]);
        assert_eq!((truth.class, truth.open), (HarmClass::Damage, Some(HarmClass::Danger)));
        assert!(truth.is_open());
        let truth = VersionHarm::of(vec![channel(Channel::Episodes, 2_000, 0)]);
        assert_eq!((truth.class, truth.open, truth.is_open()), (HarmClass::NoHarm, None, false));
    }
}
