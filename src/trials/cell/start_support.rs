//! The declared support of what a skill may see at the start of a task: the domain that evidence of a cell covers.
//!
//! Everything is computed from the declared scene, robot and distributions, nothing from sampled episodes. A true value
//! has the range of the sandbox's distribution. The camera widens it by the least margin past which the noise that the
//! sandbox declares carries a start with a small probability ([`OUTSIDE_SHARE`]). One quantity takes the wider range of
//! sandbox and live cell: the age of the first camera frame. A version meets the live cell's delays in shadow.
//!
//! A grasp starts at home with the object on the table. Align and place start as the task before left the cell, so they
//! have bounds only where scene and distribution bound that: target, hand, and roughly the object.

use std::f64::consts::{FRAC_1_SQRT_2, PI, SQRT_2};

use holdpoint_body::RATE_HZ;
use holdpoint_body::task::EpisodeStart;
use holdpoint_cell::CellSpec;
use holdpoint_cell::distribution::{CameraRange, Distribution, Range};
use holdpoint_governance::start_domain::{StartBound, StartDomain, StartQuantity};

/// The probability that one end of one noisy quantity finds a start of the sandbox outside: a thousandth over the
/// sixteen ends of a grasp (object and target: x, y, z, yaw), which has most of them.
const OUTSIDE_SHARE: f64 = 0.001 / 16.0;

/// Noise of the robot's sensors ends at 3.46 standard deviations.
const SENSOR_NOISE_SD: f64 = 3.47;

/// Rounding of exposure and delivery of a camera frame, ticks.
const FRAME_ROUNDING_TICKS: f64 = 2.0;

/// Acceleration of free fall, m/s²: the standard value (3rd CGPM 1901), rounded. Recorded domains rest on the rounded
/// value, so it stays.
const GRAVITY_ROUNDED_M_S2: f64 = 9.81;

/// What evidence of a cell covers of the start of a task that starts so.
pub(super) fn start_domain(
    spec: &CellSpec,
    sandbox: &Distribution,
    live: &Distribution,
    start: EpisodeStart,
) -> StartDomain {
    let (scene, camera) = (&spec.scene, &sandbox.camera);
    let across = Noise { bias: camera.bias_m, sigma: camera.sigma_m };
    let upward = Noise { bias: Range::exactly(0.0), sigma: camera.sigma_m.scaled(0.5) };
    let turned = Noise { bias: camera.bias_yaw_rad, sigma: camera.sigma_yaw_rad };
    let (object, target) = (&sandbox.object, &sandbox.target);
    let mut bounds = vec![
        uniform(StartQuantity::TargetX, target.x_m, &across),
        uniform(StartQuantity::TargetY, target.y_m, &across),
        uniform(StartQuantity::TargetZ, Range::exactly(scene.tray.floor_m), &upward),
        uniform(StartQuantity::TargetYaw, target.yaw_rad, &turned),
    ];
    match start {
        EpisodeStart::Home => {
            bounds.extend([
                uniform(StartQuantity::ObjectX, object.x_m, &across),
                uniform(StartQuantity::ObjectY, object.y_m, &across),
                uniform(StartQuantity::ObjectZ, Range::exactly(scene.object.half_m), &upward),
                uniform(StartQuantity::ObjectYaw, object.yaw_rad, &turned),
            ]);
            let noise = SENSOR_NOISE_SD * sandbox.sensors.joint_rad.max;
            let offset = sandbox.arm.home_offset_rad;
            let joints = StartQuantity::JOINTS.into_iter().zip(&spec.robot.home);
            bounds.extend(joints.map(|(quantity, home)| StartBound {
                quantity,
                low: home + offset.min - noise,
                high: home + offset.max + noise,
            }));
        }
        EpisodeStart::InHand => {
            let reach = moved_at_most_m(spec, sandbox);
            let moved = |range: Range| Range { min: range.min - reach, max: range.max + reach };
            bounds.push(anywhere(StartQuantity::ObjectX, moved(object.x_m), &across));
            bounds.push(anywhere(StartQuantity::ObjectY, moved(object.y_m), &across));
        }
        EpisodeStart::OverTarget => {
            // The object hangs over the tray, and the bias of the camera cancels out.
            let half = scene.object.half_m + scene.tray.clearance_m;
            let over = Range { min: -half, max: half };
            let both = Noise { bias: Range::exactly(0.0), sigma: camera.sigma_m.scaled(SQRT_2) };
            bounds.push(anywhere(StartQuantity::OffsetX, over, &both));
            bounds.push(anywhere(StartQuantity::OffsetY, over, &both));
        }
    }
    let held = f64::from(u8::from(start.is_held()));
    bounds.push(StartBound { quantity: StartQuantity::Held, low: held, high: held });
    let age = age_max_ms(spec, camera).max(age_max_ms(spec, &live.camera));
    bounds.push(StartBound { quantity: StartQuantity::PictureAge, low: 0.0, high: age });
    StartDomain { bounds }
}

/// How far the object moves at most before it is lifted, m: a push slides it, and the closing pads pull it.
fn moved_at_most_m(spec: &CellSpec, distribution: &Distribution) -> f64 {
    let push = &distribution.push;
    let speed = if push.probability.max > 0.0 { push.speed_m_s.max } else { 0.0 };
    // The smaller coefficient of object and table counts.
    let friction = distribution.object.friction.min.min(spec.scene.table.friction);
    speed * speed / (2.0 * friction * GRAVITY_ROUNDED_M_S2) + 0.5 * spec.robot.width_max_m
}

/// The largest age of the camera frame that is the newest, ms. It is so until the next one, a period later, is delivered.
fn age_max_ms(spec: &CellSpec, camera: &CameraRange) -> f64 {
    let period_ms = 1000.0 / f64::from(spec.camera_hz) + camera.period_jitter_ms.max;
    let delay_ms = camera.delay_ms.max + camera.delay_jitter_ms.max;
    period_ms + delay_ms + FRAME_ROUNDING_TICKS * 1000.0 / f64::from(RATE_HZ)
}

/// Errors of a measured value: constant in an episode, and from frame to frame.
struct Noise {
    bias: Range,
    /// Standard deviation.
    sigma: Range,
}

/// The bound of a quantity whose true value is uniform in a range.
fn uniform(quantity: StartQuantity, range: Range, noise: &Noise) -> StartBound {
    widened(quantity, range, range.max - range.min, noise)
}

/// The bound of a quantity whose true value may be anywhere in a range, always at its end, too.
fn anywhere(quantity: StartQuantity, range: Range, noise: &Noise) -> StartBound {
    widened(quantity, range, 0.0, noise)
}

fn widened(quantity: StartQuantity, range: Range, width: f64, noise: &Noise) -> StartBound {
    let Range { min, max } = noise.bias;
    let mirrored = Noise { bias: Range { min: -max, max: -min }, sigma: noise.sigma };
    StartBound { quantity, low: range.min - margin(width, &mirrored), high: range.max + margin(width, noise) }
}

/// The least margin past the upper end of a range that the noise carries a value past with a probability of
/// [`OUTSIDE_SHARE`] at most. The value is uniform in the range, of this width.
fn margin(width: f64, noise: &Noise) -> f64 {
    const STEPS: u32 = 30;
    // Eight standard deviations of a normal distribution have a probability of 1e-15.
    let farthest = noise.bias.max.abs().max(noise.bias.min.abs()) + 8.0 * noise.sigma.max;
    let (mut inside, mut outside) = (0.0, farthest);
    for _ in 0..STEPS {
        let middle = 0.5 * (inside + outside);
        if past(middle, width, noise) > OUTSIDE_SHARE {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    outside
}

/// The probability that bias and noise carry a value, uniform in a range of this width, past its upper end by more than
/// `margin`. Bias and standard deviation are uniform in their ranges, as an episode samples them.
fn past(margin: f64, width: f64, noise: &Noise) -> f64 {
    const POINTS: u32 = 8;
    let point = |range: &Range, index: u32| {
        range.min + (range.max - range.min) * (f64::from(index) + 0.5) / f64::from(POINTS)
    };
    let mut sum = 0.0;
    for bias in (0..POINTS).map(|index| point(&noise.bias, index)) {
        for sigma in (0..POINTS).map(|index| point(&noise.sigma, index)) {
            sum += past_by_normal(margin - bias, width, sigma);
        }
    }
    sum / f64::from(POINTS * POINTS)
}

/// As [`past`], with normal noise of one standard deviation.
fn past_by_normal(margin: f64, width: f64, sigma: f64) -> f64 {
    match (sigma > 0.0, width > 0.0) {
        (true, true) => sigma / width * (loss(margin / sigma) - loss((margin + width) / sigma)),
        (true, false) => upper_tail(margin / sigma),
        (false, true) => (-margin).clamp(0.0, width) / width,
        (false, false) => f64::from(u8::from(margin < 0.0)),
    }
}

/// The mean excess of a standard normal value over `z`.
fn loss(z: f64) -> f64 {
    libm::exp(-0.5 * z * z) / libm::sqrt(2.0 * PI) - z * upper_tail(z)
}

/// The probability that a standard normal value exceeds `z`.
fn upper_tail(z: f64) -> f64 {
    0.5 * libm::erfc(z * FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use holdpoint_body::disturbance::{Drift, DriftKind, Magnitude};
    use holdpoint_body::{Command, GuardVerdict, TaskKind};
    use holdpoint_cell::{EpisodeSetup, TrialCell};
    use holdpoint_governance::start_domain::{DomainMiss, StartObservation};
    use holdpoint_runtime::agent::dispatcher::is_holding;
    use holdpoint_sim::SimCells;

    use crate::cell::Cell;

    use super::*;

    fn bound(cell: &Cell, task: TaskKind, quantity: StartQuantity) -> [f64; 2] {
        let bound = cell.start_domain(task).bound(quantity).unwrap();
        [bound.low, bound.high]
    }

    /// Numbers of another implementation of the same integrals, with 64 points in place of 8.
    #[test]
    fn bounds_are_the_declared_ranges_with_the_margin_of_the_noise() {
        let cell = Cell::of(&SimCells, None).unwrap();
        for (quantity, low, high) in [
            (StartQuantity::ObjectX, 0.414_055, 0.565_945),
            (StartQuantity::ObjectY, -0.256_187, -0.133_813),
            (StartQuantity::ObjectZ, 0.020_129, 0.029_871),
            (StartQuantity::ObjectYaw, -0.764_97, 0.764_97),
            (StartQuantity::TargetX, 0.453_501, 0.546_499),
            (StartQuantity::TargetY, 0.143_371, 0.226_629),
            (StartQuantity::TargetYaw, -0.471_22, 0.471_22),
        ] {
            let [found_low, found_high] = bound(&cell, TaskKind::Grasp, quantity);
            let close = |found: f64, expected: f64| (found - expected).abs() < 3e-4;
            assert!(close(found_low, low) && close(found_high, high), "{quantity}: {found_low} {found_high}");
        }
        let joints = StartQuantity::JOINTS
            .into_iter()
            .filter(|joint| cell.start_domain(TaskKind::Grasp).bound(*joint).is_some());
        assert_eq!(joints.count(), 7);
        let [low, high] = bound(&cell, TaskKind::Grasp, StartQuantity::Joint2);
        assert!(
            (high - low - 0.1).abs() < 2e-3 && (0.5 * (low + high) - cell.spec.robot.home[1]).abs() < 1e-9
        );
    }

    /// The live cell is wider than the sandbox in one observed quantity.
    #[test]
    fn frame_age_is_that_of_the_live_cell() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let (sandbox, live) =
            (age_max_ms(&cell.spec, &cell.sandbox.camera), age_max_ms(&cell.spec, &cell.live.camera));
        assert!(sandbox < 75.0 && live > 119.0, "{sandbox} {live}");
        for task in TaskKind::SEQUENCE {
            assert_eq!(bound(&cell, task, StartQuantity::PictureAge), [0.0, live]);
        }
    }

    #[test]
    fn a_start_after_a_push_is_covered_and_one_in_an_empty_hand_is_not() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let [low, high] = bound(&cell, TaskKind::Align, StartQuantity::ObjectX);
        // A push of .75 m/s at a friction of .4 slides 72 mm, and a pad moves 40 mm.
        assert!(low < 0.42 - 0.111 && high > 0.56 + 0.111 && high < 0.56 + 0.13, "{low} {high}");
        assert_eq!(bound(&cell, TaskKind::Align, StartQuantity::Held), [1.0, 1.0]);
        assert_eq!(bound(&cell, TaskKind::Grasp, StartQuantity::Held), [0.0, 0.0]);
        let [low, high] = bound(&cell, TaskKind::Place, StartQuantity::OffsetX);
        assert!((low + high).abs() < 1e-12 && high > 0.028 && high < 0.045, "{low} {high}");
    }

    #[test]
    fn noise_without_a_standard_deviation_widens_by_its_bias() {
        let noise = Noise { bias: Range { min: -0.001, max: 0.002 }, sigma: Range::exactly(0.0) };
        assert!(margin(0.1, &noise) <= 0.002 && margin(0.1, &noise) > 0.0015);
        assert!(past(0.002, 0.1, &noise) == 0.0 && past(-0.01, 0.1, &noise) > 0.09);
        let normal = Noise { bias: Range::exactly(0.0), sigma: Range::exactly(1.0) };
        assert!((past(3.0, 0.0, &normal) - 0.001_349_898).abs() < 1e-8);
    }

    /// The misses of the start of an episode: without a skill, up to the first camera frame.
    fn misses(cell: &Cell, world: &mut dyn TrialCell, setup: &EpisodeSetup) -> Vec<DomainMiss> {
        // A start in the hand that the physics cannot set up is no start.
        if world.reset(setup).is_err() {
            return Vec::new();
        }
        let is_held = is_holding(&world.telemetry());
        let mut seen = StartObservation::new(&world.observe(GuardVerdict::Allowed), is_held);
        while !seen.has_frame() {
            world.step(&Command::Hold).unwrap();
            seen.see(&world.observe(GuardVerdict::Allowed));
        }
        cell.start_domain(setup.task).misses(&seen)
    }

    fn outside(cell: &Cell, distribution: &Distribution, task: TaskKind, count: u64) -> Vec<Vec<DomainMiss>> {
        let mut world = cell.trial().unwrap();
        let setups =
            (0..count).map(|index| EpisodeSetup::sample(task, &cell.scene, distribution, 1_710_000 + index));
        let all = setups.map(|setup| misses(cell, world.as_mut(), &setup));
        all.filter(|misses| !misses.is_empty()).collect()
    }

    /// At most one refusal in a thousand tasks. Computed for the noise of the live cell: one in 3,900.
    #[test]
    fn an_unchanged_cell_starts_inside_its_domain() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let found = outside(&cell, &cell.live, TaskKind::Grasp, 2_000);
        assert!(found.len() <= 2, "{found:?}");
    }

    /// The starts in the hand of the sandbox, whose margins are not used up.
    #[test]
    fn starts_in_the_hand_are_inside_the_domain() {
        let cell = Cell::of(&SimCells, None).unwrap();
        for task in [TaskKind::Align, TaskKind::Place] {
            let found = outside(&cell, &cell.sandbox, task, 40);
            assert!(found.is_empty(), "{task}: {found:?}");
        }
    }

    /// Of a live distribution that moved by 3 cm, 17 % of the starts lie outside, all of them past the upper end of x.
    #[test]
    fn a_moved_distribution_leaves_the_domain() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let drift = Drift { kind: DriftKind::DistributionShift, magnitude: Magnitude::Strong };
        let found = outside(&cell, &cell.with_drift(&cell.live, &drift).unwrap(), TaskKind::Grasp, 200);
        assert!((20..=50).contains(&found.len()), "{}", found.len());
        for misses in found {
            let is_past = |miss: &DomainMiss| {
                matches!(miss, DomainMiss::Outside { quantity: StartQuantity::ObjectX, value: Some(value), high, .. }
                    if value > high)
            };
            assert!(misses.iter().any(is_past), "{misses:?}");
        }
    }
}
