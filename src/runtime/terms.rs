//! What a version runs under: guard, envelope and watcher limits, derived from the profile.

use std::sync::Arc;

use holdpoint_body::{Geometry, RATE_HZ, TaskKind, Zone};

use super::grant::Grant;
use super::guard::Guard;
use super::limits::{Envelope, WatchLimits};
use super::meter::{TickMeter, TimedSkill};
use super::seeds::{BundleSeed, SeedKey};
use super::skill::Skill;
use super::stress::Stress;
use super::task::TaskTerms;
use holdpoint_governance::manifest::Permissions;
use holdpoint_governance::mode::Authority;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::profile::fields::default_of;

/// The numbers by which a task runs that are not those of a profile that sets none; empty if all are.
fn changed_numbers(profile: &Profile) -> String {
    let (limits, watcher) = (&profile.runtime, &profile.watcher);
    let numbers = [
        ("runtime.look_ahead_s", limits.look_ahead_s),
        ("runtime.clamp_share", limits.clamp_share),
        ("runtime.transient_factor", limits.transient_factor),
        ("runtime.measure_share", limits.measure_share),
        ("runtime.interrupt_max_s", limits.interrupt_max_s),
        ("runtime.creep_max_m", limits.creep_max_m),
        ("runtime.transient_max_s", limits.transient_max_s),
        ("runtime.denied_max_s", limits.denied_max_s),
        ("watcher.moving_m_s", watcher.moving_m_s),
        ("watcher.idle_force_n", watcher.idle_force_n),
        ("watcher.closed_width_m", watcher.closed_width_m),
        ("watcher.width_step_m", watcher.width_step_m),
    ];
    let mut changed = String::new();
    for (path, value) in numbers {
        if default_of(path) != Some(value) {
            changed.push_str(&format!("|{path}={value:?}"));
        }
    }
    changed
}

/// The watcher's limits that every profile sets, in the text by which results on record are found again.
fn text_of_watch(limits: &WatchLimits) -> String {
    let WatchLimits { slip_max_m, tracking_max_rad, contact_noticed_n, .. } = limits;
    let WatchLimits { picture_age_max_ticks, grip_fault_ticks, overrun_ticks, .. } = limits;
    format!(
        "WatchLimits {{ slip_max_m: {slip_max_m:?}, tracking_max_rad: {tracking_max_rad:?}, \
         contact_noticed_n: {contact_noticed_n:?}, picture_age_max_ticks: {picture_age_max_ticks}, \
         grip_fault_ticks: {grip_fault_ticks}, overrun_ticks: {overrun_ticks} }}"
    )
}

/// Everything around a skill but the skill.
#[derive(Clone)]
pub struct SkillTerms {
    profile: Arc<Profile>,
    table: Arc<PolicyTable>,
    geometry: Arc<Geometry>,
    zones: Arc<[Zone]>,
    envelope: Envelope,
    watch: WatchLimits,
    limit_ticks: u64,
    meter: Option<Arc<TickMeter>>,
    stress: Option<Stress>,
    reviewed: bool,
    seeds: SeedKey,
    /// How fast a failure has to be named, ticks.
    pub detect_ticks: u64,
}

impl SkillTerms {
    /// The terms of a profile.
    #[must_use]
    pub fn new(
        profile: &Profile,
        table: Arc<PolicyTable>,
        geometry: Arc<Geometry>,
        zones: Arc<[Zone]>,
    ) -> Self {
        let runtime = &profile.runtime;
        let watcher = &profile.watcher;
        let ticks = |secs: f64| {
            // Profiles hold finite, bounded, non-negative times.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let ticks = libm::round(secs * f64::from(RATE_HZ)) as u64;
            ticks
        };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let continuation_ms = runtime.unsafe_continuation_max_ms as u64;
        let envelope = Envelope {
            tool_speed_max_m_s: runtime.tool_speed_max_m_s,
            joint_speed_max_rad_s: runtime.joint_speed_max_rad_s,
            grip_force_max_n: runtime.grip_force_max_n,
            contact_force_max_n: runtime.contact_force_max_n,
            unsafe_continuation_max_ms: continuation_ms,
            workspace_min_m: runtime.workspace_min_m,
            workspace_max_m: runtime.workspace_max_m,
            near_share: runtime.near_margin,
            near_zone_m: runtime.near_zone_m,
            retries_max: runtime.retries_max,
        };
        let limit_ticks = ticks(runtime.episode_max_s);
        let watch = WatchLimits {
            slip_max_m: watcher.slip_max_m,
            tracking_max_rad: watcher.tracking_error_max_rad,
            contact_noticed_n: watcher.contact_noticed_n,
            picture_age_max_ticks: u32::try_from(ticks(watcher.picture_age_max_ms / 1000.0))
                .unwrap_or(u32::MAX),
            // One second.
            grip_fault_ticks: RATE_HZ,
            overrun_ticks: limit_ticks,
            moving_m_s: watcher.moving_m_s,
            idle_force_n: watcher.idle_force_n,
            closed_width_m: watcher.closed_width_m,
            width_step_m: watcher.width_step_m,
        };
        let detect_ticks = ticks(watcher.detect_max_ms / 1000.0);
        let (meter, stress, reviewed, seeds) = (None, None, false, SeedKey::of_run(0));
        Self {
            profile: Arc::new(profile.clone()),
            table,
            geometry,
            zones,
            envelope,
            watch,
            limit_ticks,
            meter,
            stress,
            reviewed,
            seeds,
            detect_ticks,
        }
    }

    /// All that they have to do with how a task runs, in a text that differs wherever they differ.
    #[must_use]
    pub fn in_full(&self) -> String {
        let Self { table, envelope, watch, limit_ticks, stress, reviewed, seeds, detect_ticks, .. } = self;
        let (policy, seeds, numbers) = (table.digest, seeds.name(), changed_numbers(&self.profile));
        let watch = text_of_watch(watch);
        format!(
            "{policy}|{envelope:?}|{watch}|{limit_ticks}|{stress:?}|{reviewed}|{seeds}|{detect_ticks}{numbers}"
        )
    }

    /// The same terms on an arm that real time does not wait for: computing longer than `cpu_us_per_tick` counts.
    #[must_use]
    pub fn on_a_clock(mut self, cpu_us_per_tick: u32) -> Self {
        self.meter = Some(TickMeter::new(cpu_us_per_tick));
        self
    }

    /// A run as it is worked under these terms: timed where time counts.
    #[must_use]
    pub fn timed(&self, skill: Box<dyn Skill>) -> Box<dyn Skill> {
        match &self.meter {
            None => skill,
            Some(meter) => Box::new(TimedSkill { skill, meter: Arc::clone(meter) }),
        }
    }

    /// The same terms under stress: what the version needs is taken from it, or a person is where it works.
    #[must_use]
    pub fn stressed(mut self, stress: Stress) -> Self {
        match stress {
            Stress::Tightened { share } => self.envelope = self.envelope.tightened(share),
            Stress::Exposed { person } => {
                // The keep-out zone stands where the person does; the first of a name is the one that counts.
                let zones = self
                    .zones
                    .iter()
                    .map(|zone| if zone.keep_out { person.in_place_of(zone) } else { zone.clone() });
                self.zones = zones.collect();
            }
            Stress::Withdrawn { .. } => {}
        }
        self.stress = Some(stress);
        self
    }

    /// The same terms with a tighter envelope: `share` of speed and force, in (0, 1].
    #[must_use]
    pub fn tightened(mut self, share: f64) -> Self {
        self.envelope = self.envelope.tightened(share);
        self
    }

    /// The same terms with speed and force capped.
    #[must_use]
    pub fn capped(mut self, speed_max_m_s: f64, force_max_n: f64) -> Self {
        self.envelope = self.envelope.capped(speed_max_m_s, force_max_n);
        self
    }

    /// The same terms with modes that policies want reviewed: people have approved the version, or it is evaluated
    /// in simulation for them to decide on.
    #[must_use]
    pub const fn reviewed(mut self) -> Self {
        self.reviewed = true;
        self
    }

    /// The same terms with bundles' seeds drawn under this key; without one they are a run's of seed 0.
    #[must_use]
    pub fn seeded(mut self, seeds: SeedKey) -> Self {
        self.seeds = seeds;
        self
    }

    /// The seed that a bundle is given in an episode.
    #[must_use]
    pub fn bundle_seed(&self, episode: u64) -> BundleSeed {
        self.seeds.seed(episode)
    }

    /// A guard for a version: what its manifest declares, within what the policies allow.
    #[must_use]
    pub fn guard(&self, declared: &Permissions) -> Guard {
        let grant = Grant::new(declared, self.limit_ticks).timed_by(self.meter.clone());
        let grant = match self.stress {
            Some(Stress::Withdrawn { from_tick, until_tick }) => grant.withdrawn(from_tick..until_tick),
            Some(Stress::Tightened { .. } | Stress::Exposed { .. }) | None => grant,
        };
        self.own_guard(declared.authority).granting(grant)
    }

    /// A guard for what the runtime itself moves on the ladder: policies and envelope, no manifest.
    #[must_use]
    pub fn own_guard(&self, authority: Authority) -> Guard {
        Guard::new(
            self.table.clone(),
            self.profile.clone(),
            self.envelope,
            authority,
            self.geometry.clone(),
            self.zones.clone(),
        )
        .reviewed(self.reviewed)
    }

    /// The terms of one task.
    #[must_use]
    pub const fn task(&self, task: TaskKind, seed: u64, abort_secs: f64) -> TaskTerms {
        TaskTerms { task, seed, watch: self.watch, abort_secs, limit_ticks: self.limit_ticks }
    }

    /// The profile that they are the terms of.
    #[must_use]
    pub fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The envelope in force.
    #[must_use]
    pub const fn envelope(&self) -> &Envelope {
        &self.envelope
    }

    #[must_use]
    pub const fn watch(&self) -> &WatchLimits {
        &self.watch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::profile::ProfileName;

    /// Results on record are found again by this text, so the shipped numbers leave it as it was.
    #[test]
    fn text_of_terms_names_numbers_that_a_profile_changes() {
        for name in ProfileName::ALL {
            let mut profile = Profile::builtin(name).unwrap();
            assert_eq!(changed_numbers(&profile), "");
            profile.runtime.look_ahead_s = 0.5;
            profile.runtime.measure_share = 1.25;
            profile.watcher.moving_m_s = 0.25;
            assert_eq!(
                changed_numbers(&profile),
                "|runtime.look_ahead_s=0.5|runtime.measure_share=1.25|watcher.moving_m_s=0.25"
            );
        }
        assert_eq!(
            text_of_watch(&WatchLimits::default()),
            "WatchLimits { slip_max_m: 0.005, tracking_max_rad: 0.05, contact_noticed_n: 2.0, \
             picture_age_max_ticks: 120, grip_fault_ticks: 240, overrun_ticks: 2880 }"
        );
    }
}
