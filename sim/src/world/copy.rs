//! A copy of a world, as bytes or in memory, from which a world continues.
//!
//! One in memory equals a snapshot, without the cost of writing and reading bytes: for a run that one process forks
//! many times.

use rapier3d::dynamics::{CCDSolver, RigidBodyHandle};
use rapier3d::pipeline::{CollisionPipeline, PhysicsPipeline, PhysicsWorld};

use super::{World, WorldConfig};
use crate::further::FurtherSight;
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
    /// The complete state as bytes; see [`World::restore`].
    ///
    /// # Errors
    /// [`CellError::Snapshot`] when the state cannot be written.
    pub fn snapshot(&self) -> Result<Vec<u8>, CellError> {
        let refused = |error: postcard::Error| CellError::Snapshot(error.to_string());
        let (head, s) = ((self.robot.digest, &self.config), &self.state);
        let mut bytes = postcard::to_allocvec(&(head, s)).map_err(refused)?;
        if !self.further.is_empty() {
            // At the end, so that a snapshot without them has no trace of them.
            let further = (&s.handles.further, s.owner.further_still_ticks, &s.further);
            bytes.extend(postcard::to_allocvec(&further).map_err(refused)?);
        }
        Ok(bytes)
    }

    /// Continues from a snapshot of a world with the same robot and as many further objects: bit-identical to never
    /// having stopped. The scene and the objects are the caller's to match.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] when the bytes are not a snapshot, belong to another robot or have other objects; the
    /// world is then unchanged.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), CellError> {
        type Head = (u64, WorldConfig);
        type Further = (Vec<RigidBodyHandle>, u32, FurtherSight);
        let refused = |error: postcard::Error| CellError::Snapshot(error.to_string());
        let (((digest, config), mut state), rest): ((Head, WorldState), &[u8]) =
            postcard::take_from_bytes(bytes).map_err(refused)?;
        if digest != self.robot.digest {
            let problem =
                format!("made with robot \"{digest:016x}\", this one is {:016x}", self.robot.digest);
            return Err(CellError::Snapshot(problem));
        }
        if !rest.is_empty() {
            let further: Further = postcard::from_bytes(rest).map_err(refused)?;
            (state.handles.further, state.owner.further_still_ticks, state.further) = further;
        }
        self.check_further(&state)?;
        self.config = config;
        self.state = state;
        self.prepare();
        self.fill_observation();
        Ok(())
    }

    /// Whether a state has as many further objects as this world.
    fn check_further(&self, state: &WorldState) -> Result<(), CellError> {
        let (made, own) = (state.handles.further.len(), self.further.len());
        if made == own {
            return Ok(());
        }
        Err(CellError::Snapshot(format!("made with \"{made}\" further objects, this cell has {own}")))
    }

    /// Copies the part of the world that changes; [`World::go_on_from`] continues from it.
    #[must_use]
    pub fn copy(&self) -> WorldCopy {
        WorldCopy { robot: self.robot.digest, config: self.config, state: duplicate(&self.state) }
    }

    /// Continues from a copy of a world with the same robot, bit-identical to an uninterrupted run. The
    /// caller ensures that the scene is the same.
    ///
    /// # Errors
    /// [`CellError::Snapshot`] for a copy of a world with another robot or other objects; this one is then unchanged.
    pub fn go_on_from(&mut self, copy: &WorldCopy) -> Result<(), CellError> {
        if copy.robot != self.robot.digest {
            let (made, own) = (copy.robot, self.robot.digest);
            return Err(CellError::Snapshot(format!(
                "made with robot \"{made:016x}\", this one is {own:016x}"
            )));
        }
        self.check_further(&copy.state)?;
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
        further: state.further.clone(),
    }
}
