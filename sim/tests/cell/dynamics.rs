//! The arm's own dynamics: against an independent implementation, and against what must be conserved.

use holdpoint_sim::RobotModel;
use holdpoint_sim::dynamics::{ArmDynamics, DOFS_MAX, Dofs, Factor, GRAVITY_M_S2};
use serde::Deserialize;

/// Made by `data/arm7_dynamics.py`, which says how.
#[derive(Deserialize)]
struct ReferenceData {
    state: Vec<ReferenceState>,
}

#[derive(Deserialize)]
struct ReferenceState {
    q: Vec<f64>,
    speed: Vec<f64>,
    force: Vec<f64>,
    mass_lower: Vec<f64>,
    bias: Vec<f64>,
    acceleration: Vec<f64>,
}

fn arm(name: &str) -> ArmDynamics {
    ArmDynamics::new(&RobotModel::builtin(name).expect("the robot parses")).without_armature()
}

fn dofs(values: &[f64]) -> Dofs {
    let mut all = [0.0; DOFS_MAX];
    all[..values.len()].copy_from_slice(values);
    all
}

/// Largest difference, relative to the largest reference value.
fn relative(found: impl IntoIterator<Item = f64>, reference: &[f64]) -> f64 {
    let scale = reference.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    found.into_iter().zip(reference).fold(0.0_f64, |most, (a, b)| most.max((a - b).abs() / scale))
}

#[test]
fn dynamics_agree_with_an_independent_implementation() {
    let reference: ReferenceData =
        toml::from_str(include_str!("../data/arm7_dynamics.toml")).expect("parses");
    let arm = arm("arm7").with_gravity(GRAVITY_M_S2);
    let n = arm.dofs();
    let (mut mass_error, mut bias_error, mut forward_error) = (0.0_f64, 0.0_f64, 0.0_f64);
    assert!(reference.state.len() >= 10);
    for state in &reference.state {
        let (q, dq, force) = (dofs(&state.q), dofs(&state.speed), dofs(&state.force));
        let place = arm.place(&q);
        let mass = arm.mass_matrix(&place);
        let lower = (0..n).flat_map(|i| (0..=i).map(move |j| mass[i][j]));
        mass_error = mass_error.max(relative(lower, &state.mass_lower));
        bias_error = bias_error.max(relative(arm.bias(&place, &dq), &state.bias));
        let acceleration = arm.forward(&q, &dq, &force).expect("positive definite");
        forward_error = forward_error.max(relative(acceleration, &state.acceleration));
    }
    println!("relative error: mass {mass_error:.1e}, bias {bias_error:.1e}, forward {forward_error:.1e}");
    assert!(mass_error < 1e-12, "{mass_error}");
    assert!(bias_error < 1e-12, "{bias_error}");
    assert!(forward_error < 1e-9, "{forward_error}");
}

/// One Runge-Kutta step of fourth order under forces that depend on the state.
fn advance(arm: &ArmDynamics, q: &mut Dofs, dq: &mut Dofs, force: &Dofs, secs: f64) {
    let at = |q: &Dofs, dq: &Dofs, k: &(Dofs, Dofs), h: f64| -> (Dofs, Dofs) {
        let (mut q, mut dq) = (*q, *dq);
        for i in 0..DOFS_MAX {
            q[i] += h * k.0[i];
            dq[i] += h * k.1[i];
        }
        let acceleration = arm.forward(&q, &dq, force).expect("positive definite");
        (dq, acceleration)
    };
    let still = ([0.0; DOFS_MAX], [0.0; DOFS_MAX]);
    let k1 = at(q, dq, &still, 0.0);
    let k2 = at(q, dq, &k1, 0.5 * secs);
    let k3 = at(q, dq, &k2, 0.5 * secs);
    let k4 = at(q, dq, &k3, secs);
    for i in 0..DOFS_MAX {
        q[i] += secs / 6.0 * (k1.0[i] + 2.0 * k2.0[i] + 2.0 * k3.0[i] + k4.0[i]);
        dq[i] += secs / 6.0 * (k1.1[i] + 2.0 * k2.1[i] + 2.0 * k3.1[i] + k4.1[i]);
    }
}

fn start(n: usize) -> (Dofs, Dofs) {
    let (mut q, mut dq) = ([0.0; DOFS_MAX], [0.0; DOFS_MAX]);
    for i in 0..n {
        let turn = i as f64;
        q[i] = if i + 2 < n { 0.3 + 0.2 * turn - 0.4 * f64::from(i % 2 == 1) * turn } else { 0.02 };
        dq[i] = if i + 2 < n { 0.8 - 0.25 * turn } else { 0.05 };
    }
    (q, dq)
}

#[test]
fn energy_is_conserved_without_forces() {
    for name in ["arm7", "arm6"] {
        let arm = arm(name).with_gravity(GRAVITY_M_S2);
        let (mut q, mut dq) = start(arm.dofs());
        let energy = |q: &Dofs, dq: &Dofs| {
            let place = arm.place(q);
            arm.kinetic_energy(&place, dq) + arm.potential_energy(&place)
        };
        let (before, kinetic) = (energy(&q, &dq), arm.kinetic_energy(&arm.place(&q), &dq));
        for _ in 0..2000 {
            advance(&arm, &mut q, &mut dq, &[0.0; DOFS_MAX], 1e-4);
        }
        let moved = (arm.kinetic_energy(&arm.place(&q), &dq) - kinetic).abs();
        let drift = (energy(&q, &dq) - before).abs();
        assert!(moved > 0.1, "{name}: the motion exchanges energy: {moved} J");
        assert!(drift < 1e-9 * (1.0 + moved), "{name}: {drift} J");
    }
}

#[test]
fn kinetic_energy_is_that_of_the_mass_matrix() {
    let arm = arm("arm7");
    let (q, dq) = start(arm.dofs());
    let place = arm.place(&q);
    let mass = arm.mass_matrix(&place);
    let quadratic: f64 =
        (0..arm.dofs()).map(|i| (0..arm.dofs()).map(|j| dq[i] * mass[i][j] * dq[j]).sum::<f64>()).sum();
    let energy = arm.kinetic_energy(&place, &dq);
    assert!((0.5 * quadratic - energy).abs() < 1e-12 * energy, "{quadratic} {energy}");
}

#[test]
fn angular_momentum_about_a_free_vertical_axis_is_conserved() {
    // Forces inside the arm cannot turn it about the axis of a first joint without torque.
    let arm = arm("arm7");
    let (mut q, mut dq) = start(arm.dofs());
    let about = |q: &Dofs, dq: &Dofs| arm.momentum(&arm.place(q), dq).moment.z;
    let before = about(&q, &dq);
    let force = dofs(&[0.0, 9.0, -4.0, 7.0, 1.0, -2.0, 0.5, 1.0, -1.0]);
    let speed = dq[0];
    for _ in 0..2000 {
        advance(&arm, &mut q, &mut dq, &force, 1e-4);
    }
    assert!((dq[0] - speed).abs() > 0.05, "the others act on it: {} rad/s", dq[0] - speed);
    let drift = (about(&q, &dq) - before).abs();
    assert!(drift < 1e-9 * before.abs().max(1.0), "{drift} N m s");
}

#[test]
fn factor_solves_the_system_of_its_matrix() {
    let arm = arm("arm7");
    let n = arm.dofs();
    let (q, b) = start(n);
    let mass = arm.mass_matrix(&arm.place(&q));
    let factor = Factor::new(&mass, n).expect("positive definite");
    let x = factor.solve(&b);
    for i in 0..n {
        let row: f64 = (0..n).map(|j| mass[i][j] * x[j]).sum();
        assert!((row - b[i]).abs() < 1e-12, "{i}: {row} {}", b[i]);
    }
    // u = L^T v keeps the energy as a plain sum of squares.
    let u = factor.whiten(&b);
    let energy: f64 = (0..n).map(|i| (0..n).map(|j| b[i] * mass[i][j] * b[j]).sum::<f64>()).sum();
    let squares: f64 = u.iter().map(|value| value * value).sum();
    assert!((energy - squares).abs() < 1e-12 * energy);
    let mut negative = mass;
    negative[3][3] = -1.0;
    assert!(Factor::new(&negative, n).is_none());
}
