//! The rows of a tick's constraints, and the speeds that they read and move.
//!
//! Rows live in coordinates in which every inertia is the identity (see [`Factor`]), so that one vector
//! both reads a row's speed and takes its impulse.

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use crate::dynamics::{DOFS_MAX, Dofs, Factor};
use crate::free_body::FreeBody;
use crate::object_contacts::{CONTACTS_MAX, FACES_MAX};

/// Degrees of freedom of arm and object together.
pub const WIDTH: usize = DOFS_MAX + 6;
/// Where rows on the object alone begin: they are 0 from there to the object's own part.
const OBJECT_FROM: usize = DOFS_MAX / LANES * LANES;
const _: () = assert!(WIDTH == 4 * LANES && OBJECT_FROM == 2 * LANES);
/// Sums taken side by side.
pub const LANES: usize = 4;

/// What a row reads and moves.
pub type Coordinates = [f64; WIDTH];

/// Rows of the fingers: motor and violated end of each, and the coupling.
pub const JOINT_ROWS_MAX: usize = 5;
/// Friction of a face: about its normal, then along two tangents.
pub const FRICTION_ROWS: usize = 3;
/// The most rows of a tick.
const ROWS_MAX: usize = JOINT_ROWS_MAX + CONTACTS_MAX + FRICTION_ROWS * FACES_MAX;

/// All rows, and the speeds that they read and move.
pub struct CoupledRows {
    rows: ArrayVec<Coordinates, ROWS_MAX>,
    /// Whether a row has a part on the arm.
    on_arm: ArrayVec<bool, ROWS_MAX>,
    impulses: ArrayVec<f64, ROWS_MAX>,
    u: Coordinates,
    /// The speeds at the beginning of the step.
    before: Coordinates,
}

/// Product of a row with the coordinates from `FROM` on.
fn dot<const FROM: usize>(a: &Coordinates, b: &Coordinates) -> f64 {
    // Four sums side by side, and each in two halves: nothing waits as long as for this. The order is fixed, so the
    // result is too.
    let mut sums = [0.0; LANES];
    for lane in 0..LANES {
        let part = |at: usize| a[at + lane] * b[at + lane];
        let late = part(2 * LANES) + part(3 * LANES);
        sums[lane] = if FROM == 0 { (part(0) + part(LANES)) + late } else { late };
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

fn push<const FROM: usize>(u: &mut Coordinates, row: &Coordinates, impulse: f64) {
    for (value, share) in u[FROM..].iter_mut().zip(&row[FROM..]) {
        *value += share * impulse;
    }
}

impl CoupledRows {
    /// No rows yet.
    pub const fn new() -> Self {
        Self {
            rows: ArrayVec::new_const(),
            on_arm: ArrayVec::new_const(),
            impulses: ArrayVec::new_const(),
            u: [0.0; WIDTH],
            before: [0.0; WIDTH],
        }
    }

    /// Adds a row with the impulse that it starts from. Returns the change of its own speed per impulse.
    pub fn add(&mut self, row: &Coordinates, on_arm: bool, impulse: f64) -> f64 {
        self.rows.push(*row);
        self.on_arm.push(on_arm);
        self.impulses.push(impulse);
        if on_arm { dot::<0>(row, row) } else { dot::<OBJECT_FROM>(row, row) }
    }

    /// The speed of a row under the present impulses.
    pub fn speed(&self, row: usize) -> f64 {
        let coordinates = &self.rows[row];
        if self.on_arm[row] {
            dot::<0>(coordinates, &self.u)
        } else {
            dot::<OBJECT_FROM>(coordinates, &self.u)
        }
    }

    fn push(&mut self, row: usize, impulse: f64) {
        let coordinates = &self.rows[row];
        if self.on_arm[row] {
            push::<0>(&mut self.u, coordinates, impulse);
        } else {
            push::<OBJECT_FROM>(&mut self.u, coordinates, impulse);
        }
    }

    /// Begins the first step at these speeds, from the impulses that the rows were added with.
    pub fn begin(&mut self, u: &Coordinates) {
        (self.before, self.u) = (*u, *u);
        for row in 0..self.rows.len() {
            let impulse = self.impulses[row];
            if impulse != 0.0 {
                self.push(row, impulse);
            }
        }
    }

    /// Begins another step at these speeds, from the impulses of the last one.
    pub fn begin_again(&mut self, u: &Coordinates) {
        let last = self.before;
        self.before = *u;
        for ((value, last), now) in self.u.iter_mut().zip(&last).zip(u) {
            *value += now - last;
        }
    }

    /// The speeds under the present impulses.
    pub fn speeds(&self) -> &Coordinates {
        &self.u
    }

    /// How many rows there are.
    pub fn count(&self) -> usize {
        self.rows.len()
    }

    /// One row.
    pub fn row(&self, row: usize) -> Coordinates {
        self.rows[row]
    }

    /// Whether a row has a part on the arm.
    pub fn is_on_arm(&self, row: usize) -> bool {
        self.on_arm[row]
    }

    /// The impulse of a row.
    pub fn impulse(&self, row: usize) -> f64 {
        self.impulses[row]
    }

    /// The impulses of all rows.
    pub fn impulses(&self) -> &[f64] {
        &self.impulses
    }

    /// Sets the impulse of a row. Returns by how much it changed.
    pub fn set(&mut self, row: usize, impulse: f64) -> f64 {
        let change = impulse - self.impulses[row];
        self.impulses[row] = impulse;
        self.push(row, change);
        change.abs()
    }
}

/// A row on the arm in the factor's coordinates.
pub fn on_arm(factor: &Factor, row: &Dofs) -> Coordinates {
    let mut wide = [0.0; WIDTH];
    wide[..DOFS_MAX].copy_from_slice(&factor.forward(row));
    wide
}

/// Speeds of arm and object as the rows see them.
pub fn coordinates(factor: &Factor, dq: &Dofs, object: Option<&FreeBody>) -> Coordinates {
    let mut u = [0.0; WIDTH];
    u[..DOFS_MAX].copy_from_slice(&factor.whiten(dq));
    if let Some(object) = object {
        let (linear, angular) =
            (object.linear * libm::sqrt(object.mass_kg), object.angular * libm::sqrt(object.inertia_kg_m2));
        u[DOFS_MAX..DOFS_MAX + 3].copy_from_slice(linear.as_slice());
        u[DOFS_MAX + 3..].copy_from_slice(angular.as_slice());
    }
    u
}

/// Adds what a free fall does to the object in a step, m/s.
pub fn fall(u: &mut Coordinates, object: &FreeBody, change_m_s: &Vector3<f64>) {
    let mass = libm::sqrt(object.mass_kg);
    for (value, part) in u[DOFS_MAX..].iter_mut().zip(change_m_s) {
        *value += part * mass;
    }
}

/// The arm's speeds in what the rows have solved.
pub fn arm_speeds(factor: &Factor, u: &Coordinates) -> Dofs {
    let mut y = [0.0; DOFS_MAX];
    y.copy_from_slice(&u[..DOFS_MAX]);
    factor.backward(&y)
}

/// The object's speeds in what the rows have solved.
pub fn object_speeds(object: &mut FreeBody, u: &Coordinates) {
    let (linear, angular) = (1.0 / libm::sqrt(object.mass_kg), 1.0 / libm::sqrt(object.inertia_kg_m2));
    object.linear = Vector3::new(u[DOFS_MAX], u[DOFS_MAX + 1], u[DOFS_MAX + 2]) * linear;
    object.angular = Vector3::new(u[DOFS_MAX + 3], u[DOFS_MAX + 4], u[DOFS_MAX + 5]) * angular;
}
