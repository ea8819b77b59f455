//! `kappa_P`: are the modes a version can reach covered by policy, and allowed?
//!
//! Reads the compiled table only. Source: paper section 4.3 and Procedure 1; design rule 3.3; readings X48.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::condition::Condition;
use super::decision::{Dimension, Kappa, Reason};
use super::exports::Interface;
use super::finding::{EvidenceGap, Finding, ResourceKind};
use super::manifest::Permissions;
use super::mode::{ReachableMode, reachable};
use super::outcome::{Assessment, Basis, PolicyOutcome};
pub use super::policy_table::{
    ActivationTerms, EnvelopeCap, ModeEntry, ModeRuling, POLICY_BYTES_MAX, PolicyError, PolicyProblem,
    PolicySource, PolicyTable,
};
use super::profile::{Profile, ProfileName};

/// The inputs of `kappa_P`: the declaration, the code's needs, and the active version's permissions.
#[derive(Clone, Copy, Debug)]
pub struct PolicyInput<'a> {
    /// Part P of the candidate's manifest.
    pub permissions: &'a Permissions,
    /// Profiles the candidate's manifest admits, part D.
    pub environments: &'a BTreeSet<ProfileName>,
    /// The needs of its code; absent if it could not be loaded.
    pub exports: Option<&'a Interface>,
    /// P of the active version; absent for a first version.
    pub active: Option<&'a Permissions>,
}

/// `kappa_P` with its other findings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyAssessment {
    /// Outcome in policy words, `kappa_P` and the reasons.
    pub assessment: Assessment<PolicyOutcome>,
    /// Every mode it can reach, by its permissions or its code.
    pub reachable: Vec<ReachableMode>,
    /// Of these, the ones no policy covers.
    pub uncovered: Vec<ReachableMode>,
    /// Permissions the active version does not have; all of them where there is no active version.
    pub new_permissions: Vec<String>,
    /// Permissions of a higher level than the active version's, with both levels.
    pub escalations: Vec<String>,
}

impl PolicyAssessment {
    /// All permissions beyond the active version's: new ones, then higher ones.
    #[must_use]
    pub fn added_permissions(&self) -> Vec<String> {
        self.new_permissions.iter().chain(&self.escalations).cloned().collect()
    }
}

/// `kappa_P = covered / reachable`, with its outcome (design rule 3.3).
#[must_use]
pub fn assess(input: &PolicyInput<'_>, table: &PolicyTable, profile: &Profile) -> PolicyAssessment {
    let limits = &profile.runtime;
    let needs = input.exports.map(|exports| exports.needs.clone()).unwrap_or_default();
    let modes = reachable(input.permissions, &needs, limits);
    let uncovered: Vec<ReachableMode> =
        modes.iter().copied().filter(|mode| table.verdict(&mode.key) == ModeRuling::Uncovered).collect();
    let active_keys: BTreeSet<_> = input.active.map_or_else(BTreeSet::new, |active| {
        let same = BTreeSet::new();
        reachable(active, &same, limits).into_iter().map(|mode| mode.key).collect()
    });
    let mut findings = PolicyFindings::default();
    if input.exports.is_none() {
        findings.no_data(EvidenceGap::CodeUnread);
    }
    if table.profile != profile.name {
        findings.no_data(EvidenceGap::OtherProfile);
    }
    if modes.is_empty() {
        findings.no_data(EvidenceGap::NoMode);
    }
    findings.static_facts(input, profile, &needs);
    findings.modes(&modes, table, &active_keys);
    findings.envelope(input.permissions, &modes, table, profile);
    let kappa = fraction(modes.len() - uncovered.len(), modes.len());
    findings.threshold(kappa, profile);
    if input.permissions.authority.level() > limits.authority_max {
        let reason = reason(Finding::AuthorityAboveProfile)
            .with(f64::from(input.permissions.authority.level()), f64::from(limits.authority_max));
        findings.review.push(reason);
    }
    findings.conditions(input.environments, profile);
    let (new_permissions, escalations) = changes(input);
    // For a first version everything is new, which does not count against it.
    let against: (&[String], &[String]) =
        if input.active.is_some() { (&new_permissions, &escalations) } else { (&[], &[]) };
    let assessment = findings.conclude(kappa, profile, against.0, against.1);
    PolicyAssessment {
        assessment,
        reachable: modes.into_iter().collect(),
        uncovered,
        new_permissions,
        escalations,
    }
}

fn fraction(part: usize, whole: usize) -> Option<Kappa> {
    if whole == 0 { None } else { Kappa::new(part as f64 / whole as f64) }
}

/// Reasons by their consequence.
#[derive(Default)]
struct PolicyFindings {
    missing: Vec<Reason>,
    incompatible: Vec<Reason>,
    /// Incompatible, unless a review is possible.
    review: Vec<Reason>,
    conditional: Vec<Reason>,
    noted: Vec<Reason>,
    conditions: Vec<Condition>,
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Policy, finding)
}

impl PolicyFindings {
    fn no_data(&mut self, gap: EvidenceGap) {
        self.missing.push(reason(Finding::PolicyGap { gap }));
    }

    fn static_facts(
        &mut self,
        input: &PolicyInput<'_>,
        profile: &Profile,
        needs: &BTreeSet<super::mode::RequiredCommand>,
    ) {
        let declared = input.permissions;
        if let Some(exports) = input.exports {
            let sensors = exports.sensors.difference(&declared.sensors);
            let sensors = sensors.map(|name| Finding::SensorUndeclared { name: name.to_string() });
            let tools = exports.tools.difference(&declared.tools);
            let tools = tools.map(|name| Finding::ToolUndeclared { name: name.to_string() });
            self.incompatible.extend(sensors.chain(tools).map(reason));
        }
        for need in needs {
            if !declared.channels.contains(&need.channel) || !declared.commands.contains(&need.command) {
                self.incompatible.push(reason(Finding::CommandUndeclared { need: *need }));
            }
        }
        if !input.environments.contains(&profile.name) {
            self.incompatible.push(reason(Finding::EnvironmentNotAdmitted { profile: profile.name }));
        }
        let (requested, limits) = (&declared.resources, &profile.runtime);
        let ticks_max = limits.ticks_max();
        for (resource, value, limit) in [
            (ResourceKind::CpuPerTick, requested.cpu_us_per_tick, limits.cpu_us_per_tick_max),
            (ResourceKind::Memory, requested.memory_kib, limits.memory_kib_max),
            (ResourceKind::TicksPerTask, requested.ticks_per_task.unwrap_or(0), ticks_max),
            (ResourceKind::CommandsPerTask, requested.commands_per_task.unwrap_or(0), ticks_max),
        ] {
            if value > limit {
                let reason = reason(Finding::ResourceExceeded { resource });
                self.incompatible.push(reason.with(f64::from(value), f64::from(limit)));
            }
        }
    }

    fn modes(
        &mut self,
        modes: &BTreeSet<ReachableMode>,
        table: &PolicyTable,
        active: &BTreeSet<super::mode::ModeKey>,
    ) {
        for mode in modes {
            let because = || table.entry(&mode.key).map_or_else(Vec::new, |entry| entry.because.clone());
            let key = mode.key;
            match table.verdict(&mode.key) {
                ModeRuling::Allow | ModeRuling::AllowTighter(_) => {}
                ModeRuling::Review => {
                    self.review.push(reason(Finding::ModeReviewed { mode: key, because: because() }));
                }
                ModeRuling::Forbid => {
                    self.incompatible.push(reason(Finding::ModeForbidden { mode: key, because: because() }));
                }
                ModeRuling::Uncovered if mode.is_high_risk() => {
                    self.incompatible
                        .push(reason(Finding::HighRiskUncovered { mode: key, errors: because() }));
                }
                ModeRuling::Uncovered => {
                    let reason = reason(Finding::ModeUncovered { mode: key, errors: because() });
                    let new = !active.contains(&mode.key);
                    if new { self.conditional.push(reason) } else { self.noted.push(reason) }
                }
            }
        }
    }

    fn envelope(
        &mut self,
        permissions: &Permissions,
        modes: &BTreeSet<ReachableMode>,
        table: &PolicyTable,
        profile: &Profile,
    ) {
        let limits = &profile.runtime;
        let cap = |mode: &ReachableMode| match table.verdict(&mode.key) {
            ModeRuling::AllowTighter(cap) => (cap.speed_max_m_s, cap.force_max_n),
            ModeRuling::Allow | ModeRuling::Review | ModeRuling::Forbid | ModeRuling::Uncovered => {
                (limits.tool_speed_max_m_s, limits.contact_force_max_n)
            }
        };
        // The widest mode sets the version's envelope; the guard holds each mode to its own cap.
        let widest = modes.iter().map(cap).fold((0.0_f64, 0.0_f64), |a, b| (a.0.max(b.0), a.1.max(b.1)));
        let narrowest = modes.iter().map(cap).fold(widest, |a, b| (a.0.min(b.0), a.1.min(b.1)));
        let (declared_speed, declared_force) = (permissions.max_speed_m_s, permissions.max_force_n);
        let speed = (narrowest.0 < declared_speed).then_some(narrowest.0);
        let force = (narrowest.1 < declared_force).then_some(narrowest.1);
        let (of_speed, of_force) =
            (speed.map(|cap| (declared_speed, cap)), force.map(|cap| (declared_force, cap)));
        if let Some((declared, cap)) = of_speed.or(of_force) {
            let finding = Finding::EnvelopeTighter { speed_m_s: speed, force_n: force };
            self.conditional.push(reason(finding).with(declared, cap));
            let (speed_max_m_s, force_max_n) = (declared_speed.min(widest.0), declared_force.min(widest.1));
            self.conditions.push(Condition::TighterEnvelope { speed_max_m_s, force_max_n });
        }
    }

    /// The conditions of use of a version that is not refused.
    fn conditions(&mut self, environments: &BTreeSet<ProfileName>, profile: &Profile) {
        if environments.iter().all(|name| *name == ProfileName::Sim) {
            self.conditional.push(reason(Finding::SimulationOnlyDeclared));
            self.conditions.push(Condition::SimulationOnly);
        }
        if !self.review.is_empty() && profile.has_approver() {
            self.conditions.push(Condition::ApprovalRequired { quorum: profile.approval.quorum_review });
        }
    }

    fn threshold(&mut self, kappa: Option<Kappa>, profile: &Profile) {
        let Some(kappa) = kappa else { return };
        let threshold = profile.thresholds.policy();
        if kappa.get() < threshold {
            let below = reason(Finding::CoverageLow).with(kappa.get(), threshold);
            self.review.push(below);
        }
    }

    fn conclude(
        self,
        kappa: Option<Kappa>,
        profile: &Profile,
        new_permissions: &[String],
        escalations: &[String],
    ) -> Assessment<PolicyOutcome> {
        let outcome = if !self.missing.is_empty() {
            PolicyOutcome::NoData
        } else if !self.incompatible.is_empty() || (!self.review.is_empty() && !profile.has_approver()) {
            PolicyOutcome::Incompatible
        } else if !self.review.is_empty() {
            PolicyOutcome::Review
        } else if !self.conditional.is_empty() {
            PolicyOutcome::Conditional
        } else {
            PolicyOutcome::Compatible
        };
        let mut reasons = self.missing;
        reasons.extend(self.incompatible);
        reasons.extend(self.review);
        reasons.extend(self.conditional);
        if outcome == PolicyOutcome::Compatible {
            let covered = reason(Finding::PolicyCompatible);
            reasons.push(covered.with(kappa.map_or(f64::NAN, Kappa::get), profile.thresholds.policy()));
        }
        reasons.extend(self.noted);
        let new = |name: &String| reason(Finding::PermissionNew { permission: name.clone() });
        reasons.extend(new_permissions.iter().map(new));
        let higher = |name: &String| reason(Finding::PermissionHigher { permission: name.clone() });
        reasons.extend(escalations.iter().map(higher));
        let known = outcome != PolicyOutcome::NoData;
        Assessment {
            outcome,
            kappa: kappa.filter(|_| known),
            basis: Basis::Measured,
            reasons,
            conditions: if known { self.conditions } else { Vec::new() },
        }
    }
}

/// New permissions and escalations against the active version. Of a first version everything is new.
fn changes(input: &PolicyInput<'_>) -> (Vec<String>, Vec<String>) {
    let new = input.permissions;
    let (channels, commands, zones) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    let (sensors, tools) = (BTreeSet::new(), BTreeSet::new());
    let old = input.active;
    let channels = new.channels.difference(old.map_or(&channels, |old| &old.channels));
    let commands = new.commands.difference(old.map_or(&commands, |old| &old.commands));
    let zones = new.zones.difference(old.map_or(&zones, |old| &old.zones));
    let sensors = new.sensors.difference(old.map_or(&sensors, |old| &old.sensors));
    let tools = new.tools.difference(old.map_or(&tools, |old| &old.tools));
    let added = channels
        .map(|channel| format!("channel {}", channel.name()))
        .chain(commands.map(|command| format!("command {}", command.name())))
        .chain(zones.map(|zone| format!("zone {}", zone.name())))
        .chain(sensors.map(|name| format!("sensor {name}")))
        .chain(tools.map(|name| format!("tool {name}")))
        .collect();
    let levels = |of: &Permissions| {
        [
            f64::from(of.authority.level()),
            of.max_speed_m_s,
            of.max_force_n,
            f64::from(of.resources.cpu_us_per_tick),
            f64::from(of.resources.memory_kib),
        ]
    };
    let names = [
        ("authority", ""),
        ("speed", " m/s"),
        ("force", " N"),
        ("processor time", " us a tick"),
        ("memory", " KiB"),
    ];
    let before = old.map(levels);
    let mut higher = Vec::new();
    for (at, ((what, unit), level)) in names.into_iter().zip(levels(new)).enumerate() {
        match before.and_then(|levels| levels.get(at).copied()) {
            Some(old) if level > old => higher.push(format!("{what} {level}{unit} (was {old}{unit})")),
            Some(_) => {}
            None => higher.push(format!("{what} {level}{unit}")),
        }
    }
    let budgets = |of: &Permissions| [of.resources.ticks_per_task, of.resources.commands_per_task];
    if let Some(old) = old {
        let pairs = budgets(old).into_iter().zip(budgets(new));
        for (what, pair) in ["ticks a task", "commands a task"].into_iter().zip(pairs) {
            match pair {
                (Some(old), Some(new)) if new > old => higher.push(format!("{what} {new} (was {old})")),
                (Some(old), None) => higher.push(format!("{what} as the profile has them (was {old})")),
                (None | Some(_), _) => {}
            }
        }
    }
    (added, higher)
}
