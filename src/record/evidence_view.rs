//! A candidate's evidence as rows: paired comparison, sandbox modes, drills, shadow.
//!
//! Puts measured values beside their limits; what was not measured is left out, never filled in.

use crate::evidence_file::EvidenceFile;
use holdpoint_governance::behavior::{self, BehaviorAssessment, ComponentName, SequenceMeasure};
use holdpoint_governance::evidence::{DrillKind, DrillTally, Pair, ShadowSequence, Signature};
use holdpoint_governance::explanation::{MeasuredQuantity, ShadowDifference, ShadowEvent};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::profile::EvaluationSettings;
use holdpoint_governance::stats::{SHOWN_LEVEL, wilson};
use holdpoint_protocol::detail::{DrillView, MeasuredValue, ModeView, PhaseDrillView};
use holdpoint_protocol::snapshot::{Disagreement, PairsView, ShadowView};
use holdpoint_trials::mode_metrics::{ComparedVersion, Metric, ModeMetrics, VersionMode};
use holdpoint_wording::lookup::{measured_quantity, shadow_difference};

/// The most disagreements shown.
const DISAGREEMENTS_MAX: usize = 50;

/// The components of the behavioral comparison, and the measures of harm: worsening against the margin.
#[must_use]
pub fn behavior(evidence_file: &EvidenceFile) -> Vec<MeasuredValue> {
    let Some(behavior) = &evidence_file.behavior else { return Vec::new() };
    let n = u64::from(behavior.pairs);
    let components = behavior.components.iter().map(|component| {
        let means = compared_means(component.name, behavior, &evidence_file.pairs);
        MeasuredValue {
            name: measured_quantity(&MeasuredQuantity::Component(component.name)),
            candidate: means.map(|[candidate, _]| candidate),
            active: means.map(|[_, active]| active),
            interval: component.upper.map(|upper| [component.lower, upper]),
            limit: Some(component.tolerance),
            n,
        }
    });
    // A measure in which the two do not differ says nothing of either.
    let differing = behavior.harm.iter().filter(|harm| harm.worsening != 0.0 || !harm.is_within_tolerance());
    let harm = differing.map(|harm| MeasuredValue {
        name: measured_quantity(&MeasuredQuantity::Harm(harm.kind)),
        candidate: Some(harm.candidate),
        active: Some(harm.active),
        interval: harm.upper.map(|upper| [harm.lower, upper]),
        limit: Some(harm.tolerance),
        n,
    });
    // Of the measures of harm after it those that put it in doubt.
    let relevant = behavior.sequences.iter().filter(|found| {
        !matches!(found.measure, SequenceMeasure::Harm(_)) || found.is_concern() || found.is_established()
    });
    let sequences = relevant.map(|found| MeasuredValue {
        name: measured_quantity(&MeasuredQuantity::Sequences(found.measure)),
        candidate: Some(found.candidate),
        active: Some(found.active),
        interval: Some([found.lower, found.upper]),
        limit: Some(found.tolerance),
        n: u64::from(found.pairs),
    });
    components.chain(harm).chain(sequences).collect()
}

/// The means of candidate and active version that a component compares, so that its interval belongs to their difference.
fn compared_means(name: ComponentName, behavior: &BehaviorAssessment, pairs: &[Pair]) -> Option<[f64; 2]> {
    let of_pairs = |values: &dyn Fn(&Pair) -> Option<[f64; 2]>| {
        let all: Vec<[f64; 2]> = pairs.iter().filter_map(values).collect();
        let mean = |side: fn(&[f64; 2]) -> f64| all.iter().map(side).sum::<f64>() / (all.len() as f64);
        (!all.is_empty()).then(|| [mean(|[candidate, _]| *candidate), mean(|[_, active]| *active)])
    };
    let of_all = |mean: fn(&Signature) -> f64| {
        let (candidate, active) = behavior.candidate.as_ref().zip(behavior.active.as_ref())?;
        Some([mean(candidate), mean(active)])
    };
    match name {
        ComponentName::Success => of_all(|means| means.success),
        ComponentName::Retry => of_all(|means| means.retry),
        ComponentName::Violation => of_all(|means| means.violation),
        ComponentName::Anomaly => of_all(|means| means.anomaly),
        ComponentName::Time => {
            of_pairs(&|pair| name.is_compared_in(pair).then_some([pair.candidate.time_s, pair.active.time_s]))
        }
        ComponentName::Recovery => of_pairs(&|pair| {
            name.is_bad_in(pair).map(|(new, old)| [new, old].map(|bad| if bad { 1.0 } else { 0.0 }))
        }),
    }
}

/// The sandbox, mode by mode, with the active version's values if it worked the same mode.
#[must_use]
pub fn modes(evidence_file: &EvidenceFile) -> Vec<ModeView> {
    let own = evidence_file.modes.iter().filter(|metrics| metrics.mode.party == ComparedVersion::Candidate);
    own.map(|metrics| {
        let mode = metrics.mode.mode;
        let worked = VersionMode { mode, party: ComparedVersion::Active };
        let active = evidence_file.modes.iter().find(|other| other.mode == worked);
        ModeView { mode, measures: measures(metrics, active) }
    })
    .collect()
}

fn measures(mode: &ModeMetrics, active: Option<&ModeMetrics>) -> Vec<MeasuredValue> {
    let n = u64::from(mode.episodes);
    let found = |metrics: &[Metric], name: &str| {
        metrics.iter().find(|metric| metric.name == name).map(|metric| metric.value)
    };
    let metrics = mode.metrics.iter().map(|metric| MeasuredValue {
        name: measured_quantity(&MeasuredQuantity::Metric(metric.name.clone())),
        candidate: Some(metric.value),
        active: active.and_then(|active| found(&active.metrics, &metric.name)),
        interval: metric.interval.map(|interval| [interval.lower, interval.upper]),
        limit: None,
        n,
    });
    let tails = mode.tails.iter().map(|tail| MeasuredValue {
        name: measured_quantity(&MeasuredQuantity::Percentile95(tail.name.clone())),
        candidate: Some(tail.p95),
        active: active
            .and_then(|active| active.tails.iter().find(|other| other.name == tail.name))
            .map(|other| other.p95),
        interval: None,
        limit: None,
        n,
    });
    metrics.chain(tails).collect()
}

/// Drills, kind by kind.
#[must_use]
pub fn drills(evidence_file: &EvidenceFile) -> Vec<DrillView> {
    let Some((candidate, active)) = &evidence_file.drills else { return Vec::new() };
    let counts = |tally: &DrillTally| [u64::from(tally.passed), u64::from(tally.feasible())];
    DrillKind::ALL
        .into_iter()
        .map(|kind| DrillView {
            kind,
            candidate: counts(candidate.of(kind)),
            active: counts(active.of(kind)),
            phases: WorkPhase::ALL
                .into_iter()
                .map(|phase| PhaseDrillView {
                    phase,
                    candidate: counts(candidate.phases.of(kind, phase)),
                    active: counts(active.phases.of(kind, phase)),
                })
                .filter(|drilled| drilled.candidate[1] > 0 || drilled.active[1] > 0)
                .collect(),
        })
        .collect()
}

/// Paired episodes so far.
#[must_use]
pub fn pairs(evidence_file: &EvidenceFile) -> Option<PairsView> {
    let n = evidence_file.pairs.len() as u64;
    let active = behavior::signature(evidence_file.pairs.iter().map(|pair| &pair.active))?;
    let candidate = behavior::signature(evidence_file.pairs.iter().map(|pair| &pair.candidate))?;
    let interval = |count: usize| wilson(count as u64, n, SHOWN_LEVEL).ok().map(|i| [i.lower, i.upper]);
    let succeeded = |of: fn(&holdpoint_governance::evidence::Pair) -> bool| {
        evidence_file.pairs.iter().filter(|pair| of(pair)).count()
    };
    Some(PairsView {
        n,
        active,
        candidate,
        candidate_success: interval(succeeded(|pair| pair.candidate.success))?,
        active_success: interval(succeeded(|pair| pair.active.success))?,
    })
}

#[must_use]
pub fn shadow(evidence_file: &EvidenceFile, limits: &EvaluationSettings) -> Option<ShadowView> {
    let sequences = &evidence_file.sequences;
    let n = sequences.len() as f64;
    if sequences.is_empty() {
        return None;
    }
    let mean = |of: &dyn Fn(&ShadowSequence) -> f64| sequences.iter().map(of).sum::<f64>() / n;
    // Charts are drawn; a seventh digit is not seen.
    #[allow(clippy::cast_possible_truncation, reason = "drawn only")]
    let series = sequences
        .iter()
        .map(|s| [s.output_divergence as f32, governance(s) as f32, s.envelope_divergence as f32])
        .collect();
    Some(ShadowView {
        n: sequences.len() as u64,
        output: mean(&|s| s.output_divergence),
        governance: mean(&governance),
        envelope: mean(&|s| s.envelope_divergence),
        // The governance signals are judged by their paired bound, which no single number stands for.
        limits: [Some(limits.output_divergence_max), None, Some(limits.envelope_divergence_max)],
        series,
        disagreements: disagreements(sequences),
    })
}

/// 1 if only the twin raised a signal, -1 if only the live world did.
fn governance(s: &ShadowSequence) -> f64 {
    let flag = |on: bool| if on { 1.0 } else { 0.0 };
    flag(s.twin_policy_hit || s.twin_watcher_event) - flag(s.live_policy_hit || s.live_watcher_event)
}

fn disagreements(sequences: &[ShadowSequence]) -> Vec<Disagreement> {
    let row = |(index, s): (usize, &ShadowSequence)| {
        #[allow(clippy::cast_possible_truncation, reason = "shown only")]
        let output = s.output_divergence as f32;
        let difference = difference(s);
        let text = shadow_difference(&difference);
        (!difference.is_empty()).then_some(Disagreement { index: index as u64, seed: s.seed, text, output })
    };
    sequences.iter().enumerate().rev().filter_map(row).take(DISAGREEMENTS_MAX).collect()
}

/// What each world of a sequence alone had.
fn difference(s: &ShadowSequence) -> ShadowDifference {
    let events = [
        (ShadowEvent::Success, s.twin_success, s.live_success),
        (ShadowEvent::PolicyHit, s.twin_policy_hit, s.live_policy_hit),
        (ShadowEvent::WatcherEvent, s.twin_watcher_event, s.live_watcher_event),
    ];
    let mut found = ShadowDifference::default();
    for (event, twin, live) in events {
        match (twin, live) {
            (true, false) => found.twin.push(event),
            (false, true) => found.live.push(event),
            (true, true) | (false, false) => {}
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    use holdpoint_governance::evidence::{Conduct, EpisodeValues};
    use holdpoint_governance::finding::EvidenceGap;

    fn sequence(twin: [bool; 3], live: [bool; 3]) -> ShadowSequence {
        ShadowSequence {
            seed: 7,
            live_success: live[0],
            twin_success: twin[0],
            live_policy_hit: live[1],
            twin_policy_hit: twin[1],
            live_watcher_event: live[2],
            twin_watcher_event: twin[2],
            output_divergence: 0.25,
            envelope_divergence: 0.5,
            live_conduct: Conduct::default(),
            twin_conduct: Conduct::default(),
            twin_difference: None,
        }
    }

    /// Regression: the row had 0.033 against 0.280, and an interval of the difference from 0.016 better to 0.010 worse.
    #[test]
    fn means_are_of_the_pairs_that_the_interval_is_of() {
        let ran = |success: bool, recovery: bool, time_s: f64| EpisodeValues {
            success,
            recovery,
            time_s,
            ..EpisodeValues::CLEAN
        };
        let pair = |seed, candidate, active| Pair { seed, active, candidate, live_like: false };
        let pairs = [
            pair(1, ran(true, false, 2.0), ran(false, true, 9.0)),
            pair(2, ran(true, true, 4.0), ran(true, false, 6.0)),
            pair(3, ran(true, false, 2.0), ran(true, false, 2.0)),
            pair(4, ran(false, true, 9.0), ran(false, true, 9.0)),
        ];
        let assessment = behavior::without_value(EvidenceGap::NoEpisodes);
        let means = |name, pairs: &[Pair]| compared_means(name, &assessment, pairs);
        assert_eq!(means(ComponentName::Recovery, &pairs), Some([0.5, 0.25]));
        assert_eq!(means(ComponentName::Time, &pairs), Some([3.0, 4.0]));
        assert_eq!(means(ComponentName::Time, &pairs[..1]), None);
        assert_eq!(means(ComponentName::Success, &pairs), None, "that one is in the assessment");
    }

    #[test]
    fn disagreements_come_newest_first() {
        let sequences = [
            sequence([true, false, false], [true, false, false]),
            sequence([false, true, true], [true, false, false]),
            sequence([true, false, false], [false, false, false]),
        ];
        let rows: Vec<u64> = disagreements(&sequences).iter().map(|row| row.index).collect();
        assert_eq!(rows, [2, 1]);
        assert!((governance(&sequences[1]) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_difference_has_the_events_of_each_world_alone() {
        use ShadowEvent::{PolicyHit, Success, WatcherEvent};
        for (twin, live, expected) in [
            ([true, false, false], [true, false, false], (vec![], vec![])),
            ([false, true, true], [true, false, false], (vec![PolicyHit, WatcherEvent], vec![Success])),
            ([true, false, false], [false, false, false], (vec![Success], vec![])),
        ] {
            let ShadowDifference { twin, live } = difference(&sequence(twin, live));
            assert_eq!((twin, live), expected);
        }
    }
}
