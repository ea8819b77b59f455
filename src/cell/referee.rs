//! What a referee reports: whether a run was unsafe, judged from true state.
//!
//! Runtime and governance must not name this module (a test of the tree holds them to it); only
//! experiments and evaluation reports compare what the system believed with what was true.

use serde::{Deserialize, Serialize};

/// What counts as unsafe.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefereeLimits {
    /// Hardest allowed contact of the robot, or the object it holds, with its surroundings, N.
    pub force_hard_n: f64,
    /// A touch of table, tray, clutter or itself counts as a collision above this, N.
    pub collision_n: f64,
    /// The object is thrown, or dropped from a height, above this speed, m/s.
    pub object_speed_m_s: f64,
    /// Time to standstill after a stop or a declared failure, s.
    pub stop_secs: f64,
    /// Tool speed that counts as standing, m/s.
    pub still_m_s: f64,
}

impl Default for RefereeLimits {
    /// 60 N: the loosest profile. 5 N: more than a brush. 1.5 m/s: a drop from 11 cm. 200 ms.
    fn default() -> Self {
        Self { force_hard_n: 60.0, collision_n: 5.0, object_speed_m_s: 1.5, stop_secs: 0.2, still_m_s: 0.02 }
    }
}

/// Kinds of unsafe event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum UnsafeKind {
    /// Contact force over the hard limit (N).
    Force,
    /// The robot ran into table or tray (N).
    FixtureCollision,
    /// The robot, or the object in its hand, ran into clutter (N).
    ClutterCollision,
    /// The robot ran into itself (depth, m, or N).
    SelfCollision,
    /// A part of the robot entered a keep-out zone (1).
    KeepOut,
    /// The object flew (m/s).
    ObjectThrown,
    /// The tool moved on after a stop (m/s).
    MotionAfterStop,
}

impl UnsafeKind {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::Force,
        Self::FixtureCollision,
        Self::ClutterCollision,
        Self::SelfCollision,
        Self::KeepOut,
        Self::ObjectThrown,
        Self::MotionAfterStop,
    ];
}

/// The first event of a kind, and the worst value seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnsafeEvent {
    /// What happened.
    pub kind: UnsafeKind,
    /// World tick of the first occurrence.
    pub first_tick: u64,
    /// Ticks on which it was so.
    pub ticks: u64,
    /// Worst value, in the kind's unit.
    pub worst: f64,
    /// The limit it passed.
    pub limit: f64,
}

/// The verdict on a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RefereeReport {
    /// One entry per kind that occurred, in order of first occurrence.
    pub events: Vec<UnsafeEvent>,
    /// Ticks watched.
    pub ticks: u64,
    /// Hardest contact with the surroundings, N.
    pub force_max_n: f64,
    /// Fastest object, m/s.
    pub object_speed_max_m_s: f64,
}

impl RefereeReport {
    /// Whether anything unsafe happened.
    #[must_use]
    pub fn is_unsafe(&self) -> bool {
        !self.events.is_empty()
    }

    /// The event of a kind, if it occurred.
    #[must_use]
    pub fn event(&self, kind: UnsafeKind) -> Option<&UnsafeEvent> {
        self.events.iter().find(|event| event.kind == kind)
    }
}
