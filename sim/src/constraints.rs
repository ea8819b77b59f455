//! The constraints of a tick that the arm's own dynamics solve: finger motors, their coupling and ends, and the
//! object's contacts with the pads and with what stands in the cell.
//!
//! The same laws as the physics engine's rows, in f64: soft constraints after Catto (*Soft
//! Constraints*, GDC 2011), projected Gauss-Seidel, friction only in the sweep after the positions have moved. Each
//! face has one friction force and one moment about its normal, at the middle of its points.
//!
//! Units SI; poses and directions in the base frame unless a name says otherwise.

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use crate::coupled_rows::{Coordinates, CoupledRows, FRICTION_ROWS, JOINT_ROWS_MAX, LANES, WIDTH, on_arm};
use crate::dynamics::{DOFS_MAX, Dofs, Factor, Placement};
use crate::free_body::FreeBody;
use crate::motors::MotorReference;
use crate::object_contacts::{ContactFace, FACES_MAX, ObjectContacts, POINTS_PER_FACE};
use holdpoint_body::TICK_SECS;

/// A sweep that changes no impulse by more than this ends the sweeps, N s: a force of five hundredths of a newton.
const SETTLED_N_S: f64 = 1e-4;

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
}

/// The row of a contact point along the normal.
struct NormalRow {
    inverse: f64,
    gap: f64,
    /// Speed with which the gap may close, m/s.
    slack: f64,
    /// Distance from the middle of the face, m.
    lever: f64,
    /// Impulse of the steps before, N s.
    pressed: f64,
}

/// The rows of a face: its points along the normal, then the friction.
struct FaceRows {
    first: usize,
    points: ArrayVec<NormalRow, POINTS_PER_FACE>,
    /// What of a penetration is taken back per second, and how much of an impulse a soft contact keeps.
    rate: f64,
    soft: f64,
    tangents: [Vector3<f64>; 2],
    friction: f64,
    friction_inverse: [f64; FRICTION_ROWS],
}

/// Everything that acts in one tick besides the arm's own dynamics.
pub struct ConstraintRows {
    all: CoupledRows,
    joints: ArrayVec<JointRow, JOINT_ROWS_MAX>,
    faces: ArrayVec<FaceRows, FACES_MAX>,
    secs: f64,
    steps: usize,
}

impl JointRow {
    /// Returns by how much the impulse changed.
    fn solve(&self, row: usize, all: &mut CoupledRows, relaxed: bool) -> f64 {
        let bias = if relaxed && !self.motor { 0.0 } else { self.bias };
        let impulse = all.impulse(row);
        let speed = bias - all.speed(row);
        let total = (impulse + self.inverse * (speed - self.gain * impulse)).clamp(self.least, self.most);
        all.set(row, total)
    }
}

impl FaceRows {
    /// Returns the largest change of an impulse.
    fn press(&self, all: &mut CoupledRows, relaxed: bool) -> f64 {
        /// Most speed with which a penetration is pushed out, m/s.
        const CORRECTION_M_S: f64 = 3.0;
        let mut change = 0.0_f64;
        for (row, point) in (self.first..).zip(&self.points) {
            // A gap may close in one step; a penetration is to open.
            let mut bias = point.slack;
            let mut share = 1.0;
            if point.gap <= 0.0 && !relaxed {
                bias += (self.rate * point.gap).max(-CORRECTION_M_S);
                share = self.soft;
            }
            let total = share * (all.impulse(row) - point.inverse * (all.speed(row) + bias)).max(0.0);
            change = change.max(all.set(row, total));
        }
        change
    }

    /// Friction at the middle of the face: about the normal, then along the tangents.
    fn rub(&self, all: &mut CoupledRows) {
        let rows = self.first + self.points.len();
        let (mut pressed, mut twist) = (0.0, 0.0);
        for (point, impulse) in self.points.iter().zip(&all.impulses()[self.first..]) {
            pressed += impulse;
            twist += impulse * point.lever;
        }
        let (most, most_twist) = (self.friction * pressed, self.friction * twist);
        if most == 0.0 && all.impulses()[rows..rows + FRICTION_ROWS].iter().all(|impulse| *impulse == 0.0) {
            return;
        }
        let wanted = |all: &CoupledRows, i: usize| {
            all.impulse(rows + i) - self.friction_inverse[i] * all.speed(rows + i)
        };
        all.set(rows, wanted(all, 0).clamp(-most_twist, most_twist));
        let (first, second) = (wanted(all, 1), wanted(all, 2));
        let size = libm::sqrt(first * first + second * second);
        let share = if size > most { most / size } else { 1.0 };
        all.set(rows + 1, first * share);
        all.set(rows + 2, second * share);
    }
}

impl ConstraintRows {
    /// No rows yet, for a tick of a number of steps.
    #[inline]
    pub fn new(steps: usize) -> Self {
        let secs = TICK_SECS / steps as f64;
        Self { all: CoupledRows::new(), joints: ArrayVec::new(), faces: ArrayVec::new(), secs, steps }
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
            // Rows count against the speed, as the motor's errors do.
            let mut unit = [0.0; DOFS_MAX];
            unit[dof] = -1.0;
            let impulse = warm[side].clamp(-most, most);
            let own = self.all.add(&on_arm(factor, &unit), true, impulse);
            let near = !(at > motors.near_end_m && at < stroke - motors.near_end_m);
            let mut speed = motors.reference.speed;
            if near {
                speed = speed.max(-at / secs).min((stroke - at) / secs);
            }
            self.joints.push(JointRow {
                inverse: 1.0 / (own + compliance),
                gain: compliance,
                error: at - motors.reference.position,
                rate,
                speed,
                bias: 0.0,
                motor: true,
                least: -most,
                most,
            });
            if side == 0 {
                let mut pair = [0.0; DOFS_MAX];
                (pair[joints], pair[joints + 1]) = (1.0, -1.0);
                let own = self.all.add(&on_arm(factor, &pair), true, warm[2]);
                self.joints.push(JointRow {
                    inverse: 1.0 / own,
                    gain: 0.0,
                    error: q[joints + 1] - q[joints],
                    rate: rigid_rate,
                    speed: 0.0,
                    bias: 0.0,
                    motor: false,
                    least: f64::NEG_INFINITY,
                    most: f64::INFINITY,
                });
            }
        }
        for side in 0..2 {
            let (at, stroke) = (q[joints + side], motors.stroke_m[side]);
            let past = (at - stroke).max(0.0) - (-at).max(0.0);
            if past != 0.0 {
                let row = self.all.row(2 * side);
                let own = self.all.add(&row, true, 0.0);
                self.joints.push(JointRow {
                    inverse: 1.0 / (own * (1.0 + rigid_cfm)),
                    gain: own * rigid_cfm,
                    error: past,
                    rate: rigid_rate,
                    speed: 0.0,
                    bias: 0.0,
                    motor: false,
                    least: if past < 0.0 { f64::NEG_INFINITY } else { 0.0 },
                    most: if past > 0.0 { f64::INFINITY } else { 0.0 },
                });
            }
        }
    }

    /// Adds the object's contacts, after the fingers.
    pub fn object(
        &mut self,
        factor: &Factor,
        joints: usize,
        place: &Placement,
        object: &FreeBody,
        contacts: &ObjectContacts,
    ) {
        let share = 1.0 / self.steps as f64;
        for face in contacts {
            let (rate, compliance) = face.softness.gains(self.secs);
            let tangents = tangents(&face.direction, &face.tangent);
            let basis = face_rows(factor, joints, place, object, face, &tangents);
            let on_arm = face.side.is_some();
            let first = self.all.count();
            let mut points = ArrayVec::new();
            for point in &face.points {
                let lever = point.at - face.center;
                let (along, across) = (lever.dot(&tangents[0]), lever.dot(&tangents[1]));
                let mut row = basis.normal;
                for (i, value) in row.iter_mut().enumerate() {
                    *value += basis.tilts[0][i] * across - basis.tilts[1][i] * along;
                }
                let own = self.all.add(&row, on_arm, point.impulse * share);
                points.push(NormalRow {
                    inverse: 1.0 / own,
                    gap: point.gap_m,
                    slack: 0.0,
                    lever: lever.norm(),
                    pressed: 0.0,
                });
            }
            let rub = face.tangent * share;
            let friction = [face.twist * share, rub.dot(&tangents[0]), rub.dot(&tangents[1])];
            let mut friction_inverse = [0.0; FRICTION_ROWS];
            for ((inverse, row), impulse) in friction_inverse.iter_mut().zip(&basis.friction).zip(friction) {
                *inverse = 1.0 / self.all.add(row, on_arm, impulse);
            }
            self.faces.push(FaceRows {
                first,
                points,
                rate,
                soft: 1.0 / (1.0 + compliance),
                tangents,
                friction: face.friction,
                friction_inverse,
            });
        }
    }

    /// Begins the first step at these speeds, from the impulses that the rows were added with.
    pub fn begin(&mut self, u: &Coordinates) {
        self.aim();
        self.all.begin(u);
    }

    /// Begins another step at these speeds, from the impulses of the last one.
    pub fn begin_again(&mut self, u: &Coordinates) {
        self.aim();
        self.all.begin_again(u);
    }

    fn aim(&mut self) {
        for row in &mut self.joints {
            row.bias = row.error * row.rate - row.speed;
        }
        for point in self.faces.iter_mut().flat_map(|face| &mut face.points) {
            point.slack = point.gap.max(0.0) / self.secs;
        }
    }

    /// The speeds under the present impulses.
    pub fn speeds(&self) -> &Coordinates {
        self.all.speeds()
    }

    /// Everything has moved by its speed for a step.
    pub fn moved(&mut self) {
        for (row, joint) in self.joints.iter_mut().enumerate() {
            joint.error -= self.secs * self.all.speed(row);
        }
        for face in &mut self.faces {
            for (row, point) in (face.first..).zip(&mut face.points) {
                point.gap += self.secs * self.all.speed(row);
                // As in the engine, the robot's contacts know of the gap that they began the step with.
                if !self.all.is_on_arm(row) {
                    point.slack = point.gap.max(0.0) / self.secs;
                }
            }
        }
    }

    /// Sweeps before the positions move.
    pub fn solve(&mut self, sweeps: usize) {
        for _ in 0..sweeps {
            if self.sweep(false) < SETTLED_N_S {
                break;
            }
        }
    }

    /// Sweeps after the positions have moved: without what pulled errors back, with friction.
    pub fn relax(&mut self, sweeps: usize) {
        for _ in 0..sweeps {
            self.sweep(true);
        }
        for face in &mut self.faces {
            for (point, impulse) in face.points.iter_mut().zip(&self.all.impulses()[face.first..]) {
                point.pressed += impulse;
            }
        }
    }

    /// The largest change of an impulse along a joint or a normal, N s.
    fn sweep(&mut self, relaxed: bool) -> f64 {
        let mut change = 0.0_f64;
        for (row, joint) in self.joints.iter().enumerate() {
            change = change.max(joint.solve(row, &mut self.all, relaxed));
        }
        // One face after the other, pressure before friction, as the engine does it.
        for face in &self.faces {
            change = change.max(face.press(&mut self.all, relaxed));
            if relaxed {
                face.rub(&mut self.all);
            }
        }
        change
    }

    /// Writes the impulses back for the next tick, and the forces of this one.
    pub fn store(&self, contacts: &mut [ContactFace], joints: &mut [f64; 3]) {
        let steps = self.steps as f64;
        let impulses = self.all.impulses();
        for (face, rows) in contacts.iter_mut().zip(&self.faces) {
            for ((point, row), impulse) in
                face.points.iter_mut().zip(&rows.points).zip(&impulses[rows.first..])
            {
                point.impulse = impulse * steps;
                point.force_n = row.pressed / TICK_SECS;
            }
            let friction = rows.first + rows.points.len();
            face.twist = impulses[friction] * steps;
            let [first, second] = [1, 2].map(|row| impulses[friction + row]);
            face.tangent = (rows.tangents[0] * first + rows.tangents[1] * second) * steps;
        }
        *joints = [0, 2, 1].map(|row| impulses[row] * steps);
    }
}

/// Rows of the forces that a face can transmit at its middle.
struct FaceBasis {
    /// A force along the normal.
    normal: Coordinates,
    /// Moments about the tangents: they move the normal force to a point of the face.
    tilts: [Coordinates; 2],
    /// A moment about the normal, and forces along the tangents.
    friction: [Coordinates; FRICTION_ROWS],
}

fn face_rows(
    factor: &Factor,
    joints: usize,
    place: &Placement,
    object: &FreeBody,
    face: &ContactFace,
    tangents: &[Vector3<f64>; 2],
) -> FaceBasis {
    let normal = face.direction;
    let forces = [normal, tangents[0], tangents[1]];
    let mut force_rows = [[0.0; WIDTH]; 3];
    let mut moment_rows = [[0.0; WIDTH]; 3];
    if let Some(side) = face.side {
        // What the middle of the face does per unit of speed of each degree of freedom.
        let mut linear = [[0.0; LANES]; DOFS_MAX];
        let mut angular = [[0.0; LANES]; DOFS_MAX];
        for dof in (0..joints).chain([joints + side]) {
            let axis = &place.axes[dof];
            let speed = axis.linear + axis.angular.cross(&face.center);
            for (lane, along) in forces.iter().enumerate() {
                linear[dof][lane] = along.dot(&speed);
                angular[dof][lane] = along.dot(&axis.angular);
            }
        }
        for (rows, columns) in [(&mut force_rows, linear), (&mut moment_rows, angular)] {
            for (dof, column) in factor.forward_lanes(&columns).iter().enumerate() {
                for (row, value) in rows.iter_mut().zip(column) {
                    row[dof] = *value;
                }
            }
        }
    }
    let (mass, inertia) = (-1.0 / libm::sqrt(object.mass_kg), -1.0 / libm::sqrt(object.inertia_kg_m2));
    let lever = face.center - object.position;
    for (i, along) in forces.iter().enumerate() {
        force_rows[i][DOFS_MAX..DOFS_MAX + 3].copy_from_slice((along * mass).as_slice());
        force_rows[i][DOFS_MAX + 3..].copy_from_slice((lever.cross(along) * inertia).as_slice());
        moment_rows[i][DOFS_MAX + 3..].copy_from_slice((along * inertia).as_slice());
    }
    let [normal, first, second] = force_rows;
    let [twist, tilt_first, tilt_second] = moment_rows;
    FaceBasis { normal, tilts: [tilt_first, tilt_second], friction: [twist, first, second] }
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
