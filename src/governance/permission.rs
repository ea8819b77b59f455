//! Used permissions: a version's observed requests beside its manifest.
//!
//! Owns the record of permissions used and their comparison with part P of a manifest. Enforces nothing: the guard
//! does, tick by tick.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use holdpoint_body::CodeFault;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::evidence::HardStop;
use super::exports::Interface;
use super::manifest::Permissions;
use super::mode::{RequiredCommand, Sensor, Tool, ZoneName};

/// A version's requests and measurements, over one task or many.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PermissionsUsed {
    /// Channels and kinds of command it sent, the refused ones too.
    pub commands: BTreeSet<RequiredCommand>,
    /// Zones its tool was measured in, or its commands led to.
    pub zones: BTreeSet<ZoneName>,
    /// Largest measured speed of the tool, m/s.
    pub speed_max_m_s: f64,
    /// Largest measured force on pads or surroundings, N.
    pub force_max_n: f64,
    /// Largest speed of the tool that a command asked for, m/s; 0 in records of older builds.
    #[serde(skip_serializing_if = "is_unasked")]
    pub asked_speed_m_s: f64,
    /// Largest grip force that a command asked for, N; 0 in records of older builds.
    #[serde(skip_serializing_if = "is_unasked")]
    pub asked_force_n: f64,
    /// Ticks of the longest task.
    pub ticks_max: u64,
    /// Commands sent in the task with the most of them; holding sends none.
    pub commands_max: u64,
    /// Commands refused and zones entered that part P does not declare, over all tasks.
    pub undeclared: u64,
    /// The most fuel that a tick of confined code needed; 0 for code that is compiled in.
    #[serde(skip_serializing_if = "is_zero")]
    pub fuel_tick_max: u64,
    /// The most memory that confined code had, bytes; 0 for code that is compiled in.
    #[serde(skip_serializing_if = "is_zero")]
    pub memory_max_bytes: u64,
    /// How its code failed, and in how many tasks.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub faults: BTreeMap<CodeFault, u64>,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
const fn is_zero(count: &u64) -> bool {
    *count == 0
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_unasked(asked: &f64) -> bool {
    *asked == 0.0
}

impl PermissionsUsed {
    /// Takes in what another task used.
    pub fn merge(&mut self, other: &Self) {
        self.commands.extend(&other.commands);
        self.zones.extend(&other.zones);
        self.speed_max_m_s = self.speed_max_m_s.max(other.speed_max_m_s);
        self.force_max_n = self.force_max_n.max(other.force_max_n);
        self.asked_speed_m_s = self.asked_speed_m_s.max(other.asked_speed_m_s);
        self.asked_force_n = self.asked_force_n.max(other.asked_force_n);
        self.ticks_max = self.ticks_max.max(other.ticks_max);
        self.commands_max = self.commands_max.max(other.commands_max);
        self.undeclared = self.undeclared.saturating_add(other.undeclared);
        self.fuel_tick_max = self.fuel_tick_max.max(other.fuel_tick_max);
        self.memory_max_bytes = self.memory_max_bytes.max(other.memory_max_bytes);
        for (fault, tasks) in &other.faults {
            let known = self.faults.entry(*fault).or_default();
            *known = known.saturating_add(*tasks);
        }
    }

    /// Takes in what confined code used in one task, and how it failed.
    pub fn record_sandbox_use(&mut self, fuel_tick_max: u64, memory_bytes: u64, fault: Option<CodeFault>) {
        self.fuel_tick_max = self.fuel_tick_max.max(fuel_tick_max);
        self.memory_max_bytes = self.memory_max_bytes.max(memory_bytes);
        if let Some(fault) = fault {
            *self.faults.entry(fault).or_default() += 1;
        }
    }
}

/// Declared against observed: part P beside what was used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PermissionUse {
    /// Part P of the manifest.
    pub declared: Permissions,
    /// The observed use in the tasks that ran.
    pub used: PermissionsUsed,
    /// Sensors its code reads, as the code itself says.
    pub sensors_read: BTreeSet<Sensor>,
    /// Tools its code reads or commands, as the code itself says.
    pub tools_read: BTreeSet<Tool>,
    /// Tasks it was seen in.
    pub tasks: u32,
    /// Undeclared requests, and measurements above the declaration.
    pub exceeded: Vec<String>,
    /// Declared but unused permissions.
    pub unused: Vec<String>,
}

impl PermissionUse {
    /// Compares what was used in `tasks` tasks, and what the code reads, with the declaration.
    #[must_use]
    pub fn new(declared: &Permissions, code: &Interface, used: &PermissionsUsed, tasks: u32) -> Self {
        let mut unused = Vec::new();
        for channel in &declared.channels {
            if !used.commands.iter().any(|sent| sent.channel == *channel) {
                unused.push(format!("channel {}", channel.name()));
            }
        }
        for command in &declared.commands {
            if !used.commands.iter().any(|sent| sent.command == *command) {
                unused.push(format!("command {}", command.name()));
            }
        }
        unused.extend(declared.zones.difference(&used.zones).map(|zone| format!("zone {}", zone.name())));
        let (sensors_read, tools_read) = (code.sensors.clone(), code.tools.clone());
        unused.extend(declared.sensors.difference(&sensors_read).map(|sensor| format!("sensor {sensor}")));
        unused.extend(declared.tools.difference(&tools_read).map(|tool| format!("tool {tool}")));
        let (declared, used) = (declared.clone(), used.clone());
        let exceeded = Vec::new();
        let mut found = Self { declared, used, sensors_read, tools_read, tasks, exceeded, unused };
        found.exceeded = found.excesses().iter().map(PermissionExcess::to_string).collect();
        found
    }

    /// Every use beyond the declaration, in the order of the record.
    #[must_use]
    pub fn excesses(&self) -> Vec<PermissionExcess> {
        use PermissionExcess as E;
        let Self { declared, used, sensors_read, tools_read, tasks, .. } = self;
        let mut all: Vec<E> = used
            .commands
            .iter()
            .filter(|sent| !declared.allows(**sent))
            .map(|sent| E::Command(*sent))
            .collect();
        all.extend(used.zones.difference(&declared.zones).map(|zone| E::Zone(*zone)));
        for (quantity, asked, declared) in [
            (PeakQuantity::Speed, used.asked_speed_m_s, declared.max_speed_m_s),
            (PeakQuantity::Force, used.asked_force_n, declared.max_force_n),
        ] {
            if asked > declared {
                all.push(E::Asked { quantity, asked, declared });
            }
        }
        for (quantity, measured, declared) in [
            (PeakQuantity::Speed, used.speed_max_m_s, declared.max_speed_m_s),
            (PeakQuantity::Force, used.force_max_n, declared.max_force_n),
        ] {
            // Written so that a value that is no number exceeds.
            if !(measured <= declared) {
                all.push(E::Peak { quantity, measured, declared });
            }
        }
        for (budget, used, declared) in [
            (TaskBudget::Ticks, used.ticks_max, declared.resources.ticks_per_task),
            (TaskBudget::Commands, used.commands_max, declared.resources.commands_per_task),
        ] {
            if let Some(declared) = declared.filter(|declared| used > u64::from(*declared)) {
                all.push(E::Budget { budget, used, declared });
            }
        }
        all.extend(used.faults.iter().map(|(fault, failed)| E::Fault {
            fault: *fault,
            failed: *failed,
            tasks: *tasks,
        }));
        all.extend(sensors_read.difference(&declared.sensors).map(|sensor| E::Sensor(*sensor)));
        all.extend(tools_read.difference(&declared.tools).map(|tool| E::Tool(*tool)));
        all
    }
}

/// A quantity whose declared limit applies to commands, and whose peak is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeakQuantity {
    /// Speed of the tool, m/s.
    Speed,
    /// Force on pads or surroundings, N.
    Force,
}

/// A declared budget of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TaskBudget {
    /// Ticks of the task.
    Ticks,
    /// Commands in the task.
    Commands,
}

/// A use beyond the declaration. Its text is that of the record.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum PermissionExcess {
    /// It sent a command that is not declared.
    Command(RequiredCommand),
    /// It entered a zone that is not declared, or aimed at one.
    Zone(ZoneName),
    /// A command asked for more than the declared limit.
    Asked { quantity: PeakQuantity, asked: f64, declared: f64 },
    /// A measured peak is above the declared limit of commands.
    Peak { quantity: PeakQuantity, measured: f64, declared: f64 },
    /// A task used more than its declared budget.
    Budget { budget: TaskBudget, used: u64, declared: u32 },
    /// Its code failed.
    Fault { fault: CodeFault, failed: u64, tasks: u32 },
    /// Its code reads a sensor that is not declared.
    Sensor(Sensor),
    /// Its code reads or commands a tool that is not declared.
    Tool(Tool),
}

/// What a use beyond the declaration leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExcessEffect {
    /// A hard stop: the first one ends an evaluation.
    HardStop(HardStop),
    /// The task with it fails.
    TaskFails,
    /// Policy compatibility fails: each sensor and tool of the code has to be declared.
    PolicyFails,
    /// The command is clamped, and its excess is a measure of harm.
    Clamped,
    /// Nothing by itself: the limit applies to commands, and this is a measured peak. The guard counts a lasting one.
    MeasuredPeak,
    /// Nothing: it is no fault of the version.
    NotOfVersion,
}

impl ExcessEffect {
    /// Whether it counts against the version.
    #[must_use]
    pub const fn counts(self) -> bool {
        match self {
            Self::HardStop(_) | Self::TaskFails | Self::PolicyFails | Self::Clamped => true,
            Self::MeasuredPeak | Self::NotOfVersion => false,
        }
    }
}

impl PermissionExcess {
    /// What it leads to.
    #[must_use]
    pub const fn effect(&self) -> ExcessEffect {
        match self {
            Self::Command(_) | Self::Zone(_) => ExcessEffect::HardStop(HardStop::CommandPastGuard),
            Self::Budget { .. } | Self::Fault { fault: CodeFault::Fuel | CodeFault::Memory, .. } => {
                ExcessEffect::HardStop(HardStop::BudgetBreach)
            }
            Self::Fault { fault: CodeFault::Trap | CodeFault::Answer, .. } => ExcessEffect::TaskFails,
            Self::Fault { fault: CodeFault::Machine, .. } => ExcessEffect::NotOfVersion,
            Self::Sensor(_) | Self::Tool(_) => ExcessEffect::PolicyFails,
            Self::Asked { .. } => ExcessEffect::Clamped,
            Self::Peak { .. } => ExcessEffect::MeasuredPeak,
        }
    }
}

impl fmt::Display for PermissionExcess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Command(sent) => write!(f, "command {}/{}", sent.channel, sent.command),
            Self::Zone(zone) => write!(f, "zone {}", zone.name()),
            Self::Asked { quantity: PeakQuantity::Speed, asked, declared } => {
                write!(f, "it asks for a speed of {asked:.3} m/s and declares {declared}")
            }
            Self::Asked { quantity: PeakQuantity::Force, asked, declared } => {
                write!(f, "it asks for a force of {asked:.1} N and declares {declared}")
            }
            Self::Peak { quantity: PeakQuantity::Speed, measured, declared } => {
                write!(f, "speed {measured:.3} m/s of {declared}")
            }
            Self::Peak { quantity: PeakQuantity::Force, measured, declared } => {
                write!(f, "force {measured:.3} N of {declared}")
            }
            Self::Budget { budget: TaskBudget::Ticks, used, declared } => {
                write!(f, "ticks a task {used} of {declared}")
            }
            Self::Budget { budget: TaskBudget::Commands, used, declared } => {
                write!(f, "commands a task {used} of {declared}")
            }
            Self::Fault { fault, failed, tasks } => {
                write!(f, "{} in {failed} of {tasks} tasks", fault_text(*fault))
            }
            Self::Sensor(sensor) => write!(f, "sensor {sensor}"),
            Self::Tool(tool) => write!(f, "tool {tool}"),
        }
    }
}

/// How confined code failed, in words.
#[must_use]
pub const fn fault_text(fault: CodeFault) -> &'static str {
    match fault {
        CodeFault::Trap => "its code traps",
        CodeFault::Fuel => "its code computes beyond its budget",
        CodeFault::Memory => "its code asks for more memory than declared",
        CodeFault::Answer => "its code refuses to start or answers what is no command",
        CodeFault::Machine => "the machine stalled",
    }
}
