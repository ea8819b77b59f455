//! Harm in live work: what is normal, what counts, and after how many tasks a version is rolled back.

use std::collections::BTreeMap;

use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::live_harm::{HarmTally, LiveHarm, TaskHarm};
use holdpoint_governance::monitor::{MonitorAction, roll_back};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::rollback::TriggerKind;
use holdpoint_governance::stats::RateRise;

use crate::fixture::Uniform;
use crate::fixture::{GOOD, profile};

const STILL: HarmMeasures = HarmMeasures::STILL;
/// Past the limit, and no danger.
const DROPPED: HarmMeasures = HarmMeasures { landing_speed_m_s: 0.5, ..STILL };

fn tally(tasks: u64, past: u64) -> HarmTally {
    let measures = if past > 0 { BTreeMap::from([(HarmKind::LandingSpeed, past)]) } else { BTreeMap::new() };
    HarmTally { tasks, any: past, past: measures }
}

/// A version with this many of 320 evaluated episodes past the limit, beside an anchor with these live tasks.
fn evaluated(past: u64, anchor: HarmTally) -> LiveHarm {
    LiveHarm::new(tally(320, past), anchor)
}

fn observe(life: &mut LiveHarm, harm: &HarmMeasures, profile: &Profile) -> TaskHarm {
    life.observe(harm, false, profile).unwrap()
}

/// Values of another implementation (SciPy's normal quantile in Wilson's formula).
#[test]
fn normal_rate_is_what_all_tasks_leave_open_and_no_less_than_a_part_shows() {
    for (past, anchor, expected) in [
        (0, tally(0, 0), 0.005_106_21),
        (1, tally(0, 0), 0.010_389_11),
        (15, tally(0, 0), 0.064_469_05),
        // A long life of the anchor tightens the bound; half an episode of the own ones stays.
        (0, tally(2_000, 0), 0.001_557_63),
        (5, tally(2_000, 0), 5.5 / 321.0),
        // What the anchor's own tasks show is normal.
        (0, tally(60, 3), 0.05),
    ] {
        let life = evaluated(past, anchor);
        for measure in [None, Some(HarmKind::LandingSpeed)] {
            let found = life.normal(measure, NORMAL_ALPHA).unwrap();
            assert!((found - expected).abs() < 1e-7, "{past}: {found} is not {expected}");
        }
        if past > 0 {
            let any = life.normal(None, NORMAL_ALPHA).unwrap();
            assert!(life.normal(Some(HarmKind::Slip), NORMAL_ALPHA).unwrap() < any);
        }
    }
    assert!(LiveHarm::default().normal(None, NORMAL_ALPHA).is_err(), "nothing was measured");
    let episodes = [STILL, DROPPED].map(|harm| EpisodeValues { harm: Some(harm), ..GOOD });
    let limits = profile(ProfileName::Sim).harm;
    assert_eq!(
        HarmTally::of(episodes.iter().chain([&GOOD]), &limits),
        tally(2, 1),
        "the last has no measures"
    );
}

#[test]
fn first_danger_rolls_a_version_back_and_names_its_measure() {
    let profile = profile(ProfileName::Sim);
    let mut life = evaluated(0, tally(0, 0));
    let thrown = HarmMeasures { landing_speed_m_s: 2.5, ..STILL };
    let task = observe(&mut life, &thrown, &profile);
    assert_eq!(task.past.len(), 1);
    let decision = roll_back(task.reasons(), 7);
    assert_eq!((decision.action, decision.tick), (MonitorAction::Rollback, 7));
    assert_eq!(TriggerKind::of(&decision.reasons, false), TriggerKind::SafetyEvent);
    let limit = profile.live_harm.danger_landing_speed_m_s;
    let expected = Finding::DangerLive { measure: HarmKind::LandingSpeed, value: 2.5, limit };
    assert_eq!(decision.reasons[0].finding, Some(expected));
    assert!(
        observe(&mut life, &DROPPED, &profile).reasons().is_empty(),
        "no danger, and no established rate"
    );
    assert_eq!(life.lived(), &tally(2, 2));
}

/// The alarm names the measure and the counts, and stays.
#[test]
fn higher_rate_rolls_a_version_back_for_its_whole_life() {
    let profile = profile(ProfileName::Sim);
    let mut life = evaluated(0, tally(0, 0));
    let mut tasks = 0_u64;
    let reason = loop {
        tasks += 1;
        let slips = HarmMeasures { slip_m: 0.02, ..STILL };
        let harm = match tasks {
            60 => &slips,
            many if many.is_multiple_of(20) => &DROPPED,
            _ => &STILL,
        };
        if let Some(reason) = observe(&mut life, harm, &profile).rise {
            break reason;
        }
        assert!(tasks < 400, "one in twenty is not found");
    };
    assert_eq!(reason.code, ReasonCode::MonitorHarmTrip);
    assert_eq!(TriggerKind::of(std::slice::from_ref(&reason), false), TriggerKind::RateTrip);
    assert!(reason.evidence >= reason.limit && reason.limit == Some(1.0 / profile.live_harm.life_alpha));
    let Some(Finding::HarmRoseLive { measure, past, any, tasks: counted, .. }) = reason.finding else {
        panic!("{reason:?}");
    };
    assert_eq!((measure, counted, any, past), (HarmKind::LandingSpeed, tasks, tasks / 20, tasks / 20 - 1));
    for _ in 0..2_000 {
        assert!(observe(&mut life, &STILL, &profile).rise.is_some(), "good tasks take nothing back");
    }
}

/// Without an evaluation the first tasks show what is normal: as many as an evaluation has pairs.
#[test]
fn version_without_an_evaluation_is_compared_with_its_first_tasks() {
    let profile = profile(ProfileName::Sim);
    let first = u64::from(profile.evaluation.sandbox_pairs);
    let mut life = LiveHarm::default();
    for task in 0..first {
        let harm = if task.is_multiple_of(10) { &DROPPED } else { &STILL };
        assert!(observe(&mut life, harm, &profile).reasons().is_empty(), "task {task}");
    }
    assert!(life.normal(None, NORMAL_ALPHA).unwrap() > 0.1 && life.evidence() == 0.0);
    let found = (0..200).find(|_| observe(&mut life, &DROPPED, &profile).rise.is_some());
    assert!(found.is_some_and(|tasks| tasks < 30), "{found:?}");
    let thrown = HarmMeasures { landing_speed_m_s: 2.5, ..STILL };
    assert!(
        !observe(&mut LiveHarm::default(), &thrown, &profile).danger.is_empty(),
        "at the very first task"
    );
}

#[test]
fn effects_of_a_tighter_envelope_do_not_count() {
    let profile = profile(ProfileName::Sim);
    let near = HarmMeasures { near_time_s: 20.0, denied_share: 0.5, ..STILL };
    for (tightened, past) in [(true, 0), (false, 2)] {
        let mut life = evaluated(0, tally(0, 0));
        assert_eq!(life.observe(&near, tightened, &profile).unwrap().past.len(), past);
    }
}

/// A restarted engine continues with the same evidence; and a chart that opens late has seen every task before.
#[test]
fn stored_life_continues_with_the_same_evidence() {
    let profile = profile(ProfileName::Real);
    let mut life = evaluated(1, tally(0, 0));
    let mut whole = RateRise::new(life.normal(None, NORMAL_ALPHA).unwrap()).unwrap();
    for task in 1..=400_u64 {
        let is_past = task.is_multiple_of(37);
        observe(&mut life, if is_past { &DROPPED } else { &STILL }, &profile);
        whole.update(is_past);
        if task % 50 == 0 {
            life = serde_json::from_str(&serde_json::to_string(&life).unwrap()).unwrap();
        }
    }
    let expected = whole.value() * SHARE;
    assert!((life.evidence() / expected - 1.0).abs() < 1e-6, "{} is not {expected}", life.evidence());
    assert_eq!(life.lived(), &tally(400, 10));
}

/// `live_harm.normal_alpha` of the shipped profiles.
const NORMAL_ALPHA: f64 = 0.1;

/// `live_harm.life_alpha` of the profile `sim`.
const ALPHA: f64 = 0.01;

/// The weight of harm in one measure that is always the same one: its own chart, and that of any.
const SHARE: f64 = 0.5 + 0.5 / HarmKind::ALL.len() as f64;

/// The task at which the rule rolls a version back that does no harm in its first `good` tasks and then does harm at a rate,
/// always in one measure; `None` if not within `most` tasks of harm. Of the profile `sim`.
fn rolled_back(normal: f64, rate: f64, [good, most]: [u64; 2], random: &mut Uniform) -> Option<u64> {
    let mut chart = RateRise::new(normal).unwrap();
    (0..good).for_each(|_| chart.update(false));
    (1..=most).find(|_| {
        chart.update(random.next() < rate);
        chart.value() * SHARE >= 1.0 / ALPHA
    })
}

/// The table of the guide (design/statistics.md): after how many tasks the rule rolls versions back, by what is normal.
#[test]
fn tasks_until_a_harmful_version_is_rolled_back() {
    const LIVES: usize = 2_000;
    let settings = profile(ProfileName::Sim).live_harm;
    assert_eq!((settings.life_alpha, settings.normal_alpha), (ALPHA, NORMAL_ALPHA));
    let normals = [(0, tally(2_000, 0)), (0, tally(0, 0)), (1, tally(0, 0)), (15, tally(0, 0))]
        .map(|(past, anchor)| evaluated(past, anchor).normal(None, NORMAL_ALPHA).unwrap());
    println!("false alarms in {LIVES} lives of 10,000 tasks at the normal rate");
    for normal in [normals[1], normals[3]] {
        let mut random = Uniform(11);
        let alarms =
            (0..LIVES).filter(|_| rolled_back(normal, normal, [0, 10_000], &mut random).is_some()).count();
        println!("{normal:.4}: {alarms}");
        assert!(alarms as f64 <= ALPHA * LIVES as f64, "{normal}: {alarms}");
    }
    println!("normal, one in, after good tasks: median, 90 %");
    let quantiles = |normal: f64, one_in: f64, good: u64| {
        let mut random = Uniform(12);
        let mut tasks: Vec<u64> = (0..400)
            .map(|_| rolled_back(normal, 1.0 / one_in, [good, 20_000], &mut random).unwrap_or(u64::MAX))
            .collect();
        tasks.sort_unstable();
        println!("{normal:.4}  {one_in}  {good:4}: {}  {}", tasks[199], tasks[359]);
        [tasks[199], tasks[359]]
    };
    // Medians and quantiles of another implementation, with a third of slack (1,000 lives each).
    for (normal, one_in, good, [median, high]) in [
        (normals[0], 20.0, 0, [52, 123]),
        (normals[0], 40.0, 0, [136, 302]),
        (normals[0], 100.0, 0, [619, 1_401]),
        (normals[0], 100.0, 1_000, [1_078, 1_905]),
        (normals[1], 20.0, 0, [90, 198]),
        (normals[1], 40.0, 0, [313, 699]),
        (normals[1], 20.0, 1_000, [193, 328]),
        (normals[1], 40.0, 1_000, [651, 1_095]),
        (normals[2], 20.0, 0, [147, 337]),
        (normals[2], 40.0, 0, [891, 1_616]),
    ] {
        let found = quantiles(normal, one_in, good);
        for (found, expected) in found.into_iter().zip([median, high]) {
            let near = expected * 2 / 3..=expected * 4 / 3;
            assert!(
                near.contains(&found),
                "{normal}, one in {one_in} after {good}: {found} is not {expected}"
            );
        }
    }
}
