//! The monitor against streams of episodes, silence and deadlines.

use holdpoint_governance::behavior::signature;
use holdpoint_governance::decision::ReasonCode::*;
use holdpoint_governance::evidence::{EpisodeValues, Signature};
use holdpoint_governance::monitor::{Monitor, MonitorAction, SafetyEvent};
use holdpoint_governance::profile::ProfileName;

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
fn what_is_no_number_and_unsafe_continuation_trip() {
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

/// Silence escalates after 100 ms (24 ticks) and restricts after 300 ms (72); nobody answers for 60 s: rollback.
#[test]
fn silence_and_deadlines() {
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
    answered.answered(&profile(ProfileName::Sim), &expected(), 40).unwrap();
    answered.telemetry(60 * 240 + 30);
    assert_eq!(answered.tick(60 * 240 + 31).action, MonitorAction::Continue);
    // A clock that runs backwards is silence.
    assert_eq!(answered.tick(5).action, MonitorAction::Restrict);
}

#[test]
fn a_monitor_goes_on_after_a_restart() {
    let mut one = monitor(ProfileName::Real);
    one.observe(&EpisodeValues { anomaly: true, ..GOOD }, 1);
    let mut other: Monitor = serde_json::from_str(&serde_json::to_string(&one).unwrap()).unwrap();
    let bad = EpisodeValues { anomaly: true, ..GOOD };
    for tick in 2..10 {
        assert_eq!(one.observe(&bad, tick), other.observe(&bad, tick));
    }
}
