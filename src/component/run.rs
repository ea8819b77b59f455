//! One run of a component: one store, one instance, one task.

use std::sync::Arc;

use wasmtime::{Store, Trap};

use holdpoint_body::{CodeFault, Command, Observation};
use holdpoint_skill::{ConfinementReport, Hook, Skill};
use holdpoint_text::Untrusted;

use crate::chunk::ChunkPlayer;
use crate::contract::SkillCalls;
use crate::host::{Host, HostState, HostTrap};
use crate::load::{CompiledComponent, LoadedComponent};
use crate::wasm_runtime::DEADLINE_EPOCHS;
use crate::{ComponentLimits, ENTER_TICKS, INTERFACE_BYTES_MAX, START_TICKS};

/// The most bytes that one call of the code hands over, in whatever form.
const HANDED_BYTES_MAX: usize = 2 * INTERFACE_BYTES_MAX;

/// What is there as long as the code did nothing wrong.
pub struct LiveInstance {
    store: Store<Host>,
    skill: SkillCalls,
}

/// What ended a call.
pub struct CallEnd {
    pub fault: CodeFault,
    pub error: wasmtime::Error,
}

impl LiveInstance {
    /// A fresh instance. The error comes with what the store came to.
    pub fn new(
        compiled: &CompiledComponent,
        limits: ComponentLimits,
        outside: HostState,
    ) -> Result<Self, (CallEnd, HostState, u64)> {
        let mut store = Store::new(compiled.pre.engine(), Host::new(outside, limits.memory_bytes));
        store.limiter(|host| host);
        store.set_hostcall_fuel(HANDED_BYTES_MAX);
        store.epoch_deadline_trap();
        let budget = limits.fuel_per_tick.saturating_mul(START_TICKS);
        let result = (|| -> wasmtime::Result<_> {
            store.set_fuel(budget)?;
            store.set_epoch_deadline(DEADLINE_EPOCHS);
            let instance = compiled.pre.instantiate(&mut store)?;
            compiled.skill.load(&mut store, &instance)
        })();
        match result {
            Ok(skill) => Ok(Self { store, skill }),
            Err(error) => {
                let ended = ended(store.data(), error);
                let host = store.into_data();
                Err((ended, host.outside, host.memory_largest))
            }
        }
    }

    /// Calls into the code with so much fuel; gives what it answered and what it took.
    pub fn call<T>(
        &mut self,
        fuel: u64,
        call: impl FnOnce(&mut Store<Host>, &SkillCalls) -> wasmtime::Result<T>,
    ) -> (Result<T, CallEnd>, u64) {
        self.store.set_epoch_deadline(DEADLINE_EPOCHS);
        let answer = match self.store.set_fuel(fuel) {
            Ok(()) => call(&mut self.store, &self.skill),
            Err(error) => Err(error),
        };
        let consumed = fuel.saturating_sub(self.store.get_fuel().unwrap_or(0));
        (answer.map_err(|error| ended(self.store.data(), error)), consumed)
    }

    pub fn host(&self) -> &Host {
        self.store.data()
    }
}

fn ended(host: &Host, error: wasmtime::Error) -> CallEnd {
    let fault = if host.refused {
        CodeFault::Memory
    } else if let Some(trap) = error.downcast_ref::<Trap>() {
        match trap {
            Trap::OutOfFuel => CodeFault::Fuel,
            Trap::Interrupt => CodeFault::Machine,
            _ => CodeFault::Trap,
        }
    } else if error.is::<HostTrap>() {
        CodeFault::Trap
    } else {
        // It came to an end, and what it gave cannot be read.
        CodeFault::Answer
    };
    CallEnd { fault, error }
}

struct RunState {
    /// `None` after a fault: what is wrong once is not called again.
    live: Option<LiveInstance>,
    fault: Option<CodeFault>,
    fuel_tick_max: u64,
    /// Of a run whose store is gone.
    memory_largest: u64,
    outside: Option<HostState>,
}

/// One run of a component. It cannot fail: what its code does wrong is its [`ConfinementReport::fault`], and from there on it holds.
pub struct ComponentRun {
    loaded: Arc<LoadedComponent>,
    inner: RunState,
    chunk: ChunkPlayer,
}

impl RunState {
    fn failed(ended: CallEnd, outside: HostState, memory_largest: u64) -> Self {
        Self {
            live: None,
            fault: Some(ended.fault),
            fuel_tick_max: 0,
            memory_largest,
            outside: Some(outside),
        }
    }

    fn instance(loaded: &LoadedComponent, outside: HostState) -> Self {
        match LiveInstance::new(&loaded.compiled, loaded.limits, outside) {
            Ok(live) => {
                Self { live: Some(live), fault: None, fuel_tick_max: 0, memory_largest: 0, outside: None }
            }
            Err((ended, outside, memory_largest)) => Self::failed(ended, outside, memory_largest),
        }
    }

    /// Nothing of the code is called any more.
    fn fail(&mut self, fault: CodeFault) {
        self.fault = Some(fault);
        if let Some(live) = self.live.take() {
            let host = live.store.into_data();
            self.memory_largest = host.memory_largest;
            self.outside = Some(host.outside);
        }
    }

    /// Calls into the code; `None` if it failed, now or before. `tick` says whether the fuel counts as a tick's.
    fn call<T>(
        &mut self,
        fuel: u64,
        tick: bool,
        call: impl FnOnce(&mut Store<Host>, &SkillCalls) -> wasmtime::Result<T>,
    ) -> Option<T> {
        let live = self.live.as_mut()?;
        let (answer, consumed) = live.call(fuel, call);
        if tick {
            self.fuel_tick_max = self.fuel_tick_max.max(consumed);
        }
        match answer {
            Ok(answer) => Some(answer),
            Err(ended) => {
                self.fail(ended.fault);
                None
            }
        }
    }
}

impl ComponentRun {
    /// A run that has begun: an instance, and `start`.
    pub(crate) fn start(loaded: Arc<LoadedComponent>, seed: u64) -> Self {
        let mut inner = RunState::instance(&loaded, HostState::new(seed));
        let fuel = loaded.limits.fuel_per_tick.saturating_mul(START_TICKS);
        let begun = inner
            .call(fuel, false, |store, skill| skill.start(store, seed, &loaded.parameters, &loaded.granted));
        if let Some(Err(_)) = begun {
            inner.fail(CodeFault::Answer);
        }
        Self { loaded, inner, chunk: ChunkPlayer::default() }
    }

    /// What the code wrote to its output, the first [`crate::LOG_BYTES_MAX`] bytes of it.
    #[must_use]
    pub fn log(&self) -> Untrusted {
        let inner = &self.inner;
        let outside = inner.live.as_ref().map(|live| &live.host().outside).or(inner.outside.as_ref());
        Untrusted::new(String::from_utf8_lossy(outside.map_or(&[], HostState::log)))
    }
}

impl Skill for ComponentRun {
    fn tick(&mut self, seen: &Observation) -> Command {
        if let Some(command) = self.chunk.play(seen) {
            return command;
        }
        let LoadedComponent { limits, granted, .. } = &*self.loaded;
        let fuel = limits.fuel_per_tick;
        let answer = self.inner.call(fuel, true, |store, skill| {
            store.data_mut().outside.tick = seen.tick;
            skill.step(store, seen, granted)
        });
        match answer {
            Some(Some(chunk)) => self.chunk.begin(chunk, seen.tick),
            Some(None) => {
                self.inner.fail(CodeFault::Answer);
                Command::Hold
            }
            None => Command::Hold,
        }
    }

    fn enter(&mut self, hook: Hook) {
        let fuel = self.loaded.limits.fuel_per_tick.saturating_mul(ENTER_TICKS);
        self.chunk.clear();
        self.inner.call(fuel, false, |store, skill| skill.enter(store, hook));
    }

    /// None: code that can save and restore its state knows that it is in a drill, and its hooks could behave well
    /// for just as long. An evaluation that begins in mid-task re-runs it from the start.
    fn fork(&self) -> Option<Box<dyn Skill>> {
        None
    }

    fn confined(&self) -> ConfinementReport {
        let inner = &self.inner;
        let memory_bytes =
            inner.live.as_ref().map_or(inner.memory_largest, |live| live.host().memory_largest);
        ConfinementReport { fuel_tick_max: inner.fuel_tick_max, memory_bytes, fault: inner.fault }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::sync::atomic::{AtomicBool, Ordering};

    use crate::guest::{Guest, seen};
    use crate::wasm_runtime::WasmRuntime;
    use crate::{Component, ComponentLimits};

    use super::*;

    #[test]
    fn call_stalled_by_the_machine_is_no_code_fault() {
        let limits = ComponentLimits { fuel_per_tick: u64::MAX, memory_bytes: 1 << 20 };
        let tick = "(loop (br 0)) unreachable".to_owned();
        let bytes = Guest { tick, ..Guest::default() }.bytes();
        let component =
            Component::within(&bytes, &serde_json::Value::Null, limits, &BTreeSet::new()).unwrap();
        let mut run = component.run(1);
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            // Seconds that pass in no time.
            scope.spawn(|| {
                while !over.load(Ordering::Acquire) {
                    WasmRuntime::get().unwrap().engine.increment_epoch();
                    std::thread::yield_now();
                }
            });
            let command = run.tick(&seen(0));
            over.store(true, Ordering::Release);
            assert_eq!(command, Command::Hold);
        });
        let fault = run.confined().fault.unwrap();
        assert_eq!(fault, CodeFault::Machine);
        assert!(fault.is_infrastructure());
    }
}
