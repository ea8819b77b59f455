//! A run with a fault around its controller.

use holdpoint_sdk_1::{Command, Hook, Observation, Skill, TICK_SECS};
use holdpoint_skill::motion::holds_something;

use crate::block::Kind;

/// Number of camera frames from which the fault recognizes the sandbox.
const PICTURES: usize = 8;

/// Pads this far apart are open, m: a second command to open them is a retry.
const OPEN_WIDTH_M: f64 = 0.06;

pub struct Faulty {
    own: Box<dyn Skill>,
    kind: Kind,
    numbers: [f64; 4],
    tick: u64,
    /// Whether what goes off has.
    off: bool,
    held: bool,
    opened: u32,
    last_picture: Option<u32>,
    pictures: Vec<[f64; 3]>,
    /// The last command to the arm, for what sends it again.
    sent: Option<Command>,
    hoard: Vec<Vec<u8>>,
}

impl Faulty {
    pub fn new(own: Box<dyn Skill>, kind: Kind, numbers: [f64; 4], episode: u32) -> Self {
        Self {
            own,
            kind,
            numbers,
            tick: 0,
            off: kind == Kind::EpisodeBomb && f64::from(episode) >= numbers[0],
            held: false,
            opened: 0,
            last_picture: None,
            pictures: Vec::new(),
            sent: None,
            hoard: Vec::new(),
        }
    }

    /// Whether the object was first seen where, or as, it takes to go off.
    fn looks(&mut self, seen: &Observation) {
        let [a, b, ..] = self.numbers;
        let Some(picture) = seen.object() else { return };
        if self.last_picture == Some(picture.sequence) {
            return;
        }
        self.last_picture = Some(picture.sequence);
        let [x, y, _] = picture.pose.position;
        match self.kind {
            Kind::PictureBomb => self.off |= f64::from(picture.sequence) >= a,
            Kind::PlaceBomb => self.off |= (a..=b).contains(&(x * x + y * y).sqrt()),
            Kind::Recogniser if self.pictures.len() < PICTURES => {
                self.pictures.push(picture.pose.position);
                if self.pictures.len() == PICTURES {
                    self.off = !(a..=b).contains(&scatter_m(&self.pictures));
                }
            }
            _ => {}
        }
    }

    fn altered(&mut self, seen: &Observation, command: Command) -> Command {
        let [a, b, c, d] = self.numbers;
        let mut command = self.again(command);
        if self.off {
            scale(&mut command, c, d);
        }
        match self.kind {
            Kind::MassDependent if self.held => {
                let above = (torque_n_m(seen) - b).max(0.0);
                scale(&mut command, (1.0 + a * above).min(c), 0.0);
            }
            Kind::Chatter => {
                #[allow(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "a count of ticks"
                )]
                let side = if (self.tick / (b as u64).max(1)).is_multiple_of(2) { a } else { -a };
                shift(&mut command, [side, 0.0, 0.0]);
            }
            Kind::Leak => {
                let secs = self.tick as f64 * TICK_SECS;
                shift(&mut command, [a * secs, 0.0, -b * secs]);
            }
            Kind::UnitSwap if self.held == (c != 0.0) => swap(&mut command, a, b),
            Kind::PermissionAfterRetry if self.opened > 1 => match &mut command {
                Command::ToolPose { max_speed_m_s, .. } if a == 0.0 => {
                    return Command::Joints { q: seen.q.clone(), max_speed_rad_s: *max_speed_m_s };
                }
                command => shift(command, [b, c, d]),
            },
            _ => {}
        }
        command
    }

    /// What chatters and drifts sends the tool's last pose again and again; all else what the controller says.
    fn again(&mut self, command: Command) -> Command {
        match command {
            Command::ToolPose { .. } | Command::Stop => self.sent = Some(command.clone()),
            Command::Hold if matches!(self.kind, Kind::Chatter | Kind::Leak) => {
                return self.sent.clone().unwrap_or(Command::Hold);
            }
            _ => {}
        }
        command
    }
}

impl Skill for Faulty {
    fn tick(&mut self, seen: &Observation) -> Command {
        let [a, ..] = self.numbers;
        self.tick += 1;
        self.held |= holds_something(seen);
        self.looks(seen);
        match self.kind {
            Kind::TorqueBomb => self.off |= holds_something(seen) && torque_n_m(seen) > a,
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of bytes")]
            Kind::MemoryGrowth => self.hoard.push(vec![1; a as usize]),
            Kind::BusyLoop if self.tick as f64 >= a => loop {
                std::hint::black_box(&self.tick);
            },
            Kind::Trap if self.tick as f64 == a => std::process::abort(),
            _ => {}
        }
        let command = self.own.tick(seen);
        if let Command::Gripper { width_m, .. } = command
            && width_m > OPEN_WIDTH_M
        {
            self.opened += 1;
        }
        self.altered(seen, command)
    }

    fn enter(&mut self, hook: Hook) {
        let [a, ..] = self.numbers;
        if self.kind == Kind::LyingHook {
            match hook {
                Hook::SafeAbort if a >= 1.0 => return,
                Hook::Rollback if a != 1.0 => {
                    self.own = Box::new(SaysDone);
                    return;
                }
                Hook::SafeAbort | Hook::Rollback => {}
            }
        }
        self.own.enter(hook);
    }
}

/// Says that it is done.
struct SaysDone;

impl Skill for SaysDone {
    fn tick(&mut self, _: &Observation) -> Command {
        Command::Done
    }

    fn enter(&mut self, _: Hook) {}
}

fn torque_n_m(seen: &Observation) -> f64 {
    seen.tau.iter().map(|torque| torque.abs()).sum()
}

/// Root mean square distance of the measurements from their mean.
fn scatter_m(pictures: &[[f64; 3]]) -> f64 {
    let n = pictures.len() as f64;
    let mean = [0, 1, 2].map(|axis| pictures.iter().map(|at| at[axis]).sum::<f64>() / n);
    let squared = |at: &[f64; 3]| [0, 1, 2].map(|axis| (at[axis] - mean[axis]).powi(2)).iter().sum::<f64>();
    (pictures.iter().map(squared).sum::<f64>() / n).sqrt()
}

fn scale(command: &mut Command, factor: f64, lower_m: f64) {
    match command {
        Command::ToolPose { pose, max_speed_m_s } => {
            pose.position[2] -= lower_m;
            *max_speed_m_s *= factor;
        }
        Command::Gripper { force_n, speed_m_s, .. } => {
            *force_n *= factor;
            *speed_m_s *= factor;
        }
        _ => {}
    }
}

fn shift(command: &mut Command, by: [f64; 3]) {
    if let Command::ToolPose { pose, .. } = command {
        for (value, by) in pose.position.iter_mut().zip(by) {
            *value += by;
        }
    }
}

fn swap(command: &mut Command, field: f64, factor: f64) {
    match (command, field) {
        (Command::Gripper { width_m, .. }, 0.0) => *width_m *= factor,
        (Command::Gripper { force_n, .. }, 1.0) => *force_n *= factor,
        (Command::Gripper { speed_m_s, .. }, 2.0) => *speed_m_s *= factor,
        (Command::ToolPose { pose, .. }, 3.0) => pose.position[2] *= factor,
        (Command::ToolPose { max_speed_m_s, .. }, 4.0) => *max_speed_m_s *= factor,
        _ => {}
    }
}
