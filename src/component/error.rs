//! Why a component cannot be taken in: one clear error each.

use std::borrow::Cow;

use holdpoint_text::{Hint, Untrusted};

use crate::{COMPONENT_BYTES_MAX, INTERFACE_BYTES_MAX, PARAMETERS_MAX, SkillContract};

/// Which call into a component an error is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComponentCall {
    /// Its instance is made; a start function of its modules runs.
    Instantiate,
    /// It says what it offers and needs.
    Describe,
}

impl std::fmt::Display for ComponentCall {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Instantiate => "its instance is made",
            Self::Describe => "`describe` is called",
        })
    }
}

/// Why a component could not be loaded. Texts of the component are in it made safe to print.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ComponentError {
    /// Not WebAssembly at all.
    #[error(
        "the file is no WebAssembly: it begins with {begins}, a component begins with 00 61 73 6d 0d 00 01 00"
    )]
    NotWasm {
        /// Its first bytes in hexadecimal.
        begins: String,
    },
    /// A core module.
    #[error("the file is a WebAssembly core module, and a component is needed")]
    CoreModule,
    /// Larger than allowed.
    #[error("the component has {bytes} bytes, too many: {COMPONENT_BYTES_MAX} are allowed")]
    TooLarge {
        /// How many it has.
        bytes: usize,
    },
    /// WebAssembly says that it is none, or it uses what is switched off.
    #[error("the component is not valid: {reason}")]
    Invalid {
        /// What the compiler says.
        reason: String,
    },
    /// More of something than a skill's code has.
    #[error("the component has {count} {what}, too many: {max} are allowed")]
    TooMuch {
        /// What there is too much of.
        what: &'static str,
        /// How many there are, as far as they were counted.
        count: usize,
        /// How many are allowed.
        max: usize,
    },
    /// A component within it has functions of its own.
    #[error(
        "a component within the component has functions of its own; a skill is one component, and modules within it"
    )]
    Composed,
    /// It may use more than there is.
    #[error(
        "the manifest's permissions.resources.{field} is {value}, more than there is: at most {max} are allowed"
    )]
    Limit {
        /// Which one.
        field: &'static str,
        /// Its message.
        value: u64,
        /// The most.
        max: u64,
    },
    /// It defines a resource.
    #[error("the component defines a resource of its own; a skill's messages are plain values")]
    Resource,
    /// An export is missing.
    #[error("the component does not export {name}")]
    NoExport {
        /// Which one.
        name: String,
    },
    /// An export has another type.
    #[error("the component's export {name} has another type than the WIT says: {reason}")]
    ExportType {
        /// Which one.
        name: String,
        /// What differs.
        reason: String,
    },
    /// Something is imported that no component is given.
    #[error("the component imports {name}; it may import wasi:*@0.2 and nothing else")]
    Import {
        /// What it is.
        name: String,
    },
    /// A package is imported that the manifest does not list.
    #[error("the component imports {name}, and its manifest does not list the package {package}")]
    Undeclared {
        /// The interface it imports.
        name: String,
        /// Its package, as it is listed.
        package: String,
    },
    /// An import has another type than WASI 0.2 says.
    #[error("the component's imports are not those of WASI 0.2: {reason}")]
    ImportType {
        /// What differs.
        reason: String,
    },
    /// The parameter file has too many values.
    #[error("the parameters are {count} values, too many: {PARAMETERS_MAX} are allowed")]
    Parameters {
        /// How many there are.
        count: usize,
    },
    /// A parameter is neither number, flag nor text.
    #[error(
        "the parameter {name} is {kind}; a component takes numbers, flags, texts, and tables and arrays of them"
    )]
    Parameter {
        /// Its dotted name.
        name: String,
        /// What it is.
        kind: &'static str,
    },
    /// The code trapped.
    #[error("the component trapped while {call}: {reason}")]
    Trapped {
        /// In which call.
        call: ComponentCall,
        /// What the trap was.
        reason: String,
    },
    /// It needed more fuel than it has.
    #[error("the component needs more than its budget while {call}: {fuel} of fuel, {ticks} times a tick's")]
    Fuel {
        /// In which call.
        call: ComponentCall,
        /// The budget.
        fuel: u64,
        /// How many ticks' budgets that is.
        ticks: u64,
    },
    /// It asked for more memory or table than it declares.
    #[error(
        "the component asks for more memory or table than it may have while {call}: {memory_bytes} bytes of memory are declared"
    )]
    Memory {
        /// In which call.
        call: ComponentCall,
        /// What is declared.
        memory_bytes: u64,
    },
    /// What `describe` gave cannot be read.
    #[error("what the component's `describe` gave cannot be read: {reason}")]
    Answer {
        /// Why not.
        reason: String,
    },
    /// It performs a task that is not declared.
    #[error("the component performs the task {name:?}, and there is no such task")]
    Task {
        /// The name of the task.
        name: String,
    },
    /// It asks for a sensor that cannot be granted.
    #[error("the component asks for the sensor {name:?}, which cannot be granted")]
    Sensor {
        /// The name of the first such sensor.
        name: String,
    },
    /// `describe` gave an error.
    #[error("the component's `describe` refuses its parameters: {reason}")]
    Refused {
        /// Its message.
        reason: String,
    },
    /// The interface is too long.
    #[error(
        "the interface that the component describes has {bytes} bytes, too many: {INTERFACE_BYTES_MAX} are allowed"
    )]
    InterfaceSize {
        /// How many it has.
        bytes: usize,
    },
    /// The interface is none.
    #[error("the interface that the component describes is none: {reason}")]
    Interface {
        /// What the parser says.
        reason: String,
    },
    /// The machine stood still; nothing is known of the component.
    #[error("the machine took too long while {call}: nothing is known of the component")]
    Machine {
        /// In which call.
        call: ComponentCall,
    },
    /// This process cannot run components.
    #[error("components cannot be run here: {reason}")]
    Engine {
        /// Why not.
        reason: String,
    },
    /// A value has no canonical form.
    #[error("the parameters have no canonical form: {reason}")]
    Canonical {
        /// What has none.
        reason: String,
    },
}

impl Hint for ComponentError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        Some(match self {
            Self::NotWasm { .. } | Self::CoreModule => {
                "`holdpoint skill build` makes a component of your code".into()
            }
            Self::TooLarge { .. } => "build it for size and without debug information".into(),
            Self::NoExport { name } | Self::ExportType { name, .. } => {
                let of_first = name.starts_with(SkillContract::One.skill());
                let contract = if of_first { SkillContract::One } else { SkillContract::Two };
                format!("the interface {} is in {}", contract.skill(), contract.file()).into()
            }
            Self::Composed => "link its parts into one module, or into modules of one component".into(),
            Self::Limit { .. } => "declare what the code needs: the profile allows less than there is".into(),
            Self::Undeclared { package, .. } => {
                format!("add \"{package}\" to `deployment.imports` in manifest.toml, or build without it")
                    .into()
            }
            Self::Import { .. } => "build it for WASI 0.2, or without imports".into(),
            Self::Fuel { .. } => "raise `permissions.resources.cpu_us_per_tick`, or do less there".into(),
            Self::Memory { .. } => "raise `permissions.resources.memory_kib`, or ask for less".into(),
            Self::Machine { .. } => "try again when the machine is less busy".into(),
            Self::Interface { .. } => {
                "it is JSON with the fields that `description.interface` in the WIT names, and no others"
                    .into()
            }
            Self::Sensor { .. } => {
                "at most 4 images of 1024 pixels a side and 8 vectors of 256 numbers, each named once".into()
            }
            Self::Invalid { .. }
            | Self::TooMuch { .. }
            | Self::Resource
            | Self::ImportType { .. }
            | Self::Parameters { .. }
            | Self::Parameter { .. }
            | Self::Trapped { .. }
            | Self::Answer { .. }
            | Self::Refused { .. }
            | Self::Task { .. }
            | Self::InterfaceSize { .. }
            | Self::Engine { .. }
            | Self::Canonical { .. } => return None,
        })
    }
}

/// A text of the component or about it, on one line and safe to print.
pub(crate) fn line(text: impl Into<String>) -> String {
    Untrusted::new(text).line().into_string()
}

/// What wasmtime says, with its reasons, on one line and safe to print.
pub(crate) fn reason(error: &wasmtime::Error) -> String {
    let chain: Vec<String> = error.chain().map(ToString::to_string).collect();
    line(chain.join(": "))
}
