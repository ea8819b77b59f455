//! The engine comparison's episode: 960 ticks of approach, grasp, lift, transfer, place, retreat.
//!
//! Same random numbers, phases, targets and success tests as the comparison's scripts for PyBullet
//! and MuJoCo, so that engines can be timed side by side: a 5 cm cube of 0.1 kg, friction 1.0
//! everywhere, the robot not colliding with itself, inverse kinematics in every tick. f32 physics
//! (the peers compute in f64).
#![allow(
    clippy::cast_possible_truncation,
    reason = "physics is f32: values are narrowed here on their way to the engine"
)]

use nalgebra::Isometry3;
use rapier3d::pipeline::PhysicsWorld;

use crate::build::{self, CellFixtures};
use crate::effort::{self, Fidelity, SolverEffort};
use crate::episode::{ObjectSetup, tool_down, upright};
use crate::error::SimError;
use crate::handles::Handles;
use crate::motors::{self, Reference};
use crate::readout;
use crate::rng::Stream;
use crate::robot::RobotModel;
use crate::scene::Table;
use holdpoint_body::chain::Transform;
use holdpoint_body::ik::IkOptions;
use holdpoint_body::{JointVec, Pose, TICK_SECS};

/// Ticks of an episode: 4 s at 240 Hz.
pub const STEPS: u32 = 960;
const LIFT_CHECK_STEP: u32 = 624;
const CUBE_HALF_M: f64 = 0.025;
const OPEN_M: f64 = 0.04;

/// End of each phase: step, tool x, y, z, yaw, finger opening (m).
type Key = (u32, [f64; 4], f64);

/// One sampled episode.
#[derive(Clone, Debug)]
struct EpisodePlan {
    cube: [f64; 3],
    target: [f64; 2],
    keys: [Key; 9],
}

impl EpisodePlan {
    fn new(seed: u64) -> Self {
        let mut r = Stream::from_state(seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let (cx, cy) = (0.40 + 0.20 * r.unit(), -0.15 + 0.30 * r.unit());
        let cyaw = (2.0 * r.unit() - 1.0) * core::f64::consts::FRAC_PI_4;
        let [tx, ty] = loop {
            let target = [0.40 + 0.20 * r.unit(), -0.25 + 0.50 * r.unit()];
            if libm::hypot(target[0] - cx, target[1] - cy) >= 0.12 {
                break target;
            }
        };
        let (x, y) = (cx + 0.003 * r.normal(), cy + 0.003 * r.normal());
        let z = CUBE_HALF_M + 0.002 * r.normal();
        let yaw = cyaw + core::f64::consts::PI / 90.0 * r.normal();
        let keys = [
            (0, [0.306_890_7, 0.0, 0.485_281_9, 0.0], OPEN_M),
            (240, [x, y, z + 0.12, yaw], OPEN_M),
            (384, [x, y, z, yaw], OPEN_M),
            (480, [x, y, z, yaw], 0.0),
            (LIFT_CHECK_STEP, [x, y, z + 0.15, yaw], 0.0),
            (792, [tx, ty, z + 0.15, yaw], 0.0),
            (888, [tx, ty, z + 0.004, yaw], 0.0),
            (924, [tx, ty, z + 0.004, yaw], OPEN_M),
            (STEPS, [tx, ty, z + 0.064, yaw], OPEN_M),
        ];
        Self { cube: [cx, cy, cyaw], target: [tx, ty], keys }
    }

    /// Tool pose and finger opening after `step`; `segment` only ever grows.
    fn goal(&self, step: u32, segment: &mut usize) -> (Isometry3<f64>, f64) {
        while *segment + 2 < self.keys.len() && step > self.keys[*segment + 1].0 {
            *segment += 1;
        }
        let (a, b) = (&self.keys[*segment], &self.keys[*segment + 1]);
        let t = f64::from(step - a.0) / f64::from(b.0 - a.0);
        let s = t * t * (3.0 - 2.0 * t);
        let [x, y, z, yaw] = core::array::from_fn(|i| a.1[i] + s * (b.1[i] - a.1[i]));
        (tool_down(x, y, z, yaw), b.2)
    }
}

/// What one episode came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeerOutcome {
    /// Cube raised by at least 10 cm after the lift.
    pub lifted: bool,
    /// Lifted, and at the end within 2 cm of the target and 1 cm of the table height.
    pub placed: bool,
    /// Inverse kinematics iterations, all ticks together.
    pub ik_iterations: u64,
    /// Final distance to the target, m.
    pub place_error_m: f64,
}

/// The comparison's robot, and how hard its solver works.
pub struct PeerBench {
    robot: RobotModel,
    table: Table,
    fidelity: Fidelity,
}

impl PeerBench {
    /// Reads the robot.
    ///
    /// # Errors
    /// [`SimError::File`] if the embedded description were wrong (a test loads it).
    pub fn new(fidelity: Fidelity) -> Result<Self, SimError> {
        let robot = RobotModel::from_texts(
            "builtin:peer.urdf",
            include_str!("../assets/peer.urdf"),
            "builtin:peer.toml",
            include_str!("../assets/peer.toml"),
        )?;
        let table = Table { centre_m: [0.6, 0.0, -0.02], half_m: [0.4, 0.6, 0.02], friction: 1.0 };
        Ok(Self { robot, table, fidelity })
    }

    /// Runs one episode: builds the cell, 960 ticks, judges.
    ///
    /// # Errors
    /// [`SimError`] when the cell cannot be built.
    pub fn run(&self, seed: u64) -> Result<PeerOutcome, SimError> {
        let plan = EpisodePlan::new(seed);
        let [cx, cy, cyaw] = plan.cube;
        let cube = Pose::from(&upright(cx, cy, CUBE_HALF_M, cyaw));
        let object = ObjectSetup { pose: cube, mass_kg: 0.1, friction: 1.0 };
        let cell = CellFixtures {
            table: &self.table,
            tray: None,
            clutter: Vec::new(),
            object_half_m: CUBE_HALF_M,
            object: &object,
            self_contacts: false,
        };
        let (mut physics, handles) = build::assemble(&self.robot, &cell, &self.robot.home, 2.0 * OPEN_M)?;
        let options = IkOptions {
            iterations_max: 20,
            tolerance: 1e-4,
            posture_gain: 0.0,
            step_max_rad: 0.2,
            restarts: 0,
        };
        let mut q = self.robot.home.clone();
        let (mut segment, mut ik_iterations, mut lifted) = (0, 0, false);
        for step in 1..=STEPS {
            let (goal, opening) = plan.goal(step, &mut segment);
            let solved =
                self.robot.geometry.chain.solve_frame(&Transform::new(&goal), &q, &self.robot.home, &options);
            ik_iterations += solved.iterations as u64 + 1;
            self.command(&mut physics, &handles, &solved.q, &q, opening);
            q = solved.q;
            physics.step();
            if step == LIFT_CHECK_STEP {
                lifted = readout::object_state(&physics, &handles).0.translation.z >= CUBE_HALF_M + 0.10;
            }
        }
        let cube = readout::object_state(&physics, &handles).0.translation;
        let place_error_m = libm::hypot(cube.x - plan.target[0], cube.y - plan.target[1]);
        let placed = lifted && place_error_m <= 0.02 && (cube.z - CUBE_HALF_M).abs() <= 0.01;
        Ok(PeerOutcome { lifted, placed, ik_iterations, place_error_m })
    }

    /// Joint targets with their rate, and the fingers' step change.
    fn command(
        &self,
        physics: &mut PhysicsWorld,
        handles: &Handles,
        q: &JointVec,
        before: &JointVec,
        opening: f64,
    ) {
        let Some((multibody, _)) = physics.multibody_joints.get_mut(handles.first_joint) else { return };
        for (i, id) in handles.link_ids.iter().enumerate() {
            let Some(link) = multibody.link_mut(*id) else { continue };
            motors::engage_limit(&mut link.joint, i < q.len());
            if let (Some(angle), Some(old)) = (q.get(i), before.get(i)) {
                let speed = (angle - old) / TICK_SECS;
                motors::drive_joint(multibody, *id, Reference { position: *angle, speed });
            } else {
                let reference = Reference { position: opening, speed: 0.0 };
                motors::drive_finger(&mut link.joint, reference, self.robot.gripper.force_max_n);
            }
        }
        let situation = effort::situation(physics, handles);
        SolverEffort::of(self.fidelity, situation).apply(physics);
    }
}
