//! One tick of physics: who computes it, and when the state changes hands.

use rapier3d::parry::query::DefaultQueryDispatcher;
use rapier3d::pipeline::PhysicsWorld;

use crate::effort::{self, Fidelity, SolverEffort};
use crate::handles::Handles;
use crate::motors::Drives;
use crate::reduced_state::{ReducedCell, StateOwner};
use crate::robot::RobotModel;

/// Advances a cell in one fidelity. Follows from robot, cell and fidelity alone; what changes from
/// tick to tick is the engine's world and the [`StateOwner`] beside it.
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

    /// Advances the cell by one tick under the given drives. Returns true if the arm's own dynamics
    /// computed the tick and the physics engine rested.
    pub fn tick(
        &self,
        owner: &mut StateOwner,
        physics: &mut PhysicsWorld,
        handles: &Handles,
        drives: &Drives,
    ) -> bool {
        let weight =
            || physics.bodies.get(handles.object).map_or(1.0, |body| f64::from(body.gravity_scale()));
        if let (Some(cell), Some(state)) = (&self.cell, owner.own.as_mut())
            && cell.tick(state, physics, drives, weight())
        {
            return true;
        }
        let last = owner.take();
        if let (Some(cell), Some(state)) = (&self.cell, &last) {
            cell.leave(state, physics, handles);
        }
        drives.apply(physics, handles);
        // What the engine knows of contacts is from before the own dynamics moved the object.
        let effort = match &last {
            Some(state) if state.moving() => SolverEffort::FULL,
            _ => SolverEffort::of(self.fidelity, effort::situation(physics, handles)),
        };
        let before = physics.integration_parameters.num_solver_iterations;
        effort.apply(physics);
        // Without a handover or a change of substeps in this tick, the engine's own warm start is right.
        let warm = self.cell.as_ref().filter(|_| last.is_some() || before != effort.substeps);
        if let Some(cell) = warm {
            physics.narrow_phase.set_query_dispatcher(cell.warm_start(last.as_ref(), before, effort));
            physics.step();
            physics.narrow_phase.set_query_dispatcher(DefaultQueryDispatcher);
        } else {
            physics.step();
        }
        if let Some(cell) = &self.cell {
            let situation = effort::situation(physics, handles);
            owner.follow_objects(physics, handles);
            owner.own = cell.enter(physics, handles, (situation, effort), owner);
        }
        false
    }
}
