//! How much work the solver does in a tick, and what decides it.
//!
//! The rule looks at who is within contact range of whom, nothing else, so that it is the same
//! function of the physics state after a snapshot as without one.

use rapier3d::pipeline::PhysicsWorld;
use serde::{Deserialize, Serialize};

use crate::handles::{ColliderKind, Handles};
use crate::readout;
use crate::reduced_state;

/// How much work the solver does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fidelity {
    /// More effort than anything needs: what every other mode is judged against.
    Reference,
    /// The least effort that comes to the same as the reference, in every tick.
    Full,
    /// One step per tick in free motion; the full effort where the robot, or what it grips, meets
    /// anything else. Same outcomes as the reference.
    Adaptive,
    /// One step per tick everywhere. Grips and places as well, but forces between a gripped object
    /// and what it stands on come out lower than the reference's.
    Single,
    /// The physics engine rests where the arm is near nothing but the object between its pads: the arm's own
    /// dynamics in joint coordinates, and the object's contacts with pads, table, tray and clutter, take these
    /// ticks. Where anything else is near, the engine works as in `Adaptive`. Same
    /// outcomes as the reference. What decides, and the live cell, work in this mode.
    #[default]
    Reduced,
}

/// Solver settings of one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SolverEffort {
    /// Solver substeps per tick; each solves the arm's dynamics.
    pub substeps: usize,
    /// Gauss-Seidel sweeps over the contacts per substep, before the positions move.
    pub sweeps: usize,
    /// Sweeps after they have moved: these alone have friction.
    pub relaxations: usize,
}

impl SolverEffort {
    /// What the others are judged against. Its forces are not the last word: twice the sweeps take a
    /// newton off the peaks.
    pub const REFERENCE: Self = Self { substeps: 4, sweeps: 4, relaxations: 1 };
    /// Effort where a gripped object meets its surroundings. With one relaxation a lifted object slips by a third of
    /// a millimeter, with two by less than a quarter.
    pub const FULL: Self = Self { substeps: 2, sweeps: 4, relaxations: 2 };
    /// What it takes that an object in the hand does not creep: with one substep it creeps by .6 mm more
    /// than the reference's in two and a half seconds, whatever the sweeps.
    pub const HELD: Self = Self { substeps: 2, sweeps: 8, relaxations: 1 };
    /// The effort of the arm's own dynamics where the object hangs between the pads: their motors start from their last
    /// forces, so half the sweeps do.
    const OWN_HELD: Self = Self { substeps: 2, sweeps: 4, relaxations: 1 };
    /// One step for a robot that touches nothing.
    pub const FREE: Self = Self { substeps: 1, sweeps: 4, relaxations: 1 };
    /// One step for everything, with the sweeps that a grip needs.
    pub const SINGLE: Self = Self { substeps: 1, sweeps: 8, relaxations: 1 };

    /// The effort of a tick that begins in the given situation.
    pub fn of(fidelity: Fidelity, situation: Situation) -> Self {
        match (fidelity, situation) {
            (Fidelity::Reference, _) => Self::REFERENCE,
            (Fidelity::Full, _)
            | (Fidelity::Adaptive | Fidelity::Reduced, Situation::Contact | Situation::Object) => Self::FULL,
            (Fidelity::Single, _) => Self::SINGLE,
            (Fidelity::Adaptive | Fidelity::Reduced, Situation::Held) => Self::HELD,
            (Fidelity::Adaptive | Fidelity::Reduced, Situation::Free) => Self::FREE,
        }
    }

    /// The effort of a tick of the arm's own dynamics.
    pub fn own(object: ObjectSituation) -> Self {
        match object {
            ObjectSituation::Resting => Self::FREE,
            ObjectSituation::Held => Self::OWN_HELD,
            ObjectSituation::Supported => Self::FULL,
        }
    }

    /// Applies the settings.
    pub fn apply(self, physics: &mut PhysicsWorld) {
        let p = &mut physics.integration_parameters;
        p.num_solver_iterations = self.substeps;
        p.num_internal_pgs_iterations = self.sweeps;
        p.num_internal_stabilization_iterations = self.relaxations;
    }
}

/// What the object does in a tick of the arm's own dynamics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectSituation {
    /// It takes no part.
    Resting,
    /// It touches the pads at most.
    Held,
    /// It touches what stands in the cell.
    Supported,
}

/// What is within contact range of what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Situation {
    /// The robot is near nothing, and the object rests.
    Free,
    /// The pads are at the object, and nothing else is near either.
    Held,
    /// The object moves, or is between the pads and what it stands on; nothing else is near.
    Object,
    /// Anything else.
    Contact,
}

/// An object slower than this rests, m/s.
const RESTING_M_S: f64 = 0.005;

/// The situation at the end of the last tick. Pairs count from 4 mm apart, more than twice what the
/// fastest tool covers in a tick, so a touch never finds the solver unprepared.
pub fn situation(physics: &PhysicsWorld, handles: &Handles) -> Situation {
    let (mut gripping, mut supported) = (false, false);
    for pair in physics.narrow_phase.contact_pairs().filter(|pair| pair.has_any_active_contact()) {
        let (Some(a), Some(b)) = (readout::kind(handles, pair, true), readout::kind(handles, pair, false))
        else {
            return Situation::Contact;
        };
        match (a, b) {
            (ColliderKind::Pad(_), ColliderKind::Object) | (ColliderKind::Object, ColliderKind::Pad(_)) => {
                gripping = true;
            }
            (ColliderKind::Object, ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_))
            | (ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_), ColliderKind::Object) => {
                supported = true;
            }
            // What a further object stands on. It counts while it moves.
            (
                ColliderKind::Further,
                ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_) | ColliderKind::Further,
            )
            | (ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_), ColliderKind::Further) => {
            }
            (ColliderKind::Link(_) | ColliderKind::Finger(_) | ColliderKind::Pad(_), _)
            | (_, ColliderKind::Link(_) | ColliderKind::Finger(_) | ColliderKind::Pad(_))
            | (ColliderKind::Object, ColliderKind::Object | ColliderKind::Further)
            | (ColliderKind::Further, ColliderKind::Object)
            | (
                ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_),
                ColliderKind::Table | ColliderKind::Tray | ColliderKind::Clutter(_),
            ) => {
                return Situation::Contact;
            }
        }
    }
    if !reduced_state::further_objects_rest(physics, handles) {
        return Situation::Contact;
    }
    let resting = || readout::object_state(physics, handles).1 < RESTING_M_S;
    match (gripping, supported) {
        (true, true) => Situation::Object,
        (true, false) => Situation::Held,
        (false, true) if !resting() => Situation::Object,
        (false, _) => Situation::Free,
    }
}
