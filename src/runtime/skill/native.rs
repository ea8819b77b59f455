//! Controllers compiled into the engine, chosen by name and set by a parameter file.
//!
//! A version's manifest says `bundle = "native:<controller>"` and names a parameter file; the two make a
//! [`NativeBundle`]. The interface of a controller comes from its code and its parameters, never from the manifest.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use holdpoint_body::{Command, Estimate, FailureSignal, Observation, Pose, TaskKind};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Hook, Skill, SkillBundle};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::{Digest, canonical_json};
use holdpoint_governance::mode::{Channel, CommandKind, RequiredCommand, Sensor, Tool};
use holdpoint_governance::text_error::{self, TextError, number_text};
use holdpoint_governance::value_type::{CoordinateFrame, FieldSpec, Unit, ValueKind};
use holdpoint_skill::motion::{AbortStyle, RollbackStyle};
use holdpoint_skill::phases::PhaseRunner;
use holdpoint_skill::{align, grasp, park, place};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The largest parameter file, bytes.
pub const PARAMS_BYTES_MAX: usize = 64 * 1024;

/// The version of what the parameters mean; a change of a controller's logic changes it.
const SEMANTICS: semver::Version = semver::Version::new(1, 1, 0);

/// A controller with its parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "controller", content = "params", rename_all = "kebab-case")]
pub enum Controller {
    /// What a manifest calls `native:grasp`.
    Grasp(grasp::GraspParams),
    /// `native:grasp-tool-frame`: as grasp, for a camera on the hand (the object in the tool's frame).
    GraspToolFrame(grasp::GraspParams),
    /// What a manifest calls `native:align`.
    Align(align::AlignParams),
    /// What a manifest calls `native:place`.
    Place(place::PlaceParams),
    /// What a manifest calls `native:park`.
    Park(park::ParkParams),
}

/// A controller's name that is not known.
#[derive(Debug, thiserror::Error)]
pub enum NativeError {
    /// The manifest names a controller there is none of.
    #[error("there is no native controller {0:?}; there are {known}", known = Controller::NAMES.join(", "))]
    UnknownController(String),
    /// The parameter file is not valid.
    #[error(transparent)]
    Params(#[from] TextError),
}

impl Hint for NativeError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::UnknownController(_) => Some(ErrorReason::BadFile.into()),
            Self::Params(error) => error.details(),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::UnknownController(_) => None,
            Self::Params(error) => error.hint(),
        }
    }
}

impl Controller {
    /// Names a manifest may use after `native:`.
    pub const NAMES: [&'static str; 5] = ["grasp", "grasp-tool-frame", "align", "place", "park"];

    /// Parses the parameters of a controller; `file` is only named in errors.
    ///
    /// # Errors
    /// An unknown controller; a file that does not parse, has unknown fields, or a value outside its range.
    pub fn parse(name: &str, file: &str, text: &str) -> Result<Self, NativeError> {
        text_error::check_size(file, text, PARAMS_BYTES_MAX)?;
        let controller = match name {
            "grasp" => Self::Grasp(params(file, text)?),
            "grasp-tool-frame" => Self::GraspToolFrame(params(file, text)?),
            "align" => Self::Align(params(file, text)?),
            "place" => Self::Place(params(file, text)?),
            "park" => Self::Park(params(file, text)?),
            _ => return Err(NativeError::UnknownController(name.to_owned())),
        };
        for (field, value, lowest, highest) in controller.ranges() {
            // Written so that a value that is no number is refused too.
            if !(value >= lowest && value <= highest) {
                let allowed = format!("{lowest} to {highest}");
                return Err(TextError::value(file, text, field, &number_text(value), &allowed).into());
            }
        }
        Ok(controller)
    }

    /// Every numeric parameter: its name, its value, and the lowest and highest value allowed.
    #[must_use]
    pub fn ranges(&self) -> Vec<(&'static str, f64, f64, f64)> {
        match self {
            Self::Grasp(p) | Self::GraspToolFrame(p) => vec![
                ("look_pictures", f64::from(p.look_pictures), 1.0, 60.0),
                ("approach_height_m", p.approach_height_m, 0.02, 0.3),
                ("approach_speed_m_s", p.approach_speed_m_s, 0.01, 3.0),
                ("entry_offset_m", p.entry_offset_m, 0.0, 0.15),
                ("pregrasp_tolerance_m", p.pregrasp_tolerance_m, 0.001, 0.1),
                ("descend_speed_m_s", p.descend_speed_m_s, 0.01, 3.0),
                ("contact_speed_m_s", p.contact_speed_m_s, 0.01, 3.0),
                ("contact_stop_n", p.contact_stop_n, 2.0, 200.0),
                ("grasp_offset_m", p.grasp_offset_m, -0.01, 0.03),
                ("close_speed_m_s", p.close_speed_m_s, 0.01, 1.0),
                ("grip_force_n", p.grip_force_n, 1.0, 200.0),
                ("settle_secs", p.settle_secs, 0.0, 2.0),
                ("lift_height_m", p.lift_height_m, 0.05, 0.4),
                ("lift_speed_m_s", p.lift_speed_m_s, 0.01, 3.0),
                ("retries_max", f64::from(p.retries_max), 0.0, 5.0),
                ("tool_wait_secs", p.tool_wait_secs, 0.0, 5.0),
                ("timeout_secs", p.timeout_secs, 1.0, 60.0),
                ("safe_height_m", p.safe_height_m, 0.02, 0.5),
            ],
            Self::Align(p) => vec![
                ("look_pictures", f64::from(p.look_pictures), 1.0, 60.0),
                ("transit_height_m", p.transit_height_m, 0.05, 0.5),
                ("transit_speed_m_s", p.transit_speed_m_s, 0.01, 3.0),
                ("hover_height_m", p.hover_height_m, 0.01, 0.2),
                ("lower_speed_m_s", p.lower_speed_m_s, 0.01, 3.0),
                ("measure_pictures", f64::from(p.measure_pictures), 0.0, 60.0),
                ("tolerance_m", p.tolerance_m, 0.0001, 0.05),
                ("corrections_max", f64::from(p.corrections_max), 0.0, 10.0),
                ("correction_gain", p.correction_gain, 0.0, 1.5),
                ("settle_secs", p.settle_secs, 0.0, 2.0),
                ("timeout_secs", p.timeout_secs, 1.0, 60.0),
                ("safe_height_m", p.safe_height_m, 0.02, 0.5),
            ],
            Self::Place(p) => vec![
                ("look_pictures", f64::from(p.look_pictures), 0.0, 60.0),
                ("lower_speed_m_s", p.lower_speed_m_s, 0.01, 3.0),
                ("contact_force_n", p.contact_force_n, 0.5, 100.0),
                ("seat_tolerance_m", p.seat_tolerance_m, 0.0, 0.03),
                ("release_gap_m", p.release_gap_m, -0.01, 0.1),
                ("release_width_m", p.release_width_m, 0.05, 0.08),
                ("release_speed_m_s", p.release_speed_m_s, 0.01, 1.0),
                ("settle_secs", p.settle_secs, 0.0, 2.0),
                ("retreat_height_m", p.retreat_height_m, 0.02, 0.4),
                ("retreat_speed_m_s", p.retreat_speed_m_s, 0.01, 3.0),
                ("exit_offset_m", p.exit_offset_m, 0.0, 0.25),
                ("search_step_m", p.search_step_m, 0.0, 0.02),
                ("retries_max", f64::from(p.retries_max), 0.0, 8.0),
                ("tool_wait_secs", p.tool_wait_secs, 0.0, 5.0),
                ("timeout_secs", p.timeout_secs, 1.0, 60.0),
                ("safe_height_m", p.safe_height_m, 0.02, 0.5),
            ],
            Self::Park(p) => vec![
                ("rise_height_m", p.rise_height_m, 0.02, 0.5),
                ("speed_m_s", p.speed_m_s, 0.01, 1.0),
                ("timeout_secs", p.timeout_secs, 1.0, 60.0),
            ],
        }
    }

    fn name(&self) -> &'static str {
        match self {
            Self::Grasp(_) => "grasp",
            Self::GraspToolFrame(_) => "grasp-tool-frame",
            Self::Align(_) => "align",
            Self::Place(_) => "place",
            Self::Park(_) => "park",
        }
    }

    fn signals(&self) -> Vec<FailureSignal> {
        match self {
            Self::Grasp(p) | Self::GraspToolFrame(p) => grasp::signals(p),
            Self::Align(p) => align::signals(p),
            Self::Place(p) => place::signals(p),
            Self::Park(_) => vec![FailureSignal::TimedOut],
        }
    }

    fn hooks(&self) -> BTreeSet<String> {
        let (abort, rollback) = match self {
            Self::Grasp(p) | Self::GraspToolFrame(p) => (p.abort, p.rollback),
            Self::Align(p) => (p.abort, p.rollback),
            Self::Place(p) => (p.abort, p.rollback),
            Self::Park(_) => (AbortStyle::Hold, RollbackStyle::Handover),
        };
        let abort = (abort != AbortStyle::None).then(|| "safe-abort".to_owned());
        let rollback = (rollback != RollbackStyle::None).then(|| "rollback".to_owned());
        abort.into_iter().chain(rollback).collect()
    }

    /// Whether any of its commands goes to the gripper, its hooks' included.
    fn moves_the_gripper(&self) -> bool {
        match self {
            Self::Grasp(_) | Self::GraspToolFrame(_) | Self::Place(_) => true,
            Self::Align(p) => p.abort == AbortStyle::Release,
            Self::Park(_) => false,
        }
    }

    /// What its code reads of an observation.
    fn sensors(&self) -> BTreeSet<Sensor> {
        match self {
            Self::Grasp(_) | Self::GraspToolFrame(_) | Self::Place(_) => Sensor::ALL.into(),
            Self::Align(_) => [Sensor::Camera, Sensor::Joints].into(),
            Self::Park(_) => [Sensor::Joints].into(),
        }
    }

    /// Tools its code reads or moves.
    fn tools(&self) -> BTreeSet<Tool> {
        match self {
            Self::Grasp(_) | Self::GraspToolFrame(_) | Self::Align(_) | Self::Place(_) => {
                [Tool::ParallelGripper].into()
            }
            Self::Park(_) => BTreeSet::new(),
        }
    }

    fn inputs(&self) -> BTreeMap<String, FieldSpec> {
        let object = |frame| ("object".to_owned(), FieldSpec::pose(frame));
        let target = ("target".to_owned(), FieldSpec::pose(CoordinateFrame::World));
        let width = ("gripper-width".to_owned(), FieldSpec::real(Unit::Metre, 0.0, 0.1));
        match self {
            Self::Grasp(_) => [object(CoordinateFrame::World), width].into(),
            Self::GraspToolFrame(_) => [object(CoordinateFrame::Tool), width].into(),
            Self::Align(_) | Self::Place(_) => [object(CoordinateFrame::World), target, width].into(),
            Self::Park(_) => [width].into(),
        }
    }

    fn outputs() -> BTreeMap<String, FieldSpec> {
        let mut outcome = FieldSpec::plain(ValueKind::Enum);
        outcome.values = vec!["done".to_owned(), "failed".to_owned()];
        [("outcome".to_owned(), outcome), ("duration".to_owned(), FieldSpec::real(Unit::Second, 0.0, 60.0))]
            .into()
    }
}

fn params<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, TextError> {
    text_error::parse_toml(file, text)
}

/// A native controller as a loaded executable.
#[derive(Clone, Debug, PartialEq)]
pub struct NativeBundle {
    controller: Controller,
    digest: Digest,
}

impl NativeBundle {
    /// Loads a controller with its parameters.
    ///
    /// # Errors
    /// Never for parsed parameters; they are finite.
    pub fn new(controller: Controller) -> Result<Self, serde_json::Error> {
        let name = controller.name();
        let params = canonical_json(&controller)?;
        let digest = Digest::of_parts(
            "holdpoint.bundle.native.v1",
            &[name.as_bytes(), SEMANTICS.to_string().as_bytes(), params.as_bytes()],
        );
        Ok(Self { controller, digest })
    }

    /// The controller and its parameters.
    #[must_use]
    pub const fn controller(&self) -> &Controller {
        &self.controller
    }
}

impl SkillBundle for NativeBundle {
    fn digest(&self) -> Digest {
        self.digest
    }

    fn interface(&self) -> Interface {
        let arm = |command| RequiredCommand { channel: Channel::Arm, command };
        let mut needs = BTreeSet::from([arm(CommandKind::ToolPose), arm(CommandKind::Stop)]);
        if self.controller.moves_the_gripper() {
            needs.insert(RequiredCommand { channel: Channel::Gripper, command: CommandKind::Gripper });
        }
        let entry = match self.controller {
            Controller::Park(_) => "park",
            _ => self.task().name(),
        };
        Interface {
            controller: self.controller.name().to_owned(),
            semantics_version: SEMANTICS,
            entry_points: [entry.to_owned()].into(),
            inputs: self.controller.inputs(),
            outputs: Controller::outputs(),
            parameters: BTreeMap::new(),
            hooks: self.controller.hooks(),
            failure_signals: self.controller.signals().into_iter().collect(),
            needs,
            sensors: self.controller.sensors(),
            tools: self.controller.tools(),
        }
    }

    fn task(&self) -> TaskKind {
        match self.controller {
            Controller::Grasp(_) | Controller::GraspToolFrame(_) | Controller::Park(_) => TaskKind::Grasp,
            Controller::Align(_) => TaskKind::Align,
            Controller::Place(_) => TaskKind::Place,
        }
    }

    fn start(&self, _seed: u64) -> Box<dyn Skill> {
        // These controllers draw nothing at random; the seed is for bundles that do.
        match self.controller.clone() {
            Controller::Grasp(p) => Box::new(PhaseRunner::new(grasp::Grasp::new(p))),
            Controller::GraspToolFrame(p) => Box::new(ToolFrame(PhaseRunner::new(grasp::Grasp::new(p)))),
            Controller::Align(p) => Box::new(PhaseRunner::new(align::Align::new(p))),
            Controller::Place(p) => Box::new(PhaseRunner::new(place::Place::new(p))),
            Controller::Park(p) => Box::new(park::Park::new(p)),
        }
    }
}

/// Takes the object's pose to be given in the tool's frame, as a camera on the hand would.
#[derive(Clone)]
struct ToolFrame(PhaseRunner<grasp::Grasp>);

impl Skill for ToolFrame {
    fn tick(&mut self, seen: &Observation) -> Command {
        let mut in_world = seen.clone();
        in_world.object = seen.object.map(|estimate| Estimate {
            pose: Pose::from(&(seen.tool.isometry() * estimate.pose.isometry())),
            ..estimate
        });
        self.0.tick(&in_world)
    }

    fn enter(&mut self, hook: Hook) {
        self.0.enter(hook);
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(self.clone()))
    }
}
