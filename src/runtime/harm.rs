//! What a task does to its surroundings, tick by tick: fills [`HarmMeasures`] from telemetry and the guard's answers.
//!
//! Reads sensors and commands alone; judges nothing. A fixed number of values is kept, so that it costs every tick the
//! same and a copy of a task copies it.

use holdpoint_body::{Command, Contacts, GuardVerdict, JointVec, TICK_SECS, Telemetry, Zone};
use holdpoint_governance::harm::{DISTANCE_MAX, HarmMeasures};

use super::guard::{CheckedCommand, Guard};

/// Ticks that a force has to last to be a sustained one, and the step of the tool's path: 50 ms.
const WINDOW: usize = 12;

/// Ticks of the tool's path that are kept: four points 50 ms apart.
const PATH: usize = 3 * WINDOW + 1;

/// Ticks without touching after which a touch is a new one: contacts flicker.
const APART_TICKS: u32 = 12;

/// Fall after which nothing is added, ticks: half a second, 1.2 m.
const FALL_TICKS_MAX: u32 = 120;

/// Ticks between two looks at the distances that cost something; the arm moves 12 mm at most between two.
const DISTANCES_EVERY: u64 = 4;

/// Ticks over which the closing speed of the pads is taken: one tick's difference is mostly noise.
const PAD_TICKS: usize = 4;

/// Standard acceleration of free fall, m/s² (3rd CGPM 1901; ISO 80000-3).
const GRAVITY_M_S2: f64 = 9.806_65;

/// The mean over the last [`WINDOW`] values.
#[derive(Clone, Debug, Default)]
struct SlidingMean {
    values: [f64; WINDOW],
    sum: f64,
    count: usize,
}

impl SlidingMean {
    /// Takes in a value; the mean, once the window is full.
    fn note(&mut self, value: f64) -> Option<f64> {
        let slot = self.values.get_mut(self.count % WINDOW)?;
        self.sum += value - *slot;
        *slot = value;
        self.count += 1;
        // Rounding of the running sum must not make a force of nothing.
        (self.count >= WINDOW).then(|| (self.sum / WINDOW as f64).max(0.0))
    }
}

/// Where the tool was in the last ticks.
#[derive(Clone, Debug)]
struct ToolPath {
    points: [[f64; 3]; PATH],
    count: usize,
}

impl ToolPath {
    fn note(&mut self, point: [f64; 3]) {
        if let Some(slot) = self.points.get_mut(self.count % PATH) {
            *slot = point;
        }
        self.count += 1;
    }

    /// The point so many windows ago.
    fn ago(&self, windows: usize) -> Option<[f64; 3]> {
        let back = windows * WINDOW + 1;
        (self.count >= back).then(|| self.points.get((self.count - back) % PATH).copied()).flatten()
    }

    /// Downward speed over the last window, m/s.
    fn descent_m_s(&self) -> f64 {
        let (Some(now), Some(before)) = (self.ago(0), self.ago(1)) else { return 0.0 };
        (before[2] - now[2]) / (WINDOW as f64 * TICK_SECS)
    }

    /// Third difference over three windows by their cubed length, m/s³.
    fn jerk_m_s3(&self) -> Option<f64> {
        let step_s = WINDOW as f64 * TICK_SECS;
        let [a, b, c, d] = [self.ago(3)?, self.ago(2)?, self.ago(1)?, self.ago(0)?];
        let third: f64 = (0..3)
            .map(|i| {
                let difference = d[i] - 3.0 * c[i] + 3.0 * b[i] - a[i];
                difference * difference
            })
            .sum();
        Some(libm::sqrt(third) / (step_s * step_s * step_s))
    }
}

/// The object since it left the hand with nothing beneath it.
#[derive(Clone, Copy, Debug)]
struct Fall {
    ticks: u32,
    /// Downward speed of the tool when the hand let go, m/s.
    from_m_s: f64,
}

impl Fall {
    fn seconds(self) -> f64 {
        f64::from(self.ticks.min(FALL_TICKS_MAX)) * TICK_SECS
    }

    fn height_m(self) -> f64 {
        let t = self.seconds();
        (self.from_m_s * t + 0.5 * GRAVITY_M_S2 * t * t).max(0.0)
    }

    fn speed_m_s(self) -> f64 {
        (self.from_m_s + GRAVITY_M_S2 * self.seconds()).max(0.0)
    }
}

/// Measures harm over the ticks of one task.
#[derive(Clone, Debug)]
pub struct HarmMeter {
    so_far: HarmMeasures,
    grip: SlidingMean,
    contact: SlidingMean,
    path: ToolPath,
    /// Ticks measured.
    ticks: u64,
    /// Ticks in which the skill commanded, and of these with a command reduced or refused.
    commanded: u32,
    clamped: u32,
    denied: u32,
    /// Ticks with a command beyond the version's own declaration.
    beyond: u32,
    /// Ticks since the robot touched anything, and since the object touched anything but the robot.
    untouched: u32,
    unsupported: u32,
    touching_ticks: u32,
    near_ticks: u32,
    speed_before_m_s: f64,
    /// Distances between the pads in the last ticks, m.
    widths_m: [f64; PAD_TICKS + 1],
    was_held: bool,
    fall: Option<Fall>,
}

impl Default for HarmMeter {
    fn default() -> Self {
        Self {
            so_far: HarmMeasures::STILL,
            grip: SlidingMean::default(),
            contact: SlidingMean::default(),
            path: ToolPath { points: [[0.0; 3]; PATH], count: 0 },
            ticks: 0,
            commanded: 0,
            clamped: 0,
            denied: 0,
            beyond: 0,
            // A task that begins in contact does not begin with a touch.
            untouched: 0,
            unsupported: 0,
            touching_ticks: 0,
            near_ticks: 0,
            speed_before_m_s: 0.0,
            widths_m: [0.0; PAD_TICKS + 1],
            was_held: false,
            fall: None,
        }
    }
}

impl HarmMeter {
    /// Takes in a command of the skill and what the guard made of it; torques and speeds are those it was given under.
    pub fn note_command(
        &mut self,
        requested: &Command,
        checked: &CheckedCommand,
        guard: &Guard,
        (tau, dq): (&JointVec, &JointVec),
    ) {
        self.commanded = self.commanded.saturating_add(1);
        let excess = guard.excess_over_declared(requested);
        self.beyond = self.beyond.saturating_add(u32::from(excess > 0.0));
        self.so_far.excess_depth = worse(self.so_far.excess_depth, excess);
        match checked.verdict {
            GuardVerdict::Allowed => {}
            GuardVerdict::Clamped => {
                self.clamped = self.clamped.saturating_add(1);
                self.so_far.clamp_depth = self.so_far.clamp_depth.max(depth(requested, &checked.command));
            }
            GuardVerdict::Denied => self.denied = self.denied.saturating_add(1),
        }
        let power_w: f64 = tau.iter().zip(dq).map(|(torque, speed)| (torque * speed).abs()).sum();
        self.so_far.energy_j += power_w * TICK_SECS;
    }

    /// Takes in what the sensors tell after a tick.
    pub fn note(&mut self, seen: &Telemetry, guard: &Guard, near: bool) {
        let m = &mut self.so_far;
        m.grip_peak_n = worse(m.grip_peak_n, seen.gripper_force_n);
        m.contact_peak_n = worse(m.contact_peak_n, seen.contact_force_n);
        if let Some(mean) = self.grip.note(seen.gripper_force_n) {
            m.grip_held_n = worse(m.grip_held_n, mean);
        }
        if let Some(mean) = self.contact.note(seen.contact_force_n) {
            m.contact_held_n = worse(m.contact_held_n, mean);
        }
        m.slip_m = worse(m.slip_m, seen.slip_m.unwrap_or(0.0));
        // A landing brakes the hand: what counts is how fast it came down before.
        let descent_m_s = self.path.descent_m_s();
        self.path.note(seen.tool.position);
        if self.ticks.is_multiple_of(DISTANCES_EVERY) {
            m.jerk_m_s3 = worse(m.jerk_m_s3, self.path.jerk_m_s3().unwrap_or(0.0));
            note_distances(m, seen, guard);
        }
        self.near_ticks = self.near_ticks.saturating_add(u32::from(near));
        self.note_touch(seen);
        self.widths_m.rotate_left(1);
        self.widths_m[PAD_TICKS] = seen.gripper_width_m;
        self.note_object(seen.contacts, descent_m_s);
        self.speed_before_m_s = seen.tool_speed_m_s;
        self.ticks += 1;
    }

    fn note_touch(&mut self, seen: &Telemetry) {
        let c = &seen.contacts;
        let strikes = c.robot_fixture || c.robot_clutter || c.robot_robot;
        let held = c.pad_object;
        let touches = strikes || held || c.body_object;
        if touches && self.untouched >= APART_TICKS {
            // The touch itself brakes: the speed that counts is the one it was met with, the pads' own included.
            let met_with = self.speed_before_m_s.max(seen.tool_speed_m_s).max(self.closing_m_s());
            self.so_far.touch_speed_m_s = worse(self.so_far.touch_speed_m_s, met_with);
        }
        self.untouched = if touches { 0 } else { self.untouched.saturating_add(1) };
        let presses = strikes || (held && c.object_clutter);
        self.touching_ticks = self.touching_ticks.saturating_add(u32::from(presses));
    }

    /// How fast the pads closed until the tick before, each against the other, m/s.
    fn closing_m_s(&self) -> f64 {
        if self.ticks <= PAD_TICKS as u64 {
            return 0.0;
        }
        ((self.widths_m[0] - self.widths_m[PAD_TICKS]) / (PAD_TICKS as f64 * TICK_SECS)).max(0.0)
    }

    fn note_object(&mut self, c: Contacts, descent_m_s: f64) {
        let held = c.pad_object || c.body_object;
        let supported = c.object_fixture || c.object_clutter;
        if supported {
            if let Some(fall) = self.fall.take() {
                self.landed(fall);
            } else if held && self.unsupported >= APART_TICKS {
                self.so_far.landing_speed_m_s = self.so_far.landing_speed_m_s.max(descent_m_s);
            }
        } else if held {
            // Caught again, or a flicker of the contact.
            self.fall = None;
        } else if let Some(fall) = &mut self.fall {
            fall.ticks = fall.ticks.saturating_add(1);
        } else if self.was_held && self.unsupported > 0 {
            self.fall = Some(Fall { ticks: 1, from_m_s: descent_m_s });
        }
        self.unsupported = if supported { 0 } else { self.unsupported.saturating_add(1) };
        self.was_held = held;
    }

    fn landed(&mut self, fall: Fall) {
        let m = &mut self.so_far;
        m.drop_height_m = m.drop_height_m.max(fall.height_m());
        m.landing_speed_m_s = m.landing_speed_m_s.max(fall.speed_m_s());
    }

    /// Returns the harm measured so far. An object that is still falling counts as if it landed now.
    #[must_use]
    pub fn measures(&self) -> HarmMeasures {
        let mut whole = self.clone();
        if let Some(fall) = whole.fall.take() {
            whole.landed(fall);
        }
        let share = |ticks: u32| f64::from(ticks) / f64::from(self.commanded.max(1));
        HarmMeasures {
            contact_time_s: f64::from(self.touching_ticks) * TICK_SECS,
            near_time_s: f64::from(self.near_ticks) * TICK_SECS,
            clamped_share: share(self.clamped),
            denied_share: share(self.denied),
            excess_share: share(self.beyond),
            ..whole.so_far
        }
        .rounded()
    }
}

/// The larger of the two; a value that is no number is the largest there is.
const fn worse(so_far: f64, value: f64) -> f64 {
    if value.is_nan() { f64::INFINITY } else { so_far.max(value) }
}

/// The smaller of the two; a value that is no number is the smallest there is.
const fn nearer(so_far: f64, value: f64) -> f64 {
    if value.is_nan() { f64::NEG_INFINITY } else { so_far.min(value) }
}

/// The relative excess of the requested value over the allowed one.
fn depth(requested: &Command, allowed: &Command) -> f64 {
    let (requested, allowed) = match (requested, allowed) {
        (Command::ToolPose { max_speed_m_s: a, .. }, Command::ToolPose { max_speed_m_s: b, .. })
        | (Command::Joints { max_speed_rad_s: a, .. }, Command::Joints { max_speed_rad_s: b, .. })
        | (Command::Gripper { force_n: a, .. }, Command::Gripper { force_n: b, .. }) => (*a, *b),
        _ => return 0.0,
    };
    if requested > allowed && allowed > 0.0 { requested / allowed - 1.0 } else { 0.0 }
}

fn note_distances(m: &mut HarmMeasures, seen: &Telemetry, guard: &Guard) {
    let tool = seen.tool.position;
    let e = guard.envelope();
    let edges = (0..3)
        .map(|i| (tool[i] - e.workspace_min_m[i]).min(e.workspace_max_m[i] - tool[i]))
        .fold(DISTANCE_MAX, nearer);
    m.workspace_margin_m = nearer(m.workspace_margin_m, edges);
    let zones = guard.keep_out_zones().map(|zone| distance_m(zone, tool)).fold(DISTANCE_MAX, nearer);
    m.zone_clearance_m = nearer(m.zone_clearance_m, zones);
    let joints = guard.geometry().chain.joints.iter().zip(&seen.q);
    let margin =
        joints.map(|(joint, q)| (q - joint.lower_rad).min(joint.upper_rad - q)).fold(DISTANCE_MAX, nearer);
    m.joint_margin_rad = nearer(m.joint_margin_rad, margin);
    m.arm_clearance_m = nearer(m.arm_clearance_m, guard.clearance_seen_m());
}

/// Distance of a point from a box, 0 inside.
fn distance_m(zone: &Zone, point: [f64; 3]) -> f64 {
    let squared: f64 = (0..3)
        .map(|i| {
            let outside = (zone.min_m[i] - point[i]).max(point[i] - zone.max_m[i]).max(0.0);
            outside * outside
        })
        .sum();
    libm::sqrt(squared)
}

#[cfg(test)]
mod tests;
