//! The policy guard: every command passes it, and every tick is measured against the envelope.
//!
//! It stands outside the skill and reads the table that was compiled when the policies were
//! loaded; a mode that no policy determines is denied. It limits speed, force and reach by
//! clamping, and refuses what would leave the workspace, enter the keep-out zone, or is predicted
//! to strike the table or the arm itself. What a sensor tells past a limit is a violation even
//! if every command was within it.

use std::sync::Arc;

use holdpoint_body::{Command, Geometry, GuardVerdict, JointVec, Telemetry, zone};

use super::grant::Grant;
use super::limits::Envelope;
use holdpoint_governance::mode::{Authority, CommandKind, ModeKey, ZoneName};
use holdpoint_governance::permission::PermissionsUsed;
use holdpoint_governance::policy::{ModeRuling, PolicyTable};
pub use holdpoint_governance::policy_hit::PolicyHit;
use holdpoint_governance::profile::{Profile, RuntimeLimits};

/// What became of a command.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedCommand {
    /// What the robot is given.
    pub command: Command,
    /// The answer to the skill.
    pub verdict: GuardVerdict,
    /// Why, if it was not passed unchanged.
    pub hit: Option<PolicyHit>,
}

/// The least predicted loss of clearance that counts as a motion toward contact, m.
const CLEARANCE_LOSS_M: f64 = 1e-4;

/// A component of a line below this, m, counts as 0: the line is parallel to a face of the box.
const PARALLEL_M: f64 = 1e-12;

/// Guards one arm for one version.
#[derive(Clone)]
pub struct Guard {
    table: Arc<PolicyTable>,
    profile: Arc<Profile>,
    envelope: Envelope,
    authority: Authority,
    grant: Option<Grant>,
    geometry: Arc<Geometry>,
    zones: Arc<[zone::Zone]>,
    /// People have approved what a policy wants reviewed.
    reviewed: bool,
    /// The name of each of the `zones` for policies and manifests; absent for one that no text can name.
    names: Arc<[Option<ZoneName>]>,
    speed_over_ticks: u32,
    force_over_ticks: u32,
    transient_over_ticks: u32,
    /// Distance of the arm from the table and from itself when it was last looked at, m.
    clearance_seen_m: f64,
}

impl Guard {
    /// A guard over a compiled table, its profile, an envelope and the authority the version was granted. It asks no
    /// manifest: what the runtime itself moves is declared by none.
    #[must_use]
    pub fn new(
        table: Arc<PolicyTable>,
        profile: Arc<Profile>,
        envelope: Envelope,
        authority: Authority,
        geometry: Arc<Geometry>,
        zones: Arc<[zone::Zone]>,
    ) -> Self {
        Self {
            table,
            profile,
            envelope,
            authority,
            grant: None,
            geometry,
            names: zones.iter().map(|zone| ZoneName::try_from(zone.name.as_str()).ok()).collect(),
            zones,
            reviewed: false,
            speed_over_ticks: 0,
            force_over_ticks: 0,
            transient_over_ticks: 0,
            clearance_seen_m: f64::INFINITY,
        }
    }

    /// The same guard for a version that people have approved, or that is evaluated in simulation for them to decide.
    #[must_use]
    pub const fn reviewed(mut self, reviewed: bool) -> Self {
        self.reviewed = reviewed;
        self
    }

    /// The same guard, which lets through nothing but what is granted.
    #[must_use]
    pub fn granting(self, grant: Grant) -> Self {
        Self { grant: Some(grant), ..self }
    }

    /// What was used of the permissions so far; nothing if the guard asks no manifest.
    #[must_use]
    pub fn used(&self) -> PermissionsUsed {
        self.grant.as_ref().map(Grant::used).unwrap_or_default()
    }

    /// Whether more ticks or commands were used than are declared.
    #[must_use]
    pub fn is_overdrawn(&self) -> bool {
        self.grant.as_ref().is_some_and(Grant::is_overdrawn)
    }

    /// The envelope in force.
    #[must_use]
    pub const fn envelope(&self) -> &Envelope {
        &self.envelope
    }

    /// The limits of the profile, before any cap.
    #[must_use]
    pub fn limits(&self) -> &RuntimeLimits {
        &self.profile.runtime
    }

    /// The robot's kinematics.
    #[must_use]
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Where the tool must not be.
    pub fn keep_out_zones(&self) -> impl Iterator<Item = &zone::Zone> {
        self.zones.iter().filter(|zone| zone.keep_out)
    }

    /// By what share a command asks for more speed or force than the manifest declares; 0 if it does not, and for a
    /// guard that asks no manifest.
    #[must_use]
    pub fn excess_over_declared(&self, command: &Command) -> f64 {
        self.grant.as_ref().map_or(0.0, |grant| grant.excess(command))
    }

    /// Distance of the arm from the table and from itself when a collision was last looked for, m; infinite before.
    #[must_use]
    pub const fn clearance_seen_m(&self) -> f64 {
        self.clearance_seen_m
    }

    /// Passes, clamps or denies one command. A denied command becomes [`Command::Stop`].
    #[must_use]
    pub fn check(&mut self, command: &Command, seen: &Telemetry) -> CheckedCommand {
        if let Some(grant) = &mut self.grant {
            grant.note_command(command);
        }
        match self.judge(command, seen) {
            Ok((command, None)) => CheckedCommand { command, verdict: GuardVerdict::Allowed, hit: None },
            Ok((command, Some(hit))) => {
                CheckedCommand { command, verdict: GuardVerdict::Clamped, hit: Some(hit) }
            }
            Err(hit) => {
                CheckedCommand { command: Command::Stop, verdict: GuardVerdict::Denied, hit: Some(hit) }
            }
        }
    }

    fn judge(
        &mut self,
        command: &Command,
        seen: &Telemetry,
    ) -> Result<(Command, Option<PolicyHit>), PolicyHit> {
        let Some((channel, kind)) = CommandKind::of(command) else {
            return Ok((command.clone(), None));
        };
        let target = self.target_of(command, seen)?;
        let zone = self.zone_of(target).ok_or(PolicyHit::OutsideWorkspace)?;
        let cap = self.mode_cap(ModeKey { channel, command: kind, zone, authority: self.authority })?;
        if let Some(hit) = self.grant.as_mut().and_then(|grant| grant.refuses(kind, zone)) {
            return Err(hit);
        }
        match command {
            Command::ToolPose { pose, max_speed_m_s } => {
                if !(pose.is_valid() && *max_speed_m_s > 0.0 && max_speed_m_s.is_finite()) {
                    return Err(PolicyHit::NotFinite);
                }
                let start = seen.tool.position;
                let is_entered =
                    |zone: &zone::Zone| segment_enters(zone.min_m, zone.max_m, start, pose.position);
                if self.human_zones().any(is_entered) {
                    return Err(PolicyHit::KeepOut);
                }
                let limit = self.limits().clamp_share * cap.tool_speed_max_m_s;
                let speed = max_speed_m_s.min(limit);
                let hit = (*max_speed_m_s > limit).then_some(PolicyHit::SpeedClamped);
                Ok((Command::ToolPose { pose: *pose, max_speed_m_s: speed }, hit))
            }
            Command::Joints { q, max_speed_rad_s } => {
                let finite =
                    q.iter().all(|v| v.is_finite()) && *max_speed_rad_s > 0.0 && max_speed_rad_s.is_finite();
                if !finite || q.len() != self.geometry.joint_count() {
                    return Err(PolicyHit::NotFinite);
                }
                let limit = self.limits().clamp_share * cap.joint_speed_max_rad_s;
                let speed = max_speed_rad_s.min(limit);
                let hit = (*max_speed_rad_s > limit).then_some(PolicyHit::SpeedClamped);
                Ok((Command::Joints { q: q.clone(), max_speed_rad_s: speed }, hit))
            }
            Command::Gripper { width_m, speed_m_s, force_n } => {
                let finite = [*width_m, *speed_m_s, *force_n].iter().all(|v| v.is_finite() && *v >= 0.0);
                if !finite || *speed_m_s <= 0.0 {
                    return Err(PolicyHit::NotFinite);
                }
                let limit = self.limits().clamp_share * cap.grip_force_max_n;
                let force = force_n.min(limit);
                let hit = (*force_n > limit).then_some(PolicyHit::ForceClamped);
                Ok((Command::Gripper { width_m: *width_m, speed_m_s: *speed_m_s, force_n: force }, hit))
            }
            Command::Stop | Command::Hold | Command::Done | Command::Fail { .. } => {
                Ok((command.clone(), None))
            }
        }
    }

    /// The envelope a mode may use.
    fn mode_cap(&self, mode: ModeKey) -> Result<Envelope, PolicyHit> {
        match self.table.verdict(&mode) {
            ModeRuling::Allow => Ok(self.envelope),
            ModeRuling::AllowTighter(cap) => Ok(self.envelope.capped(cap.speed_max_m_s, cap.force_max_n)),
            ModeRuling::Review if self.reviewed => Ok(self.envelope),
            ModeRuling::Review => Err(PolicyHit::ModeUnreviewed),
            ModeRuling::Forbid => Err(PolicyHit::ModeForbidden),
            ModeRuling::Uncovered => Err(PolicyHit::ModeUncovered),
        }
    }

    /// Where a command leads the tool; commands that do not move it act where it is.
    fn target_of(&self, command: &Command, seen: &Telemetry) -> Result<[f64; 3], PolicyHit> {
        let target = match command {
            Command::ToolPose { pose, .. } => pose.position,
            Command::Joints { q, .. }
                if q.len() == self.geometry.joint_count() && q.iter().all(|v| v.is_finite()) =>
            {
                self.geometry.tool_pose(q).translation.vector.into()
            }
            Command::Joints { .. } => return Err(PolicyHit::NotFinite),
            _ => seen.tool.position,
        };
        if target.iter().any(|v| !v.is_finite()) {
            return Err(PolicyHit::NotFinite);
        }
        let e = &self.envelope;
        let inside = (0..3).all(|i| (e.workspace_min_m[i]..=e.workspace_max_m[i]).contains(&target[i]));
        let moves = matches!(command, Command::ToolPose { .. } | Command::Joints { .. });
        if moves && !inside {
            return Err(PolicyHit::OutsideWorkspace);
        }
        Ok(target)
    }

    /// The zones that policies know as the one of a person: the keep-out zones, and a zone of that name.
    fn human_zones(&self) -> impl Iterator<Item = &zone::Zone> {
        self.zones.iter().filter(|zone| zone.keep_out || zone.name == ZoneName::Human.name())
    }

    /// The zone a point lies in: the first that contains it, but a person's zone before any other.
    fn zone_of(&self, point: [f64; 3]) -> Option<ZoneName> {
        if self.human_zones().any(|bounds| bounds.contains(&point)) {
            return Some(ZoneName::Human);
        }
        let mut named = self.zones.iter().zip(self.names.iter()).filter(|(_, name)| name.is_some());
        named.find(|(bounds, _)| bounds.contains(&point)).and_then(|(_, name)| *name)
    }

    /// Holds one tick of telemetry against the envelope and the declared zones. Speed has to be over its limit for three
    /// ticks, a force for the profile's `transient_max_s`, or for two ticks over its `transient_factor` times the limit.
    pub fn measure(&mut self, seen: &Telemetry) -> Option<PolicyHit> {
        let zone = self.zone_of(seen.tool.position);
        let entered = self.grant.as_mut().and_then(|grant| grant.measure(seen, zone));
        let e = &self.envelope;
        let RuntimeLimits { measure_share, transient_factor, transient_max_s, .. } = *self.limits();
        let count = |over: bool, ticks: u32| if over { ticks.saturating_add(1) } else { 0 };
        // Written so that a value that is no number counts as over the limit.
        let fast = !(seen.tool_speed_m_s <= measure_share * e.tool_speed_max_m_s);
        let force = seen.contact_force_n.max(seen.gripper_force_n);
        let over = |factor: f64| {
            !(force <= factor * measure_share * e.contact_force_max_n) || seen.contact_force_n.is_nan()
        };
        self.speed_over_ticks = count(fast, self.speed_over_ticks);
        self.force_over_ticks = count(over(1.0), self.force_over_ticks);
        self.transient_over_ticks = count(over(transient_factor), self.transient_over_ticks);
        if self.force_over_ticks == RuntimeLimits::ticks(transient_max_s) || self.transient_over_ticks == 2 {
            return Some(PolicyHit::ForceMeasured);
        }
        if self.speed_over_ticks == 3 { Some(PolicyHit::SpeedMeasured) } else { entered }
    }

    /// Whether a measured value is within the margin below its limit, or the tool within that of a keep-out zone.
    #[must_use]
    pub fn is_near(&self, seen: &Telemetry) -> bool {
        let e = &self.envelope;
        seen.tool_speed_m_s > e.near_share * e.tool_speed_max_m_s
            || seen.contact_force_n.max(seen.gripper_force_n) > e.near_share * e.contact_force_max_n
            || self
                .zones
                .iter()
                .any(|zone| zone.keep_out && is_beside(zone, seen.tool.position, e.near_zone_m))
    }

    /// Whether going on as now for the profile's `look_ahead_s` would strike the table or the arm itself.
    #[must_use]
    pub fn predicts_collision(&mut self, seen: &Telemetry) -> bool {
        let ahead_s = self.limits().look_ahead_s;
        let ahead: JointVec = seen.q.iter().zip(&seen.dq).map(|(q, dq)| q + ahead_s * dq).collect();
        let now = self.geometry.clearance(&seen.q);
        let then = self.geometry.clearance(&ahead);
        self.clearance_seen_m = now.table_m.min(now.self_m);
        // A motion that leads away from contact is never refused.
        (then.table_m < 0.0 && then.table_m < now.table_m - CLEARANCE_LOSS_M)
            || (then.self_m < 0.0 && then.self_m < now.self_m - CLEARANCE_LOSS_M)
    }
}

/// Whether a point lies in a box or at most `margin_m` from it, along each axis.
fn is_beside(zone: &zone::Zone, point: [f64; 3], margin_m: f64) -> bool {
    (0..3).all(|i| (zone.min_m[i] - margin_m..=zone.max_m[i] + margin_m).contains(&point[i]))
}

/// Whether the straight line from `a` to `b` meets an axis-aligned box (slab test).
fn segment_enters(min: [f64; 3], max: [f64; 3], a: [f64; 3], b: [f64; 3]) -> bool {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for i in 0..3 {
        let along = b[i] - a[i];
        if along.abs() < PARALLEL_M {
            if a[i] < min[i] || a[i] > max[i] {
                return false;
            }
            continue;
        }
        let (s, t) = ((min[i] - a[i]) / along, (max[i] - a[i]) / along);
        enter = enter.max(s.min(t));
        leave = leave.min(s.max(t));
    }
    enter <= leave
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mode that a policy wants reviewed is denied until people have approved the version, and then passed.
    #[test]
    fn approved_review_permits_the_reviewed_mode() {
        use holdpoint_body::{Body, Pose};
        use holdpoint_governance::profile::{Profile, ProfileName};
        let profile = Profile::builtin(ProfileName::Human).unwrap();
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let model = holdpoint_sim::RobotModel::builtin("arm7").unwrap();
        let scene = holdpoint_sim::published::scene().unwrap();
        let seen = Body::telemetry(&holdpoint_sim::world::World::new(&model, &scene).unwrap());
        let zones: Arc<[zone::Zone]> = scene.zones.into();
        let transit = zone::named(&zones, ZoneName::Transit.name()).unwrap();
        let position = std::array::from_fn(|i| f64::midpoint(transit.min_m[i], transit.max_m[i]));
        let command = Command::ToolPose { pose: Pose { position, ..seen.tool }, max_speed_m_s: 0.1 };
        let geometry = Arc::new(model.geometry);
        let guard = |authority: u8| {
            crate::terms::SkillTerms::new(&profile, table.clone(), geometry.clone(), zones.clone())
                .own_guard(Authority::try_from(authority).unwrap())
        };
        assert_eq!(guard(1).check(&command, &seen).verdict, GuardVerdict::Allowed);
        let denied = guard(2).check(&command, &seen);
        assert_eq!((denied.verdict, denied.hit), (GuardVerdict::Denied, Some(PolicyHit::ModeUnreviewed)));
        assert_eq!(guard(2).reviewed(true).check(&command, &seen).verdict, GuardVerdict::Allowed);
        // What a policy forbids stays forbidden despite any approval.
        let forbidden = guard(3).reviewed(true).check(&command, &seen);
        assert_eq!(forbidden.hit, Some(PolicyHit::ModeForbidden));
    }

    /// A cell names its zones itself.
    #[test]
    fn keep_out_zone_counts_under_any_name() {
        use holdpoint_body::{Body, Pose};
        use holdpoint_governance::profile::{Profile, ProfileName};
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let model = holdpoint_sim::RobotModel::builtin("arm7").unwrap();
        let scene = holdpoint_sim::published::scene().unwrap();
        let seen = Body::telemetry(&holdpoint_sim::world::World::new(&model, &scene).unwrap());
        let geometry = Arc::new(model.geometry);
        let [x, y, z] = seen.tool.position;
        let hit = |keep_out: bool, ahead_m: f64| {
            let press = zone::Zone {
                name: "press".to_owned(),
                min_m: [x + 0.05, y - 0.05, z - 0.05],
                max_m: [x + 0.1, y + 0.05, z + 0.05],
                keep_out,
            };
            let zones: Arc<[zone::Zone]> = scene.zones.iter().cloned().chain([press]).collect();
            let pose = Pose { position: [x + ahead_m, y, z], ..seen.tool };
            let command = Command::ToolPose { pose, max_speed_m_s: 0.1 };
            crate::terms::SkillTerms::new(&profile, table.clone(), geometry.clone(), zones)
                .own_guard(Authority::try_from(1).unwrap())
                .check(&command, &seen)
                .hit
        };
        assert_eq!([0.02, 0.07, 0.15].map(|ahead_m| hit(false, ahead_m)), [None, None, None]);
        assert_eq!(hit(true, 0.02), None);
        assert!(hit(true, 0.07).is_some(), "it ends inside");
        assert_eq!(hit(true, 0.15), Some(PolicyHit::KeepOut), "it passes through");
    }

    /// Policies name the zones of the cell. The first zone that contains a point counts.
    #[test]
    fn zone_of_the_cell_needs_a_policy_that_names_it() {
        use holdpoint_body::{Body, Pose};
        use holdpoint_governance::policy::PolicySource;
        use holdpoint_governance::profile::{Profile, ProfileName};
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let (file, shipped) = Profile::builtin_policy(ProfileName::Sim);
        let press = "permit (principal, action == Action::\"tool-pose\", resource == Zone::\"press\");";
        let model = holdpoint_sim::RobotModel::builtin("arm7").unwrap();
        let scene = holdpoint_sim::published::scene().unwrap();
        let seen = Body::telemetry(&holdpoint_sim::world::World::new(&model, &scene).unwrap());
        let geometry = Arc::new(model.geometry);
        let [x, y, z] = seen.tool.position;
        let bounds = zone::Zone {
            name: "press".to_owned(),
            min_m: [x - 0.1, y - 0.1, z - 0.1],
            max_m: [x + 0.1, y + 0.1, z + 0.1],
            keep_out: false,
        };
        let zones: Arc<[zone::Zone]> = [bounds].into_iter().chain(scene.zones).collect();
        let command =
            Command::ToolPose { pose: Pose { position: [x + 0.02, y, z], ..seen.tool }, max_speed_m_s: 0.1 };
        let hit = |text: &str| {
            let table = PolicyTable::compile(&profile, &[PolicySource { file, text }]).unwrap();
            crate::terms::SkillTerms::new(&profile, Arc::new(table), geometry.clone(), zones.clone())
                .own_guard(Authority::try_from(1).unwrap())
                .check(&command, &seen)
                .hit
        };
        assert_eq!(hit(shipped), Some(PolicyHit::ModeUncovered));
        assert_eq!(hit(&format!("{shipped}\n{press}")), None);
    }

    #[test]
    fn force_above_its_limit_is_a_violation_once_it_lasts() {
        use holdpoint_body::Body;
        use holdpoint_governance::profile::{Profile, ProfileName};
        let model = holdpoint_sim::RobotModel::builtin("arm7").unwrap();
        let scene = holdpoint_sim::published::scene().unwrap();
        let mut seen = Body::telemetry(&holdpoint_sim::world::World::new(&model, &scene).unwrap());
        let (geometry, zones) = (Arc::new(model.geometry), Arc::<[zone::Zone]>::from(scene.zones));
        for (transient_max_s, ticks) in [(0.05, 12), (0.1, 24)] {
            let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
            profile.runtime.transient_max_s = transient_max_s;
            seen.contact_force_n = 1.5 * profile.runtime.contact_force_max_n;
            let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
            let mut guard = crate::terms::SkillTerms::new(&profile, table, geometry.clone(), zones.clone())
                .own_guard(Authority::try_from(1).unwrap());
            let first = (1..100).find_map(|tick| Some((tick, guard.measure(&seen)?)));
            assert_eq!(first, Some((ticks, PolicyHit::ForceMeasured)));
        }
    }

    #[test]
    fn segment_entering_a_box_is_found() {
        let (min, max) = ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]);
        for (a, b, meets) in [
            ([-1.0, 0.5, 0.5], [2.0, 0.5, 0.5], true),
            ([-1.0, 0.5, 0.5], [-0.1, 0.5, 0.5], false),
            ([0.5, 0.5, 0.5], [0.6, 0.5, 0.5], true),
            ([-1.0, 2.0, 0.5], [2.0, 2.0, 0.5], false),
            ([-0.5, 0.6, 0.5], [0.6, -0.5, 0.5], true),
            ([-0.5, 0.4, 0.5], [0.4, -0.5, 0.5], false),
        ] {
            assert_eq!(segment_enters(min, max, a, b), meets, "{a:?} {b:?}");
        }
    }
}
