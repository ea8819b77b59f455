//! Controllers compiled into the engine, chosen by name and set by a parameter file.
//!
//! A version's manifest says `bundle = "native:<controller>"` and names a parameter file; the two make a
//! [`NativeBundle`]. The interface of a controller comes from its code and its parameters, never from the manifest.

mod controllers;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use holdpoint_body::{Command, Observation, Pose, TaskKind};
use serde_json::Value;

pub use self::controllers::ParameterRange;
use self::controllers::{CONTROLLERS, ControllerEntry, ControllerParams};
use super::{Hook, Skill, SkillBundle};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::{Digest, canonical_json};
use holdpoint_governance::mode::{Channel, CommandKind, RequiredCommand};
use holdpoint_governance::text_error::{self, TextError, number_text};
use holdpoint_governance::value_type::{CoordinateFrame, FieldSpec, Unit, ValueKind};
use holdpoint_skill::motion::{AbortStyle, RollbackStyle};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The largest parameter file, bytes.
pub const PARAMS_BYTES_MAX: usize = 64 * 1024;

/// The version of what the parameters mean; a change of a controller's logic changes it.
const SEMANTICS: semver::Version = semver::Version::new(1, 1, 0);

/// A controller with its parameters.
#[derive(Debug)]
pub struct Controller {
    entry: &'static ControllerEntry,
    params: Box<dyn ControllerParams>,
}

/// A controller's name that is not known.
#[derive(Debug, thiserror::Error)]
pub enum NativeError {
    /// The manifest names a controller there is none of.
    #[error("there is no native controller {0:?}; there are {known}", known = Controller::names().join(", "))]
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
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        CONTROLLERS.iter().map(|entry| entry.name).collect()
    }

    /// Parses the parameters of a controller; `file` is only named in errors.
    ///
    /// # Errors
    /// An unknown controller; a file that does not parse, has unknown fields, or a value outside its range.
    pub fn parse(name: &str, file: &str, text: &str) -> Result<Self, NativeError> {
        text_error::check_size(file, text, PARAMS_BYTES_MAX)?;
        let Some(entry) = CONTROLLERS.iter().find(|entry| entry.name == name) else {
            return Err(NativeError::UnknownController(name.to_owned()));
        };
        let controller = Self { entry, params: (entry.read)(file, text)? };
        for (field, value, lowest, highest) in controller.ranges() {
            // Written so that a value that is no number is refused too.
            if !(value >= lowest && value <= highest) {
                let allowed = format!("{lowest} to {highest}");
                return Err(TextError::value(file, text, field, &number_text(value), &allowed).into());
            }
        }
        Ok(controller)
    }

    /// Every numeric parameter with its range.
    #[must_use]
    pub fn ranges(&self) -> Vec<ParameterRange> {
        self.params.ranges()
    }

    fn hooks(&self) -> BTreeSet<String> {
        let (abort, rollback) = self.params.hooks();
        let abort = (abort != AbortStyle::None).then(|| "safe-abort".to_owned());
        let rollback = (rollback != RollbackStyle::None).then(|| "rollback".to_owned());
        abort.into_iter().chain(rollback).collect()
    }

    fn inputs(&self) -> BTreeMap<String, FieldSpec> {
        let object = self.entry.object_frame.map(|frame| ("object".to_owned(), FieldSpec::pose(frame)));
        let target = || ("target".to_owned(), FieldSpec::pose(CoordinateFrame::World));
        let target = self.entry.reads_target.then(target);
        let width = ("gripper-width".to_owned(), FieldSpec::real(Unit::Metre, 0.0, 0.1));
        object.into_iter().chain(target).chain([width]).collect()
    }

    fn outputs() -> BTreeMap<String, FieldSpec> {
        let mut outcome = FieldSpec::plain(ValueKind::Enum);
        outcome.values = vec!["done".to_owned(), "failed".to_owned()];
        [("outcome".to_owned(), outcome), ("duration".to_owned(), FieldSpec::real(Unit::Second, 0.0, 60.0))]
            .into()
    }
}

/// A native controller as a loaded executable.
#[derive(Debug)]
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
        let name = controller.entry.name;
        let params =
            BTreeMap::from([("controller", Value::from(name)), ("params", controller.params.to_json()?)]);
        let params = canonical_json(&params)?;
        let digest = Digest::of_parts(
            "holdpoint.bundle.native.v1",
            &[name.as_bytes(), SEMANTICS.to_string().as_bytes(), params.as_bytes()],
        );
        Ok(Self { controller, digest })
    }
}

impl SkillBundle for NativeBundle {
    fn digest(&self) -> Digest {
        self.digest
    }

    fn interface(&self) -> Interface {
        let Controller { entry, params } = &self.controller;
        let arm = |command| RequiredCommand { channel: Channel::Arm, command };
        let mut needs = BTreeSet::from([arm(CommandKind::ToolPose), arm(CommandKind::Stop)]);
        if params.moves_the_gripper() {
            needs.insert(RequiredCommand { channel: Channel::Gripper, command: CommandKind::Gripper });
        }
        Interface {
            controller: entry.name.to_owned(),
            semantics_version: SEMANTICS,
            entry_points: [entry.entry_point.to_owned()].into(),
            inputs: self.controller.inputs(),
            outputs: Controller::outputs(),
            parameters: BTreeMap::new(),
            hooks: self.controller.hooks(),
            failure_signals: params.signals().into_iter().collect(),
            needs,
            sensors: entry.sensors.iter().copied().collect(),
            tools: entry.tools.iter().copied().collect(),
        }
    }

    fn task(&self) -> TaskKind {
        self.controller.entry.task
    }

    fn start(&self, _seed: u64) -> Box<dyn Skill> {
        // These controllers draw nothing at random; the seed is for bundles that do.
        let run = self.controller.params.start();
        if self.controller.entry.object_frame == Some(CoordinateFrame::Tool) {
            return Box::new(ToolFrame(run));
        }
        run
    }
}

/// Takes the object's pose to be given in the tool's frame, as a camera on the hand would.
struct ToolFrame(Box<dyn Skill>);

impl Skill for ToolFrame {
    fn tick(&mut self, seen: &Observation) -> Command {
        let mut in_world = seen.clone();
        if let Some(object) = in_world.object_mut() {
            object.pose = Pose::from(&(seen.tool.isometry() * object.pose.isometry()));
        }
        self.0.tick(&in_world)
    }

    fn enter(&mut self, hook: Hook) {
        self.0.enter(hook);
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        let run = self.0.fork()?;
        Some(Box::new(Self(run)))
    }
}

#[cfg(test)]
mod tests;
