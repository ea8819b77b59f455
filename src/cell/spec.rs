//! What a cell is and what it can do: geometry, zones, named objects, tasks, sensors and abilities, as plain data.

use std::sync::Arc;

use holdpoint_body::chain::Transform;
use holdpoint_body::task::{SEQUENCE_ALLOWED, is_sequence};
use holdpoint_body::{
    FurtherObject, FurtherProblem, Geometry, JointVec, MAX_JOINTS, MAX_OBJECTS, MAX_SENSORS,
    OBJECT_NAME_BYTES_MAX, ObjectName, RATE_HZ, SENSOR_VALUES_MAX, Shape, TaskKind, Zone,
};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::error::CellError;
use crate::scene::Scene;

/// The shape of a part of the robot, in the part's frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PartShape {
    /// A primitive shape.
    Primitive(Shape),
    /// The convex hull of points, m.
    Hull(Vec<[f64; 3]>),
}

/// A collision shape on the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedShape {
    /// The piece it is on: 0 is the base, `i` the link of joint `i - 1`, and the fingers come last.
    pub piece: usize,
    /// Pose in the frame of the piece.
    pub pose: Isometry3<f64>,
    /// The shape.
    pub shape: PartShape,
}

/// The robot of a cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotSpec {
    /// Name in its description.
    pub name: String,
    /// Digest of its description.
    pub digest: u64,
    /// Kinematics and covers of the arm.
    pub geometry: Arc<Geometry>,
    /// Collision shapes.
    pub parts: Vec<PlacedShape>,
    /// Home configuration, rad.
    pub home: JointVec,
    /// Last link frame to the frame of each closed finger, which slides along its own z axis.
    pub fingers: [Transform; 2],
    /// Largest distance between the pads, m.
    pub width_max_m: f64,
}

/// What a task does with a named object.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectKind {
    /// It works on it.
    Workpiece,
    /// It brings a workpiece to it.
    Place,
    /// Nothing: it is a further object.
    Further(FurtherObject),
}

impl ObjectKind {
    /// The name in texts.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Workpiece => "workpiece",
            Self::Place => "place",
            Self::Further(_) => "further object",
        }
    }
}

/// An object that the observations of a cell can name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellObject {
    /// Its name there.
    pub name: ObjectName,
    /// What a task does with it.
    pub kind: ObjectKind,
    /// Half extents, m.
    pub half_m: [f64; 3],
}

/// The longest unit of a sensor, bytes.
const UNIT_BYTES_MAX: usize = 16;

/// A sensor that a cell offers by name, beside those of every observation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SensorSpec {
    /// Its name in observations.
    pub name: ObjectName,
    /// How many numbers it has.
    pub length: u32,
    /// Their unit.
    pub unit: String,
    /// Measurements per second.
    pub rate_hz: u32,
}

/// What a cell can do beyond the calls of its body. Evidence that needs a missing ability is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Abilities {
    /// It gives its state, so that a trial cell continues from it.
    pub export_state: bool,
    /// Its live cell says what its sensors tell of its state, and its trial cells can be set to that.
    pub set_observed: bool,
    /// It keeps the frames of an episode.
    pub film: bool,
    /// It gives true state, so that a referee can judge it.
    pub referee: bool,
}

/// A cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CellSpec {
    /// The robot.
    pub robot: RobotSpec,
    /// Table, tray, clutter and what counts as done.
    pub scene: Arc<Scene>,
    /// The zones of the scene, first match wins.
    pub zones: Arc<[Zone]>,
    /// The objects that its observations can name.
    pub objects: Vec<CellObject>,
    /// The sensors that it offers by name; a component may ask for them.
    #[serde(default)]
    pub sensors: Vec<SensorSpec>,
    /// The tasks that the cell presents, in their order: the sequence that live cell, agent and trials run. Each task once;
    /// each starts with the hand as the one before leaves it.
    pub tasks: Vec<TaskKind>,
    /// Ticks per second.
    pub rate_hz: u32,
    /// Camera frames per second.
    pub camera_hz: u32,
    /// What it can do.
    pub abilities: Abilities,
}

impl CellSpec {
    /// Digest of the whole description.
    #[must_use]
    pub fn digest(&self) -> [u8; 32] {
        // The debug text contains type names; a build with other names has another digest in any case.
        Sha256::digest(format!("{self:?}").as_bytes()).into()
    }

    /// Checks a description from outside: what this program can work with.
    ///
    /// # Errors
    /// [`CellError::File`] naming the element; `file` stands for where the description is from.
    pub fn check(&self, file: &str) -> Result<(), CellError> {
        let refuse = |element: &str, problem: String| Err(CellError::file(file, element, problem));
        let robot = &self.robot;
        let joints = robot.geometry.joint_count();
        if !(1..=MAX_JOINTS).contains(&joints) {
            return refuse(
                "robot.geometry.chain.joints",
                format!("\"{joints}\" joints; 1 to {MAX_JOINTS} are allowed"),
            );
        }
        if !robot.geometry.within_limits(&robot.home) {
            let problem = format!("\"{:?}\" must have {joints} values inside the joint limits", robot.home);
            return refuse("robot.home", problem);
        }
        let limits = robot.geometry.chain.joints.iter();
        let mut limits = limits
            .flat_map(|joint| [joint.speed_max_rad_s, joint.acceleration_max_rad_s2, joint.effort_max_n_m]);
        if !limits.all(|limit| limit.is_finite() && limit > 0.0) {
            return refuse(
                "robot.geometry.chain.joints",
                "every limit must be finite and above 0".to_owned(),
            );
        }
        if !(robot.width_max_m.is_finite() && robot.width_max_m > 0.0) {
            return refuse(
                "robot.width_max_m",
                format!("\"{}\" must be finite and above 0", robot.width_max_m),
            );
        }
        if let Some(part) = robot.parts.iter().find(|part| part.piece > joints + 2) {
            return refuse(
                "robot.parts",
                format!("\"{}\" is no piece; the last is {}", part.piece, joints + 2),
            );
        }
        if self.rate_hz != RATE_HZ {
            return refuse(
                "rate_hz",
                format!("\"{}\" is not the rate of this build, {RATE_HZ}", self.rate_hz),
            );
        }
        if self.camera_hz == 0 || self.camera_hz > self.rate_hz {
            return refuse("camera_hz", format!("\"{}\" must be 1 to {}", self.camera_hz, self.rate_hz));
        }
        if !is_sequence(&self.tasks) {
            return refuse("tasks", format!("\"{:?}\" must be {SEQUENCE_ALLOWED}", self.tasks));
        }
        if self.zones.iter().ne(&self.scene.zones) {
            return refuse("zones", "they must be those of the scene".to_owned());
        }
        if let Some(problem) = self.object_problem() {
            return refuse("objects", problem);
        }
        if let Some(problem) = self.sensor_problem() {
            return refuse("sensors", problem);
        }
        self.scene.check(file)
    }

    /// What is wrong with the objects: their number, a name or a size, or a task lacks one.
    fn object_problem(&self) -> Option<String> {
        if self.objects.len() > MAX_OBJECTS {
            return Some(format!("\"{}\" objects; at most {MAX_OBJECTS} are allowed", self.objects.len()));
        }
        for (place, CellObject { name, kind, half_m }) in self.objects.iter().enumerate() {
            if name.is_empty() || self.objects.iter().take(place).any(|before| before.name == *name) {
                return Some(format!(
                    "\"{name}\" must have 1 to {OBJECT_NAME_BYTES_MAX} bytes and occur once"
                ));
            }
            if !half_m.iter().all(|half| half.is_finite() && *half > 0.0) {
                return Some(format!(
                    "half_m \"{half_m:?}\" of {name}: every value must be finite and above 0"
                ));
            }
            if let ObjectKind::Further(further) = kind
                && let Some(FurtherProblem { field, value, allowed }) = further.problem()
            {
                return Some(format!("{field} \"{value}\" of {name}; allowed: {allowed}"));
            }
        }
        let has = |name: &str, kind: ObjectKind| self.object(name).is_some_and(|object| object.kind == kind);
        self.tasks.iter().find_map(|task| {
            let declared = task.declaration();
            [(declared.object, ObjectKind::Workpiece), (declared.target, ObjectKind::Place)]
                .into_iter()
                .find(|(name, kind)| !has(name, *kind))
                .map(|(name, kind)| format!("the task \"{task}\" needs the {} \"{name}\"", kind.name()))
        })
    }

    /// What is wrong with the sensors: their number, a name, a length, a unit or a rate.
    fn sensor_problem(&self) -> Option<String> {
        if self.sensors.len() > MAX_SENSORS {
            return Some(format!("\"{}\" sensors; at most {MAX_SENSORS} are allowed", self.sensors.len()));
        }
        self.sensors.iter().enumerate().find_map(|(place, SensorSpec { name, length, unit, rate_hz })| {
            let is_named = !name.is_empty() && self.sensors.iter().take(place).all(|one| one.name != *name);
            let is_sized = usize::try_from(*length).is_ok_and(|n| (1..=SENSOR_VALUES_MAX).contains(&n));
            let is_whole = (1..=UNIT_BYTES_MAX).contains(&unit.len()) && (1..=self.rate_hz).contains(rate_hz);
            (!(is_named && is_sized && is_whole)).then(|| {
                format!(
                    "\"{name}\" must have 1 to {OBJECT_NAME_BYTES_MAX} bytes and occur once, with 1 to \
                     {SENSOR_VALUES_MAX} values, a unit of 1 to {UNIT_BYTES_MAX} bytes and 1 to {} Hz",
                    self.rate_hz
                )
            })
        })
    }

    /// Whether it offers a sensor of this name with so many numbers.
    #[must_use]
    pub fn offers(&self, name: &str, length: usize) -> bool {
        let is_it = |one: &SensorSpec| one.name.as_str() == name && usize::try_from(one.length) == Ok(length);
        self.sensors.iter().any(is_it)
    }

    /// The object of this name.
    #[must_use]
    pub fn object(&self, name: &str) -> Option<&CellObject> {
        self.objects.iter().find(|object| object.name.as_str() == name)
    }

    /// The first task of the sequence. A description that passed its check has one.
    #[must_use]
    pub fn first_task(&self) -> TaskKind {
        self.tasks.first().copied().unwrap_or(TaskKind::SEQUENCE[0])
    }

    /// The last task of the sequence. As [`Self::first_task`].
    #[must_use]
    pub fn last_task(&self) -> TaskKind {
        self.tasks.last().copied().unwrap_or_else(|| self.first_task())
    }
}
