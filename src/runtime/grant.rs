//! Part P of a manifest as the guard holds every tick against it, and the count of what was used of it.
//!
//! A version gets what it declares and no more: kinds of command, zones, and a budget in ticks and commands, which
//! are the same on every machine. What it may sense is withheld elsewhere, before the skill sees it
//! ([`crate::capability::Capability::start`]).

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use holdpoint_body::{Command, Telemetry};
use holdpoint_governance::manifest::Permissions;
use holdpoint_governance::mode::{Channel, CommandKind, RequiredCommand, ZoneName};
use holdpoint_governance::permission::PermissionsUsed;

use super::guard::PolicyHit;
use super::meter::TickMeter;

/// Ticks that the tool has to be in a zone before it counts as entered: a noisy sample on the border is no entry.
const ENTERED_TICKS: u32 = 3;

/// The least declaration that an excess is divided by, so that the quotient is a number.
const DECLARED_MIN: f64 = 1e-9;

/// What one version may ask for in one task, and what it has asked for so far.
#[derive(Clone, Debug)]
pub struct Grant {
    kinds: [bool; CommandKind::ALL.len()],
    zones: BTreeSet<ZoneName>,
    ticks_max: u64,
    commands_max: u64,
    /// Tool speed, m/s, and force, N.
    declared: (f64, f64),
    sent: [bool; CommandKind::ALL.len()],
    seen: BTreeSet<ZoneName>,
    withdrawn: Range<u64>,
    meter: Option<Arc<TickMeter>>,
    was_within: bool,
    outside_ticks: u32,
    used: PermissionsUsed,
}

/// The one channel that takes a kind of command.
fn channel_of(kind: CommandKind) -> Channel {
    Channel::ALL.into_iter().find(|channel| channel.takes(kind)).unwrap_or(Channel::Bus)
}

impl Grant {
    /// What a manifest declares; `episode_ticks` is the profile's longest episode, which nothing exceeds.
    #[must_use]
    pub fn new(declared: &Permissions, episode_ticks: u64) -> Self {
        let budget = |own: Option<u32>| own.map_or(episode_ticks, |own| u64::from(own).min(episode_ticks));
        Self {
            kinds: CommandKind::ALL
                .map(|command| declared.allows(RequiredCommand { channel: channel_of(command), command })),
            zones: declared.zones.clone(),
            ticks_max: budget(declared.resources.ticks_per_task),
            commands_max: budget(declared.resources.commands_per_task),
            declared: (declared.max_speed_m_s, declared.max_force_n),
            sent: [false; CommandKind::ALL.len()],
            seen: BTreeSet::new(),
            withdrawn: 0..0,
            meter: None,
            was_within: false,
            outside_ticks: 0,
            used: PermissionsUsed::default(),
        }
    }

    /// The same grant, withdrawn for a while: in these ticks of the task nothing may move.
    #[must_use]
    pub fn withdrawn(self, ticks: Range<u64>) -> Self {
        Self { withdrawn: ticks, ..self }
    }

    /// The same grant on an arm where computing time counts too.
    #[must_use]
    pub fn timed_by(self, meter: Option<Arc<TickMeter>>) -> Self {
        Self { meter, ..self }
    }

    /// Counts a command that the version asks for, whatever becomes of it.
    pub(crate) fn note_command(&mut self, command: &Command) {
        if let Some((_, kind)) = CommandKind::of(command) {
            self.sent[kind as usize] = true;
            self.used.commands_max = self.used.commands_max.saturating_add(1);
        }
        let used = &mut self.used;
        // A value that is no number is refused, and is not the largest of anything.
        match command {
            Command::ToolPose { max_speed_m_s, .. } if max_speed_m_s.is_finite() => {
                used.asked_speed_m_s = used.asked_speed_m_s.max(*max_speed_m_s);
            }
            Command::Gripper { force_n, .. } if force_n.is_finite() => {
                used.asked_force_n = used.asked_force_n.max(*force_n);
            }
            Command::ToolPose { .. }
            | Command::Gripper { .. }
            | Command::Joints { .. }
            | Command::Hold
            | Command::Stop
            | Command::Done
            | Command::Fail { .. } => {}
        }
    }

    /// By what share a command asks for more than is declared, at least 0. Speeds of joints are not declared.
    pub(crate) fn excess(&self, command: &Command) -> f64 {
        let (speed_m_s, force_n) = self.declared;
        let (requested, declared) = match command {
            Command::ToolPose { max_speed_m_s, .. } => (*max_speed_m_s, speed_m_s),
            Command::Gripper { force_n: requested_n, .. } => (*requested_n, force_n),
            Command::Joints { .. } | Command::Hold | Command::Stop | Command::Done | Command::Fail { .. } => {
                return 0.0;
            }
        };
        // A declaration that is no number, or none, lets nothing be asked for; the manifest rules both out.
        if requested <= declared { 0.0 } else { (requested - declared) / declared.max(DECLARED_MIN) }
    }

    /// Whether a command that leads to a zone is declared. To stand still needs no permission: refused, it would be
    /// the same command. A version that finds itself in a zone it does not declare has not gone there: it may work
    /// its hand, and leave.
    pub(crate) fn refuses(&mut self, kind: CommandKind, zone: ZoneName) -> Option<PolicyHit> {
        if matches!(kind, CommandKind::Stop) {
            return None;
        }
        let tick = self.used.ticks_max;
        if self.withdrawn.start <= tick && tick < self.withdrawn.end {
            return Some(PolicyHit::PermissionWithdrawn);
        }
        let hit = if !self.kinds[kind as usize] {
            PolicyHit::CommandUndeclared
        } else if !self.zones.contains(&zone) && (self.was_within || !matches!(kind, CommandKind::Gripper)) {
            if zone == ZoneName::Human {
                return Some(PolicyHit::KeepOut);
            }
            self.seen.insert(zone);
            PolicyHit::ZoneUndeclared
        } else {
            return None;
        };
        self.used.undeclared = self.used.undeclared.saturating_add(1);
        Some(hit)
    }

    /// Takes in one tick: where the tool was measured and what acts on it. A version that finds itself in a zone it
    /// does not declare has not entered it. In the keep-out zone people come to the tool as well as the tool to them:
    /// that is a violation, and nothing that the version is to declare.
    pub(crate) fn measure(&mut self, seen: &Telemetry, zone: Option<ZoneName>) -> Option<PolicyHit> {
        self.used.ticks_max = self.used.ticks_max.saturating_add(1);
        self.used.speed_max_m_s = self.used.speed_max_m_s.max(seen.tool_speed_m_s);
        self.used.force_max_n = self.used.force_max_n.max(seen.contact_force_n.max(seen.gripper_force_n));
        let zone = zone?;
        if self.zones.contains(&zone) {
            self.seen.insert(zone);
            self.was_within = true;
            self.outside_ticks = 0;
            return None;
        }
        if !self.was_within {
            return None;
        }
        self.outside_ticks = self.outside_ticks.saturating_add(1);
        if self.outside_ticks != ENTERED_TICKS {
            return None;
        }
        if zone == ZoneName::Human {
            return Some(PolicyHit::KeepOutEntered);
        }
        self.seen.insert(zone);
        self.used.undeclared = self.used.undeclared.saturating_add(1);
        Some(PolicyHit::ZoneUndeclared)
    }

    /// Whether more ticks, commands or, where it counts, time were used than are declared.
    pub(crate) fn is_overdrawn(&self) -> bool {
        self.used.ticks_max > self.ticks_max
            || self.used.commands_max > self.commands_max
            || self.meter.as_ref().is_some_and(|meter| meter.is_breached())
    }

    /// What was used so far.
    #[must_use]
    pub fn used(&self) -> PermissionsUsed {
        let sent = |command: &CommandKind| self.sent[*command as usize];
        let commands: BTreeSet<RequiredCommand> = CommandKind::ALL
            .into_iter()
            .filter(sent)
            .map(|command| RequiredCommand { channel: channel_of(command), command })
            .collect();
        PermissionsUsed { commands, zones: self.seen.clone(), ..self.used.clone() }
    }
}

#[cfg(test)]
mod tests;
