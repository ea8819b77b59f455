//! Inverse kinematics: damped least squares, limit-clamped, warm-started.
//!
//! Each iteration solves `dq = J^T (J J^T + l^2 I)^-1 e` (Nakamura and Hanafusa 1986; Wampler 1986) with damping
//! scaled by the error, plus a null-space pull toward a rest posture.

use nalgebra::{Isometry3, Matrix6, Rotation3, Vector3, Vector6};

use crate::chain::{Chain, Jacobian, Transform};
use crate::messages::{JointVec, MAX_JOINTS};

/// How hard to try before the best configuration found is given back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkOptions {
    /// Most iterations from one starting configuration.
    pub iterations_max: usize,
    /// Norm of the pose error (m and rad together) at which to stop.
    pub tolerance: f64,
    /// Share of the distance to the rest posture taken per iteration in the null space.
    pub posture_gain: f64,
    /// Largest change of one joint per iteration, rad.
    pub step_max_rad: f64,
    /// How often to begin again elsewhere when the tolerance is not reached.
    pub restarts: usize,
}

impl IkOptions {
    /// From anywhere: up to 100 iterations, seven times.
    pub const GLOBAL: Self =
        Self { iterations_max: 100, tolerance: 1e-6, posture_gain: 0.05, step_max_rad: 0.2, restarts: 6 };
    /// Following a path from the previous solution.
    pub const TRACKING: Self =
        Self { iterations_max: 4, tolerance: 1e-5, posture_gain: 0.01, step_max_rad: 0.1, restarts: 0 };
}

/// The best configuration found, whether it converged or not.
#[derive(Clone, Debug, PartialEq)]
pub struct IkOutcome {
    /// Joint angles, inside the limits.
    pub q: JointVec,
    /// Remaining pose error: norm of (m, rad).
    pub error: f64,
    /// Iterations used, over all starts.
    pub iterations: usize,
}

impl IkOutcome {
    /// Whether the error is within a tolerance (a number that is not finite is not).
    #[must_use]
    pub fn converged(&self, tolerance: f64) -> bool {
        self.error <= tolerance
    }
}

/// Pose error from `from` to `to`: translation, then rotation vector, both in the base frame.
#[must_use]
pub fn pose_error(from: &Transform, to: &Transform) -> Vector6<f64> {
    let linear = to.origin - from.origin;
    let turn = rotation_vector(&(to.rotation * from.rotation.transpose()));
    Vector6::new(linear.x, linear.y, linear.z, turn.x, turn.y, turn.z)
}

/// Rotation vector of a rotation matrix; first order (exact to 1e-9) for the small angles of tracking.
fn rotation_vector(r: &nalgebra::Matrix3<f64>) -> Vector3<f64> {
    let half_skew = Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]) * 0.5;
    let sin2 = half_skew.norm_squared();
    let trace = r[(0, 0)] + r[(1, 1)] + r[(2, 2)];
    if sin2 < 1e-6 && trace > 2.0 {
        // asin(s) / s = 1 + s^2 / 6 + ...
        half_skew * (1.0 + sin2 / 6.0)
    } else {
        Rotation3::from_matrix_unchecked(*r).scaled_axis()
    }
}

/// Lower Cholesky factor of a symmetric matrix given by its lower triangle; None if not definite.
fn cholesky(a: &Matrix6<f64>) -> Option<[[f64; 6]; 6]> {
    let mut l = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let mut sum = a[(i, j)];
            sum -= (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            if i == j {
                if sum <= 0.0 || !sum.is_finite() {
                    return None;
                }
                l[i][i] = libm::sqrt(sum);
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    Some(l)
}

/// Solves `L L^T x = b`.
fn back_substitute(l: &[[f64; 6]; 6], b: &Vector6<f64>) -> Vector6<f64> {
    let mut y = [0.0; 6];
    for i in 0..6 {
        let mut sum = b[i];
        for k in 0..i {
            sum -= l[i][k] * y[k];
        }
        y[i] = sum / l[i][i];
    }
    let mut x = Vector6::zeros();
    for i in (0..6).rev() {
        let mut sum = y[i];
        for k in i + 1..6 {
            sum -= l[k][i] * x[k];
        }
        x[i] = sum / l[i][i];
    }
    x
}

/// One damped step: joint change for the error `e`, with the null-space share of `pull`.
fn damped_step(jacobian: &Jacobian, e: &Vector6<f64>, pull: &[f64; MAX_JOINTS]) -> Option<[f64; MAX_JOINTS]> {
    // Error-scaled damping: robust far from the goal, Gauss-Newton close to it.
    weighted_step(jacobian, e, pull, (1e-2 * e.norm_squared()).clamp(1e-8, 1e-3))
}

fn weighted_step(
    jacobian: &Jacobian,
    e: &Vector6<f64>,
    pull: &[f64; MAX_JOINTS],
    damping: f64,
) -> Option<[f64; MAX_JOINTS]> {
    let mut a = Matrix6::identity() * damping;
    for column in &jacobian.columns {
        for i in 0..6 {
            for j in 0..=i {
                a[(i, j)] += column[i] * column[j];
            }
        }
    }
    let l = cholesky(&a)?;
    // dq = pull + J^+ (e - J pull): the pull acts only in directions that do not move the tool.
    let x = back_substitute(&l, &(e - jacobian.twist(pull)));
    let mut dq = *pull;
    for (value, column) in dq.iter_mut().zip(&jacobian.columns) {
        *value += column.dot(&x);
    }
    Some(dq)
}

impl Chain {
    /// Joint angles that bring the tool to `target`, starting from `warm`, resting near `rest`.
    ///
    /// Never fails: the outcome's `error` says how close it came. Angles stay 1 mrad inside the limits.
    #[must_use]
    pub fn solve(
        &self,
        target: &Isometry3<f64>,
        warm: &[f64],
        rest: &[f64],
        options: &IkOptions,
    ) -> IkOutcome {
        self.solve_frame(&Transform::new(target), warm, rest, options)
    }

    /// [`Chain::solve`] for a target already in matrix form.
    #[must_use]
    pub fn solve_frame(
        &self,
        target: &Transform,
        warm: &[f64],
        rest: &[f64],
        options: &IkOptions,
    ) -> IkOutcome {
        let first = self.descend(target, warm, rest, options, options.iterations_max);
        if first.error < options.tolerance || options.restarts == 0 {
            return first;
        }
        // Stuck at a joint limit or a singularity: begin again elsewhere, deterministically.
        let mut best = first;
        for restart in 0..options.restarts {
            let begin: JointVec = (0..self.len()).map(|i| self.restart_angle(i, restart, rest)).collect();
            let mut next = self.descend(target, &begin, rest, options, options.iterations_max);
            next.iterations += best.iterations;
            if next.error < best.error {
                best = next;
            }
            if best.error < options.tolerance {
                break;
            }
        }
        best
    }

    /// The rest posture first, then points spread over the joint's range (golden ratio sequence).
    fn restart_angle(&self, joint: usize, restart: usize, rest: &[f64]) -> f64 {
        let home = rest.get(joint).copied().unwrap_or(0.0);
        match (restart, self.joints.get(joint)) {
            (0, _) | (_, None) => home,
            (_, Some(spec)) => {
                let share = (0.618_033_988_749_895 * (restart * (joint + 2)) as f64).fract();
                let reach = (spec.upper_rad - spec.lower_rad).min(core::f64::consts::PI);
                home + (share - 0.5) * reach
            }
        }
    }

    fn descend(
        &self,
        target: &Transform,
        warm: &[f64],
        rest: &[f64],
        options: &IkOptions,
        most: usize,
    ) -> IkOutcome {
        const LIMIT_MARGIN_RAD: f64 = 1e-3;
        /// The posture counts less and less within this error, so that it never keeps the goal away.
        const POSTURE_FADE: f64 = 0.05;
        let mut q = self.clamped(warm, LIMIT_MARGIN_RAD);
        let mut best = IkOutcome { q: q.clone(), error: f64::INFINITY, iterations: 0 };
        for iteration in 0..=most {
            let frames = self.frames(&q);
            let e = pose_error(&frames.tool, target);
            let error = e.norm();
            if error < best.error {
                best.q.clone_from(&q);
                best.error = error;
                best.iterations = iteration;
            }
            if error < options.tolerance || iteration == most || !error.is_finite() {
                break;
            }
            let gain = options.posture_gain * (error / POSTURE_FADE).min(1.0);
            let mut pull = [0.0; MAX_JOINTS];
            for ((value, angle), home) in pull.iter_mut().zip(&q).zip(rest) {
                *value = gain * (home - angle);
            }
            let Some(dq) = damped_step(&self.jacobian(&frames), &e, &pull) else { break };
            for (angle, change) in q.iter_mut().zip(dq) {
                *angle += change.clamp(-options.step_max_rad, options.step_max_rad);
            }
            q = self.clamped(&q, LIMIT_MARGIN_RAD);
        }
        best
    }
}

/// Joint speeds for a tool velocity (linear, angular): damped least squares with a null-space pull.
/// `None` if the Jacobian is not finite.
#[must_use]
pub fn rate_step(
    jacobian: &Jacobian,
    twist: &Vector6<f64>,
    pull: &[f64; MAX_JOINTS],
) -> Option<[f64; MAX_JOINTS]> {
    /// Loses 1 % of the speed where the arm's smallest singular value is 10 mm/rad.
    const DAMPING: f64 = 1e-6;
    weighted_step(jacobian, twist, pull, DAMPING)
}
