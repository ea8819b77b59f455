//! The cell of every measurement: robot, scene and the published distributions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use holdpoint_body::disturbance::Drift;
use holdpoint_body::{FurtherObject, Geometry, TaskKind, Zone};
use holdpoint_cell::{
    CellError, CellFactory, CellSource, CellSpec, Distribution, LiveCell, Scene, TrialCell,
};

use holdpoint_governance::ids::Digest;
use holdpoint_governance::mode::{UnknownZone, ZoneName};
use holdpoint_governance::site::CellKind;
use holdpoint_governance::start_domain::StartDomain;
use holdpoint_runtime::capability::{Capability, PackageError, shown};
use holdpoint_text::Untrusted;

use crate::embedded;
use crate::site::LoadedSite;
use crate::unoffered_sensor::UnofferedSensor;

mod start_support;

/// Digest of what computes an episode in this build beside the cell: controllers, rules, their dependencies, the
/// compiler and the target (`build.rs`).
const COMPUTED_BY: &str = env!("HOLDPOINT_COMPUTED_BY");

/// Digest of what computes an episode in cells of a build. Results of another build are not evidence here.
#[must_use]
pub fn computed_by(cell_build: &str) -> String {
    Digest::of_parts("holdpoint.computed-by.v1", &[COMPUTED_BY.as_bytes(), cell_build.as_bytes()]).to_string()
}

/// Robot, scene and distributions, shared by every worker.
#[derive(Clone)]
pub struct Cell {
    factory: Arc<dyn CellFactory>,
    /// What the cell is and can do.
    pub spec: Arc<CellSpec>,
    /// The file the robot was read from; absent for a built-in one.
    pub robot_file: Option<PathBuf>,
    /// The site file; absent for the built-in site.
    pub site: Option<Arc<LoadedSite>>,
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
    /// What evidence of this cell covers of the start of each task, in the order of [`TaskKind::ALL`].
    starts: [Arc<StartDomain>; TaskKind::ALL.len()],
    computed_by: Arc<str>,
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
    /// The cell of a factory.
    ///
    /// # Errors
    /// If this program cannot work with its description, or its distributions cannot be read.
    pub fn new(factory: Arc<dyn CellFactory>) -> Result<Self, CellError> {
        let [canonical, sandbox, live] = factory.distributions()?;
        let spec = Arc::clone(factory.spec());
        spec.check(&spec.robot.name)?;
        let misnamed = spec.zones.iter().find_map(|zone| ZoneName::try_from(zone.name.as_str()).err());
        if let Some(problem) = misnamed {
            return Err(CellError::file(&spec.robot.name, "zones", problem.to_string()));
        }
        for distribution in [&canonical, &sandbox, &live] {
            distribution.check(&distribution.name)?;
        }
        let computed_by = computed_by(factory.build_digest());
        let digest = digest(&spec, [&canonical, &sandbox, &live], &computed_by);
        let starts = TaskKind::ALL.map(|task| {
            let start = task.declaration().start;
            Arc::new(start_support::start_domain(&spec, &sandbox, &live, start))
        });
        Ok(Self {
            geometry: Arc::clone(&spec.robot.geometry),
            zones: Arc::clone(&spec.zones),
            robot_file: None,
            site: None,
            scene: Arc::clone(&spec.scene),
            factory,
            spec,
            canonical: Arc::new(canonical),
            sandbox: Arc::new(sandbox),
            live: Arc::new(live),
            starts,
            computed_by: computed_by.into(),
            digest,
        })
    }

    /// The cell with the robot of this file; the source's default cell without one.
    ///
    /// # Errors
    /// As [`Cell::new`], or if the file cannot be read.
    pub fn of(source: &dyn CellSource, robot: Option<&Path>) -> Result<Self, CellError> {
        let Some(file) = robot else { return Self::new(source.builtin(None)?) };
        let cell = Self::new(source.load(file)?)?;
        // The store records it for a start from another folder.
        let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
        Ok(Self { robot_file: Some(file), ..cell })
    }

    /// The cell of a site, with the robot of this file if one is named; as [`Cell::of`] without a site.
    ///
    /// # Errors
    /// As [`Cell::of`], or if the source has no such built-in robot, or the cell cannot have an object of the site, or a
    /// baseline of the site names a zone that the cell does not have, or asks for a sensor that it does not offer; for a
    /// cell of another process also if it is not there or has another robot.
    pub fn at(
        source: &dyn CellSource,
        robot: Option<&Path>,
        site: Option<&Arc<LoadedSite>>,
    ) -> Result<Self, CellError> {
        let Some(site) = site else { return Self::of(source, robot) };
        let cell = match (robot, site.robot_file()) {
            (Some(file), _) => Self::of(source, Some(file))?,
            (None, Some(file)) => Self::of(source, Some(&file))?,
            (None, None) => Self::new(source.builtin(Some(&site.site.robot))?)?,
        };
        let cell = cell.with_objects(&shown(&site.file), &site.site.objects)?;
        let cell = match &site.site.sequence {
            Some(tasks) => cell.with_tasks(tasks),
            None => cell,
        };
        // The check of the file holds live and trial cells to one place.
        let cell = match (site.site.live.kind, &site.site.live.endpoint) {
            (CellKind::Simulated, _) | (CellKind::Wire, None) => cell,
            (CellKind::Wire, Some(endpoint)) => {
                let (named, file) = (&cell.spec.robot.name, cell.robot_file.clone());
                let far = Self::new(source.connect(endpoint)?)?;
                if far.spec.robot.name != *named {
                    let there = Untrusted::new(far.spec.robot.name.as_str());
                    let problem = format!("\"{named}\" is not the robot there, \"{}\"", there.line());
                    return Err(CellError::file(endpoint, "robot", problem));
                }
                let has_family = |task: TaskKind| {
                    site.site.families.iter().any(|family| family.name.as_str() == task.name())
                };
                if let Some(task) = far.spec.tasks.iter().find(|task| !has_family(**task)) {
                    let problem = format!("\"{task}\" has no family in the site file");
                    return Err(CellError::file(endpoint, "tasks", problem));
                }
                Self { robot_file: file, ..far }
            }
        };
        let cell = cell.with_site(Arc::clone(site));
        let unknown = site
            .baselines
            .iter()
            .find_map(|baseline| baseline.manifest.unknown_zone(&baseline.id().to_string(), &cell.zones));
        if let Some(UnknownZone { file, field, zone, allowed }) = unknown {
            let problem = format!("\"{zone}\" is no zone of the cell; allowed: {allowed}");
            return Err(CellError::file(&shown(&site.file), format!("{field} of {file}"), problem));
        }
        let unoffered = site.baselines.iter().find_map(|baseline| UnofferedSensor::of(baseline, &cell.spec));
        match unoffered {
            None => Ok(cell),
            Some(UnofferedSensor { file, value, allowed }) => {
                let problem = format!("\"{value}\" is no sensor of the cell; allowed: {allowed}");
                Err(CellError::file(&shown(&site.file), format!("wanted of {file}"), problem))
            }
        }
    }

    /// The same cell with further objects, which a file declares. Evidence of other objects does not count.
    fn with_objects(self, file: &str, objects: &BTreeMap<String, FurtherObject>) -> Result<Self, CellError> {
        if objects.is_empty() {
            return Ok(self);
        }
        let cell = Self::new(self.factory.with_objects(file, objects)?)?;
        Ok(Self { robot_file: self.robot_file, ..cell })
    }

    /// The same cell with another sequence of tasks. Evidence of another sequence does not count.
    fn with_tasks(self, tasks: &[TaskKind]) -> Self {
        let mut spec = CellSpec::clone(&self.spec);
        spec.tasks = tasks.to_vec();
        let digest = digest(&spec, [&self.canonical, &self.sandbox, &self.live], &self.computed_by);
        Self { spec: Arc::new(spec), digest, ..self }
    }

    /// The same cell at a site. Evidence of another site does not count.
    #[must_use]
    pub fn with_site(self, site: Arc<LoadedSite>) -> Self {
        let digest = site.on_record().map_or(self.digest, |site| site.bound(self.digest));
        Self { digest, site: Some(site), ..self }
    }

    /// The first versions of the site's families: those of its file, else the embedded ones.
    ///
    /// # Errors
    /// If an embedded one does not load.
    pub fn baselines(&self) -> Result<Vec<Capability>, PackageError> {
        self.site.as_ref().map_or_else(embedded::baselines, |site| Ok(site.baselines.clone()))
    }

    /// The site file, safe to print; absent for the built-in site.
    #[must_use]
    pub fn site_file(&self) -> Option<String> {
        self.site.as_ref().and_then(|site| site.on_record()).map(|site| shown(&site.file))
    }

    /// Digest of what computes episodes here: this build and that of the cell.
    #[must_use]
    pub fn computed_by(&self) -> &str {
        &self.computed_by
    }

    /// Digest of robot, scene, distributions, site and of what computes episodes ([`Cell::computed_by`]).
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }

    /// What evidence of this cell covers of the start of a task.
    #[must_use]
    pub const fn start_domain(&self, task: TaskKind) -> &Arc<StartDomain> {
        &self.starts[task as usize]
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
    pub fn with_sandbox(&self, sandbox: Distribution) -> Self {
        Self { sandbox: Arc::new(sandbox), ..self.clone() }
    }

    /// The same cell with the current conditions of the live cell in its sandbox, and a digest of its own.
    #[must_use]
    pub fn with_live_sandbox(&self, live: &Arc<Distribution>) -> Self {
        let digest = digest(&self.spec, [&self.canonical, live, live], &self.computed_by);
        let on_record = self.site.as_ref().and_then(|site| site.on_record());
        let digest = on_record.map_or(digest, |site| site.bound(digest));
        Self { sandbox: Arc::clone(live), live: Arc::clone(live), digest, ..self.clone() }
    }

    /// A distribution of this cell after a drift.
    ///
    /// # Errors
    /// If the cell has no such drift.
    pub fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
        self.factory.with_drift(of, drift)
    }

    /// A new live cell of this description.
    ///
    /// # Errors
    /// If it cannot be built.
    pub fn live_cell(&self) -> Result<Box<dyn LiveCell>, CellError> {
        self.factory.live()
    }

    /// A new trial cell of this description.
    ///
    /// # Errors
    /// If it cannot be built.
    pub fn trial(&self) -> Result<Box<dyn TrialCell>, CellError> {
        self.factory.trial()
    }
}

fn digest(spec: &CellSpec, distributions: [&Distribution; 3], computed_by: &str) -> Digest {
    let [canonical, sandbox, live] = distributions;
    // The debug text contains type names; a build with other names has another digest in any case.
    let describe = |name: &str, distribution: &Distribution| format!("{name}:{distribution:?}").into_bytes();
    let parts = [
        spec.digest().to_vec(),
        describe("canonical", canonical),
        describe("sandbox", sandbox),
        describe("live", live),
        computed_by.as_bytes().to_vec(),
    ];
    let bytes: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
    Digest::of_parts("holdpoint.environment.v3", &bytes)
}

#[cfg(test)]
mod tests {
    use holdpoint_sim::SimCells;

    use super::*;

    /// The simulated cells under another description.
    struct Described {
        spec: Arc<CellSpec>,
        simulated: Arc<dyn CellFactory>,
    }

    impl CellFactory for Described {
        fn spec(&self) -> &Arc<CellSpec> {
            &self.spec
        }
        fn build_digest(&self) -> &str {
            self.simulated.build_digest()
        }
        fn distributions(&self) -> Result<[Distribution; 3], CellError> {
            self.simulated.distributions()
        }
        fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
            self.simulated.with_drift(of, drift)
        }
        fn live(&self) -> Result<Box<dyn LiveCell>, CellError> {
            self.simulated.live()
        }
        fn trial(&self) -> Result<Box<dyn TrialCell>, CellError> {
            self.simulated.trial()
        }
    }

    /// The rate is that of this program, and the tasks can follow each other, for every maker of cells.
    #[test]
    fn cell_that_this_program_cannot_work_with_is_refused() {
        let simulated = SimCells.builtin(None).unwrap();
        let refused = |change: fn(&mut CellSpec)| {
            let mut spec = CellSpec::clone(simulated.spec());
            change(&mut spec);
            let factory = Described { spec: Arc::new(spec), simulated: Arc::clone(&simulated) };
            let error = Cell::new(Arc::new(factory)).err()?;
            let CellError::File { element, .. } = error else { panic!("{error}") };
            Some(element)
        };
        assert_eq!(refused(|_| {}), None);
        assert_eq!(refused(|spec| spec.rate_hz = 1000).as_deref(), Some("rate_hz"));
        let renamed = refused(|spec| {
            let mut scene = Scene::clone(&spec.scene);
            scene.zones[1].name = "Tray 2".to_owned();
            (spec.zones, spec.scene) = (scene.zones.clone().into(), Arc::new(scene));
        });
        assert_eq!(renamed.as_deref(), Some("zones"));
        // Of a cell without an alignment.
        assert_eq!(refused(|spec| spec.tasks = vec![TaskKind::Grasp, TaskKind::Place]), None);
        assert_eq!(refused(|spec| spec.tasks.clear()).as_deref(), Some("tasks"));
        assert_eq!(refused(|spec| spec.tasks = vec![TaskKind::Align]).as_deref(), Some("tasks"));
        assert_eq!(refused(|spec| spec.tasks.insert(1, TaskKind::Grasp)).as_deref(), Some("tasks"));
    }

    /// Cells of another process, with these tasks.
    struct CellsElsewhere(Vec<TaskKind>);

    impl CellSource for CellsElsewhere {
        fn builtin(&self, robot: Option<&str>) -> Result<Arc<dyn CellFactory>, CellError> {
            SimCells.builtin(robot)
        }
        fn load(&self, robot: &Path) -> Result<Arc<dyn CellFactory>, CellError> {
            SimCells.load(robot)
        }
        fn connect(&self, _: &str) -> Result<Arc<dyn CellFactory>, CellError> {
            let simulated = SimCells.builtin(None)?;
            let mut spec = CellSpec::clone(simulated.spec());
            spec.tasks.clone_from(&self.0);
            Ok(Arc::new(Described { spec: Arc::new(spec), simulated }))
        }
    }

    #[test]
    fn a_cell_of_another_process_needs_a_family_for_each_of_its_tasks() {
        let folder = tempfile::tempdir().unwrap();
        let text = std::fs::read_to_string(Path::new(crate::MANIFESTS).join("site.toml")).unwrap();
        let align = "[[families]]\nname = \"align\"\nbaseline = \"align/1.0.0\"\nfallback = \"park\"\n\n";
        assert!(text.contains(align));
        let wire = "kind = \"wire\"\nendpoint = \"unix:/run/cell.sock\"";
        let file = folder.path().join("site.toml");
        std::fs::write(&file, text.replace(align, "").replace("kind = \"simulated\"", wire)).unwrap();
        let site = Arc::new(LoadedSite::read(&file).unwrap());
        let of = |tasks: &[TaskKind]| Cell::at(&CellsElsewhere(tasks.to_vec()), None, Some(&site));
        let without_align = of(&[TaskKind::Grasp, TaskKind::Place]).unwrap();
        assert_eq!(without_align.spec.tasks, [TaskKind::Grasp, TaskKind::Place]);
        let refused = of(&TaskKind::SEQUENCE).err().unwrap().to_string();
        assert!(refused.contains("tasks") && refused.contains("\"align\""), "{refused}");
    }

    /// Evidence and cached results are bound to the digest, so it must cover everything that an episode depends on.
    #[test]
    fn another_robot_or_another_build_is_another_cell() {
        let of = |robot| Cell::new(SimCells.builtin(robot).unwrap()).unwrap();
        let (seven, six) = (of(None), of(Some("arm6")));
        assert_eq!(seven.digest(), of(Some("arm7")).digest());
        assert_ne!(seven.digest(), six.digest());
        assert_eq!(COMPUTED_BY.len(), 64, "the build script names the build: {COMPUTED_BY:?}");
        assert_eq!(seven.computed_by(), computed_by(holdpoint_sim::BUILD));
        let conditions = [&*seven.canonical, &*seven.sandbox, &*seven.live];
        assert_eq!(seven.digest(), digest(&seven.spec, conditions, seven.computed_by()));
        assert_ne!(seven.digest(), digest(&seven.spec, conditions, &computed_by("another cell's build")));
    }
}
