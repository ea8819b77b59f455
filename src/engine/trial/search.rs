//! A search for the episode in which a candidate does most harm beside the version it would replace.
//!
//! A (3 + 4) evolution strategy with recombination (Beyer and Schwefel 2002) over the box of perturbations that the
//! sandbox's distribution declares. What was found is then run again and again on fresh noise, so that what is concluded
//! rests on those runs alone, however many places were tried before. Concludes nothing itself.

use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::profile::HarmSettings;
use holdpoint_governance::stats::PairedCounts;
use holdpoint_governance::worst_case_search::SearchFinding;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_sim::distribution::Distribution;
use holdpoint_sim::envelope::{AXES, EnvelopePoint};
use holdpoint_sim::rng::Stream;

/// Places drawn over the whole box, before there is anything to go by.
const FIRST: usize = 12;

/// Places of a generation.
const GENERATION: usize = 4;

/// The worst places so far, which a generation descends from.
const PARENTS: usize = 3;

/// All places that are tried.
const PLACES: usize = 48;

/// Pairs on fresh noise at the worst place.
const REPEATS: usize = 12;

/// All pairs of a search.
pub const PAIRS: u64 = (PLACES + REPEATS) as u64;

/// The chance that an axis comes from a second parent.
const CROSSED: f64 = 0.3;

/// The chance that an axis is changed: in a quarter of the cases it is sampled again, in a quarter set to an end of
/// its range, else moved.
const CHANGED: f64 = 0.4;

/// Standard deviation of a move, in shares of an axis.
const STEP: f64 = 0.2;

/// How a place is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchStyle {
    /// Descending from the worst places so far.
    Evolution,
    /// Anywhere, as the sandbox draws: what a search is compared with.
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
    /// From which values on an episode is a bad one.
    limits: HarmSettings,
    stream: Stream,
    /// The places of the generation that are not worked yet.
    open: Vec<EnvelopePoint>,
    /// In the order they were worked.
    tried: Vec<TriedPoint>,
    /// On fresh noise at the worst place: whether a limit was passed, by the candidate and by the active version.
    repeats: Vec<(bool, bool)>,
}

impl Search {
    /// A search of a run's seed; what harm is, the profile's limits of an episode say.
    #[must_use]
    pub fn new(seed: u64, style: SearchStyle, limits: HarmSettings) -> Self {
        // A raw state, apart from every stream of an episode.
        let mut stream = Stream::from_state(seed ^ 0x5ea2_c4ed_0000_0001);
        let open = (0..FIRST).map(|_| anywhere(&mut stream)).collect();
        Self { style, limits, stream, open, tried: Vec::new(), repeats: Vec::new() }
    }

    /// The places to work next, at most `most` of them, the number of the first pair among all of the search; empty when
    /// it is over.
    #[must_use]
    pub fn next(&self, most: usize) -> (u64, Vec<EnvelopePoint>) {
        let worked = self.tried.len() + self.repeats.len();
        let points = if self.tried.len() < PLACES {
            self.open.iter().copied().take(most).collect()
        } else {
            let left = REPEATS - self.repeats.len();
            self.worst().map_or_else(Vec::new, |worst| vec![worst.point; left.min(most)])
        };
        (worked as u64, points)
    }

    /// What came of places, in their order: candidate and active version.
    pub fn take(&mut self, worked: &[(EnvelopePoint, TaskRecord, TaskRecord)]) {
        for (point, candidate, active) in worked {
            if self.tried.len() < PLACES {
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

    /// Pairs worked.
    #[must_use]
    pub fn done(&self) -> u64 {
        (self.tried.len() + self.repeats.len()) as u64
    }

    /// Whether all is worked.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.repeats.len() >= REPEATS
    }

    /// What was found; `distribution` is what the places are shares of.
    #[must_use]
    pub fn found(&self, distribution: &Distribution) -> Option<SearchFinding> {
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
        (0..GENERATION)
            .map(|_| match style {
                SearchStyle::Random => anywhere(&mut self.stream),
                SearchStyle::Evolution => descendant(&parents, &mut self.stream),
            })
            .collect()
    }
}

fn anywhere(stream: &mut Stream) -> EnvelopePoint {
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
        if stream.chance(CROSSED) {
            *share = other[axis];
        }
        if !stream.chance(CHANGED) {
            continue;
        }
        *share = match stream.unit() {
            draw if draw < 0.25 => stream.unit(),
            draw if draw < 0.5 => libm::round(stream.unit()),
            _ => (*share + STEP * stream.normal()).clamp(0.0, 1.0),
        };
    }
    point
}

/// Whether an episode counts against a version: a limit was passed, of a stop, of the guard or of a measure of harm. To
/// fail is no harm, and somewhere in the envelope every other way of working fails more often.
fn is_harmful(record: &TaskRecord, limits: &HarmSettings) -> bool {
    let is_past = |kind| limit_ratio(record, kind, limits) > 1.0;
    record.violation || record.hard_stop.is_some() || HarmKind::ALL.into_iter().any(is_past)
}

/// A measure as a share of its limit: above 1 it is past it; a distance is taken the other way round.
fn limit_ratio(record: &TaskRecord, kind: HarmKind, limits: &HarmSettings) -> f64 {
    let harm = record.harm.unwrap_or(HarmMeasures::STILL);
    let (value, limit) = (harm.of(kind), limits.of(kind).limit);
    if kind.is_worse_when_lower() {
        if value <= 0.0 { SHARE_MAX } else { limit / value }
    } else {
        value / limit.max(f64::MIN_POSITIVE)
    }
}

/// How far past its limit a measure still counts.
const SHARE_MAX: f64 = 3.0;

/// How bad an episode was, for the search to climb by; no rule reads it.
#[must_use]
pub fn severity(record: &TaskRecord, limits: &HarmSettings) -> f64 {
    if record.invalid {
        return 0.0;
    }
    let flag = |is: bool| f64::from(u8::from(is));
    let harm: f64 = HarmKind::ALL
        .into_iter()
        .map(|kind| limit_ratio(record, kind, limits).clamp(0.0, SHARE_MAX))
        .map(|share| 0.2 * share + flag(share > 1.0))
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

    fn searched(seed: u64, style: SearchStyle, part: usize) -> Search {
        let mut search = Search::new(seed, style, limits());
        while !search.is_over() {
            let (_, points) = search.next(part);
            let worked: Vec<_> = points
                .into_iter()
                .map(|point| {
                    let (candidate, active) = corner(&point);
                    (point, candidate, active)
                })
                .collect();
            search.take(&worked);
        }
        search
    }

    #[test]
    fn a_corner_is_found_that_draws_seldom_hit() {
        let found = |style| (0..40).filter(|seed| searched(*seed, style, 5).repeats[0].0).count();
        let (climbed, drawn) = (found(SearchStyle::Evolution), found(SearchStyle::Random));
        // One percent of the box: 48 draws hit it in two searches of five.
        assert!(climbed >= 30 && drawn <= 24, "{climbed} of 40 by search, {drawn} by draws");
    }

    #[test]
    fn parts_change_nothing_and_all_is_worked() {
        let (whole, parts) =
            (searched(3, SearchStyle::Evolution, 100), searched(3, SearchStyle::Evolution, 5));
        assert_eq!((&whole.tried, &whole.repeats), (&parts.tried, &parts.repeats));
        assert_eq!(whole.done(), PAIRS);
        let distribution = Distribution::sandbox().unwrap();
        let found = whole.found(&distribution).unwrap();
        assert_eq!((found.tried, found.repeats.pairs), (48, 12));
        assert_eq!(found.place.len(), AXES.len());
    }
}
