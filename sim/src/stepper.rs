//! One tick of physics: who computes it, and when the state changes hands.

use rapier3d::pipeline::PhysicsWorld;

use crate::effort::{self, Fidelity, SolverEffort};
use crate::handles::Handles;
use crate::motors::Drives;
use crate::reduced::{Reduced, ReducedCell};
use crate::robot::RobotModel;

/// How the engine takes a grip over. Its own impulses in the pads are those from before it rested,
/// and their friction is not what holds the object now: in this one tick friction is solved together
/// with the pressure, before anything moves.
struct Takeover {
    sweeps: usize,
    relaxations: usize,
}

const TAKEOVER: Takeover = Takeover { sweeps: 24, relaxations: 4 };

impl Takeover {
    fn apply(&self, physics: &mut PhysicsWorld) {
        let p = &mut physics.integration_parameters;
        p.friction_in_bias_pass = true;
        p.num_internal_pgs_iterations = self.sweeps;
        p.num_internal_stabilization_iterations = self.relaxations;
    }

    fn revert(physics: &mut PhysicsWorld) {
        let p = &mut physics.integration_parameters;
        p.friction_in_bias_pass = false;
        p.num_internal_stabilization_iterations = crate::build::RELAXATIONS;
    }
}

/// Advances a cell in one fidelity. Follows from robot, cell and fidelity alone; what changes from
/// tick to tick is the engine's world and an `Option<Reduced>` beside it.
pub struct Stepper {
    fidelity: Fidelity,
    cell: Option<ReducedCell>,
}

impl Stepper {
    /// For a cell as built.
    pub fn new(
        fidelity: Fidelity,
        robot: &RobotModel,
        physics: &PhysicsWorld,
        handles: &Handles,
        self_contacts: bool,
    ) -> Self {
        let reduced = fidelity == Fidelity::Reduced;
        let cell = reduced.then(|| ReducedCell::new(robot, physics, handles, self_contacts));
        Self { fidelity, cell }
    }

    /// The own dynamics, where the fidelity has them.
    pub fn cell(&self) -> Option<&ReducedCell> {
        self.cell.as_ref()
    }

    /// One tick under the given drives; `reduced` is the state while the engine rests. Whether it
    /// rested in this tick.
    pub fn tick(
        &self,
        reduced: &mut Option<Reduced>,
        physics: &mut PhysicsWorld,
        handles: &Handles,
        drives: &Drives,
    ) -> bool {
        let weight =
            || physics.bodies.get(handles.object).map_or(1.0, |body| f64::from(body.gravity_scale()));
        if let (Some(cell), Some(state)) = (&self.cell, reduced.as_mut())
            && cell.tick(state, drives, weight())
        {
            return true;
        }
        let held = reduced.as_ref().is_some_and(Reduced::holds);
        self.wake(reduced, physics, handles);
        drives.apply(physics, handles);
        let situation = effort::situation(physics, handles);
        let effort = SolverEffort::of(self.fidelity, situation);
        effort.apply(physics);
        if held {
            TAKEOVER.apply(physics);
        }
        physics.step();
        if held {
            Takeover::revert(physics);
        }
        if let Some(cell) = &self.cell {
            let situation = effort::situation(physics, handles);
            *reduced = cell.enter(physics, handles, situation, effort);
        }
        false
    }

    /// Gives the state back to the engine, if it rests.
    pub fn wake(&self, reduced: &mut Option<Reduced>, physics: &mut PhysicsWorld, handles: &Handles) {
        if let (Some(cell), Some(state)) = (&self.cell, reduced.take()) {
            cell.leave(&state, physics, handles);
        }
    }
}
