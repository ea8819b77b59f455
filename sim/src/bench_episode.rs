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

use nalgebra::{Isometry3, Vector3};
use rapier3d::pipeline::PhysicsWorld;

use crate::build::{self, CellFixtures};
use crate::effort::Fidelity;
use crate::handles::Handles;
use crate::motors::{Drives, MotorReference};
use crate::readout;
use crate::reduced_state::{ReducedState, StateOwner};
use crate::robot::RobotModel;
use crate::stepper::Stepper;
use holdpoint_body::chain::Transform;
use holdpoint_body::ik::IkOptions;
use holdpoint_body::{Pose, TICK_SECS};
use holdpoint_cell::CellError;
use holdpoint_cell::episode::{ObjectSetup, tool_down, upright};
use holdpoint_cell::rng::Stream;
use holdpoint_cell::scene::Table;
use holdpoint_cell::truth::ContactForces;

/// Ticks of an episode: 4 s at 240 Hz.
pub const STEPS: u32 = 960;
const LIFT_CHECK_STEP: u32 = 624;
/// The grip has closed.
const HELD_FROM_STEP: u32 = 470;
/// The fingers open.
const OPEN_STEP: u32 = 888;
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
    /// Ticks in which the physics engine rested.
    pub rested_ticks: u32,
}

/// What happened on the way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PeerTrace {
    /// Hardest contact of the robot, or of what it grips, with its surroundings, N.
    pub peak_force_n: f64,
    /// Hardest contact of the cube with the table while a pad touches it, N.
    pub impact_n: f64,
    /// Furthest displacement of the cube in the hand, m.
    pub slip_m: f64,
    /// Height from which the cube was let go, m.
    pub drop_m: f64,
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
    /// [`CellError::File`] if the embedded description were wrong (a test loads it).
    pub fn new(fidelity: Fidelity) -> Result<Self, CellError> {
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
    /// [`CellError`] when the cell cannot be built.
    pub fn run(&self, seed: u64) -> Result<PeerOutcome, CellError> {
        self.play(seed, |_| {})
    }

    /// Runs one episode and measures what happened on the way.
    ///
    /// # Errors
    /// As [`PeerBench::run`].
    pub fn run_traced(&self, seed: u64) -> Result<(PeerOutcome, PeerTrace), CellError> {
        let joints = self.robot.geometry.joint_count();
        let mut trace = PeerTrace::default();
        let (mut step, mut reference, mut let_go) = (0_u32, None, 0.0);
        let mut forces = ContactForces::default();
        let mut rest = 0.0;
        let outcome = self.play(seed, |stage| {
            step += 1;
            let object = stage.object();
            let (q, now) = match (&stage.owner.own, stage.stepper.cell()) {
                (Some(own), Some(cell)) => (cell.joint_state(own), own.forces(&forces)),
                _ => (
                    readout::joint_state(stage.physics, stage.handles, &self.robot),
                    readout::contact_forces(stage.physics, stage.handles, joints),
                ),
            };
            forces = now;
            trace.peak_force_n = trace.peak_force_n.max(forces.surroundings_n());
            if forces.contacts.pad_object {
                trace.impact_n = trace.impact_n.max(forces.object_surroundings_n);
                let_go = object.z;
            }
            rest = object.z;
            if (HELD_FROM_STEP..OPEN_STEP).contains(&step) {
                let tool = self.robot.geometry.chain.frames(&q.q).tool;
                let local = tool.rotation.transpose() * (object - tool.origin);
                let from = *reference.get_or_insert(local);
                trace.slip_m = trace.slip_m.max((local - from).norm());
            }
        })?;
        trace.drop_m = (let_go - rest).max(0.0);
        Ok((outcome, trace))
    }

    /// Runs one episode and shows every tick before it is computed.
    fn play(&self, seed: u64, watch: impl FnMut(&mut PendingTick<'_>)) -> Result<PeerOutcome, CellError> {
        self.play_plan(&EpisodePlan::new(seed), watch)
    }

    fn play_plan(
        &self,
        plan: &EpisodePlan,
        mut watch: impl FnMut(&mut PendingTick<'_>),
    ) -> Result<PeerOutcome, CellError> {
        let [cx, cy, cyaw] = plan.cube;
        let cube = Pose::from(&upright(cx, cy, CUBE_HALF_M, cyaw));
        let object = ObjectSetup { pose: cube, mass_kg: 0.1, friction: 1.0 };
        let cell = CellFixtures {
            table: &self.table,
            tray: None,
            clutter: Vec::new(),
            object_half_m: CUBE_HALF_M,
            object: &object,
            further: Vec::new(),
            self_contacts: false,
        };
        let (mut physics, handles) = build::assemble(&self.robot, &cell, &self.robot.home, 2.0 * OPEN_M)?;
        let stepper = Stepper::new(self.fidelity, &self.robot, &physics, &handles, false);
        let mut owner = StateOwner::default();
        let centre = |owner: &StateOwner, physics: &PhysicsWorld| {
            let held = owner.own.as_ref().map(ReducedState::object);
            held.unwrap_or_else(|| readout::object_state(physics, &handles)).0.translation
        };
        let options = IkOptions {
            iterations_max: 20,
            tolerance: 1e-4,
            posture_gain: 0.0,
            step_max_rad: 0.2,
            restarts: 0,
        };
        let mut q = self.robot.home.clone();
        let (mut segment, mut ik_iterations, mut lifted, mut rested_ticks) = (0, 0, false, 0);
        for step in 1..=STEPS {
            let (goal, opening) = plan.goal(step, &mut segment);
            let solved =
                self.robot.geometry.chain.solve_frame(&Transform::new(&goal), &q, &self.robot.home, &options);
            ik_iterations += solved.iterations as u64 + 1;
            // Joint targets with their rate, and the fingers' step change.
            let reference =
                |(at, old): (&f64, &f64)| MotorReference { position: *at, speed: (at - old) / TICK_SECS };
            let drives = Drives {
                arm: solved.q.iter().zip(&q).map(reference).collect(),
                finger: MotorReference { position: opening, speed: 0.0 },
                finger_force_n: self.robot.gripper.force_max_n,
            };
            q = solved.q;
            watch(&mut PendingTick {
                stepper: &stepper,
                owner: &mut owner,
                physics: &physics,
                handles: &handles,
                drives: &drives,
            });
            rested_ticks += u32::from(stepper.tick(&mut owner, &mut physics, &handles, &drives));
            if step == LIFT_CHECK_STEP {
                lifted = centre(&owner, &physics).z >= CUBE_HALF_M + 0.10;
            }
        }
        let cube = centre(&owner, &physics);
        let place_error_m = libm::hypot(cube.x - plan.target[0], cube.y - plan.target[1]);
        let placed = lifted && place_error_m <= 0.02 && (cube.z - CUBE_HALF_M).abs() <= 0.01;
        Ok(PeerOutcome { lifted, placed, ik_iterations, place_error_m, rested_ticks })
    }
}

/// A tick about to be computed.
struct PendingTick<'a> {
    stepper: &'a Stepper,
    owner: &'a mut StateOwner,
    physics: &'a PhysicsWorld,
    handles: &'a Handles,
    #[cfg_attr(not(test), expect(dead_code, reason = "for tests, which compute the tick themselves"))]
    drives: &'a Drives,
}

impl PendingTick<'_> {
    /// Center of the object.
    fn object(&self) -> Vector3<f64> {
        let held = self.owner.own.as_ref().map(ReducedState::object);
        held.unwrap_or_else(|| readout::object_state(self.physics, self.handles)).0.translation.vector
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effort::{self, SolverEffort};
    use holdpoint_cell::truth::JointState;

    /// Largest difference of positions and of speeds of the arm, then of the fingers.
    fn apart(a: &JointState, b: &JointState) -> [f64; 4] {
        let most = |a: &[f64], b: &[f64]| a.iter().zip(b).fold(0.0_f64, |m, (x, y)| m.max((x - y).abs()));
        let finger =
            |part: usize| (0..2).map(|i| (a.fingers[i][part] - b.fingers[i][part]).abs()).fold(0.0, f64::max);
        [most(&a.q, &b.q), most(&a.dq, &b.dq), finger(0), finger(1)]
    }

    /// From the same state, one tick of the engine and one without it.
    #[test]
    fn reduced_tick_equals_the_tick_of_the_physics_engine() {
        let bench = PeerBench::new(Fidelity::Reduced).expect("the robot parses");
        for seed in 0..3 {
            let mut before: Option<(ReducedState, bool)> = None;
            let (mut free, mut held) = (0, 0);
            let (mut substeps, mut last_steps, mut same_steps) = (0, 0, 0);
            let (mut worst, mut usual) = ([[0.0_f64; 6]; 2], [Vec::new(), Vec::new()]);
            bench
                .play(seed, |stage| {
                    let cell = stage.stepper.cell().expect("in this fidelity");
                    // With the same steps in the tick and, as the engine goes on from its last step, in those before.
                    let steps = stage.physics.integration_parameters.num_solver_iterations;
                    same_steps = if steps == last_steps { same_steps + 1 } else { 0 };
                    last_steps = steps;
                    let alike = substeps == steps && same_steps >= 2;
                    if let Some((own, was_moving)) = before.take().filter(|_| alike) {
                        let engine = readout::joint_state(stage.physics, stage.handles, &bench.robot);
                        let row = &mut worst[usize::from(was_moving)];
                        for (most, value) in row.iter_mut().zip(apart(&cell.joint_state(&own), &engine)) {
                            *most = most.max(value);
                        }
                        if was_moving {
                            let (pose, _, _) = own.object();
                            let (at, _, _) = readout::object_state(stage.physics, stage.handles);
                            let object = (pose.translation.vector - at.translation.vector).norm();
                            let forces = readout::contact_forces(stage.physics, stage.handles, 7).pad_n;
                            let ours = own.forces(&ContactForces::default()).pad_n;
                            let pads = (forces[0] - ours[0]).abs().max((forces[1] - ours[1]).abs());
                            (row[4], row[5]) = (row[4].max(object), row[5].max(pads));
                            usual[0].push(object);
                            usual[1].push(pads);
                        }
                    }
                    // The engine takes every tick; the other dynamics start from its state each time.
                    stage.owner.own = None;
                    let situation = effort::situation(stage.physics, stage.handles);
                    let effort = SolverEffort::of(Fidelity::Reduced, situation);
                    let own = cell.enter(stage.physics, stage.handles, (situation, effort), stage.owner);
                    if let Some(mut own) = own {
                        let began = own.moving();
                        assert!(
                            cell.tick(&mut own, stage.physics, stage.drives, 1.0),
                            "nothing is near in this episode"
                        );
                        // It may come near at the begin of a tick, and come to rest at the end.
                        let moving = began || own.moving();
                        substeps = if moving { 2 } else { 1 };
                        if moving {
                            held += 1;
                        } else {
                            free += 1;
                        }
                        before = Some((own, moving));
                    }
                })
                .expect("the episode runs");
            println!(
                "seed {seed}: {free} free, {held} held; q, dq, finger q, finger dq, object, pad N: {worst:?}"
            );
            assert!(free > 350 && held > 300, "{free} {held}");
            let [free, held] = worst;
            assert!(free[0] < 2e-6 && free[1] < 3e-4, "{free:?}");
            // The sweeps end at five hundredths of a newton, which moves a finger by a micron or two.
            assert!(free[2] < 2e-6 && free[3] < 2e-4, "{free:?}");
            assert!(held[0] < 2e-5 && held[1] < 5e-3, "{held:?}");
            // Where pads meet the object, or it falls onto the table, in this very tick, and in nine ticks of ten.
            assert!(held[4] < 1e-3 && held[5] < 2.0, "{held:?}");
            let most = usual.map(|mut all| {
                all.sort_by(f64::total_cmp);
                all[all.len() * 9 / 10]
            });
            // The sweeps end at five hundredths of a newton in each point, and a pad has four.
            assert!(most[0] < 1e-5 && most[1] < 0.15, "{most:?}");
        }
    }

    /// Out of the engine and back without a tick between: the same state, to the bit.
    #[test]
    fn two_changes_of_owner_keep_the_state() {
        let bench = PeerBench::new(Fidelity::Reduced).expect("the robot parses");
        let mut compared = 0;
        bench
            .play(5, |stage| {
                let cell = stage.stepper.cell().expect("in this fidelity");
                stage.owner.own = None;
                let situation = effort::situation(stage.physics, stage.handles);
                let effort = SolverEffort::of(Fidelity::Reduced, situation);
                let own = cell.enter(stage.physics, stage.handles, (situation, effort), stage.owner);
                let Some(own) = own else { return };
                compared += 1;
                if compared % 50 != 0 {
                    return;
                }
                let bytes = postcard::to_allocvec(&own).expect("it is written");
                let read: ReducedState = postcard::from_bytes(&bytes).expect("and read");
                assert_eq!(postcard::to_allocvec(&read).expect("it is written"), bytes);
                let bytes = postcard::to_allocvec(stage.physics).expect("it is written");
                let mut copy: PhysicsWorld = postcard::from_bytes(&bytes).expect("and read");
                cell.leave(&own, &mut copy, stage.handles);
                let state =
                    |physics: &PhysicsWorld| readout::joint_state(physics, stage.handles, &bench.robot);
                assert_eq!(state(&copy), state(stage.physics));
                let (a, b) = (
                    readout::object_state(&copy, stage.handles),
                    readout::object_state(stage.physics, stage.handles),
                );
                assert!((a.0.translation.vector - b.0.translation.vector).norm() < 1e-9);
                assert!(a.0.rotation.angle_to(&b.0.rotation) < 1e-6);
                assert_eq!((a.1, a.2), (b.1, b.2));
            })
            .expect("the episode runs");
        assert!(compared > 700, "{compared}");
    }

    /// Where ticks change hands, positions go on as the speeds say and speeds as in the ticks around.
    #[test]
    fn positions_and_speeds_are_continuous_where_the_owner_changes() {
        let bench = PeerBench::new(Fidelity::Reduced).expect("the robot parses");
        for seed in 0..4 {
            let mut track: Vec<(bool, JointState)> = Vec::new();
            // So low that the fingers come within range of the table, which is the engine's.
            let mut plan = EpisodePlan::new(seed);
            for key in &mut plan.keys[1..] {
                key.1[2] -= 0.016;
            }
            bench
                .play_plan(&plan, |stage| {
                    let cell = stage.stepper.cell().expect("in this fidelity");
                    let state = match &stage.owner.own {
                        Some(own) => cell.joint_state(own),
                        None => readout::joint_state(stage.physics, stage.handles, &bench.robot),
                    };
                    track.push((stage.owner.own.is_some(), state));
                })
                .expect("the episode runs");
            let change = |i: usize| {
                let (a, b) = (&track[i - 1].1, &track[i].1);
                let drift = (0..7).map(|j| (b.q[j] - a.q[j] - TICK_SECS * b.dq[j]).abs()).fold(0.0, f64::max);
                let speed = (0..7).map(|j| (b.dq[j] - a.dq[j]).abs()).fold(0.0, f64::max);
                (drift, speed)
            };
            let mut changes = 0;
            for i in 8..track.len() - 8 {
                if track[i].0 == track[i - 1].0 {
                    continue;
                }
                changes += 1;
                let (drift, speed) = change(i);
                let usual = (i - 6..i + 7).filter(|j| *j != i).map(|j| change(j).1).fold(0.0, f64::max);
                // Within a tick the positions go by the speeds of its two steps.
                assert!(drift < 0.5 * TICK_SECS * speed + 2e-5, "seed {seed}, tick {i}: {drift} rad");
                assert!(speed < 2.0 * usual + 2e-3, "seed {seed}, tick {i}: {speed} rad/s, else {usual}");
            }
            assert!((2..40).contains(&changes), "seed {seed}: {changes} changes");
        }
    }
}
