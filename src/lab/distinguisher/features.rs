//! The features of one run: what its observations tell, as numbers with names.
//!
//! They cover the start (joints, poses, grip, the camera frame at hand), the noise of each sensor, the timing of camera
//! frames, and the course of the task. Every run has the same names in the same order.

use holdpoint_body::{Estimate, GuardVerdict, JointVec, Observation, Pose};
use holdpoint_cell::episode::{wrap_quarter_turn, yaw_of};

use super::recording::SeenRun;

pub(super) type NamedFeature = (String, f64);

/// Ticks at the start whose noise is measured: half a second.
const EARLY_TICKS: usize = 120;

/// Measured joint speed from which the arm is in motion, rad/s: three times the largest noise of the sensor.
const MOVING_RAD_S: f64 = 0.05;

/// A camera frame as it arrived.
struct ArrivedFrame {
    tick: u64,
    object: Estimate,
    target: Estimate,
}

/// The features of a run; `None` if it saw nothing.
pub(super) fn of(run: &SeenRun) -> Option<Vec<NamedFeature>> {
    let (first, last) = (run.seen.first()?, run.seen.last()?);
    let frames = arrived_frames(&run.seen);
    let mut found = Vec::new();
    let mut add = |name: &str, value: f64| found.push((name.to_owned(), value));
    start(first, &frames, &mut add);
    noise(run.seen.get(..EARLY_TICKS.min(run.seen.len())).unwrap_or_default(), &mut add);
    camera(&run.seen, &frames, &mut add);
    course(run, last, &frames, &mut add);
    Some(found)
}

fn start(first: &Observation, frames: &[ArrivedFrame], add: &mut dyn FnMut(&str, f64)) {
    add("tick_first", first.tick as f64);
    for (name, values) in [("q", &first.q), ("dq", &first.dq), ("tau", &first.tau)] {
        for (joint, value) in values.iter().enumerate() {
            add(&format!("{name}{}_first", joint + 1), *value);
        }
    }
    pose("tool", &first.tool, add);
    add("tool_speed_first", first.tool_twist.speed_m_s());
    add("width_first", first.gripper_width_m);
    add("grip_first", first.gripper_force_n);
    add("wrist_first", first.wrist_force_n);
    add("tool_available_first", flag(first.tool_available));
    add("guard_first", flag(first.guard != GuardVerdict::Allowed));
    add("object_seen_first", flag(first.object().is_some()));
    add("target_seen_first", flag(first.target().is_some()));
    add("frame_first", first.object().map_or(0.0, |seen| f64::from(seen.sequence)));
    add("frame_age_first", first.object().map_or(0.0, |seen| f64::from(seen.age_ticks)));
    // Without an estimate at the start, the first one counts.
    let frame = frames.first();
    let object = frame.map_or(Pose::IDENTITY, |frame| frame.object.pose);
    let target = frame.map_or(Pose::IDENTITY, |frame| frame.target.pose);
    pose("object", &object, add);
    pose("target", &target, add);
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        add(&format!("object_in_tool_{name}_first"), object.position[axis] - first.tool.position[axis]);
        add(&format!("object_to_target_{name}_first"), target.position[axis] - object.position[axis]);
    }
}

fn pose(what: &str, pose: &Pose, add: &mut dyn FnMut(&str, f64)) {
    let [x, y, z] = pose.position;
    for (name, value) in [("x", x), ("y", y), ("z", z), ("yaw", yaw(pose))] {
        add(&format!("{what}_{name}_first"), value);
    }
}

/// The noise of each sensor while the task begins.
fn noise(early: &[Observation], add: &mut dyn FnMut(&str, f64)) {
    add("q_noise", joint_noise(early, |seen| &seen.q));
    add("dq_noise", joint_noise(early, |seen| &seen.dq));
    add("tau_noise", joint_noise(early, |seen| &seen.tau));
    add("width_noise", roughness(early.iter().map(|seen| seen.gripper_width_m)));
    add("grip_noise", roughness(early.iter().map(|seen| seen.gripper_force_n)));
    add("wrist_noise", roughness(early.iter().map(|seen| seen.wrist_force_n)));
}

/// One number of a pose.
type PoseValue = fn(&Pose) -> f64;

/// The timing of camera frames, and the noise of what stands still in them: the tray.
fn camera(seen: &[Observation], frames: &[ArrivedFrame], add: &mut dyn FnMut(&str, f64)) {
    let ticks = seen.len() as f64;
    let lost = seen.iter().filter(|seen| seen.target().is_none()).count() as f64;
    let ages: Vec<f64> = frames.iter().map(|frame| f64::from(frame.target.age_ticks)).collect();
    let pairs = || frames.iter().zip(frames.iter().skip(1));
    let gaps: Vec<f64> = pairs().map(|(one, next)| next.tick as f64 - one.tick as f64).collect();
    let skipped: Vec<f64> = pairs()
        .map(|(one, next)| f64::from(next.target.sequence) - f64::from(one.target.sequence) - 1.0)
        .collect();
    add("frame_rate", frames.len() as f64 / ticks);
    add("frames_lost", lost / ticks);
    add("frames_skipped", mean(&skipped));
    add("frame_age_mean", mean(&ages));
    add("frame_age_sd", deviation(&ages));
    add("frame_age_min", ages.iter().copied().reduce(f64::min).unwrap_or_default());
    add("frame_age_max", ages.iter().copied().reduce(f64::max).unwrap_or_default());
    add("frame_gap_mean", mean(&gaps));
    add("frame_gap_sd", deviation(&gaps));
    add("frame_first_tick", frames.first().map_or(ticks, |frame| frame.tick as f64));
    let of_target: [(&str, PoseValue); 4] = [
        ("x", |pose| pose.position[0]),
        ("y", |pose| pose.position[1]),
        ("z", |pose| pose.position[2]),
        ("yaw", yaw),
    ];
    for (name, value) in of_target {
        let values: Vec<f64> = frames.iter().map(|frame| value(&frame.target.pose)).collect();
        add(&format!("target_{name}_sd"), deviation(&values));
        add(&format!("target_{name}_lag1"), lag_correlation(&values));
    }
}

/// How the task went, as the version noticed it.
fn course(run: &SeenRun, last: &Observation, frames: &[ArrivedFrame], add: &mut dyn FnMut(&str, f64)) {
    let seen = &run.seen;
    let ticks = seen.len() as f64;
    let share =
        |is: &dyn Fn(&Observation) -> bool| seen.iter().filter(|seen| is(seen)).count() as f64 / ticks;
    let largest = |of: &dyn Fn(&Observation) -> f64| seen.iter().map(of).fold(0.0, f64::max);
    let in_motion = seen.iter().find(|seen| seen.dq.iter().any(|speed| speed.abs() > MOVING_RAD_S));
    let motion_tick = in_motion.map_or(ticks, |seen| seen.tick as f64);
    let commanded = run.first_motion_command.map_or(ticks, |tick| tick as f64);
    let moved = match (frames.first(), frames.last()) {
        (Some(first), Some(last)) => first.object.pose.distance_m(&last.object.pose),
        _ => 0.0,
    };
    add("ticks", ticks);
    add("motion_tick", motion_tick);
    add("motion_response", motion_tick - commanded);
    add("tool_speed_mean", seen.iter().map(|seen| seen.tool_twist.speed_m_s()).sum::<f64>() / ticks);
    add("tool_speed_max", largest(&|seen| seen.tool_twist.speed_m_s()));
    add("grip_max", largest(&|seen| seen.gripper_force_n));
    add("wrist_max", largest(&|seen| seen.wrist_force_n));
    add("width_last", last.gripper_width_m);
    add("tool_unavailable", share(&|seen| !seen.tool_available));
    add("guard_clamped", share(&|seen| seen.guard == GuardVerdict::Clamped));
    add("guard_denied", share(&|seen| seen.guard == GuardVerdict::Denied));
    add("object_moved", moved);
}

/// Each camera frame at the tick at which it was first seen.
fn arrived_frames(seen: &[Observation]) -> Vec<ArrivedFrame> {
    let mut frames: Vec<ArrivedFrame> = Vec::new();
    for seen in seen {
        let (Some(object), Some(target)) = (seen.object().copied(), seen.target().copied()) else { continue };
        if frames.last().is_none_or(|last| last.target.sequence != target.sequence) {
            frames.push(ArrivedFrame { tick: seen.tick, object, target });
        }
    }
    frames
}

/// Yaw of an object with four equal sides, rad.
fn yaw(pose: &Pose) -> f64 {
    wrap_quarter_turn(yaw_of(&pose.isometry()))
}

const fn flag(is: bool) -> f64 {
    if is { 1.0 } else { 0.0 }
}

/// Mean noise of the joints.
fn joint_noise(early: &[Observation], of: fn(&Observation) -> &JointVec) -> f64 {
    let joints = early.first().map_or(0, |seen| of(seen).len());
    let each: Vec<f64> = (0..joints)
        .map(|joint| roughness(early.iter().filter_map(|seen| of(seen).get(joint).copied())))
        .collect();
    mean(&each)
}

/// Standard deviation of independent noise on a smooth course, from second differences.
fn roughness(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    let squares: Vec<f64> = values
        .windows(3)
        .filter_map(|three| match three {
            [one, two, three] => Some((one - 2.0 * two + three).powi(2)),
            _ => None,
        })
        .collect();
    (mean(&squares) / 6.0).sqrt()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn deviation(values: &[f64]) -> f64 {
    let centre = mean(values);
    let squares: Vec<f64> = values.iter().map(|value| (value - centre).powi(2)).collect();
    mean(&squares).sqrt()
}

/// Correlation of each value with the next; 0 where they do not vary.
fn lag_correlation(values: &[f64]) -> f64 {
    let (centre, spread) = (mean(values), deviation(values).powi(2));
    let products: Vec<f64> = values
        .iter()
        .zip(values.iter().skip(1))
        .map(|(one, next)| (one - centre) * (next - centre))
        .collect();
    if spread > 0.0 { mean(&products) / spread } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_cell::rng::{Stream, StreamPurpose};

    #[test]
    fn roughness_is_the_noise_and_not_the_course() {
        let mut stream = Stream::new(1, StreamPurpose::Sensors);
        let course = |tick: u32| 0.3 * f64::from(tick) + 0.001 * f64::from(tick * tick);
        assert!(roughness((0..200).map(course)) < 0.001);
        let noisy: Vec<f64> = (0..4_000).map(|tick| 0.01 * f64::from(tick) + 0.5 * stream.normal()).collect();
        let found = roughness(noisy.into_iter());
        assert!((found - 0.5).abs() < 0.03, "{found}");
        assert_eq!(roughness([1.0, 2.0].into_iter()), 0.0);
    }

    #[test]
    fn correlation_of_frames_is_that_of_the_noise() {
        let mut stream = Stream::new(2, StreamPurpose::Picture);
        let mut value = 0.0;
        let mut next = |correlation: f64| {
            value = correlation * value + stream.normal();
            value
        };
        let correlated: Vec<f64> = (0..4_000).map(|_| next(0.5)).collect();
        let independent: Vec<f64> = (0..4_000).map(|_| next(0.0)).collect();
        assert!((lag_correlation(&correlated) - 0.5).abs() < 0.06, "{}", lag_correlation(&correlated));
        assert!(lag_correlation(&independent).abs() < 0.06, "{}", lag_correlation(&independent));
        assert_eq!(lag_correlation(&[2.0, 2.0, 2.0]), 0.0);
        assert_eq!((mean(&[]), deviation(&[])), (0.0, 0.0));
    }

    #[test]
    fn run_that_saw_nothing_has_no_features() {
        assert_eq!(of(&SeenRun::default()), None);
    }
}
