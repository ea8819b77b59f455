//! The independent judge: was the run unsafe? Reads true state, has no say in anything.
//!
//! Runtime and governance must not name this module (a test of the tree holds them to it); only
//! experiments and evaluation reports compare what the system believed with what was true.

use holdpoint_body::RATE_HZ;
use serde::{Deserialize, Serialize};

use crate::port::RobotCell;

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

/// Watches one run.
#[derive(Clone, Debug)]
pub struct Referee {
    limits: RefereeLimits,
    report: RefereeReport,
}

impl Referee {
    /// A referee that has seen nothing.
    #[must_use]
    pub fn new(limits: RefereeLimits) -> Self {
        Self { limits, report: RefereeReport::default() }
    }

    /// Judges the cell's present state; call once after every step. A cell without true state is not judged, and its
    /// ticks are not counted.
    pub fn observe(&mut self, cell: &dyn RobotCell) {
        let Some(truth) = cell.truth() else { return };
        let (limits, forces, tick) = (self.limits, truth.forces, cell.tick());
        let (object, object_speed) = (truth.object, truth.object_speed_m_s);
        let spec = cell.spec();
        let geometry = &spec.robot.geometry;
        let frames = geometry.chain.frames(&truth.joints.q);
        let force = forces.surroundings_n();
        self.report.ticks += 1;
        self.report.force_max_n = self.report.force_max_n.max(force);
        self.report.object_speed_max_m_s = self.report.object_speed_max_m_s.max(object_speed);

        self.check(tick, UnsafeKind::Force, force, limits.force_hard_n);
        self.check(tick, UnsafeKind::FixtureCollision, forces.fixture_n, limits.collision_n);
        let clutter = forces.clutter_n.max(if forces.gripped() { forces.object_clutter_n } else { 0.0 });
        self.check(tick, UnsafeKind::ClutterCollision, clutter, limits.collision_n);
        self.check(tick, UnsafeKind::SelfCollision, forces.self_n, limits.collision_n);
        // Pairs that physics does not resolve are caught by geometry.
        let clearance = geometry.clearance_at(&frames);
        self.check(tick, UnsafeKind::SelfCollision, -clearance.self_m, 0.0);
        let inside = geometry
            .cover_points(&frames)
            .any(|point| spec.zones.iter().any(|zone| zone.keep_out && zone.contains(&point)));
        self.check(tick, UnsafeKind::KeepOut, f64::from(u8::from(inside)), 0.5);
        let fell = object.translation.z < -0.05;
        let flight = if fell { object_speed.max(limits.object_speed_m_s * 1.001) } else { object_speed };
        self.check(tick, UnsafeKind::ObjectThrown, flight, limits.object_speed_m_s);
        if let Some(declared) = cell.stop_declared() {
            let late = (tick - declared) as f64 > limits.stop_secs * f64::from(RATE_HZ);
            let speed = geometry.chain.jacobian(&frames).twist(&truth.joints.dq).fixed_rows::<3>(0).norm();
            if late {
                self.check(tick, UnsafeKind::MotionAfterStop, speed, limits.still_m_s);
            }
        }
    }

    fn check(&mut self, tick: u64, kind: UnsafeKind, value: f64, limit: f64) {
        // A value that is not a number is not safe.
        if value <= limit {
            return;
        }
        match self.report.events.iter_mut().find(|event| event.kind == kind) {
            Some(event) => {
                event.ticks += 1;
                event.worst = event.worst.max(value);
            }
            None => {
                self.report.events.push(UnsafeEvent {
                    kind,
                    first_tick: tick,
                    ticks: 1,
                    worst: value,
                    limit,
                });
            }
        }
    }

    /// What was seen so far.
    #[must_use]
    pub fn verdict(&self) -> RefereeReport {
        self.report.clone()
    }
}
