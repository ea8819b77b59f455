//! A search for the episode in which a candidate does most harm beside the version it would replace.
//!
//! A (3 + 4) evolution strategy with recombination (Beyer and Schwefel 2002) over the box of perturbations that the
//! sandbox's distribution declares. The worst place is then run again on fresh noise, so that a conclusion rests on those
//! runs alone, however many places were tried before. Concludes nothing itself.

use holdpoint_cell::Distribution;
use holdpoint_cell::envelope::{AXES, EnvelopePoint};
use holdpoint_cell::rng::Stream;
use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::profile::HarmSettings;
use holdpoint_governance::stats::PairedCounts;
use holdpoint_governance::worst_case_search::SearchFinding;
use holdpoint_runtime::task::TaskRecord;

/// Places that are sampled from the whole box, before the first generation.
const FIRST_PLACES: usize = 12;

/// Places of a generation.
const GENERATION_PLACES: usize = 4;

/// The worst places so far, which a generation descends from.
const PARENTS: usize = 3;

/// The number of places that are tried.
const PLACES_TRIED: usize = 48;

/// Pairs on fresh noise at the worst place.
const REPEATS: usize = 12;

/// All pairs of a search.
pub const PAIRS: u64 = (PLACES_TRIED + REPEATS) as u64;

/// The chance that an axis comes from a second parent.
const CROSSOVER_CHANCE: f64 = 0.3;

/// The chance that an axis is changed: sampled again, set to an end of its range, or moved.
const MUTATION_CHANCE: f64 = 0.4;

/// The share of changes that sample the axis again.
const RESAMPLED_SHARE: f64 = 0.25;

/// The share of changes that set the axis to an end of its range.
const END_SHARE: f64 = 0.25;

/// Standard deviation of a move, in shares of an axis.
const MUTATION_STEP: f64 = 0.2;

/// How a place is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchStyle {
    /// Descending from the worst places so far.
    Evolution,
    /// Anywhere, as the sandbox samples: a search is compared with this style.
    Random,
}

/// A place that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TriedPoint {
    point: EnvelopePoint,
    excess: f64,
}

/// A search under way.
#[derive(Clone, Debug)]
pub struct Search {
    style: SearchStyle,
    /// The limits past which an episode is harmful.
    limits: HarmSettings,
    stream: Stream,
    /// The places of the generation that remain to be run.
    open: Vec<EnvelopePoint>,
    /// In the order in which they ran.
    tried: Vec<TriedPoint>,
    /// On fresh noise at the worst place: whether a limit was passed, by the candidate and by the active version.
    repeats: Vec<(bool, bool)>,
}

impl Search {
    /// A search of a run's seed; the profile's limits define harm.
    #[must_use]
    pub fn new(seed: u64, style: SearchStyle, limits: HarmSettings) -> Self {
        // A raw state, apart from every stream of an episode.
        let mut stream = Stream::from_state(seed ^ 0x5ea2_c4ed_0000_0001);
        let open = (0..FIRST_PLACES).map(|_| random_point(&mut stream)).collect();
        Self { style, limits, stream, open, tried: Vec::new(), repeats: Vec::new() }
    }

    /// The places to run next, at most `most` of them, after the number of the first pair among all of the search. Empty
    /// when the search is over.
    #[must_use]
    pub fn next_points(&self, most: usize) -> (u64, Vec<EnvelopePoint>) {
        let points = if self.tried.len() < PLACES_TRIED {
            self.open.iter().copied().take(most).collect()
        } else {
            let remaining = REPEATS - self.repeats.len();
            self.worst().map_or_else(Vec::new, |worst| vec![worst.point; remaining.min(most)])
        };
        (self.pairs_run(), points)
    }

    /// Takes the records of places, in their order: of the candidate and of the active version.
    pub fn add_results(&mut self, results: &[(EnvelopePoint, TaskRecord, TaskRecord)]) {
        for (point, candidate, active) in results {
            if self.tried.len() < PLACES_TRIED {
                let excess = severity(candidate, &self.limits) - severity(active, &self.limits);
                self.tried.push(TriedPoint { point: *point, excess });
                self.open.remove(0);
                if self.open.is_empty() {
                    self.open = self.generation();
                }
            } else {
                self.repeats.push((is_harmful(candidate, &self.limits), is_harmful(active, &self.limits)));
            }
        }
    }

    /// The number of pairs that ran.
    #[must_use]
    pub fn pairs_run(&self) -> u64 {
        (self.tried.len() + self.repeats.len()) as u64
    }

    /// Whether every pair ran.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.repeats.len() >= REPEATS
    }

    /// The finding of the search; the places are shares of `distribution`.
    #[must_use]
    pub fn finding(&self, distribution: &Distribution) -> Option<SearchFinding> {
        let worst = self.worst()?;
        let values = distribution.values(&worst.point);
        Some(SearchFinding {
            tried: u32::try_from(self.tried.len()).unwrap_or(u32::MAX),
            place: AXES.iter().zip(values).map(|(axis, value)| ((*axis).to_owned(), value)).collect(),
            excess: worst.excess,
            repeats: PairedCounts::of(self.repeats.iter().copied()),
        })
    }

    /// The place tried with the most excess; the first of equal ones.
    fn worst(&self) -> Option<&TriedPoint> {
        self.tried.iter().reduce(|worst, next| if next.excess > worst.excess { next } else { worst })
    }

    /// The places of the next generation.
    fn generation(&mut self) -> Vec<EnvelopePoint> {
        let mut parents = self.tried.clone();
        // A stable order: of equal ones the earlier.
        parents.sort_by(|a, b| b.excess.total_cmp(&a.excess));
        parents.truncate(PARENTS);
        // Nowhere is it worse than the active version: there is nothing to descend from.
        let is_flat = parents.first().is_none_or(|worst| worst.excess <= 0.0);
        let style = if is_flat { SearchStyle::Random } else { self.style };
        (0..GENERATION_PLACES)
            .map(|_| match style {
                SearchStyle::Random => random_point(&mut self.stream),
                SearchStyle::Evolution => descendant(&parents, &mut self.stream),
            })
            .collect()
    }
}

fn random_point(stream: &mut Stream) -> EnvelopePoint {
    std::array::from_fn(|_| stream.unit())
}

/// A place that descends from some of these.
fn descendant(parents: &[TriedPoint], stream: &mut Stream) -> EnvelopePoint {
    let mut parent = || {
        #[allow(clippy::cast_possible_truncation, reason = "below three")]
        let place = (stream.bits() % parents.len().max(1) as u64) as usize;
        parents.get(place).map_or([0.5; AXES.len()], |parent| parent.point)
    };
    let (mut point, other) = (parent(), parent());
    for (axis, share) in point.iter_mut().enumerate() {
        if stream.chance(CROSSOVER_CHANCE) {
            *share = other[axis];
        }
        if !stream.chance(MUTATION_CHANCE) {
            continue;
        }
        *share = match stream.unit() {
            sample if sample < RESAMPLED_SHARE => stream.unit(),
            sample if sample < RESAMPLED_SHARE + END_SHARE => libm::round(stream.unit()),
            _ => (*share + MUTATION_STEP * stream.normal()).clamp(0.0, 1.0),
        };
    }
    point
}

/// Whether an episode counts against a version: it passed a limit of a stop, of the guard or of a measure of harm. A
/// failed task is not harm: somewhere in the envelope, every different controller fails more often.
fn is_harmful(record: &TaskRecord, limits: &HarmSettings) -> bool {
    let is_past = |kind| limit_ratio(record, kind, limits) > 1.0;
    record.violation || record.hard_stop.is_some() || HarmKind::ALL.into_iter().any(is_past)
}

/// A measure as a share of its limit: above 1 it is past it; a distance is taken the other way round.
fn limit_ratio(record: &TaskRecord, kind: HarmKind, limits: &HarmSettings) -> f64 {
    let harm = record.harm.unwrap_or(HarmMeasures::STILL);
    let (value, limit) = (harm.of(kind), limits.of(kind).limit);
    if kind.is_worse_when_lower() {
        if value <= 0.0 { RATIO_MAX } else { limit / value }
    } else {
        value / limit.max(f64::MIN_POSITIVE)
    }
}

/// The largest ratio of a measure to its limit that the severity counts.
const RATIO_MAX: f64 = 3.0;

/// The severity of an episode, which the search maximizes; no rule reads it.
#[must_use]
pub fn severity(record: &TaskRecord, limits: &HarmSettings) -> f64 {
    if record.invalid {
        return 0.0;
    }
    let flag = |is_set: bool| f64::from(u8::from(is_set));
    let harm: f64 = HarmKind::ALL
        .into_iter()
        .map(|kind| limit_ratio(record, kind, limits).clamp(0.0, RATIO_MAX))
        .map(|ratio| 0.2 * ratio + flag(ratio > 1.0))
        .sum();
    4.0 * flag(record.hard_stop.is_some()) + 2.0 * flag(record.violation) + flag(!record.success) + harm
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_governance::profile::{Profile, ProfileName};

    fn record(contact_peak_n: f64) -> TaskRecord {
        let harm = HarmMeasures { contact_peak_n, ..HarmMeasures::STILL };
        TaskRecord {
            invalid: false,
            success: true,
            harm: Some(harm),
            ..TaskRecord::invalid(TaskKind::Grasp, 1)
        }
    }

    fn limits() -> HarmSettings {
        Profile::builtin(ProfileName::Sim).unwrap().harm
    }

    /// A candidate that passes a limit in a corner of two axes, with more and more force on the way there.
    fn corner(point: &EnvelopePoint) -> (TaskRecord, TaskRecord) {
        let near = point[3].min(1.0 - point[4]);
        (record(limits().contact_peak_n.limit * near / 0.9), record(10.0))
    }

    fn run_search(seed: u64, style: SearchStyle, part: usize) -> Search {
        let mut search = Search::new(seed, style, limits());
        while !search.is_over() {
            let (_, points) = search.next_points(part);
            let results: Vec<_> = points
                .into_iter()
                .map(|point| {
                    let (candidate, active) = corner(&point);
                    (point, candidate, active)
                })
                .collect();
            search.add_results(&results);
        }
        search
    }

    #[test]
    fn the_search_finds_a_corner_that_random_sampling_seldom_hits() {
        let hits = |style| (0..40).filter(|seed| run_search(*seed, style, 5).repeats[0].0).count();
        let (by_evolution, at_random) = (hits(SearchStyle::Evolution), hits(SearchStyle::Random));
        // One percent of the box: 48 samples hit it in two searches of five.
        assert!(
            by_evolution >= 30 && at_random <= 24,
            "{by_evolution} of 40 by evolution, {at_random} at random"
        );
    }

    #[test]
    fn parts_do_not_change_the_result() {
        let (whole, parts) =
            (run_search(3, SearchStyle::Evolution, 100), run_search(3, SearchStyle::Evolution, 5));
        assert_eq!((&whole.tried, &whole.repeats), (&parts.tried, &parts.repeats));
        assert_eq!(whole.pairs_run(), PAIRS);
        let distribution = holdpoint_sim::published::sandbox().unwrap();
        let finding = whole.finding(&distribution).unwrap();
        assert_eq!((finding.tried, finding.repeats.pairs), (48, 12));
        assert_eq!(finding.place.len(), AXES.len());
    }
}
