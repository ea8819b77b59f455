//! How the meter rates contacts, forces, commands and non-finite values.

use super::*;
use holdpoint_body::Pose;
use holdpoint_governance::harm::HarmKind;

fn seen(height_m: f64, contacts: Contacts) -> Telemetry {
    Telemetry {
        tick: 0,
        q: JointVec::new(),
        dq: JointVec::new(),
        tracking_error_rad: 0.0,
        tool: Pose { position: [0.4, 0.0, height_m], ..Pose::IDENTITY },
        tool_speed_m_s: 0.0,
        gripper_width_m: 0.05,
        gripper_force_n: 0.0,
        contact_force_n: 0.0,
        contacts,
        slip_m: None,
        picture_age_ticks: None,
        tool_available: true,
    }
}

fn guard() -> Guard {
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::{Profile, ProfileName};
    use std::sync::Arc;
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let model = holdpoint_sim::RobotModel::builtin("arm7").unwrap();
    let zones: Arc<[Zone]> = holdpoint_sim::published::scene().unwrap().zones.into();
    crate::terms::SkillTerms::new(&profile, table, Arc::new(model.geometry), zones)
        .own_guard(holdpoint_governance::mode::Authority::ALL[0])
}

const HELD: Contacts = Contacts {
    pad_object: true,
    body_object: false,
    robot_fixture: false,
    robot_clutter: false,
    robot_robot: false,
    object_fixture: false,
    object_clutter: false,
};
const LYING: Contacts = Contacts { object_fixture: true, pad_object: false, ..HELD };
const FREE: Contacts = Contacts { pad_object: false, ..HELD };

/// What a task comes to in which each of these lasts so many ticks, at a height that changes by so much a tick.
fn work(parts: &[(Contacts, u32, f64)]) -> HarmMeasures {
    let (guard, mut meter, mut height_m) = (guard(), HarmMeter::default(), 0.4);
    for (contacts, ticks, rise_m) in parts {
        for _ in 0..*ticks {
            height_m += rise_m;
            meter.note(&seen(height_m, *contacts), &guard, false);
        }
    }
    meter.measures()
}

#[test]
fn a_fall_is_measured_by_its_time() {
    // 19 ticks of free fall are 31 mm, and end at .78 m/s.
    let dropped = work(&[(HELD, 40, 0.0), (FREE, 19, 0.0), (LYING, 20, 0.0)]);
    assert!((dropped.drop_height_m - 0.0307).abs() < 1e-4, "{dropped:?}");
    assert!((dropped.landing_speed_m_s - 0.7763).abs() < 1e-3, "{dropped:?}");
    let released = work(&[(HELD, 40, 0.0), (HELD, 5, -0.0001), (LYING, 40, 0.0)]);
    assert_eq!(released.drop_height_m, 0.0);
    // Caught again before it lands, and a contact that flickers: neither is a fall.
    let caught = work(&[(HELD, 40, 0.0), (FREE, 5, 0.0), (HELD, 40, 0.0), (LYING, 9, 0.0)]);
    assert_eq!(caught.drop_height_m, 0.0, "{caught:?}");
    // What never lands fell all the same.
    let lost = work(&[(HELD, 40, 0.0), (FREE, 400, 0.0)]);
    assert!((lost.drop_height_m - 1.2258).abs() < 1e-3, "{lost:?}");
}

#[test]
fn a_lying_object_does_not_fall_and_one_set_down_hard_lands_fast() {
    let touched = work(&[(LYING, 9, 0.0), (FREE, 300, 0.0), (HELD, 9, 0.0), (LYING, 9, 0.0)]);
    assert_eq!(touched.drop_height_m, 0.0, "{touched:?}");
    let both = Contacts { object_fixture: true, ..HELD };
    // .25 m/s downward with the object in the hand.
    let slammed = work(&[(HELD, 40, -0.25 / 240.0), (both, 20, 0.0)]);
    assert!((slammed.landing_speed_m_s - 0.25).abs() < 0.02, "{slammed:?}");
    let lifted = work(&[(both, 10, 0.0), (HELD, 40, 0.001)]);
    assert_eq!(lifted.landing_speed_m_s, 0.0);
}

#[test]
fn lasting_forces_differ_from_blows() {
    let (guard, mut meter) = (guard(), HarmMeter::default());
    for tick in 0..60 {
        let blow = if tick == 30 { 60.0 } else { 10.0 };
        let mut now = seen(0.4, HELD);
        (now.gripper_force_n, now.contact_force_n) = (18.0, blow);
        meter.note(&now, &guard, tick < 24);
    }
    let found = meter.measures();
    assert_eq!((found.grip_peak_n, found.grip_held_n, found.contact_peak_n), (18.0, 18.0, 60.0));
    assert!((found.contact_held_n - (11.0 * 10.0 + 60.0) / 12.0).abs() < 0.01, "{found:?}");
    assert!((found.near_time_s - 0.1).abs() < 1e-9);
}

#[test]
fn a_clamp_counts_with_its_depth() {
    let (guard, mut meter) = (guard(), HarmMeter::default());
    let grip = |force_n| Command::Gripper { width_m: 0.0, speed_m_s: 0.1, force_n };
    let q = JointVec::from_iter([1.0, -2.0]);
    for verdict in [GuardVerdict::Clamped, GuardVerdict::Denied, GuardVerdict::Allowed, GuardVerdict::Allowed]
    {
        let command = if verdict == GuardVerdict::Denied { Command::Stop } else { grip(25.0) };
        meter.note_command(&grip(38.0), &CheckedCommand { command, verdict, hit: None }, &guard, (&q, &q));
    }
    meter.note(&seen(0.4, FREE), &guard, false);
    let found = meter.measures();
    assert_eq!((found.clamped_share, found.denied_share, found.clamp_depth), (0.25, 0.25, 0.52));
    assert!((found.energy_j - 0.08).abs() < 0.01, "four ticks of 5 W: {found:?}");
}

#[test]
fn nan_measures_count_as_the_worst_value() {
    let (guard, mut meter) = (guard(), HarmMeter::default());
    let mut broken = seen(f64::NAN, FREE);
    (broken.gripper_force_n, broken.slip_m) = (f64::NAN, Some(f64::NAN));
    meter.note(&broken, &guard, false);
    let found = meter.measures();
    assert!(found.is_valid(), "{found:?}");
    assert_eq!((found.grip_peak_n, found.slip_m, found.workspace_margin_m), (1.0e4, 10.0, -1.0));
    let empty = HarmMeter::default().measures();
    assert!(
        empty.is_valid()
            && HarmKind::ALL.into_iter().all(|kind| empty.of(kind) == HarmMeasures::STILL.of(kind))
    );
}
