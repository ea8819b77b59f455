//! A scripted cell for tests of the ports: its arm never moves, and it has only the abilities that a test gives it.

use std::any::Any;
use std::sync::{Arc, Mutex};

use holdpoint_body::disturbance::Drift;
use holdpoint_body::{
    Body, BodyError, Command, Contacts, GuardVerdict, Interrupt, JointVec, ObjectVec, Observation, Pose,
    ReadingVec, TaskKind, Telemetry, Twist,
};
use holdpoint_cell::spec::Abilities;
use holdpoint_cell::truth::{ContactForces, JointState, TrueState};
use holdpoint_cell::{
    CellCopy, CellError, CellFactory, CellSource as _, CellSpec, Distribution, EpisodeSetup, InjectedFault,
    LiveCell, RobotCell, StateImage, TrialCell, WorkCall,
};
use holdpoint_sim::{SimCells, published};
use nalgebra::Isometry3;

use super::listener::Listener as _;
use super::shadow::Shadow;
use holdpoint_runtime::task::{TaskRecord, Tick};
use holdpoint_trials::cell::Cell;

mod tests;

/// What the engine asked of a live cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FakeCall {
    AwaitWork { seed: u64 },
    BeginTask(TaskKind),
    EndTask,
}

/// A script of fake cells.
#[derive(Clone)]
pub(crate) struct StubFactory {
    pub(crate) spec: Arc<CellSpec>,
    pub(crate) build: String,
    /// The live cell is given no work.
    pub(crate) is_starved: bool,
    /// The live cell does not answer.
    pub(crate) is_lost: bool,
    /// How far the first joint is off in a trial cell that is set to an observation.
    pub(crate) set_error_rad: f64,
    pub(crate) calls: Arc<Mutex<Vec<FakeCall>>>,
}

impl StubFactory {
    /// Cells of the built-in arm that export nothing.
    pub(crate) fn new() -> Self {
        let spec = CellSpec {
            abilities: Abilities { export_state: false, set_observed: false, film: false, referee: false },
            ..CellSpec::clone(SimCells.builtin(None).unwrap().spec())
        };
        Self {
            spec: Arc::new(spec),
            build: "fake".to_owned(),
            is_starved: false,
            is_lost: false,
            set_error_rad: 0.0,
            calls: Arc::default(),
        }
    }

    /// Cells of the built-in arm that export their state.
    pub(crate) fn exporting() -> Self {
        let mut factory = Self::new();
        Arc::make_mut(&mut factory.spec).abilities.export_state = true;
        factory
    }

    /// Cells of the built-in arm that export nothing; a trial cell is set to an observation, with this error of a joint.
    pub(crate) fn observing(set_error_rad: f64) -> Self {
        let mut factory = Self { set_error_rad, ..Self::new() };
        Arc::make_mut(&mut factory.spec).abilities.set_observed = true;
        factory
    }

    /// The cell as the engine is given it.
    pub(crate) fn into_cell(self) -> Cell {
        Cell::new(Arc::new(self)).unwrap()
    }

    fn cell(&self) -> StubCell {
        let joints = JointState { q: self.spec.robot.home.clone(), ..JointState::default() };
        StubCell {
            script: self.clone(),
            tick: 0,
            task: TaskKind::Grasp,
            stop_declared: None,
            joints,
            forces: ContactForces::default(),
        }
    }
}

impl CellFactory for StubFactory {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.spec
    }
    fn build_digest(&self) -> &str {
        &self.build
    }
    fn distributions(&self) -> Result<[Distribution; 3], CellError> {
        Ok([published::canonical()?, published::sandbox()?, published::live()?])
    }
    fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
        published::with_drift(of, drift)
    }
    fn live(&self) -> Result<Box<dyn LiveCell>, CellError> {
        Ok(Box::new(self.cell()))
    }
    fn trial(&self) -> Result<Box<dyn TrialCell>, CellError> {
        Ok(Box::new(self.cell()))
    }
}

struct StubCell {
    script: StubFactory,
    tick: u64,
    task: TaskKind,
    stop_declared: Option<u64>,
    joints: JointState,
    forces: ContactForces,
}

impl StubCell {
    fn note(&self, call: FakeCall) {
        self.script.calls.lock().unwrap().push(call);
    }

    fn still(&self) -> JointVec {
        self.joints.q.iter().map(|_| 0.0).collect()
    }

    fn tool(&self) -> Pose {
        Pose::from(&self.script.spec.robot.geometry.tool_pose(&self.joints.q))
    }

    fn seen(&self, last: GuardVerdict) -> Observation {
        Observation {
            tick: self.tick,
            q: self.joints.q.clone(),
            dq: self.still(),
            tau: self.still(),
            tool: self.tool(),
            tool_twist: Twist::default(),
            gripper_width_m: self.script.spec.robot.width_max_m,
            gripper_force_n: 0.0,
            wrist_force_n: 0.0,
            objects: ObjectVec::new(),
            sensors: ReadingVec::new(),
            tool_available: true,
            goal: self.task,
            guard: last,
        }
    }
}

impl Body for StubCell {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        self.seen(last)
    }
    fn telemetry(&self) -> Telemetry {
        Telemetry {
            tick: self.tick,
            q: self.joints.q.clone(),
            dq: self.still(),
            tracking_error_rad: 0.0,
            tool: self.tool(),
            tool_speed_m_s: 0.0,
            gripper_width_m: self.script.spec.robot.width_max_m,
            gripper_force_n: 0.0,
            contact_force_n: 0.0,
            contacts: Contacts::default(),
            slip_m: None,
            picture_age_ticks: None,
            tool_available: true,
        }
    }
    fn step(&mut self, _: &Command) -> Result<(), BodyError> {
        self.tick += 1;
        Ok(())
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        self.stop_declared = match interrupt {
            Interrupt::Stop => self.stop_declared.or(Some(self.tick)),
            Interrupt::Release => None,
        };
    }
    fn inspect(&self) -> bool {
        false
    }
}

impl RobotCell for StubCell {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.script.spec
    }
    fn tick(&self) -> u64 {
        self.tick
    }
    fn begin_task(&mut self, task: TaskKind) {
        self.task = task;
        self.note(FakeCall::BeginTask(task));
    }
    fn end_task(&mut self) {
        self.note(FakeCall::EndTask);
    }
    fn shown_object(&self) -> Isometry3<f64> {
        Isometry3::identity()
    }
    fn stop_declared(&self) -> Option<u64> {
        self.stop_declared
    }
    fn export(&self) -> Result<StateImage, CellError> {
        if self.script.spec.abilities.export_state {
            StateImage::new(self.tick.to_le_bytes().to_vec())
        } else {
            Err(CellError::Unable("export its state"))
        }
    }
    fn observed(&self) -> Option<Observation> {
        self.script.spec.abilities.set_observed.then(|| self.seen(GuardVerdict::Allowed))
    }
}

impl LiveCell for StubCell {
    fn await_work(&mut self, call: &WorkCall<'_>) -> Result<(), CellError> {
        self.note(FakeCall::AwaitWork { seed: call.seed });
        if self.script.is_lost {
            return Err(CellError::Body(BodyError::Lost("gone".to_owned())));
        }
        if self.script.is_starved {
            return Err(CellError::InvalidStart { seed: call.seed, problem: "no work".to_owned() });
        }
        self.tick = 0;
        Ok(())
    }
}

impl TrialCell for StubCell {
    fn reset(&mut self, _: &EpisodeSetup) -> Result<(), CellError> {
        self.tick = 0;
        Ok(())
    }
    fn go_on_from(&mut self, copy: &CellCopy) -> Result<(), CellError> {
        let none = || CellError::Snapshot("it has no image".to_owned());
        self.import(copy.image().ok_or_else(none)?)
    }
    fn import(&mut self, image: &StateImage) -> Result<(), CellError> {
        let wrong = |_| CellError::Snapshot("it is no tick".to_owned());
        self.tick = u64::from_le_bytes(image.bytes().try_into().map_err(wrong)?);
        Ok(())
    }
    fn set_to(&mut self, observed: &Observation) -> Result<(), CellError> {
        if !self.script.spec.abilities.set_observed {
            return Err(CellError::Unable("be set to an observation"));
        }
        self.tick = observed.tick;
        self.joints.q.clone_from(&observed.q);
        if let Some(first) = self.joints.q.first_mut() {
            *first += self.script.set_error_rad;
        }
        Ok(())
    }
    fn inject(&mut self, _: InjectedFault) {}
    fn true_state(&self) -> TrueState<'_> {
        let (joints, forces) = (&self.joints, &self.forces);
        TrueState { joints, forces, object: Isometry3::identity(), object_speed_m_s: 0.0 }
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
}

/// A live task that a candidate is in shadow of: the active version commands nothing in three ticks, and is done.
pub(crate) fn stand_still(shadow: &mut Shadow, cell: &Cell, seed: u64) -> TaskRecord {
    let task = shadow.task();
    let mut live = cell.live_cell().unwrap();
    live.begin_task(task);
    shadow.before_task(live.as_ref(), task, seed);
    let (observation, seen) = (live.observe(GuardVerdict::Allowed), live.telemetry());
    for tick in 1..=3 {
        let passed = Tick {
            tick,
            observation: &observation,
            command: &Command::Hold,
            seen: &seen,
            raised: &[],
            checked: None,
            measured: None,
            settling: false,
        };
        shadow.tick(live.as_ref(), task, &passed);
    }
    TaskRecord { success: true, invalid: false, ..TaskRecord::refused(task, seed) }
}
