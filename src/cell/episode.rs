//! One sampled episode: plain data, complete, independent of the robot and of what a skill does.
//!
//! Each purpose draws from its own stream ([`crate::rng`]) in a fixed order, so the same task,
//! distribution and seed give the same episode everywhere, and everything random that happens
//! during the episode comes from streams seeded here.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::distribution::Distribution;
use crate::rng::{Stream, StreamPurpose};
use crate::scene::Scene;
use holdpoint_body::task::EpisodeStart;
use holdpoint_body::{JointVec, Pose, RATE_HZ, TaskKind};

/// Joints whose start is drawn, base to tool: equal seeds give equal episodes whatever the robot.
const OFFSET_JOINTS: usize = 8;

/// The object of this episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSetup {
    /// Where it starts, world frame, m: the middle of the cube. For a held start this follows from the tool pose.
    pub pose: Pose,
    /// Mass, kg; spread evenly over the cube.
    pub mass_kg: f64,
    /// Coulomb coefficient. At a contact the smaller coefficient of the two bodies counts.
    pub friction: f64,
}

/// How the arm starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// At home, each joint off by a little; the gripper fully open, the object on the table.
    Home {
        /// Offset of each joint from the home of the description, rad, base to tool. Surplus values are ignored, and a
        /// joint without a value starts at home. The sum is kept inside the joint limits.
        offset_rad: JointVec,
    },
    /// With the object in the hand. The pads close before tick 0 and square the object, which then hangs still.
    Held {
        /// Tool pose, world frame, m.
        tool: Pose,
        /// Object in the tool frame before the pads square it, m.
        object_in_tool: Pose,
    },
}

/// The camera of this episode, in ticks of 1/240 s. It measures object and target in the world frame.
///
/// Each frame is exposed, may be lost, and is delivered after its delay, never before the frame before it. A lost frame
/// has no estimate when it is delivered. Noise and bias are the same kind for both poses: x and y by `sigma_m`, z by
/// half of it, and a turn about the world's z.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSetup {
    /// Exposure to delivery, ticks; the sum with the jitter is rounded.
    pub delay_ticks: f64,
    /// Largest addition to it per camera frame, ticks; uniform from 0.
    pub delay_jitter_ticks: f64,
    /// First exposure, ticks after the start of the episode.
    pub phase_ticks: f64,
    /// Largest addition to the period between two exposures, ticks; uniform from 0.
    pub period_jitter_ticks: f64,
    /// Probability of a lost camera frame.
    pub drop_probability: f64,
    /// Standard deviation of x and y, m.
    pub sigma_m: f64,
    /// Standard deviation of yaw, rad.
    pub sigma_yaw_rad: f64,
    /// Constant error of x and y, m.
    pub bias_m: [f64; 2],
    /// Constant error of yaw, rad.
    pub bias_yaw_rad: f64,
    /// AR(1) coefficient of the noise from one exposure to the next, 0 to 1.
    pub correlation: f64,
    /// Stream of the noise.
    pub noise: Stream,
    /// Stream of exposure times, delays and losses.
    pub timing: Stream,
}

/// Standard deviations of the robot's sensors in this episode. Each tick has fresh errors, independent of the last.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorSetup {
    /// Joint position, rad.
    pub joint_rad: f64,
    /// Joint speed, rad/s.
    pub joint_speed_rad_s: f64,
    /// Joint torque, N m.
    pub torque_n_m: f64,
    /// Force of the grip, at the wrist and on the surroundings, N.
    pub force_n: f64,
    /// Gripper width, m.
    pub width_m: f64,
    /// Slip in the hand, m.
    pub slip_m: f64,
    /// Stream of the noise.
    pub noise: Stream,
}

/// From command to servo, in ticks. The delay of a command is the rounded sum of latency and jitter, and no command
/// overtakes the one before it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionSetup {
    /// Latency, ticks.
    pub latency_ticks: f64,
    /// Largest addition per command, ticks; uniform from 0.
    pub jitter_ticks: f64,
    /// Stream of the jitter.
    pub jitter: Stream,
}

/// A push on the middle of the object, whether it lies, hangs or falls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Push {
    /// Tick from the start of the episode in which it acts; it is over when the tick is.
    pub tick: u64,
    /// Impulse, N s, world frame. Sampled pushes are horizontal.
    pub impulse_n_s: [f64; 3],
}

/// A window in which the gripper does not answer: from tick `begin` up to, not including, `end`.
///
/// The fingers stay where they are and keep their force. A command to the gripper that arrives in the window is lost.
/// The observation tells the skill (`tool_available`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolWindow {
    /// First tick, from the start of the episode.
    pub begin: u64,
    /// First tick after it.
    pub end: u64,
}

/// Everything that makes one episode.
///
/// A trial cell that is reset to it ([`TrialCell::reset`](crate::TrialCell::reset)) makes every condition true. Lengths
/// are in m and poses in the world frame: z up, the base of the robot at the origin, and the table's top at height 0.
/// Ticks count from the start of the episode. What led to the start, such as closing the hand, counts none.
///
/// A cell that cannot do a condition answers [`CellError::InvalidStart`](crate::CellError::InvalidStart) and names the
/// field. The episode is then void and no result of the skill. A cell never starts an episode without one of its
/// conditions, because the evidence would state a disturbance that did not happen. Its maker chooses its distributions
/// ([`CellFactory::distributions`](crate::CellFactory::distributions)): a condition that the cell cannot vary has one
/// value there. A cell with a mass, a friction or an error of its own has its measured value there.
///
/// Random events of the episode come from the streams in it. Each is drawn the same number of times whatever the skill
/// does, so that two skills on one seed meet the same disturbances.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeSetup {
    /// The seed it was drawn with; for messages, and for what a cell draws itself: where further objects start.
    pub seed: u64,
    /// Name of the distribution it was drawn from; for messages.
    pub distribution: String,
    /// The first task. The goal of the skill and the inspection follow it until
    /// [`RobotCell::begin_task`](crate::RobotCell::begin_task).
    pub task: TaskKind,
    /// The object.
    pub object: ObjectSetup,
    /// Tray frame in the world frame: center of the floor's upper face, x along a wall. The tray of the scene stands
    /// there and does not move.
    pub target: Pose,
    /// How the arm starts.
    pub start: Start,
    /// Which pieces of the scene's clutter are present, by index. They do not move; the others are not in the cell.
    pub clutter: ArrayVec<u8, 16>,
    /// The camera.
    pub camera: CameraSetup,
    /// The robot's sensors.
    pub sensors: SensorSetup,
    /// From command to servo.
    pub action: ActionSetup,
    /// Pushes, in order of time; none for most episodes.
    pub pushes: ArrayVec<Push, 4>,
    /// Windows in which the gripper does not answer. They may overlap.
    pub tool_windows: ArrayVec<ToolWindow, 4>,
}

const TICKS_PER_MS: f64 = RATE_HZ as f64 / 1000.0;

/// A pose on the table: x and y in m, height z, yaw about z.
#[must_use]
pub fn upright(x: f64, y: f64, z: f64, yaw: f64) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::new(x, y, z), about_z(yaw))
}

/// A tool pose that points straight down: `Rz(yaw) Rx(pi)`.
#[must_use]
pub fn tool_down(x: f64, y: f64, z: f64, yaw: f64) -> Isometry3<f64> {
    // The half turn about x is the quaternion (1, 0, 0, 0): exact.
    let flip = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(0.0, 1.0, 0.0, 0.0));
    Isometry3::from_parts(Translation3::new(x, y, z), about_z(yaw) * flip)
}

/// Rotation about z, through `libm`.
fn about_z(yaw: f64) -> UnitQuaternion<f64> {
    let (sin, cos) = libm::sincos(0.5 * yaw);
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(cos, 0.0, 0.0, sin))
}

/// An angle reduced by the cube's quarter-turn symmetry to -45..45 degrees, rad.
#[must_use]
pub fn wrap_quarter_turn(angle: f64) -> f64 {
    let quarter = core::f64::consts::FRAC_PI_2;
    angle - libm::round(angle / quarter) * quarter
}

/// Yaw of the object's x axis in the world, rad.
#[must_use]
pub fn yaw_of(pose: &Isometry3<f64>) -> f64 {
    let x = pose.rotation * Vector3::x();
    libm::atan2(x.y, x.x)
}

impl EpisodeSetup {
    /// Draws the episode of a seed.
    #[must_use]
    pub fn sample(task: TaskKind, scene: &Scene, distribution: &Distribution, seed: u64) -> Self {
        let d = distribution;
        let mut stream = Stream::new(seed, StreamPurpose::Object);
        let (x, y) = (d.object.x_m.sample(&mut stream), d.object.y_m.sample(&mut stream));
        let yaw = d.object.yaw_rad.sample(&mut stream);
        let mass_kg = d.object.mass_kg.sample(&mut stream);
        let friction = d.object.friction.sample(&mut stream);
        let mut stream = Stream::new(seed, StreamPurpose::Target);
        let (tx, ty) = (d.target.x_m.sample(&mut stream), d.target.y_m.sample(&mut stream));
        let tyaw = d.target.yaw_rad.sample(&mut stream);
        let target = upright(tx, ty, scene.tray.floor_m, tyaw);

        let mut stream = Stream::new(seed, StreamPurpose::Arm);
        let offset_rad: JointVec =
            (0..OFFSET_JOINTS).map(|_| d.arm.home_offset_rad.sample(&mut stream)).collect();
        let held = HeldSample::new(d, seed);
        let start = match task.declaration().start {
            EpisodeStart::Home => Start::Home { offset_rad },
            EpisodeStart::InHand => held.start(&upright(x, y, held.height_m, yaw)),
            EpisodeStart::OverTarget => {
                let z = scene.seat_height_m() + scene.tolerance.hover_m;
                let [rx, ry] = held.residual_m;
                held.start(&upright(tx + rx, ty + ry, z, tyaw + held.residual_yaw_rad))
            }
        };
        let pose = match &start {
            Start::Home { .. } => upright(x, y, scene.object.half_m, yaw),
            Start::Held { tool, object_in_tool } => tool.isometry() * object_in_tool.isometry(),
        };
        Self {
            seed,
            distribution: d.name.clone(),
            task,
            object: ObjectSetup { pose: Pose::from(&pose), mass_kg, friction },
            target: Pose::from(&target),
            start,
            clutter: clutter(d, scene, seed),
            camera: camera(d, seed),
            sensors: sensors(d, seed),
            action: action(d, seed),
            pushes: pushes(d, seed, mass_kg),
            tool_windows: tool_windows(d, seed),
        }
    }
}

/// The draws for a held start; always all of them, whatever the task.
struct HeldSample {
    height_m: f64,
    in_hand: Isometry3<f64>,
    residual_m: [f64; 2],
    residual_yaw_rad: f64,
}

impl HeldSample {
    fn new(d: &Distribution, seed: u64) -> Self {
        let mut stream = Stream::new(seed, StreamPurpose::InHand);
        let height_m = d.held.height_m.sample(&mut stream);
        let (along, depth) = (d.held.along_pad_m.sample(&mut stream), d.held.depth_m.sample(&mut stream));
        let in_hand = tool_down(along, 0.0, depth, d.held.yaw_rad.sample(&mut stream));
        let residual_m = [d.held.residual_xy_m.sample(&mut stream), d.held.residual_xy_m.sample(&mut stream)];
        Self { height_m, in_hand, residual_m, residual_yaw_rad: d.held.residual_yaw_rad.sample(&mut stream) }
    }

    /// The start whose object pose is `object`, turned by the quarter turn that suits the wrist.
    fn start(&self, object: &Isometry3<f64>) -> Start {
        let t = object.translation;
        let square = upright(t.x, t.y, t.z, wrap_quarter_turn(yaw_of(object)));
        let tool = square * self.in_hand.inverse();
        Start::Held { tool: Pose::from(&tool), object_in_tool: Pose::from(&self.in_hand) }
    }
}

#[allow(clippy::cast_possible_truncation, reason = "a scene has at most 16 pieces of clutter")]
fn clutter(d: &Distribution, scene: &Scene, seed: u64) -> ArrayVec<u8, 16> {
    let mut stream = Stream::new(seed, StreamPurpose::Clutter);
    let probability = d.clutter.probability.sample(&mut stream);
    (0..scene.clutter.len() as u8).filter(|_| stream.chance(probability)).take(16).collect()
}

fn camera(d: &Distribution, seed: u64) -> CameraSetup {
    let c = &d.camera;
    let mut timing = Stream::new(seed, StreamPurpose::Timing);
    let mut noise = Stream::new(seed, StreamPurpose::Picture);
    CameraSetup {
        delay_ticks: c.delay_ms.sample(&mut timing) * TICKS_PER_MS,
        delay_jitter_ticks: c.delay_jitter_ms.sample(&mut timing) * TICKS_PER_MS,
        phase_ticks: c.phase_ms.sample(&mut timing) * TICKS_PER_MS,
        period_jitter_ticks: c.period_jitter_ms.sample(&mut timing) * TICKS_PER_MS,
        drop_probability: c.drop_probability.sample(&mut timing),
        sigma_m: c.sigma_m.sample(&mut noise),
        sigma_yaw_rad: c.sigma_yaw_rad.sample(&mut noise),
        bias_m: [c.bias_m.sample(&mut noise), c.bias_m.sample(&mut noise)],
        bias_yaw_rad: c.bias_yaw_rad.sample(&mut noise),
        correlation: c.correlation.sample(&mut noise),
        noise,
        timing,
    }
}

fn sensors(d: &Distribution, seed: u64) -> SensorSetup {
    let s = &d.sensors;
    let mut noise = Stream::new(seed, StreamPurpose::Sensors);
    SensorSetup {
        joint_rad: s.joint_rad.sample(&mut noise),
        joint_speed_rad_s: s.joint_speed_rad_s.sample(&mut noise),
        torque_n_m: s.torque_n_m.sample(&mut noise),
        force_n: s.force_n.sample(&mut noise),
        width_m: s.width_m.sample(&mut noise),
        slip_m: s.slip_m.sample(&mut noise),
        noise,
    }
}

fn action(d: &Distribution, seed: u64) -> ActionSetup {
    let mut jitter = Stream::new(seed, StreamPurpose::Latency);
    ActionSetup {
        latency_ticks: d.action.latency_ms.sample(&mut jitter) * TICKS_PER_MS,
        jitter_ticks: d.action.jitter_ms.sample(&mut jitter) * TICKS_PER_MS,
        jitter,
    }
}

fn pushes(d: &Distribution, seed: u64, mass_kg: f64) -> ArrayVec<Push, 4> {
    let mut stream = Stream::new(seed, StreamPurpose::Push);
    let probability = d.push.probability.sample(&mut stream);
    let happens = stream.chance(probability);
    let seconds = d.push.time_s.sample(&mut stream);
    let impulse = mass_kg * d.push.speed_m_s.sample(&mut stream);
    let (sin, cos) = libm::sincos(stream.uniform(0.0, core::f64::consts::TAU));
    let mut pushes = ArrayVec::new();
    if happens && impulse > 0.0 {
        pushes.push(Push { tick: ticks(seconds), impulse_n_s: [impulse * cos, impulse * sin, 0.0] });
    }
    pushes
}

fn tool_windows(d: &Distribution, seed: u64) -> ArrayVec<ToolWindow, 4> {
    let mut stream = Stream::new(seed, StreamPurpose::Tool);
    let probability = d.tool.probability.sample(&mut stream);
    let mut windows = ArrayVec::new();
    for _ in 0..2 {
        let happens = stream.chance(probability);
        let begin = ticks(d.tool.start_s.sample(&mut stream));
        let length = ticks(d.tool.length_s.sample(&mut stream));
        if happens && length > 0 {
            windows.push(ToolWindow { begin, end: begin + length });
        }
    }
    windows
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "never negative; a cast saturates"
)]
fn ticks(seconds: f64) -> u64 {
    libm::round(seconds.max(0.0) * f64::from(RATE_HZ)) as u64
}
