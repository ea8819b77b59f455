//! The table of built-in controllers, and what the code of each does with its parameters.
//!
//! Owns names, inputs, sensors, tools, ranges, signals and hooks. A new controller is an entry here, and an
//! implementation of [`ControllerParams`] if its parameters are new. Its logic is in `holdpoint_skill`.

use std::fmt;

use holdpoint_body::{FailureSignal, TaskKind};
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::skill::Skill;
use holdpoint_governance::mode::{Sensor, Tool};
use holdpoint_governance::text_error::{self, TextError};
use holdpoint_governance::value_type::CoordinateFrame;
use holdpoint_skill::align::{self, Align, AlignParams};
use holdpoint_skill::grasp::{self, Grasp, GraspParams};
use holdpoint_skill::motion::{AbortStyle, RollbackStyle};
use holdpoint_skill::park::{Park, ParkParams};
use holdpoint_skill::phases::PhaseRunner;
use holdpoint_skill::place::{self, Place, PlaceParams};

/// A numeric parameter: its name, its value, and the lowest and highest value allowed.
pub type ParameterRange = (&'static str, f64, f64, f64);

/// Reads the parameters of a controller; the file is only named in errors.
type ReadParams = fn(file: &str, text: &str) -> Result<Box<dyn ControllerParams>, TextError>;

/// What is the same for all parameters of a controller.
#[derive(Debug)]
pub(super) struct ControllerEntry {
    /// Its name in manifests, after `native:`.
    pub name: &'static str,
    /// The primitive it performs.
    pub task: TaskKind,
    /// Name by which its code is called.
    pub entry_point: &'static str,
    /// Frame of the object's pose that it is given; `None` if it reads no object. Its code works in the world frame, to
    /// which the bundle converts another one.
    pub object_frame: Option<CoordinateFrame>,
    /// Whether it reads the target's pose.
    pub reads_target: bool,
    /// What its code reads of an observation.
    pub sensors: &'static [Sensor],
    /// Tools its code reads or moves.
    pub tools: &'static [Tool],
    /// Reads its parameters.
    pub read: ReadParams,
}

/// What a controller reads that looks, moves and feels for contact.
const SENSORS_OF_CONTACT: &[Sensor] = &[Sensor::Camera, Sensor::Joints, Sensor::WristForce];

/// Every built-in controller, in the order in which errors name them.
pub(super) static CONTROLLERS: &[ControllerEntry] = &[
    ControllerEntry {
        name: "grasp",
        task: grasp::TASK,
        entry_point: grasp::TASK.name(),
        object_frame: Some(CoordinateFrame::World),
        reads_target: false,
        sensors: SENSORS_OF_CONTACT,
        tools: &[Tool::ParallelGripper],
        read: read::<GraspParams>,
    },
    // As grasp, for a camera on the hand.
    ControllerEntry {
        name: "grasp-tool-frame",
        task: grasp::TASK,
        entry_point: grasp::TASK.name(),
        object_frame: Some(CoordinateFrame::Tool),
        reads_target: false,
        sensors: SENSORS_OF_CONTACT,
        tools: &[Tool::ParallelGripper],
        read: read::<GraspParams>,
    },
    ControllerEntry {
        name: "align",
        task: align::TASK,
        entry_point: align::TASK.name(),
        object_frame: Some(CoordinateFrame::World),
        reads_target: true,
        sensors: &[Sensor::Camera, Sensor::Joints],
        tools: &[Tool::ParallelGripper],
        read: read::<AlignParams>,
    },
    ControllerEntry {
        name: "place",
        task: place::TASK,
        entry_point: place::TASK.name(),
        object_frame: Some(CoordinateFrame::World),
        reads_target: true,
        sensors: SENSORS_OF_CONTACT,
        tools: &[Tool::ParallelGripper],
        read: read::<PlaceParams>,
    },
    ControllerEntry {
        name: "park",
        task: grasp::TASK,
        entry_point: "park",
        object_frame: None,
        reads_target: false,
        sensors: &[Sensor::Joints],
        tools: &[],
        read: read::<ParkParams>,
    },
];

fn read<P: ControllerParams + DeserializeOwned + 'static>(
    file: &str,
    text: &str,
) -> Result<Box<dyn ControllerParams>, TextError> {
    Ok(Box::new(text_error::parse_toml::<P>(file, text)?))
}

/// The parameters of a version, and what the controller's code does with them.
pub(super) trait ControllerParams: fmt::Debug + Send + Sync {
    /// The numeric ones, each with its range.
    fn ranges(&self) -> Vec<ParameterRange>;

    /// The signals that the code can raise.
    fn signals(&self) -> Vec<FailureSignal>;

    /// What its two hooks do.
    fn hooks(&self) -> (AbortStyle, RollbackStyle);

    /// Whether any of its commands goes to the gripper, its hooks' included.
    fn moves_the_gripper(&self) -> bool;

    /// Begins a run.
    fn start(&self) -> Box<dyn Skill>;

    /// The parameters as the digest has them.
    ///
    /// # Errors
    /// Never for parsed parameters; they are finite.
    fn to_json(&self) -> Result<Value, serde_json::Error>;
}

impl ControllerParams for GraspParams {
    fn ranges(&self) -> Vec<ParameterRange> {
        vec![
            ("look_pictures", f64::from(self.look_pictures), 1.0, 60.0),
            ("approach_height_m", self.approach_height_m, 0.02, 0.3),
            ("approach_speed_m_s", self.approach_speed_m_s, 0.01, 3.0),
            ("entry_offset_m", self.entry_offset_m, 0.0, 0.15),
            ("pregrasp_tolerance_m", self.pregrasp_tolerance_m, 0.001, 0.1),
            ("descend_speed_m_s", self.descend_speed_m_s, 0.01, 3.0),
            ("contact_speed_m_s", self.contact_speed_m_s, 0.01, 3.0),
            ("contact_stop_n", self.contact_stop_n, 2.0, 200.0),
            ("grasp_offset_m", self.grasp_offset_m, -0.01, 0.03),
            ("close_speed_m_s", self.close_speed_m_s, 0.01, 1.0),
            ("grip_force_n", self.grip_force_n, 1.0, 200.0),
            ("settle_secs", self.settle_secs, 0.0, 2.0),
            ("lift_height_m", self.lift_height_m, 0.05, 0.4),
            ("lift_speed_m_s", self.lift_speed_m_s, 0.01, 3.0),
            ("retries_max", f64::from(self.retries_max), 0.0, 5.0),
            ("tool_wait_secs", self.tool_wait_secs, 0.0, 5.0),
            ("timeout_secs", self.timeout_secs, 1.0, 60.0),
            ("safe_height_m", self.safe_height_m, 0.02, 0.5),
        ]
    }

    fn signals(&self) -> Vec<FailureSignal> {
        grasp::signals(self)
    }

    fn hooks(&self) -> (AbortStyle, RollbackStyle) {
        (self.abort, self.rollback)
    }

    fn moves_the_gripper(&self) -> bool {
        true
    }

    fn start(&self) -> Box<dyn Skill> {
        Box::new(PhaseRunner::new(Grasp::new(self.clone())))
    }

    fn to_json(&self) -> Result<Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

impl ControllerParams for AlignParams {
    fn ranges(&self) -> Vec<ParameterRange> {
        vec![
            ("look_pictures", f64::from(self.look_pictures), 1.0, 60.0),
            ("transit_height_m", self.transit_height_m, 0.05, 0.5),
            ("transit_speed_m_s", self.transit_speed_m_s, 0.01, 3.0),
            ("hover_height_m", self.hover_height_m, 0.01, 0.2),
            ("lower_speed_m_s", self.lower_speed_m_s, 0.01, 3.0),
            ("measure_pictures", f64::from(self.measure_pictures), 0.0, 60.0),
            ("tolerance_m", self.tolerance_m, 0.0001, 0.05),
            ("corrections_max", f64::from(self.corrections_max), 0.0, 10.0),
            ("correction_gain", self.correction_gain, 0.0, 1.5),
            ("settle_secs", self.settle_secs, 0.0, 2.0),
            ("timeout_secs", self.timeout_secs, 1.0, 60.0),
            ("safe_height_m", self.safe_height_m, 0.02, 0.5),
        ]
    }

    fn signals(&self) -> Vec<FailureSignal> {
        align::signals(self)
    }

    fn hooks(&self) -> (AbortStyle, RollbackStyle) {
        (self.abort, self.rollback)
    }

    fn moves_the_gripper(&self) -> bool {
        self.abort == AbortStyle::Release
    }

    fn start(&self) -> Box<dyn Skill> {
        Box::new(PhaseRunner::new(Align::new(self.clone())))
    }

    fn to_json(&self) -> Result<Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

impl ControllerParams for PlaceParams {
    fn ranges(&self) -> Vec<ParameterRange> {
        vec![
            ("look_pictures", f64::from(self.look_pictures), 0.0, 60.0),
            ("lower_speed_m_s", self.lower_speed_m_s, 0.01, 3.0),
            ("contact_force_n", self.contact_force_n, 0.5, 100.0),
            ("seat_tolerance_m", self.seat_tolerance_m, 0.0, 0.03),
            ("release_gap_m", self.release_gap_m, -0.01, 0.1),
            ("release_width_m", self.release_width_m, 0.05, 0.08),
            ("release_speed_m_s", self.release_speed_m_s, 0.01, 1.0),
            ("settle_secs", self.settle_secs, 0.0, 2.0),
            ("retreat_height_m", self.retreat_height_m, 0.02, 0.4),
            ("retreat_speed_m_s", self.retreat_speed_m_s, 0.01, 3.0),
            ("exit_offset_m", self.exit_offset_m, 0.0, 0.25),
            ("search_step_m", self.search_step_m, 0.0, 0.02),
            ("retries_max", f64::from(self.retries_max), 0.0, 8.0),
            ("tool_wait_secs", self.tool_wait_secs, 0.0, 5.0),
            ("timeout_secs", self.timeout_secs, 1.0, 60.0),
            ("safe_height_m", self.safe_height_m, 0.02, 0.5),
        ]
    }

    fn signals(&self) -> Vec<FailureSignal> {
        place::signals(self)
    }

    fn hooks(&self) -> (AbortStyle, RollbackStyle) {
        (self.abort, self.rollback)
    }

    fn moves_the_gripper(&self) -> bool {
        true
    }

    fn start(&self) -> Box<dyn Skill> {
        Box::new(PhaseRunner::new(Place::new(self.clone())))
    }

    fn to_json(&self) -> Result<Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}

impl ControllerParams for ParkParams {
    fn ranges(&self) -> Vec<ParameterRange> {
        vec![
            ("rise_height_m", self.rise_height_m, 0.02, 0.5),
            ("speed_m_s", self.speed_m_s, 0.01, 1.0),
            ("timeout_secs", self.timeout_secs, 1.0, 60.0),
        ]
    }

    fn signals(&self) -> Vec<FailureSignal> {
        vec![FailureSignal::TimedOut]
    }

    fn hooks(&self) -> (AbortStyle, RollbackStyle) {
        (AbortStyle::Hold, RollbackStyle::Handover)
    }

    fn moves_the_gripper(&self) -> bool {
        false
    }

    fn start(&self) -> Box<dyn Skill> {
        Box::new(Park::new(self.clone()))
    }

    fn to_json(&self) -> Result<Value, serde_json::Error> {
        serde_json::to_value(self)
    }
}
