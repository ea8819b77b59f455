//! Shared by the process: the engine that compiles and runs components, and the compiled components.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::thread;
use std::time::Duration;

use wasmtime::{Config, Engine, OperatorCost, OptLevel};
use zeroize::Zeroizing;

use holdpoint_compiled::{CodeOrigin, CompiledForms};
use holdpoint_governance::ids::Digest;

use crate::error::{ComponentError, reason};
use crate::load::CompiledComponent;

/// The interval of the epochs, in which the deadline of a call is counted.
const EPOCH_INTERVAL: Duration = Duration::from_millis(250);

/// A call ends after this number of epochs (10 s) of wall time. Fuel bounds the code, so the machine stalled.
pub const DEADLINE_EPOCHS: u64 = 40;

/// The stack of a component's code; deeper recursion is a trap.
const STACK_BYTES: usize = 256 << 10;

type ComponentSlot = Arc<Mutex<Weak<CompiledComponent>>>;

pub struct WasmRuntime {
    pub engine: Engine,
    /// The compiled components in use, by the digest of their source.
    compiled: Mutex<BTreeMap<Digest, ComponentSlot>>,
}

/// The store of compiled forms; without one, nothing is stored.
static COMPILED_FORMS: Mutex<Option<Arc<CompiledForms>>> = Mutex::new(None);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The fuel that instructions cost. An instruction that the runtime runs as a call takes as long as hundreds of others, and
/// would cost as much as one. Those that move memory also cost fuel by length.
const fn costs() -> OperatorCost {
    let mut costs = OperatorCost::new();
    costs.RefFunc = 100;
    costs.ElemDrop = 100;
    costs.DataDrop = 100;
    costs.MemoryGrow = 200;
    costs.TableGrow = 200;
    costs.MemoryInit = 100;
    costs.MemoryCopy = 50;
    costs.MemoryFill = 50;
    costs.TableInit = 100;
    costs.TableCopy = 100;
    costs.TableFill = 100;
    costs
}

fn config() -> Config {
    let mut config = Config::new();
    config
        .consume_fuel(true)
        .operator_cost(costs())
        .epoch_interruption(true)
        .cranelift_nan_canonicalization(true)
        .cranelift_opt_level(OptLevel::Speed)
        .max_wasm_stack(STACK_BYTES)
        .wasm_relaxed_simd(false)
        .relaxed_simd_deterministic(true)
        .wasm_memory64(false)
        .wasm_multi_memory(false)
        .wasm_custom_page_sizes(false)
        .wasm_wide_arithmetic(false)
        .wasm_backtrace_max_frames(None)
        .generate_address_map(false)
        .native_unwind_info(false);
    config
}

impl WasmRuntime {
    fn new() -> Result<Self, ComponentError> {
        let engine =
            Engine::new(&config()).map_err(|error| ComponentError::Engine { reason: reason(&error) })?;
        let weak = engine.weak();
        thread::Builder::new()
            .name("component-clock".to_owned())
            .spawn(move || {
                loop {
                    thread::sleep(EPOCH_INTERVAL);
                    let Some(engine) = weak.upgrade() else { return };
                    engine.increment_epoch();
                }
            })
            .map_err(|error| ComponentError::Engine { reason: error.to_string() })?;
        Ok(Self { engine, compiled: Mutex::default() })
    }

    /// The runtime of this process.
    ///
    /// # Errors
    /// If components cannot be run here.
    pub fn get() -> Result<&'static Self, ComponentError> {
        static RUNTIME: OnceLock<Result<WasmRuntime, ComponentError>> = OnceLock::new();
        RUNTIME.get_or_init(Self::new).as_ref().map_err(Clone::clone)
    }

    /// The compiled form of a source; it is compiled once as long as it is in use.
    ///
    /// # Errors
    /// If the source is not a valid component.
    pub fn compiled(&self, source: &[u8]) -> Result<Arc<CompiledComponent>, ComponentError> {
        let digest = Digest::of_parts("holdpoint.component-source.v1", &[source]);
        let slot = {
            let mut slots = lock(&self.compiled);
            slots.retain(|_, slot| Arc::strong_count(slot) > 1 || lock(slot).strong_count() > 0);
            slots.entry(digest).or_default().clone()
        };
        let mut cached = lock(&slot);
        if let Some(compiled) = cached.upgrade() {
            return Ok(compiled);
        }
        let forms = lock(&COMPILED_FORMS).clone();
        // A panic in the compiler is an error of the source and must not end the caller.
        let result = catch_unwind(AssertUnwindSafe(|| match forms {
            Some(forms) => forms.component(&self.engine, source),
            None => wasmtime::component::Component::from_binary(&self.engine, source)
                .map(|component| (component, CodeOrigin::Compiled)),
        }));
        let result = result.map_err(|_| ComponentError::Invalid {
            reason: "the compiler failed on it; nothing of it is kept".to_owned(),
        })?;
        let (component, origin) =
            result.map_err(|error| ComponentError::Invalid { reason: reason(&error) })?;
        let compiled = Arc::new(CompiledComponent::new(&self.engine, &component, origin)?);
        *cached = Arc::downgrade(&compiled);
        Ok(compiled)
    }
}

/// Names the folder in which this process stores compiled forms from now on, and the secret that authenticates them.
pub fn keep_compiled_in(folder: PathBuf, secret: [u8; 32]) {
    *lock(&COMPILED_FORMS) = Some(Arc::new(CompiledForms::new(folder, Zeroizing::new(secret))));
}
