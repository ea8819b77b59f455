//! Everything of a world that changes, and how it is set up and advanced between ticks.
//!
//! One serialisable value: what is not in here does not survive a snapshot, so nothing that affects
//! the future may live elsewhere.
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use std::collections::VecDeque;

use nalgebra::{Isometry3, Vector3};
use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::build;
use crate::fault::{ActiveFaults, RUNAWAY_RAD_S};
use crate::further::{self, FurtherSight, NamedObject};
use crate::handles::{Handles, from_rapier};
use crate::motors::{self, Drives, MotorReference};
use crate::perception::{Camera, SensorErrors};
use crate::readout;
use crate::reduced_state::{ReducedState, StateOwner};
use crate::robot::RobotModel;
use crate::servo::Servo;
use holdpoint_body::chain::Transform;
use holdpoint_body::ik::IkOptions;
use holdpoint_body::{BodyError, Command, FailureSignal, GuardVerdict, JointVec, Pose, TICK_SECS, TaskKind};
use holdpoint_cell::CellError;
use holdpoint_cell::Scene;
use holdpoint_cell::episode::{EpisodeSetup, Start};
use holdpoint_cell::truth::{ContactForces, JointState};

/// The grip as the slip sensor follows it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Grip {
    /// Consecutive ticks with both pads pressing.
    pub pressed_ticks: u32,
    /// Consecutive ticks with no pad touching.
    pub open_ticks: u32,
    /// Object center in the tool frame when the grip had closed.
    pub reference_m: Option<[f64; 3]>,
    /// Distance from it, m.
    pub slip_m: f64,
}

/// Both pads press for this long before the grip counts as closed: the squeeze has settled.
const GRIP_CLOSED_TICKS: u32 = 12;
/// No pad touches for this long before the grip counts as open.
const GRIP_OPEN_TICKS: u32 = 6;
/// Speeds past these are a diverged solver, not a motion (the motors stop far below).
const JOINT_SPEED_DIVERGED_RAD_S: f64 = 100.0;
const OBJECT_SPEED_DIVERGED_M_S: f64 = 50.0;
const DISTANCE_DIVERGED_M: f64 = 20.0;

/// A command under way to the servo.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InFlightCommand {
    /// World tick at which it arrives.
    pub due: u64,
    #[serde(with = "PlainCommand")]
    pub command: Command,
}

/// A command as a snapshot stores it, with the index of its variant as the tag. The format of
/// snapshots is not self-describing, so serde could not read a named tag.
#[derive(Serialize, Deserialize)]
#[serde(remote = "Command")]
enum PlainCommand {
    Hold,
    ToolPose { pose: Pose, max_speed_m_s: f64 },
    Joints { q: JointVec, max_speed_rad_s: f64 },
    Gripper { width_m: f64, speed_m_s: f64, force_n: f64 },
    Stop,
    Done,
    Fail { signal: FailureSignal },
}

/// Everything that changes.
#[derive(Serialize, Deserialize)]
pub struct WorldState {
    pub physics: PhysicsWorld,
    pub handles: Handles,
    /// Whether the engine has the state of arm and object, or rests.
    pub owner: StateOwner,
    pub setup: EpisodeSetup,
    pub task: TaskKind,
    pub tick: u64,
    pub task_start: u64,
    pub servo: Servo,
    pub queue: VecDeque<InFlightCommand>,
    pub last_due: u64,
    pub camera: Camera,
    pub guard: GuardVerdict,
    /// What has been broken on purpose.
    pub faults: ActiveFaults,
    /// Tick of the first stop command or declared failure.
    pub stop_declared: Option<u64>,
    /// Height of the object when the task began, m.
    pub object_start_z: f64,
    pub grip: Grip,
    pub joints: JointState,
    pub forces: ContactForces,
    pub errors: SensorErrors,
    /// What the camera sees of the further objects. A snapshot has it at its end, if there are any.
    #[serde(skip, default = "FurtherSight::none")]
    pub further: FurtherSight,
}

impl WorldState {
    pub fn new(
        robot: &RobotModel,
        scene: &Scene,
        objects: &[NamedObject],
        setup: &EpisodeSetup,
    ) -> Result<Self, CellError> {
        let (q, width) = start_configuration(robot, scene, setup)?;
        let (starts, stream) = further::starts(objects, scene, setup)?;
        let placed = objects.iter().map(|(_, object)| *object).zip(starts).collect();
        let fixtures = build::CellFixtures::new(scene, setup, placed);
        let (physics, handles) = build::assemble(robot, &fixtures, &q, width)?;
        let joints = readout::joint_state(&physics, &handles, robot);
        Ok(Self {
            physics,
            handles,
            owner: StateOwner::default(),
            setup: setup.clone(),
            task: setup.task,
            tick: 0,
            task_start: 0,
            servo: Servo::new(q, width, robot),
            queue: VecDeque::new(),
            last_due: 0,
            camera: Camera::new(&setup.camera),
            guard: GuardVerdict::Allowed,
            faults: ActiveFaults::default(),
            stop_declared: None,
            object_start_z: setup.object.pose.position[2],
            grip: Grip::default(),
            joints,
            forces: ContactForces::default(),
            errors: SensorErrors::default(),
            further: FurtherSight::new(objects.len(), stream),
        })
    }

    /// Tick 0: whatever led to the start is forgotten.
    pub fn begin(&mut self) {
        self.object_start_z = self.object().0.translation.z;
        if self.grip.reference_m.is_some() {
            // In-hand displacement counts from the start of the episode.
            self.grip.reference_m = None;
            self.grip.pressed_ticks = GRIP_CLOSED_TICKS;
        }
    }

    pub fn set_object_gravity(&mut self, scale: f32) {
        if let Some(body) = self.physics.bodies.get_mut(self.handles.object) {
            body.set_gravity_scale(scale, true);
        }
    }

    /// Pose, speed (m/s) and spin (rad/s) of the object.
    pub fn object(&self) -> (Isometry3<f64>, f64, f64) {
        let own = self.owner.own.as_ref().map(ReducedState::object);
        own.unwrap_or_else(|| readout::object_state(&self.physics, &self.handles))
    }

    /// Poses of the further objects, in the order of their names.
    pub fn further_poses(&self) -> impl Iterator<Item = Isometry3<f64>> {
        readout::further_objects(&self.physics, &self.handles).map(|body| from_rapier(body.position()))
    }

    /// Applies the push that is due.
    pub fn push_object(&mut self) {
        for push in self.setup.pushes.iter().filter(|push| push.tick == self.tick) {
            let impulse = Vector3::from(push.impulse_n_s);
            if let Some(reduced) = &mut self.owner.own {
                reduced.push(&impulse);
            } else if let Some(body) = self.physics.bodies.get_mut(self.handles.object) {
                body.apply_impulse(crate::handles::to_vector(&push.impulse_n_s), true);
            }
        }
    }

    /// The servo's reference as the motors get it.
    pub fn drives(&self) -> Drives {
        let commanded = |joint| match &self.owner.own {
            Some(reduced) => reduced.commanded_position(joint),
            None => motors::commanded_position(&self.physics, &self.handles, joint),
        };
        let arm = self.servo.q.iter().zip(&self.servo.dq).enumerate().map(|(i, (q, dq))| {
            if self.faults.stuck_joint == Some(i) {
                MotorReference { position: commanded(i), speed: 0.0 }
            } else if self.faults.runaway_joint == Some(i) {
                MotorReference { position: commanded(i) + RUNAWAY_RAD_S * TICK_SECS, speed: RUNAWAY_RAD_S }
            } else {
                MotorReference { position: *q, speed: *dq }
            }
        });
        let g = &self.servo.gripper;
        Drives {
            arm: arm.collect(),
            finger: MotorReference { position: 0.5 * g.width_m, speed: 0.5 * g.rate_m_s },
            finger_force_n: if self.faults.grip_lost { 0.0 } else { g.force_n },
        }
    }

    /// Whether the gripper answers in this tick.
    pub fn tool_available(&self) -> bool {
        !self.faults.tool_dead && tool_available(&self.setup, self.tick)
    }

    /// Follows the object in the hand from the moment the grip has closed.
    pub fn follow_grip(&mut self, robot: &RobotModel) {
        let object = self.object().0;
        let grip = &mut self.grip;
        if self.forces.gripped() {
            grip.pressed_ticks = grip.pressed_ticks.saturating_add(1);
        } else {
            grip.pressed_ticks = 0;
        }
        if self.forces.contacts.pad_object {
            grip.open_ticks = 0;
        } else {
            grip.open_ticks = grip.open_ticks.saturating_add(1);
        }
        if grip.open_ticks >= GRIP_OPEN_TICKS {
            grip.reference_m = None;
            grip.slip_m = 0.0;
            return;
        }
        if grip.reference_m.is_none() && grip.pressed_ticks < GRIP_CLOSED_TICKS {
            return;
        }
        let tool: Transform = robot.geometry.chain.frames(&self.joints.q).tool;
        let local: Vector3<f64> = tool.rotation.transpose() * (object.translation.vector - tool.origin);
        let reference = Vector3::from(*grip.reference_m.get_or_insert(local.into()));
        grip.slip_m = (local - reference).norm();
    }

    pub fn check_finite(&self) -> Result<(), BodyError> {
        let diverged = |what: String| Err(BodyError::Diverged { tick: self.tick, what });
        for (q, dq) in self.joints.q.iter().zip(&self.joints.dq) {
            let usable = q.is_finite() && dq.abs() < JOINT_SPEED_DIVERGED_RAD_S;
            if !usable {
                return diverged(format!("joint at \"{q}\" rad, \"{dq}\" rad/s"));
            }
        }
        let (object, speed, spin) = self.object();
        let distance = object.translation.vector.norm();
        // Comparisons with what is not a number are false.
        let usable = distance < DISTANCE_DIVERGED_M && speed < OBJECT_SPEED_DIVERGED_M_S && spin.is_finite();
        if !usable {
            return diverged(format!("object {distance} m away at \"{speed}\" m/s"));
        }
        // One that a skill pushed off the table falls for the rest of the episode.
        let finite = |pose: Isometry3<f64>| pose.translation.vector.iter().all(|at| at.is_finite());
        if !self.further_poses().all(finite) {
            return diverged("a further object is nowhere".to_owned());
        }
        Ok(())
    }
}

/// Joint angles and gripper width an episode starts with.
fn start_configuration(
    robot: &RobotModel,
    scene: &Scene,
    setup: &EpisodeSetup,
) -> Result<(JointVec, f64), CellError> {
    match &setup.start {
        Start::Home { offset_rad } => {
            let q: JointVec = robot
                .home
                .iter()
                .enumerate()
                .map(|(i, h)| h + offset_rad.get(i).copied().unwrap_or(0.0))
                .collect();
            Ok((robot.geometry.chain.clamped(&q, 1e-3), robot.gripper.width_max_m()))
        }
        Start::Held { tool, .. } => {
            let outcome = robot.solve_ik(&tool.isometry(), &robot.home, &IkOptions::GLOBAL);
            if !outcome.converged(1e-4) {
                let problem =
                    format!("tool pose {:?} is out of reach (error {:.4})", tool.position, outcome.error);
                return Err(CellError::InvalidStart { seed: setup.seed, problem });
            }
            // Just wide enough for the cube at the largest start yaw.
            Ok((outcome.q, 2.0 * scene.object.half_m + 0.004))
        }
    }
}

/// Whether the gripper answers at a world tick.
fn tool_available(setup: &EpisodeSetup, tick: u64) -> bool {
    !setup.tool_windows.iter().any(|window| (window.begin..window.end).contains(&tick))
}
