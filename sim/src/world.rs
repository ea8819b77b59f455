//! One cell: build, reset, observe, step. The first implementation of the robot boundary.
//!
//! A tick is 1/240 s: the command passes the latency queue, sets a channel's setpoint, the servo
//! moves the motor targets, physics advances once, sensors and camera read the result. Everything
//! that changes lives in one serialisable state, so a snapshot resumes bit-identically.

mod copy;

pub use copy::WorldCopy;

use std::collections::BTreeMap;
use std::sync::Arc;

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::cell::{cell_spec, readings};
use crate::dynamics::ARM_JOINTS_MAX;
use crate::film::EpisodeFilm;
use crate::further::NamedObject;
use crate::handles::from_rapier;
use crate::perception::sensor_errors;
use crate::readout;
use crate::reduced_state::ReducedState;
use crate::robot::RobotModel;
use crate::state::{InFlightCommand, WorldState};
use crate::stepper::Stepper;
use crate::work_count;
use holdpoint_body::chain::Transform;
use holdpoint_body::task::DoneCondition;
use holdpoint_body::{
    Body, BodyError, Command, FurtherObject, GuardVerdict, Interrupt, JointVec, ObjectVec, Observation, Pose,
    ReadingVec, TaskKind, Telemetry, Twist, check_command,
};
use holdpoint_cell::episode::{EpisodeSetup, Start};
use holdpoint_cell::truth::{ContactForces, ContactPoint, JointState};
use holdpoint_cell::{CellError, CellSpec, InjectedFault, Scene};

pub use crate::effort::Fidelity;

/// Settings of a world that are not part of scene, robot or episode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldConfig {
    /// Solver effort.
    pub fidelity: Fidelity,
}

/// The most commands under way: a second's worth.
const QUEUE_MAX: usize = 256;
/// A cell with a robot in it.
pub struct World {
    robot: Arc<RobotModel>,
    scene: Arc<Scene>,
    pub(crate) spec: Arc<CellSpec>,
    further: Arc<[NamedObject]>,
    config: WorldConfig,
    stepper: Stepper,
    state: WorldState,
    observation: Observation,
    /// The recorded film, while one is being recorded.
    pub(crate) film: Option<Box<EpisodeFilm>>,
}

/// True state, for drawing, inspection and tests. Neither skill nor governance sees it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldTruth {
    /// World tick.
    pub tick: u64,
    /// True joint positions, rad.
    pub q: JointVec,
    /// True joint speeds, rad/s.
    pub dq: JointVec,
    /// Links moved by the joints, first joint first (shapes are in [`RobotModel::links`]).
    pub links: ArrayVec<Pose, ARM_JOINTS_MAX>,
    /// The two fingers.
    pub fingers: [Pose; 2],
    /// The tool.
    pub tool: Pose,
    /// Tool speed, m/s.
    pub tool_speed_m_s: f64,
    /// The object.
    pub object: Pose,
    /// Its speed, m/s.
    pub object_speed_m_s: f64,
    /// The tray.
    pub target: Pose,
    /// Forces and contacts.
    pub forces: ContactForces,
    /// Displacement of the object in the hand since the grip closed, m.
    pub slip_m: Option<f64>,
    /// World tick of a declared stop or failure that still stands.
    pub stop_declared: Option<u64>,
}

impl World {
    /// A world with default settings, reset to seed 0 of an unperturbed grasp.
    ///
    /// # Errors
    /// [`CellError`] when the robot cannot be built or does not fit the scene.
    pub fn new(robot: &RobotModel, scene: &Scene) -> Result<Self, CellError> {
        Self::with_config(robot, scene, WorldConfig::default())
    }

    /// A world with explicit settings.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn with_config(robot: &RobotModel, scene: &Scene, config: WorldConfig) -> Result<Self, CellError> {
        Self::with_objects(robot, scene, &BTreeMap::new(), config)
    }

    /// A world with further objects under these names.
    ///
    /// # Errors
    /// As [`World::new`], or if the cell cannot have one of the objects.
    pub fn with_objects(
        robot: &RobotModel,
        scene: &Scene,
        objects: &BTreeMap<String, FurtherObject>,
        config: WorldConfig,
    ) -> Result<Self, CellError> {
        let further: Arc<[NamedObject]> = crate::further::check(&scene.name, scene, objects)?.into();
        let distribution = crate::published::canonical()?;
        let setup = EpisodeSetup::sample(TaskKind::Grasp, scene, &distribution, 0);
        let (robot, scene) = (Arc::new(robot.clone()), Arc::new(scene.clone()));
        let state = WorldState::new(&robot, &scene, &further, &setup)?;
        let observation = blank_observation(robot.geometry.joint_count());
        let stepper = Stepper::new(config.fidelity, &robot, &state.physics, &state.handles, true);
        let spec = Arc::new(cell_spec(&robot, &scene, &further));
        let mut world = Self { robot, scene, spec, further, config, stepper, state, observation, film: None };
        world.settle_start()?;
        Ok(world)
    }

    /// Starts an episode. Nothing of the one before is left.
    ///
    /// # Errors
    /// [`CellError::InvalidStart`] when a held start is out of reach or the object does not hold.
    pub fn reset(&mut self, setup: &EpisodeSetup) -> Result<(), CellError> {
        self.state = WorldState::new(&self.robot, &self.scene, &self.further, setup)?;
        work_count::note(|count| count.episodes += 1);
        self.prepare();
        self.settle_start()?;
        self.restart_film();
        Ok(())
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &RobotModel {
        &self.robot
    }

    /// The scene.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The episode being run.
    #[must_use]
    pub fn setup(&self) -> &EpisodeSetup {
        &self.state.setup
    }

    /// Ticks since the reset.
    #[must_use]
    pub fn tick(&self) -> u64 {
        self.state.tick
    }

    /// The task at work.
    #[must_use]
    pub fn task(&self) -> TaskKind {
        self.state.task
    }

    /// Switches the goal and restarts the task's tick; the physics goes on untouched.
    pub fn begin_task(&mut self, task: TaskKind) {
        let s = &mut self.state;
        s.task = task;
        s.task_start = s.tick;
        s.stop_declared = None;
        s.object_start_z = s.object().0.translation.z;
        self.fill_observation();
    }

    /// Tells the skill, through the observation, what became of its command.
    pub fn set_guard(&mut self, verdict: GuardVerdict) {
        self.state.guard = verdict;
        self.observation.guard = verdict;
    }

    /// What a skill may see now.
    pub fn observe(&mut self) -> &Observation {
        &self.observation
    }

    /// An interruption from outside the skill; immediate, without latency.
    pub fn interrupt(&mut self, interrupt: Interrupt) {
        let s = &mut self.state;
        match interrupt {
            Interrupt::Stop => {
                s.servo.stop();
                s.queue.clear();
                s.stop_declared = s.stop_declared.or(Some(s.tick));
            }
            Interrupt::Release => {
                s.servo.release();
                s.stop_declared = None;
            }
        }
    }

    /// Breaks something, from the next tick on and for the rest of the episode.
    pub fn inject(&mut self, fault: InjectedFault) {
        let s = &mut self.state;
        match fault {
            InjectedFault::CameraLost => s.camera.lose(),
            InjectedFault::ToolDead => s.faults.tool_dead = true,
            InjectedFault::GripLost => s.faults.grip_lost = true,
            InjectedFault::JointStuck { joint } => s.faults.stuck_joint = Some(joint),
            InjectedFault::JointRunaway { joint } => s.faults.runaway_joint = Some(joint),
        }
    }

    /// One tick.
    ///
    /// # Errors
    /// [`BodyError::Command`] for a command with numbers that cannot be meant (the world does not
    /// advance); [`BodyError::Diverged`] when the physics state is no longer usable.
    pub fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        check_command(command, self.robot.geometry.joint_count())?;
        let s = &mut self.state;
        let jitter = s.setup.action.jitter.unit() * s.setup.action.jitter_ticks;
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a cast saturates, NaN is 0"
        )]
        let delay = libm::round(s.setup.action.latency_ticks + jitter) as u64;
        s.last_due = s.last_due.max(s.tick + delay);
        if !matches!(command, Command::Hold) && s.queue.len() < QUEUE_MAX {
            s.queue.push_back(InFlightCommand { due: s.last_due, command: command.clone() });
        }
        if matches!(command, Command::Fail { .. }) {
            // From here on the robot is expected to stand still, until released.
            s.stop_declared = s.stop_declared.or(Some(s.tick));
        }
        let available = s.tool_available();
        let width = s.joints.width_m();
        while s.queue.front().is_some_and(|first| first.due <= s.tick) {
            if let Some(arrived) = s.queue.pop_front() {
                s.servo.accept(&arrived.command, &self.robot, width, available);
            }
        }
        s.servo.advance(&self.robot, available);
        s.push_object();
        self.physics_tick()?;
        self.state.tick += 1;
        self.sense();
        self.keep_frame();
        Ok(())
    }

    /// What the watcher and the monitor may read now.
    #[must_use]
    pub fn telemetry(&self) -> Telemetry {
        let (s, o) = (&self.state, &self.observation);
        let tracking =
            s.servo.q.iter().zip(&o.q).fold(0.0_f64, |most, (want, is)| most.max((want - is).abs()));
        let contact = s.forces.surroundings_n();
        Telemetry {
            tick: o.tick,
            q: o.q.clone(),
            dq: o.dq.clone(),
            tracking_error_rad: tracking,
            tool: o.tool,
            tool_speed_m_s: o.tool_twist.speed_m_s(),
            gripper_width_m: o.gripper_width_m,
            gripper_force_n: o.gripper_force_n,
            contact_force_n: (contact + s.errors.force_n[2]).max(0.0),
            contacts: s.forces.contacts,
            slip_m: s.grip.reference_m.map(|_| (s.grip.slip_m + s.errors.slip_m).abs()),
            picture_age_ticks: s.camera.age_ticks(s.tick),
            tool_available: o.tool_available,
        }
    }

    /// Joint torques as measured, N m.
    #[must_use]
    pub const fn torques(&self) -> &JointVec {
        &self.observation.tau
    }

    /// True state.
    #[must_use]
    pub fn truth(&self) -> WorldTruth {
        let s = &self.state;
        let frames = self.robot.geometry.chain.frames(&s.joints.q);
        let twist = self.robot.geometry.chain.jacobian(&frames).twist(&s.joints.dq);
        let (object, object_speed_m_s, _) = s.object();
        let finger = |i: usize| {
            let slide = Isometry3::translation(0.0, 0.0, s.joints.fingers[i][0]);
            let last = frames.links.last().copied().unwrap_or(Transform::IDENTITY).isometry();
            Pose::from(&(last * self.robot.gripper.fingers[i].origin.isometry() * slide))
        };
        WorldTruth {
            tick: s.tick,
            q: s.joints.q.clone(),
            dq: s.joints.dq.clone(),
            links: frames.links.iter().map(|f| Pose::from(&f.isometry())).collect(),
            fingers: [finger(0), finger(1)],
            tool: Pose::from(&frames.tool.isometry()),
            tool_speed_m_s: twist.fixed_rows::<3>(0).norm(),
            object: Pose::from(&object),
            object_speed_m_s,
            target: s.setup.target,
            forces: s.forces,
            slip_m: s.grip.reference_m.map(|_| s.grip.slip_m),
            stop_declared: s.stop_declared,
        }
    }

    /// True forces between robot, object and surroundings.
    #[must_use]
    pub fn forces(&self) -> &ContactForces {
        &self.state.forces
    }

    /// Whether the physics engine rests: the next tick begins without it.
    #[must_use]
    pub fn engine_rests(&self) -> bool {
        self.state.owner.own.is_some()
    }

    /// What stands in the cell in this episode: the parts of the tray, then the clutter. Pose of the middle and half
    /// extents, m.
    #[must_use]
    pub fn fixtures(&self) -> Vec<(Isometry3<f64>, [f64; 3])> {
        let (setup, scene) = (&self.state.setup, &self.scene);
        let target = setup.target.isometry();
        let tray = crate::build::tray_parts(&scene.tray, scene.object.half_m)
            .into_iter()
            .map(|(half, centre)| (target * Isometry3::translation(centre[0], centre[1], centre[2]), half));
        let present = setup.clutter.iter().filter_map(|index| scene.clutter.get(usize::from(*index)));
        let clutter = present.map(|piece| {
            let [x, y] = piece.centre_xy_m;
            (Isometry3::translation(x, y, piece.half_m[2]), piece.half_m)
        });
        tray.chain(clutter).collect()
    }

    /// Where robot and object touch what they touch, the strongest contact first.
    #[must_use]
    pub fn contact_points(&self) -> Vec<ContactPoint> {
        let s = &self.state;
        let held = match (&s.owner.own, self.stepper.cell()) {
            (Some(own), Some(cell)) => cell.contact_points(own),
            _ => None,
        };
        held.unwrap_or_else(|| readout::contact_points(&s.physics, &s.handles))
    }

    /// True joint positions and speeds.
    #[must_use]
    pub fn joints(&self) -> &JointState {
        &self.state.joints
    }

    /// World tick of a declared failure or a stop from outside that still stands.
    #[must_use]
    pub fn stop_declared(&self) -> Option<u64> {
        self.state.stop_declared
    }

    /// True pose and speed (m/s) of the object.
    #[must_use]
    pub fn object(&self) -> (Isometry3<f64>, f64) {
        let (pose, speed, _) = self.state.object();
        (pose, speed)
    }

    /// True poses of the further objects, by their names.
    #[must_use]
    pub fn further_objects(&self) -> BTreeMap<&str, Isometry3<f64>> {
        let names = self.further.iter().map(|(name, _)| name.as_str());
        names.zip(self.state.further_poses()).collect()
    }

    /// The end-of-task inspection, from true poses: is the work of the current task done right now?
    #[must_use]
    pub fn task_succeeded(&self) -> bool {
        let (s, t) = (&self.state, &self.scene.tolerance);
        let (object, speed, _) = s.object();
        let target = s.setup.target.isometry();
        let half = self.scene.object.half_m;
        let local = target.inverse() * object;
        let at = local.translation;
        s.task.done().iter().all(|condition| match condition {
            DoneCondition::InHand => {
                s.forces.gripped() && s.grip.reference_m.is_some() && s.grip.slip_m < t.in_hand_m
            }
            DoneCondition::Lifted => object.translation.z - s.object_start_z >= t.lift_m,
            DoneCondition::OverTarget => libm::hypot(at.x, at.y) <= t.align_xy_m,
            DoneCondition::SquareToTarget => {
                crate::perception::yaw_error(&object, &target) <= t.align_yaw_rad
            }
            DoneCondition::AtHover => (at.z - half - t.hover_m).abs() <= t.hover_band_m,
            DoneCondition::InTarget => {
                let free = self.scene.tray.clearance_m + t.place_height_m;
                at.x.abs() <= free && at.y.abs() <= free
            }
            DoneCondition::Seated => (at.z - half).abs() <= t.place_height_m,
            DoneCondition::Upright => face_up_tilt(&object) <= t.place_tilt_rad,
            DoneCondition::Still => speed <= t.still_m_s,
            DoneCondition::Untouched => !s.forces.contacts.pad_object && !s.forces.contacts.body_object,
            DoneCondition::ToolClear => {
                let tool = self.robot.geometry.chain.frames(&s.joints.q).tool.origin;
                (tool - object.translation.vector).norm() >= t.place_clear_m
            }
        })
    }

    /// FNV-1a over the raw bits of every body's pose and velocity, the servo's reference and the tick.
    #[must_use]
    pub fn state_hash(&self) -> u64 {
        let s = &self.state;
        let bodies = s.physics.bodies.iter().flat_map(|(_, body)| {
            let (p, r) = (body.translation().to_array(), body.rotation().to_array());
            let (v, w) = (body.linvel().to_array(), body.angvel().to_array());
            p.into_iter().chain(r).chain(v).chain(w).flat_map(|value| value.to_bits().to_le_bytes())
        });
        let servo = s.servo.q.iter().chain(&s.servo.dq).flat_map(|value| value.to_bits().to_le_bytes());
        let reduced = s
            .owner
            .own
            .iter()
            .flat_map(ReducedState::numbers)
            .flat_map(|value| value.to_bits().to_le_bytes());
        crate::robot::fnv1a(bodies.chain(servo).chain(reduced).chain(s.tick.to_le_bytes()))
    }

    /// Makes what follows from the state and does not change with it.
    fn prepare(&mut self) {
        let s = &self.state;
        self.stepper = Stepper::new(self.config.fidelity, &self.robot, &s.physics, &s.handles, true);
    }

    /// Closes on a held object and checks that it holds; then takes the first reading.
    fn settle_start(&mut self) -> Result<(), CellError> {
        if let Start::Held { .. } = self.state.setup.start {
            self.close_on_object()?;
        }
        self.state.begin();
        self.sense();
        Ok(())
    }

    fn close_on_object(&mut self) -> Result<(), CellError> {
        const CLOSE_TICKS: usize = 36;
        const HANG_TICKS: usize = 36;
        /// Firm: carries 0.35 kg at the smallest friction twice over.
        const FORCE_N: f64 = 25.0;
        let seed = self.state.setup.seed;
        let robot = Arc::clone(&self.robot);
        let close = Command::Gripper { width_m: 0.0, speed_m_s: 0.1, force_n: FORCE_N };
        let width = self.state.joints.width_m();
        self.state.servo.accept(&close, &robot, width, true);
        self.state.set_object_gravity(0.0);
        for tick in 0..CLOSE_TICKS + HANG_TICKS {
            if tick == CLOSE_TICKS {
                self.state.set_object_gravity(1.0);
            }
            self.state.servo.advance(&robot, true);
            self.physics_tick()?;
            self.state.follow_grip(&robot);
        }
        let s = &self.state;
        let speed = s.object().1;
        let problem = if !s.forces.gripped() {
            "the pads do not press on the object".to_owned()
        } else if s.grip.slip_m > 0.002 {
            format!("the object slips by {:.4} m while it should hang still", s.grip.slip_m)
        } else if speed > 0.05 {
            format!("the object still moves at {speed:.3} m/s")
        } else {
            return Ok(());
        };
        Err(CellError::InvalidStart { seed, problem })
    }

    fn physics_tick(&mut self) -> Result<(), BodyError> {
        work_count::note(|count| count.ticks += 1);
        let s = &mut self.state;
        let drives = s.drives();
        let rested = self.stepper.tick(&mut s.owner, &mut s.physics, &s.handles, &drives);
        (s.joints, s.forces) = match (&s.owner.own, self.stepper.cell()) {
            (Some(reduced), Some(cell)) if rested => (cell.joint_state(reduced), reduced.forces(&s.forces)),
            _ => (
                readout::joint_state(&s.physics, &s.handles, &self.robot),
                readout::contact_forces(&s.physics, &s.handles, self.robot.geometry.joint_count()),
            ),
        };
        s.check_finite()
    }

    fn sense(&mut self) {
        let s = &mut self.state;
        s.follow_grip(&self.robot);
        s.errors = sensor_errors(&mut s.setup.sensors);
        let (object, _, _) = s.object();
        s.camera.tick(s.tick, &object, &s.setup.target.isometry());
        let further = readout::further_objects(&s.physics, &s.handles);
        s.further.follow(&s.camera, further.map(|body| from_rapier(body.position())));
        self.fill_observation();
    }

    /// The observation is a function of the state, so it need not be in a snapshot.
    fn fill_observation(&mut self) {
        let (s, o) = (&self.state, &mut self.observation);
        let e = &s.errors;
        for i in 0..s.joints.q.len() {
            o.q[i] = s.joints.q[i] + e.q.get(i).copied().unwrap_or(0.0);
            o.dq[i] = s.joints.dq[i] + e.dq.get(i).copied().unwrap_or(0.0);
            o.tau[i] = s.joints.tau[i] + e.tau.get(i).copied().unwrap_or(0.0);
        }
        let frames = self.robot.geometry.chain.frames(&o.q);
        let twist = self.robot.geometry.chain.jacobian(&frames).twist(&o.dq);
        o.tick = s.tick - s.task_start;
        o.tool = Pose::from(&frames.tool.isometry());
        o.tool_twist =
            Twist { linear: [twist[0], twist[1], twist[2]], angular: [twist[3], twist[4], twist[5]] };
        o.gripper_width_m = s.joints.width_m() + e.width_m;
        o.gripper_force_n = (s.forces.grip_n() + e.force_n[0]).max(0.0);
        o.wrist_force_n = (Vector3::from(s.forces.wrist_n).norm() + e.force_n[1]).max(0.0);
        let (object, target) = s.camera.estimates(s.tick);
        o.objects = s.task.seen_objects(object, target);
        o.objects.extend(s.further.seen(&s.camera, s.tick, &self.further));
        o.sensors = readings(&self.spec, s.forces.pad_n.map(|force| (force + e.force_n[0]).max(0.0)));
        o.tool_available = s.tool_available();
        o.goal = s.task;
        o.guard = s.guard;
    }
}

/// Angle between the vertical and the object's face that looks up most, rad.
fn face_up_tilt(object: &Isometry3<f64>) -> f64 {
    let up = object.rotation.inverse() * Vector3::z();
    libm::acos(up.amax().clamp(-1.0, 1.0))
}

fn blank_observation(joints: usize) -> Observation {
    let zeros: JointVec = (0..joints).map(|_| 0.0).collect();
    Observation {
        tick: 0,
        q: zeros.clone(),
        dq: zeros.clone(),
        tau: zeros,
        tool: Pose::IDENTITY,
        tool_twist: Twist::default(),
        gripper_width_m: 0.0,
        gripper_force_n: 0.0,
        wrist_force_n: 0.0,
        objects: ObjectVec::new(),
        sensors: ReadingVec::new(),
        tool_available: true,
        goal: TaskKind::Grasp,
        guard: GuardVerdict::Allowed,
    }
}

impl Body for World {
    fn observe(&mut self, last: GuardVerdict) -> Observation {
        self.set_guard(last);
        World::observe(self).clone()
    }
    fn telemetry(&self) -> Telemetry {
        World::telemetry(self)
    }
    fn step(&mut self, command: &Command) -> Result<(), BodyError> {
        World::step(self, command)
    }
    fn interrupt(&mut self, interrupt: Interrupt) {
        World::interrupt(self, interrupt);
    }
    fn inspect(&self) -> bool {
        self.task_succeeded()
    }
}
