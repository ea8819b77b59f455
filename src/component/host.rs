//! What a run's code is given: memory up to a limit, and WASI 0.2 in a deterministic, empty form.
//!
//! Ordinary toolchains link their libraries against WASI, whatever the code does. So its interfaces exist, and give
//! the same results in every run: the wall clock is fixed, the monotonic clock counts ticks, and random numbers come
//! from the run's seed. There are no files, arguments, environment or input; no call waits; output goes into a
//! bounded log. A call that needs a file or a socket traps, because no component has one.

use wasmtime::component::types::ComponentItem;
use wasmtime::component::{
    ComponentType, Lift, Linker, LinkerInstance, Lower, Resource, ResourceType, WasmList,
};
use wasmtime::{Engine, StoreContextMut};

use holdpoint_body::RATE_HZ;

/// The most bytes of output that a run's log keeps.
pub const LOG_BYTES_MAX: usize = 16 << 10;

/// The most elements that all tables of a run have together.
const TABLE_ELEMENTS_MAX: usize = 1 << 16;

/// The most bytes that one call takes or gives.
const CALL_BYTES_MAX: usize = 4 << 10;

/// The most handles that a run has at a time.
const HANDLES_MAX: u32 = 1_024;

/// What a call of the host costs beside the bytes it moves: about what it takes, so that it cannot be had for nothing.
const CALL_FUEL: u64 = 200;

/// The wall clock: 2000-01-01, in s since 1970. It stands still.
const WALL_SECS: u64 = 946_684_800;

/// Why the host ended a call of the code.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct HostTrap(String);

fn trap<T>(text: impl Into<String>) -> wasmtime::Result<T> {
    Err(HostTrap(text.into()).into())
}

/// A SplitMix64 stream.
#[derive(Clone, Copy)]
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

/// What a run's code can change outside its own memory.
#[derive(Clone)]
pub struct HostState {
    random: SplitMix,
    log: Vec<u8>,
    /// Ticks since the task started.
    pub tick: u64,
}

/// The host's side of one instance.
pub struct Host {
    pub outside: HostState,
    handles: u32,
    memory_max: usize,
    memory: usize,
    table_elements: usize,
    /// The largest memory so far, bytes.
    pub memory_largest: u64,
    /// It asked for more memory or table than it may have.
    pub refused: bool,
}

impl HostState {
    pub const fn new(seed: u64) -> Self {
        Self { random: SplitMix(seed), log: Vec::new(), tick: 0 }
    }

    /// What the code wrote to its output, up to [`LOG_BYTES_MAX`].
    pub fn log(&self) -> &[u8] {
        &self.log
    }
}

impl Host {
    pub fn new(outside: HostState, memory_bytes: u64) -> Self {
        Self {
            outside,
            handles: 0,
            memory_max: usize::try_from(memory_bytes).unwrap_or(usize::MAX),
            memory: 0,
            table_elements: 0,
            memory_largest: 0,
            refused: false,
        }
    }

    /// One more handle of the code's.
    fn handle<T: 'static>(&mut self, rep: u32) -> wasmtime::Result<Resource<T>> {
        if self.handles >= HANDLES_MAX {
            return trap(format!("more than {HANDLES_MAX} handles of WASI at a time"));
        }
        self.handles += 1;
        Ok(Resource::new_own(rep))
    }
}

impl wasmtime::ResourceLimiter for Host {
    fn memory_growing(&mut self, now: usize, wanted: usize, _: Option<usize>) -> wasmtime::Result<bool> {
        let all = self.memory.saturating_add(wanted.saturating_sub(now));
        if all > self.memory_max {
            self.refused = true;
            return trap(format!("{all} bytes of memory, and {} are declared", self.memory_max));
        }
        self.memory = all;
        self.memory_largest = self.memory_largest.max(all as u64);
        Ok(true)
    }

    fn memory_grow_failed(&mut self, error: wasmtime::Error) -> wasmtime::Result<()> {
        // What was counted is not there: a run that goes on with a wrong count is none.
        Err(error)
    }

    fn table_growing(&mut self, now: usize, wanted: usize, _: Option<usize>) -> wasmtime::Result<bool> {
        let all = self.table_elements.saturating_add(wanted.saturating_sub(now));
        if all > TABLE_ELEMENTS_MAX {
            self.refused = true;
            return trap(format!("{all} table elements, and {TABLE_ELEMENTS_MAX} are allowed"));
        }
        self.table_elements = all;
        Ok(true)
    }

    fn table_grow_failed(&mut self, error: wasmtime::Error) -> wasmtime::Result<()> {
        Err(error)
    }

    fn instances(&self) -> usize {
        32
    }

    fn tables(&self) -> usize {
        16
    }

    fn memories(&self) -> usize {
        8
    }
}

/// `wasi:io/error`'s only resource.
struct IoError;
/// `wasi:io/poll`'s only resource.
struct Pollable;
struct InputStream;
struct OutputStream;
/// Every other resource; no component ever has one.
struct UnsupportedResource;

#[derive(ComponentType, Lift, Lower)]
#[component(variant)]
enum StreamError {
    #[component(name = "last-operation-failed")]
    LastOperationFailed(Resource<IoError>),
    #[component(name = "closed")]
    Closed,
}

#[derive(ComponentType, Lift, Lower)]
#[component(record)]
struct Datetime {
    seconds: u64,
    nanoseconds: u32,
}

type HostContext<'a> = StoreContextMut<'a, Host>;

/// Takes the fuel of a call that moves so many bytes.
fn charge(cx: &mut HostContext, bytes: usize) -> wasmtime::Result<()> {
    let left = cx.get_fuel()?;
    match left.checked_sub(CALL_FUEL + bytes as u64) {
        Some(left) => cx.set_fuel(left),
        None => Err(wasmtime::Trap::OutOfFuel.into()),
    }
}

/// Random bytes of the run's seed.
fn random(cx: &mut HostContext, length: u64) -> wasmtime::Result<Vec<u8>> {
    let Some(length) = usize::try_from(length).ok().filter(|wanted| *wanted <= CALL_BYTES_MAX) else {
        return trap(format!("{length} random bytes in one call, and {CALL_BYTES_MAX} are allowed"));
    };
    charge(cx, length)?;
    let stream = &mut cx.data_mut().outside.random;
    let mut bytes = Vec::with_capacity(length.next_multiple_of(8));
    while bytes.len() < length {
        bytes.extend(stream.next().to_le_bytes());
    }
    bytes.truncate(length);
    Ok(bytes)
}

/// Takes what is written; what does not fit into the log is dropped.
fn write(cx: &mut HostContext, bytes: &WasmList<u8>) -> wasmtime::Result<Result<(), StreamError>> {
    if bytes.len() > CALL_BYTES_MAX {
        return trap(format!("{} bytes in one write, and {CALL_BYTES_MAX} are allowed", bytes.len()));
    }
    charge(cx, bytes.len())?;
    let length = bytes.len().min(LOG_BYTES_MAX.saturating_sub(cx.data().outside.log.len()));
    let written = bytes.as_le_slice(&*cx)[..length].to_vec();
    cx.data_mut().outside.log.extend(written);
    Ok(Ok(()))
}

/// A result of WASI itself, e.g. of an end with success or without.
type ExitStatusResult = Result<(), ()>;

/// Defines a function of an interface if it is one that this host has; `false` if not.
fn known(linker: &mut LinkerInstance<'_, Host>, interface: &str, name: &str) -> wasmtime::Result<bool> {
    type InputArgs = (Resource<InputStream>,);
    type OutputArgs = (Resource<OutputStream>,);
    type BytesResult = (Result<Vec<u8>, StreamError>,);
    type CountResult = (Result<u64, StreamError>,);
    type UnitResult = (Result<(), StreamError>,);
    // Time in ns since the task started: every tick the same for every run.
    let now = |cx: &HostContext| -> u64 {
        let nanos = u128::from(cx.data().outside.tick) * 1_000_000_000 / u128::from(RATE_HZ);
        u64::try_from(nanos).unwrap_or(u64::MAX)
    };
    let pollable = |mut cx: HostContext| -> wasmtime::Result<(Resource<Pollable>,)> {
        charge(&mut cx, 0)?;
        Ok((cx.data_mut().handle(0)?,))
    };
    match (interface, name) {
        ("wasi:cli/environment", "get-environment") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((Vec::<(String, String)>::new(),))
            })
        }
        ("wasi:cli/environment", "get-arguments") => linker.func_wrap(name, |mut cx: HostContext, (): ()| {
            charge(&mut cx, 0)?;
            Ok((Vec::<String>::new(),))
        }),
        ("wasi:cli/environment", "initial-cwd") => linker.func_wrap(name, |mut cx: HostContext, (): ()| {
            charge(&mut cx, 0)?;
            Ok((None::<String>,))
        }),
        ("wasi:cli/exit", "exit") => {
            linker.func_wrap(name, |_: HostContext, (_,): (ExitStatusResult,)| -> wasmtime::Result<()> {
                trap("the code called `exit`")
            })
        }
        ("wasi:cli/exit", "exit-with-code") => linker
            .func_wrap(name, |_: HostContext, (_,): (u8,)| -> wasmtime::Result<()> {
                trap("the code called `exit`")
            }),
        ("wasi:cli/stdin", "get-stdin") => linker.func_wrap(name, |mut cx: HostContext, (): ()| {
            charge(&mut cx, 0)?;
            Ok((cx.data_mut().handle::<InputStream>(0)?,))
        }),
        ("wasi:cli/stdout", "get-stdout") | ("wasi:cli/stderr", "get-stderr") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((cx.data_mut().handle::<OutputStream>(0)?,))
            })
        }
        ("wasi:cli/terminal-stdin", "get-terminal-stdin")
        | ("wasi:cli/terminal-stdout", "get-terminal-stdout")
        | ("wasi:cli/terminal-stderr", "get-terminal-stderr") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((None::<Resource<UnsupportedResource>>,))
            })
        }
        ("wasi:clocks/monotonic-clock", "now") => {
            linker.func_wrap(name, move |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((now(&cx),))
            })
        }
        ("wasi:clocks/monotonic-clock", "resolution") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((1_000_000_000 / u64::from(RATE_HZ),))
            })
        }
        ("wasi:clocks/monotonic-clock", "subscribe-instant" | "subscribe-duration") => {
            linker.func_wrap(name, move |cx: HostContext, (_,): (u64,)| pollable(cx))
        }
        ("wasi:clocks/wall-clock", "now") => linker.func_wrap(name, |mut cx: HostContext, (): ()| {
            charge(&mut cx, 0)?;
            Ok((Datetime { seconds: WALL_SECS, nanoseconds: 0 },))
        }),
        ("wasi:clocks/wall-clock", "resolution") => linker.func_wrap(name, |mut cx: HostContext, (): ()| {
            charge(&mut cx, 0)?;
            Ok((Datetime { seconds: 1, nanoseconds: 0 },))
        }),
        ("wasi:random/random", "get-random-bytes")
        | ("wasi:random/insecure", "get-insecure-random-bytes") => {
            linker.func_wrap(name, |mut cx: HostContext, (wanted,): (u64,)| Ok((random(&mut cx, wanted)?,)))
        }
        ("wasi:random/random", "get-random-u64") | ("wasi:random/insecure", "get-insecure-random-u64") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((cx.data_mut().outside.random.next(),))
            })
        }
        ("wasi:random/insecure-seed", "insecure-seed") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                let stream = &mut cx.data_mut().outside.random;
                Ok(((stream.next(), stream.next()),))
            })
        }
        ("wasi:filesystem/preopens", "get-directories") => {
            linker.func_wrap(name, |mut cx: HostContext, (): ()| {
                charge(&mut cx, 0)?;
                Ok((Vec::<(Resource<UnsupportedResource>, String)>::new(),))
            })
        }
        ("wasi:io/poll", "[method]pollable.ready") => {
            linker.func_wrap(name, |mut cx: HostContext, (_,): (Resource<Pollable>,)| {
                charge(&mut cx, 0)?;
                Ok((true,))
            })
        }
        ("wasi:io/poll", "[method]pollable.block") => {
            linker.func_wrap(name, |mut cx: HostContext, (_,): (Resource<Pollable>,)| charge(&mut cx, 0))
        }
        ("wasi:io/poll", "poll") => {
            // Borrowed handles are given back by being lifted, so they are lifted one and all.
            linker.func_wrap(name, |mut cx: HostContext, (pollables,): (Vec<Resource<Pollable>>,)| {
                charge(&mut cx, 8 * pollables.len())?;
                if pollables.is_empty() {
                    return trap("`poll` of nothing");
                }
                Ok(((0..).zip(&pollables).map(|(place, _)| place).collect::<Vec<u32>>(),))
            })
        }
        ("wasi:io/error", "[method]error.to-debug-string") => {
            linker.func_wrap(name, |mut cx: HostContext, (_,): (Resource<IoError>,)| {
                charge(&mut cx, 0)?;
                Ok((String::new(),))
            })
        }
        ("wasi:io/streams", "[method]input-stream.read" | "[method]input-stream.blocking-read") => linker
            .func_wrap(
                name,
                |mut cx: HostContext, _: (Resource<InputStream>, u64)| -> wasmtime::Result<BytesResult> {
                    charge(&mut cx, 0)?;
                    Ok((Err(StreamError::Closed),))
                },
            ),
        ("wasi:io/streams", "[method]input-stream.skip" | "[method]input-stream.blocking-skip") => linker
            .func_wrap(
                name,
                |mut cx: HostContext, _: (Resource<InputStream>, u64)| -> wasmtime::Result<CountResult> {
                    charge(&mut cx, 0)?;
                    Ok((Err(StreamError::Closed),))
                },
            ),
        ("wasi:io/streams", "[method]input-stream.subscribe") => {
            linker.func_wrap(name, move |cx: HostContext, _: InputArgs| pollable(cx))
        }
        ("wasi:io/streams", "[method]output-stream.subscribe") => {
            linker.func_wrap(name, move |cx: HostContext, _: OutputArgs| pollable(cx))
        }
        ("wasi:io/streams", "[method]output-stream.check-write") => {
            linker.func_wrap(name, |mut cx: HostContext, _: OutputArgs| -> wasmtime::Result<CountResult> {
                charge(&mut cx, 0)?;
                Ok((Ok(CALL_BYTES_MAX as u64),))
            })
        }
        (
            "wasi:io/streams",
            "[method]output-stream.write" | "[method]output-stream.blocking-write-and-flush",
        ) => linker.func_wrap(
            name,
            |mut cx: HostContext,
             (_, bytes): (Resource<OutputStream>, WasmList<u8>)|
             -> wasmtime::Result<UnitResult> { Ok((write(&mut cx, &bytes)?,)) },
        ),
        ("wasi:io/streams", "[method]output-stream.flush" | "[method]output-stream.blocking-flush") => linker
            .func_wrap(name, |mut cx: HostContext, _: OutputArgs| -> wasmtime::Result<UnitResult> {
                charge(&mut cx, 0)?;
                Ok((Ok(()),))
            }),
        _ => return Ok(false),
    }?;
    Ok(true)
}

/// The type of a resource, by its name: the same wherever it is named.
fn resource(linker: &mut LinkerInstance<'_, Host>, name: &str) -> wasmtime::Result<()> {
    let ty = match name {
        "error" => ResourceType::host::<IoError>(),
        "pollable" => ResourceType::host::<Pollable>(),
        "input-stream" => ResourceType::host::<InputStream>(),
        "output-stream" => ResourceType::host::<OutputStream>(),
        _ => ResourceType::host::<UnsupportedResource>(),
    };
    linker.resource(name, ty, |mut cx, _| {
        let handles = &mut cx.data_mut().handles;
        *handles = handles.saturating_sub(1);
        Ok(())
    })
}

/// Defines a function of an interface; what this host does not have traps when it is called.
fn function(linker: &mut LinkerInstance<'_, Host>, interface: &str, name: &str) -> wasmtime::Result<()> {
    if known(linker, interface, name)? {
        return Ok(());
    }
    let whole = format!("the code called {interface}#{name}, which no skill is given");
    linker.func_new(name, move |_, _, _, _| trap(whole.clone()))
}

/// A linker with all that a component imports of WASI.
///
/// # Errors
/// If something is imported that is neither function, type nor resource.
pub fn linker(engine: &Engine, component: &wasmtime::component::Component) -> wasmtime::Result<Linker<Host>> {
    let mut linker = Linker::new(engine);
    let ty = component.component_type();
    for (name, import) in ty.imports(engine) {
        let ComponentItem::ComponentInstance(interface) = import.ty else { continue };
        let base = name.split('@').next().unwrap_or(name);
        let mut instance = linker.instance(name)?;
        for (item, exported) in interface.exports(engine) {
            match exported.ty {
                ComponentItem::ComponentFunc(_) => function(&mut instance, base, item)?,
                ComponentItem::Resource(_) => resource(&mut instance, item)?,
                _ => {}
            }
        }
    }
    Ok(linker)
}
