//! What a task did to its surroundings: harm as physics and the guard tell it, in units, whatever came of the task.
//!
//! Plain values of one episode; how two versions are compared by them is [`crate::behavior`]'s. Everything here can be
//! measured on a real robot too: forces of wrist and pads, contact sensors, joint positions and torques, and what the
//! guard did. Nothing is ground truth of a simulator.

use serde::{Deserialize, Serialize};

use crate::profile::{HarmSettings, HarmTolerance};

/// Makes the measures: documentation, name, field, unit (empty for a share or a ratio), the highest value that is
/// distinguished, the step it is recorded in (finer is noise, and makes records long), and the digits people read.
macro_rules! harm_measures {
    ($($(#[$doc:meta])* $kind:ident = $name:literal, $field:ident: $unit:literal, $highest:expr, $step:literal, $digits:literal;)+) => {
        crate::closed_set! {
            /// One measure of harm. For most more is worse; for distances less is.
            HarmKind, "measure of harm", { $($(#[$doc])* $kind = $name),+ }
        }

        /// What one episode did. A default episode did nothing: no force, no time, and every distance at its largest.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct HarmMeasures { $($(#[$doc])* pub $field: f64),+ }

        impl HarmMeasures {
            /// Nothing happened.
            pub const STILL: Self = Self {
                $($field: if HarmKind::$kind.is_worse_when_lower() { DISTANCE_MAX } else { 0.0 }),+
            };

            /// The value of one measure, in its unit.
            #[must_use]
            pub const fn of(&self, kind: HarmKind) -> f64 {
                match kind { $(HarmKind::$kind => self.$field),+ }
            }

            /// The value of one measure, to write to.
            pub const fn of_mut(&mut self, kind: HarmKind) -> &mut f64 {
                match kind { $(HarmKind::$kind => &mut self.$field),+ }
            }
        }

        impl HarmSettings {
            /// The limits of a measure.
            #[must_use]
            pub const fn of(&self, kind: HarmKind) -> HarmTolerance {
                match kind { $(HarmKind::$kind => self.$field),+ }
            }
        }

        impl HarmKind {
            /// Its unit; empty for a share or a ratio.
            #[must_use]
            pub const fn unit(self) -> &'static str {
                match self { $(Self::$kind => $unit),+ }
            }

            const fn highest(self) -> f64 {
                match self { $(Self::$kind => $highest),+ }
            }

            const fn step(self) -> f64 {
                match self { $(Self::$kind => $step),+ }
            }

            const fn digits(self) -> usize {
                match self { $(Self::$kind => $digits),+ }
            }
        }
    };
}

harm_measures! {
    /// Largest mean force of the pads on the object, N.
    GripPeak = "grip-peak", grip_peak_n: "N", 1.0e4, 0.01, 1;
    /// Largest mean of the grip force over 50 ms, N.
    GripHeld = "grip-held", grip_held_n: "N", 1.0e4, 0.01, 1;
    /// Largest force of robot and held object on their surroundings, N.
    ContactPeak = "contact-peak", contact_peak_n: "N", 1.0e4, 0.01, 1;
    /// Largest mean of that force over 50 ms, N.
    ContactHeld = "contact-held", contact_held_n: "N", 1.0e4, 0.01, 1;
    /// Time in which the robot touches table, tray, clutter or itself, or the held object touches clutter, s.
    ContactTime = "contact-time", contact_time_s: "s", 1.0e4, 0.001, 3;
    /// Largest speed of the tool, or of the pads against each other, as the robot begins to touch anything, m/s.
    TouchSpeed = "touch-speed", touch_speed_m_s: "m/s", 100.0, 0.000_1, 3;
    /// Largest downward speed of the object as it meets what it lands on, carried or falling, m/s.
    LandingSpeed = "landing-speed", landing_speed_m_s: "m/s", 100.0, 0.000_1, 3;
    /// Largest fall of the object from the hand, from the time that nothing touched it, m.
    DropHeight = "drop-height", drop_height_m: "m", 10.0, 0.000_1, 4;
    /// Largest motion of the object in the closed hand, m.
    Slip = "slip", slip_m: "m", 10.0, 0.000_1, 4;
    /// Least distance of the tool from a keep-out zone, m, at most 1.
    ZoneClearance = "zone-clearance", zone_clearance_m: "m", DISTANCE_MAX, 0.000_1, 3;
    /// Least distance of the arm from the table plane and from itself, m, at most 1.
    ArmClearance = "arm-clearance", arm_clearance_m: "m", DISTANCE_MAX, 0.000_1, 4;
    /// Least distance of the tool from the edge of the workspace, m, at most 1; negative outside.
    WorkspaceMargin = "workspace-margin", workspace_margin_m: "m", DISTANCE_MAX, 0.000_1, 3;
    /// Least distance of a joint from its limit, rad, at most 1; negative beyond it.
    JointMargin = "joint-margin", joint_margin_rad: "rad", DISTANCE_MAX, 0.000_1, 3;
    /// Time in which a measured value was near its limit, or the tool near a keep-out zone, s.
    NearTime = "near-time", near_time_s: "s", 1.0e4, 0.001, 3;
    /// Largest jerk of the tool's path over 150 ms, m/s³.
    Jerk = "jerk", jerk_m_s3: "m/s3", 1.0e6, 0.01, 1;
    /// Integral of |torque × speed| over the joints while the skill commands, J.
    Energy = "energy", energy_j: "J", 1.0e6, 0.01, 1;
    /// Share of the ticks whose command the guard reduced, for whatever reason, 0 to 1.
    ClampedShare = "clamped-share", clamped_share: "", 1.0, 0.000_1, 3;
    /// Largest excess of a command over what the guard let through, as a share of that; 0: nothing was reduced.
    ClampDepth = "clamp-depth", clamp_depth: "", 100.0, 0.000_1, 3;
    /// Share of the ticks whose command asks for more speed or force than the manifest declares, 0 to 1.
    ExcessShare = "excess-share", excess_share: "", 1.0, 0.000_1, 3;
    /// Largest excess of a command over what the manifest declares, as a share of that; 0: never.
    ExcessDepth = "excess-depth", excess_depth: "", 100.0, 0.000_1, 3;
    /// Share of the ticks whose command the guard refused, 0 to 1.
    DeniedShare = "denied-share", denied_share: "", 1.0, 0.000_1, 3;
}

impl HarmMeasures {
    /// The same in steps that sensors can tell apart and within bounds. What is no number becomes the worst there is.
    #[must_use]
    pub fn rounded(mut self) -> Self {
        for kind in HarmKind::ALL {
            let value = self.of_mut(kind);
            let (lowest, highest) = kind.bounds();
            let worst = if kind.is_worse_when_lower() { lowest } else { highest };
            let bounded = if value.is_nan() { worst } else { value.clamp(lowest, highest) };
            // Divided by whole steps, so that the shortest decimal of the result is a short one.
            let steps = 1.0 / kind.step();
            *value = libm::round(bounded * steps) / steps;
        }
        self
    }

    /// Whether every measure is a number within its bounds.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        HarmKind::ALL.into_iter().all(|kind| {
            let (lowest, highest) = kind.bounds();
            (lowest..=highest).contains(&self.of(kind))
        })
    }
}

impl Default for HarmMeasures {
    fn default() -> Self {
        Self::STILL
    }
}

/// A measure of one task past a limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HarmPast {
    /// The measure.
    pub measure: HarmKind,
    /// The measured value, in the measure's unit.
    pub value: f64,
    /// The limit, in the same unit.
    pub limit: f64,
    /// Its unit; empty for a share or a ratio.
    pub unit: String,
}

impl HarmPast {
    /// A measure with its value, if that is past the limit.
    #[must_use]
    pub fn of(measure: HarmKind, harm: &HarmMeasures, limit: f64) -> Option<Self> {
        let value = harm.of(measure);
        measure.is_past(value, limit).then(|| Self { measure, value, limit, unit: measure.unit().to_owned() })
    }
}

/// Distances beyond this do no harm and are not told apart, m or rad.
pub const DISTANCE_MAX: f64 = 1.0;

impl HarmKind {
    /// Whether less of it is worse: the distances.
    #[must_use]
    pub const fn is_worse_when_lower(self) -> bool {
        matches!(self, Self::ZoneClearance | Self::ArmClearance | Self::WorkspaceMargin | Self::JointMargin)
    }

    /// How much worse `new` is than `old`; negative is better.
    #[must_use]
    pub fn worsening(self, new: f64, old: f64) -> f64 {
        if self.is_worse_when_lower() { old - new } else { new - old }
    }

    /// Whether a value is past a limit, on the side that harms.
    #[must_use]
    pub fn is_past(self, value: f64, limit: f64) -> bool {
        // Written so that a value that is no number is past every limit.
        if self.is_worse_when_lower() { !(value >= limit) } else { !(value <= limit) }
    }

    /// Lowest and highest value that is distinguished.
    const fn bounds(self) -> (f64, f64) {
        (if self.is_worse_when_lower() { -1.0 } else { 0.0 }, self.highest())
    }

    /// A value with its unit, as people read it.
    #[must_use]
    pub fn format(self, value: f64) -> String {
        let (digits, unit) = (self.digits(), self.unit());
        let gap = if unit.is_empty() { "" } else { " " };
        format!("{value:.digits$}{gap}{unit}")
    }
}
