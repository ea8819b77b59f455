//! The constraints of a tick that the arm's own dynamics solve: finger motors, their coupling and ends, and the
//! object's contacts with the pads and with what stands in the cell.
//!
//! The same laws as the physics engine's rows, in f64: soft constraints after Catto (*Soft
//! Constraints*, GDC 2011), projected Gauss-Seidel, friction only in the sweep after the positions have moved. Rows
//! live in coordinates in which every inertia is the identity (see [`Factor`]), so that one vector
//! both reads a row's speed and takes its impulse. Units SI; poses and directions in the base frame
//! unless a name says otherwise.

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use crate::dynamics::{DOFS_MAX, Dofs, Factor, Placement};
use crate::free_body::FreeBody;
use crate::motors::MotorReference;
use crate::object_contacts::{CONTACTS_MAX, ObjectContact, ObjectContacts};
use holdpoint_body::TICK_SECS;

/// Degrees of freedom of arm and object together.
const WIDTH: usize = DOFS_MAX + 6;
/// Where rows on the object alone begin: they are 0 from there to the object's own part.
const OBJECT_FROM: usize = DOFS_MAX / LANES * LANES;
const _: () = assert!(WIDTH == 4 * LANES && OBJECT_FROM == 2 * LANES);
/// Sums taken side by side.
const LANES: usize = 4;
/// A sweep that changes no impulse by more than this ends the sweeps, N s: a force of five thousandths of a newton.
const SETTLED_N_S: f64 = 1e-5;
/// What a row reads and moves.
pub type Coordinates = [f64; WIDTH];

/// A spring and damper in place of a rigid constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Softness {
    /// Natural frequency, Hz.
    pub frequency_hz: f64,
    /// Damping ratio.
    pub ratio: f64,
}

impl Softness {
    /// Joint limits and couplings: as good as rigid.
    const RIGID: Self = Self { frequency_hz: 1e6, ratio: 1.0 };

    /// Share of an error taken back per second, and the compliance relative to the row's own, in steps
    /// of `secs`.
    fn gains(self, secs: f64) -> (f64, f64) {
        let speed = core::f64::consts::TAU * self.frequency_hz;
        let rate = speed / (secs * speed + 2.0 * self.ratio);
        let rest = 1.0 / (secs * rate) - 1.0;
        (rate, rest * rest / ((1.0 + rest) * 4.0 * self.ratio * self.ratio))
    }
}

/// Commands for the two fingers, and their constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FingerMotors {
    /// Opening and its speed, per finger.
    pub reference: MotorReference,
    /// Largest force, N.
    pub force_n: f64,
    /// Position gain, N/m.
    pub stiffness_n_m: f64,
    /// Damping, N s/m.
    pub damping_n_s_m: f64,
    /// Travel, m.
    pub stroke_m: [f64; 2],
    /// Distance from an end within which the end bounds the motor's speed, m.
    pub near_end_m: f64,
}

/// A row with a bounded impulse.
struct JointRow {
    row: Coordinates,
    inverse: f64,
    gain: f64,
    /// Distance from where it is to be, m; what of it is taken back per second; the speed wanted there.
    error: f64,
    rate: f64,
    speed: f64,
    /// What the row's speed is short of in this step.
    bias: f64,
    /// A motor goes on pulling while the positions stand.
    motor: bool,
    least: f64,
    most: f64,
    impulse: f64,
}

/// The rows of one contact point: along the normal, then along two tangents.
struct ContactRow {
    pair: usize,
    on_arm: bool,
    rows: [Coordinates; 3],
    inverse: [f64; 3],
    gap: f64,
    /// What of a penetration is taken back per second, and how much of an impulse a soft contact keeps.
    rate: f64,
    soft: f64,
    cfm: f64,
    /// Speed with which a gap may close, and a penetration is to open, m/s.
    bias: f64,
    bias_relaxed: f64,
    impulse: [f64; 3],
    /// Normal impulse of the steps before, N s.
    pressed: f64,
    tangents: [Vector3<f64>; 2],
    friction: f64,
}

/// Everything that acts in one tick besides the arm's own dynamics.
pub struct ConstraintRows {
    joints: ArrayVec<JointRow, 5>,
    contacts: ArrayVec<ContactRow, CONTACTS_MAX>,
    secs: f64,
    steps: usize,
}

/// Product of a row with the coordinates from `FROM` on.
fn dot<const FROM: usize>(a: &Coordinates, b: &Coordinates) -> f64 {
    // Four sums side by side, and each in two halves: a sweep waits for nothing as long as for this. The order is
    // fixed, so the result is too.
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

/// A row on the arm in the factor's coordinates.
fn on_arm(factor: &Factor, row: &Dofs) -> Coordinates {
    let mut wide = [0.0; WIDTH];
    wide[..DOFS_MAX].copy_from_slice(&factor.forward(row));
    wide
}

impl JointRow {
    /// Returns by how much the impulse changed.
    fn solve(&mut self, u: &mut Coordinates, relaxed: bool) -> f64 {
        let bias = if relaxed && !self.motor { 0.0 } else { self.bias };
        let speed = bias + dot::<0>(&self.row, u);
        let total =
            (self.impulse + self.inverse * (speed - self.gain * self.impulse)).clamp(self.least, self.most);
        let change = total - self.impulse;
        self.impulse = total;
        push::<0>(u, &self.row, -change);
        change.abs()
    }
}

impl ContactRow {
    fn dot(&self, row: usize, u: &Coordinates) -> f64 {
        if self.on_arm { dot::<0>(&self.rows[row], u) } else { dot::<OBJECT_FROM>(&self.rows[row], u) }
    }

    fn push(&self, row: usize, u: &mut Coordinates, impulse: f64) {
        if self.on_arm {
            push::<0>(u, &self.rows[row], impulse);
        } else {
            push::<OBJECT_FROM>(u, &self.rows[row], impulse);
        }
    }

    /// Moves toward the present gap.
    fn aim(&mut self, secs: f64) {
        /// Most speed with which a penetration is pushed out, m/s.
        const CORRECTION_M_S: f64 = 3.0;
        let slack = self.gap.max(0.0) / secs;
        (self.bias, self.bias_relaxed) = (slack + (self.rate * self.gap).clamp(-CORRECTION_M_S, 0.0), slack);
        // What is still apart meets as rigid bodies do.
        self.cfm = if self.gap > 0.0 { 1.0 } else { self.soft };
    }

    fn press(&mut self, u: &mut Coordinates, relaxed: bool) -> f64 {
        let (bias, cfm) = if relaxed { (self.bias_relaxed, 1.0) } else { (self.bias, self.cfm) };
        let speed = self.dot(0, u) + bias;
        let total = cfm * (self.impulse[0] - self.inverse[0] * speed).max(0.0);
        let change = total - self.impulse[0];
        self.impulse[0] = total;
        self.push(0, u, change);
        change.abs()
    }

    fn rub(&mut self, u: &mut Coordinates) {
        let most = self.friction * self.impulse[0];
        if most == 0.0 && self.impulse[1] == 0.0 && self.impulse[2] == 0.0 {
            return;
        }
        let first = self.impulse[1] - self.inverse[1] * self.dot(1, u);
        let second = self.impulse[2] - self.inverse[2] * self.dot(2, u);
        let size = libm::sqrt(first * first + second * second);
        let share = if size > most { most / size } else { 1.0 };
        let (first, second) = (first * share, second * share);
        self.push(1, u, first - self.impulse[1]);
        self.push(2, u, second - self.impulse[2]);
        (self.impulse[1], self.impulse[2]) = (first, second);
    }
}

impl ConstraintRows {
    /// No rows yet, for a tick of a number of steps.
    #[inline]
    pub fn new(steps: usize) -> Self {
        let secs = TICK_SECS / steps as f64;
        Self { joints: ArrayVec::new(), contacts: ArrayVec::new(), secs, steps }
    }

    /// Adds the fingers' rows: motor and violated end of each, and their coupling. Motors and
    /// coupling start from the impulses of the last tick, N s.
    pub fn fingers(
        &mut self,
        factor: &Factor,
        joints: usize,
        q: &Dofs,
        motors: &FingerMotors,
        impulses: &[f64; 3],
    ) {
        let (secs, steps) = (self.secs, self.steps);
        let (rigid_rate, rigid_cfm) = Softness::RIGID.gains(secs);
        let (k, d) = (motors.stiffness_n_m, motors.damping_n_s_m);
        let rate = k / (secs * k + d);
        let compliance = 1.0 / (secs * (secs * k + d));
        let most = motors.force_n * secs;
        let warm = impulses.map(|impulse| impulse / steps as f64);
        for side in 0..2 {
            let (dof, stroke) = (joints + side, motors.stroke_m[side]);
            let at = q[dof];
            let mut unit = [0.0; DOFS_MAX];
            unit[dof] = 1.0;
            let row = on_arm(factor, &unit);
            let own = dot::<0>(&row, &row);
            let near = !(at > motors.near_end_m && at < stroke - motors.near_end_m);
            let mut speed = motors.reference.speed;
            if near {
                speed = speed.max(-at / secs).min((stroke - at) / secs);
            }
            self.joints.push(JointRow {
                row,
                inverse: 1.0 / (own + compliance),
                gain: compliance,
                error: at - motors.reference.position,
                rate,
                speed,
                bias: 0.0,
                motor: true,
                least: -most,
                most,
                impulse: warm[side].clamp(-most, most),
            });
            if side == 0 {
                let mut pair = [0.0; DOFS_MAX];
                (pair[joints], pair[joints + 1]) = (-1.0, 1.0);
                let row = on_arm(factor, &pair);
                self.joints.push(JointRow {
                    row,
                    inverse: 1.0 / dot::<0>(&row, &row),
                    gain: 0.0,
                    error: q[joints + 1] - q[joints],
                    rate: rigid_rate,
                    speed: 0.0,
                    bias: 0.0,
                    motor: false,
                    least: f64::NEG_INFINITY,
                    most: f64::INFINITY,
                    impulse: warm[2],
                });
            }
        }
        for side in 0..2 {
            let (at, stroke) = (q[joints + side], motors.stroke_m[side]);
            let past = (at - stroke).max(0.0) - (-at).max(0.0);
            if past != 0.0 {
                let row = self.joints[2 * side].row;
                let own = dot::<0>(&row, &row);
                self.joints.push(JointRow {
                    row,
                    inverse: 1.0 / (own * (1.0 + rigid_cfm)),
                    gain: own * rigid_cfm,
                    error: past,
                    rate: rigid_rate,
                    speed: 0.0,
                    bias: 0.0,
                    motor: false,
                    least: if past < 0.0 { f64::NEG_INFINITY } else { 0.0 },
                    most: if past > 0.0 { f64::INFINITY } else { 0.0 },
                    impulse: 0.0,
                });
            }
        }
    }

    /// Adds the object's contacts, those of one pair after the other.
    pub fn object(
        &mut self,
        factor: &Factor,
        joints: usize,
        place: &Placement,
        object: &FreeBody,
        contacts: &ObjectContacts,
    ) {
        let share = 1.0 / self.steps as f64;
        let masses = (1.0 / libm::sqrt(object.mass_kg), 1.0 / libm::sqrt(object.inertia_kg_m2));
        for contact in contacts {
            let (rate, compliance) = contact.softness.gains(self.secs);
            let tangents = tangents(&contact.direction, &contact.tangent);
            let along = [contact.direction, tangents[0], tangents[1]];
            let mut rows = match contact.side {
                Some(side) => pad_rows(factor, joints, place, joints + side, &contact.at, &along),
                None => [[0.0; WIDTH]; 3],
            };
            let lever = contact.at - object.position;
            for (row, along) in rows.iter_mut().zip(&along) {
                let (force, moment) = (along * -masses.0, lever.cross(along) * -masses.1);
                row[DOFS_MAX..DOFS_MAX + 3].copy_from_slice(force.as_slice());
                row[DOFS_MAX + 3..].copy_from_slice(moment.as_slice());
            }
            let rub = contact.tangent * share;
            let inverse = |row: &Coordinates| 1.0 / dot::<0>(row, row);
            self.contacts.push(ContactRow {
                pair: contact.pair,
                on_arm: contact.side.is_some(),
                inverse: [inverse(&rows[0]), inverse(&rows[1]), inverse(&rows[2])],
                rows,
                gap: contact.gap_m,
                rate,
                soft: 1.0 / (1.0 + compliance),
                cfm: 1.0,
                bias: 0.0,
                bias_relaxed: 0.0,
                impulse: [contact.impulse * share, rub.dot(&tangents[0]), rub.dot(&tangents[1])],
                pressed: 0.0,
                tangents,
                friction: contact.friction,
            });
        }
    }

    /// Begins a step from the impulses of the last one.
    pub fn begin(&mut self, u: &mut Coordinates) {
        for row in &mut self.joints {
            row.bias = row.error * row.rate - row.speed;
            push::<0>(u, &row.row, -row.impulse);
        }
        for contact in &mut self.contacts {
            contact.aim(self.secs);
            for i in 0..3 {
                if contact.impulse[i] != 0.0 {
                    contact.push(i, u, contact.impulse[i]);
                }
            }
        }
    }

    /// Ends a step: everything has moved by its speed since the last.
    pub fn moved(&mut self, u: &Coordinates) {
        for row in &mut self.joints {
            row.error += self.secs * dot::<0>(&row.row, u);
        }
        for contact in &mut self.contacts {
            contact.gap += self.secs * contact.dot(0, u);
        }
    }

    /// Sweeps before the positions move.
    pub fn solve(&mut self, u: &mut Coordinates, sweeps: usize) {
        for _ in 0..sweeps {
            if self.sweep(u, false) < SETTLED_N_S {
                break;
            }
        }
    }

    /// Sweeps after the positions have moved: without what pulled errors back, with friction.
    pub fn relax(&mut self, u: &mut Coordinates, sweeps: usize) {
        for _ in 0..sweeps {
            self.sweep(u, true);
        }
        for contact in &mut self.contacts {
            contact.pressed += contact.impulse[0];
        }
    }

    /// The largest change of an impulse along a joint or a normal, N s.
    fn sweep(&mut self, u: &mut Coordinates, relaxed: bool) -> f64 {
        let mut change = 0.0_f64;
        for row in &mut self.joints {
            change = change.max(row.solve(u, relaxed));
        }
        // One pair after the other, pressure before friction, as the engine does it.
        for pair in self.contacts.chunk_by_mut(|a, b| a.pair == b.pair) {
            for contact in pair.iter_mut() {
                change = change.max(contact.press(u, relaxed));
            }
            if relaxed {
                for contact in pair.iter_mut() {
                    contact.rub(u);
                }
            }
        }
        change
    }

    /// Writes the impulses back for the next tick, and the forces of this one.
    pub fn store(&self, contacts: &mut [ObjectContact], joints: &mut [f64; 3]) {
        let steps = self.steps as f64;
        for (contact, row) in contacts.iter_mut().zip(&self.contacts) {
            contact.impulse = row.impulse[0] * steps;
            contact.tangent = (row.tangents[0] * row.impulse[1] + row.tangents[1] * row.impulse[2]) * steps;
            contact.force_n = row.pressed / TICK_SECS;
        }
        *joints = [0, 2, 1].map(|row| self.joints[row].impulse * steps);
    }
}

/// Rows of a force at a pad's point along three directions, the arm's part.
fn pad_rows(
    factor: &Factor,
    joints: usize,
    place: &Placement,
    finger: usize,
    at: &Vector3<f64>,
    along: &[Vector3<f64>; 3],
) -> [Coordinates; 3] {
    // The velocity of the point per unit of speed of each degree of freedom.
    let mut columns = [[0.0; LANES]; DOFS_MAX];
    for dof in (0..joints).chain([finger]) {
        let axis = &place.axes[dof];
        let speed = axis.linear + axis.angular.cross(at);
        columns[dof] = [along[0].dot(&speed), along[1].dot(&speed), along[2].dot(&speed), 0.0];
    }
    let columns = factor.forward_lanes(&columns);
    let mut rows = [[0.0; WIDTH]; 3];
    for (dof, column) in columns.iter().enumerate() {
        for (row, value) in rows.iter_mut().zip(column) {
            row[dof] = *value;
        }
    }
    rows
}

/// Two directions square to the normal and to one another, the first along the present friction.
fn tangents(normal: &Vector3<f64>, along: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let flat = along - normal * normal.dot(along);
    let size = flat.norm();
    let first = if size > 1e-9 {
        flat / size
    } else {
        // The base axis furthest from the normal.
        let axis = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        (axis - normal * normal.dot(&axis)).normalize()
    };
    [first, normal.cross(&first)]
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
