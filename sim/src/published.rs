//! The scene and the distributions that are published with the simulated cell, and its drifts in numbers.

use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
use holdpoint_cell::number::parse_toml;
use holdpoint_cell::{CellError, Distribution, Range, Scene};
use serde::Deserialize;

/// The bench cell.
///
/// # Errors
/// [`CellError::File`] if the embedded text were wrong (a test parses it).
pub fn scene() -> Result<Scene, CellError> {
    Scene::from_toml("builtin:cell.toml", include_str!("../scenes/cell.toml"))
}

/// No perturbation.
///
/// # Errors
/// [`CellError::File`] if the embedded text were wrong (a test parses it).
pub fn canonical() -> Result<Distribution, CellError> {
    Distribution::from_toml("builtin:canonical.toml", include_str!("../scenes/canonical.toml"))
}

/// Independent noise, short latency, single tasks, no clutter.
///
/// # Errors
/// As [`canonical`].
pub fn sandbox() -> Result<Distribution, CellError> {
    Distribution::from_toml("builtin:sandbox.toml", include_str!("../scenes/sandbox.toml"))
}

/// Long latency, correlated noise, asynchronous camera frames, clutter.
///
/// # Errors
/// As [`canonical`].
pub fn live() -> Result<Distribution, CellError> {
    Distribution::from_toml("builtin:live.toml", include_str!("../scenes/live.toml"))
}

/// A drift's column of `scenes/drift.toml`.
const fn column(magnitude: Magnitude) -> usize {
    match magnitude {
        Magnitude::Mild => 0,
        Magnitude::Middle => 1,
        Magnitude::Strong => 2,
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DriftFile {
    format: u32,
    sensor_noise: SensorNoiseFile,
    distribution_shift: ShiftFile,
    actuator_delay: DelayFile,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorNoiseFile {
    sigma_factor: [f64; 3],
    sigma_floor_m: [f64; 3],
    bias_m: [f64; 3],
    drop_shift: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShiftFile {
    mass_factor: [f64; 3],
    friction_factor: [f64; 3],
    place_shift_m: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DelayFile {
    latency_shift_ms: [f64; 3],
    jitter_shift_ms: [f64; 3],
}

/// A distribution after a drift; the name says so (`live+sensor_noise:mild`).
///
/// # Errors
/// [`CellError::File`] if the embedded numbers were wrong (a test applies them all).
pub fn with_drift(of: &Distribution, drift: &Drift) -> Result<Distribution, CellError> {
    let file = "builtin:drift.toml";
    let numbers: DriftFile = parse_toml(file, include_str!("../scenes/drift.toml"))?;
    if numbers.format != 1 {
        return Err(CellError::file(file, "format", format!("\"{}\" is not known", numbers.format)));
    }
    let i = column(drift.magnitude);
    let mut out = of.clone();
    let kind = match drift.kind {
        DriftKind::SensorNoise => {
            add_noise(&mut out, &numbers.sensor_noise, i);
            "sensor_noise"
        }
        DriftKind::DistributionShift => {
            shift(&mut out, &numbers.distribution_shift, i);
            "distribution_shift"
        }
        DriftKind::ActuatorDelay => {
            delay(&mut out, &numbers.actuator_delay, i);
            "actuator_delay"
        }
        DriftKind::Combined => {
            add_noise(&mut out, &numbers.sensor_noise, i);
            shift(&mut out, &numbers.distribution_shift, i);
            delay(&mut out, &numbers.actuator_delay, i);
            "combined"
        }
    };
    let magnitude = ["mild", "middle", "strong"][i];
    out.name = format!("{}+{kind}:{magnitude}", of.name);
    out.check(file)?;
    Ok(out)
}

fn add_noise(out: &mut Distribution, numbers: &SensorNoiseFile, i: usize) {
    let factor = numbers.sigma_factor[i];
    let camera = &mut out.camera;
    camera.sigma_m = camera.sigma_m.scaled(factor);
    camera.sigma_m.min = camera.sigma_m.min.max(numbers.sigma_floor_m[i]);
    camera.sigma_m.max = camera.sigma_m.max.max(numbers.sigma_floor_m[i]);
    camera.sigma_yaw_rad = camera.sigma_yaw_rad.scaled(factor);
    camera.bias_m = camera.bias_m.shifted(numbers.bias_m[i]);
    let drop = &mut camera.drop_probability;
    *drop = Range {
        min: (drop.min + numbers.drop_shift[i]).min(1.0),
        max: (drop.max + numbers.drop_shift[i]).min(1.0),
    };
    let sensors = &mut out.sensors;
    for range in [
        &mut sensors.joint_rad,
        &mut sensors.joint_speed_rad_s,
        &mut sensors.torque_n_m,
        &mut sensors.force_n,
        &mut sensors.width_m,
        &mut sensors.slip_m,
    ] {
        *range = range.scaled(factor);
    }
}

fn shift(out: &mut Distribution, numbers: &ShiftFile, i: usize) {
    out.object.mass_kg = out.object.mass_kg.scaled(numbers.mass_factor[i]);
    out.object.friction = out.object.friction.scaled(numbers.friction_factor[i]);
    out.object.x_m = out.object.x_m.shifted(numbers.place_shift_m[i]);
}

fn delay(out: &mut Distribution, numbers: &DelayFile, i: usize) {
    out.action.latency_ms = out.action.latency_ms.shifted(numbers.latency_shift_ms[i]);
    out.action.jitter_ms =
        Range { min: out.action.jitter_ms.min, max: out.action.jitter_ms.max + numbers.jitter_shift_ms[i] };
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_cell::EpisodeSetup;
    use holdpoint_cell::envelope::{AXES, EnvelopePoint};

    #[test]
    fn envelope_point_fixes_only_the_values_of_its_axes() {
        let (whole, scene) = (sandbox().unwrap(), scene().unwrap());
        let [mut low, mut high] = [[0.0; AXES.len()], [1.0; AXES.len()]];
        let sample =
            |at: &EnvelopePoint, seed| EpisodeSetup::sample(TaskKind::Grasp, &scene, &whole.at(at), seed);
        assert_eq!(whole.values(&low)[3], whole.object.mass_kg.min);
        assert_eq!(whole.values(&high)[3], whole.object.mass_kg.max);
        assert_eq!(sample(&high, 1).object.mass_kg, whole.object.mass_kg.max);
        let (one, other) = (sample(&low, 1), sample(&low, 2));
        assert_eq!(one.object, other.object);
        assert_ne!(one.camera.noise, other.camera.noise, "noise is drawn");
        // No place is outside of what is declared.
        (low[0], high[0]) = (-3.0, f64::NAN);
        assert_eq!(whole.values(&low)[0], whole.object.x_m.min);
        let middle = 0.5 * (whole.object.x_m.min + whole.object.x_m.max);
        assert!((whole.values(&high)[0] - middle).abs() < 1e-12);
    }
}
