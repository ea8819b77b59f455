//! The shadow comparison: how often does a version that is exactly as good fail it?

use super::Study;
use super::figure::{StatedBound, StudyFigure, StudyMeasure, rate};
use super::sampling::{SampleStream, binding};
use holdpoint::bench::BenchError;
use holdpoint_governance::evidence::{Conduct, Pair, ShadowEvidence, ShadowSequence};
use holdpoint_governance::gate::{ShadowAssessment, assess_shadow};
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::profile::Profile;

const RULE: &str = "shadow";

/// True rates of each signal, in both worlds and independently: more discordance than twins have.
const RATES: [f64; 3] = [0.02, 0.1, 0.3];

/// How much more frequent the watcher's events are in the twins of a worse version.
const WORSE: [f64; 2] = [0.2, 0.4];

/// A figure of equally good versions, and the name of its stream of samples.
const EQUAL: (StudyMeasure, &str) = (StudyMeasure::EqualFailsShadow, "equally good: fails");

pub(super) fn study(study: &Study) -> Result<Vec<StudyFigure>, BenchError> {
    let mut findings = Vec::new();
    for profile in &study.profiles {
        let alpha = profile.evaluation.shadow_alpha;
        let name = profile.name.name();
        let mut push =
            |what,
             stream: &str,
             under: String,
             diverging: bool,
             stated,
             sequence: &dyn Fn(&mut SampleStream) -> Option<ShadowSequence>| {
                let mut draw = SampleStream::new(&format!("shadow {stream} {under}"));
                let runs = 0..study.runs;
                let failed = runs
                    .filter(|_| deployed(&mut draw, profile, diverging, sequence).check == CheckResult::Fail)
                    .count();
                findings.push(rate(RULE, what, under, (failed as u64, u64::from(study.runs)), stated)?);
                Ok::<(), BenchError>(())
            };
        let stated = Some(StatedBound::AtMost(alpha));
        for table in &study.recorded.live {
            push(EQUAL.0, EQUAL.1, format!("{name}, {}", table.name), true, stated, &|draw| {
                let pair = draw.of(&table.pairs)?;
                Some(if draw.chance(0.5) { sequence(&pair) } else { mirrored(&sequence(&pair)) })
            })?;
        }
        for rate in RATES {
            // Divergence of the outputs makes shadow longer, and so gives it a second look.
            push(EQUAL.0, EQUAL.1, format!("{name}, signals at {rate}, two looks"), true, stated, &|draw| {
                Some(of([(); 6].map(|()| draw.chance(rate))))
            })?;
        }
        for worse in WORSE {
            let under = format!("{name}, watcher events .05 and +{worse}");
            push(StudyMeasure::WorseFailsShadow, "worse: fails", under, false, None, &|draw| {
                let live = draw.chance(0.05);
                Some(of([false, false, false, false, live, live || draw.chance(worse)]))
            })?;
        }
    }
    Ok(findings)
}

/// A shadow deployment as the pipeline does it: judged at the plain length and, if that is not enough, at the
/// longest.
fn deployed(
    draw: &mut SampleStream,
    profile: &Profile,
    diverging: bool,
    sequence: &dyn Fn(&mut SampleStream) -> Option<ShadowSequence>,
) -> ShadowAssessment {
    let divergence = if diverging { 1.0 } else { 0.0 };
    let settings = &profile.evaluation;
    let mut evidence = ShadowEvidence {
        binding: binding(),
        sequences: Vec::new(),
        hard_stops: Vec::new(),
        outputs: Vec::new(),
        missing: Vec::new(),
    };
    let mut lengthen = |count: u32| {
        while evidence.sequences.len() < count as usize {
            let Some(next) = sequence(draw) else { break };
            let seed = evidence.sequences.len() as u64;
            evidence.sequences.push(ShadowSequence { seed, output_divergence: divergence, ..next });
        }
        assess_shadow(&evidence, &binding(), profile)
    };
    let first = lengthen(settings.shadow_sequences);
    if first.check == CheckResult::Inconclusive { lengthen(settings.shadow_sequences_max) } else { first }
}

/// Signals in pairs, live before twin: the task failed, policy hit, watcher event.
fn of(signals: [bool; 6]) -> ShadowSequence {
    let [live_failed, twin_failed, live_policy_hit, twin_policy_hit, live_watcher_event, twin_watcher_event] =
        signals;
    ShadowSequence {
        seed: 0,
        live_success: !live_failed,
        twin_success: !twin_failed,
        live_policy_hit,
        twin_policy_hit,
        live_watcher_event,
        twin_watcher_event,
        output_divergence: 0.0,
        envelope_divergence: 0.0,
        live_conduct: Conduct::default(),
        twin_conduct: Conduct::default(),
        twin_difference: None,
    }
}

/// The signals that a twin and its live episode give (as `pipeline::shadow` reads them).
fn sequence(pair: &Pair) -> ShadowSequence {
    let Pair { active, candidate, .. } = pair;
    of([
        !active.success,
        !candidate.success,
        active.violation,
        candidate.violation,
        active.anomaly,
        candidate.anomaly,
    ])
}

fn mirrored(of: &ShadowSequence) -> ShadowSequence {
    ShadowSequence {
        live_success: of.twin_success,
        twin_success: of.live_success,
        live_policy_hit: of.twin_policy_hit,
        twin_policy_hit: of.live_policy_hit,
        live_watcher_event: of.twin_watcher_event,
        twin_watcher_event: of.live_watcher_event,
        ..*of
    }
}
