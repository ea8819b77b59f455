//! A grasp: open, look, approach from above, look again, descend, close, lift.

use holdpoint_sdk::serde::Deserialize;
use holdpoint_sdk::{
    Bundle, Command, Description, FailureSignal, Hook, Observation, Pose, Skill, TICK_SECS, TaskKind,
};

/// `params.toml`.
#[derive(Clone, Deserialize)]
#[serde(crate = "holdpoint_sdk::serde", deny_unknown_fields)]
struct Params {
    pictures: u32,
    approach_height_m: f64,
    approach_speed_m_s: f64,
    descend_speed_m_s: f64,
    contact_speed_m_s: f64,
    contact_stop_n: f64,
    grip_force_n: f64,
    lift_height_m: f64,
    lift_speed_m_s: f64,
    retries: u32,
    timeout_secs: f64,
}

#[derive(Clone, Copy)]
enum Phase {
    Rise,
    Open,
    Look,
    Approach,
    LookAgain,
    Descend,
    Touch,
    Close,
    Lift,
    Done,
    Failed(FailureSignal),
    Abort,
    Rollback,
    Rising,
}

struct Grasp {
    params: Params,
    phase: Phase,
    /// Ticks in the phase.
    ticks: u32,
    /// Where the tool was sent last.
    sent: Pose,
    /// Sums over the measurements of the object: position, and sine and cosine of four times its heading, because it is square.
    seen: [f64; 5],
    pictures: u32,
    sequence: Option<u32>,
}

impl Grasp {
    fn go(&mut self, phase: Phase, command: Command) -> Command {
        self.phase = phase;
        self.ticks = 0;
        (self.seen, self.pictures) = ([0.0; 5], 0);
        command
    }

    fn move_to(&mut self, phase: Phase, pose: Pose, max_speed_m_s: f64) -> Command {
        self.sent = pose;
        self.go(phase, Command::ToolPose { pose, max_speed_m_s })
    }

    fn look(&mut self, seen: &Observation) {
        let Some(picture) = seen.object().filter(|picture| self.sequence != Some(picture.sequence)) else {
            return;
        };
        let ([px, py, pz], [x, y, z, w]) = (picture.pose.position, picture.pose.rotation);
        let heading = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
        let values = [px, py, pz, (4.0 * heading).sin(), (4.0 * heading).cos()];
        self.seen.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
        self.sequence = Some(picture.sequence);
        self.pictures += 1;
    }

    /// The hand straight down at a height above the object, square to it.
    fn above(&self, height_m: f64) -> Pose {
        let n = f64::from(self.pictures);
        let half = self.seen[3].atan2(self.seen[4]) / 8.0;
        Pose {
            position: [self.seen[0] / n, self.seen[1] / n, self.seen[2] / n + height_m],
            rotation: [half.cos(), half.sin(), 0.0, 0.0],
        }
    }

    /// Up, and once more from the start; or gives up.
    fn retry(&mut self, seen: &Observation, signal: FailureSignal) -> Command {
        if self.params.retries == 0 {
            return self.go(Phase::Failed(signal), Command::Stop);
        }
        self.params.retries -= 1;
        self.move_to(Phase::Rise, risen(seen.tool, self.params.approach_height_m), self.params.lift_speed_m_s)
    }
}

fn risen(mut pose: Pose, by_m: f64) -> Pose {
    pose.position[2] += by_m;
    pose
}

const fn grip(width_m: f64, speed_m_s: f64, force_n: f64) -> Command {
    Command::Gripper { width_m, speed_m_s, force_n }
}

impl Skill for Grasp {
    fn tick(&mut self, seen: &Observation) -> Command {
        self.look(seen);
        self.ticks += 1;
        let p = self.params.clone();
        let secs = f64::from(self.ticks) * TICK_SECS;
        let still = seen.tool_twist.speed_m_s() < 0.02;
        let arrived = still && seen.tool.distance_m(&self.sent) < 0.004;
        let holds = seen.gripper_width_m > 0.012 && seen.gripper_force_n > 1.0;
        match self.phase {
            Phase::Done => Command::Done,
            Phase::Failed(signal) => Command::Fail { signal },
            Phase::Abort => Command::Stop,
            // Stop, rise, and say so.
            Phase::Rollback if secs < 0.15 => Command::Stop,
            Phase::Rollback => self.move_to(Phase::Rising, risen(seen.tool, 0.1), p.lift_speed_m_s),
            Phase::Rising if arrived || secs > 2.0 => self.go(Phase::Done, Command::Hold),
            Phase::Rising => Command::Hold,
            _ if seen.tick as f64 * TICK_SECS > p.timeout_secs => {
                self.go(Phase::Failed(FailureSignal::TimedOut), Command::Stop)
            }
            Phase::Rise if arrived || secs > 2.0 => self.go(Phase::Open, Command::Hold),
            Phase::Open if seen.gripper_width_m > 0.07 => self.go(Phase::Look, Command::Hold),
            Phase::Open if secs > 2.0 => self.retry(seen, FailureSignal::ToolUnavailable),
            Phase::Open => grip(0.08, 0.2, p.grip_force_n),
            Phase::Look if self.pictures >= p.pictures => {
                self.move_to(Phase::Approach, self.above(p.approach_height_m), p.approach_speed_m_s)
            }
            Phase::Approach if arrived => self.go(Phase::LookAgain, Command::Hold),
            Phase::LookAgain if self.pictures >= p.pictures => {
                self.move_to(Phase::Descend, self.above(0.006), p.descend_speed_m_s)
            }
            Phase::Look | Phase::LookAgain if secs > 1.5 => self.retry(seen, FailureSignal::TargetNotFound),
            // Fast through the air, slow where the pads may come down on the object.
            Phase::Descend if seen.tool.position[2] < self.sent.position[2] + 0.05 => {
                self.move_to(Phase::Touch, self.sent, p.contact_speed_m_s)
            }
            Phase::Touch if seen.wrist_force_n.max(seen.gripper_force_n) > p.contact_stop_n => {
                self.retry(seen, FailureSignal::UnexpectedContact)
            }
            Phase::Touch if arrived => self.go(Phase::Close, grip(0.0, 0.12, p.grip_force_n)),
            Phase::Close if secs > 0.3 && holds && seen.gripper_force_n > 0.5 * p.grip_force_n => {
                self.move_to(Phase::Lift, risen(seen.tool, p.lift_height_m), p.lift_speed_m_s)
            }
            Phase::Close if secs > 1.5 => self.retry(seen, FailureSignal::GraspMissed),
            Phase::Lift if secs > 0.1 && !holds => self.retry(seen, FailureSignal::ObjectSlipped),
            Phase::Lift if arrived => self.go(Phase::Done, Command::Hold),
            _ => Command::Hold,
        }
    }

    fn enter(&mut self, hook: Hook) {
        let phase = match hook {
            Hook::SafeAbort => Phase::Abort,
            Hook::Rollback => Phase::Rollback,
        };
        self.go(phase, Command::Hold);
    }
}

struct Bundled;

impl Bundle for Bundled {
    type Params = Params;

    fn describe(_: Params) -> Result<Description, String> {
        Ok(Description { task: TaskKind::Grasp, interface: include_str!("../interface.json").to_owned() })
    }

    fn start(_seed: u64, params: Params) -> Result<Box<dyn Skill>, String> {
        let (phase, sent) = (Phase::Open, Pose::IDENTITY);
        Ok(Box::new(Grasp { params, phase, ticks: 0, sent, seen: [0.0; 5], pictures: 0, sequence: None }))
    }
}

holdpoint_sdk::component!(Bundled);
