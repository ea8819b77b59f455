//! How often a rate ends a version for good, on drawn outcomes of the version and of its rollback target.
//!
//! The comparison is not exact once a chart has tripped: the trip selected tasks in which the version was bad. So the
//! shares are measured here, and stated in the guide (design/statistics.md, Drift monitor).

use std::collections::VecDeque;

use holdpoint_governance::evidence::EpisodeValues;
use holdpoint_governance::monitor::{
    ForkedPair, Monitor, MonitorAction, RateComparison, deciding_rates, normal_rates,
};
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_governance::strictness::Strictness;

use crate::fixture::{GOOD, Uniform, profile};

const LIVES: u64 = 1_000;

/// The tasks of a life.
const WINDOW: u64 = 200;

/// What is normal after 20 twins without a failure.
const NORMAL: f64 = 0.075_886_979;

/// How a live scene makes either version fail, independently of each other, and how often the version fails besides.
struct Scenes {
    name: &'static str,
    /// Share of scenes that are hard, and of failures in them.
    hard: [f64; 2],
    /// Share of the tasks without that failure in which the version fails besides.
    more: f64,
}

/// Whether a chart rolls the version back in its window, and whether that is for good.
fn life(scenes: &Scenes, profile: &Profile, random: &mut Uniform) -> [bool; 2] {
    let settings = &profile.monitor;
    let expected = normal_rates(&[GOOD; 20], settings).unwrap();
    let mut monitor = Monitor::new(profile, &expected, 0).unwrap();
    let mut pairs = VecDeque::new();
    for seed in 1..=WINDOW {
        let fails = if random.next() < scenes.hard[0] { scenes.hard[1] } else { 0.0 };
        let mut of = |rate: f64| EpisodeValues { success: random.next() >= rate, ..GOOD };
        let version = of(fails + scenes.more * (1.0 - fails));
        pairs.push_back(ForkedPair { seed, version, target: of(fails), tightened: false });
        if pairs.len() > settings.paired_tasks_max() {
            pairs.pop_front();
        }
        let decision = monitor.observe(&version, seed);
        if decision.action == MonitorAction::Rollback {
            let rates = deciding_rates(&decision.reasons);
            let compared = monitor.rate_comparison(&rates, pairs.make_contiguous(), settings.paired_alpha);
            return [true, compared.differs()];
        }
    }
    [false, false]
}

/// Shares of another implementation, with slack: 4,000 lives each.
#[test]
fn a_rate_ends_an_equal_version_for_good_as_seldom_as_stated() {
    let profile = profile(ProfileName::Sim);
    assert_eq!((profile.monitor.paired_tasks, profile.monitor.paired_alpha), (40.0, 0.05));
    let chart = WINDOW as f64 / profile.monitor.false_alarm_episodes;
    println!("rolled back by a chart, and for good, of {LIVES} lives of {WINDOW} tasks");
    for (scenes, rolled_back, for_good) in [
        // The chart's own rate bounds what happens without any change of the cell.
        (Scenes { name: "equal, as normal", hard: [1.0, NORMAL], more: 0.0 }, [0.0, chart], [0.0, 0.03]),
        (Scenes { name: "equal, a tenth hard", hard: [0.1, 0.5], more: 0.0 }, [0.0, chart], [0.0, 0.01]),
        // Where the cell has changed, the trip is certain, and selects little.
        (Scenes { name: "equal, cell at .3", hard: [1.0, 0.3], more: 0.0 }, [0.99, 1.0], [0.0, 0.05]),
        (Scenes { name: "equal, cell at .5", hard: [1.0, 0.5], more: 0.0 }, [0.99, 1.0], [0.0, 0.05]),
        (Scenes { name: "equal, cell at .9", hard: [1.0, 0.9], more: 0.0 }, [0.99, 1.0], [0.0, 0.05]),
        (Scenes { name: "13 % more", hard: [0.05, 0.5], more: 0.13 }, [0.75, 1.0], [0.65, 1.0]),
        (Scenes { name: "40 % more", hard: [0.05, 0.5], more: 0.4 }, [0.99, 1.0], [0.9, 1.0]),
        (Scenes { name: "always", hard: [0.05, 0.5], more: 1.0 }, [0.99, 1.0], [0.96, 1.0]),
        (Scenes { name: "40 % more, cell at .3", hard: [1.0, 0.3], more: 0.4 }, [0.99, 1.0], [0.07, 0.2]),
    ] {
        let mut random = Uniform(5);
        let ends: Vec<[bool; 2]> = (0..LIVES).map(|_| life(&scenes, &profile, &mut random)).collect();
        let share = |at: usize| ends.iter().filter(|end| end[at]).count() as f64 / LIVES as f64;
        let (off, final_end) = (share(0), share(1));
        println!("{}: {off:.3} {final_end:.3}", scenes.name);
        assert!((rolled_back[0]..=rolled_back[1]).contains(&off), "{}: {off}", scenes.name);
        assert!((for_good[0]..=for_good[1]).contains(&final_end), "{}: {final_end}", scenes.name);
    }
}

/// A version that fails in every way it can, up to the trip of its charts: the rates that decided, compared with a target
/// that has these values in the same tasks.
fn always_failing(target: impl Fn(EpisodeValues) -> EpisodeValues) -> RateComparison {
    let profile = profile(ProfileName::Sim);
    let expected = normal_rates(&[GOOD; 20], &profile.monitor).unwrap();
    let mut monitor = Monitor::new(&profile, &expected, 0).unwrap();
    let failed = EpisodeValues { success: false, anomaly: true, recovery: true, retries: 2, ..GOOD };
    let mut pairs = Vec::new();
    let mut rates = Vec::new();
    for seed in 1..=40 {
        pairs.push(ForkedPair { seed, version: failed, target: target(failed), tightened: false });
        let decision = monitor.observe(&failed, seed);
        if decision.action == MonitorAction::Rollback {
            rates = deciding_rates(&decision.reasons);
            break;
        }
    }
    assert!(rates.len() > 1, "{rates:?}");
    monitor.rate_comparison(&rates, &pairs, profile.monitor.paired_alpha)
}

/// In the same fork an equal version does the same: no chance of the scenes ends it for good.
#[test]
fn a_version_with_the_same_outcomes_is_never_ended_for_good_by_a_rate() {
    let compared = always_failing(|failed| failed);
    assert!(!compared.differs(), "{compared:?}");
    assert!(compared.rates.iter().all(|rate| rate.p == 1.0), "{compared:?}");
}

#[test]
fn a_version_that_fails_in_every_way_at_once_is_ended_for_good() {
    let compared = always_failing(|_| GOOD);
    assert!(compared.differs(), "{compared:?}");
}

/// As stated in the guide: the charts may need fewer than five tasks, the fewest that differ.
#[test]
fn a_version_that_always_fails_may_leave_too_few_tasks_to_differ() {
    for (name, twins, coupled, tasks, differs) in [
        (ProfileName::Sim, 20, false, 6, true),
        (ProfileName::Real, 30, false, 5, true),
        (ProfileName::Real, 30, true, 4, false),
        (ProfileName::Human, 40, true, 4, false),
    ] {
        let profile = profile(name);
        let expected = normal_rates(&vec![GOOD; twins], &profile.monitor).unwrap();
        let strictness = Strictness { coupled, ..Strictness::PLAIN };
        let mut monitor = Monitor::strict(&profile, &expected, strictness, 0).unwrap();
        let failed = EpisodeValues { success: false, ..GOOD };
        let rolled_back = (1..=40).find_map(|task| {
            let decision = monitor.observe(&failed, task);
            (decision.action == MonitorAction::Rollback).then_some((task, decision.reasons))
        });
        let (fed, reasons) = rolled_back.unwrap();
        let pair = |seed| ForkedPair { seed, version: failed, target: GOOD, tightened: false };
        let pairs: Vec<ForkedPair> = (1..=fed).map(pair).collect();
        let compared =
            monitor.rate_comparison(&deciding_rates(&reasons), &pairs, profile.monitor.paired_alpha);
        assert_eq!((fed, compared.differs()), (tasks, differs), "{name}, coupled: {coupled}");
    }
}
