//! The monitor against streams of episodes, silence and deadlines.

use holdpoint_governance::behavior::signature;
use holdpoint_governance::condition::Condition;
use holdpoint_governance::decision::ReasonCode::*;
use holdpoint_governance::evidence::{EpisodeValues, Signature};
use holdpoint_governance::monitor::{Monitor, MonitorAction, Rate, SafetyEvent};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::strictness::Strictness;

use crate::fixture::{GOOD, profile};

fn monitor(name: ProfileName) -> Monitor {
    Monitor::new(&profile(name), &expected(), 0).unwrap()
}

fn expected() -> Signature {
    signature([GOOD; 4].iter()).unwrap()
}

#[test]
fn good_episodes_confirm_a_version() {
    for name in ProfileName::ALL {
        let mut monitor = monitor(name);
        for episode in 1..=profile(name).activation.provisional_episodes {
            assert!(!monitor.is_confirmed());
            let decision = monitor.observe(&GOOD, u64::from(episode) * 960);
            assert_eq!(decision.action, MonitorAction::Continue, "{name:?}");
        }
        assert!(monitor.is_confirmed());
    }
}

#[test]
fn every_safety_event_trips_at_once_and_latches() {
    for event in SafetyEvent::ALL {
        let mut monitor = monitor(ProfileName::Sim);
        let decision = monitor.safety(event, 5);
        assert_eq!((decision.action, decision.reasons[0].code), (MonitorAction::Rollback, MonitorSafetyTrip));
        monitor.telemetry(6);
        assert_eq!(monitor.observe(&GOOD, 6).action, MonitorAction::Rollback, "it latches");
        assert_eq!(monitor.tick(7).action, MonitorAction::Rollback, "it latches");
    }
}

/// A blind spot leaves the other rates and the immediate trips.
#[test]
fn a_monitor_that_is_blind_to_a_rate_sees_the_others_and_every_safety_event() {
    let failing = EpisodeValues { success: false, ..GOOD };
    let acts = |blind: &[Rate], episode: EpisodeValues| {
        let mut monitor = monitor(ProfileName::Sim);
        monitor.disable_rates(blind);
        (1..=40).map(|tick| monitor.observe(&episode, tick).action).max().unwrap()
    };
    assert_eq!(acts(&[], failing), MonitorAction::Rollback);
    assert_eq!(acts(&[Rate::Failure], failing), MonitorAction::Continue);
    let retried = EpisodeValues { retries: 1, ..failing };
    assert_eq!(acts(&[Rate::Failure], retried), MonitorAction::Rollback);
    assert_eq!(acts(&Rate::ALL, retried), MonitorAction::Continue);
    let moved_on = EpisodeValues { unsafe_continuation_ms: 1e6, ..retried };
    assert_eq!(acts(&Rate::ALL, moved_on), MonitorAction::Rollback);
}

/// A rate that stays bad restricts first and then rolls back, sooner in a tighter profile.
#[test]
fn a_worse_rate_restricts_and_then_rolls_back() {
    let bad = [
        EpisodeValues { success: false, ..GOOD },
        EpisodeValues { violation: true, ..GOOD },
        EpisodeValues { anomaly: true, ..GOOD },
        EpisodeValues { intervention: true, ..GOOD },
        EpisodeValues { retries: 1, ..GOOD },
        EpisodeValues { recovery: true, ..GOOD },
    ];
    for episode in bad {
        let mut monitor = monitor(ProfileName::Sim);
        let actions: Vec<MonitorAction> =
            (1..=20).map(|tick| monitor.observe(&episode, tick).action).collect();
        let restricted = actions.iter().position(|action| *action == MonitorAction::Restrict);
        let rolled_back = actions.iter().position(|action| *action == MonitorAction::Rollback);
        assert!(
            restricted.is_some() && restricted < rolled_back && rolled_back < Some(8),
            "{episode:?}: {actions:?}"
        );
    }
}

#[test]
fn nan_and_unsafe_continuation_trip_the_monitor() {
    for episode in [
        EpisodeValues { time_s: f64::NAN, ..GOOD },
        EpisodeValues { unsafe_continuation_ms: f64::INFINITY, ..GOOD },
        EpisodeValues { unsafe_continuation_ms: 501.0, ..GOOD },
    ] {
        assert_eq!(
            monitor(ProfileName::Sim).observe(&episode, 1).action,
            MonitorAction::Rollback,
            "{episode:?}"
        );
    }
    for value in [f64::NAN, -0.1, 1.1] {
        let expected = Signature { anomaly: value, ..expected() };
        assert!(Monitor::new(&profile(ProfileName::Sim), &expected, 0).is_err(), "{value}");
    }
}

/// Silence escalates after 100 ms (24 ticks), restricts after 300 ms (72), and rolls back after 60 s without an answer.
#[test]
fn telemetry_silence_escalates_restricts_and_rolls_back() {
    let mut monitor = monitor(ProfileName::Sim);
    monitor.telemetry(100);
    for (tick, action) in [
        (110, MonitorAction::Continue),
        (124, MonitorAction::Escalate),
        (172, MonitorAction::Restrict),
        (124 + 60 * 240 - 1, MonitorAction::Restrict),
        (124 + 60 * 240, MonitorAction::Rollback),
    ] {
        assert_eq!(monitor.tick(tick).action, action, "{tick}");
    }
    let mut answered = self::monitor(ProfileName::Sim);
    assert_eq!(answered.tick(30).action, MonitorAction::Escalate);
    answered.on_answer(&profile(ProfileName::Sim), &expected(), 40).unwrap();
    answered.telemetry(60 * 240 + 30);
    assert_eq!(answered.tick(60 * 240 + 31).action, MonitorAction::Continue);
    // A clock that runs backward is silence.
    assert_eq!(answered.tick(5).action, MonitorAction::Restrict);
}

#[test]
fn monitor_continues_after_a_restart() {
    let mut one = monitor(ProfileName::Real);
    one.observe(&EpisodeValues { anomaly: true, ..GOOD }, 1);
    let mut other: Monitor = serde_json::from_str(&serde_json::to_string(&one).unwrap()).unwrap();
    let bad = EpisodeValues { anomaly: true, ..GOOD };
    for tick in 2..10 {
        assert_eq!(one.observe(&bad, tick), other.observe(&bad, tick));
    }
}

/// A monitor under conditions, for a version that shows an anomaly in every fifth episode.
fn under(name: ProfileName, conditions: &[Condition]) -> Monitor {
    let expected = Signature { anomaly: 0.2, ..expected() };
    Monitor::strict(&profile(name), &expected, Strictness::of(conditions), 0).unwrap()
}

/// A version under `human` showed 0 % of the limit of harm beside events of harm past its limit.
#[test]
fn a_rate_that_is_not_judged_has_no_chart() {
    for name in ProfileName::ALL {
        let monitor = monitor(name);
        let has_harm = monitor.charts().any(|(rate, ..)| rate == Rate::Harm);
        assert_eq!(has_harm, name == ProfileName::Sim, "{name:?}");
        assert!(monitor.charts().any(|(rate, ..)| rate == Rate::Failure), "{name:?}");
    }
}

/// The values of an episode where one in `every` shows an anomaly.
fn one_in(every: u64, tick: u64) -> &'static EpisodeValues {
    const BAD: EpisodeValues = EpisodeValues { anomaly: true, ..GOOD };
    if tick.is_multiple_of(every) { &BAD } else { &GOOD }
}

/// Half the limits: the same episodes warn and trip sooner.
#[test]
fn stricter_thresholds_halve_the_limits_until_the_version_is_confirmed() {
    let conditions = [Condition::StricterThresholds { factor: 0.5 }];
    let (plain, mut strict) = (under(ProfileName::Sim, &[]), under(ProfileName::Sim, &conditions));
    let limits = |monitor: &Monitor| monitor.charts().map(|(_, _, _, limit)| limit).collect::<Vec<_>>();
    let halved: Vec<f64> = limits(&plain).iter().map(|limit| limit / 2.0).collect();
    assert_eq!(limits(&strict), halved);
    let until = |mut monitor: Monitor, action: MonitorAction| {
        (1..10_000).find(|tick| monitor.observe(one_in(2, *tick), *tick).action >= action).unwrap()
    };
    for action in [MonitorAction::Restrict, MonitorAction::Rollback] {
        let (strict, plain) = (until(strict.clone(), action), until(plain.clone(), action));
        assert!(strict < plain, "{action}: {strict} against {plain} episodes");
    }
    // 300 ms of motion after a stop is within the limit of 500, and not within half of it.
    let moved = EpisodeValues { unsafe_continuation_ms: 300.0, ..GOOD };
    assert_eq!(plain.clone().observe(&moved, 1).action, MonitorAction::Continue);
    assert_eq!(strict.clone().observe(&moved, 1).action, MonitorAction::Rollback);
    strict.confirmed().unwrap();
    assert_eq!(limits(&strict), limits(&plain));
    for factor in [0.0, -1.0, f64::NAN] {
        let strictness = Strictness::of(&[Condition::StricterThresholds { factor }]);
        assert!(Monitor::strict(&profile(ProfileName::Sim), &expected(), strictness, 0).is_err(), "{factor}");
    }
}

/// Rollback-coupled: the first warning rolls the version back without asking an operator. Silence says nothing of the
/// version and asks as usual.
#[test]
fn a_coupled_version_is_rolled_back_on_the_first_warning() {
    // Where a chart warns before another trips, the two monitors part.
    let first = |mut monitor: Monitor, every: u64| {
        (1..10_000)
            .map(|tick| monitor.observe(one_in(every, tick), tick))
            .find(|decision| decision.action != MonitorAction::Continue)
            .unwrap()
    };
    let mut parted = 0;
    for name in ProfileName::ALL {
        for every in 1..=3 {
            let plain = first(under(name, &[]), every);
            let coupled = first(under(name, &[Condition::RollbackCoupled]), every);
            assert_eq!(
                (coupled.action, coupled.tick),
                (MonitorAction::Rollback, plain.tick),
                "{name} {every}"
            );
            if plain.action == MonitorAction::Restrict {
                parted += 1;
                assert_eq!(coupled.reasons[0].code, MonitorCoupledTrip);
            }
        }
    }
    assert!(parted > 0, "a chart warns before another trips at least once");
    let mut silent = under(ProfileName::Sim, &[Condition::RollbackCoupled]);
    assert_eq!(silent.tick(30).action, MonitorAction::Escalate);
    let mut confirmed = under(ProfileName::Sim, &[Condition::RollbackCoupled]);
    confirmed.confirmed().unwrap();
    let actions = (1..).map(|tick| confirmed.observe(one_in(2, tick), tick).action);
    let first = actions.into_iter().find(|action| *action != MonitorAction::Continue);
    assert_eq!(first, Some(MonitorAction::Restrict), "coupling ends with the window");
}
