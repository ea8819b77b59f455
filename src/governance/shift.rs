//! Whether a candidate is in the live world what it was in the sandbox, beside the version that it would replace.
//!
//! The live world differs from the sandbox by design, for both versions. So what is compared is how much worse the
//! candidate is than the active version: pair by pair in the sandbox, sequence by sequence in shadow. If these two samples
//! are of one distribution, what the sandbox concluded holds in the live world too. One exact test of Smirnov a signal,
//! one-sided, with Holm's correction over the signals and half of the error rate at each of shadow's two looks: in 99 of
//! 100 shadows at least nothing is said of a version whose worsening is the same in both. A measure of harm counts from
//! half of its tolerance on: trifles can be established, and harm nobody. A shift rejects nothing by itself. It makes shadow
//! longer; what is still there then makes the version suspicious, which is an alarm, and it is worked again: beside the active
//! version, on seeds nobody has seen, in the live world's own conditions. If that establishes it as worse it is rejected, and
//! if that does not clear it, it is held back. Where it is as good there, a real cell holds it back all the same, for what
//! shadow saw is not explained by that; in simulation it goes on.
//!
//! Once it is active there is no version beside it, and its twins in shadow are what it is held against: they worked under
//! the live world's conditions, too. It is the same test, at [`live_look`]s alone. What it finds makes the version suspicious
//! as well; worked again beside its predecessor it is cleared, or it is taken off.

use super::behavior::BehaviorAssessment;
use super::decision::{Dimension, Reason, ReasonCode};
use super::evidence::{EpisodeValues, Pair, ShadowEvidence, ShadowSequence};
use super::gate::ShadowAssessment;
use super::harm::HarmKind;
use super::outcome::{BehaviorOutcome, Check};
use super::profile::{Profile, ProfileName};
use super::stats::holm;
use super::stats::smirnov::smirnov_above;

/// Looks of shadow at most: at its plain length, and at the longest.
const LOOKS: f64 = 2.0;

/// After so many provisional windows of live tasks it is looked.
const LIVE_LOOKS: [u32; 3] = [1, 3, 9];

/// Of a tolerance, what is a trifle.
const TRIFLE: f64 = 0.5;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Signal {
    Failure,
    Anomaly,
    Warning,
    Retry,
    Harm(HarmKind),
}

impl Signal {
    fn all() -> impl Iterator<Item = Self> {
        let flags = [Self::Failure, Self::Anomaly, Self::Warning, Self::Retry];
        flags.into_iter().chain(HarmKind::ALL.into_iter().map(Self::Harm))
    }

    const fn words(self) -> &'static str {
        match self {
            Self::Failure => "failures of the task",
            Self::Anomaly => "anomalies",
            Self::Warning => "commands the guard clamps or refuses",
            Self::Retry => "new attempts",
            Self::Harm(kind) => kind.words(),
        }
    }

    /// A value of which more is worse; `None` if it was not measured.
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

    /// A difference, in the signal's unit.
    fn show(self, value: f64) -> String {
        match self {
            Self::Harm(kind) => kind.show(value),
            Self::Failure | Self::Anomaly | Self::Warning | Self::Retry => format!("{:.1} %", 100.0 * value),
        }
    }

    /// A version's own mean, which [`Self::of`] told as a worsening.
    fn show_own(self, worsening: f64) -> String {
        match self {
            Self::Harm(kind) => kind.show(kind.worsening(worsening, 0.0)),
            Self::Failure | Self::Anomaly | Self::Warning | Self::Retry => self.show(worsening),
        }
    }

    fn trifle(self, profile: &Profile) -> f64 {
        match self {
            Self::Failure | Self::Anomaly | Self::Warning | Self::Retry => 0.0,
            Self::Harm(kind) => TRIFLE * profile.harm.of(kind).mean,
        }
    }
}

/// A signal with what it was before and what it is now, each a value of which more is worse.
struct Compared {
    signal: Signal,
    before: Vec<f64>,
    now: Vec<f64>,
}

/// What is established as worse now by more than a trifle, with its p-value.
fn established(compared: Vec<Compared>, profile: &Profile, level: f64) -> Vec<(Compared, f64)> {
    let mut tested = Vec::new();
    for one in compared {
        let trifle = one.signal.trifle(profile);
        let beyond: Vec<f64> = one.now.iter().map(|worse| worse - trifle).collect();
        let Ok(found) = smirnov_above(&one.before, &beyond) else { continue };
        tested.push((one, found.p_value));
    }
    let p_values: Vec<f64> = tested.iter().map(|(_, p_value)| *p_value).collect();
    let adjusted = holm(&p_values).unwrap_or_default();
    let said = tested.into_iter().zip(adjusted).filter(|(_, p_value)| *p_value <= level);
    said.map(|((one, _), p_value)| (one, p_value)).collect()
}

/// For each signal that is established as worse in shadow than the sandbox showed, a reason with both means.
#[must_use]
pub fn shifted(sandbox: &[Pair], shadow: &[ShadowSequence], profile: &Profile) -> Vec<Reason> {
    let compared = Signal::all().filter_map(|signal| {
        // What was not measured on either side is not compared.
        Some(Compared {
            signal,
            before: sandbox.iter().map(|pair| signal.in_sandbox(pair)).collect::<Option<_>>()?,
            now: shadow.iter().map(|sequence| signal.in_shadow(sequence)).collect::<Option<_>>()?,
        })
    });
    let level = profile.evaluation.shift_alpha / LOOKS;
    let said = established(compared.collect(), profile, level).into_iter().map(|(one, p_value)| {
        let text = format!(
            "not what the sandbox showed: {} worse than the active version's by {} in {} live sequences, by {} in {} \
             sandbox pairs",
            one.signal.words(),
            one.signal.show(mean(&one.now)),
            shadow.len(),
            one.signal.show(mean(&one.before)),
            sandbox.len()
        );
        Reason::new(ReasonCode::ShadowShifted, Dimension::Shadow, text).with(p_value, level)
    });
    said.collect()
}

/// Whether it is looked after so many live tasks of an active version.
#[must_use]
pub fn live_look(tasks: u32, profile: &Profile) -> bool {
    LIVE_LOOKS.iter().any(|windows| windows.saturating_mul(profile.activation.provisional_episodes) == tasks)
}

/// Live tasks that are kept for the last look.
#[must_use]
pub fn live_tasks_max(profile: &Profile) -> u32 {
    LIVE_LOOKS
        .map(|windows| windows.saturating_mul(profile.activation.provisional_episodes))
        .into_iter()
        .fold(0, u32::max)
}

/// For each signal that is established as worse in live tasks than in the version's twins, a reason with both means.
#[must_use]
pub fn shifted_live(twins: &[EpisodeValues], live: &[EpisodeValues], profile: &Profile) -> Vec<Reason> {
    let compared = Signal::all().filter_map(|signal| {
        let of =
            |values: &[EpisodeValues]| values.iter().map(|values| signal.of(values)).collect::<Option<_>>();
        Some(Compared { signal, before: of(twins)?, now: of(live)? })
    });
    let level = profile.evaluation.shift_alpha / LIVE_LOOKS.len() as f64;
    let said = established(compared.collect(), profile, level).into_iter().map(|(one, p_value)| {
        let text = format!(
            "not what shadow showed: {} {} in {} live tasks, {} in {} of its twins",
            one.signal.words(),
            one.signal.show_own(mean(&one.now)),
            live.len(),
            one.signal.show_own(mean(&one.before)),
            twins.len()
        );
        Reason::new(ReasonCode::MonitorShifted, Dimension::Monitor, text).with(p_value, level)
    });
    said.collect()
}

/// Whether shadow found a version suspicious: there it is not what the sandbox showed.
#[must_use]
pub fn is_suspicious(result: &ShadowAssessment) -> bool {
    result.reasons.iter().any(|reason| reason.code == ReasonCode::ShadowShifted)
}

/// Whether a suspicious version that was worked again is cleared: it is established as no worse where the work is.
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

/// What working it again, in so many pairs, came to; what speaks against the version comes after it.
#[must_use]
pub fn worked_again(
    again: &BehaviorAssessment,
    pairs: usize,
    code: ReasonCode,
    dimension: Dimension,
) -> Vec<Reason> {
    let outcome = &again.assessment.outcome;
    let text = format!(
        "suspicious, and worked again in the live world's conditions: {} in {pairs} pairs with the version before",
        outcome.name()
    );
    let told = |reason: &&Reason| !is_cleared(again) && reason.code.tells_what_was_found();
    let found = again.assessment.reasons.iter().filter(told).cloned();
    std::iter::once(Reason::new(code, dimension, text)).chain(found).collect()
}

/// Adds to what shadow came to what working a suspicious version again has to say of it.
pub fn judge_again(result: &mut ShadowAssessment, again: &BehaviorAssessment, pairs: usize) {
    match again.assessment.outcome {
        // What holds the version back on a real cell still does.
        BehaviorOutcome::Compatible => {}
        BehaviorOutcome::Incompatible => result.check = Check::Fail,
        BehaviorOutcome::Suspicious | BehaviorOutcome::Inconclusive | BehaviorOutcome::NoData => {
            result.check = Check::Inconclusive;
        }
    }
    if result.check != Check::Pass {
        result.reasons.retain(|reason| reason.code != ReasonCode::ShadowClean);
    }
    let said = worked_again(again, pairs, ReasonCode::ShadowWorkedAgain, Dimension::Shadow);
    result.reasons.splice(0..0, said);
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Adds to what shadow came to what the sandbox has to say of it. Whoever would pass is looked at longer, and once that is
/// done held back, or, in simulation, let pass with the reason standing.
pub fn hold_against_sandbox(
    result: &mut ShadowAssessment,
    shadow: &ShadowEvidence,
    sandbox: &[Pair],
    profile: &Profile,
) {
    let looked_at = matches!(result.check, Check::Pass | Check::Inconclusive);
    if !looked_at || sandbox.is_empty() || result.sequences < profile.evaluation.shadow_sequences {
        return;
    }
    let found = shifted(sandbox, &shadow.sequences, profile);
    if found.is_empty() {
        return;
    }
    let holds = match profile.name {
        ProfileName::Sim => false,
        ProfileName::Real | ProfileName::Human => true,
    };
    if result.sequences < profile.evaluation.shadow_sequences_max || holds {
        result.check = Check::Inconclusive;
        result.reasons.retain(|reason| reason.code != ReasonCode::ShadowClean);
    }
    result.reasons.splice(0..0, found);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::{Binding, Conduct};
    use crate::harm::HarmMeasures;
    use crate::ids::Digest;

    fn values(slip_m: f64) -> EpisodeValues {
        EpisodeValues {
            success: true,
            violation: false,
            anomaly: false,
            recovery: false,
            intervention: false,
            timeout: false,
            near_violation: false,
            policy_warning: false,
            retries: 0,
            time_s: 4.0,
            unsafe_continuation_ms: 0.0,
            harm: Some(HarmMeasures { slip_m, ..HarmMeasures::STILL }),
        }
    }

    /// Slips less than 1 mm more in the sandbox, with some spread.
    fn sandbox() -> Vec<Pair> {
        let pair = |seed: u32| Pair {
            seed: seed.into(),
            active: values(0.001),
            candidate: values(0.001 + 1e-5 * f64::from(seed % 50)),
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
        };
        let digest = Digest::of_parts("test", &[]);
        let binding = Binding {
            candidate: digest,
            active: None,
            profile: digest,
            policy: digest,
            environment: digest,
            neighbours: None,
        };
        ShadowEvidence { binding, sequences: (0..count).map(sequence).collect(), hard_stops: Vec::new() }
    }

    fn judged(name: ProfileName, count: u32, more_m: f64) -> ShadowAssessment {
        let profile = Profile::builtin(name).unwrap();
        let evidence = shadow(count, more_m);
        let mut result = crate::gate::assess_shadow(&evidence, &evidence.binding, &profile);
        assert_eq!(result.check, Check::Pass, "without the sandbox nothing speaks against it: {result:?}");
        hold_against_sandbox(&mut result, &evidence, &sandbox(), &profile);
        result
    }

    #[test]
    fn what_is_the_same_in_both_worlds_or_differs_by_a_trifle_is_left_alone() {
        for more_m in [0.0, 2.0e-4, -0.001] {
            let found = judged(ProfileName::Sim, 20, more_m);
            assert_eq!(found.check, Check::Pass, "{more_m}: {found:?}");
            assert!(found.reasons.iter().all(|reason| reason.code != ReasonCode::ShadowShifted));
        }
    }

    #[test]
    fn a_shift_is_looked_at_longer_and_then_held_or_said() {
        let shift = 0.000_75;
        let said = |found: &ShadowAssessment| found.reasons[0].code == ReasonCode::ShadowShifted;
        let plain = judged(ProfileName::Sim, 20, shift);
        assert!(plain.check == Check::Inconclusive && said(&plain), "{plain:?}");
        let text = &plain.reasons[0].text;
        let begins = "not what the sandbox showed: motion of the object in the hand worse";
        assert!(text.starts_with(begins), "{text}");
        let longest = judged(ProfileName::Sim, 60, shift);
        assert!(longest.check == Check::Pass && said(&longest), "nobody is asked: it is said: {longest:?}");
        let held = judged(ProfileName::Real, 90, shift);
        assert!(held.check == Check::Inconclusive && said(&held), "{held:?}");
    }

    /// What working it again comes to: the candidate fails in so many of 300 pairs.
    fn again(failing: u32) -> BehaviorAssessment {
        let mut pairs = sandbox();
        for pair in pairs.iter_mut().take(failing as usize) {
            pair.candidate.success = false;
        }
        let evidence = shadow(0, 0.0);
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let paired =
            crate::evidence::PairedEvidence { binding: evidence.binding, pairs, hard_stops: Vec::new() };
        crate::behavior::assess(&paired, &evidence.binding, &profile)
    }

    #[test]
    fn what_working_it_again_comes_to_decides_and_lets_nothing_in_that_was_held() {
        for (name, count, failing, check) in [
            (ProfileName::Sim, 60, 0, Check::Pass),
            (ProfileName::Sim, 60, 200, Check::Fail),
            (ProfileName::Real, 90, 0, Check::Inconclusive),
            (ProfileName::Real, 90, 200, Check::Fail),
        ] {
            let mut found = judged(name, count, 0.000_75);
            assert!(is_suspicious(&found));
            let again = again(failing);
            judge_again(&mut found, &again, 300);
            assert_eq!(found.check, check, "{name} {failing}: {found:?}");
            assert_eq!(found.reasons[0].code, ReasonCode::ShadowWorkedAgain);
            assert_eq!(is_cleared(&again), failing == 0);
            // What was shadow's own reason to suspect it still stands.
            assert!(is_suspicious(&found));
        }
        // Neither established nor excluded: held, in simulation, too.
        let mut found = judged(ProfileName::Sim, 60, 0.000_75);
        let doubtful =
            (1..200).map(again).find(|again| again.assessment.outcome == BehaviorOutcome::Suspicious);
        judge_again(&mut found, &doubtful.expect("some number is neither"), 300);
        assert_eq!(found.check, Check::Inconclusive);
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
    fn an_active_version_is_held_against_its_twins() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let found = |live: &[EpisodeValues]| shifted_live(&lived(20, 0.0, 0), live, &profile);
        assert_eq!(found(&lived(20, 0.0, 0)), []);
        assert_eq!(found(&lived(60, 2.0e-4, 0)), [], "a trifle");
        let slipping = found(&lived(20, 0.003, 0));
        assert_eq!(slipping.len(), 1, "{slipping:?}");
        assert_eq!(slipping[0].code, ReasonCode::MonitorShifted);
        let begins = "not what shadow showed: motion of the object in the hand";
        assert!(slipping[0].text.starts_with(begins), "{}", slipping[0].text);
        let failing = found(&lived(20, 0.0, 16));
        assert!(
            failing[0].text.contains("failures of the task 80.0 % in 20 live tasks, 0.0 %"),
            "{failing:?}"
        );
        assert_eq!(found(&lived(20, 0.0, 6)), [], "three in ten of twenty can be chance beside 24 others");
        // A build without measures of harm compares the rest.
        let unmeasured = lived(20, 0.0, 16).into_iter().map(|one| EpisodeValues { harm: None, ..one });
        assert_eq!(found(&unmeasured.collect::<Vec<_>>()).len(), 1);
    }

    #[test]
    fn it_is_looked_at_the_end_of_the_window_and_twice_later() {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let looks: Vec<u32> =
            (0..=live_tasks_max(&profile)).filter(|tasks| live_look(*tasks, &profile)).collect();
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
            wrong += u32::from(looks.iter().any(|look| !shifted(&pairs, look, &profile).is_empty()));
        }
        assert!(wrong <= 7, "{wrong} of 200, 2 expected at most");
    }
}
