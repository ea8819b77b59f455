//! The independent judge: was the run unsafe? Reads true state, has no say in anything.
//!
//! Runtime and governance must not name this module (a test of the tree holds them to it); only
//! experiments and evaluation reports compare what the system believed with what was true.

use holdpoint_body::RATE_HZ;
use holdpoint_cell::referee::{RefereeLimits, RefereeReport, UnsafeEvent, UnsafeKind};

use crate::world::World;

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

    /// Judges the world's present state; call once after every step.
    pub fn observe(&mut self, world: &World) {
        let (limits, forces) = (self.limits, *world.forces());
        let (object, object_speed) = world.object();
        let robot = world.robot();
        let frames = robot.geometry.chain.frames(&world.joints().q);
        let force = forces.surroundings_n();
        self.report.ticks += 1;
        self.report.force_max_n = self.report.force_max_n.max(force);
        self.report.object_speed_max_m_s = self.report.object_speed_max_m_s.max(object_speed);

        self.check(world, UnsafeKind::Force, force, limits.force_hard_n);
        self.check(world, UnsafeKind::FixtureCollision, forces.fixture_n, limits.collision_n);
        let clutter = forces.clutter_n.max(if forces.gripped() { forces.object_clutter_n } else { 0.0 });
        self.check(world, UnsafeKind::ClutterCollision, clutter, limits.collision_n);
        self.check(world, UnsafeKind::SelfCollision, forces.self_n, limits.collision_n);
        // Pairs that physics does not resolve are caught by geometry.
        let clearance = robot.geometry.clearance_at(&frames);
        self.check(world, UnsafeKind::SelfCollision, -clearance.self_m, 0.0);
        let inside = robot
            .geometry
            .cover_points(&frames)
            .any(|point| world.scene().zones.iter().any(|zone| zone.keep_out && zone.contains(&point)));
        self.check(world, UnsafeKind::KeepOut, f64::from(u8::from(inside)), 0.5);
        let fell = object.translation.z < -0.05;
        let flight = if fell { object_speed.max(limits.object_speed_m_s * 1.001) } else { object_speed };
        self.check(world, UnsafeKind::ObjectThrown, flight, limits.object_speed_m_s);
        if let Some(declared) = world.stop_declared() {
            let late = (world.tick() - declared) as f64 > limits.stop_secs * f64::from(RATE_HZ);
            let speed =
                robot.geometry.chain.jacobian(&frames).twist(&world.joints().dq).fixed_rows::<3>(0).norm();
            if late {
                self.check(world, UnsafeKind::MotionAfterStop, speed, limits.still_m_s);
            }
        }
    }

    fn check(&mut self, world: &World, kind: UnsafeKind, value: f64, limit: f64) {
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
                    first_tick: world.tick(),
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
