//! Dynamics of the arm in joint coordinates: mass matrix, bias forces, motion under given forces.
//!
//! Composite rigid bodies for the mass matrix and recursive Newton-Euler for the bias, after
//! Featherstone, *Rigid Body Dynamics Algorithms* (2008), sections 6.2 and 5.3. Every spatial
//! quantity is expressed about the origin of the base frame and along its axes, so nothing is
//! transformed from link to link: composite inertias and forces are sums. f64, fixed size, no
//! allocation. Degrees of freedom are the arm's joints (rad), then the two fingers (m).

#![allow(clippy::needless_range_loop, reason = "formulas over several arrays of one index")]

use nalgebra::{Matrix3, Vector3};

use crate::robot::{Inertial, RobotModel};
use holdpoint_body::chain::Transform;

/// The most arm joints that are simulated, fewer than the interface of robots carries: every matrix here has this size,
/// and every tick draws the errors of as many joints.
pub const ARM_JOINTS_MAX: usize = 8;

const _: () = assert!(ARM_JOINTS_MAX <= holdpoint_body::MAX_JOINTS);

/// The most degrees of freedom: an arm and two fingers.
pub const DOFS_MAX: usize = ARM_JOINTS_MAX + 2;

/// One number per degree of freedom; only as many as the robot has are meaningful.
pub type Dofs = [f64; DOFS_MAX];

/// A square matrix over the degrees of freedom.
pub type DofMatrix = [Dofs; DOFS_MAX];

/// Gravity in the base frame, m/s^2.
pub const GRAVITY_M_S2: [f64; 3] = [0.0, 0.0, -9.81];

/// Spatial velocity or acceleration of a body (Featherstone 2008, section 2.2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Angular part, rad/s.
    pub angular: Vector3<f64>,
    /// Velocity of the point of the body that is at the origin, m/s.
    pub linear: Vector3<f64>,
}

/// Spatial force (Featherstone 2008, section 2.3); also a spatial momentum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// Moment about the origin, N m.
    pub moment: Vector3<f64>,
    /// Force, N.
    pub force: Vector3<f64>,
}

impl Motion {
    /// No motion.
    pub const ZERO: Self = Self { angular: Vector3::new(0.0, 0.0, 0.0), linear: Vector3::new(0.0, 0.0, 0.0) };

    /// Power of a force on this motion, W.
    #[must_use]
    pub fn dot(&self, wrench: &Wrench) -> f64 {
        self.angular.dot(&wrench.moment) + self.linear.dot(&wrench.force)
    }

    fn plus(&self, other: &Self, scale: f64) -> Self {
        Self { angular: self.angular + other.angular * scale, linear: self.linear + other.linear * scale }
    }

    /// Rate of change of a motion vector fixed in a body that moves with `self` (section 2.9).
    fn cross(&self, fixed: &Self) -> Self {
        Self {
            angular: self.angular.cross(&fixed.angular),
            linear: self.angular.cross(&fixed.linear) + self.linear.cross(&fixed.angular),
        }
    }

    /// The same for a force vector.
    fn cross_force(&self, fixed: &Wrench) -> Wrench {
        Wrench {
            moment: self.angular.cross(&fixed.moment) + self.linear.cross(&fixed.force),
            force: self.angular.cross(&fixed.force),
        }
    }
}

impl Wrench {
    /// No force.
    pub const ZERO: Self = Self { moment: Vector3::new(0.0, 0.0, 0.0), force: Vector3::new(0.0, 0.0, 0.0) };

    /// A force that acts at a point.
    #[must_use]
    pub fn at(point: &Vector3<f64>, force: &Vector3<f64>) -> Self {
        Self { moment: point.cross(force), force: *force }
    }

    fn add(&mut self, other: &Self) {
        self.moment += other.moment;
        self.force += other.force;
    }
}

/// Rigid-body inertia about the origin (section 2.13).
#[derive(Clone, Copy, Debug, PartialEq)]
struct SpatialInertia {
    mass: f64,
    /// Mass times center of mass.
    first: Vector3<f64>,
    /// Rotational inertia about the origin.
    second: Matrix3<f64>,
}

impl SpatialInertia {
    const ZERO: Self = Self {
        mass: 0.0,
        first: Vector3::new(0.0, 0.0, 0.0),
        second: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    fn of(frame: &Transform, body: &Inertial) -> Self {
        let (mass, centre) = (body.mass_kg, frame.point(&body.centre_m));
        let first = centre * mass;
        let mut second = frame.rotation * body.inertia_kg_m2 * frame.rotation.transpose();
        second -= first * centre.transpose();
        let square = first.dot(&centre);
        for axis in 0..3 {
            second[(axis, axis)] += square;
        }
        Self { mass, first, second }
    }

    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.first += other.first;
        self.second += other.second;
    }

    fn times(&self, v: &Motion) -> Wrench {
        Wrench {
            moment: self.second * v.angular + self.first.cross(&v.linear),
            force: v.linear * self.mass - self.first.cross(&v.angular),
        }
    }
}

/// Where everything is at one configuration.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Frame of the link that each degree of freedom moves; the axis is the frame's z.
    pub frames: [Transform; DOFS_MAX],
    /// Motion of that link per unit of speed of its joint.
    pub axes: [Motion; DOFS_MAX],
    inertias: [SpatialInertia; DOFS_MAX],
}

/// The robot as a tree of rigid bodies on the base: a chain of turning joints that ends in two
/// sliding fingers.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDynamics {
    joints: usize,
    origins: [Transform; DOFS_MAX],
    bodies: [Inertial; DOFS_MAX],
    armature: Dofs,
    gravity: Vector3<f64>,
}

impl ArmDynamics {
    /// Builds the dynamics of a robot model; gravity is zero if the motors compensate for it.
    #[must_use]
    pub fn new(robot: &RobotModel) -> Self {
        const NONE: Inertial = Inertial {
            mass_kg: 0.0,
            centre_m: Vector3::new(0.0, 0.0, 0.0),
            inertia_kg_m2: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        };
        let joints = robot.geometry.joint_count();
        let mut origins = [Transform::IDENTITY; DOFS_MAX];
        let mut bodies = [NONE; DOFS_MAX];
        let mut armature = [0.0; DOFS_MAX];
        let links = robot.geometry.chain.joints.iter().zip(robot.links.iter().skip(1));
        for (i, (joint, link)) in links.enumerate() {
            origins[i] = joint.origin;
            bodies[i] = link.inertial.unwrap_or(NONE);
            armature[i] = robot.motors.armature_kg_m2;
        }
        for (i, finger) in robot.gripper.fingers.iter().enumerate() {
            origins[joints + i] = finger.origin;
            bodies[joints + i] = finger.link.inertial.unwrap_or(NONE);
            armature[joints + i] = robot.gripper.armature_kg;
        }
        let gravity =
            if robot.motors.gravity_compensation { Vector3::zeros() } else { Vector3::from(GRAVITY_M_S2) };
        Self { joints, origins, bodies, armature, gravity }
    }

    /// The same robot under another gravity, m/s^2.
    #[must_use]
    pub fn with_gravity(mut self, gravity: [f64; 3]) -> Self {
        self.gravity = Vector3::from(gravity);
        self
    }

    /// The same robot without rotor inertia.
    #[must_use]
    pub fn without_armature(mut self) -> Self {
        self.armature = [0.0; DOFS_MAX];
        self
    }

    /// Joints of the arm.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// Degrees of freedom: the joints and two fingers.
    #[must_use]
    pub fn dofs(&self) -> usize {
        self.joints + 2
    }

    /// The degree of freedom whose link carries that of `dof`; None for the first joint.
    fn parent(&self, dof: usize) -> Option<usize> {
        dof.min(self.joints).checked_sub(1)
    }

    /// Forward kinematics, and the inertias of the links where they are.
    #[must_use]
    pub fn place(&self, q: &Dofs) -> Placement {
        let mut place = Placement {
            frames: [Transform::IDENTITY; DOFS_MAX],
            axes: [Motion::ZERO; DOFS_MAX],
            inertias: [SpatialInertia::ZERO; DOFS_MAX],
        };
        for i in 0..self.dofs() {
            let mut at = match self.parent(i) {
                Some(parent) => place.frames[parent].then(&self.origins[i]),
                None => self.origins[i],
            };
            let axis = at.z();
            if i < self.joints {
                let (sin, cos) = libm::sincos(q[i]);
                let x = at.rotation.column(0) * cos + at.rotation.column(1) * sin;
                let y = at.rotation.column(1) * cos - at.rotation.column(0) * sin;
                at.rotation.set_column(0, &x);
                at.rotation.set_column(1, &y);
                place.axes[i] = Motion { angular: axis, linear: at.origin.cross(&axis) };
            } else {
                at.origin += axis * q[i];
                place.axes[i] = Motion { angular: Vector3::zeros(), linear: axis };
            }
            place.inertias[i] = SpatialInertia::of(&at, &self.bodies[i]);
            place.frames[i] = at;
        }
        place
    }

    /// Joint-space inertia with the rotors', kg m^2 and kg (composite rigid bodies, section 6.2).
    #[must_use]
    pub fn mass_matrix(&self, place: &Placement) -> DofMatrix {
        let mut matrix = [[0.0; DOFS_MAX]; DOFS_MAX];
        let mut composite = place.inertias;
        for i in (0..self.dofs()).rev() {
            let force = composite[i].times(&place.axes[i]);
            let mut ancestor = Some(i);
            while let Some(j) = ancestor {
                let value = place.axes[j].dot(&force);
                matrix[i][j] = value;
                matrix[j][i] = value;
                ancestor = self.parent(j);
            }
            matrix[i][i] += self.armature[i];
            if let Some(parent) = self.parent(i) {
                let own = composite[i];
                composite[parent].add(&own);
            }
        }
        matrix
    }

    /// Forces that keep the joints at constant speed: Coriolis, centrifugal and weight, N m and N
    /// (recursive Newton-Euler without acceleration, section 5.3).
    #[must_use]
    pub fn bias(&self, place: &Placement, dq: &Dofs) -> Dofs {
        let mut velocity = [Motion::ZERO; DOFS_MAX];
        let mut acceleration = [Motion::ZERO; DOFS_MAX];
        let mut force = [Wrench::ZERO; DOFS_MAX];
        // The base accelerates upward in place of the links' weight.
        let base = Motion { angular: Vector3::zeros(), linear: -self.gravity };
        for i in 0..self.dofs() {
            let (v, a) = match self.parent(i) {
                Some(parent) => (velocity[parent], acceleration[parent]),
                None => (Motion::ZERO, base),
            };
            let axis = &place.axes[i];
            velocity[i] = v.plus(axis, dq[i]);
            acceleration[i] = a.plus(&v.cross(axis), dq[i]);
            let inertia = &place.inertias[i];
            force[i] = inertia.times(&acceleration[i]);
            force[i].add(&velocity[i].cross_force(&inertia.times(&velocity[i])));
        }
        let mut bias = [0.0; DOFS_MAX];
        for i in (0..self.dofs()).rev() {
            bias[i] = place.axes[i].dot(&force[i]);
            if let Some(parent) = self.parent(i) {
                let own = force[i];
                force[parent].add(&own);
            }
        }
        bias
    }

    /// Accelerations under the given forces; None where the mass matrix is not positive definite.
    #[must_use]
    pub fn forward(&self, q: &Dofs, dq: &Dofs, forces: &Dofs) -> Option<Dofs> {
        let place = self.place(q);
        let factor = Factor::new(&self.mass_matrix(&place), self.dofs())?;
        let bias = self.bias(&place, dq);
        let mut rest = [0.0; DOFS_MAX];
        for i in 0..self.dofs() {
            rest[i] = forces[i] - bias[i];
        }
        Some(factor.solve(&rest))
    }

    /// Kinetic energy of the links (without the rotors), J.
    #[must_use]
    pub fn kinetic_energy(&self, place: &Placement, dq: &Dofs) -> f64 {
        self.velocities(place, dq)
            .iter()
            .zip(&place.inertias)
            .take(self.dofs())
            .map(|(v, inertia)| 0.5 * v.dot(&inertia.times(v)))
            .sum()
    }

    /// Momentum of all links together: angular about the origin, N m s, and linear, N s.
    #[must_use]
    pub fn momentum(&self, place: &Placement, dq: &Dofs) -> Wrench {
        let mut sum = Wrench::ZERO;
        for (v, inertia) in self.velocities(place, dq).iter().zip(&place.inertias).take(self.dofs()) {
            sum.add(&inertia.times(v));
        }
        sum
    }

    /// Potential energy of the links under gravity, J.
    #[must_use]
    pub fn potential_energy(&self, place: &Placement) -> f64 {
        -place.inertias.iter().take(self.dofs()).map(|inertia| inertia.first.dot(&self.gravity)).sum::<f64>()
    }

    fn velocities(&self, place: &Placement, dq: &Dofs) -> [Motion; DOFS_MAX] {
        let mut velocity = [Motion::ZERO; DOFS_MAX];
        for i in 0..self.dofs() {
            let parent = self.parent(i).map_or(Motion::ZERO, |parent| velocity[parent]);
            velocity[i] = parent.plus(&place.axes[i], dq[i]);
        }
        velocity
    }
}

/// Cholesky factor `A = L L^T` of a matrix over the degrees of freedom.
///
/// In the coordinates `u = L^T v` the inertia is the identity: a force row `J` becomes `L^-1 J^T`,
/// and applying an impulse and reading a speed use that same vector.
#[derive(Clone, Copy, Debug)]
pub struct Factor {
    lower: DofMatrix,
    inverse_diagonal: Dofs,
    count: usize,
}

impl Factor {
    /// Of the lower triangle of a matrix; None where it is not positive definite.
    #[must_use]
    pub fn new(matrix: &DofMatrix, count: usize) -> Option<Self> {
        let mut lower = [[0.0; DOFS_MAX]; DOFS_MAX];
        let mut inverse_diagonal = [0.0; DOFS_MAX];
        let count = count.min(DOFS_MAX);
        for i in 0..count {
            for j in 0..i {
                let mut sum = matrix[i][j];
                for k in 0..j {
                    sum -= lower[i][k] * lower[j][k];
                }
                lower[i][j] = sum * inverse_diagonal[j];
            }
            let mut sum = matrix[i][i];
            for value in lower[i].iter().take(i) {
                sum -= value * value;
            }
            if !(sum > 0.0 && sum.is_finite()) {
                return None;
            }
            lower[i][i] = libm::sqrt(sum);
            inverse_diagonal[i] = 1.0 / lower[i][i];
        }
        Some(Self { lower, inverse_diagonal, count })
    }

    /// Solves `L y = b`.
    #[must_use]
    pub fn forward(&self, b: &Dofs) -> Dofs {
        let mut y = [0.0; DOFS_MAX];
        for i in 0..self.count {
            let mut sum = b[i];
            for k in 0..i {
                sum -= self.lower[i][k] * y[k];
            }
            y[i] = sum * self.inverse_diagonal[i];
        }
        y
    }

    /// Solves `L y = b` for four vectors side by side.
    #[must_use]
    pub fn forward_lanes(&self, b: &[[f64; 4]; DOFS_MAX]) -> [[f64; 4]; DOFS_MAX] {
        let mut y = [[0.0; 4]; DOFS_MAX];
        for i in 0..self.count {
            let mut sum = b[i];
            for k in 0..i {
                for lane in 0..4 {
                    sum[lane] -= self.lower[i][k] * y[k][lane];
                }
            }
            for lane in 0..4 {
                y[i][lane] = sum[lane] * self.inverse_diagonal[i];
            }
        }
        y
    }

    /// Solves `L^T x = y`.
    #[must_use]
    pub fn backward(&self, y: &Dofs) -> Dofs {
        let mut x = *y;
        for i in (0..self.count).rev() {
            x[i] *= self.inverse_diagonal[i];
            let value = x[i];
            for (k, other) in x.iter_mut().enumerate().take(i) {
                *other -= self.lower[i][k] * value;
            }
        }
        x
    }

    /// `L^T v`.
    #[must_use]
    pub fn whiten(&self, v: &Dofs) -> Dofs {
        let mut u = [0.0; DOFS_MAX];
        for i in 0..self.count {
            for (k, sum) in u.iter_mut().enumerate().take(i + 1) {
                *sum += self.lower[i][k] * v[i];
            }
        }
        u
    }

    /// Solves `A x = b`.
    #[must_use]
    pub fn solve(&self, b: &Dofs) -> Dofs {
        self.backward(&self.forward(b))
    }
}
