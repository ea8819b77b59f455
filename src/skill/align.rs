//! `native:align`: carry the held object over the tray, square to it, and hold it there.

use holdpoint_body::{Command, FailureSignal, Observation, Pose, TaskKind};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::motion::{
    AbortStyle, OBJECT_HALF_M, PoseAverage, RollbackStyle, arrived, at_height, holds_something, ticks,
    wrap_quarter, yaw_of,
};
use super::phases::{PhaseFrame, PhaseRun, Phased};

/// The parameters of an align version. Lengths in meters, speeds in m/s.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AlignParams {
    /// Camera frames of the tray averaged before the transit, 1 to 60.
    pub look_pictures: u32,
    /// Tool height of the transit; a lower one than the present height makes the path a diagonal.
    pub transit_height_m: f64,
    /// Tool speed of the transit.
    pub transit_speed_m_s: f64,
    /// Height of the object's center above its seat when aligned.
    pub hover_height_m: f64,
    /// Tool speed of the last part.
    pub lower_speed_m_s: f64,
    /// Camera frames of object and tray averaged for a measurement over the tray; 0 trusts the transit.
    pub measure_pictures: u32,
    /// Largest measured error that is left uncorrected.
    pub tolerance_m: f64,
    /// Most corrections, 0 to 10.
    pub corrections_max: u32,
    /// Share of the measured error that a correction takes out, 0 to 1.5.
    pub correction_gain: f64,
    /// Seconds to come to rest before a measurement.
    pub settle_secs: f64,
    /// Seconds the whole work may take.
    pub timeout_secs: f64,
    /// What the safe-abort hook does.
    pub abort: AbortStyle,
    /// What the rollback hook does.
    pub rollback: RollbackStyle,
    /// Height the hooks rise to.
    pub safe_height_m: f64,
}

/// Its phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlignPhase {
    Look,
    Rise,
    Transit,
    Lower,
    Settle,
    Measure,
}

/// The align controller at work.
#[derive(Clone, Debug)]
pub struct Align {
    params: AlignParams,
    tray: PoseAverage,
    object: PoseAverage,
    /// Seat of the object in the tray: position and heading.
    seat: Option<([f64; 3], f64)>,
    /// Object's pose in the tool's frame, as last measured.
    in_hand: Isometry3<f64>,
    corrections: u32,
}

impl Align {
    /// A controller before its first tick.
    #[must_use]
    pub fn new(params: AlignParams) -> Self {
        Self {
            params,
            tray: PoseAverage::default(),
            object: PoseAverage::default(),
            seat: None,
            in_hand: Isometry3::identity(),
            corrections: 0,
        }
    }

    /// Tool pose that puts the object's center `height_m` above its seat, hand straight down.
    fn tool_over_seat(&self, seen: &Observation, height_m: f64) -> Option<Pose> {
        let ([x, y, z], tray_yaw) = self.seat?;
        let tool_yaw = yaw_of(&seen.tool);
        // The object's heading in the world is the hand's plus what it is turned in the hand.
        let object_yaw = tool_yaw + turned_in_hand(&self.in_hand);
        let yaw = tool_yaw + wrap_quarter(tray_yaw - object_yaw);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let offset = rotation * self.in_hand.translation.vector;
        let place = Translation3::new(x - offset.x, y - offset.y, z + height_m - offset.z);
        Some(Pose::from(&Isometry3::from_parts(place, rotation)))
    }

    fn note_in_hand(&mut self, seen: &Observation) {
        if let Some((position, yaw)) = self.object.mean() {
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
            let object = Isometry3::from_parts(Translation3::from(position), rotation);
            self.in_hand = seen.tool.isometry().inverse() * object;
        }
    }

    fn measure(&mut self, run: &mut PhaseRun<AlignPhase>, seen: &Observation) -> Command {
        let p = self.params.clone();
        if run.tick > ticks(3.0) {
            return run.finish(Some(FailureSignal::TargetNotFound));
        }
        let fresh = |age: u32| u64::from(age) < run.tick;
        if let Some(picture) = seen.target().filter(|picture| fresh(picture.age_ticks)) {
            self.tray.add(picture);
        }
        if let Some(picture) = seen.object().filter(|picture| fresh(picture.age_ticks)) {
            self.object.add(picture);
        }
        if self.tray.count() < p.measure_pictures || self.object.count() < p.measure_pictures {
            return Command::Hold;
        }
        let (Some((seat, seat_yaw)), Some((object, object_yaw))) = (self.tray.mean(), self.object.mean())
        else {
            return run.finish(Some(FailureSignal::TargetNotFound));
        };
        let error = [seat[0] - object[0], seat[1] - object[1]];
        let turn = wrap_quarter(seat_yaw - object_yaw);
        let within = libm::hypot(error[0], error[1]) <= p.tolerance_m && turn.abs() < 0.03;
        if within {
            return run.finish(None);
        }
        if self.corrections >= p.corrections_max {
            // The error is known to be too large: say so rather than pass it on.
            return run.finish(Some(FailureSignal::AlignmentLost));
        }
        self.corrections += 1;
        let mut pose = seen.tool;
        pose.position[0] += p.correction_gain * error[0];
        pose.position[1] += p.correction_gain * error[1];
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), p.correction_gain * turn)
            * seen.tool.isometry().rotation;
        run.target = Pose::from(&Isometry3::from_parts(Translation3::from(pose.position), rotation));
        run.go(AlignPhase::Settle);
        Command::ToolPose { pose: run.target, max_speed_m_s: p.lower_speed_m_s }
    }
}

/// Heading of the object relative to the hand that points down, rad.
fn turned_in_hand(in_hand: &Isometry3<f64>) -> f64 {
    // The hand's z axis points down, so a turn about the world's vertical is seen reversed.
    let x = in_hand.rotation * Vector3::x();
    libm::atan2(-x.y, x.x)
}

impl Phased for Align {
    type Phase = AlignPhase;
    const FIRST: AlignPhase = AlignPhase::Look;

    fn frame(&self) -> PhaseFrame {
        let p = &self.params;
        PhaseFrame {
            timeout_secs: p.timeout_secs,
            abort: p.abort,
            rollback: p.rollback,
            safe_height_m: p.safe_height_m,
            hook_speed_m_s: p.lower_speed_m_s,
        }
    }

    fn work(&mut self, run: &mut PhaseRun<AlignPhase>, seen: &Observation) -> Command {
        let p = self.params.clone();
        if run.tick > 24 && !holds_something(seen) {
            return run.finish(Some(FailureSignal::ObjectSlipped));
        }
        match run.phase {
            AlignPhase::Look => {
                if let Some(picture) = seen.target() {
                    self.tray.add(picture);
                }
                if let Some(picture) = seen.object() {
                    self.object.add(picture);
                }
                let object_seen = p.measure_pictures == 0 || self.object.count() >= p.look_pictures;
                if self.tray.count() >= p.look_pictures && object_seen {
                    self.seat = self.tray.mean().map(|([x, y, z], yaw)| ([x, y, z + OBJECT_HALF_M], yaw));
                    if p.measure_pictures > 0 {
                        self.note_in_hand(seen);
                    }
                    run.go(AlignPhase::Rise);
                } else if run.tick > ticks(2.0) {
                    return run.finish(Some(FailureSignal::TargetNotFound));
                }
                Command::Hold
            }
            AlignPhase::Rise => {
                if run.tick == 1 && seen.tool.position[2] < p.transit_height_m - 0.01 {
                    run.target = at_height(seen.tool, p.transit_height_m);
                    return Command::ToolPose { pose: run.target, max_speed_m_s: p.transit_speed_m_s };
                }
                if run.tick == 1 || arrived(seen, &run.target, 0.01) {
                    run.go(AlignPhase::Transit);
                }
                Command::Hold
            }
            AlignPhase::Transit => {
                if run.tick == 1
                    && let Some(over) = self.tool_over_seat(seen, p.hover_height_m)
                {
                    run.target = at_height(over, p.transit_height_m.max(over.position[2]));
                    return Command::ToolPose { pose: run.target, max_speed_m_s: p.transit_speed_m_s };
                }
                if arrived(seen, &run.target, 0.01) {
                    run.go(AlignPhase::Lower);
                }
                Command::Hold
            }
            AlignPhase::Lower => {
                if run.tick == 1
                    && let Some(over) = self.tool_over_seat(seen, p.hover_height_m)
                {
                    run.target = over;
                    return Command::ToolPose { pose: over, max_speed_m_s: p.lower_speed_m_s };
                }
                if arrived(seen, &run.target, 0.002) {
                    run.go(AlignPhase::Settle);
                }
                Command::Hold
            }
            AlignPhase::Settle => {
                if run.tick >= ticks(p.settle_secs).max(1) {
                    if p.measure_pictures == 0 {
                        return run.finish(None);
                    }
                    self.tray = PoseAverage::default();
                    self.object = PoseAverage::default();
                    run.go(AlignPhase::Measure);
                }
                Command::Hold
            }
            AlignPhase::Measure => self.measure(run, seen),
        }
    }
}

/// The signals this controller's code can raise with these parameters.
#[must_use]
pub fn signals(params: &AlignParams) -> Vec<FailureSignal> {
    let mut signals =
        vec![FailureSignal::TargetNotFound, FailureSignal::ObjectSlipped, FailureSignal::TimedOut];
    if params.measure_pictures > 0 {
        signals.push(FailureSignal::AlignmentLost);
    }
    signals
}

/// The primitive this controller performs.
pub const TASK: TaskKind = TaskKind::Align;

#[cfg(test)]
mod tests {
    use super::super::motion::hand_down;
    use super::*;

    #[test]
    fn the_turn_in_hand_is_what_the_world_sees() {
        // A hand at heading .2 holding a cube at heading .5: the cube is turned .3 in the hand.
        let tool = hand_down([0.5, 0.0, 0.2], 0.2).isometry();
        let cube = Isometry3::from_parts(
            Translation3::new(0.5, 0.0, 0.2),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5),
        );
        assert!((turned_in_hand(&(tool.inverse() * cube)) - 0.3).abs() < 1e-12);
    }
}
