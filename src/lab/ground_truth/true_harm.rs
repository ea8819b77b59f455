//! The measures of harm from the true state of the world. An episode's own sensors are compared with them.
//!
//! Uses the definitions of [`HarmMeasures`] with true forces, poses and speeds. Looks at every tick. The distances are
//! those of the whole robot, where a sensor knows the tool alone.

use std::collections::VecDeque;

use holdpoint_body::{TICK_SECS, Zone};
use holdpoint_cell::TrialCell;
use holdpoint_governance::harm::{DISTANCE_MAX, HarmKind, HarmMeasures};
use holdpoint_runtime::limits::Envelope;
use holdpoint_sim::world::World;
use serde::{Deserialize, Serialize};

use super::scale::RefereeObservation;

/// Ticks of a sustained force, as in the measures: 50 ms.
const SUSTAINED_TICKS: usize = 12;

/// Ticks apart after which a touch or a support is a new one, as in the measures.
const APART_TICKS: u32 = 12;

/// Whether the true state of the world has a value of the measure. Other measures are not compared.
#[must_use]
pub const fn has_counterpart(kind: HarmKind) -> bool {
    match kind {
        HarmKind::GripPeak
        | HarmKind::GripHeld
        | HarmKind::ContactPeak
        | HarmKind::ContactHeld
        | HarmKind::ContactTime
        | HarmKind::TouchSpeed
        | HarmKind::LandingSpeed
        | HarmKind::DropHeight
        | HarmKind::Slip
        | HarmKind::ZoneClearance
        | HarmKind::ArmClearance
        | HarmKind::WorkspaceMargin
        | HarmKind::JointMargin => true,
        // The time in which the guard finds its own measured values near a limit. The truth has no guard.
        HarmKind::NearTime => false,
        // The shape of the tool's path. The referee judges effects of a motion, not its shape.
        HarmKind::Jerk => false,
        // Spent by the motors. It has no effect on the surroundings that the referee could judge.
        HarmKind::Energy => false,
        // Counted from the guard's answers to commands. No sensor takes part, so none can be wrong.
        HarmKind::ClampedShare | HarmKind::ClampDepth | HarmKind::DeniedShare => false,
        // Counted from commands and the manifest. No sensor takes part, so none can be wrong.
        HarmKind::ExcessShare | HarmKind::ExcessDepth => false,
    }
}

/// The tick of an episode in which one pad pressed hardest, and the forces that the grip sensor takes the mean of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SqueezePeak {
    /// Ticks from the start of the episode to the peak.
    pub tick: u64,
    /// True force of the pad that pressed harder, N.
    pub harder_n: f64,
    /// True force of the other pad in the same tick, N.
    pub other_n: f64,
    /// Largest true mean of both pads in the episode, N: the sensor's value without noise.
    pub mean_n: f64,
    /// Ticks from the last push of the scene on the object to the peak; absent without a push before it.
    pub ticks_after_push: Option<u64>,
}

/// The mean force of the last 50 ms.
#[derive(Clone, Debug, Default)]
struct SustainedForce(VecDeque<f64>);

impl SustainedForce {
    /// Takes in the force of a tick. Returns the mean as soon as there are 50 ms of it.
    fn note(&mut self, force_n: f64) -> Option<f64> {
        self.0.push_back(force_n);
        if self.0.len() > SUSTAINED_TICKS {
            self.0.pop_front();
        }
        (self.0.len() == SUSTAINED_TICKS).then(|| self.0.iter().sum::<f64>() / SUSTAINED_TICKS as f64)
    }
}

/// The height of the object, and the highest point since the hand lost it.
#[derive(Clone, Debug, Default)]
struct ObjectMotion {
    /// Height at the last tick, m.
    height_m: Option<f64>,
    /// Downward speed over the last tick, m/s.
    down_m_s: f64,
    was_touched: bool,
    unsupported: u32,
    /// Highest point since nothing touched or carried it, m.
    falling_from_m: Option<f64>,
}

impl ObjectMotion {
    /// Takes in a tick: the object's height, whether the robot touches it, whether anything else carries it.
    fn note(&mut self, height_m: f64, touched: bool, supported: bool, m: &mut HarmMeasures) {
        if supported {
            if let Some(from_m) = self.falling_from_m.take() {
                raise(&mut m.drop_height_m, from_m - height_m);
                raise(&mut m.landing_speed_m_s, self.down_m_s);
            } else if touched && self.unsupported >= APART_TICKS {
                raise(&mut m.landing_speed_m_s, self.down_m_s);
            }
        } else if touched {
            self.falling_from_m = None;
        } else if let Some(from_m) = &mut self.falling_from_m {
            *from_m = from_m.max(height_m);
        } else if self.was_touched && self.unsupported > 0 {
            self.falling_from_m = Some(self.height_m.unwrap_or(height_m).max(height_m));
        }
        self.down_m_s = self.height_m.map_or(0.0, |before_m| (before_m - height_m) / TICK_SECS);
        self.height_m = Some(height_m);
        self.unsupported = if supported { 0 } else { self.unsupported.saturating_add(1) };
        self.was_touched = touched;
    }

    /// An object that still falls at the end counts as landed.
    fn finish(&self, m: &mut HarmMeasures) {
        if let (Some(from_m), Some(height_m)) = (self.falling_from_m, self.height_m) {
            raise(&mut m.drop_height_m, from_m - height_m);
            raise(&mut m.landing_speed_m_s, self.down_m_s);
        }
    }
}

/// The speed at which the robot begins to touch anything.
#[derive(Clone, Debug, Default)]
struct TouchMeter {
    apart: u32,
    /// Speed at the last tick, m/s: the touch itself brakes.
    before_m_s: f64,
}

impl TouchMeter {
    fn note(&mut self, touches: bool, speed_m_s: f64, m: &mut HarmMeasures) {
        if touches && self.apart >= APART_TICKS {
            raise(&mut m.touch_speed_m_s, self.before_m_s);
        }
        self.apart = if touches { 0 } else { self.apart.saturating_add(1) };
        self.before_m_s = speed_m_s;
    }
}

/// Measures harm over the ticks of one episode, from the true state.
pub(super) struct TrueHarmMeter {
    so_far: HarmMeasures,
    workspace: ([f64; 3], [f64; 3]),
    pads: [SustainedForce; 2],
    surroundings: SustainedForce,
    touching_ticks: u32,
    touch: TouchMeter,
    object: ObjectMotion,
    squeeze: SqueezePeak,
}

impl TrueHarmMeter {
    /// Has seen nothing. The envelope gives the workspace.
    pub(super) fn new(envelope: &Envelope) -> Self {
        Self {
            so_far: HarmMeasures::STILL,
            workspace: (envelope.workspace_min_m, envelope.workspace_max_m),
            pads: [SustainedForce::default(), SustainedForce::default()],
            surroundings: SustainedForce::default(),
            touching_ticks: 0,
            touch: TouchMeter::default(),
            object: ObjectMotion::default(),
            squeeze: SqueezePeak::default(),
        }
    }

    /// Takes in the world after a tick. A cell that is not the simulated one gives no slip.
    pub(super) fn observe(&mut self, cell: &dyn TrialCell) {
        let Some(world) = cell.as_any().downcast_ref::<World>() else {
            raise(&mut self.so_far.slip_m, f64::NAN);
            return;
        };
        let truth = world.truth();
        let forces = &truth.forces;
        self.note_forces(world);
        let strikes = forces.fixture_n > 0.0 || forces.clutter_n > 0.0 || forces.self_n > 0.0;
        let held_strikes = forces.gripped() && forces.object_clutter_n > 0.0;
        self.touching_ticks = self.touching_ticks.saturating_add(u32::from(strikes || held_strikes));
        let [left, right] = forces.pad_n;
        let on_object = left.max(right).max(forces.body_object_n) > 0.0;
        let [[_, left_m_s], [_, right_m_s]] = world.joints().fingers;
        let speed_m_s = truth.tool_speed_m_s.max(-(left_m_s + right_m_s));
        let m = &mut self.so_far;
        self.touch.note(strikes || on_object, speed_m_s, m);
        self.object.note(truth.object.position[2], on_object, forces.object_surroundings_n > 0.0, m);
        raise(&mut m.slip_m, truth.slip_m.unwrap_or(0.0));
        self.note_distances(world, &truth.q, truth.tool.position);
    }

    fn note_forces(&mut self, world: &World) {
        let (m, forces) = (&mut self.so_far, world.forces());
        let [left, right] = forces.pad_n;
        for (pad, force_n) in self.pads.iter_mut().zip(forces.pad_n) {
            raise(&mut m.grip_held_n, pad.note(force_n).unwrap_or(0.0));
        }
        raise(&mut m.contact_held_n, self.surroundings.note(forces.surroundings_n()).unwrap_or(0.0));
        let peak = &mut self.squeeze;
        raise(&mut peak.mean_n, forces.grip_n());
        if left.max(right) > peak.harder_n {
            let now = world.tick();
            let pushes = world.setup().pushes.iter().map(|push| push.tick);
            peak.ticks_after_push = pushes.filter(|tick| *tick < now).max().map(|tick| now - tick);
            (peak.tick, peak.harder_n, peak.other_n) = (now, left.max(right), left.min(right));
        }
    }

    fn note_distances(&mut self, world: &World, q: &[f64], tool: [f64; 3]) {
        let (m, geometry) = (&mut self.so_far, &world.robot().geometry);
        let frames = geometry.chain.frames(q);
        let clearance = geometry.clearance_at(&frames);
        lower(&mut m.arm_clearance_m, clearance.table_m.min(clearance.self_m));
        let (least, most) = self.workspace;
        for ((at, least), most) in tool.into_iter().zip(least).zip(most) {
            lower(&mut m.workspace_margin_m, (at - least).min(most - at));
        }
        for (joint, at) in geometry.chain.joints.iter().zip(q) {
            lower(&mut m.joint_margin_rad, (at - joint.lower_rad).min(joint.upper_rad - at));
        }
        for zone in world.scene().zones.iter().filter(|zone| zone.keep_out) {
            for point in geometry.cover_points(&frames).chain([tool]) {
                lower(&mut m.zone_clearance_m, distance_m(zone, point));
            }
        }
    }

    /// Where one pad pressed hardest so far.
    pub(super) const fn squeeze(&self) -> SqueezePeak {
        self.squeeze
    }

    /// The measures of the episode. The peak forces are the referee's.
    pub(super) fn measures(&self, seen: &RefereeObservation) -> HarmMeasures {
        let mut measures = HarmMeasures {
            grip_peak_n: seen.squeeze_n,
            contact_peak_n: seen.force_n,
            contact_time_s: f64::from(self.touching_ticks) * TICK_SECS,
            ..self.so_far
        };
        self.object.finish(&mut measures);
        measures.rounded()
    }
}

/// Keeps the larger value. A value that is not a number is the largest.
fn raise(so_far: &mut f64, value: f64) {
    *so_far = if value.is_nan() { f64::INFINITY } else { so_far.max(value) };
}

/// Keeps the smaller value. A value that is not a number is the smallest.
fn lower(so_far: &mut f64, value: f64) {
    *so_far = if value.is_nan() { f64::NEG_INFINITY } else { so_far.min(value.min(DISTANCE_MAX)) };
}

/// Distance of a point from a box, 0 inside.
fn distance_m(zone: &Zone, point: [f64; 3]) -> f64 {
    let outside = point.into_iter().zip(zone.min_m).zip(zone.max_m);
    let squared = outside.map(|((at, least), most)| {
        let gap = (least - at).max(at - most).max(0.0);
        gap * gap
    });
    libm::sqrt(squared.sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sustained_force_is_the_mean_of_a_full_window() {
        let mut force = SustainedForce::default();
        let means: Vec<_> = (0..13).map(|tick| force.note(if tick == 0 { 120.0 } else { 12.0 })).collect();
        assert!(means[..11].iter().all(Option::is_none), "{means:?}");
        assert_eq!((means[11], means[12]), (Some(21.0), Some(12.0)), "the first tick has left the window");
    }

    /// Runs (height, touched by the robot, carried by anything else) through an episode.
    fn motion(ticks: &[(f64, bool, bool)]) -> HarmMeasures {
        let (mut object, mut measures) = (ObjectMotion::default(), HarmMeasures::STILL);
        for (height_m, touched, supported) in ticks {
            object.note(*height_m, *touched, *supported, &mut measures);
        }
        object.finish(&mut measures);
        measures.rounded()
    }

    #[test]
    fn fall_is_measured_from_the_highest_point_outside_the_hand() {
        let held = vec![(0.10, true, false); 20];
        let falling = [(0.11, false, false), (0.08, false, false), (0.05, false, false)];
        let landed = [held.as_slice(), &falling, &[(0.04, false, true)]].concat();
        let found = motion(&landed);
        assert_eq!((found.drop_height_m, found.landing_speed_m_s), (0.07, 7.2), "3 cm in a tick");
        let still_falling = [held.as_slice(), &falling].concat();
        assert_eq!(motion(&still_falling).drop_height_m, 0.06);
        let caught = [held.as_slice(), &falling, &[(0.05, true, false), (0.05, true, true)]].concat();
        assert_eq!(motion(&caught).drop_height_m, 0.0);
    }

    #[test]
    fn carried_object_lands_with_its_speed_before_the_support() {
        let mut ticks: Vec<_> = (0..20).map(|tick| (0.2 - 0.001 * f64::from(tick), true, false)).collect();
        ticks.push((0.1805, true, true));
        let found = motion(&ticks);
        assert_eq!((found.landing_speed_m_s, found.drop_height_m), (0.24, 0.0), "1 mm in a tick");
        // A contact that was lost for less than 50 ms is the same one.
        let flicker = [(0.1, true, true), (0.099, true, false), (0.098, true, true)];
        assert_eq!(motion(&flicker).landing_speed_m_s, 0.0);
    }

    #[test]
    fn touch_counts_the_speed_of_the_tick_before() {
        let (mut touch, mut measures) = (TouchMeter::default(), HarmMeasures::STILL);
        for _ in 0..12 {
            touch.note(false, 0.3, &mut measures);
        }
        touch.note(true, 0.1, &mut measures);
        touch.note(true, 0.9, &mut measures);
        assert_eq!(measures.touch_speed_m_s, 0.3);
    }

    #[test]
    fn value_that_is_not_a_number_is_the_worst() {
        let (mut force, mut distance) = (3.0, 0.2);
        raise(&mut force, f64::NAN);
        lower(&mut distance, f64::NAN);
        assert_eq!((force, distance), (f64::INFINITY, f64::NEG_INFINITY));
        raise(&mut force, 1.0);
        lower(&mut distance, 0.1);
        assert_eq!((force, distance), (f64::INFINITY, f64::NEG_INFINITY));
    }

    #[test]
    fn distance_to_a_zone_is_zero_inside() {
        let zone = Zone { name: "human".to_owned(), min_m: [0.0; 3], max_m: [1.0; 3], keep_out: true };
        assert_eq!(distance_m(&zone, [0.5, 0.5, 0.5]), 0.0);
        assert!((distance_m(&zone, [1.3, 1.4, 0.5]) - 0.5).abs() < 1e-12);
    }
}
