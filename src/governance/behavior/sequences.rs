//! Effects of a candidate on the following skills: whole sequences, compared in pairs.
//!
//! A sequence runs with the candidate in its place and the other families' active versions in theirs, and on the same
//! seed with the active version in its place. The comparison covers the part after the handover, in the pairs in which
//! both came so far: whether the sequence was done, and how the skills that *follow* performed. The candidate's own
//! work is compared in far more pairs of its own. A candidate of the last skill is judged by its success on what the
//! preceding skills really hand over. At most a rate of `sequence_alpha` of equally good versions raises a concern
//! (Bonferroni): half of it is for sequences not done, a sixth each for violations, for anomalies, and for time, bad
//! episodes and the measures of harm together. A significant worsening beyond its margin makes a version incompatible.
//! A concern needs a significant worsening of a rate, or one beyond half of the margin of a measured quantity, where
//! trivial differences can be significant. An inconclusive measure raises no concern here: so few sequences exclude
//! nothing small. Source: design rule 3.4.

use holdpoint_body::TaskKind;
use serde::{Deserialize, Serialize};

use super::{BehaviorAssessment, concern_conditions, overrule, real_pairs, reason};
use crate::distribution_shift::TRIFLE;
use crate::evidence::EpisodeValues;
use crate::finding::{EvidenceGap, Finding, SequenceEnds};
use crate::harm::{HarmKind, HarmMeasures};
use crate::ids::CapabilityId;
use crate::outcome::BehaviorOutcome;
use crate::profile::Profile;
use crate::stats::{PairedCounts, binary_pairs};

/// One task of a sequence, as run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceStep {
    /// The task; [`SequenceEvidence::beside`] names its version.
    pub task: TaskKind,
    /// Its values.
    pub values: EpisodeValues,
}

/// The same sequence with either version in its place. A side ends with the first task that was not done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequencePair {
    /// Seed of the sequence; no two pairs share one.
    pub seed: u64,
    /// With the active version in its place.
    pub active: Vec<SequenceStep>,
    /// With the candidate in its place.
    pub candidate: Vec<SequenceStep>,
}

/// The sequences of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceEvidence {
    /// The place of the candidate.
    pub task: TaskKind,
    /// The tasks of the cell, in their order; not written if they are grasp, align and place, as in the first records.
    #[serde(default = "unwritten", skip_serializing_if = "is_unwritten")]
    pub sequence: Vec<TaskKind>,
    /// The active versions in the other tasks, in order; one is missing if a family has none.
    pub beside: Vec<CapabilityId>,
    /// The number that the profile requires.
    pub wanted: u32,
    /// In ascending order of seed; empty if they could not be run.
    pub pairs: Vec<SequencePair>,
}

/// The sequence of every record that states none. It stays as it is, whatever tasks the built-in cell has.
const UNWRITTEN: [TaskKind; 3] = [TaskKind::Grasp, TaskKind::Align, TaskKind::Place];

fn unwritten() -> Vec<TaskKind> {
    UNWRITTEN.to_vec()
}

fn is_unwritten(sequence: &[TaskKind]) -> bool {
    *sequence == UNWRITTEN
}

/// A measure of sequences; in records a word, or the name of a measure of harm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SequenceMeasure {
    /// Share of sequences that reached the handover and were not done.
    NotDone,
    /// Share of sequences in which a skill that follows passed a limit of policy.
    Violation,
    /// Share of sequences in which a skill that follows showed an anomaly.
    Anomaly,
    /// Share of sequences in which a skill that follows passed the limit of any measure of harm.
    PastLimit,
    /// Relative increase of the time of the skills that follow, over pairs in which both sequences were done.
    Time,
    /// A measure of harm at its worst over the skills that follow, over the same pairs, in its unit.
    Harm(HarmKind),
}

/// One comparison over all pairs of sequences.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceComparison {
    /// The measure.
    pub measure: SequenceMeasure,
    /// Share or mean with the active version in its place.
    pub active: f64,
    /// Share or mean with the candidate in its place.
    pub candidate: f64,
    /// Mean worsening; negative is an improvement.
    pub worsening: f64,
    /// One-sided lower bound of it, at its part of `sequence_alpha`.
    pub lower: f64,
    /// One-sided upper bound at the same level: what these pairs do not exclude. Nothing is decided by it.
    pub upper: f64,
    /// How much worse it may be.
    pub tolerance: f64,
    /// Pairs it rests on.
    pub pairs: u32,
}

/// The part of the error rate for sequences not done: a bad handover shows there first.
const NOT_DONE_PART: f64 = 0.5;

/// Each of the other three parts.
const OTHER_PART: f64 = (1.0 - NOT_DONE_PART) / 3.0;

/// Comparisons that share the last part: bad episodes, time, and each measure of harm.
const SHARING: f64 = (2 + HarmKind::ALL.len()) as f64;

impl SequenceEvidence {
    fn is_done(&self, side: &[SequenceStep]) -> bool {
        side.len() == self.sequence.len() && side.iter().all(|step| step.values.success)
    }

    /// Whether the task follows the candidate's.
    fn is_after(&self, task: TaskKind) -> bool {
        let place = |of: TaskKind| self.sequence.iter().position(|known| *known == of);
        place(task) > place(self.task)
    }

    /// The task after the candidate's; `None` if that is the last.
    fn next_task(&self) -> Option<TaskKind> {
        self.sequence.iter().copied().find(|task| self.is_after(*task))
    }

    /// Whether both reached the judged part: the skill after the candidate's, or that one itself if it is the last.
    fn is_reached(&self, pair: &SequencePair) -> bool {
        let judged = self.next_task().unwrap_or(self.task);
        let comes_to = |side: &[SequenceStep]| side.iter().any(|step| step.task == judged);
        comes_to(&pair.candidate) && comes_to(&pair.active)
    }

    /// The values of the skills after the candidate's, in order.
    fn following<'a>(&self, side: &'a [SequenceStep]) -> impl Iterator<Item = &'a EpisodeValues> {
        side.iter().filter(move |step| self.is_after(step.task)).map(|step| &step.values)
    }

    /// A measure at its worst over the skills that follow; `None` where nothing follows or nothing was measured.
    fn worst(&self, side: &[SequenceStep], kind: HarmKind) -> Option<f64> {
        let values = self.following(side).map(|values| values.harm.map(|harm: HarmMeasures| harm.of(kind)));
        values.reduce(|worst, next| {
            let (worst, next) = (worst?, next?);
            Some(if kind.worsening(next, worst) > 0.0 { next } else { worst })
        })?
    }

    /// The pairs in which both reached the judged part.
    fn reached(&self) -> impl Iterator<Item = &SequencePair> + Clone {
        self.pairs.iter().filter(move |pair| self.is_reached(pair))
    }

    fn rate(
        &self,
        measure: SequenceMeasure,
        alpha: f64,
        tolerance: f64,
        is_bad: &dyn Fn(&[SequenceStep]) -> bool,
    ) -> Option<SequenceComparison> {
        let sides = || self.reached().map(|pair| (is_bad(&pair.candidate), is_bad(&pair.active)));
        let bound = binary_pairs(PairedCounts::of(sides()), alpha).ok()?;
        let n = bound.n as f64;
        let count = |of: fn((bool, bool)) -> bool| sides().filter(|pair| of(*pair)).count() as f64;
        Some(SequenceComparison {
            measure,
            active: count(|(_, old)| old) / n,
            candidate: count(|(new, _)| new) / n,
            worsening: bound.mean,
            lower: bound.lower,
            upper: bound.upper,
            tolerance,
            pairs: u32::try_from(bound.n).unwrap_or(u32::MAX),
        })
    }

    /// A measured quantity over the pairs in which both sequences were done: how much worse, from both values.
    fn quantity(
        &self,
        measure: SequenceMeasure,
        alpha: f64,
        tolerance: f64,
        of: &dyn Fn(&[SequenceStep]) -> Option<f64>,
        worsening: &dyn Fn(f64, f64) -> f64,
    ) -> Option<SequenceComparison> {
        let done = |pair: &&SequencePair| self.is_done(&pair.candidate) && self.is_done(&pair.active);
        let both: Option<Vec<(f64, f64)>> = self
            .pairs
            .iter()
            .filter(done)
            .map(|pair| Some((of(&pair.candidate)?, of(&pair.active)?)))
            .collect();
        let both = both.filter(|both| both.len() >= 2)?;
        let worse: Vec<f64> = both.iter().map(|(new, old)| worsening(*new, *old)).collect();
        let bound = real_pairs(&worse, tolerance, alpha).ok()?;
        let n = both.len() as f64;
        Some(SequenceComparison {
            measure,
            active: both.iter().map(|(_, old)| old).sum::<f64>() / n,
            candidate: both.iter().map(|(new, _)| new).sum::<f64>() / n,
            worsening: bound.mean,
            lower: bound.lower,
            upper: bound.upper,
            tolerance,
            pairs: u32::try_from(both.len()).unwrap_or(u32::MAX),
        })
    }

    /// Every comparison that these sequences allow.
    #[must_use]
    pub fn compare(&self, profile: &Profile) -> Vec<SequenceComparison> {
        use SequenceMeasure::{Anomaly, Harm, NotDone, PastLimit, Time, Violation};
        let alpha = profile.evaluation.sequence_alpha;
        let part = OTHER_PART * alpha;
        let shared = part / SHARING;
        let allowed = profile.evaluation.sequence_tolerance;
        let any =
            |side: &[SequenceStep], flag: &dyn Fn(&EpisodeValues) -> bool| self.following(side).any(flag);
        let is_past = |values: &EpisodeValues| values.harm.is_some_and(|harm| profile.harm.is_past(&harm));
        let time_allowed = (1.0 - profile.thresholds.behavior()) / profile.behavior.cost_time;
        let time = |side: &[SequenceStep]| {
            let took: f64 = self.following(side).map(|values| values.time_s).sum();
            (took > 0.0).then_some(took)
        };
        let mut all = vec![
            self.rate(NotDone, NOT_DONE_PART * alpha, allowed, &|side| !self.is_done(side)),
            self.rate(Violation, part, allowed, &|side| any(side, &|values| values.violation)),
            self.rate(Anomaly, part, allowed, &|side| any(side, &|values| values.anomaly)),
            self.rate(PastLimit, shared, allowed, &|side| any(side, &is_past)),
            self.quantity(Time, shared, time_allowed, &time, &|new, old| new / old - 1.0),
        ];
        all.extend(HarmKind::ALL.into_iter().map(|kind| {
            let allowed = profile.harm.of(kind).mean;
            let of = |side: &[SequenceStep]| self.worst(side, kind);
            self.quantity(Harm(kind), shared, allowed, &of, &|new, old| kind.worsening(new, old))
        }));
        all.into_iter().flatten().collect()
    }

    /// The task at which sequences end that much more often than with the active version, and how often. `None` if it is not a
    /// task after the candidate's.
    fn ends(&self) -> Option<SequenceEnds> {
        let ends_at = |side: &[SequenceStep], task| {
            !self.is_done(side) && side.last().is_some_and(|step| step.task == task)
        };
        let counted = self.sequence.iter().map(|&task| {
            let new = self.reached().filter(|pair| ends_at(&pair.candidate, task)).count() as u64;
            let old = self.reached().filter(|pair| ends_at(&pair.active, task)).count() as u64;
            (task, new, old)
        });
        let (task, candidate, active) = counted.max_by_key(|(_, new, old)| new.saturating_sub(*old))?;
        let is_next = self.next_task() == Some(task);
        self.is_after(task).then_some(SequenceEnds { task, is_next, candidate, active })
    }

    /// A seed under which a comparison came out worst, to be re-run.
    fn example(&self, measure: SequenceMeasure, profile: &Profile) -> Option<u64> {
        let bad = |side: &[SequenceStep]| match measure {
            SequenceMeasure::NotDone => f64::from(u8::from(!self.is_done(side))),
            SequenceMeasure::Violation => {
                f64::from(u8::from(self.following(side).any(|values| values.violation)))
            }
            SequenceMeasure::Anomaly => {
                f64::from(u8::from(self.following(side).any(|values| values.anomaly)))
            }
            SequenceMeasure::PastLimit => {
                let past =
                    |values: &EpisodeValues| values.harm.is_some_and(|harm| profile.harm.is_past(&harm));
                f64::from(u8::from(self.following(side).any(past)))
            }
            SequenceMeasure::Time => self.following(side).map(|values| values.time_s).sum(),
            SequenceMeasure::Harm(kind) => {
                self.worst(side, kind).map_or(0.0, |value| kind.worsening(value, 0.0))
            }
        };
        let gap = |pair: &SequencePair| bad(&pair.candidate) - bad(&pair.active);
        self.reached().max_by(|a, b| gap(a).total_cmp(&gap(b))).map(|pair| pair.seed)
    }

    /// The finding of one comparison: both sides, the margin, and an example seed.
    fn finding(&self, found: &SequenceComparison, is_established: bool, profile: &Profile) -> Finding {
        let SequenceComparison { measure, active, candidate, tolerance, pairs, .. } = *found;
        let ends = if measure == SequenceMeasure::NotDone { self.ends() } else { None };
        let seed = self.example(measure, profile);
        if is_established {
            Finding::SequenceWorse { measure, active, candidate, tolerance, pairs, ends, seed }
        } else {
            Finding::SequencePossiblyWorse { measure, active, candidate, tolerance, pairs, ends, seed }
        }
    }

    /// Why these sequences cannot be assessed; `None` if they can.
    fn unusable(&self, profile: &Profile) -> Option<Finding> {
        let mut seeds = std::collections::BTreeSet::new();
        let plausible = |pair: &SequencePair| {
            let mut steps = pair.active.iter().chain(&pair.candidate);
            steps.all(|step| step.values.is_valid()) && seeds.insert(pair.seed)
        };
        let (ran, budget, reached) =
            (self.pairs.len() as u64, u64::from(self.wanted), self.reached().count() as u64);
        if self.beside.len() + 1 < self.sequence.len() {
            Some(Finding::SequencesNotRun)
        } else if ran < budget {
            Some(Finding::TooFewSequences { ran, asked: budget })
        } else if (reached as f64) < profile.evaluation.sequences_reached_share * budget as f64 {
            Some(Finding::TooFewHandovers { reached, ran })
        } else if !self.pairs.iter().all(plausible) {
            Some(Finding::SequenceGap { gap: EvidenceGap::Implausible })
        } else {
            None
        }
    }
}

impl SequenceComparison {
    /// Significantly worse beyond the margin.
    #[must_use]
    pub fn is_established(&self) -> bool {
        self.lower > self.tolerance
    }

    /// Significantly worse: a rate at all, a measured quantity by half of its margin.
    #[must_use]
    pub fn is_concern(&self) -> bool {
        let trifle = match self.measure {
            SequenceMeasure::NotDone
            | SequenceMeasure::Violation
            | SequenceMeasure::Anomaly
            | SequenceMeasure::PastLimit => 0.0,
            SequenceMeasure::Time | SequenceMeasure::Harm(_) => TRIFLE * self.tolerance,
        };
        // Written so that a NaN bound is a concern.
        !(self.lower <= trifle)
    }
}

/// Adds the findings of the sequences to an assessment that does not reject yet. Ignores records without sequences.
pub fn apply_sequences(
    result: &mut BehaviorAssessment,
    evidence: Option<&SequenceEvidence>,
    profile: &Profile,
) {
    let Some(evidence) = evidence else { return };
    if !matches!(result.assessment.outcome, BehaviorOutcome::Compatible | BehaviorOutcome::Suspicious) {
        return;
    }
    let (mut worse, mut doubts) = (Vec::new(), Vec::new());
    if let Some(why) = evidence.unusable(profile) {
        let few = reason(why);
        doubts.push(few.with(evidence.pairs.len() as f64, f64::from(evidence.wanted)));
    } else {
        result.sequences = evidence.compare(profile);
        for found in &result.sequences {
            let is_established = found.is_established();
            if is_established || found.is_concern() {
                let finding = evidence.finding(found, is_established, profile);
                let list = if is_established { &mut worse } else { &mut doubts };
                list.push(reason(finding).with(found.lower, found.tolerance));
            }
        }
    }
    if !worse.is_empty() {
        overrule(result, BehaviorOutcome::Incompatible, worse.into_iter().chain(doubts));
    } else if !doubts.is_empty() {
        overrule(result, BehaviorOutcome::Suspicious, doubts);
        result.assessment.conditions = concern_conditions(profile);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::ProfileName;

    fn evidence(task: TaskKind, sequence: &[TaskKind]) -> SequenceEvidence {
        let sequence = sequence.to_vec();
        SequenceEvidence { task, sequence, beside: Vec::new(), wanted: 4, pairs: Vec::new() }
    }

    #[test]
    fn the_next_task_is_that_of_the_cell() {
        let [grasp, align, place] = UNWRITTEN;
        for (task, sequence, next) in [
            (grasp, vec![grasp, align, place], Some(align)),
            (place, vec![grasp, align, place], None),
            (grasp, vec![grasp, place], Some(place)),
            (align, vec![align, grasp], Some(grasp)),
            (grasp, vec![align, grasp], None),
        ] {
            assert_eq!(evidence(task, &sequence).next_task(), next, "{task} in {sequence:?}");
        }
    }

    #[test]
    fn as_many_versions_are_needed_as_the_cell_has_tasks() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let [grasp, ..] = UNWRITTEN;
        let unusable = |sequence: &[TaskKind]| evidence(grasp, sequence).unusable(&profile);
        assert_eq!(unusable(&UNWRITTEN), Some(Finding::SequencesNotRun));
        assert_eq!(unusable(&[grasp]), Some(Finding::TooFewSequences { ran: 0, asked: 4 }));
    }

    #[test]
    fn evidence_without_a_sequence_has_that_of_the_first_records() {
        let [grasp, _, place] = UNWRITTEN;
        let unwritten = evidence(grasp, &UNWRITTEN);
        let text = serde_json::to_string(&unwritten).unwrap();
        assert_eq!(text, r#"{"task":"grasp","beside":[],"wanted":4,"pairs":[]}"#);
        assert_eq!(serde_json::from_str::<SequenceEvidence>(&text).unwrap(), unwritten);
        let other = evidence(grasp, &[grasp, place]);
        let text = serde_json::to_string(&other).unwrap();
        assert_eq!(serde_json::from_str::<SequenceEvidence>(&text).unwrap(), other);
    }
}
