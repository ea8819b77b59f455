//! Which alarm comes first.

use super::*;

fn alarm(priority: Priority, state: AlarmState, since_ms: u64) -> AlarmView {
    AlarmView {
        alarm: String::new(),
        subject: String::new(),
        state,
        priority,
        text: NoticeOrText::default(),
        since_ms,
        state_below: state,
        latching: false,
        acknowledged_by: None,
        shelf: None,
        raises: 1,
        chattering: false,
    }
}

/// Whether `one` comes before `other`, spelled out independently of the code.
fn comes_before(one: &AlarmView, other: &AlarmView) -> bool {
    let urgency = |alarm: &AlarmView| Priority::ALL.iter().position(|known| *known == alarm.priority);
    if one.priority != other.priority {
        return urgency(one) < urgency(other);
    }
    let unseen = |alarm: &AlarmView| {
        matches!(alarm.state, AlarmState::Unacknowledged | AlarmState::ReturnedUnacknowledged)
    };
    if unseen(one) != unseen(other) {
        return unseen(one);
    }
    let stands =
        |alarm: &AlarmView| matches!(alarm.state, AlarmState::Unacknowledged | AlarmState::Acknowledged);
    if stands(one) != stands(other) {
        return stands(one);
    }
    one.since_ms > other.since_ms
}

/// Every set of up to three alarms of every priority and state, older and newer, in every order.
#[test]
fn no_alarm_precedes_the_foremost_one() {
    let mut kinds = Vec::new();
    for priority in Priority::ALL {
        for state in AlarmState::ALL {
            kinds.extend([10, 20].map(|since_ms| alarm(priority, state, since_ms)));
        }
    }
    let hidden = |alarm: &AlarmView| matches!(alarm.state, AlarmState::Normal | AlarmState::Shelved);
    let check = |set: &[&AlarmView]| {
        let visible: Vec<&AlarmView> = set.iter().copied().filter(|alarm| !hidden(alarm)).collect();
        match foremost(set.iter().copied()) {
            None => assert!(visible.is_empty(), "{set:?}"),
            Some(first) => {
                assert!(visible.contains(&first), "{set:?}");
                assert!(!visible.iter().any(|other| comes_before(other, first)), "{first:?} of {set:?}");
            }
        }
    };
    check(&[]);
    for one in &kinds {
        check(&[one]);
        for two in &kinds {
            check(&[one, two]);
            for three in &kinds {
                check(&[one, two, three]);
            }
        }
    }
}
