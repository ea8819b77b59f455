//! The cell of every measurement: robot, scene and the published distributions.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use holdpoint_body::{Geometry, TaskKind, Zone};
use holdpoint_cell::CellError;
use holdpoint_cell::Distribution;
use holdpoint_cell::Scene;
use holdpoint_sim::robot::RobotModel;
use holdpoint_sim::world::World;

use holdpoint_governance::ids::Digest;
use holdpoint_governance::start_domain::StartDomain;

mod start_support;

/// Digest of what computes an episode in this build: simulator, controllers, rules, their dependencies, the compiler
/// and the target (`build.rs`). Results of another build are not evidence here.
pub const COMPUTED_BY: &str = env!("HOLDPOINT_COMPUTED_BY");

/// Digest of what decides in this build: [`COMPUTED_BY`], the stages, the record and the profiles. Cached decisions of
/// an experiment are bound to it.
pub const DECIDED_BY: &str = env!("HOLDPOINT_DECIDED_BY");

/// Robot, scene and distributions, shared by every worker.
#[derive(Clone)]
pub struct Cell {
    pub model: Arc<RobotModel>,
    /// The file the robot was read from; absent for a built-in one.
    pub robot_file: Option<PathBuf>,
    /// Table, tray, zones, clutter.
    pub scene: Arc<Scene>,
    /// The geometry of the arm, for the guard.
    pub geometry: Arc<Geometry>,
    /// The zones of the scene, for the guard.
    pub zones: Arc<[Zone]>,
    pub canonical: Arc<Distribution>,
    pub sandbox: Arc<Distribution>,
    /// The live cell's distribution, held out from the sandbox.
    pub live: Arc<Distribution>,
    /// What evidence of this cell covers of the start of each task, in the order of [`TaskKind::SEQUENCE`].
    starts: [Arc<StartDomain>; 3],
    digest: Digest,
}

/// The published distribution that an episode is sampled from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Conditions {
    Canonical,
    Sandbox,
    Live,
}

impl Conditions {
    /// The name in records and cache keys.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Canonical => "canonical",
            Self::Sandbox => "sandbox",
            Self::Live => "live",
        }
    }
}

impl Cell {
    /// The embedded scene and distributions with a robot.
    ///
    /// # Errors
    /// If an embedded file does not parse, or the robot does not fit the scene.
    pub fn new(model: RobotModel) -> Result<Self, CellError> {
        let scene = holdpoint_sim::published::scene()?;
        let canonical = holdpoint_sim::published::canonical()?;
        let sandbox = holdpoint_sim::published::sandbox()?;
        let live = holdpoint_sim::published::live()?;
        let digest = digest(&model, &scene, [&canonical, &sandbox, &live], COMPUTED_BY);
        let starts = TaskKind::SEQUENCE
            .map(|task| Arc::new(start_support::start_domain(&model, &scene, &sandbox, &live, task)));
        Ok(Self {
            geometry: Arc::new(model.geometry.clone()),
            zones: scene.zones.clone().into(),
            model: Arc::new(model),
            robot_file: None,
            scene: Arc::new(scene),
            canonical: Arc::new(canonical),
            sandbox: Arc::new(sandbox),
            live: Arc::new(live),
            starts,
            digest,
        })
    }

    /// The cell with the robot of this file; the seven-axis arm without one.
    ///
    /// # Errors
    /// As [`Cell::new`], or if the file cannot be read.
    pub fn of(robot: Option<&Path>) -> Result<Self, CellError> {
        let Some(file) = robot else { return Self::builtin() };
        let cell = Self::new(RobotModel::load(file)?)?;
        // The store records it for a start from another folder.
        let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
        Ok(Self { robot_file: Some(file), ..cell })
    }

    /// The default cell: the seven-axis arm.
    ///
    /// # Errors
    /// As [`Cell::new`].
    pub fn builtin() -> Result<Self, CellError> {
        Self::new(RobotModel::builtin("arm7")?)
    }

    /// Digest of robot, scene, distributions and of what computes episodes ([`COMPUTED_BY`]).
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// What evidence of this cell covers of the start of a task.
    #[must_use]
    pub const fn start_domain(&self, task: TaskKind) -> &Arc<StartDomain> {
        let [grasp, align, place] = &self.starts;
        match task {
            TaskKind::Grasp => grasp,
            TaskKind::Align => align,
            TaskKind::Place => place,
        }
    }

    /// A distribution by name.
    #[must_use]
    pub fn distribution(&self, conditions: Conditions) -> &Distribution {
        match conditions {
            Conditions::Canonical => &self.canonical,
            Conditions::Sandbox => &self.sandbox,
            Conditions::Live => &self.live,
        }
    }

    /// The same cell with a part of its sandbox's distribution. Its digest is that of the whole cell, so results from it
    /// must not be cached under that digest.
    #[must_use]
    pub(crate) fn with_sandbox(&self, sandbox: Distribution) -> Self {
        Self { sandbox: Arc::new(sandbox), ..self.clone() }
    }

    /// The same cell with the current conditions of the live cell in its sandbox, and a digest of its own.
    #[must_use]
    pub(crate) fn with_live_sandbox(&self, live: &Arc<Distribution>) -> Self {
        let digest = digest(&self.model, &self.scene, [&self.canonical, live, live], COMPUTED_BY);
        Self { sandbox: Arc::clone(live), live: Arc::clone(live), digest, ..self.clone() }
    }

    /// A new world of this cell.
    ///
    /// # Errors
    /// If the robot cannot be built.
    pub fn world(&self) -> Result<World, CellError> {
        World::new(&self.model, &self.scene)
    }
}

fn digest(model: &RobotModel, scene: &Scene, distributions: [&Distribution; 3], computed_by: &str) -> Digest {
    let [canonical, sandbox, live] = distributions;
    let describe = |name: &str, text: String| format!("{name}:{text}");
    // The debug text contains type names; a build with other names has another digest in any case.
    let parts = [
        describe("robot", model.digest.to_string()),
        describe("scene", format!("{scene:?}")),
        describe("canonical", format!("{canonical:?}")),
        describe("sandbox", format!("{sandbox:?}")),
        describe("live", format!("{live:?}")),
        describe("computed by", computed_by.to_owned()),
    ];
    let bytes: Vec<&[u8]> = parts.iter().map(String::as_bytes).collect();
    Digest::of_parts("holdpoint.environment.v2", &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evidence and cached results are bound to the digest, so it must cover everything that an episode depends on.
    #[test]
    fn another_robot_or_another_build_is_another_cell() {
        let (seven, six) =
            (Cell::builtin().unwrap(), Cell::new(RobotModel::builtin("arm6").unwrap()).unwrap());
        assert_eq!(seven.digest(), Cell::builtin().unwrap().digest());
        assert_ne!(seven.digest(), six.digest());
        assert_eq!(COMPUTED_BY.len(), 64, "the build script names the build: {COMPUTED_BY:?}");
        let other =
            digest(&seven.model, &seven.scene, [&seven.canonical, &seven.sandbox, &seven.live], "another");
        assert_ne!(seven.digest(), other);
    }
}
