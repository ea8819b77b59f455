//! The cell everything is measured in: robot, scene and the published distributions.

use std::sync::Arc;

use holdpoint_body::{Geometry, Zone};
use holdpoint_sim::SimError;
use holdpoint_sim::distribution::Distribution;
use holdpoint_sim::robot::RobotModel;
use holdpoint_sim::scene::Scene;
use holdpoint_sim::world::World;

use holdpoint_governance::ids::Digest;

/// What the results of an episode depend on beside robot, scene and version: raised when the
/// simulation, a controller or the watcher changes what an episode gives.
pub const EPISODE_SEMANTICS: u32 = 3;

/// Robot, scene and distributions, shared by every worker.
#[derive(Clone)]
pub struct Cell {
    pub model: Arc<RobotModel>,
    /// Table, tray, zones, clutter.
    pub scene: Arc<Scene>,
    /// What a guard knows of the arm.
    pub geometry: Arc<Geometry>,
    /// What a guard knows of the scene.
    pub zones: Arc<[Zone]>,
    pub canonical: Arc<Distribution>,
    pub sandbox: Arc<Distribution>,
    /// The live world's, held out from the sandbox.
    pub live: Arc<Distribution>,
    digest: Digest,
}

/// Which published distribution an episode is drawn from.
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
    pub fn new(model: RobotModel) -> Result<Self, SimError> {
        let scene = Scene::cell()?;
        let canonical = Distribution::canonical()?;
        let sandbox = Distribution::sandbox()?;
        let live = Distribution::live()?;
        let describe = |name: &str, text: String| format!("{name}:{text}");
        let parts = [
            describe("robot", model.digest.to_string()),
            describe("scene", format!("{scene:?}")),
            describe("canonical", format!("{canonical:?}")),
            describe("sandbox", format!("{sandbox:?}")),
            describe("live", format!("{live:?}")),
            describe("semantics", EPISODE_SEMANTICS.to_string()),
        ];
        let bytes: Vec<&[u8]> = parts.iter().map(String::as_bytes).collect();
        let digest = Digest::of_parts("holdpoint.environment.v1", &bytes);
        Ok(Self {
            geometry: Arc::new(model.geometry.clone()),
            zones: scene.zones.clone().into(),
            model: Arc::new(model),
            scene: Arc::new(scene),
            canonical: Arc::new(canonical),
            sandbox: Arc::new(sandbox),
            live: Arc::new(live),
            digest,
        })
    }

    /// The default cell: the seven-axis arm.
    ///
    /// # Errors
    /// As [`Cell::new`].
    pub fn builtin() -> Result<Self, SimError> {
        Self::new(RobotModel::builtin("arm7")?)
    }

    /// Digest of robot, scene, distributions and episode semantics.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
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

    /// A new world of this cell.
    ///
    /// # Errors
    /// If the robot cannot be built.
    pub fn world(&self) -> Result<World, SimError> {
        World::new(&self.model, &self.scene)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evidence and cached episodes are bound to this digest. It covers the debug text of the scene and of the
    /// distributions, the types' names included: a renamed type must not void what is on record.
    #[test]
    fn the_digest_on_record_stays() {
        let digest = Cell::builtin().unwrap().digest().to_string();
        assert_eq!(digest, "c5e8e9b314875c5066d88bc07ab277fbb988d1d5418760b0198462407f3e3694");
    }
}
