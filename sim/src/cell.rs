//! The simulated cell behind the ports of [`holdpoint_cell`]: a world as live cell and as trial cell, and its sources.

use std::any::Any;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use holdpoint_body::disturbance::Drift;
use holdpoint_body::{FurtherObject, NamedReading, ObjectName, RATE_HZ, ReadingVec, TaskKind};
use holdpoint_cell::film::EpisodeFrame;
use holdpoint_cell::spec::{
    Abilities, CellObject, CellSpec, ObjectKind, PartShape, PlacedShape, RobotSpec, SensorSpec,
};
use holdpoint_cell::truth::{ContactPoint, TrueState};
use holdpoint_cell::{
    CellCopy, CellError, CellFactory, CellSource, Distribution, EpisodeSetup, FixtureBox, InjectedFault,
    LiveCell, RobotCell, Scene, StateImage, TrialCell, WorkCall,
};

use nalgebra::Isometry3;

use crate::further::{self, NamedObject};
use crate::perception::CAMERA_HZ;
use crate::published;
use crate::robot::{RobotModel, shapes};
use crate::world::{World, WorldConfig, WorldCopy};

/// Digest of what computes the simulated cell in this build (`build.rs`).
pub const BUILD: &str = env!("HOLDPOINT_SIM_BUILD");

/// The robot that a cell has if none is named.
const DEFAULT_ROBOT: &str = "arm7";

/// Episodes of each distribution that are tried for a place of further objects.
const STARTS_TRIED: u64 = 64;

/// The cube and the tray, under the names that the tasks have for them, and the further objects.
fn objects(scene: &Scene, further: &[NamedObject]) -> Vec<CellObject> {
    let edge = scene.object.half_m;
    let outside = edge + scene.tray.clearance_m + scene.tray.wall_m;
    let declared = TaskKind::SEQUENCE[0].declaration();
    [
        (declared.object, ObjectKind::Workpiece, [edge; 3]),
        (declared.target, ObjectKind::Place, [outside, outside, 0.5 * scene.tray.wall_top_m]),
    ]
    .into_iter()
    // A declared name is short enough: a test of the tasks holds them to it.
    .filter_map(|(name, kind, half_m)| Some(CellObject { name: ObjectName::from(name).ok()?, kind, half_m }))
    .chain(further.iter().map(|(name, object)| CellObject {
        name: *name,
        kind: ObjectKind::Further(*object),
        half_m: object.shape.half_m(),
    }))
    .collect()
}

/// The sensor of the two pads: the normal force of the object on each, first that of the first finger.
fn sensors() -> Vec<SensorSpec> {
    let pads = |name| SensorSpec { name, length: 2, unit: "N".to_owned(), rate_hz: RATE_HZ };
    ObjectName::from("pad-forces").map(pads).into_iter().collect()
}

/// What it measured in a tick. One amplifier serves both pads, so their mean is the force of the gripper.
pub(crate) fn readings(spec: &CellSpec, pads_n: [f64; 2]) -> ReadingVec {
    let read = |offered: &SensorSpec| NamedReading {
        name: offered.name,
        age_ticks: 0,
        values: pads_n.into_iter().collect(),
    };
    spec.sensors.iter().map(read).collect()
}

/// What the simulated cell of a robot, a scene and further objects is.
pub(crate) fn cell_spec(robot: &RobotModel, scene: &Arc<Scene>, further: &[NamedObject]) -> CellSpec {
    let parts = shapes(&robot.links, &robot.gripper).into_iter().map(|(piece, at, shape)| PlacedShape {
        piece,
        pose: at.isometry(),
        shape: PartShape::Primitive(shape),
    });
    let [first, second] = &robot.gripper.fingers;
    CellSpec {
        robot: RobotSpec {
            name: robot.name.clone(),
            digest: robot.digest,
            geometry: Arc::new(robot.geometry.clone()),
            parts: parts.collect(),
            home: robot.home.clone(),
            fingers: [first.origin, second.origin],
            width_max_m: robot.gripper.width_max_m(),
        },
        zones: scene.zones.clone().into(),
        objects: objects(scene, further),
        sensors: sensors(),
        tasks: TaskKind::SEQUENCE.to_vec(),
        rate_hz: RATE_HZ,
        camera_hz: CAMERA_HZ,
        abilities: Abilities { export_state: true, set_observed: false, film: true, referee: true },
        scene: Arc::clone(scene),
    }
}

impl RobotCell for World {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.spec
    }

    fn tick(&self) -> u64 {
        World::tick(self)
    }

    fn begin_task(&mut self, task: TaskKind) {
        World::begin_task(self, task);
    }

    fn shown_object(&self) -> Isometry3<f64> {
        self.object().0
    }

    fn stop_declared(&self) -> Option<u64> {
        World::stop_declared(self)
    }

    fn copy(&self) -> Result<CellCopy, CellError> {
        Ok(CellCopy::in_memory(World::tick(self), World::copy(self)))
    }

    fn export(&self) -> Result<StateImage, CellError> {
        StateImage::new(self.snapshot()?)
    }

    fn truth(&self) -> Option<TrueState<'_>> {
        Some(self.true_state())
    }

    fn fixtures(&self) -> Vec<FixtureBox> {
        World::fixtures(self)
    }

    fn contact_points(&self) -> Vec<ContactPoint> {
        World::contact_points(self)
    }
}

impl LiveCell for World {
    fn await_work(&mut self, call: &WorkCall<'_>) -> Result<(), CellError> {
        let setup = EpisodeSetup::sample(TaskKind::Grasp, self.scene(), call.conditions, call.seed);
        World::reset(self, &setup)
    }

    fn inject(&mut self, fault: InjectedFault) -> Result<(), CellError> {
        World::inject(self, fault);
        Ok(())
    }
}

impl TrialCell for World {
    fn reset(&mut self, setup: &EpisodeSetup) -> Result<(), CellError> {
        World::reset(self, setup)
    }

    fn go_on_from(&mut self, copy: &CellCopy) -> Result<(), CellError> {
        match (copy.memory::<WorldCopy>(), copy.image()) {
            (Some(copy), _) => World::go_on_from(self, copy),
            (None, Some(image)) => self.import(image),
            (None, None) => Err(CellError::Snapshot("it is a state of another kind of cell".to_owned())),
        }
    }

    fn import(&mut self, image: &StateImage) -> Result<(), CellError> {
        self.restore(image.bytes())
    }

    fn inject(&mut self, fault: InjectedFault) {
        World::inject(self, fault);
    }

    fn true_state(&self) -> TrueState<'_> {
        let (object, object_speed_m_s) = self.object();
        TrueState { joints: self.joints(), forces: self.forces(), object, object_speed_m_s }
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn film(&mut self) {
        World::film(self);
    }

    fn take_film(&mut self) -> Vec<EpisodeFrame> {
        World::take_film(self)
    }
}

/// Builds simulated cells of one robot in the published scene.
pub struct SimFactory {
    robot: RobotModel,
    scene: Scene,
    objects: BTreeMap<String, FurtherObject>,
    spec: Arc<CellSpec>,
}

impl SimFactory {
    /// The cells of a robot.
    ///
    /// # Errors
    /// [`CellError::File`] if the embedded scene were wrong.
    pub fn new(robot: RobotModel) -> Result<Self, CellError> {
        let scene = published::scene()?;
        let spec = Arc::new(cell_spec(&robot, &Arc::new(scene.clone()), &[]));
        Ok(Self { robot, scene, objects: BTreeMap::new(), spec })
    }

    fn world(&self) -> Result<World, CellError> {
        World::with_objects(&self.robot, &self.scene, &self.objects, WorldConfig::default())
    }
}

impl CellFactory for SimFactory {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.spec
    }

    fn build_digest(&self) -> &str {
        BUILD
    }

    fn distributions(&self) -> Result<[Distribution; 3], CellError> {
        Ok([published::canonical()?, published::sandbox()?, published::live()?])
    }

    fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
        published::with_drift(of, drift)
    }

    fn with_objects(
        &self,
        file: &str,
        objects: &BTreeMap<String, FurtherObject>,
    ) -> Result<Arc<dyn CellFactory>, CellError> {
        let further = further::check(file, &self.scene, objects)?;
        for distribution in self.distributions()? {
            for seed in 0..STARTS_TRIED {
                let setup = EpisodeSetup::sample(TaskKind::Grasp, &self.scene, &distribution, seed);
                // Else some episodes, the live cell's too, would not start.
                further::starts(&further, &self.scene, &setup)
                    .map_err(|error| CellError::file(file, "objects", error.to_string()))?;
            }
        }
        let (robot, scene) = (self.robot.clone(), self.scene.clone());
        let spec = Arc::new(cell_spec(&robot, &self.spec.scene, &further));
        Ok(Arc::new(Self { robot, scene, objects: objects.clone(), spec }))
    }

    fn live(&self) -> Result<Box<dyn LiveCell>, CellError> {
        Ok(Box::new(self.world()?))
    }

    fn trial(&self) -> Result<Box<dyn TrialCell>, CellError> {
        Ok(Box::new(self.world()?))
    }
}

/// The simulated cells: those of the built-in robots, and of robots in files.
pub struct SimCells;

impl CellSource for SimCells {
    fn builtin(&self, robot: Option<&str>) -> Result<Arc<dyn CellFactory>, CellError> {
        Ok(Arc::new(SimFactory::new(RobotModel::builtin(robot.unwrap_or(DEFAULT_ROBOT))?)?))
    }

    fn load(&self, robot: &Path) -> Result<Arc<dyn CellFactory>, CellError> {
        Ok(Arc::new(SimFactory::new(RobotModel::load(robot)?)?))
    }
}
