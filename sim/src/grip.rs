//! The constraints of a tick that the arm's own dynamics solve: finger motors, their coupling and
//! ends, and the pads on the object.
//!
//! The same laws as the physics engine's rows, in f64: soft constraints after Catto (*Soft
//! Constraints*, GDC 2011), projected Gauss-Seidel, friction only in the sweep after the positions have moved. Rows
//! live in coordinates in which every inertia is the identity (see [`Factor`]), so that one vector
//! both reads a row's speed and takes its impulse. Units SI; poses and directions in the base frame
//! unless a name says otherwise.

use arrayvec::ArrayVec;
use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::dynamics::{DOFS_MAX, Dofs, Factor, Motion, Placement, Wrench};
use crate::motors::MotorReference;
use holdpoint_body::TICK_SECS;

/// The most contact points on both pads together.
pub const CONTACTS_MAX: usize = 16;
/// Degrees of freedom of arm and object together.
const WIDTH: usize = DOFS_MAX + 6;
/// What a row reads and moves.
type Coordinates = [f64; WIDTH];

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

/// Vectors in a snapshot: three numbers.
mod plain {
    use nalgebra::Vector3;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(v: &Vector3<f64>, out: S) -> Result<S::Ok, S::Error> {
        [v.x, v.y, v.z].serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vector3<f64>, D::Error> {
        Ok(Vector3::from(<[f64; 3]>::deserialize(from)?))
    }
}

/// Orientations in a snapshot: x, y, z, w, to the bit.
mod plain_turn {
    use nalgebra::{Quaternion, UnitQuaternion};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(r: &UnitQuaternion<f64>, out: S) -> Result<S::Ok, S::Error> {
        [r.i, r.j, r.k, r.w].serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<UnitQuaternion<f64>, D::Error> {
        let [i, j, k, w] = <[f64; 4]>::deserialize(from)?;
        Ok(UnitQuaternion::new_unchecked(Quaternion::new(w, i, j, k)))
    }
}

/// A free rigid body with the same inertia about every axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FreeBody {
    /// Center.
    #[serde(with = "plain")]
    pub position: Vector3<f64>,
    /// Orientation.
    #[serde(with = "plain_turn")]
    pub rotation: UnitQuaternion<f64>,
    /// Velocity of the center, m/s.
    #[serde(with = "plain")]
    pub linear: Vector3<f64>,
    /// Angular velocity, rad/s.
    #[serde(with = "plain")]
    pub angular: Vector3<f64>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Inertia about any axis, kg m^2.
    pub inertia_kg_m2: f64,
}

/// One point of a pad on the object, as the engine's collision detection last found it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GripContact {
    /// Finger 0 or 1.
    pub side: usize,
    /// The point of the pad, finger frame.
    #[serde(with = "plain")]
    pub on_finger: Vector3<f64>,
    /// The point of the object, object frame.
    #[serde(with = "plain")]
    pub on_object: Vector3<f64>,
    /// Direction of the force on the finger, finger frame.
    #[serde(with = "plain")]
    pub direction: Vector3<f64>,
    /// Coulomb coefficient.
    pub friction: f64,
    /// Normal impulse of the last tick, N s.
    pub impulse: f64,
    /// Friction impulse on the finger of the last tick, N s.
    #[serde(with = "plain")]
    pub tangent: Vector3<f64>,
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
    side: usize,
    rows: [Coordinates; 3],
    inverse: [f64; 3],
    gap: f64,
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
    rate: f64,
    cfm: f64,
}

fn dot(a: &Coordinates, b: &Coordinates) -> f64 {
    // Four sums at a time: the order is fixed, so the result is too.
    let mut sums = [0.0; 4];
    for (a, b) in a.chunks_exact(4).zip(b.chunks_exact(4)) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

fn push(u: &mut Coordinates, row: &Coordinates, impulse: f64) {
    for (value, share) in u.iter_mut().zip(row) {
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
    fn solve(&mut self, u: &mut Coordinates, relaxed: bool) {
        let bias = if relaxed && !self.motor { 0.0 } else { self.bias };
        let speed = bias + dot(&self.row, u);
        let total =
            (self.impulse + self.inverse * (speed - self.gain * self.impulse)).clamp(self.least, self.most);
        let change = total - self.impulse;
        self.impulse = total;
        push(u, &self.row, -change);
    }
}

impl ContactRow {
    /// Moves toward the present gap.
    fn aim(&mut self, rate: f64, secs: f64) {
        /// Most speed with which a penetration is pushed out, m/s.
        const CORRECTION_M_S: f64 = 3.0;
        let slack = self.gap.max(0.0) / secs;
        (self.bias, self.bias_relaxed) = (slack + (rate * self.gap).clamp(-CORRECTION_M_S, 0.0), slack);
    }

    fn press(&mut self, u: &mut Coordinates, cfm: f64, relaxed: bool) {
        let bias = if relaxed { self.bias_relaxed } else { self.bias };
        let speed = dot(&self.rows[0], u) + bias;
        let total = cfm * (self.impulse[0] - self.inverse[0] * speed).max(0.0);
        let change = total - self.impulse[0];
        self.impulse[0] = total;
        push(u, &self.rows[0], change);
    }

    fn rub(&mut self, u: &mut Coordinates) {
        let wanted = [1, 2].map(|i| self.impulse[i] - self.inverse[i] * dot(&self.rows[i], u));
        let (size, most) =
            (libm::sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1]), self.friction * self.impulse[0]);
        let share = if size > most { most / size } else { 1.0 };
        for (i, value) in [(1, wanted[0] * share), (2, wanted[1] * share)] {
            push(u, &self.rows[i], value - self.impulse[i]);
            self.impulse[i] = value;
        }
    }
}

impl ConstraintRows {
    /// The fingers' rows: motor and violated end of each, and their coupling. A tick has `steps` steps.
    pub fn fingers(factor: &Factor, joints: usize, q: &Dofs, motors: &FingerMotors, steps: usize) -> Self {
        let secs = TICK_SECS / steps as f64;
        let mut rows =
            Self { joints: ArrayVec::new(), contacts: ArrayVec::new(), secs, steps, rate: 0.0, cfm: 1.0 };
        let (rigid_rate, rigid_cfm) = Softness::RIGID.gains(secs);
        let (k, d) = (motors.stiffness_n_m, motors.damping_n_s_m);
        let rate = k / (secs * k + d);
        let compliance = 1.0 / (secs * (secs * k + d));
        let most = motors.force_n * secs;
        for side in 0..2 {
            let (dof, stroke) = (joints + side, motors.stroke_m[side]);
            let at = q[dof];
            let mut unit = [0.0; DOFS_MAX];
            unit[dof] = 1.0;
            let row = on_arm(factor, &unit);
            let own = dot(&row, &row);
            let near = !(at > motors.near_end_m && at < stroke - motors.near_end_m);
            let mut speed = motors.reference.speed;
            if near {
                speed = speed.max(-at / secs).min((stroke - at) / secs);
            }
            rows.joints.push(JointRow {
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
                impulse: 0.0,
            });
            let past = (at - stroke).max(0.0) - (-at).max(0.0);
            if past != 0.0 {
                rows.joints.push(JointRow {
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
            if side == 0 {
                let mut pair = [0.0; DOFS_MAX];
                (pair[joints], pair[joints + 1]) = (-1.0, 1.0);
                let row = on_arm(factor, &pair);
                rows.joints.push(JointRow {
                    row,
                    inverse: 1.0 / dot(&row, &row),
                    gain: 0.0,
                    error: q[joints + 1] - q[joints],
                    rate: rigid_rate,
                    speed: 0.0,
                    bias: 0.0,
                    motor: false,
                    least: f64::NEG_INFINITY,
                    most: f64::INFINITY,
                    impulse: 0.0,
                });
            }
        }
        rows
    }

    /// Adds the pads on the object.
    pub fn grip(
        &mut self,
        factor: &Factor,
        joints: usize,
        place: &Placement,
        (object, softness): (&FreeBody, Softness),
        contacts: &[GripContact],
    ) {
        let (rate, compliance) = softness.gains(self.secs);
        (self.rate, self.cfm) = (rate, 1.0 / (1.0 + compliance));
        let share = 1.0 / self.steps as f64;
        let masses = (1.0 / libm::sqrt(object.mass_kg), 1.0 / libm::sqrt(object.inertia_kg_m2));
        for contact in contacts.iter().take(CONTACTS_MAX) {
            let finger = joints + contact.side;
            let frame = &place.frames[finger];
            let arm = object.rotation * contact.on_object;
            let (on_finger, on_object) = (frame.point(&contact.on_finger), object.position + arm);
            let point = (on_finger + on_object) * 0.5;
            let direction = frame.rotation * contact.direction;
            let tangents = tangents(&direction, &contact.tangent);
            let lever = point - object.position;
            let rows = [direction, tangents[0], tangents[1]].map(|along| {
                let wrench = Wrench::at(&point, &along);
                let mut row = [0.0; DOFS_MAX];
                for (value, axis) in row.iter_mut().zip(&place.axes).take(joints) {
                    *value = Motion::dot(axis, &wrench);
                }
                row[finger] = place.axes[finger].dot(&wrench);
                let mut row = on_arm(factor, &row);
                let (force, moment) = (along * -masses.0, lever.cross(&along) * -masses.1);
                row[DOFS_MAX..DOFS_MAX + 3].copy_from_slice(force.as_slice());
                row[DOFS_MAX + 3..].copy_from_slice(moment.as_slice());
                row
            });
            let rub = contact.tangent * share;
            self.contacts.push(ContactRow {
                side: contact.side,
                inverse: [0, 1, 2].map(|i| 1.0 / dot(&rows[i], &rows[i])),
                rows,
                gap: (on_finger - on_object).dot(&direction),
                bias: 0.0,
                bias_relaxed: 0.0,
                impulse: [contact.impulse * share, rub.dot(&tangents[0]), rub.dot(&tangents[1])],
                pressed: 0.0,
                tangents,
                friction: contact.friction,
            });
        }
    }

    /// Begins a step: the pads start from the last one's impulses, motors from none.
    pub fn begin(&mut self, u: &mut Coordinates) {
        for row in &mut self.joints {
            row.impulse = 0.0;
            row.bias = row.error * row.rate - row.speed;
        }
        for contact in &mut self.contacts {
            contact.aim(self.rate, self.secs);
            for (row, impulse) in contact.rows.iter().zip(contact.impulse) {
                push(u, row, impulse);
            }
        }
    }

    /// Ends a step: everything has moved by its speed since the last.
    pub fn moved(&mut self, u: &Coordinates) {
        for row in &mut self.joints {
            row.error += self.secs * dot(&row.row, u);
        }
        for contact in &mut self.contacts {
            contact.gap += self.secs * dot(&contact.rows[0], u);
        }
    }

    /// Sweeps before the positions move.
    pub fn solve(&mut self, u: &mut Coordinates, sweeps: usize) {
        for _ in 0..sweeps {
            self.sweep(u, false);
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

    fn sweep(&mut self, u: &mut Coordinates, relaxed: bool) {
        for row in &mut self.joints {
            row.solve(u, relaxed);
        }
        let cfm = if relaxed { 1.0 } else { self.cfm };
        // One pad after the other, pressure before friction, as the engine does it.
        for pad in self.contacts.chunk_by_mut(|a, b| a.side == b.side) {
            for contact in pad.iter_mut() {
                contact.press(u, cfm, relaxed);
            }
            if relaxed {
                for contact in pad.iter_mut() {
                    contact.rub(u);
                }
            }
        }
    }

    /// Writes the impulses back for the next tick; normal force on each finger, N.
    pub fn store(&self, contacts: &mut [GripContact]) -> [f64; 2] {
        let mut force = [0.0; 2];
        let steps = self.steps as f64;
        for (contact, row) in contacts.iter_mut().zip(&self.contacts) {
            contact.impulse = row.impulse[0] * steps;
            contact.tangent = (row.tangents[0] * row.impulse[1] + row.tangents[1] * row.impulse[2]) * steps;
            force[contact.side] += row.pressed / TICK_SECS;
        }
        force
    }
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

/// The arm's speeds in what the rows have solved.
pub fn arm_speeds(factor: &Factor, u: &Coordinates) -> Dofs {
    let mut y = [0.0; DOFS_MAX];
    y.copy_from_slice(&u[..DOFS_MAX]);
    factor.backward(&y)
}

impl FreeBody {
    /// Takes its speeds from what the rows have solved.
    pub fn take_speeds(&mut self, u: &Coordinates) {
        let (linear, angular) = (1.0 / libm::sqrt(self.mass_kg), 1.0 / libm::sqrt(self.inertia_kg_m2));
        self.linear = Vector3::new(u[DOFS_MAX], u[DOFS_MAX + 1], u[DOFS_MAX + 2]) * linear;
        self.angular = Vector3::new(u[DOFS_MAX + 3], u[DOFS_MAX + 4], u[DOFS_MAX + 5]) * angular;
    }

    /// Moves for a while.
    pub fn advance(&mut self, secs: f64) {
        self.position += self.linear * secs;
        let turn = nalgebra::Quaternion::from_parts(0.0, self.angular * (0.5 * secs));
        let next = self.rotation.into_inner() + turn * self.rotation.into_inner();
        self.rotation = UnitQuaternion::new_normalize(next);
    }
}
