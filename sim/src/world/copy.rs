//! An in-memory copy of a world, from which a world continues.
//!
//! Equals a snapshot, without the cost of writing and reading bytes: for a run that one process forks many
//! times.

use rapier3d::dynamics::CCDSolver;
use rapier3d::pipeline::{CollisionPipeline, PhysicsPipeline, PhysicsWorld};

use super::{World, WorldConfig};
use crate::state::WorldState;
use holdpoint_cell::CellError;

/// Everything of a world that changes, at one tick.
pub struct WorldCopy {
    robot: u64,
    config: WorldConfig,
    state: WorldState,
}

impl WorldCopy {
    /// Ticks since the reset.
    #[must_use]
    pub const fn tick(&self) -> u64 {
        self.state.tick
    }
}

impl World {
    /// Copies the part of the world that changes; [`World::go_on_from`] continues from it.
    #[must_use]
    pub fn copy(&self) -> WorldCopy {
        WorldCopy { robot: self.robot.digest, config: self.config, state: duplicate(&self.state) }
    }

    /// Continues from a copy of a world with the same robot, bit-identical to an uninterrupted run. The
    /// caller ensures that the scene is the same.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] for a copy of another robot's world; this one is then unchanged.
    pub fn go_on_from(&mut self, copy: &WorldCopy) -> Result<(), CellError> {
        if copy.robot != self.robot.digest {
            let (made, own) = (copy.robot, self.robot.digest);
            return Err(CellError::Snapshot(format!(
                "made with robot \"{made:016x}\", this one is {own:016x}"
            )));
        }
        crate::work_count::note(|count| count.forks += 1);
        self.config = copy.config;
        self.state = duplicate(&copy.state);
        self.prepare();
        self.fill_observation();
        self.rewind_film();
        Ok(())
    }
}

/// Names every field, so that the compiler reports a new field that is missing here. As after a snapshot, the
/// working memory of the physics engine starts empty.
fn duplicate(state: &WorldState) -> WorldState {
    let p = &state.physics;
    let physics = PhysicsWorld {
        gravity: p.gravity,
        integration_parameters: p.integration_parameters,
        physics_pipeline: PhysicsPipeline::new(),
        collision_pipeline: CollisionPipeline::new(),
        islands: p.islands.clone(),
        broad_phase: p.broad_phase.clone(),
        narrow_phase: p.narrow_phase.clone(),
        bodies: p.bodies.clone(),
        colliders: p.colliders.clone(),
        impulse_joints: p.impulse_joints.clone(),
        multibody_joints: p.multibody_joints.clone(),
        soft_bodies: p.soft_bodies.clone(),
        ccd_solver: CCDSolver::new(),
    };
    WorldState {
        physics,
        handles: state.handles.clone(),
        owner: state.owner.clone(),
        setup: state.setup.clone(),
        task: state.task,
        tick: state.tick,
        task_start: state.task_start,
        servo: state.servo.clone(),
        queue: state.queue.clone(),
        last_due: state.last_due,
        camera: state.camera.clone(),
        guard: state.guard,
        faults: state.faults,
        stop_declared: state.stop_declared,
        object_start_z: state.object_start_z,
        grip: state.grip.clone(),
        joints: state.joints.clone(),
        forces: state.forces,
        errors: state.errors.clone(),
    }
}
