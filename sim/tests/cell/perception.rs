//! What camera and sensors deliver has the statistics the distribution says.

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_body::{Command, TaskKind};
use holdpoint_cell::{Distribution, EpisodeSetup, Range, RobotCell as _};

use crate::script::{act, arm, canonical, scene, world};

/// Errors of x of the perceived tray, one per picture, over some seconds.
fn frame_errors(distribution: &Distribution, seed: u64, ticks: u32) -> Vec<f64> {
    let mut world = world("arm7");
    let setup = EpisodeSetup::sample(TaskKind::Grasp, &scene(), distribution, seed);
    world.reset(&setup).expect("reset");
    let mut errors = Vec::new();
    let mut last = 0;
    for _ in 0..ticks {
        world.step(&Command::Hold).expect("step");
        let Some(estimate) = world.observe().target().copied() else { continue };
        if estimate.sequence != last {
            last = estimate.sequence;
            errors.push(estimate.pose.position[0] - setup.target.position[0]);
        }
    }
    errors
}

fn moments(values: &[f64]) -> (f64, f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n;
    let lag = values.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum::<f64>() / n;
    (mean, variance.sqrt(), lag / variance)
}

#[test]
fn frames_come_at_thirty_hertz_with_the_set_noise() {
    let mut d = canonical();
    d.camera.sigma_m = Range::exactly(0.003);
    d.camera.bias_m = Range::exactly(0.002);
    let errors = frame_errors(&d, 4, 4800);
    assert!((595..=601).contains(&errors.len()), "{} camera frames in 20 s", errors.len());
    let (mean, sigma, lag) = moments(&errors);
    assert!((mean - 0.002).abs() < 0.0005, "mean {mean}");
    assert!((0.0027..0.0033).contains(&sigma), "sigma {sigma}");
    assert!(lag.abs() < 0.15, "independent: {lag}");

    d.camera.correlation = Range::exactly(0.8);
    let (_, sigma, lag) = moments(&frame_errors(&d, 4, 4800));
    assert!((0.0022..0.0038).contains(&sigma), "sigma {sigma}");
    assert!((0.7..0.9).contains(&lag), "correlation {lag}");
}

#[test]
fn sensors_of_the_pads_tell_the_force_on_each_and_the_grip_is_their_mean() {
    let mut world = world("arm7");
    world.reset(&EpisodeSetup::sample(TaskKind::Align, &scene(), &canonical(), 5)).expect("reset");
    world.step(&Command::Hold).expect("step");
    let offered = world.spec().sensors.clone();
    let told: Vec<(String, usize)> =
        offered.iter().map(|one| (one.name.to_string(), one.length.try_into().unwrap())).collect();
    let seen = world.observe();
    let read: Vec<(String, usize)> =
        seen.sensors.iter().map(|one| (one.name.to_string(), one.values.len())).collect();
    assert_eq!(read, told);
    assert_eq!(read, [("pad-forces".to_owned(), 2)]);
    let pads = &seen.sensors[0].values;
    assert!(pads.iter().all(|force| *force > 1.0), "it holds the object: {pads:?}");
    assert!((0.5 * (pads[0] + pads[1]) - seen.gripper_force_n).abs() < 1e-9, "{pads:?}");
}

#[test]
fn lost_frames_are_absent_and_late_ones_have_an_age() {
    let mut d = canonical();
    d.camera.drop_probability = Range::exactly(0.3);
    d.camera.delay_ms = Range::exactly(50.0);
    let mut world = world("arm7");
    world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene(), &d, 8)).expect("reset");
    assert!(world.observe().object().is_none() && world.telemetry().picture_age_ticks.is_none());
    let (mut absent, mut youngest, mut oldest) = (0, u32::MAX, 0);
    for _ in 0..2400 {
        world.step(&Command::Hold).expect("step");
        match world.observe().object() {
            Some(estimate) => {
                youngest = youngest.min(estimate.age_ticks);
                oldest = oldest.max(estimate.age_ticks);
            }
            None => absent += 1,
        }
    }
    assert!((480..960).contains(&absent), "{absent} of 2400 ticks without a camera frame");
    assert_eq!((youngest, oldest), (12, 19), "50 ms are 12 ticks, a period is 8");
}

#[test]
fn joint_sensors_have_the_set_noise() {
    let mut d = canonical();
    d.sensors.joint_rad = Range::exactly(0.001);
    let mut world = world("arm7");
    world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene(), &d, 2)).expect("reset");
    let mut errors = Vec::new();
    for _ in 0..600 {
        world.step(&Command::Hold).expect("step");
        let truth = world.truth();
        errors.extend(world.observe().q.iter().zip(&truth.q).map(|(seen, is)| seen - is));
    }
    let (mean, sigma, _) = moments(&errors);
    assert!(mean.abs() < 1e-4 && (0.00095..0.00105).contains(&sigma), "mean {mean}, sigma {sigma}");
}

#[test]
fn commands_arrive_late_and_in_order() {
    let mut d = canonical();
    d.action.latency_ms = Range::exactly(50.0);
    let mut world = world("arm7");
    world.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene(), &d, 2)).expect("reset");
    let start = world.truth().tool;
    let mut goal = start.isometry();
    goal.translation.y += 0.1;
    act(&mut world, &arm(&goal, 0.5), 12);
    assert!(world.truth().tool.distance_m(&start) < 1e-4, "nothing for 12 ticks");
    act(&mut world, &Command::Hold, 30);
    assert!(world.truth().tool.distance_m(&start) > 0.005, "then it moves");
}

#[test]
fn every_drift_changes_the_distribution_and_stronger_changes_it_more() {
    let live = holdpoint_sim::published::live().expect("live");
    for kind in DriftKind::ALL {
        let mut last = 0.0;
        for magnitude in Magnitude::ALL {
            let drifted =
                holdpoint_sim::published::with_drift(&live, &Drift { kind, magnitude }).expect("applies");
            let size = (drifted.camera.sigma_m.max - live.camera.sigma_m.max) * 1e3
                + (drifted.object.mass_kg.max - live.object.mass_kg.max)
                + (drifted.action.latency_ms.max - live.action.latency_ms.max);
            assert!(size > last, "{kind:?} {magnitude:?}");
            assert!(drifted.name.starts_with("live+"), "{}", drifted.name);
            last = size;
        }
    }
}

#[test]
fn live_and_sandbox_distributions_differ_as_published() {
    let (sandbox, live) = (
        holdpoint_sim::published::sandbox().expect("sandbox"),
        holdpoint_sim::published::live().expect("live"),
    );
    assert!(sandbox.action.latency_ms.max <= 20.0 && live.action.latency_ms.min >= 20.0);
    assert!(sandbox.camera.correlation.max == 0.0 && live.camera.correlation.min > 0.0);
    assert!(sandbox.clutter.probability.max == 0.0 && live.clutter.probability.min > 0.0);
    let with_clutter = (0..50)
        .filter(|seed| !EpisodeSetup::sample(TaskKind::Grasp, &scene(), &live, *seed).clutter.is_empty())
        .count();
    assert!(with_clutter > 40, "{with_clutter} of 50");
}
