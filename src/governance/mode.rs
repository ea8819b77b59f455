//! Reachable modes: the requests that a version's permissions allow.
//!
//! A mode is channel x command kind x zone x authority; speed and force bands say how near the
//! profile's limits it may get. Owns the enumeration of modes; knows nothing of policies.

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::manifest::Permissions;
use super::profile::RuntimeLimits;
pub use super::zone_name::{UnknownZone, ZoneName};

crate::closed_set! {
    /// A path by which a version can move something.
    Channel, "channel", {
        /// The arm's joints, through the servo.
        Arm = "arm",
        /// The gripper, through its servo.
        Gripper = "gripper",
        /// The field bus: direct actuator access, past the mediated channels.
        Bus = "bus",
    }
}

crate::closed_set! {
    /// The kind of a command as policies name it (the paper's action type).
    CommandKind, "kind of command", {
        /// Straight line of the tool to a pose.
        ToolPose = "tool-pose",
        /// Joint motion to a configuration.
        Joints = "joints",
        /// Fingers to a width with at most a force.
        Gripper = "gripper",
        /// Standstill: every joint is braked to zero speed.
        Stop = "stop",
        /// Raw actuator values on the field bus.
        Direct = "direct",
    }
}

crate::closed_set! {
    /// A part of the observation that a version reads only if it declares it.
    Sensor, "sensor", {
        /// Where object and target were last seen.
        Camera = "camera",
        /// Joint positions, speeds and torques, and the tool's pose and velocity computed from them.
        Joints = "joints",
        /// The force sensed at the wrist.
        WristForce = "wrist-force",
        /// The sensors that the cell offers by name.
        Named = "named",
    }
}

crate::closed_set! {
    /// A tool at the end of the arm. A version that declares none neither commands it nor reads it.
    Tool, "tool", {
        /// The two-fingered gripper: its width, its force, and whether it answers.
        ParallelGripper = "parallel-gripper",
    }
}

impl Channel {
    /// Whether this channel takes this kind of command.
    #[must_use]
    pub const fn takes(self, command: CommandKind) -> bool {
        match command {
            CommandKind::ToolPose | CommandKind::Joints | CommandKind::Stop => matches!(self, Self::Arm),
            CommandKind::Gripper => matches!(self, Self::Gripper),
            CommandKind::Direct => matches!(self, Self::Bus),
        }
    }
}

impl CommandKind {
    /// The kind and channel of a command at the robot's boundary; `None` for those that move nothing
    /// (hold, done, fail) and so need no permission.
    #[must_use]
    pub const fn of(command: &holdpoint_body::Command) -> Option<(Channel, Self)> {
        use holdpoint_body::Command;
        match command {
            Command::ToolPose { .. } => Some((Channel::Arm, Self::ToolPose)),
            Command::Joints { .. } => Some((Channel::Arm, Self::Joints)),
            Command::Gripper { .. } => Some((Channel::Gripper, Self::Gripper)),
            Command::Stop => Some((Channel::Arm, Self::Stop)),
            Command::Hold | Command::Done | Command::Fail { .. } => None,
        }
    }
}

/// How much a version may decide by itself: 0 observes, 1 moves in its task, 2 changes shared state, 3 overrides others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct Authority(u8);

impl JsonSchema for Authority {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Authority".into()
    }
    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "integer", "minimum": 0, "maximum": 3 })
    }
}

/// An authority level above 3.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the authority level {0} is not allowed; 0, 1, 2 and 3 are")]
pub struct AuthorityError(pub u8);

impl Authority {
    /// Every level, the least first.
    pub const ALL: [Self; 4] = [Self(0), Self(1), Self(2), Self(3)];
    /// The lowest level of high risk (design rule: authority >= 2).
    pub const HIGH_RISK_FROM: Self = Self(2);
    /// The level as a number.
    #[must_use]
    pub const fn level(self) -> u8 {
        self.0
    }
}

impl TryFrom<u8> for Authority {
    type Error = AuthorityError;
    fn try_from(level: u8) -> Result<Self, AuthorityError> {
        if level <= 3 { Ok(Self(level)) } else { Err(AuthorityError(level)) }
    }
}

impl From<Authority> for u8 {
    fn from(authority: Authority) -> Self {
        authority.0
    }
}

/// One mode as the policy table and the runtime guard know it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModeKey {
    /// Channel the command goes out on.
    pub channel: Channel,
    /// Kind of command that is sent.
    pub command: CommandKind,
    /// Where the tool is or is sent.
    pub zone: ZoneName,
    /// With how much authority the version acts.
    pub authority: Authority,
}

impl ModeKey {
    /// Every mode there is in these zones, in a fixed order.
    #[must_use]
    pub fn all(zones: &BTreeSet<ZoneName>) -> Vec<Self> {
        let mut modes = Vec::new();
        for channel in Channel::ALL {
            for command in CommandKind::ALL.into_iter().filter(|command| channel.takes(*command)) {
                for zone in zones {
                    for authority in Authority::ALL {
                        modes.push(Self { channel, command, zone: *zone, authority });
                    }
                }
            }
        }
        modes
    }
}

impl std::fmt::Display for ModeKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { channel, command, zone, authority } = self;
        write!(f, "{channel}/{command} in {} at authority {}", zone.name(), authority.level())
    }
}

/// How near a limit of the profile a permission reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LimitBand {
    /// Up to the profile's `high_share` of the limit.
    Normal,
    /// Above it and up to the limit: high risk.
    High,
    /// Above the limit: usable in a tighter envelope only.
    Over,
}

impl LimitBand {
    /// The band of `value` against `limit`, of which `high_share` is the normal part; NaN is over the limit.
    #[must_use]
    pub fn of(value: f64, limit: f64, high_share: f64) -> Self {
        if value <= high_share * limit {
            Self::Normal
        } else if value <= limit {
            Self::High
        } else {
            Self::Over
        }
    }
}

/// A mode a version can reach, with the bands of its declared speed and force.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReachableMode {
    /// Its command, zone and authority.
    pub key: ModeKey,
    /// Band of the declared speed (arm modes).
    pub speed: LimitBand,
    /// Band of the declared force.
    pub force: LimitBand,
}

impl ReachableMode {
    /// Human zone, authority >= 2, or above 80 % of a limit.
    #[must_use]
    pub fn is_high_risk(&self) -> bool {
        self.key.zone == ZoneName::Human
            || self.key.authority >= Authority::HIGH_RISK_FROM
            || self.speed >= LimitBand::High
            || self.force >= LimitBand::High
    }
}

/// A channel and kind of command, as code needs them or sends them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RequiredCommand {
    /// Channel it goes out on.
    pub channel: Channel,
    /// Kind of command it is.
    pub command: CommandKind,
}

/// The modes that permissions, or what the code needs, can reach (`kappa_P`, design rule 3.3).
///
/// The declared channels and commands are joined with `needs`: what the code can do counts even if the manifest is
/// silent. Speed and force are compared with the profile's limits.
#[must_use]
pub fn reachable(
    permissions: &Permissions,
    needs: &BTreeSet<RequiredCommand>,
    limits: &RuntimeLimits,
) -> BTreeSet<ReachableMode> {
    let declared = permissions.channels.iter().flat_map(|channel| {
        let taken = permissions.commands.iter().filter(|command| channel.takes(**command));
        taken.map(|command| RequiredCommand { channel: *channel, command: *command })
    });
    let pairs: BTreeSet<RequiredCommand> = declared.chain(needs.iter().copied()).collect();
    let band = |value, limit| LimitBand::of(value, limit, limits.high_share);
    let speed = band(permissions.max_speed_m_s, limits.tool_speed_max_m_s);
    let force = band(permissions.max_force_n, limits.contact_force_max_n);
    let mut modes = BTreeSet::new();
    for RequiredCommand { channel, command } in pairs {
        for zone in &permissions.zones {
            let key = ModeKey { channel, command, zone: *zone, authority: permissions.authority };
            // A stop neither moves nor presses; the gripper's travel is no tool speed.
            let moves = command != CommandKind::Stop;
            let travels = moves && channel != Channel::Gripper;
            modes.insert(ReachableMode {
                key,
                speed: if travels { speed } else { LimitBand::Normal },
                force: if moves { force } else { LimitBand::Normal },
            });
        }
    }
    modes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eighty_modes_are_distinct() {
        let modes = ModeKey::all(&ZoneName::SHIPPED.into());
        assert_eq!(modes.len(), 5 * 4 * 4);
        assert_eq!(modes.iter().collect::<BTreeSet<_>>().len(), modes.len());
    }

    #[test]
    fn limit_bands_are_assigned_by_value() {
        for (value, band) in [
            (0.0, LimitBand::Normal),
            (0.8, LimitBand::Normal),
            (0.81, LimitBand::High),
            (1.0, LimitBand::High),
            (1.01, LimitBand::Over),
            (f64::NAN, LimitBand::Over),
        ] {
            assert_eq!(LimitBand::of(value, 1.0, 0.8), band, "{value}");
        }
    }
}
