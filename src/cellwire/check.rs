//! Checks a cell at an endpoint against the protocol: one verdict for each promise. Moves its arms.
//!
//! Each verdict opens connections of its own, so that one that fails spoils no other.

mod behavior;
mod limits;
mod opening;
mod promise;

use std::thread;
use std::time::{Duration, Instant};

use holdpoint_body::{Command, GuardVerdict, JointVec, TICK_SECS};
use holdpoint_cell::EpisodeSetup;

use crate::client::{CellCallError, Connect, Peer};
use crate::framing::{WireError, decode, encode};
use crate::messages::{Call, CellReply, CellState, FactoryDescription, Hello, PROTOCOL, Role, Welcome};
use crate::refusal::CellRefusal;
pub use promise::CellPromise;

/// How long an answer is waited for.
const WITHIN: Duration = Duration::from_secs(10);

/// How long the live cell may be another's.
const TAKEN_WITHIN: Duration = Duration::from_secs(3);

/// Ticks of a run that is compared with another.
const RUN_TICKS: usize = 40;

/// Ticks that are timed.
const TIMED_TICKS: usize = 1000;

/// The speed of the arm in a check, rad/s.
const SPEED_RAD_S: f64 = 0.5;

/// Whether a cell keeps a promise.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// The promise.
    pub promise: CellPromise,
    /// What is wrong; absent where it is kept.
    pub problem: Option<String>,
}

/// How long one exchange of a tick took, with what the cell computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExchangeTimes {
    /// Ticks.
    pub ticks: usize,
    /// The median, us.
    pub p50_us: u64,
    /// One of a hundred took longer, us.
    pub p99_us: u64,
    /// The longest, us.
    pub max_us: u64,
    /// Ticks that took longer than a tick lasts.
    pub overruns: usize,
}

/// What a verdict found.
type Found = Result<(), String>;

/// The checks of one cell.
struct Check {
    connect: Connect,
    described: Result<FactoryDescription, String>,
    /// Whether a promise is looked at.
    is_wanted: Box<dyn Fn(CellPromise) -> bool>,
    verdicts: Vec<Verdict>,
}

/// Checks the cell that connections lead to.
#[must_use]
pub fn check(connect: Connect) -> Vec<Verdict> {
    check_those(connect, Box::new(|_| true))
}

/// As [`check()`], for the promises that are wanted.
fn check_those(connect: Connect, is_wanted: Box<dyn Fn(CellPromise) -> bool>) -> Vec<Verdict> {
    let mut check = Check { is_wanted, ..Check::new(connect) };
    check.opening();
    check.behavior();
    check.state();
    check.commands();
    check.limits();
    check.live();
    check.verdicts
}

/// Times the exchange of a tick in a trial cell.
///
/// # Errors
/// What is wrong, if no trial runs.
pub fn measure(connect: Connect) -> Result<ExchangeTimes, String> {
    let check = Check::new(connect);
    let mut peer = check.trial(1)?;
    seen(&mut peer, Call::Observe { guard: GuardVerdict::Allowed })?;
    let mut times = Vec::with_capacity(TIMED_TICKS);
    for _ in 0..TIMED_TICKS {
        let begun = Instant::now();
        seen(&mut peer, Call::Step { command: Command::Hold })?;
        times.push(begun.elapsed());
    }
    times.sort_unstable();
    let of = |share: usize| {
        let time = times.get((times.len() * share / 100).min(times.len().saturating_sub(1)));
        time.map_or(0, |time| u64::try_from(time.as_micros()).unwrap_or(u64::MAX))
    };
    let tick = Duration::from_secs_f64(TICK_SECS);
    let overruns = times.iter().filter(|time| **time > tick).count();
    Ok(ExchangeTimes { ticks: times.len(), p50_us: of(50), p99_us: of(99), max_us: of(100), overruns })
}

fn hello(role: Role) -> Hello {
    Hello {
        protocol: PROTOCOL,
        role,
        session: None,
        watchdog_ms: None,
        client: "holdpoint cell check".to_owned(),
    }
}

fn told(error: CellCallError) -> String {
    match error {
        CellCallError::Refused(refusal) => refusal.into_body_error().to_string(),
        CellCallError::Lost(error) => error.to_string(),
    }
}

fn ask(peer: &mut Peer, call: Call) -> Result<CellReply, CellCallError> {
    peer.ask(None, Vec::new(), call, None, WITHIN)
}

/// A call that is answered by the state.
fn seen(peer: &mut Peer, call: Call) -> Result<CellState, String> {
    let name = call.name();
    match ask(peer, call) {
        Ok(CellReply::Seen(seen)) => Ok(*seen),
        Ok(_) => Err(format!("{name} is not answered by the state")),
        Err(error) => Err(format!("{name}: {}", told(error))),
    }
}

fn holds(is_so: bool, otherwise: impl FnOnce() -> String) -> Found {
    if is_so { Ok(()) } else { Err(otherwise()) }
}

/// Whether a call was refused as it must be.
fn refused<T>(
    answer: Result<T, CellCallError>,
    due: &str,
    is_due: impl FnOnce(&CellRefusal) -> bool,
) -> Found {
    match answer {
        Err(CellCallError::Refused(refusal)) if is_due(&refusal) => Ok(()),
        Err(CellCallError::Refused(refusal)) => {
            Err(format!("it refuses for another reason than {due}: {}", refusal.into_body_error()))
        }
        Err(CellCallError::Lost(error)) => Err(format!("{due} is due, and the connection ends: {error}")),
        Ok(_) => Err(format!("{due} is due, and it is taken")),
    }
}

impl Check {
    fn new(connect: Connect) -> Self {
        let mut check = Self {
            connect,
            described: Err("it was not read".to_owned()),
            is_wanted: Box::new(|_| true),
            verdicts: Vec::new(),
        };
        check.described = check.read_description();
        check
    }

    fn verdict(&mut self, promise: CellPromise, found: impl FnOnce(&Self) -> Found) {
        if !(self.is_wanted)(promise) {
            return;
        }
        let problem = found(self).err();
        self.verdicts.push(Verdict { promise, problem });
    }

    fn greet(&self, hello: &Hello) -> Result<(Peer, Welcome), CellCallError> {
        let begun = Instant::now();
        loop {
            match Peer::greet(&self.connect, hello) {
                // The connection before may not be closed yet.
                Err(CellCallError::Refused(CellRefusal::Taken)) if begun.elapsed() < TAKEN_WITHIN => {
                    thread::sleep(Duration::from_millis(20));
                }
                greeted => return greeted,
            }
        }
    }

    fn open(&self, role: Role) -> Result<Peer, String> {
        self.greet(&hello(role)).map(|(peer, _)| peer).map_err(told)
    }

    fn read_description(&self) -> Result<FactoryDescription, String> {
        let bytes = self.open(Role::Control)?.ask_block(Call::Describe, WITHIN).map_err(told)?;
        decode(&bytes).map_err(|error| error.to_string())
    }

    fn description(&self) -> Result<&FactoryDescription, String> {
        self.described.as_ref().map_err(|error| format!("no description: {error}"))
    }

    fn setup(&self, seed: u64) -> Result<Box<EpisodeSetup>, String> {
        let described = self.description()?;
        let [canonical, ..] = &described.distributions;
        let spec = &described.spec;
        Ok(Box::new(EpisodeSetup::sample(spec.first_task(), &spec.scene, canonical, seed)))
    }

    /// A trial cell that was reset.
    fn trial(&self, seed: u64) -> Result<Peer, String> {
        let mut peer = self.open(Role::Trial)?;
        self.reset(&mut peer, seed)?;
        Ok(peer)
    }

    fn reset(&self, peer: &mut Peer, seed: u64) -> Result<CellState, String> {
        seen(peer, Call::Reset { setup: self.setup(seed)? })
    }

    /// A short motion of every joint.
    fn motion(&self) -> Result<Command, String> {
        let robot = &self.description()?.spec.robot;
        let moved: JointVec = robot.home.iter().map(|q| q + 0.15).collect();
        let q = robot.geometry.chain.clamped(&moved, 0.05);
        Ok(Command::Joints { q, max_speed_rad_s: SPEED_RAD_S })
    }

    /// Everything that a run with a motion tells, bit for bit.
    fn run(&self, peer: &mut Peer) -> Result<Vec<u8>, String> {
        run_from(peer, self.motion()?)
    }
}

/// Everything that a run after a command tells, bit for bit.
fn run_from(peer: &mut Peer, first: Command) -> Result<Vec<u8>, String> {
    let written = |seen: &CellState| encode(seen).map_err(|error| error.to_string());
    let mut all = written(&seen(peer, Call::Observe { guard: GuardVerdict::Allowed })?)?;
    let commands = std::iter::once(first).chain(std::iter::repeat(Command::Hold)).take(RUN_TICKS);
    for command in commands {
        all.extend(written(&seen(peer, Call::Step { command })?)?);
    }
    Ok(all)
}

/// Whether the other side closes the connection.
fn closes(peer: &mut Peer, within: Duration) -> Found {
    match peer.line().receive_bytes(within) {
        Err(WireError::Closed) => Ok(()),
        Err(error) => Err(format!("it does not close the connection: {error}")),
        Ok(_) => Err("it does not close the connection, and answers more".to_owned()),
    }
}

#[cfg(test)]
mod tests;
