//! `native:grasp`: look, approach from above, check, close, lift, verify.

use holdpoint_body::{Command, FailureSignal, Observation, Pose, TaskKind};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::motion::{
    AbortStyle, PoseAverage, RollbackStyle, arrived, at_height, hand_down, holds_something, ticks,
    wrap_quarter, yaw_of,
};
use super::phases::{PhaseFrame, PhaseRun, Phased};

/// The parameters of a grasp version. Lengths in meters, speeds in m/s.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspParams {
    /// Camera frames of the object averaged before the approach, 1 to 60.
    pub look_pictures: u32,
    /// Height of the pre-grasp pose above the object's center.
    pub approach_height_m: f64,
    /// Tool speed of the approach.
    pub approach_speed_m_s: f64,
    /// Distance on the tray side (+y) of the object at which the hand descends to the approach height before it moves
    /// over the object; 0 comes straight. Shortens the path of an arm that comes from the tray, low over obstacles.
    pub entry_offset_m: f64,
    /// Follow the object with new camera frames during the approach and the descent.
    pub track: bool,
    /// Look again at the pre-grasp pose and go back if the object has moved.
    pub pregrasp_check: bool,
    /// How far the object may have moved at the check.
    pub pregrasp_tolerance_m: f64,
    /// Tool speed of the descent.
    pub descend_speed_m_s: f64,
    /// Tool speed of its last part, in which the pads may meet the object; the descent's if that is slower.
    pub contact_speed_m_s: f64,
    /// Force on wrist or pads in the descent that makes the hand stop and back off, N.
    pub contact_stop_n: f64,
    /// Height of the pads above the object's center when they close.
    pub grasp_offset_m: f64,
    /// Closing speed of the pad distance.
    pub close_speed_m_s: f64,
    /// Force per finger, N.
    pub grip_force_n: f64,
    /// Seconds from the command that closes the fingers until the lift, at least.
    pub settle_secs: f64,
    /// How far the tool rises.
    pub lift_height_m: f64,
    /// Tool speed of the lift.
    pub lift_speed_m_s: f64,
    /// After the lift, look whether the object is in the hand.
    pub slip_check: bool,
    /// New attempts after a miss, 0 to 5.
    pub retries_max: u32,
    /// Seconds to wait for a gripper that does not answer.
    pub tool_wait_secs: f64,
    /// Seconds the whole work may take.
    pub timeout_secs: f64,
    /// What the safe-abort hook does.
    pub abort: AbortStyle,
    /// What the rollback hook does.
    pub rollback: RollbackStyle,
    /// Height the hooks rise to.
    pub safe_height_m: f64,
}

/// Height of the tool above the object's center at which the pads' tips reach the object's top, m.
const TOUCH_HEIGHT_M: f64 = 0.033;
/// What the object's height is uncertain by, with room to spare, m.
const TOUCH_MARGIN_M: f64 = 0.008;
/// Time from a decision until the hand goes slower: latency and braking, s.
const REACTION_SECS: f64 = 0.1;

/// Its phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GraspPhase {
    Rise,
    Open,
    Look,
    Enter,
    Approach,
    Check,
    Descend,
    Close,
    Lift,
    Verify,
}

/// The grasp controller at work.
#[derive(Clone, Debug)]
pub struct Grasp {
    params: GraspParams,
    look: PoseAverage,
    check: PoseAverage,
    /// Where the object is believed to be: position and heading.
    object: Option<([f64; 3], f64)>,
    speed_m_s: f64,
    retries: u32,
}

impl Grasp {
    /// A controller before its first tick.
    #[must_use]
    pub fn new(params: GraspParams) -> Self {
        Self {
            params,
            look: PoseAverage::default(),
            check: PoseAverage::default(),
            object: None,
            speed_m_s: 0.0,
            retries: 0,
        }
    }

    /// Sends a pose once per phase, or again if it moved by more than half a millimeter or the speed is
    /// another.
    fn move_to(&mut self, run: &mut PhaseRun<GraspPhase>, pose: Pose, max_speed_m_s: f64) -> Command {
        if run.commanded && pose.distance_m(&run.target) < 5e-4 && max_speed_m_s == self.speed_m_s {
            return Command::Hold;
        }
        run.commanded = true;
        run.target = pose;
        self.speed_m_s = max_speed_m_s;
        Command::ToolPose { pose, max_speed_m_s }
    }

    /// Tool pose above the object. The heading is reduced by the object's symmetry, so that the
    /// wrist never turns further than an eighth of a turn.
    fn above(&self, height_m: f64) -> Option<Pose> {
        let ([x, y, z], yaw) = self.object?;
        Some(hand_down([x, y, z + height_m], wrap_quarter(yaw)))
    }

    /// Fast through the air, slow where the pads may come down on the object: a hand that meets it at
    /// 0.12 m/s presses with 80 N before anything can answer.
    fn descent_speed_m_s(&self, seen: &Observation) -> f64 {
        let p = &self.params;
        let slow_below_m = TOUCH_HEIGHT_M + TOUCH_MARGIN_M + p.descend_speed_m_s * REACTION_SECS;
        let height_m = self.object.map_or(0.0, |([_, _, z], _)| seen.tool.position[2] - z);
        if height_m > slow_below_m {
            p.descend_speed_m_s
        } else {
            p.contact_speed_m_s.min(p.descend_speed_m_s)
        }
    }

    fn retry(&mut self, run: &mut PhaseRun<GraspPhase>, signal: FailureSignal) -> Command {
        if self.retries >= self.params.retries_max {
            run.finish(Some(signal));
            return Command::Stop;
        }
        self.retries += 1;
        self.look = PoseAverage::default();
        self.check = PoseAverage::default();
        run.go(GraspPhase::Open);
        Command::Hold
    }

    fn follow(&mut self, seen: &Observation) {
        if let (true, Some(picture), Some((position, _))) = (self.params.track, seen.object(), self.object) {
            let moved =
                libm::hypot(picture.pose.position[0] - position[0], picture.pose.position[1] - position[1]);
            if self.check.add(picture) && moved > self.params.pregrasp_tolerance_m {
                self.object = Some((
                    [picture.pose.position[0], picture.pose.position[1], position[2]],
                    yaw_of(&picture.pose),
                ));
            } else if let (true, Some((mean, mean_yaw))) = (self.check.count() >= 4, self.check.mean()) {
                self.object = Some(([mean[0], mean[1], position[2]], mean_yaw));
                self.check = PoseAverage::default();
            }
        }
    }

    fn open(&mut self, run: &mut PhaseRun<GraspPhase>, seen: &Observation) -> Command {
        if !seen.tool_available {
            return self.wait_for_tool(run);
        }
        if run.tick == 1 || !run.commanded {
            run.commanded = true;
            return Command::Gripper { width_m: 0.08, speed_m_s: 0.2, force_n: self.params.grip_force_n };
        }
        // After a miss the hand goes up before it looks again.
        let low = seen.tool.position[2] < 0.025 + 0.6 * self.params.approach_height_m;
        if seen.gripper_width_m > 0.07 && low {
            let up = at_height(seen.tool, 0.025 + self.params.approach_height_m);
            if run.target.distance_m(&up) > 0.02 {
                run.target = up;
                return Command::ToolPose { pose: up, max_speed_m_s: self.params.lift_speed_m_s };
            }
        }
        if seen.gripper_width_m > 0.07 && !low {
            run.go(GraspPhase::Look);
        } else if run.tick > ticks(3.0) {
            return self.retry(run, FailureSignal::ToolUnavailable);
        }
        Command::Hold
    }

    fn wait_for_tool(&self, run: &mut PhaseRun<GraspPhase>) -> Command {
        if run.tick > ticks(self.params.tool_wait_secs) {
            run.finish(Some(FailureSignal::ToolUnavailable));
        }
        Command::Hold
    }

    fn close(&mut self, run: &mut PhaseRun<GraspPhase>, seen: &Observation) -> Command {
        if !run.commanded {
            if !seen.tool_available {
                return self.wait_for_tool(run);
            }
            run.commanded = true;
            run.tick = 0;
            let p = &self.params;
            return Command::Gripper { width_m: 0.0, speed_m_s: p.close_speed_m_s, force_n: p.grip_force_n };
        }
        let closing_secs = 0.1 / self.params.close_speed_m_s;
        let gripped = holds_something(seen) && seen.gripper_force_n > 0.5 * self.params.grip_force_n;
        if gripped && run.tick > ticks(self.params.settle_secs) {
            run.go(GraspPhase::Lift);
        } else if run.tick > ticks(closing_secs + self.params.settle_secs + 0.3) {
            if holds_something(seen) {
                run.go(GraspPhase::Lift);
            } else {
                return self.retry(run, FailureSignal::GraspMissed);
            }
        }
        Command::Hold
    }

    fn verify(&mut self, run: &mut PhaseRun<GraspPhase>, seen: &Observation) -> Command {
        if !holds_something(seen) {
            return self.retry(run, FailureSignal::ObjectSlipped);
        }
        if !self.params.slip_check {
            run.finish(None);
            return Command::Hold;
        }
        if let Some(picture) = seen.object()
            && picture.age_ticks < run.tick.try_into().unwrap_or(u32::MAX)
        {
            self.check.add(picture);
        }
        if self.check.count() >= 2 {
            let near = self.check.mean().is_some_and(|(mean, _)| {
                let tool = seen.tool.position;
                libm::hypot(mean[0] - tool[0], mean[1] - tool[1]) < 0.03 && (mean[2] - tool[2]).abs() < 0.04
            });
            if !near {
                return self.retry(run, FailureSignal::ObjectSlipped);
            }
            run.finish(None);
        } else if run.tick > ticks(0.6) {
            run.finish(None);
        }
        Command::Hold
    }
}

impl Phased for Grasp {
    type Phase = GraspPhase;
    const FIRST: GraspPhase = GraspPhase::Rise;

    fn frame(&self) -> PhaseFrame {
        let p = &self.params;
        PhaseFrame {
            timeout_secs: p.timeout_secs,
            abort: p.abort,
            rollback: p.rollback,
            safe_height_m: p.safe_height_m,
            hook_speed_m_s: p.lift_speed_m_s,
        }
    }

    fn work(&mut self, run: &mut PhaseRun<GraspPhase>, seen: &Observation) -> Command {
        let p = self.params.clone();
        match run.phase {
            GraspPhase::Rise => {
                if holds_something(seen) && seen.tool.position[2] > 0.05 {
                    // Taken over with the object already in the hand: only the lift is left.
                    run.go(GraspPhase::Lift);
                    return Command::Hold;
                }
                let clear_m = 0.025 + p.approach_height_m.min(0.08);
                if seen.tool.position[2] >= clear_m {
                    run.go(GraspPhase::Open);
                    return Command::Hold;
                }
                let up = at_height(seen.tool, clear_m + 0.01);
                if run.commanded { Command::Hold } else { self.move_to(run, up, p.lift_speed_m_s) }
            }
            GraspPhase::Open => self.open(run, seen),
            GraspPhase::Look => {
                if let Some(picture) = seen.object() {
                    self.look.add(picture);
                }
                if self.look.count() >= p.look_pictures {
                    self.object = self.look.mean();
                    self.check = PoseAverage::default();
                    run.go(if p.entry_offset_m > 0.0 { GraspPhase::Enter } else { GraspPhase::Approach });
                } else if run.tick > ticks(1.5) {
                    return self.retry(run, FailureSignal::TargetNotFound);
                }
                Command::Hold
            }
            GraspPhase::Enter => {
                let Some(mut pose) = self.above(p.approach_height_m) else {
                    return self.retry(run, FailureSignal::TargetNotFound);
                };
                pose.position[1] += p.entry_offset_m;
                if arrived(seen, &pose, 0.01) {
                    run.go(GraspPhase::Approach);
                    return Command::Hold;
                }
                self.move_to(run, pose, p.approach_speed_m_s)
            }
            GraspPhase::Approach => {
                self.follow(seen);
                let Some(pose) = self.above(p.approach_height_m) else {
                    return self.retry(run, FailureSignal::TargetNotFound);
                };
                if arrived(seen, &pose, 0.004) {
                    self.check = PoseAverage::default();
                    run.go(if p.pregrasp_check { GraspPhase::Check } else { GraspPhase::Descend });
                    return Command::Hold;
                }
                self.move_to(run, pose, p.approach_speed_m_s)
            }
            GraspPhase::Check => {
                if let Some(picture) = seen.object() {
                    self.check.add(picture);
                }
                if self.check.count() >= 3
                    && let (Some((mean, yaw)), Some((position, _))) = (self.check.mean(), self.object)
                {
                    let moved = libm::hypot(mean[0] - position[0], mean[1] - position[1]);
                    if moved > p.pregrasp_tolerance_m {
                        self.object = Some((mean, yaw));
                        self.check = PoseAverage::default();
                        run.go(GraspPhase::Approach);
                    } else {
                        self.check = PoseAverage::default();
                        run.go(GraspPhase::Descend);
                    }
                } else if run.tick > ticks(1.0) {
                    return self.retry(run, FailureSignal::TargetNotFound);
                }
                Command::Hold
            }
            GraspPhase::Descend => {
                self.follow(seen);
                if run.tick > 12 && seen.wrist_force_n.max(seen.gripper_force_n) > p.contact_stop_n {
                    // The pads stand on something: the object is not where it was believed to be.
                    self.retry(run, FailureSignal::UnexpectedContact);
                    run.target = at_height(seen.tool, seen.tool.position[2] + p.approach_height_m);
                    return Command::ToolPose { pose: run.target, max_speed_m_s: p.lift_speed_m_s };
                }
                let Some(pose) = self.above(p.grasp_offset_m) else {
                    return self.retry(run, FailureSignal::TargetNotFound);
                };
                if arrived(seen, &pose, 0.004) {
                    run.go(GraspPhase::Close);
                    return Command::Hold;
                }
                self.move_to(run, pose, self.descent_speed_m_s(seen))
            }
            GraspPhase::Close => self.close(run, seen),
            GraspPhase::Lift => {
                if run.tick == 1 {
                    run.target = at_height(seen.tool, seen.tool.position[2] + p.lift_height_m);
                    return Command::ToolPose { pose: run.target, max_speed_m_s: p.lift_speed_m_s };
                }
                if run.tick > 12 && !holds_something(seen) {
                    return self.retry(run, FailureSignal::ObjectSlipped);
                }
                if arrived(seen, &run.target, 0.006) {
                    self.check = PoseAverage::default();
                    run.go(GraspPhase::Verify);
                }
                Command::Hold
            }
            GraspPhase::Verify => self.verify(run, seen),
        }
    }
}

/// The signals this controller's code can raise with these parameters.
#[must_use]
pub fn signals(_: &GraspParams) -> Vec<FailureSignal> {
    vec![
        FailureSignal::TargetNotFound,
        FailureSignal::GraspMissed,
        FailureSignal::ObjectSlipped,
        FailureSignal::UnexpectedContact,
        FailureSignal::ToolUnavailable,
        FailureSignal::TimedOut,
    ]
}

/// The primitive this controller performs.
pub const TASK: TaskKind = TaskKind::Grasp;
