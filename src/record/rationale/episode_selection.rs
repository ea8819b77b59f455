//! Which piece of work is meant: a numbered one, or the worst.
//!
//! The worst pair is the one that shows most of what decided: bad in the component the rules found against the version,
//! good in the version it was compared with, then by gravity. Reads evidence; judges nothing.

use holdpoint_body::CodeFault;
use holdpoint_governance::behavior::{ComponentName, component_of};
use holdpoint_governance::decision::Reason;
use holdpoint_governance::evidence::{DrillKind, EpisodeValues, FailedDrill, Pair, SoloEpisode};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::permission::PermissionUse;
use holdpoint_protocol::film::{
    BreakCause, CodeFaultCount, FilmRequest, FilmSubject, SelectionFailure, SelectionReason,
};

use crate::evidence_file::EvidenceFile;

/// The piece that is meant.
pub struct SelectedEpisode {
    /// Its place, from 1.
    pub number: u32,
    pub count: u32,
    /// How many more failed than are on record one by one.
    pub beyond: u32,
    /// Why this one, where the worst was requested.
    pub reason: Option<SelectionReason>,
    pub found: SelectedWork,
}

pub enum SelectedWork {
    Pair(Box<Pair>),
    Drill(FailedDrill),
    Alone(Box<SoloEpisode>),
}

/// Finds it.
///
/// # Errors
/// If there is no such piece on record.
pub fn choose(
    evidence_file: &EvidenceFile,
    request: FilmRequest,
) -> Result<SelectedEpisode, SelectionFailure> {
    match request.of {
        FilmSubject::Episode => pair(&evidence_file.pairs, evidence_file, request),
        FilmSubject::Confirmation => {
            let settled = evidence_file.confirmation.as_ref();
            let pairs = settled.map_or(&[][..], |confirmation| &confirmation.pairs.pairs);
            pair(pairs, evidence_file, request)
        }
        FilmSubject::Drill => drill(&evidence_file.failed_drills, failed(evidence_file), request),
        FilmSubject::Alone => alone(&evidence_file.alone, overrun(evidence_file), request),
    }
}

/// What there is of an evaluation in the sandbox, the worst of each kind of work and of each kind of drill.
#[must_use]
pub fn worst_of_each(evidence_file: &EvidenceFile) -> Vec<FilmRequest> {
    let worst = |of: FilmSubject| FilmRequest { of, number: None };
    let mut requests = Vec::new();
    requests.extend((!evidence_file.pairs.is_empty()).then(|| worst(FilmSubject::Episode)));
    requests.extend((!evidence_file.alone.is_empty()).then(|| worst(FilmSubject::Alone)));
    requests.extend(DrillKind::ALL.into_iter().filter_map(|kind| {
        let of_kind =
            || evidence_file.failed_drills.iter().enumerate().filter(|(_, drill)| drill.kind == kind);
        let against = of_kind().find(|(_, drill)| drill.active == Some(true));
        let (index, _) = against.or_else(|| of_kind().next())?;
        Some(FilmRequest { of: FilmSubject::Drill, number: Some(count(index + 1)) })
    }));
    requests
}

/// The first reason that the rules found against the behavior; an early end of the evaluation is none.
fn first_against(evidence_file: &EvidenceFile) -> Option<&Reason> {
    let assessment = &evidence_file.behavior.as_ref()?.assessment;
    let is_against =
        |reason: &&Reason| reason.code.is_finding() && !crate::rationale::remedy::is_in_favor(reason.code);
    assessment.reasons.iter().find(is_against)
}

/// The component of behavior that the first reason against the version names, if it names one.
#[must_use]
pub fn decisive(evidence_file: &EvidenceFile) -> Option<ComponentName> {
    first_against(evidence_file).and_then(component_of)
}

/// The measure of harm that the first reason against the version names, if it names one.
#[must_use]
pub fn decisive_harm(evidence_file: &EvidenceFile) -> Option<HarmKind> {
    match first_against(evidence_file)?.finding.as_ref()? {
        Finding::HarmWorse { measure, .. }
        | Finding::HarmPossiblyWorse { measure, .. }
        | Finding::HarmLimitWorse { measure, .. }
        | Finding::HarmLimitPossiblyWorse { measure, .. } => Some(*measure),
        _ => None,
    }
}

/// What the rules found against the version.
#[derive(Clone, Copy)]
enum DecidingFinding {
    Component(ComponentName),
    Harm(HarmKind),
}

impl DecidingFinding {
    /// By how much the candidate is worse than the other in a pair; 0 where it was not measured.
    fn excess(self, pair: &Pair) -> f64 {
        match self {
            Self::Component(name) => badness(name, &pair.candidate) - badness(name, &pair.active),
            Self::Harm(kind) => pair
                .candidate
                .harm
                .zip(pair.active.harm)
                .map_or(0.0, |(new, old)| kind.worsening(new.of(kind), old.of(kind))),
        }
    }
}

/// The component or the measure of harm that the first reason names, or else the first significant measure of harm.
fn deciding(evidence_file: &EvidenceFile) -> Option<DecidingFinding> {
    let worse = || evidence_file.behavior.as_ref()?.harm.iter().find(|harm| harm.is_established());
    decisive(evidence_file).map(DecidingFinding::Component).or_else(|| {
        let kind = decisive_harm(evidence_file).or_else(|| worse().map(|harm| harm.kind));
        kind.map(DecidingFinding::Harm)
    })
}

/// How confined code failed on record, and in how many of the tasks.
#[must_use]
pub fn code_fault_counts(evidence_file: &EvidenceFile) -> Vec<CodeFaultCount> {
    let Some(PermissionUse { used, tasks, .. }) = &evidence_file.permissions else { return Vec::new() };
    let count = |(fault, failed): (&CodeFault, &u64)| CodeFaultCount {
        fault: *fault,
        failed: *failed,
        tasks: *tasks,
    };
    used.faults.iter().map(count).collect()
}

/// The fault of confined code that counts as a budget that is passed.
#[must_use]
pub fn overrun(evidence_file: &EvidenceFile) -> Option<CodeFault> {
    let faults = &evidence_file.permissions.as_ref()?.used.faults;
    [CodeFault::Fuel, CodeFault::Memory].into_iter().find(|fault| faults.contains_key(fault))
}

/// Whether a hard stop or a fault of the code broke an episode off, as far as its values tell.
const fn broke_off(values: &EpisodeValues) -> bool {
    values.recovery && !values.success && (values.anomaly || values.violation)
}

/// What is on record first of why episodes were broken off.
fn break_cause(evidence_file: &EvidenceFile) -> Option<BreakCause> {
    let fault = code_fault_counts(evidence_file).first().copied().map(BreakCause::Code);
    fault.or_else(|| {
        let stop = *evidence_file.hard_stops.first()?;
        Some(BreakCause::HardStop { stop, overrun: overrun(evidence_file) })
    })
}

fn pair(
    pairs: &[Pair],
    evidence_file: &EvidenceFile,
    request: FilmRequest,
) -> Result<SelectedEpisode, SelectionFailure> {
    let deciding = deciding(evidence_file);
    let cause = break_cause(evidence_file);
    let (index, pair) = chosen(pairs, request, || worst(pairs, deciding, cause.is_some()))?;
    let reason = if request.number.is_some() {
        None
    } else if let Some(cause) = cause.filter(|_| broke_off(&pair.candidate) && !broke_off(&pair.active)) {
        Some(SelectionReason::BrokenOff(cause))
    } else {
        Some(reason_for(&pair, deciding))
    };
    Ok(SelectedEpisode {
        number: count(index + 1),
        count: count(pairs.len()),
        beyond: 0,
        reason,
        found: SelectedWork::Pair(Box::new(pair)),
    })
}

/// How many of the version's drills failed, on record one by one or not.
fn failed(evidence_file: &EvidenceFile) -> u32 {
    let own = evidence_file.drills.as_ref().map(|(own, _)| own);
    own.map_or(0, |own| DrillKind::ALL.iter().map(|kind| own.of(*kind).failed).sum())
}

/// `all`: how many failed, of which the first are on record one by one.
fn drill(
    failed: &[FailedDrill],
    all: u32,
    request: FilmRequest,
) -> Result<SelectedEpisode, SelectionFailure> {
    let (index, found) = chosen(failed, request, || worst_drill(failed))?;
    let is_worst = request.number.is_none();
    let reason = is_worst.then_some(SelectionReason::MostFailingDrill { active_passes: found.active });
    let (number, listed) = (count(index + 1), count(failed.len()));
    let beyond = all.saturating_sub(listed);
    Ok(SelectedEpisode { number, count: listed, beyond, reason, found: SelectedWork::Drill(found) })
}

fn alone(
    episodes: &[SoloEpisode],
    overrun: Option<CodeFault>,
    request: FilmRequest,
) -> Result<SelectedEpisode, SelectionFailure> {
    let gravity = |episode: &SoloEpisode| -> [f64; 7] {
        let mut score = [0.0; 7];
        score[0] = f64::from(u8::from(episode.hard_stop.is_some()));
        for (place, name) in score[1..].iter_mut().zip(GRAVITY) {
            *place = badness(name, &episode.values);
        }
        score
    };
    let (index, episode) = chosen(episodes, request, || first_most(episodes.iter().map(gravity)))?;
    let reason = match (request.number, episode.hard_stop) {
        (Some(_), _) => None,
        (None, Some(stop)) => Some(SelectionReason::EndsEvaluation { stop, overrun }),
        (None, None) => Some(SelectionReason::Gravest),
    };
    let found = SelectedWork::Alone(Box::new(episode));
    Ok(SelectedEpisode { number: count(index + 1), count: count(episodes.len()), beyond: 0, reason, found })
}

/// Place of the largest; of equal ones the first.
fn first_most<const N: usize>(scores: impl Iterator<Item = [f64; N]>) -> usize {
    let mut most: Option<(usize, [f64; N])> = None;
    for (index, score) in scores.enumerate() {
        let order = most.as_ref().map(|(_, most)| {
            let parts = score.iter().zip(most).map(|(new, old)| new.total_cmp(old));
            parts.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
        });
        if order.is_none_or(std::cmp::Ordering::is_gt) {
            most = Some((index, score));
        }
    }
    most.map_or(0, |(index, _)| index)
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

/// The one that the request numbers, or else the worst, and its index.
fn chosen<T: Copy>(
    all: &[T],
    request: FilmRequest,
    worst: impl FnOnce() -> usize,
) -> Result<(usize, T), SelectionFailure> {
    let none = SelectionFailure::NoneOnRecord(request.of);
    if all.is_empty() {
        return Err(none);
    }
    let index = match request.number {
        Some(number) => numbered(number, all.len(), request.of)?,
        None => worst(),
    };
    all.get(index).map(|found| (index, *found)).ok_or(none)
}

fn numbered(number: u32, all: usize, of: FilmSubject) -> Result<usize, SelectionFailure> {
    let index = usize::try_from(number).ok().and_then(|number| number.checked_sub(1));
    let failure = SelectionFailure::OutOfRange { of, number, count: count(all) };
    index.filter(|index| *index < all).ok_or(failure)
}

/// How bad an episode is in one component; 0 is good.
#[must_use]
pub fn badness(name: ComponentName, values: &EpisodeValues) -> f64 {
    let flag = |on: bool| if on { 1.0 } else { 0.0 };
    match name {
        ComponentName::Success => flag(!values.success),
        ComponentName::Time => values.time_s,
        ComponentName::Retry => f64::from(values.retries),
        ComponentName::Violation => flag(values.violation),
        ComponentName::Anomaly => flag(values.anomaly),
        ComponentName::Recovery => flag(values.recovery),
    }
}

/// By gravity, the gravest first.
const GRAVITY: [ComponentName; 6] = [
    ComponentName::Violation,
    ComponentName::Recovery,
    ComponentName::Anomaly,
    ComponentName::Success,
    ComponentName::Retry,
    ComponentName::Time,
];

/// Place of the pair that shows most, one that was broken off first where such are on record; of equal ones the first.
fn worst(pairs: &[Pair], deciding: Option<DecidingFinding>, breaks: bool) -> usize {
    let score = |pair: &Pair| -> [f64; 9] {
        let mut score = [0.0; 9];
        score[0] = f64::from(u8::from(breaks && broke_off(&pair.candidate) && !broke_off(&pair.active)));
        score[1] = deciding.map_or(0.0, |deciding| deciding.excess(pair));
        score[2] = pair.candidate.unsafe_continuation_ms;
        for (place, name) in score[3..].iter_mut().zip(GRAVITY) {
            *place = DecidingFinding::Component(name).excess(pair);
        }
        score
    };
    first_most(pairs.iter().map(score))
}

/// What the candidate does in a pair that the other does not, the gravest first.
fn reason_for(pair: &Pair, deciding: Option<DecidingFinding>) -> SelectionReason {
    let first = deciding.into_iter().chain(GRAVITY.map(DecidingFinding::Component));
    let mut findings = first.filter(|deciding| deciding.excess(pair) > 0.0);
    let name = match findings.next() {
        Some(DecidingFinding::Component(name)) => name,
        Some(DecidingFinding::Harm(kind)) => {
            let value = |values: &EpisodeValues| values.harm.unwrap_or_default().of(kind);
            let (candidate, active) = (value(&pair.candidate), value(&pair.active));
            return SelectionReason::Harm { kind, candidate, active };
        }
        None => return SelectionReason::NowhereWorse,
    };
    match name {
        ComponentName::Violation => SelectionReason::LimitExceeded,
        ComponentName::Recovery => SelectionReason::RecoveryTookOver,
        ComponentName::Anomaly => SelectionReason::FailureNamed,
        ComponentName::Success => SelectionReason::NotDone,
        ComponentName::Retry => {
            SelectionReason::MoreAttempts { more: pair.candidate.retries.saturating_sub(pair.active.retries) }
        }
        ComponentName::Time => {
            SelectionReason::MoreTime { more_s: pair.candidate.time_s - pair.active.time_s }
        }
    }
}

/// Place of the first drill of the kind that fails most where the active version passes, else that fails most.
fn worst_drill(failed: &[FailedDrill]) -> usize {
    let active_passes = |drill: &&FailedDrill| drill.active == Some(true);
    let number = |kind: DrillKind, alone: bool| {
        failed.iter().filter(|drill| drill.kind == kind && (!alone || active_passes(drill))).count()
    };
    let alone = failed.iter().any(|drill| active_passes(&drill));
    let mut kinds = DrillKind::ALL;
    kinds.sort_by_key(|kind| std::cmp::Reverse(number(*kind, alone)));
    let first = failed.iter().position(|drill| drill.kind == kinds[0] && (!alone || active_passes(&drill)));
    first.unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::behavior::BehaviorAssessment;
    use holdpoint_governance::decision::Dimension;
    use holdpoint_governance::finding::EvidenceGap;
    use holdpoint_governance::harm::HarmMeasures;

    fn values(violation: bool, success: bool) -> EpisodeValues {
        EpisodeValues { success, violation, time_s: 4.0, ..EpisodeValues::CLEAN }
    }

    fn pair(seed: u64, candidate: EpisodeValues, active: EpisodeValues) -> Pair {
        Pair { seed, active, candidate, live_like: false }
    }

    #[test]
    fn the_worst_pair_shows_what_decided() {
        let good = values(false, true);
        let pairs = [
            pair(1, good, good),
            pair(2, values(false, false), good),
            pair(3, values(true, true), values(true, true)),
            pair(4, values(true, true), good),
            pair(5, values(true, false), good),
        ];
        assert_eq!(pairs[worst(&pairs, None, false)].seed, 5, "the gravest, and most of it");
        let component = |name| Some(DecidingFinding::Component(name));
        assert_eq!(pairs[worst(&pairs, component(ComponentName::Success), false)].seed, 5);
        assert_eq!(pairs[worst(&pairs[..4], component(ComponentName::Success), false)].seed, 2);
        assert_eq!(pairs[worst(&pairs[..4], component(ComponentName::Violation), false)].seed, 4);
        assert_eq!(reason_for(&pairs[3], None), SelectionReason::LimitExceeded);
        assert_eq!(reason_for(&pairs[0], None), SelectionReason::NowhereWorse);
    }

    /// The slowest episode was shown of a version whose code trapped in others.
    #[test]
    fn a_broken_off_episode_comes_first() {
        let good = values(false, true);
        let slow = EpisodeValues { time_s: 60.0, ..values(false, false) };
        let trapped = EpisodeValues { anomaly: true, recovery: true, ..values(false, false) };
        let pairs = [pair(1, slow, good), pair(2, trapped, trapped), pair(3, trapped, good)];
        let time = Some(DecidingFinding::Component(ComponentName::Time));
        assert_eq!(pairs[worst(&pairs, time, false)].seed, 1);
        assert_eq!(pairs[worst(&pairs, time, true)].seed, 3, "and the active version's is not broken off");
    }

    /// Of a version that was refused for what it did to its surroundings the slowest episode was shown.
    #[test]
    fn where_harm_decided_the_worst_pair_shows_it() {
        let pressing = |grip_peak_n, time_s| EpisodeValues {
            time_s,
            harm: Some(HarmMeasures { grip_peak_n, ..HarmMeasures::STILL }),
            ..values(false, true)
        };
        let pairs = [
            pair(1, pressing(25.0, 9.0), pressing(24.0, 4.0)),
            pair(2, pressing(70.0, 4.0), pressing(24.0, 4.0)),
        ];
        let harm = Some(DecidingFinding::Harm(HarmKind::GripPeak));
        assert_eq!(pairs[worst(&pairs, None, false)].seed, 1);
        assert_eq!(pairs[worst(&pairs, harm, false)].seed, 2);
        let reason = SelectionReason::Harm { kind: HarmKind::GripPeak, candidate: 70.0, active: 24.0 };
        assert_eq!(reason_for(&pairs[1], harm), reason);
    }

    /// Regression: a tolerated component stood for the harm that decided.
    #[test]
    fn the_first_reason_names_what_decides() {
        let measure = HarmKind::GripPeak;
        let harm = Finding::HarmWorse { measure, candidate: 70.0, active: 24.0, tolerance: 5.0 };
        let longer = Finding::ComponentWorse { component: ComponentName::Time };
        let mut behavior = holdpoint_governance::behavior::without_value(EvidenceGap::NoEpisodes);
        behavior.assessment.reasons =
            [harm, longer].map(|found| Reason::new(Dimension::Behavior, found)).to_vec();
        let of = |behavior: &BehaviorAssessment| {
            let file = EvidenceFile { behavior: Some(behavior.clone()), ..EvidenceFile::default() };
            (decisive(&file), decisive_harm(&file))
        };
        assert_eq!(of(&behavior), (None, Some(measure)));
        behavior.assessment.reasons.remove(0);
        assert_eq!(of(&behavior), (Some(ComponentName::Time), None));
    }

    #[test]
    fn drills_that_are_not_on_record_one_by_one_are_counted() {
        let failed = [FailedDrill { kind: DrillKind::Abort, phase: None, seed: 1, active: None }];
        let worst = FilmRequest { of: FilmSubject::Drill, number: None };
        assert_eq!(drill(&failed, 7, worst).unwrap().beyond, 6);
        assert_eq!(drill(&failed, 1, worst).unwrap().beyond, 0);
        // Records of older builds have no tally beside them.
        assert_eq!(drill(&failed, 0, worst).unwrap().beyond, 0);
    }

    #[test]
    fn a_drill_that_the_active_version_passes_comes_first() {
        let failed = |kind, seed, active| FailedDrill { kind, phase: None, seed, active };
        let all = [
            failed(DrillKind::Abort, 1, Some(false)),
            failed(DrillKind::Abort, 2, Some(false)),
            failed(DrillKind::Detect, 3, Some(false)),
            failed(DrillKind::Detect, 4, Some(true)),
        ];
        assert_eq!(all[worst_drill(&all)].seed, 4);
        assert_eq!(all[worst_drill(&all[..3])].seed, 1);
    }

    #[test]
    fn a_number_out_of_range_is_refused() {
        let of = FilmSubject::Drill;
        assert_eq!(numbered(1, 3, of), Ok(0));
        for number in [0, 4] {
            assert_eq!(numbered(number, 3, of), Err(SelectionFailure::OutOfRange { of, number, count: 3 }));
        }
    }
}
