//! Both contracts behind one set of calls: a component of `holdpoint:skill@1.0.0` runs as one of 2.0.0 that answers one
//! command and asks for no sensors.
//!
//! Owns the choice between the generated bindings. Decides nothing about fuel, faults or chunks.

use wasmtime::Store;
use wasmtime::component::{Instance, InstancePre};

use holdpoint_body::{Observation, TaskKind};
use holdpoint_skill::Hook;

use crate::chunk::CommandChunk;
use crate::host::Host;
use crate::sensors::SensorSet;
use crate::wit::types::Parameter;
use crate::{wit, wit_2};

/// The contract that a component exports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkillContract {
    /// `holdpoint:skill@1.0.0`: one object, one target, one command a tick, at most eight joints.
    One,
    /// `holdpoint:skill@2.0.0`: named objects, negotiated sensors, chunks of commands.
    Two,
}

impl SkillContract {
    /// The interface that a component of it exports.
    #[must_use]
    pub const fn skill(self) -> &'static str {
        match self {
            Self::One => "holdpoint:skill/skill@1.0.0",
            Self::Two => "holdpoint:skill/skill@2.0.0",
        }
    }

    /// The interface of its messages: it has types alone, and components name it as an import.
    #[must_use]
    pub const fn types(self) -> &'static str {
        match self {
            Self::One => "holdpoint:skill/types@1.0.0",
            Self::Two => "holdpoint:skill/types@2.0.0",
        }
    }

    /// The file with its text.
    #[must_use]
    pub const fn file(self) -> &'static str {
        match self {
            Self::One => "src/sdk/wit/skill.wit",
            Self::Two => "src/sdk/wit/2/skill.wit",
        }
    }
}

/// What a component says of itself.
pub struct ComponentDescription {
    /// Its task; the name of one that is not declared.
    pub task: Result<TaskKind, String>,
    /// Its interface as JSON.
    pub interface: String,
    /// The sensors that it can use.
    pub wanted: SensorSet,
}

/// Where a compiled component has its calls.
pub enum CallIndices {
    One(wit::skill::GuestIndices),
    Two(wit_2::skill::GuestIndices),
}

impl CallIndices {
    pub fn new(contract: SkillContract, pre: &InstancePre<Host>) -> wasmtime::Result<Self> {
        Ok(match contract {
            SkillContract::One => Self::One(wit::skill::GuestIndices::new(pre)?),
            SkillContract::Two => Self::Two(wit_2::skill::GuestIndices::new(pre)?),
        })
    }

    pub fn load(&self, store: &mut Store<Host>, instance: &Instance) -> wasmtime::Result<SkillCalls> {
        Ok(match self {
            Self::One(indices) => SkillCalls::One(indices.load(store, instance)?),
            Self::Two(indices) => SkillCalls::Two(indices.load(store, instance)?),
        })
    }
}

/// The calls of an instance.
pub enum SkillCalls {
    One(wit::skill::Guest),
    Two(wit_2::skill::Guest),
}

impl SkillCalls {
    pub fn describe(
        &self,
        store: &mut Store<Host>,
        parameters: &[Parameter],
    ) -> wasmtime::Result<Result<ComponentDescription, String>> {
        Ok(match self {
            Self::One(skill) => skill.call_describe(store, parameters)?.map(wit::description),
            Self::Two(skill) => {
                skill.call_describe(store, &wit_2::parameters(parameters))?.map(wit_2::description)
            }
        })
    }

    pub fn start(
        &self,
        store: &mut Store<Host>,
        seed: u64,
        parameters: &[Parameter],
        granted: &SensorSet,
    ) -> wasmtime::Result<Result<(), String>> {
        match self {
            Self::One(skill) => skill.call_start(store, seed, parameters),
            Self::Two(skill) => {
                skill.call_start(store, seed, &wit_2::parameters(parameters), &wit_2::sensors(granted))
            }
        }
    }

    /// The commands from this tick on. `None` if the contract has no such observation, or if what came is no answer.
    pub fn step(
        &self,
        store: &mut Store<Host>,
        seen: &Observation,
        granted: &SensorSet,
    ) -> wasmtime::Result<Option<CommandChunk>> {
        Ok(match self {
            Self::One(skill) => {
                // The code describes a task of the contract, so no cell gives it another one. The arm can have more
                // joints than the contract: the code must not act on some of them.
                let Some(handed) = wit::observation(seen) else { return Ok(None) };
                let answer = skill.call_tick(store, handed)?;
                wit::command(&answer).map(|first| CommandChunk { first, rest: Vec::new() })
            }
            Self::Two(skill) => {
                let answer = skill.call_step(store, &wit_2::observation(seen, granted))?;
                wit_2::chunk(&answer)
            }
        })
    }

    pub fn enter(&self, store: &mut Store<Host>, hook: Hook) -> wasmtime::Result<()> {
        match self {
            Self::One(skill) => skill.call_enter(store, wit::hook(hook)),
            Self::Two(skill) => skill.call_enter(store, wit_2::hook(hook)),
        }
    }
}
