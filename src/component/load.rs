//! From bytes to a component that is known to keep the contract.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde_json::Value;
use wasmtime::Engine;
use wasmtime::component::types::{ComponentFunc, ComponentItem};
use wasmtime::component::{InstancePre, types::Component as ComponentType};

use holdpoint_body::{CodeFault, TaskKind};
use holdpoint_compiled::CodeOrigin;
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::{Digest, canonical_json};
use holdpoint_governance::mode::Sensor;
use holdpoint_skill::Skill;

use crate::contract::{CallIndices, SkillContract};
use crate::error::{ComponentCall, ComponentError, line, reason};
use crate::host::{self, Host, HostState};
use crate::parameters;
use crate::run::{CallEnd, ComponentRun, LiveInstance};
use crate::scan::scan;
use crate::sensors::SensorSet;
use crate::wasm_runtime::WasmRuntime;
use crate::wit::types;
use crate::wit_2::types as types_2;
use crate::{COMPONENT_BYTES_MAX, ComponentLimits, DESCRIBE_FUEL_PER_TICK, INTERFACE_BYTES_MAX, START_TICKS};

/// What a source compiles to, whatever its parameters and limits.
pub struct CompiledComponent {
    pub pre: InstancePre<Host>,
    pub skill: CallIndices,
    contract: SkillContract,
    imports: BTreeSet<String>,
    origin: CodeOrigin,
}

/// What is the same for every run.
pub struct LoadedComponent {
    pub compiled: Arc<CompiledComponent>,
    pub parameters: Vec<types::Parameter>,
    pub limits: ComponentLimits,
    /// Of the sensors that the code asks for, those that a cell can deliver.
    pub granted: SensorSet,
    wanted: SensorSet,
    digest: Digest,
    interface: Interface,
    task: TaskKind,
}

/// A skill that is a WebAssembly component: loaded, checked against the contract, not running. Copies share the code.
#[derive(Clone)]
pub struct Component(Arc<LoadedComponent>);

impl std::fmt::Debug for Component {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Component").field("digest", &self.0.digest).finish_non_exhaustive()
    }
}

/// The package of an interface's name: `wasi:clocks` of `wasi:clocks/wall-clock@0.2.3`.
fn package(name: &str) -> &str {
    name.split('/').next().unwrap_or(name)
}

/// Whether a name is one of WASI 0.2.
fn is_wasi(name: &str) -> bool {
    name.starts_with("wasi:")
        && name.split_once('@').is_some_and(|(_, version)| version == "0.2" || version.starts_with("0.2."))
}

impl CompiledComponent {
    /// Holds what a component imports and exports against the contract.
    pub(crate) fn new(
        engine: &Engine,
        component: &wasmtime::component::Component,
        origin: CodeOrigin,
    ) -> Result<Self, ComponentError> {
        let ty = component.component_type();
        let contract = exported(engine, &ty)?;
        let imports = imported(engine, &ty)?;
        let linker = host::linker(engine, component)
            .map_err(|error| ComponentError::ImportType { reason: reason(&error) })?;
        let pre = linker
            .instantiate_pre(component)
            .map_err(|error| ComponentError::ImportType { reason: reason(&error) })?;
        let missing = |name: &'static str| {
            move |error| ComponentError::ExportType { name: name.to_owned(), reason: reason(&error) }
        };
        let skill = CallIndices::new(contract, &pre).map_err(missing(contract.skill()))?;
        Ok(Self { pre, skill, contract, imports, origin })
    }
}

/// The interfaces that a component imports; only those of WASI, and types of the contract, are allowed.
fn imported(engine: &Engine, ty: &ComponentType) -> Result<BTreeSet<String>, ComponentError> {
    let mut imports = BTreeSet::new();
    for (name, import) in ty.imports(engine) {
        let refused = || ComponentError::Import { name: line(name) };
        let ComponentItem::ComponentInstance(interface) = &import.ty else { return Err(refused()) };
        let mut items = interface.exports(engine);
        let is_types = [SkillContract::One, SkillContract::Two].iter().any(|one| one.types() == name);
        if is_types && items.all(|(_, item)| matches!(item.ty, ComponentItem::Type(_))) {
            continue;
        }
        if !is_wasi(name) {
            return Err(refused());
        }
        imports.insert(name.to_owned());
    }
    Ok(imports)
}

/// Holds the exports against the contract, one by one, so that the first that is not so is named. A component that exports
/// neither contract is asked for the second one.
fn exported(engine: &Engine, ty: &ComponentType) -> Result<SkillContract, ComponentError> {
    type ExportCheck =
        fn(&ComponentFunc, &wasmtime::component::__internal::InstanceType<'_>) -> wasmtime::Result<()>;
    let cx = ty.instance_type();
    let hold = |interface: &str, functions: &[(&str, ExportCheck)]| {
        let missing = |name: String| ComponentError::NoExport { name };
        let Some(export) = ty.get_export(engine, interface) else {
            return Err(missing(interface.to_owned()));
        };
        let other = |name: String, reason: String| ComponentError::ExportType { name, reason };
        let ComponentItem::ComponentInstance(instance) = export.ty else {
            return Err(other(interface.to_owned(), "it is no interface".to_owned()));
        };
        for (function, check) in functions {
            let name = format!("{interface}#{function}");
            match instance.get_export(engine, function).map(|export| export.ty) {
                None => return Err(missing(name)),
                Some(ComponentItem::ComponentFunc(found)) => {
                    check(&found, &cx).map_err(|error| other(name, reason(&error)))?;
                }
                Some(_) => return Err(other(name, "it is no function".to_owned())),
            }
        }
        Ok(())
    };
    let exports = |contract: SkillContract| ty.get_export(engine, contract.skill()).is_some();
    if exports(SkillContract::Two) || !exports(SkillContract::One) {
        hold(
            SkillContract::Two.skill(),
            &[
                ("describe", |f, cx| {
                    f.typecheck::<(&[types_2::Parameter],), (Result<types_2::Description, String>,)>(cx)
                }),
                ("start", |f, cx| {
                    f.typecheck::<(u64, &[types_2::Parameter], &types_2::Sensors), (Result<(), String>,)>(cx)
                }),
                ("step", |f, cx| f.typecheck::<(&types_2::Observation,), (Vec<types_2::Command>,)>(cx)),
                ("enter", |f, cx| f.typecheck::<(types_2::Hook,), ()>(cx)),
            ],
        )?;
        return Ok(SkillContract::Two);
    }
    hold(
        SkillContract::One.skill(),
        &[
            ("describe", |f, cx| {
                f.typecheck::<(&[types::Parameter],), (Result<types::Description, String>,)>(cx)
            }),
            ("start", |f, cx| f.typecheck::<(u64, &[types::Parameter]), (Result<(), String>,)>(cx)),
            ("tick", |f, cx| f.typecheck::<(&types::Observation,), (types::Command,)>(cx)),
            ("enter", |f, cx| f.typecheck::<(types::Hook,), ()>(cx)),
        ],
    )?;
    Ok(SkillContract::One)
}

/// Whether the bytes begin like a component's.
fn begins(bytes: &[u8]) -> Result<(), ComponentError> {
    match bytes {
        [0, b'a', b's', b'm', 0x0d, 0, 1, 0, ..] => Ok(()),
        [0, b'a', b's', b'm', 1, 0, 0, 0, ..] => Err(ComponentError::CoreModule),
        _ => {
            let begins: Vec<String> = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
            let begins = if begins.is_empty() { "nothing".to_owned() } else { begins.join(" ") };
            Err(ComponentError::NotWasm { begins })
        }
    }
}

impl Component {
    /// Loads a component and asks it for its offer and its needs. `parameters` is the value of its parameter file, null if it has none;
    /// `imports` are the packages that its manifest lets it import, e.g. `wasi:clocks`.
    ///
    /// # Errors
    /// One for each way in which the bytes are no skill, see [`ComponentError`].
    pub fn load(
        bytes: &[u8],
        parameters: &Value,
        limits: ComponentLimits,
        imports: &BTreeSet<String>,
    ) -> Result<Self, ComponentError> {
        if bytes.len() > COMPONENT_BYTES_MAX {
            return Err(ComponentError::TooLarge { bytes: bytes.len() });
        }
        limits.check()?;
        Self::within(bytes, parameters, limits, imports)
    }

    /// As [`Self::load`], whatever the limits are.
    pub(crate) fn within(
        bytes: &[u8],
        parameters: &Value,
        limits: ComponentLimits,
        imports: &BTreeSet<String>,
    ) -> Result<Self, ComponentError> {
        begins(bytes)?;
        scan(bytes)?;
        let canonical = canonical_json(parameters)
            .map_err(|error| ComponentError::Canonical { reason: line(error.to_string()) })?;
        let parameters = parameters::flat(parameters)?;
        let compiled = WasmRuntime::get()?.compiled(bytes)?;
        let undeclared = compiled.imports.iter().find(|name| !imports.contains(package(name)));
        if let Some(name) = undeclared {
            return Err(ComponentError::Undeclared {
                name: line(name.clone()),
                package: line(package(name)),
            });
        }
        let digest = Digest::of_parts(
            "holdpoint.component.v1",
            &[
                bytes,
                canonical.as_bytes(),
                &limits.fuel_per_tick.to_le_bytes(),
                &limits.memory_bytes.to_le_bytes(),
            ],
        );
        let (task, interface, wanted) = describe(&compiled, &parameters, limits)?;
        let granted = wanted.deliverable();
        Ok(Self(Arc::new(LoadedComponent {
            compiled,
            parameters,
            limits,
            granted,
            wanted,
            digest,
            interface,
            task,
        })))
    }
}

impl Component {
    /// Over all that determines the behavior: source, parameters and limits.
    #[must_use]
    pub fn digest(&self) -> Digest {
        self.0.digest
    }

    /// What the code says it offers and needs.
    #[must_use]
    pub fn interface(&self) -> &Interface {
        &self.0.interface
    }

    /// The primitive the code performs.
    #[must_use]
    pub fn task(&self) -> TaskKind {
        self.0.task
    }

    /// The contract that the code keeps.
    #[must_use]
    pub fn contract(&self) -> SkillContract {
        self.0.compiled.contract
    }

    /// The sensors beside those of every observation that the code can use.
    #[must_use]
    pub fn wanted_sensors(&self) -> &SensorSet {
        &self.0.wanted
    }

    /// The interfaces of WASI that the code imports, with their versions.
    #[must_use]
    pub fn imports(&self) -> &BTreeSet<String> {
        &self.0.compiled.imports
    }

    /// Where its compiled form came from when this process first needed it.
    #[must_use]
    pub fn origin(&self) -> CodeOrigin {
        self.0.compiled.origin
    }

    /// Begins a run. What fails in its beginning is a fault of the run.
    #[must_use]
    pub fn run(&self, seed: u64) -> ComponentRun {
        ComponentRun::start(self.0.clone(), seed)
    }

    /// As [`Self::run`], for callers that handle any skill.
    #[must_use]
    pub fn start(&self, seed: u64) -> Box<dyn Skill> {
        Box::new(self.run(seed))
    }
}

/// Asks the code what it offers and needs, in an instance of its own.
fn describe(
    compiled: &CompiledComponent,
    parameters: &[types::Parameter],
    limits: ComponentLimits,
) -> Result<(TaskKind, Interface, SensorSet), ComponentError> {
    // The declaration is not checked yet: until then the code gets only what a description needs.
    let limits =
        ComponentLimits { fuel_per_tick: limits.fuel_per_tick.min(DESCRIBE_FUEL_PER_TICK), ..limits };
    let fuel = limits.fuel_per_tick.saturating_mul(START_TICKS);
    let failed = |call: ComponentCall| {
        move |CallEnd { fault, error }: CallEnd| match fault {
            CodeFault::Trap => ComponentError::Trapped { call, reason: reason(&error) },
            CodeFault::Fuel => ComponentError::Fuel { call, fuel, ticks: START_TICKS },
            CodeFault::Memory => ComponentError::Memory { call, memory_bytes: limits.memory_bytes },
            CodeFault::Answer => ComponentError::Answer { reason: reason(&error) },
            CodeFault::Machine => ComponentError::Machine { call },
        }
    };
    let mut live = LiveInstance::new(compiled, limits, HostState::new(0))
        .map_err(|(ended, _, _)| failed(ComponentCall::Instantiate)(ended))?;
    let (answer, _) = live.call(fuel, |store, skill| skill.describe(store, parameters));
    let result = answer.map_err(failed(ComponentCall::Describe))?;
    let description = result.map_err(|text| ComponentError::Refused { reason: line(text) })?;
    if description.interface.len() > INTERFACE_BYTES_MAX {
        return Err(ComponentError::InterfaceSize { bytes: description.interface.len() });
    }
    let mut interface: Interface = serde_json::from_str(&description.interface)
        .map_err(|error| ComponentError::Interface { reason: line(error.to_string()) })?;
    let task = description.task.map_err(|name| ComponentError::Task { name: line(name) })?;
    if let Some(name) = description.wanted.first_refused() {
        return Err(ComponentError::Sensor { name: line(name) });
    }
    if !description.wanted.is_empty() {
        // What the code asks for counts, whatever its interface says.
        interface.sensors.insert(Sensor::Named);
    }
    Ok((task, interface, description.wanted))
}
