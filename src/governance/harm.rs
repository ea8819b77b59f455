//! What a task did to its surroundings: harm as physics and the guard tell it, in units, whatever came of the task.
//!
//! Plain values of one episode; how two versions are compared by them is [`crate::behavior`]'s. Everything here can be
//! measured on a real robot too: forces of wrist and pads, contact sensors, joint positions and torques, and what the
//! guard did. Nothing is ground truth of a simulator.

use serde::{Deserialize, Serialize};

crate::closed_set! {
    /// One measure of harm. For most more is worse; for distances less is.
    HarmKind, "measure of harm", {
        /// Largest mean force of the pads on the object, N.
        GripPeak = "grip-peak",
        /// Largest mean of the grip force over 50 ms, N.
        GripHeld = "grip-held",
        /// Largest force of robot and held object on their surroundings, N.
        ContactPeak = "contact-peak",
        /// Largest mean of that force over 50 ms, N.
        ContactHeld = "contact-held",
        /// Time in which the robot touches table, tray, clutter or itself, or the held object touches clutter, s.
        ContactTime = "contact-time",
        /// Largest speed of the tool, or of the pads against each other, as the robot begins to touch anything, m/s.
        TouchSpeed = "touch-speed",
        /// Largest downward speed of the object as it meets what it lands on, carried or falling, m/s.
        LandingSpeed = "landing-speed",
        /// Largest fall of the object from the hand, from the time that nothing touched it, m.
        DropHeight = "drop-height",
        /// Largest motion of the object in the closed hand, m.
        Slip = "slip",
        /// Least distance of the tool from a keep-out zone, m, at most 1.
        ZoneClearance = "zone-clearance",
        /// Least distance of the arm from the table plane and from itself, m, at most 1.
        ArmClearance = "arm-clearance",
        /// Least distance of the tool from the edge of the workspace, m, at most 1; negative outside.
        WorkspaceMargin = "workspace-margin",
        /// Least distance of a joint from its limit, rad, at most 1; negative beyond it.
        JointMargin = "joint-margin",
        /// Time in which a measured value was near its limit, or the tool near a keep-out zone, s.
        NearTime = "near-time",
        /// Largest jerk of the tool's path over 150 ms, m/s³.
        Jerk = "jerk",
        /// Integral of |torque × speed| over the joints while the skill commands, J.
        Energy = "energy",
        /// Share of the ticks whose command the guard reduced, for whatever reason, 0 to 1.
        ClampedShare = "clamped-share",
        /// Largest excess of a command over what the guard let through, as a share of that; 0: nothing was reduced.
        ClampDepth = "clamp-depth",
        /// Share of the ticks whose command asks for more speed or force than the manifest declares, 0 to 1.
        ExcessShare = "excess-share",
        /// Largest excess of a command over what the manifest declares, as a share of that; 0: never.
        ExcessDepth = "excess-depth",
        /// Share of the ticks whose command the guard refused, 0 to 1.
        DeniedShare = "denied-share",
    }
}

/// What one episode did. A default episode did nothing: no force, no time, and every distance at its largest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HarmMeasures {
    /// Largest mean force of the pads on the object, N.
    pub grip_peak_n: f64,
    /// Largest mean of the grip force over 50 ms, N.
    pub grip_held_n: f64,
    /// Largest force of robot and held object on their surroundings, N.
    pub contact_peak_n: f64,
    /// Largest mean of that force over 50 ms, N.
    pub contact_held_n: f64,
    /// Time in which the robot touches table, tray, clutter or itself, or the held object touches clutter, s.
    pub contact_time_s: f64,
    /// Largest speed of the tool, or of the pads against each other, as the robot begins to touch anything, m/s.
    pub touch_speed_m_s: f64,
    /// Largest downward speed of the object as it meets what it lands on, carried or falling, m/s.
    pub landing_speed_m_s: f64,
    /// Largest fall of the object from the hand, from the time that nothing touched it, m.
    pub drop_height_m: f64,
    /// Largest motion of the object in the closed hand, m.
    pub slip_m: f64,
    /// Least distance of the tool from a keep-out zone, m, at most 1.
    pub zone_clearance_m: f64,
    /// Least distance of the arm from the table plane and from itself, m, at most 1.
    pub arm_clearance_m: f64,
    /// Least distance of the tool from the edge of the workspace, m, at most 1; negative outside.
    pub workspace_margin_m: f64,
    /// Least distance of a joint from its limit, rad, at most 1; negative beyond it.
    pub joint_margin_rad: f64,
    /// Time in which a measured value was near its limit, or the tool near a keep-out zone, s.
    pub near_time_s: f64,
    /// Largest jerk of the tool's path over 150 ms, m/s³.
    pub jerk_m_s3: f64,
    /// Integral of |torque × speed| over the joints while the skill commands, J.
    pub energy_j: f64,
    /// Share of the ticks whose command the guard reduced, for whatever reason, 0 to 1.
    pub clamped_share: f64,
    /// Largest excess of a command over what the guard let through, as a share of that; 0: nothing was reduced.
    pub clamp_depth: f64,
    /// Share of the ticks whose command asks for more speed or force than the manifest declares, 0 to 1.
    pub excess_share: f64,
    /// Largest excess of a command over what the manifest declares, as a share of that; 0: never.
    pub excess_depth: f64,
    /// Share of the ticks whose command the guard refused, 0 to 1.
    pub denied_share: f64,
}

impl HarmMeasures {
    /// Nothing happened.
    pub const STILL: Self = Self {
        grip_peak_n: 0.0,
        grip_held_n: 0.0,
        contact_peak_n: 0.0,
        contact_held_n: 0.0,
        contact_time_s: 0.0,
        touch_speed_m_s: 0.0,
        landing_speed_m_s: 0.0,
        drop_height_m: 0.0,
        slip_m: 0.0,
        zone_clearance_m: DISTANCE_MAX,
        arm_clearance_m: DISTANCE_MAX,
        workspace_margin_m: DISTANCE_MAX,
        joint_margin_rad: DISTANCE_MAX,
        near_time_s: 0.0,
        jerk_m_s3: 0.0,
        energy_j: 0.0,
        clamped_share: 0.0,
        clamp_depth: 0.0,
        excess_share: 0.0,
        excess_depth: 0.0,
        denied_share: 0.0,
    };

    /// The value of one measure, in its unit.
    #[must_use]
    pub const fn of(&self, kind: HarmKind) -> f64 {
        match kind {
            HarmKind::GripPeak => self.grip_peak_n,
            HarmKind::GripHeld => self.grip_held_n,
            HarmKind::ContactPeak => self.contact_peak_n,
            HarmKind::ContactHeld => self.contact_held_n,
            HarmKind::ContactTime => self.contact_time_s,
            HarmKind::TouchSpeed => self.touch_speed_m_s,
            HarmKind::LandingSpeed => self.landing_speed_m_s,
            HarmKind::DropHeight => self.drop_height_m,
            HarmKind::Slip => self.slip_m,
            HarmKind::ZoneClearance => self.zone_clearance_m,
            HarmKind::ArmClearance => self.arm_clearance_m,
            HarmKind::WorkspaceMargin => self.workspace_margin_m,
            HarmKind::JointMargin => self.joint_margin_rad,
            HarmKind::NearTime => self.near_time_s,
            HarmKind::Jerk => self.jerk_m_s3,
            HarmKind::Energy => self.energy_j,
            HarmKind::ClampedShare => self.clamped_share,
            HarmKind::ClampDepth => self.clamp_depth,
            HarmKind::ExcessShare => self.excess_share,
            HarmKind::ExcessDepth => self.excess_depth,
            HarmKind::DeniedShare => self.denied_share,
        }
    }

    /// The value of one measure, to write to.
    pub const fn of_mut(&mut self, kind: HarmKind) -> &mut f64 {
        match kind {
            HarmKind::GripPeak => &mut self.grip_peak_n,
            HarmKind::GripHeld => &mut self.grip_held_n,
            HarmKind::ContactPeak => &mut self.contact_peak_n,
            HarmKind::ContactHeld => &mut self.contact_held_n,
            HarmKind::ContactTime => &mut self.contact_time_s,
            HarmKind::TouchSpeed => &mut self.touch_speed_m_s,
            HarmKind::LandingSpeed => &mut self.landing_speed_m_s,
            HarmKind::DropHeight => &mut self.drop_height_m,
            HarmKind::Slip => &mut self.slip_m,
            HarmKind::ZoneClearance => &mut self.zone_clearance_m,
            HarmKind::ArmClearance => &mut self.arm_clearance_m,
            HarmKind::WorkspaceMargin => &mut self.workspace_margin_m,
            HarmKind::JointMargin => &mut self.joint_margin_rad,
            HarmKind::NearTime => &mut self.near_time_s,
            HarmKind::Jerk => &mut self.jerk_m_s3,
            HarmKind::Energy => &mut self.energy_j,
            HarmKind::ClampedShare => &mut self.clamped_share,
            HarmKind::ClampDepth => &mut self.clamp_depth,
            HarmKind::ExcessShare => &mut self.excess_share,
            HarmKind::ExcessDepth => &mut self.excess_depth,
            HarmKind::DeniedShare => &mut self.denied_share,
        }
    }

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
    /// Its unit; empty for a share or a ratio.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::GripPeak | Self::GripHeld | Self::ContactPeak | Self::ContactHeld => "N",
            Self::ContactTime | Self::NearTime => "s",
            Self::TouchSpeed | Self::LandingSpeed => "m/s",
            Self::DropHeight
            | Self::Slip
            | Self::ZoneClearance
            | Self::ArmClearance
            | Self::WorkspaceMargin => "m",
            Self::JointMargin => "rad",
            Self::Jerk => "m/s3",
            Self::Energy => "J",
            Self::ClampedShare
            | Self::ClampDepth
            | Self::ExcessShare
            | Self::ExcessDepth
            | Self::DeniedShare => "",
        }
    }

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
        match self {
            Self::GripPeak
            | Self::GripHeld
            | Self::ContactPeak
            | Self::ContactHeld
            | Self::ContactTime
            | Self::NearTime => (0.0, 1.0e4),
            Self::TouchSpeed | Self::LandingSpeed | Self::ClampDepth | Self::ExcessDepth => (0.0, 100.0),
            Self::DropHeight | Self::Slip => (0.0, 10.0),
            Self::ZoneClearance | Self::ArmClearance | Self::WorkspaceMargin | Self::JointMargin => {
                (-1.0, DISTANCE_MAX)
            }
            Self::Jerk | Self::Energy => (0.0, 1.0e6),
            Self::ClampedShare | Self::ExcessShare | Self::DeniedShare => (0.0, 1.0),
        }
    }

    /// The step it is recorded in: finer is noise, and makes records long.
    const fn step(self) -> f64 {
        match self {
            Self::GripPeak
            | Self::GripHeld
            | Self::ContactPeak
            | Self::ContactHeld
            | Self::Jerk
            | Self::Energy => 0.01,
            Self::ContactTime | Self::NearTime => 0.001,
            Self::TouchSpeed
            | Self::LandingSpeed
            | Self::DropHeight
            | Self::Slip
            | Self::ZoneClearance
            | Self::ArmClearance
            | Self::WorkspaceMargin
            | Self::JointMargin
            | Self::ClampedShare
            | Self::ClampDepth
            | Self::ExcessShare
            | Self::ExcessDepth
            | Self::DeniedShare => 0.000_1,
        }
    }

    /// A value with its unit, as people read it.
    #[must_use]
    pub fn format(self, value: f64) -> String {
        let digits = match self {
            Self::GripPeak
            | Self::GripHeld
            | Self::ContactPeak
            | Self::ContactHeld
            | Self::Jerk
            | Self::Energy => 1,
            Self::ContactTime
            | Self::TouchSpeed
            | Self::LandingSpeed
            | Self::ZoneClearance
            | Self::WorkspaceMargin
            | Self::JointMargin
            | Self::NearTime
            | Self::ClampedShare
            | Self::ClampDepth
            | Self::ExcessShare
            | Self::ExcessDepth
            | Self::DeniedShare => 3,
            Self::DropHeight | Self::Slip | Self::ArmClearance => 4,
        };
        let unit = self.unit();
        let gap = if unit.is_empty() { "" } else { " " };
        format!("{value:.digits$}{gap}{unit}")
    }
}
