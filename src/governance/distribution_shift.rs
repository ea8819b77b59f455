//! Compares a candidate in the live world with the sandbox, relative to the version that it would replace.
//!
//! The live world differs from the sandbox by design, for both versions. So the comparison is of how much worse the
//! candidate is than the active version: pair by pair in the sandbox, sequence by sequence in shadow. If both samples
//! have one distribution, the sandbox's conclusion also holds in the live world. Each signal has one exact one-sided
//! Smirnov test, with Holm's correction over the signals and half of the error rate at each of shadow's two looks. So
//! at least 99 of 100 shadows report nothing if the worsening is the same in both. A measure of harm counts from half
//! of its margin on, because trivial differences can be significant. A shift alone rejects nothing. It lengthens
//! shadow; if it persists, the version is inconclusive, which raises an alarm. The version is then re-evaluated beside
//! the active version, on new seeds, under the live world's own conditions. If it is significantly worse there, it is
//! rejected; if it is not cleared, it is held back. A real cell holds back even a cleared version, because the result
//! does not explain what shadow saw; in simulation it continues.
//!
//! Once active, a version has none beside it and is compared with its own twins in shadow, which ran under the live
//! world's conditions too. The test is the same, only when [`is_live_look_due`]. Its finding makes the version
//! inconclusive as well: re-evaluated beside its rollback target, it is cleared or rolled back.

use serde::{Deserialize, Serialize};

use super::behavior::BehaviorAssessment;
use super::decision::{Dimension, Reason, ReasonCode};
use super::evidence::{EpisodeValues, Pair, ShadowEvidence, ShadowSequence};
use super::finding::Finding;
use super::gate::ShadowAssessment;
use super::harm::HarmKind;
use super::outcome::{BehaviorOutcome, CheckResult};
use super::profile::Profile;
use super::stats::holm;
use super::stats::smirnov::smirnov_above;

/// Looks of shadow at most: at its plain length, and at the longest.
const SHADOW_LOOKS: u32 = 2;

/// The provisional windows of live tasks after which there is a look.
const LIVE_LOOKS: [u32; 3] = [1, 3, 9];

/// The part of a margin below which a difference of a measured quantity is trivial.
pub(crate) const TRIFLE: f64 = 0.5;

/// A compared signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ShiftSignal {
    /// Failures of the task.
    Failure,
    /// Anomalies.
    Anomaly,
    /// Commands that the guard clamps or denies.
    Warning,
    /// New attempts.
    Retry,
    /// A measure of harm.
    Harm(HarmKind),
}

impl ShiftSignal {
    fn all() -> impl Iterator<Item = Self> {
        let flags = [Self::Failure, Self::Anomaly, Self::Warning, Self::Retry];
        flags.into_iter().chain(HarmKind::ALL.into_iter().map(Self::Harm))
    }

    /// A value where more is worse; `None` if it was not measured.
    fn of(self, values: &EpisodeValues) -> Option<f64> {
        let flag = |is: bool| Some(f64::from(u8::from(is)));
        match self {
            Self::Failure => flag(!values.success),
            Self::Anomaly => flag(values.anomaly),
            Self::Warning => flag(values.policy_warning),
            Self::Retry => flag(values.retries > 0),
            Self::Harm(kind) => values.harm.map(|harm| kind.worsening(harm.of(kind), 0.0)),
        }
    }

    fn in_sandbox(self, pair: &Pair) -> Option<f64> {
        Some(self.of(&pair.candidate)? - self.of(&pair.active)?)
    }

    fn in_shadow(self, sequence: &ShadowSequence) -> Option<f64> {
        let (twin, live) = (&sequence.twin_conduct, &sequence.live_conduct);
        let flags = |new: bool, old: bool| Some(f64::from(u8::from(new)) - f64::from(u8::from(old)));
        match self {
            Self::Failure => flags(!sequence.twin_success, !sequence.live_success),
            Self::Anomaly => flags(sequence.twin_watcher_event, sequence.live_watcher_event),
            Self::Warning => flags(twin.warned, live.warned),
            Self::Retry => flags(twin.retried, live.retried),
            Self::Harm(kind) => Some(kind.worsening(twin.harm?.of(kind), live.harm?.of(kind))),
        }
    }

    fn negligible_difference(self, profile: &Profile) -> f64 {
        match self {
            Self::Failure | Self::Anomaly | Self::Warning | Self::Retry => 0.0,
            Self::Harm(kind) => TRIFLE * profile.harm.of(kind).mean,
        }
    }
}

/// A signal with its values before and now, where more is worse.
struct SignalComparison {
    signal: ShiftSignal,
    before: Vec<f64>,
    now: Vec<f64>,
}

/// A reason for each signal that is significantly worse now by more than a trivial difference.
fn significantly_worse(
    compared: impl Iterator<Item = SignalComparison>,
    level: f64,
    profile: &Profile,
    reason: impl Fn(&SignalComparison) -> Reason,
) -> Vec<Reason> {
    let mut tested = Vec::new();
    for one in compared {
        let trifle = one.signal.negligible_difference(profile);
        let beyond: Vec<f64> = one.now.iter().map(|worse| worse - trifle).collect();
        let Ok(found) = smirnov_above(&one.before, &beyond) else { continue };
        tested.push((one, found.p_value));
    }
    let p_values: Vec<f64> = tested.iter().map(|(_, p_value)| *p_value).collect();
    let adjusted = holm(&p_values).unwrap_or_default();
    let significant = tested.iter().zip(adjusted).filter(|(_, p_value)| *p_value <= level);
    significant.map(|((one, _), p_value)| reason(one).with(p_value, level)).collect()
}

/// One reason with both means for each signal that is significantly worse in shadow than in the sandbox.
#[must_use]
pub fn significant_shifts(sandbox: &[Pair], shadow: &[ShadowSequence], profile: &Profile) -> Vec<Reason> {
    let compared = ShiftSignal::all().filter_map(|signal| {
        // A signal that either side did not measure is not compared.
        Some(SignalComparison {
            signal,
            before: sandbox.iter().map(|pair| signal.in_sandbox(pair)).collect::<Option<_>>()?,
            now: shadow.iter().map(|sequence| signal.in_shadow(sequence)).collect::<Option<_>>()?,
        })
    });
    let level = profile.evaluation.shift_alpha / f64::from(SHADOW_LOOKS);
    significantly_worse(compared, level, profile, |one| {
        let finding = Finding::ShiftedInShadow {
            signal: one.signal,
            live: mean(&one.now),
            sequences: shadow.len() as u64,
            sandbox: mean(&one.before),
            pairs: sandbox.len() as u64,
        };
        Reason::new(Dimension::Shadow, finding)
    })
}

/// Whether a look is due after this many live tasks of an active version.
#[must_use]
pub fn is_live_look_due(tasks: u32, profile: &Profile) -> bool {
    LIVE_LOOKS.iter().any(|windows| windows.saturating_mul(profile.activation.provisional_episodes) == tasks)
}

/// Live tasks stored for the last look.
#[must_use]
pub fn live_tasks_max(profile: &Profile) -> u32 {
    LIVE_LOOKS
        .map(|windows| windows.saturating_mul(profile.activation.provisional_episodes))
        .into_iter()
        .fold(0, u32::max)
}

/// One reason with both means for each signal that is significantly worse in live tasks than in the version's twins.
#[must_use]
pub fn live_shifts(twins: &[EpisodeValues], live: &[EpisodeValues], profile: &Profile) -> Vec<Reason> {
    let compared = ShiftSignal::all().filter_map(|signal| {
        let of =
            |values: &[EpisodeValues]| values.iter().map(|values| signal.of(values)).collect::<Option<_>>();
        Some(SignalComparison { signal, before: of(twins)?, now: of(live)? })
    });
    let level = profile.evaluation.shift_alpha / LIVE_LOOKS.len() as f64;
    significantly_worse(compared, level, profile, |one| {
        let finding = Finding::ShiftedLive {
            signal: one.signal,
            live: mean(&one.now),
            tasks: live.len() as u64,
            twin: mean(&one.before),
            twins: twins.len() as u64,
        };
        Reason::new(Dimension::Monitor, finding)
    })
}

/// Whether shadow found a version inconclusive: it differs there from the sandbox.
#[must_use]
pub fn is_suspicious(result: &ShadowAssessment) -> bool {
    result.reasons.iter().any(|reason| reason.code == ReasonCode::ShadowShifted)
}

/// Whether the re-evaluation of an inconclusive version clears it: it is non-inferior under the live conditions.
#[must_use]
pub fn is_cleared(again: &BehaviorAssessment) -> bool {
    match again.assessment.outcome {
        BehaviorOutcome::Compatible => true,
        BehaviorOutcome::Suspicious
        | BehaviorOutcome::Incompatible
        | BehaviorOutcome::Inconclusive
        | BehaviorOutcome::NoData => false,
    }
}

/// The result of a re-evaluation over `pairs` pairs, followed by the findings against the version.
#[must_use]
pub fn re_evaluation_reasons(again: &BehaviorAssessment, pairs: usize, dimension: Dimension) -> Vec<Reason> {
    let (outcome, pairs) = (again.assessment.outcome, pairs as u64);
    let finding = match dimension {
        Dimension::Monitor => Finding::ReEvaluatedLive { outcome, pairs },
        _ => Finding::ReEvaluatedInShadow { outcome, pairs },
    };
    let is_finding = |reason: &&Reason| !is_cleared(again) && reason.code.is_finding();
    let found = again.assessment.reasons.iter().filter(is_finding).cloned();
    std::iter::once(Reason::new(dimension, finding)).chain(found).collect()
}

/// Adds the re-evaluation of an inconclusive version to the shadow result.
pub fn apply_re_evaluation(result: &mut ShadowAssessment, again: &BehaviorAssessment, pairs: usize) {
    match again.assessment.outcome {
        // A real cell still holds the version back.
        BehaviorOutcome::Compatible => {}
        BehaviorOutcome::Incompatible => result.check = CheckResult::Fail,
        BehaviorOutcome::Suspicious | BehaviorOutcome::Inconclusive | BehaviorOutcome::NoData => {
            result.check = CheckResult::Inconclusive;
        }
    }
    if result.check != CheckResult::Pass {
        result.reasons.retain(|reason| reason.code != ReasonCode::ShadowClean);
    }
    let reasons = re_evaluation_reasons(again, pairs, Dimension::Shadow);
    result.reasons.splice(0..0, reasons);
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Adds the comparison with the sandbox to the shadow result. A version with a shift that would pass is evaluated
/// longer. After the longest shadow it is held back or, in simulation, passes with the reason.
pub fn compare_with_sandbox(
    result: &mut ShadowAssessment,
    shadow: &ShadowEvidence,
    sandbox: &[Pair],
    profile: &Profile,
) {
    let looked_at = matches!(result.check, CheckResult::Pass | CheckResult::Inconclusive);
    // Live-like pairs are no sample of the sandbox's distribution.
    let sandbox: Vec<Pair> = sandbox.iter().filter(|pair| !pair.live_like).copied().collect();
    let is_empty = sandbox.is_empty() || shadow.sequences.is_empty();
    if !looked_at || is_empty || result.sequences < profile.evaluation.shadow_sequences {
        return;
    }
    let found = significant_shifts(&sandbox, &shadow.sequences, profile);
    if found.is_empty() {
        return;
    }
    if result.sequences < profile.evaluation.shadow_sequences_max || profile.name.is_at_risk() {
        result.check = CheckResult::Inconclusive;
        result.reasons.retain(|reason| reason.code != ReasonCode::ShadowClean);
    }
    result.reasons.splice(0..0, found);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::{Conduct, EvidenceBinding};
    use crate::harm::HarmMeasures;
    use crate::ids::Digest;
    use crate::profile::ProfileName;

    fn values(slip_m: f64) -> EpisodeValues {
        let harm = Some(HarmMeasures { slip_m, ..HarmMeasures::STILL });
        EpisodeValues { time_s: 4.0, harm, ..EpisodeValues::CLEAN }
    }

    /// Slips less than 1 mm more in the sandbox, with some spread.
    fn sandbox() -> Vec<Pair> {
        let pair = |seed: u32| Pair {
            seed: seed.into(),
            active: values(0.001),
            candidate: values(0.001 + 1e-5 * f64::from(seed % 50)),
            live_like: false,
        };
        (0..300).map(pair).collect()
    }

    fn shadow(count: u32, more_m: f64) -> ShadowEvidence {
        let conduct = |slip_m: f64| Conduct { harm: values(slip_m).harm, ..Conduct::default() };
        let sequence = |seed: u32| ShadowSequence {
            seed: seed.into(),
            live_success: true,
            twin_success: true,
            live_policy_hit: false,
            twin_policy_hit: false,
            live_watcher_event: false,
            twin_watcher_event: false,
            output_divergence: 0.0,
            envelope_divergence: 0.0,
            live_conduct: conduct(0.001),
            twin_conduct: conduct(0.001 + more_m + 1e-5 * f64::from(seed % 50)),
            twin_difference: None,
        };
        let digest = Digest::of_parts("test", &[]);
        let binding = EvidenceBinding {
            candidate: digest,
            active: None,
            profile: digest,
            policy: digest,
            environment: digest,
            neighbours: None,
            anchor: None,
        };
        ShadowEvidence {
            binding,
            sequences: (0..count).map(sequence).collect(),
            hard_stops: Vec::new(),
            outputs: Vec::new(),
            missing: Vec::new(),
        }
    }

    fn judged(name: ProfileName, count: u32, more_m: f64) -> ShadowAssessment {
        let profile = Profile::builtin(name).unwrap();
        let evidence = shadow(count, more_m);
        let mut result = crate::gate::assess_shadow(&evidence, &evidence.binding, &profile);
        assert_eq!(
            result.check,
            CheckResult::Pass,
            "without the sandbox nothing speaks against it: {result:?}"
        );
        compare_with_sandbox(&mut result, &evidence, &sandbox(), &profile);
        result
    }

    #[test]
    fn equal_or_negligibly_different_worlds_show_no_shift() {
        for more_m in [0.0, 2.0e-4, -0.001] {
            let found = judged(ProfileName::Sim, 20, more_m);
            assert_eq!(found.check, CheckResult::Pass, "{more_m}: {found:?}");
            assert!(found.reasons.iter().all(|reason| reason.code != ReasonCode::ShadowShifted));
        }
    }

    #[test]
    fn a_shift_prolongs_shadow_and_is_then_reported() {
        let shift = 0.000_75;
        let is_shifted = |found: &ShadowAssessment| found.reasons[0].code == ReasonCode::ShadowShifted;
        let plain = judged(ProfileName::Sim, 20, shift);
        assert!(plain.check == CheckResult::Inconclusive && is_shifted(&plain), "{plain:?}");
        let found = plain.reasons[0].finding.as_ref().unwrap();
        let signal = ShiftSignal::Harm(HarmKind::Slip);
        let in_slip = matches!(found, Finding::ShiftedInShadow { signal: of, live, .. } if *of == signal && *live > 0.0);
        assert!(in_slip, "{found:?}");
        let longest = judged(ProfileName::Sim, 60, shift);
        assert!(
            longest.check == CheckResult::Pass && is_shifted(&longest),
            "it passes with the reason: {longest:?}"
        );
        let held = judged(ProfileName::Real, 90, shift);
        assert!(held.check == CheckResult::Inconclusive && is_shifted(&held), "{held:?}");
    }

    #[test]
    fn live_like_pairs_are_no_sample_of_the_sandbox() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let evidence = shadow(60, 0.000_75);
        let compared = |sandbox: &[Pair]| {
            let mut result = crate::gate::assess_shadow(&evidence, &evidence.binding, &profile);
            compare_with_sandbox(&mut result, &evidence, sandbox, &profile);
            result.reasons.iter().find_map(|reason| match reason.finding {
                Some(Finding::ShiftedInShadow { sandbox, pairs, .. }) => Some((sandbox, pairs)),
                _ => None,
            })
        };
        let mut mixed = sandbox();
        for pair in mixed.iter_mut().step_by(3) {
            *pair = Pair { candidate: values(0.4), live_like: true, ..*pair };
        }
        let others: Vec<Pair> = mixed.iter().filter(|pair| !pair.live_like).copied().collect();
        let (mean, pairs) = compared(&mixed).unwrap();
        assert_eq!((Some((mean, pairs)), pairs), (compared(&others), 200));
        for pair in &mut mixed {
            pair.live_like = true;
        }
        assert_eq!(compared(&mixed), None, "there is nothing to compare with");
    }

    /// A re-evaluation in which the candidate fails in `failing` of 300 pairs.
    fn again(failing: u32) -> BehaviorAssessment {
        changed_again(|index, values| values.success &= index >= failing as usize)
    }

    /// A re-evaluation in which the candidate's values differ by this.
    fn changed_again(change: impl Fn(usize, &mut EpisodeValues)) -> BehaviorAssessment {
        let mut pairs = sandbox();
        for (index, pair) in pairs.iter_mut().enumerate() {
            change(index, &mut pair.candidate);
        }
        let evidence = shadow(0, 0.0);
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let paired =
            crate::evidence::PairedEvidence { binding: evidence.binding, pairs, hard_stops: Vec::new() };
        crate::behavior::assess(&paired, &evidence.binding, &profile)
    }

    #[test]
    fn re_evaluation_decides_and_resumes_no_version_on_hold() {
        for (name, count, failing, check) in [
            (ProfileName::Sim, 60, 0, CheckResult::Pass),
            (ProfileName::Sim, 60, 200, CheckResult::Fail),
            (ProfileName::Real, 90, 0, CheckResult::Inconclusive),
            (ProfileName::Real, 90, 200, CheckResult::Fail),
        ] {
            let mut found = judged(name, count, 0.000_75);
            assert!(is_suspicious(&found));
            let again = again(failing);
            apply_re_evaluation(&mut found, &again, 300);
            assert_eq!(found.check, check, "{name} {failing}: {found:?}");
            assert_eq!(found.reasons[0].code, ReasonCode::ShadowWorkedAgain);
            assert_eq!(is_cleared(&again), failing == 0);
            // Shadow's own reason remains.
            assert!(is_suspicious(&found));
        }
        // Inconclusive: on hold, also in simulation.
        let mut found = judged(ProfileName::Sim, 60, 0.000_75);
        let slower =
            |percent: u32| changed_again(|_, values| values.time_s *= 1.0 + f64::from(percent) / 100.0);
        let doubtful =
            (1..200).map(slower).find(|again| again.assessment.outcome == BehaviorOutcome::Suspicious);
        apply_re_evaluation(&mut found, &doubtful.expect("some time is neither longer nor as long"), 300);
        assert_eq!(found.check, CheckResult::Inconclusive);
        assert!(found.reasons.iter().all(|reason| reason.code != ReasonCode::ShadowClean));
    }

    /// Slips about as the twins do, `more_m` more; some fail.
    fn lived(count: u32, more_m: f64, failing: u32) -> Vec<EpisodeValues> {
        let one = |at: u32| {
            let slips = values(0.001 + more_m + 1e-5 * f64::from(at % 50));
            EpisodeValues { success: at >= failing, ..slips }
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn an_active_version_is_compared_to_its_twins() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let found = |live: &[EpisodeValues]| live_shifts(&lived(20, 0.0, 0), live, &profile);
        assert_eq!(found(&lived(20, 0.0, 0)), []);
        assert_eq!(found(&lived(60, 2.0e-4, 0)), [], "a trifle");
        let slipping = found(&lived(20, 0.003, 0));
        assert_eq!(slipping.len(), 1, "{slipping:?}");
        assert_eq!(slipping[0].code, ReasonCode::MonitorShifted);
        let signal = |found: &Reason| match found.finding {
            Some(Finding::ShiftedLive { signal, live, tasks, twin, .. }) => Some((signal, live, tasks, twin)),
            _ => None,
        };
        assert_eq!(signal(&slipping[0]).unwrap().0, ShiftSignal::Harm(HarmKind::Slip));
        let failing = found(&lived(20, 0.0, 16));
        assert_eq!(signal(&failing[0]), Some((ShiftSignal::Failure, 0.8, 20, 0.0)));
        assert_eq!(found(&lived(20, 0.0, 6)), [], "three in ten of twenty can be chance beside 24 others");
        // A build without measures of harm compares the rest.
        let unmeasured = lived(20, 0.0, 16).into_iter().map(|one| EpisodeValues { harm: None, ..one });
        assert_eq!(found(&unmeasured.collect::<Vec<_>>()).len(), 1);
    }

    #[test]
    fn live_shift_is_checked_at_the_end_of_the_window_and_twice_later() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let looks: Vec<u32> =
            (0..=live_tasks_max(&profile)).filter(|tasks| is_live_look_due(*tasks, &profile)).collect();
        assert_eq!(looks, [20, 60, 180]);
    }

    /// A worsening drawn from one distribution in both worlds is called shifted at most as often as stated: of 200
    /// shadows with both looks two are expected at most, and more than seven are three standard deviations more.
    #[test]
    fn equal_distributions_are_called_shifted_no_more_often_than_stated() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let mut state = 7_u64;
        let mut unit = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut wrong = 0;
        for _ in 0..200 {
            let mut spread = |of: &mut f64| *of = 0.001 + 0.004 * unit();
            let mut pairs = sandbox();
            for harm in pairs.iter_mut().filter_map(|pair| pair.candidate.harm.as_mut()) {
                spread(&mut harm.slip_m);
            }
            let mut evidence = shadow(60, 0.0);
            for harm in evidence.sequences.iter_mut().filter_map(|one| one.twin_conduct.harm.as_mut()) {
                spread(&mut harm.slip_m);
            }
            let looks = [&evidence.sequences[..20], &evidence.sequences];
            wrong +=
                u32::from(looks.iter().any(|look| !significant_shifts(&pairs, look, &profile).is_empty()));
        }
        assert!(wrong <= 7, "{wrong} of 200, 2 expected at most");
    }
}
