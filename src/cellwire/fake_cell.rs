//! A small cell for tests: two joints that follow their setpoints, and quirks that break a promise of the ports.

use std::any::Any;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use holdpoint_body::chain::{Chain, JointSpec, Transform};
use holdpoint_body::clearance::ClearanceModel;
use holdpoint_body::disturbance::Drift;
use holdpoint_body::{
    Body, BodyError, Command, Contacts, Estimate, Geometry, GuardVerdict, Interrupt, JointVec, NamedReading,
    ObjectName, Observation, Pose, RATE_HZ, Shape, TICK_SECS, TaskKind, Telemetry, Twist,
};
use holdpoint_cell::film::EpisodeFrame;
use holdpoint_cell::spec::{
    Abilities, CellObject, ObjectKind, PartShape, PlacedShape, RobotSpec, SensorSpec,
};
use holdpoint_cell::truth::{ContactForces, ContactPoint, JointState, TrueState};
use holdpoint_cell::{
    CellCopy, CellError, CellFactory, CellSpec, Distribution, EpisodeSetup, FixtureBox, InjectedFault,
    LiveCell, RobotCell, Scene, StateImage, TrialCell, WorkCall,
};
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::client::Connect;
use crate::endpoint::EndpointStream;
use crate::framing::{decode, encode};
use crate::server::CellServer;

/// A promise that a cell breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quirk {
    Honest,
    /// A joint speed is no number from tick 3 on.
    TellsNaN,
    /// Two ticks pass in a step.
    SkipsTicks,
    /// It tells one joint more than it has.
    TellsThreeJoints,
    /// A reset is another one each time.
    ForgetsSeeds,
    /// What it exports is not all of its state.
    ExportsHalf,
    /// It carries out commands that are no number.
    TakesNaN,
    /// A stop has no effect.
    IgnoresStop,
    /// The tool is elsewhere than the joints say.
    MovesTool,
    /// An object has a name that the description does not have.
    NamesOthers,
}

pub(crate) struct FakeFactory {
    spec: Arc<CellSpec>,
    quirk: Quirk,
    resets: Arc<AtomicU64>,
}

impl FakeFactory {
    pub(crate) fn new(quirk: Quirk) -> Self {
        Self { spec: Arc::new(spec()), quirk, resets: Arc::default() }
    }

    pub(crate) fn cell(&self) -> FakeCell {
        let state = FakeState {
            tick: 0,
            task_start: 0,
            task: TaskKind::Grasp,
            q: self.spec.robot.home.clone(),
            dq: self.spec.robot.home.iter().map(|_| 0.0).collect(),
            target: None,
            guard: GuardVerdict::Allowed,
            stop_declared: None,
            is_braked: false,
            offset: 0.0,
        };
        let (spec, resets) = (Arc::clone(&self.spec), Arc::clone(&self.resets));
        let mut cell = FakeCell {
            spec,
            quirk: self.quirk,
            resets,
            state,
            joints: JointState::default(),
            forces: ContactForces::default(),
            film: None,
        };
        cell.settle();
        cell
    }
}

fn transform(z: f64) -> Transform {
    Transform { origin: Vector3::new(0.0, 0.0, z), ..Transform::IDENTITY }
}

/// A sensor that tells the joints once more.
fn sensor_name() -> ObjectName {
    ObjectName::from("encoders").unwrap()
}

fn spec() -> CellSpec {
    let joint = |name: &str| JointSpec {
        name: name.to_owned(),
        origin: transform(0.3),
        lower_rad: -3.0,
        upper_rad: 3.0,
        speed_max_rad_s: 2.0,
        acceleration_max_rad_s2: 10.0,
        effort_max_n_m: 80.0,
    };
    let chain = Chain { joints: vec![joint("first"), joint("second")], tool_from_last: transform(0.1) };
    let ball = Shape::Ball { radius_m: 0.04 };
    let shapes = (0..3).map(|piece| (piece, Transform::IDENTITY, ball));
    let home: JointVec = [0.1, -0.2].into_iter().collect();
    let covers = ClearanceModel::new(&chain, shapes, &home);
    let scene = Scene::from_toml("cell.toml", include_str!("../../sim/scenes/cell.toml")).unwrap();
    let object =
        |name: &str, kind| CellObject { name: ObjectName::from(name).unwrap(), kind, half_m: [0.025; 3] };
    CellSpec {
        robot: RobotSpec {
            name: "fake".to_owned(),
            digest: u64::MAX,
            geometry: Arc::new(Geometry { chain, covers }),
            parts: vec![PlacedShape {
                piece: 1,
                pose: Isometry3::translation(0.0, 0.1, 0.2),
                shape: PartShape::Primitive(ball),
            }],
            home,
            fingers: [Transform::IDENTITY; 2],
            width_max_m: 0.08,
        },
        zones: scene.zones.clone().into(),
        objects: vec![object("object", ObjectKind::Workpiece), object("tray", ObjectKind::Place)],
        sensors: vec![SensorSpec {
            name: sensor_name(),
            length: 2,
            unit: "rad".to_owned(),
            rate_hz: RATE_HZ,
        }],
        tasks: TaskKind::SEQUENCE.to_vec(),
        rate_hz: RATE_HZ,
        camera_hz: 30,
        abilities: Abilities { export_state: true, set_observed: true, film: true, referee: true },
        scene: Arc::new(scene),
    }
}

impl CellFactory for FakeFactory {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.spec
    }
    fn build_digest(&self) -> &'static str {
        "fake-build"
    }
    fn distributions(&self) -> Result<[Distribution; 3], CellError> {
        let of = |text| Distribution::from_toml("distribution", text);
        Ok([
            of(include_str!("../../sim/scenes/canonical.toml"))?,
            of(include_str!("../../sim/scenes/sandbox.toml"))?,
            of(include_str!("../../sim/scenes/live.toml"))?,
        ])
    }
    fn with_drift(&self, of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
        Ok(Distribution { name: format!("{} after {drift}", of.name), ..of.clone() })
    }
    fn live(&self) -> Result<Box<dyn LiveCell>, CellError> {
        Ok(Box::new(self.cell()))
    }
    fn trial(&self) -> Result<Box<dyn TrialCell>, CellError> {
        Ok(Box::new(self.cell()))
    }
}

#[derive(Clone, Serialize, Deserialize)]
struct FakeState {
    tick: u64,
    task_start: u64,
    task: TaskKind,
    q: JointVec,
    dq: JointVec,
    /// Where the joints go, and how fast.
    target: Option<(JointVec, f64)>,
    guard: GuardVerdict,
    stop_declared: Option<u64>,
    is_braked: bool,
    /// Something that a reset must set.
    offset: f64,
}

pub(crate) struct FakeCell {
    spec: Arc<CellSpec>,
    quirk: Quirk,
    resets: Arc<AtomicU64>,
    state: FakeState,
    joints: JointState,
    forces: ContactForces,
    film: Option<Vec<EpisodeFrame>>,
}

impl FakeCell {
    /// What follows from the state.
    fn settle(&mut self) {
        let s = &self.state;
        let tau = s.q.iter().map(|q| 0.5 * q + s.offset).collect();
        self.joints = JointState { q: s.q.clone(), dq: s.dq.clone(), tau, fingers: [[0.02, 0.0]; 2] };
    }

    fn told(&self, values: &JointVec) -> JointVec {
        let more = (self.quirk == Quirk::TellsThreeJoints).then_some(0.0);
        values.iter().copied().chain(more).collect()
    }

    fn tool(&self) -> Pose {
        let mut tool = Pose::from(&self.spec.robot.geometry.tool_pose(&self.state.q));
        if self.quirk == Quirk::MovesTool {
            tool.position[0] += 0.01;
        }
        tool
    }

    fn speeds(&self) -> JointVec {
        let mut dq = self.told(&self.state.dq);
        if self.quirk == Quirk::TellsNaN && self.state.tick >= 3 {
            dq[0] = f64::NAN;
        }
        dq
    }
}

fn is_finite(command: &Command) -> bool {
    match command {
        Command::Hold | Command::Stop | Command::Done | Command::Fail { .. } => true,
        Command::ToolPose { pose, max_speed_m_s } => pose.is_valid() && *max_speed_m_s > 0.0,
        Command::Joints { q, max_speed_rad_s } => {
            q.len() == 2 && q.iter().all(|value| value.is_finite()) && *max_speed_rad_s > 0.0
        }
        Command::Gripper { width_m, speed_m_s, force_n } => {
            width_m.is_finite() && *speed_m_s > 0.0 && force_n.is_finite()
        }
    }
}

impl Body for FakeCell {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        self.state.guard = last;
        let s = &self.state;
        let seen = Estimate { pose: Pose::IDENTITY, age_ticks: 3, sequence: 1 };
        let mut objects = s.task.seen_objects(Some(seen), None);
        if self.quirk == Quirk::NamesOthers {
            objects.iter_mut().for_each(|object| object.name.push('2'));
        }
        Observation {
            tick: s.tick - s.task_start,
            q: self.told(&s.q),
            dq: self.speeds(),
            tau: self.told(&self.joints.tau),
            tool: self.tool(),
            tool_twist: Twist::default(),
            gripper_width_m: 0.04,
            gripper_force_n: 0.0,
            wrist_force_n: -0.0,
            objects,
            sensors: [NamedReading {
                name: sensor_name(),
                age_ticks: 0,
                values: s.q.iter().copied().collect(),
            }]
            .into_iter()
            .collect(),
            tool_available: true,
            goal: s.task,
            guard: s.guard,
        }
    }
    fn telemetry(&self) -> Telemetry {
        let s = &self.state;
        Telemetry {
            tick: s.tick - s.task_start,
            q: self.told(&s.q),
            dq: self.speeds(),
            tracking_error_rad: 0.0,
            tool: self.tool(),
            tool_speed_m_s: 0.0,
            gripper_width_m: 0.04,
            gripper_force_n: 0.0,
            contact_force_n: 0.0,
            contacts: Contacts::default(),
            slip_m: None,
            picture_age_ticks: Some(3),
            tool_available: true,
        }
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        if !is_finite(command) && self.quirk != Quirk::TakesNaN {
            return Err(BodyError::Command("a value is no number".to_owned()));
        }
        let s = &mut self.state;
        match command {
            Command::Joints { q, max_speed_rad_s } if !s.is_braked && is_finite(command) => {
                s.target = Some((q.clone(), *max_speed_rad_s));
            }
            Command::Stop => s.target = None,
            _ => {}
        }
        let (target, speed) = s.target.clone().unwrap_or_else(|| (s.q.clone(), 0.0));
        for ((q, dq), goal) in s.q.iter_mut().zip(&mut s.dq).zip(&target) {
            let most = speed * TICK_SECS;
            let by = (goal - *q).clamp(-most, most);
            (*q, *dq) = (*q + by, by / TICK_SECS);
        }
        s.tick += if self.quirk == Quirk::SkipsTicks { 2 } else { 1 };
        self.settle();
        let frame = EpisodeFrame {
            tick: self.state.tick,
            seen: self.telemetry(),
            tau: self.joints.tau.clone(),
            object: Isometry3::identity(),
            speed_m_s: 0.0,
            grip_n: 0.0,
            contact_n: 0.0,
            touched: false,
            stopped: false,
        };
        if let Some(film) = &mut self.film {
            film.push(frame);
        }
        Ok(())
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        if self.quirk == Quirk::IgnoresStop {
            return;
        }
        let s = &mut self.state;
        s.is_braked = interrupt == Interrupt::Stop;
        s.target = None;
        s.stop_declared = match interrupt {
            Interrupt::Stop => s.stop_declared.or(Some(s.tick)),
            Interrupt::Release => None,
        };
    }
    fn inspect(&self) -> bool {
        self.state.tick >= 20
    }
}

impl RobotCell for FakeCell {
    fn spec(&self) -> &Arc<CellSpec> {
        &self.spec
    }
    fn tick(&self) -> u64 {
        self.state.tick
    }
    fn begin_task(&mut self, task: TaskKind) {
        (self.state.task, self.state.task_start) = (task, self.state.tick);
    }
    fn shown_object(&self) -> Isometry3<f64> {
        Isometry3::translation(0.5, -0.2, self.state.offset)
    }
    fn stop_declared(&self) -> Option<u64> {
        self.state.stop_declared
    }
    fn export(&self) -> Result<StateImage, CellError> {
        let mut state = self.state.clone();
        if self.quirk == Quirk::ExportsHalf {
            state.target = None;
        }
        StateImage::new(encode(&state).unwrap())
    }
    fn observed(&self) -> Option<Observation> {
        let mut copy =
            FakeFactory { spec: Arc::clone(&self.spec), quirk: self.quirk, resets: Arc::clone(&self.resets) }
                .cell();
        copy.state = self.state.clone();
        copy.settle();
        Some(copy.observe(self.state.guard))
    }
    fn truth(&self) -> Option<TrueState<'_>> {
        Some(self.true_state())
    }
    fn fixtures(&self) -> Vec<FixtureBox> {
        vec![(Isometry3::translation(0.5, 0.2, 0.0), [0.1, 0.1, 0.01])]
    }
    fn contact_points(&self) -> Vec<ContactPoint> {
        vec![ContactPoint { at_m: [0.5, 0.2, 0.01], force_n: [0.0, 0.0, 2.5] }]
    }
}

impl LiveCell for FakeCell {
    fn await_work(&mut self, call: &WorkCall<'_>) -> Result<(), CellError> {
        let scene = Arc::clone(&self.spec.scene);
        self.reset(&EpisodeSetup::sample(TaskKind::Grasp, &scene, call.conditions, call.seed))
    }
    fn inject(&mut self, fault: InjectedFault) -> Result<(), CellError> {
        TrialCell::inject(self, fault);
        Ok(())
    }
}

impl TrialCell for FakeCell {
    fn reset(&mut self, setup: &EpisodeSetup) -> Result<(), CellError> {
        if setup.object.mass_kg > 1.0 {
            let problem = "the object is too heavy".to_owned();
            return Err(CellError::InvalidStart { seed: setup.seed, problem });
        }
        let quirk = self.quirk;
        let fresh =
            FakeFactory { spec: Arc::clone(&self.spec), quirk, resets: Arc::clone(&self.resets) }.cell();
        let resets = self.resets.fetch_add(1, Ordering::Relaxed);
        let by = if self.quirk == Quirk::ForgetsSeeds { resets as f64 } else { 0.0 };
        self.state = FakeState { task: setup.task, offset: setup.object.mass_kg + by, ..fresh.state };
        self.settle();
        self.film = self.film.take().map(|_| Vec::new());
        Ok(())
    }
    fn go_on_from(&mut self, copy: &CellCopy) -> Result<(), CellError> {
        let none = || CellError::Snapshot("it has no image".to_owned());
        self.import(copy.image().ok_or_else(none)?)
    }
    fn import(&mut self, image: &StateImage) -> Result<(), CellError> {
        self.state = decode(image.bytes()).map_err(|error| CellError::Snapshot(error.to_string()))?;
        self.settle();
        Ok(())
    }
    fn set_to(&mut self, observed: &Observation) -> Result<(), CellError> {
        self.state.q.clone_from(&observed.q);
        self.settle();
        Ok(())
    }
    fn inject(&mut self, fault: InjectedFault) {
        if let InjectedFault::JointStuck { .. } = fault {
            self.state.target = None;
            self.state.is_braked = true;
        }
    }
    fn true_state(&self) -> TrueState<'_> {
        TrueState {
            joints: &self.joints,
            forces: &self.forces,
            object: self.shown_object(),
            object_speed_m_s: 0.0,
        }
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn film(&mut self) {
        self.film = Some(Vec::new());
    }
    fn take_film(&mut self) -> Vec<EpisodeFrame> {
        self.film.as_mut().map(std::mem::take).unwrap_or_default()
    }
}

/// Connections to a server in this process, each with a thread.
pub(crate) fn connect_to(server: &Arc<CellServer>) -> Connect {
    let server = Arc::clone(server);
    Box::new(move || {
        let (own, other) = UnixStream::pair()?;
        let server = Arc::clone(&server);
        thread::spawn(move || server.attend(EndpointStream::Unix(other)));
        Ok(Box::new(EndpointStream::Unix(own)))
    })
}
