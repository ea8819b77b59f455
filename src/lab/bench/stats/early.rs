//! Early rejection of a behavior evaluation, checked after every 20 pairs as the sandbox does.

use super::figure::{StatedBound, StudyFigure, StudyMeasure, rate, unjudged};
use super::sampling::{SampleStream, binding};
use super::{Study, missing};
use holdpoint::bench::{BenchError, CLEAN};
use holdpoint_governance::behavior;
use holdpoint_governance::evidence::{EpisodeValues, Pair, PairedEvidence};
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::profile::Profile;

/// Pairs between two looks.
const LOOK_PAIRS: usize = 20;

const RULE: &str = "finite population, pairs";

/// The event that an episode gets.
type EpisodeSpoiler = fn(&mut EpisodeValues);

const COMPONENTS: [(&str, EpisodeSpoiler); 4] = [
    ("failures", |episode| episode.success = false),
    ("violations", |episode| episode.violation = true),
    ("anomalies", |episode| episode.anomaly = true),
    ("recoveries", |episode| episode.recovery = true),
];

/// Active-only pairs that a boundary population holds beside its net worsening.
const OPPOSED: [usize; 2] = [0, 15];

/// Worse candidates: the component with its place in [`COMPONENTS`], and the added rate of its events.
const WORSE_CANDIDATES: [(&str, usize, f64); 5] = [
    ("failures", 0, 0.15),
    ("failures", 0, 0.3),
    ("violations", 1, 0.2),
    ("anomalies", 2, 0.13),
    ("anomalies", 2, 0.3),
];

pub(super) fn study(study: &Study) -> Result<Vec<StudyFigure>, BenchError> {
    // The profiles differ in their budgets alone here; the smallest is the first.
    let profile = study.profiles.first().ok_or_else(|| missing("profiles"))?;
    let mut findings = Vec::new();
    for (name, spoil) in COMPONENTS {
        for opposed in OPPOSED {
            findings.push(boundary(study, profile, name, spoil, opposed)?);
        }
    }
    for (name, component, worse) in WORSE_CANDIDATES {
        findings.extend(worse_candidate(study, profile, name, COMPONENTS[component].1, worse)?);
    }
    Ok(findings)
}

fn evidence(pairs: Vec<Pair>) -> PairedEvidence {
    PairedEvidence { binding: binding(), pairs, hard_stops: Vec::new() }
}

fn is_incompatible(pairs: &[Pair], profile: &Profile) -> bool {
    let found = behavior::assess(&evidence(pairs.to_vec()), &binding(), profile);
    found.assessment.outcome == BehaviorOutcome::Incompatible
}

/// The pairs of a whole budget: some with events of the candidate alone, some of the active version alone.
fn population(size: usize, worse: usize, better: usize, spoil: EpisodeSpoiler) -> Vec<Pair> {
    let mut pairs: Vec<Pair> = (0..size as u64)
        .map(|seed| Pair { seed, active: CLEAN, candidate: CLEAN, live_like: false })
        .collect();
    pairs.iter_mut().take(worse).for_each(|pair| spoil(&mut pair.candidate));
    pairs.iter_mut().skip(worse).take(better).for_each(|pair| spoil(&mut pair.active));
    pairs
}

/// The worst population that the full budget does not reject, in random order: how often is it rejected early?
fn boundary(
    study: &Study,
    profile: &Profile,
    name: &'static str,
    spoil: EpisodeSpoiler,
    opposed: usize,
) -> Result<StudyFigure, BenchError> {
    let size = profile.evaluation.sandbox_pairs as usize;
    let rejected = |worse: &usize| is_incompatible(&population(size, *worse, opposed, spoil), profile);
    let least =
        (opposed..size - opposed).find(rejected).ok_or_else(|| missing("a population that is rejected"))?;
    let mut pairs = population(size, least - 1, opposed, spoil);
    let mut draw = SampleStream::new(&format!("boundary {name} {opposed}"));
    let mut wrong = 0;
    for _ in 0..study.runs {
        draw.shuffle(&mut pairs);
        let seen = first_look(&pairs, |part| behavior::is_lost_early(part, &binding(), profile));
        wrong += u64::from(seen.is_some());
    }
    let under = format!("boundary of {size}: {name} {} against {opposed}", least - 1);
    let stated = Some(StatedBound::AtMost(profile.evaluation.early_alpha));
    Ok(rate(RULE, StudyMeasure::RejectsEarly, under, (wrong, u64::from(study.runs)), stated)?)
}

/// Pairs seen at the first look that ends it.
fn first_look(pairs: &[Pair], ends: impl Fn(&PairedEvidence) -> bool) -> Option<usize> {
    let mut part = evidence(Vec::with_capacity(pairs.len()));
    for slice in pairs.chunks(LOOK_PAIRS) {
        part.pairs.extend_from_slice(slice);
        if part.pairs.len() < pairs.len() && ends(&part) {
            return Some(part.pairs.len());
        }
    }
    None
}

/// Candidates sampled from the recorded pairs and made worse: the pairs that each rule saves, and its errors.
fn worse_candidate(
    study: &Study,
    profile: &Profile,
    name: &'static str,
    spoil: EpisodeSpoiler,
    worse: f64,
) -> Result<Vec<StudyFigure>, BenchError> {
    let size = profile.evaluation.sandbox_pairs;
    let all = u64::from(study.runs);
    let mut draw = SampleStream::new(&format!("bad {name} {worse}"));
    let (mut exact, mut early, mut wrong, mut differing) = (0, 0, 0, 0);
    for run in 0..study.runs as usize {
        let table = study.recorded.sandbox.get(run % study.recorded.sandbox.len().max(1));
        let mut pairs = draw.equal_pairs(table.ok_or_else(|| missing("tables"))?, size);
        for pair in &mut pairs {
            if draw.chance(worse) {
                spoil(&mut pair.candidate);
            }
        }
        let curtailed = first_look(&pairs, |part| behavior::is_lost(part, &binding(), profile));
        let ended = first_look(&pairs, |part| behavior::end_reason(part, &binding(), profile).is_some());
        exact += curtailed.unwrap_or(size as usize) as u64;
        early += ended.unwrap_or(size as usize) as u64;
        if ended.is_some() && !is_incompatible(&pairs, profile) {
            wrong += 1;
            differing += u64::from(curtailed.is_some());
        }
    }
    let under = format!("recorded pairs, {name} in +{worse} of {size}");
    let used = |used: u64| used as f64 / all as f64;
    Ok(vec![
        rate(
            "exact curtailment",
            StudyMeasure::DiffersFromFullBudget,
            under.clone(),
            (differing, all),
            Some(StatedBound::AtMost(0.0)),
        )?,
        unjudged("exact curtailment", StudyMeasure::PairsUsed, under.clone(), all, used(exact), "pairs"),
        rate(
            RULE,
            StudyMeasure::RejectsEarly,
            under.clone(),
            (wrong, all),
            Some(StatedBound::AtMost(profile.evaluation.early_alpha)),
        )?,
        unjudged(RULE, StudyMeasure::PairsUsed, under, all, used(early), "pairs"),
    ])
}
