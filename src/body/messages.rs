//! The messages between whatever decides and the robot: plain data, no handles.
//!
//! Four kinds cross this boundary, and nothing else does: an [`Observation`] (what a skill may
//! see), a [`Command`] (what it may ask for), [`Telemetry`] (what the watcher and the monitor may
//! see) and an [`Interrupt`]. They are plain serde values so that a skill can run behind a
//! process or a WebAssembly boundary and an episode can be logged and replayed.
//!
//! Units are SI: meters, radians, newtons, seconds; ticks are [`RATE_HZ`] per second. Poses are expressed in the
//! world frame, z up, the robot's base at the origin.

use arrayvec::{ArrayString, ArrayVec};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

use crate::task::TaskKind;

/// Ticks per second of physics, skill, guard and watcher.
pub const RATE_HZ: u32 = 240;

/// Seconds per tick, 1/240.
pub const TICK_SECS: f64 = 1.0 / RATE_HZ as f64;

/// The most arm joints a robot description may have.
pub const MAX_JOINTS: usize = 16;

/// One value per arm joint, base to tool, without allocation.
pub type JointVec = ArrayVec<f64, MAX_JOINTS>;

/// A rigid pose in the world frame: position in meters and a unit quaternion (x, y, z, w).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Position of the origin, m.
    pub position: [f64; 3],
    /// Unit quaternion, x, y, z, w.
    pub rotation: [f64; 4],
}

impl Pose {
    /// The pose at the origin without rotation.
    pub const IDENTITY: Self = Self { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };

    /// The same pose as an f64 isometry.
    #[must_use]
    pub fn isometry(&self) -> Isometry3<f64> {
        let [x, y, z, w] = self.rotation;
        Isometry3::from_parts(
            Translation3::from(self.position),
            UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
        )
    }

    /// Whether every number is finite and the quaternion is of unit length (within 1e-6).
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let norm2: f64 = self.rotation.iter().map(|v| v * v).sum();
        self.position.iter().all(|v| v.is_finite()) && (norm2 - 1.0).abs() < 1e-6
    }

    /// Heading of the x axis about the vertical, rad.
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        let [x, y, z, w] = self.rotation;
        libm::atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    }

    /// Distance between the two origins in meters.
    #[must_use]
    pub fn distance_m(&self, other: &Self) -> f64 {
        let [a, b] = [self.position, other.position];
        libm::sqrt((0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum())
    }
}

impl From<&Isometry3<f64>> for Pose {
    fn from(iso: &Isometry3<f64>) -> Self {
        let c = iso.rotation.coords;
        Self { position: iso.translation.vector.into(), rotation: [c.x, c.y, c.z, c.w] }
    }
}

/// Linear (m/s) and angular (rad/s) velocity in the world frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Velocity of the origin, m/s.
    pub linear: [f64; 3],
    /// Angular velocity as a rotation vector, rad/s.
    pub angular: [f64; 3],
}

impl Twist {
    /// Magnitude of the linear part in m/s.
    #[must_use]
    pub fn speed_m_s(&self) -> f64 {
        libm::sqrt(self.linear.iter().map(|v| v * v).sum())
    }
}

/// A perceived pose: where the camera last saw something, and how long ago.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Perceived pose, with noise and bias.
    pub pose: Pose,
    /// Ticks since the camera frame was taken.
    pub age_ticks: u32,
    /// Number of the camera frame: a new number is a new measurement.
    pub sequence: u32,
}

/// The most named objects that an observation carries.
pub const MAX_OBJECTS: usize = 8;

/// The longest name of an object, bytes.
pub const OBJECT_NAME_BYTES_MAX: usize = 16;

/// The name of an object, without allocation.
pub type ObjectName = ArrayString<OBJECT_NAME_BYTES_MAX>;

/// An object that the camera saw, or a place for one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeenObject {
    /// Its name in the cell; an observation has each name once.
    pub name: ObjectName,
    /// Where it was last seen.
    pub estimate: Estimate,
}

/// Named objects, without allocation.
pub type ObjectVec = ArrayVec<SeenObject, MAX_OBJECTS>;

/// The most named sensors that an observation carries.
pub const MAX_SENSORS: usize = 4;

/// The most numbers of a named sensor.
pub const SENSOR_VALUES_MAX: usize = 16;

/// The newest numbers of a sensor that a cell offers by name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedReading {
    /// Its name in the cell; an observation has each name once.
    pub name: ObjectName,
    /// Ticks since they were measured.
    pub age_ticks: u32,
    /// The numbers, in the unit that the cell states.
    pub values: ArrayVec<f64, SENSOR_VALUES_MAX>,
}

/// Named sensors, without allocation.
pub type ReadingVec = ArrayVec<NamedReading, MAX_SENSORS>;

/// What the guard did with the previous command; a skill may react to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GuardVerdict {
    /// Passed on to the robot unchanged.
    #[default]
    Allowed,
    /// Passed with a smaller speed, force or reach.
    Clamped,
    /// Not passed; the robot holds.
    Denied,
}

/// What a skill may see in one tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Ticks since the task started.
    pub tick: u64,
    /// Measured joint positions, rad.
    pub q: JointVec,
    /// Measured joint velocities, rad/s.
    pub dq: JointVec,
    /// Joint torques, N m.
    pub tau: JointVec,
    /// Tool pose from the measured joints.
    pub tool: Pose,
    /// Tool velocity from the measured joints.
    pub tool_twist: Twist,
    /// Distance between the finger pads, m.
    pub gripper_width_m: f64,
    /// Mean normal force on the pads, N.
    pub gripper_force_n: f64,
    /// Contact force sensed at the wrist, without the payload's weight, N.
    pub wrist_force_n: f64,
    /// Where the objects of the cell were last seen; without those that are not in sight, and empty when the camera
    /// frame was dropped.
    pub objects: ObjectVec,
    /// What the sensors measured that the cell offers by name.
    #[serde(default, skip_serializing_if = "ReadingVec::is_empty")]
    pub sensors: ReadingVec,
    /// Whether the gripper answers at the moment.
    pub tool_available: bool,
    /// The primitive that is to be done.
    pub goal: TaskKind,
    /// What the guard did with the previous command.
    pub guard: GuardVerdict,
}

impl Observation {
    /// Where the object of this name was last seen.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<&Estimate> {
        self.objects.iter().find(|seen| seen.name.as_str() == name).map(|seen| &seen.estimate)
    }

    /// Where the object on which the goal works was last seen.
    #[must_use]
    pub fn object(&self) -> Option<&Estimate> {
        self.named(self.goal.declaration().object)
    }

    /// Where the target of the goal was last seen.
    #[must_use]
    pub fn target(&self) -> Option<&Estimate> {
        self.named(self.goal.declaration().target)
    }

    /// [`Self::named`], to change it.
    pub fn named_mut(&mut self, name: &str) -> Option<&mut Estimate> {
        self.objects.iter_mut().find(|seen| seen.name.as_str() == name).map(|seen| &mut seen.estimate)
    }

    /// [`Self::object`], to change it.
    pub fn object_mut(&mut self) -> Option<&mut Estimate> {
        self.named_mut(self.goal.declaration().object)
    }

    /// [`Self::target`], to change it.
    pub fn target_mut(&mut self) -> Option<&mut Estimate> {
        self.named_mut(self.goal.declaration().target)
    }
}

/// Why a skill gave up. Manifests list the ones a version may raise.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum FailureSignal {
    /// The object or the target was not seen.
    TargetNotFound,
    /// The fingers closed on nothing.
    GraspMissed,
    /// The object moved in, or left, the hand.
    ObjectSlipped,
    /// Contact that the task at hand does not expect.
    UnexpectedContact,
    /// The object could not be brought over the target.
    AlignmentLost,
    /// The object did not come to rest in the target.
    PlacementMissed,
    /// The gripper does not answer.
    ToolUnavailable,
    /// The camera frames are too old to act on.
    InputStale,
    /// The work took longer than the skill allows itself.
    TimedOut,
}

impl FailureSignal {
    /// Every signal there is, in the order of the variants.
    pub const ALL: [Self; 9] = [
        Self::TargetNotFound,
        Self::GraspMissed,
        Self::ObjectSlipped,
        Self::UnexpectedContact,
        Self::AlignmentLost,
        Self::PlacementMissed,
        Self::ToolUnavailable,
        Self::InputStale,
        Self::TimedOut,
    ];
}

/// How a skill's confined code failed, as its host found it.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, schemars::JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum CodeFault {
    /// It trapped.
    Trap,
    /// A tick, or its start, needed more than its budget of fuel.
    Fuel,
    /// It asked for more memory than it declares.
    Memory,
    /// It refused to start, or what it answered is no command.
    Answer,
    /// The call took so long that the machine must have stalled; this is no fault of the code.
    Machine,
}

impl CodeFault {
    /// All of them, in the order of the variants.
    pub const ALL: [Self; 5] = [Self::Trap, Self::Fuel, Self::Memory, Self::Answer, Self::Machine];

    /// Whether the fault is the machine's: the episode says nothing of the version.
    #[must_use]
    pub const fn is_infrastructure(self) -> bool {
        matches!(self, Self::Machine)
    }
}

/// What a skill may ask for in one tick. A setpoint stays in force until it is replaced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Command {
    /// Leave both channels as they are; setpoints stay in force.
    Hold,
    /// Channel arm: move the tool in a straight line to a pose, world frame.
    ToolPose {
        /// Pose of the tool to reach, world frame.
        pose: Pose,
        /// Path speed, m/s, above 0.
        max_speed_m_s: f64,
    },
    /// Channel arm: move the joints to a configuration.
    Joints {
        /// Target, rad, one value per joint.
        q: JointVec,
        /// Speed of the fastest joint, rad/s, above 0.
        max_speed_rad_s: f64,
    },
    /// Channel gripper: bring the pads to a distance, pressing with at most a force.
    Gripper {
        /// Distance between the pads, m.
        width_m: f64,
        /// Closing or opening speed of the width, m/s, above 0.
        speed_m_s: f64,
        /// Largest force per finger, N.
        force_n: f64,
    },
    /// Channel arm: stand still as fast as the servo allows.
    Stop,
    /// The skill believes it has finished; inspection decides whether it has.
    Done,
    /// The skill gives up and says why.
    Fail {
        /// Why it gives up; its manifest must list the signal.
        signal: FailureSignal,
    },
}

/// Asked of the robot from outside the skill.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Interrupt {
    /// Brake at the servo's limit and stay; setpoints are ignored until [`Interrupt::Release`].
    Stop,
    /// Take setpoints again, from standstill.
    Release,
}

/// Which kinds of things touch each other, as the cell's sensors report it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Contacts {
    /// A finger pad touches the object.
    pub pad_object: bool,
    /// Another part of the robot touches the object.
    pub body_object: bool,
    /// The robot touches the table or the tray.
    pub robot_fixture: bool,
    /// The robot touches clutter.
    pub robot_clutter: bool,
    /// Two parts of the robot touch.
    pub robot_robot: bool,
    /// The object touches table or tray.
    pub object_fixture: bool,
    /// The object touches clutter.
    pub object_clutter: bool,
}

/// What the watcher and the monitor may read in one tick: sensors, with noise, never ground truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Ticks since the task started.
    pub tick: u64,
    /// Measured joint positions, rad.
    pub q: JointVec,
    /// Measured joint velocities, rad/s.
    pub dq: JointVec,
    /// Largest distance of a joint from its servo target, rad.
    pub tracking_error_rad: f64,
    /// Tool pose from the measured joints.
    pub tool: Pose,
    /// Speed of the tool's center point, m/s.
    pub tool_speed_m_s: f64,
    /// Distance between the finger pads, m.
    pub gripper_width_m: f64,
    /// Mean normal force on the pads, N.
    pub gripper_force_n: f64,
    /// Largest force of the robot or of the held object on its surroundings, N.
    pub contact_force_n: f64,
    /// Which kinds of things touch each other.
    pub contacts: Contacts,
    /// How far the object has moved in the hand since the grip closed, m; absent without a grip.
    pub slip_m: Option<f64>,
    /// Age of the camera frame the skill acts on, ticks; absent before the first frame.
    pub picture_age_ticks: Option<u32>,
    /// Whether the gripper answers.
    pub tool_available: bool,
}
