//! The monitor after activation, end to end: the normal rates are measured on the twins of shadow, then the provisional
//! window is watched.

use super::figure::{StatedBound, StudyFigure, StudyMeasure, rate, unjudged};
use super::sampling::SampleStream;
use super::{Study, missing};
use holdpoint::bench::{BenchError, CLEAN};
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::monitor::{Monitor, MonitorAction, normal_rates};
use holdpoint_governance::profile::{ClassRisk, Profile};
use holdpoint_governance::strictness::Strictness;
use holdpoint_text::Hint;

const RULE: &str = "monitor";

/// True failure rates of versions that stay as they were.
const RATES: [f64; 6] = [0.01, 0.05, 0.12, 0.2, 0.3, 0.5];

/// Failures more, of versions that become worse with activation.
const SHIFTS: [f64; 2] = [0.2, 0.4];

/// Failure rate of a version before it becomes worse.
const BEFORE: f64 = 0.05;

/// Episodes watched at most when a delay is measured.
const DELAY_MAX: u32 = 400;

pub(super) fn study(study: &Study) -> Result<Vec<StudyFigure>, BenchError> {
    let mut findings = Vec::new();
    for profile in &study.profiles {
        let settings = &profile.evaluation;
        for twins in [settings.shadow_sequences, settings.shadow_sequences_max] {
            for table in &study.recorded.live {
                // The baseline and the candidate are each a version that stays as it is.
                let episodes: Vec<_> = table.pairs.iter().map(|pair| pair.active).collect();
                findings.extend(unchanged(study, profile, twins, table.name, &|draw| draw.of(&episodes))?);
            }
            for rate in RATES {
                findings.extend(unchanged(study, profile, twins, &format!("failures {rate}"), &|draw| {
                    Some(EpisodeValues { success: !draw.chance(rate), ..CLEAN })
                })?);
            }
        }
        for shift in SHIFTS {
            findings.extend(worse(study, profile, shift)?);
        }
    }
    Ok(findings)
}

/// The monitor of a version without an open concern. Where the profile couples, the first warning rolls it back.
fn set_up(
    draw: &mut SampleStream,
    profile: &Profile,
    twins: u32,
    episode: &dyn Fn(&mut SampleStream) -> Option<EpisodeValues>,
) -> Result<Monitor, BenchError> {
    let twins: Option<Vec<_>> = (0..twins).map(|_| episode(draw)).collect();
    let expected = twins.as_deref().and_then(|twins| normal_rates(twins, &profile.monitor));
    let expected = expected.ok_or_else(|| missing("twins"))?;
    let strictness = Strictness { coupled: profile.activation.rollback_coupled, ..Strictness::PLAIN };
    Monitor::strict(profile, &expected, strictness, 0).map_err(|error| BenchError::Unexpected {
        what: "the monitor",
        found: error.sentence(),
        expected: "a monitor",
    })
}

/// The first episode of each kind of action, from 1.
#[derive(Default)]
struct FirstActions {
    restricted: Option<u32>,
    rolled_back: Option<u32>,
}

fn watch(
    draw: &mut SampleStream,
    monitor: &mut Monitor,
    most: u32,
    episode: &dyn Fn(&mut SampleStream) -> Option<EpisodeValues>,
) -> FirstActions {
    let mut firsts = FirstActions::default();
    for number in 1..=most {
        let Some(values) = episode(draw) else { break };
        match monitor.observe(&values, u64::from(number)).action {
            MonitorAction::Continue | MonitorAction::Escalate => {}
            MonitorAction::Restrict => {
                firsts.restricted.get_or_insert(number);
            }
            MonitorAction::Rollback => {
                // A rolled-back version has also been warned of, at the latest now.
                firsts.restricted.get_or_insert(number);
                firsts.rolled_back = Some(number);
                break;
            }
        }
    }
    firsts
}

/// A version that behaves in live use as its twins did: how often is it restricted or rolled back within the window?
fn unchanged(
    study: &Study,
    profile: &Profile,
    twins: u32,
    name: &str,
    episode: &dyn Fn(&mut SampleStream) -> Option<EpisodeValues>,
) -> Result<Vec<StudyFigure>, BenchError> {
    let window = profile.activation.provisional_episodes;
    let under = format!("{}, {twins} twins, {window} episodes, {name}", profile.name.name());
    let mut draw = SampleStream::new(&format!("unchanged {under}"));
    let (mut restricted, mut rolled_back) = (0, 0);
    for _ in 0..study.runs {
        let mut monitor = set_up(&mut draw, profile, twins, episode)?;
        let firsts = watch(&mut draw, &mut monitor, window, episode);
        restricted += u64::from(firsts.restricted.is_some());
        rolled_back += u64::from(firsts.rolled_back.is_some());
    }
    let runs = u64::from(study.runs);
    // In simulation no operator has to answer, and an unanswered restriction ends in a rollback.
    let stated = Some(StatedBound::AtMost(match profile.name.declaration().risk {
        ClassRisk::Nothing => 0.005,
        ClassRisk::Machine => 0.02,
        ClassRisk::People => 0.04,
    }));
    Ok(vec![
        rate(RULE, StudyMeasure::UnchangedRestricted, under.clone(), (restricted, runs), stated)?,
        rate(RULE, StudyMeasure::UnchangedRolledBack, under, (rolled_back, runs), stated)?,
    ])
}

/// A version that fails more often from the first live episode on: after how many is it restricted and rolled back?
fn worse(study: &Study, profile: &Profile, shift: f64) -> Result<Vec<StudyFigure>, BenchError> {
    let window = profile.activation.provisional_episodes;
    let twins = profile.evaluation.shadow_sequences;
    let under = format!("{}, {twins} twins, failures {BEFORE} and +{shift}", profile.name.name());
    let mut draw = SampleStream::new(&format!("worse {under}"));
    let (mut restricted, mut rolled_back) = (Vec::new(), Vec::new());
    for _ in 0..study.runs {
        let fails = |rate: f64| {
            move |draw: &mut SampleStream| Some(EpisodeValues { success: !draw.chance(rate), ..CLEAN })
        };
        let mut monitor = set_up(&mut draw, profile, twins, &fails(BEFORE))?;
        let firsts = watch(&mut draw, &mut monitor, DELAY_MAX, &fails(BEFORE + shift));
        restricted.push(firsts.restricted.unwrap_or(DELAY_MAX + 1));
        rolled_back.push(firsts.rolled_back.unwrap_or(DELAY_MAX + 1));
    }
    let runs = u64::from(study.runs);
    let mut findings = Vec::new();
    for (what, within, delays) in [
        (StudyMeasure::DelayToRestriction, StudyMeasure::WorseRestricted, &mut restricted),
        (StudyMeasure::DelayToRollback, StudyMeasure::WorseRolledBack, &mut rolled_back),
    ] {
        delays.sort_unstable();
        let median = delays.get(delays.len() / 2).copied().ok_or_else(|| missing("delays"))?;
        findings.push(unjudged(RULE, what, under.clone(), runs, f64::from(median), "episodes"));
        let in_time = delays.iter().filter(|delay| **delay <= window).count() as u64;
        findings.push(rate(RULE, within, under.clone(), (in_time, runs), None)?);
    }
    Ok(findings)
}
