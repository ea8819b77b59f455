//! A skill that is a WebAssembly component, confined.
//!
//! A component is given what its calls bring and nothing else; whatever its code does is an answer, a measured fault, or
//! nothing. It keeps the contract of `src/sdk/wit/2/skill.wit`, or the earlier one of `src/sdk/wit/skill.wit`
//! ([`SkillContract`]). [`Component::load`] holds it against the contract and asks it what it offers and needs;
//! [`Component::start`] begins one run: one store, one instance, one task.
//!
//! What bounds a run:
//!
//! - **Fuel** decides, and equal runs burn equal fuel: each tick gets the whole budget of the manifest. The calls
//!   around a task get a multiple of it, [`START_TICKS`] and [`ENTER_TICKS`].
//! - **A wall-clock limit** of seconds beside it: if a call reaches it, the machine stalled. The episode is void and
//!   says nothing about the code.
//! - **Memory** as the manifest declares it, over all memories of the instance; a larger request ends the run.
//! - **The outside world** is WASI 0.2 in an empty form that is the same for every run of one seed (`host.rs`).
//!
//! After a fault the code is not called again and the run answers [`holdpoint_body::Command::Hold`]: its caller reads
//! the fault from `confined()` and stops the arm.

mod chunk;
mod contract;
mod error;
mod host;
mod load;
mod parameters;
mod run;
mod scan;
mod sensors;
mod wasm_runtime;
mod wit;
mod wit_2;

// The guests of the tests beside this crate name it as everyone does.
#[cfg(test)]
extern crate self as holdpoint_component;
#[cfg(test)]
#[path = "tests/component/guest.rs"]
#[allow(dead_code, clippy::unwrap_used, reason = "the tests beside this crate use all of it")]
mod guest;

use holdpoint_governance::manifest::{FUEL_PER_US, Resources};

pub use chunk::CHUNK_COMMANDS_MAX;
pub use contract::SkillContract;
pub use error::{ComponentCall, ComponentError};
pub use holdpoint_compiled::CodeOrigin;
pub use host::LOG_BYTES_MAX;
pub use load::Component;
pub use parameters::PARAMETERS_MAX;
pub use run::ComponentRun;
pub use sensors::{ImageSpec, PixelFormat, SensorSet, VectorSpec};
pub use wasm_runtime::keep_compiled_in;

pub use holdpoint_governance::component::COMPONENT_BYTES_MAX;

/// The most bytes of the interface that a component describes.
pub const INTERFACE_BYTES_MAX: usize = 64 << 10;

/// Ticks' budgets that each of instantiation, `describe` and `start` has: one second of them.
pub const START_TICKS: u64 = holdpoint_body::RATE_HZ as u64;

/// Of a tick's fuel, what counts while a component is asked what it is: before any profile has looked at what it declares.
pub const DESCRIBE_FUEL_PER_TICK: u64 = 200_000;

/// The most that a manifest may declare for a component, whatever a profile allows: all of a tick's time, us, and memory, bytes.
const TICK_US_MAX: u64 = 1_000_000 / holdpoint_body::RATE_HZ as u64;
const MEMORY_BYTES_MAX: u64 = 256 << 20;

/// Ticks' budgets that `enter` has: the arm is moving when it is called.
pub const ENTER_TICKS: u64 = 2;

/// What a run may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ComponentLimits {
    /// Fuel of one tick.
    pub fuel_per_tick: u64,
    /// All memories of the instance together, bytes.
    pub memory_bytes: u64,
}

impl ComponentLimits {
    /// What a manifest's `permissions.resources` come to.
    #[must_use]
    pub fn of(resources: &Resources) -> Self {
        Self { fuel_per_tick: resources.fuel_per_tick(), memory_bytes: resources.memory_bytes() }
    }

    /// # Errors
    /// If it is more than there is.
    fn check(self) -> Result<(), ComponentError> {
        let of = [
            ("cpu_us_per_tick", self.fuel_per_tick / FUEL_PER_US, TICK_US_MAX),
            ("memory_kib", self.memory_bytes >> 10, MEMORY_BYTES_MAX >> 10),
        ];
        match of.into_iter().find(|(_, value, max)| value > max) {
            Some((field, value, max)) => Err(ComponentError::Limit { field, value, max }),
            None => Ok(()),
        }
    }
}
