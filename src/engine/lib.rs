//! The one door: commands in, events out, a snapshot for whoever looks.
//!
//! The engine numbers events, remembers answers so that a retried command is carried out once, and
//! keeps nothing else: authority lies with the pipeline and the rules behind it. It is synchronous:
//! who owns it calls [`Engine::submit`] and [`Engine::advance`] in turn.

mod alarms;
pub mod anteroom;
mod binding;
pub mod bound;
pub mod bound_robot;
pub mod caller;
mod calls;
pub mod cell;
pub mod check;
pub mod context;
pub mod door;
pub mod dossier;
pub mod doubt;
pub mod doubted_clock;
pub mod embedded;
pub mod explain;
pub mod fault;
mod goal;
pub mod halt;
mod health;
pub mod health_series;
pub mod host;
mod kept_clock;
mod kept_task;
pub mod ledger;
mod listeners;
pub mod monitors;
pub mod observed;
mod operations;
mod origin;
pub mod people;
pub mod pipeline;
pub mod pump;
mod reading;
pub mod record;
pub mod recordings;
mod restart;
mod retake;
mod shift_note;
pub mod stages;
mod stated;
mod stop_mark;
pub mod trial;
pub mod tryout;
mod view;
pub mod wall_clock;
pub mod world;

use std::borrow::Cow;
use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::bound::RunSeed;
use crate::bound_robot::BoundRobot;
use crate::cell::Cell;
use crate::door::DoorError;
use crate::embedded::baselines;
use crate::fault::Fault;
use crate::health_series::Present;
use crate::kept_clock::KeptClock;
use crate::ledger::{Ledger, LedgerError};
use crate::people::signed_calls::Signer;
use crate::pipeline::concurrent::Timing;
use crate::pipeline::{Pipeline, PipelineSettings, Progress};
use crate::reading::{Asked, Readings};
use crate::trial::cache::EpisodeCache;
use crate::wall_clock::{MachineClocks, WallClock};
use crate::world::switch::{AskedStop, Controls, Switch};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::omitted::{Omitted, Part};
use holdpoint_governance::own_profile::{ChosenProfile, OwnProfileError, ProfileTexts};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply, Request};
use holdpoint_protocol::event::Event;
use holdpoint_protocol::sink::Pictures;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_registry::{Store, StoreError};
use holdpoint_runtime::capability::{Capability, PackageError};
use holdpoint_runtime::skill::component::keep_compiled_in;
use holdpoint_text::{Hint, Problem};

/// Answers remembered for retried commands.
const ANSWERS_KEPT: usize = 1024;

/// A request that was carried out, and what was answered.
struct Answered {
    id: String,
    command: Digest,
    reply: Reply,
}

/// A request that was let in.
struct Admitted {
    request: Request,
    caller: Caller,
    /// Who signed it; absent if nobody had to.
    signer: Option<Signer>,
}

/// What a command is known by, however large it is.
fn fingerprint(command: &Command) -> Digest {
    Digest::of_parts("holdpoint.command.v1", &[&serde_json::to_vec(command).unwrap_or_default()])
}

/// The most requests that wait for the end of a sequence.
const WAITING_MAX: usize = 64;

/// Why an engine could not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The registry cannot be read.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// A profile or its policies cannot be used.
    #[error(transparent)]
    Profile(#[from] OwnProfileError),
    /// A baseline does not load.
    #[error(transparent)]
    Baseline(#[from] PackageError),
    /// The cell cannot be built.
    #[error(transparent)]
    Sim(#[from] holdpoint_sim::SimError),
    /// The store is for another robot. Nothing was written.
    #[error("this store is for the robot {recorded}, not for {given}")]
    OtherRobot {
        /// The robot the store was made with.
        recorded: Box<BoundRobot>,
        /// The robot it was to be opened with.
        given: Box<BoundRobot>,
    },
    /// An experiment leaves parts of the way out, and this is none, or the store is not an experiment's like it.
    #[error("{0}")]
    LeftOut(String),
    /// Other processes cannot be served.
    #[error(transparent)]
    Door(#[from] DoorError),
    /// The system gives no thread to read the record on.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// The start could not be written.
    #[error(transparent)]
    Fault(#[from] Fault),
}

impl Hint for StartError {
    fn code(&self) -> Option<&'static str> {
        if let Self::Store(error) = self { error.code() } else { None }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::Ledger(error) => error.hint(),
            Self::Profile(error) => error.hint(),
            Self::Baseline(error) => error.hint(),
            Self::Fault(error) => error.hint(),
            Self::Door(error) => error.hint(),
            Self::OtherRobot { recorded, .. } => Some(
                match &recorded.file {
                    Some(file) => format!(
                        "start with `--robot {}`, or choose another store with `--data`: what was measured on one \
                         robot says nothing of another",
                        file.display()
                    ),
                    None => "start without `--robot`, or choose another store with `--data`: what was measured on \
                             one robot says nothing of another"
                        .to_owned(),
                }
                .into(),
            ),
            Self::LeftOut(_) => Some(
                "what was let through with parts of the way left out never gets the arm; take another store".into(),
            ),
            Self::Sim(_) | Self::Thread(_) => None,
        }
    }
}

/// What an engine is started with.
pub struct Config<'a> {
    pub data: &'a Path,
    pub profile: ChosenProfile,
    pub seed: u64,
    pub jobs: usize,
    /// Whether time is virtual (a script) or follows the machine's.
    pub scripted: bool,
    pub cell: Cell,
    /// Where episodes of active versions are kept.
    pub cache: EpisodeCache,
}

/// What an experiment does otherwise than an engine at work.
#[derive(Clone, Debug, Default)]
pub struct Experiment {
    /// The parts of the way that are left out.
    pub omitted: Omitted,
    /// First versions in place of the embedded ones of their families.
    pub first: Vec<Capability>,
}

/// What an engine decides by and begins with, read before anything of the store is.
struct StartRules {
    profile: Profile,
    table: PolicyTable,
    own: Option<ProfileTexts>,
    baselines: Vec<Capability>,
    omitted: Omitted,
}

impl StartRules {
    fn of(chosen: &ChosenProfile) -> Result<Self, StartError> {
        let (profile, table) = chosen.rules()?;
        let (own, omitted) = (chosen.texts().cloned(), Omitted::default());
        Ok(Self { profile, table, own, baselines: baselines()?, omitted })
    }
}

/// See the module's head.
pub struct Engine {
    pipeline: Pipeline,
    next_seq: u64,
    answers: VecDeque<Answered>,
    waiting: VecDeque<Admitted>,
    /// Calls made by the program that holds it.
    calls: u64,
    readings: Readings,
    kept_clock: KeptClock,
    ended: bool,
}

impl Engine {
    /// Opens the store and starts; finishes or undoes what an interrupted engine left.
    ///
    /// # Errors
    /// [`StartError`]; the store is then as it was, but for the recovery that was written.
    pub fn start(config: Config<'_>) -> Result<Self, StartError> {
        let rules = StartRules::of(&config.profile)?;
        let store = Store::open(config.data)?;
        Self::on(config, rules, store, Controls::default())
    }

    /// As [`Engine::start`], for an experiment: on a script's store of its own alone.
    ///
    /// # Errors
    /// As [`Engine::start`]; [`StartError::LeftOut`] if it is no script that is to leave something out.
    pub fn start_experiment(config: Config<'_>, experiment: Experiment) -> Result<Self, StartError> {
        let Experiment { omitted, first } = experiment;
        if !omitted.is_none() && !config.scripted {
            return Err(StartError::LeftOut(
                "a part of the way can be left out in a script alone".to_owned(),
            ));
        }
        // The gate holds what nobody looked at, and would hold every candidate.
        if omitted.has(Part::Sandbox) && omitted.has(Part::Shadow) {
            let text = "sandbox and shadow cannot both be left out: nothing would be found out about how a version works";
            return Err(StartError::LeftOut(text.to_owned()));
        }
        let mut rules = StartRules::of(&config.profile)?;
        for version in first {
            let family = version.id().family;
            match rules.baselines.iter_mut().find(|baseline| baseline.id().family == family) {
                Some(baseline) => *baseline = version,
                None => rules.baselines.push(version),
            }
        }
        rules.omitted = omitted;
        let store = Store::open(config.data)?;
        Self::on(config, rules, store, Controls::default())
    }

    /// Starts on a store whose record was read.
    fn on(
        config: Config<'_>,
        rules: StartRules,
        store: Store,
        controls: Controls,
    ) -> Result<Self, StartError> {
        let StartRules { profile, table, own, baselines, omitted } = rules;
        let opening = store.opening();
        let (clock, kept_clock, wall) = if config.scripted {
            let at_ms = opening.head.at_ms;
            (Clock::scripted(at_ms), KeptClock::none(), WallClock::scripted(at_ms, opening.newest_record))
        } else {
            let from_ms = kept_clock::resumed_ms(store.layout(), &store.views()?)?;
            let (newest, jump_max_s) = (opening.newest_record, profile.clock.jump_max_s);
            let wall = WallClock::of_machine(Box::new(MachineClocks), newest, jump_max_s);
            (Clock::real(from_ms), KeptClock::begin(store.layout(), from_ms), wall)
        };
        keep_compiled_in(store.layout().compiled(), store.cells().secret().derived("compiled components")?);
        let ledger = Ledger::open(store, wall)?;
        let given = BoundRobot::of(&config.cell);
        let other = bound::robot(&ledger.store().views()?)?.filter(|recorded| !recorded.is(&given));
        if let Some(recorded) = other {
            return Err(StartError::OtherRobot { recorded: Box::new(recorded), given: Box::new(given) });
        }
        bound::check_pointers(&ledger.store().views()?, &given)?;
        if !config.scripted {
            RunSeed::OfStore(config.seed).check(bound::seed(&ledger.store().views()?)?)?;
        }
        if let Some(parts) = bound::left_out(&ledger.store().views()?)?.filter(|parts| *parts != omitted) {
            let parts: Vec<&str> = parts.parts().into_iter().map(Part::name).collect();
            let parts = if parts.is_empty() { "nothing".to_owned() } else { parts.join(", ") };
            return Err(StartError::LeftOut(format!("{parts} was left out in this store")));
        }
        let settings = PipelineSettings {
            seed: config.seed,
            jobs: config.jobs,
            profile,
            table,
            own,
            cell: config.cell,
            cache: config.cache,
            controls,
            omitted,
        };
        let pipeline = Pipeline::new(settings, ledger, clock, baselines).map_err(|fault| match fault {
            Fault::Store(error) | Fault::Ledger(LedgerError::Store(error)) if error.refuses_start() => {
                error.into()
            }
            fault => StartError::Fault(fault),
        })?;
        // Much was read since the tables were compared, the profile that is in force for one.
        pipeline.record().ledger().store().undisturbed()?;
        Ok(Self {
            pipeline,
            next_seq: 1,
            answers: VecDeque::new(),
            waiting: VecDeque::new(),
            calls: 0,
            readings: Readings::default(),
            kept_clock,
            ended: false,
        })
    }

    /// Carries out one request. The same id again gets the same answer and does nothing. Where the live world works
    /// on a thread of its own, a request that has to wait for the end of a sequence is waited for.
    pub fn submit(&mut self, request: Request) -> Reply {
        if let Some(asked) = Asked::of(&request.command) {
            return reading::read(self.layout(), asked, self.present());
        }
        let id = request.id.clone();
        if let Some(reply) = self.offer(request) {
            return reply;
        }
        self.pipeline.collect_sequence(true);
        self.carry_out_waiting();
        self.answer_of(&id).unwrap_or_else(|| refused("the engine is ending"))
    }

    /// As [`Engine::submit`], but never waits: `None` if the request has to wait for the end of a sequence of the
    /// live world. [`Engine::answer_of`] has its answer after some [`Engine::advance`].
    pub fn offer(&mut self, request: Request) -> Option<Reply> {
        let caller = self.pipeline.own_caller();
        self.offer_for(request, caller)
    }

    /// As [`Engine::offer`], for somebody else's process.
    pub(crate) fn offer_for(&mut self, request: Request, caller: Caller) -> Option<Reply> {
        let id = request.id.clone();
        let reply = self.take(request, caller);
        // The arm was stopped for it by now, or works on.
        self.pipeline.switch().taken(&id);
        reply
    }

    /// Whether a request waits until the arm stands.
    pub(crate) fn is_braking(&self) -> bool {
        !self.waiting.is_empty() && self.pipeline.is_stopping()
    }

    fn take(&mut self, request: Request, caller: Caller) -> Option<Reply> {
        if let Some(asked) = Asked::of(&request.command) {
            let (layout, present) = (self.layout().clone(), self.present());
            return self.readings.begin(&request.id, asked, (&layout, present));
        }
        if matches!(request.command, Command::Stop { .. }) {
            // A stop is carried out whatever its id was used for, or waits under.
            self.answers.retain(|answer| answer.id != request.id);
        } else if let Some(answer) = self.answers.iter().find(|answer| answer.id == request.id) {
            let same = answer.command == fingerprint(&request.command);
            return Some(if same { answer.reply.clone() } else { used_otherwise(&request.id) });
        } else if let Some(waiting) = self.waiting.iter().find(|waiting| waiting.request.id == request.id) {
            return (waiting.request.command != request.command).then(|| used_otherwise(&request.id));
        }
        if self.waiting.len() >= WAITING_MAX {
            return Some(refused("too many requests wait for the end of a sequence"));
        }
        // Before the arm is stopped for it, or anything waits for it.
        let signer = match self.pipeline.admit(&request) {
            Ok(signer) => signer,
            Err(refused) => return Some(refused),
        };
        let timing = self.pipeline.timing(&request.command);
        let admitted = Admitted { request, caller, signer };
        match timing {
            Timing::Now => return Some(self.carry_out(admitted)),
            Timing::Between => {}
            Timing::Stop => self.pipeline.stop_arm(),
        }
        self.waiting.push_back(admitted);
        None
    }

    /// The answer to a request that was carried out and changed something.
    #[must_use]
    pub fn answer_of(&self, id: &str) -> Option<Reply> {
        let found = self.answers.iter().find(|answer| answer.id == id).map(|answer| answer.reply.clone());
        found.or_else(|| self.readings.answer_of(id))
    }

    fn carry_out(&mut self, admitted: Admitted) -> Reply {
        let Admitted { request, caller, signer } = admitted;
        let remembered = (!request.command.only_reads()).then(|| fingerprint(&request.command));
        let reply = match request.command {
            Command::Snapshot => Reply::Snapshot { snapshot: Box::new(self.snapshot()) },
            Command::Shutdown => {
                self.pipeline.end();
                self.kept_clock.keep(self.now_ms());
                self.ended = true;
                let text = "the engine ends; nothing was approved or activated by it".to_owned();
                Reply::Accepted { text, version: None }
            }
            Command::Stop { by, reason } => {
                let id = request.id.clone();
                self.pipeline.halt(AskedStop { id, by, reason, caller })
            }
            _ if self.ended => refused("the engine is ending"),
            command => self.pipeline.command_of(command, &caller, signer.as_ref()),
        };
        if let Some(command) = remembered {
            self.answers.push_back(Answered { id: request.id, command, reply: reply.clone() });
            if self.answers.len() > ANSWERS_KEPT {
                self.answers.pop_front();
            }
        }
        reply
    }

    fn carry_out_waiting(&mut self) {
        while let Some(admitted) = self.waiting.pop_front() {
            self.carry_out(admitted);
        }
    }

    /// One slice of work.
    pub fn advance(&mut self) -> Progress {
        if self.ended {
            return Progress::Idle { next_ms: None };
        }
        self.kept_clock.look(self.now_ms());
        if !self.waiting.is_empty() {
            if self.pipeline.collect_sequence(false) {
                self.carry_out_waiting();
                return Progress::Worked;
            }
            if self.pipeline.is_stopping() {
                // The arm comes to a stand; nothing is begun meanwhile.
                return Progress::Idle { next_ms: Some(self.now_ms()) };
            }
        }
        self.pipeline.advance()
    }

    /// A sequence of the live world falls due: where it works in step, the next slice is one.
    pub fn work_one(&mut self) {
        self.pipeline.work_one();
    }

    /// From now on pictures of the live world go to `pictures`, which must not wait. Nothing else changes by it.
    pub fn draw_live_world(&mut self, pictures: Pictures) {
        self.pipeline.draw_live_world(pictures);
    }

    /// From now on the live world works on a thread of its own: `times` simulated seconds in a second (absent: as
    /// fast as it computes). Pictures of it go to `pictures`, which must not wait.
    pub fn pace_live_world(&mut self, times: Option<f64>, pictures: Pictures) {
        self.pipeline.pace_live_world(times, pictures);
    }

    /// Stops the arm where it works now, from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<Switch> {
        self.pipeline.switch()
    }

    /// The engine's thread failed: nothing is approved, activated or begun from now on.
    pub fn fail(&mut self, why: &str) {
        self.pipeline.hold(why);
    }

    /// Another program took the name of the socket; so many times by now.
    pub(crate) fn name_taken(&mut self, times: u64) {
        self.pipeline.name_taken(times);
    }

    /// A script's clock jumps to a deadline. Tells whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.pipeline.jump_to(at_ms)
    }

    /// Whether time is virtual and moved by a script.
    #[must_use]
    pub const fn is_scripted(&self) -> bool {
        self.pipeline.record().clock().is_scripted()
    }

    /// The present virtual time, ms.
    #[must_use]
    pub fn now_ms(&self) -> u64 {
        self.pipeline.record().now_ms()
    }

    /// The present on both clocks.
    fn present(&self) -> Present {
        let wall_ms = self.pipeline.record().ledger().wall().said().map(WallTime::ms);
        Present { at_ms: self.now_ms(), wall_ms }
    }

    /// Events since the last call, numbered, in order.
    pub fn drain_events(&mut self) -> Vec<Event> {
        let at_ms = self.now_ms();
        let kinds = self.pipeline.drain_events();
        kinds
            .into_iter()
            .map(|kind| {
                let seq = self.next_seq;
                self.next_seq += 1;
                Event { seq, at_ms, kind }
            })
            .collect()
    }

    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.pipeline.snapshot()
    }

    /// Whether the engine was asked to end.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        self.ended
    }

    /// Why the engine holds, if it does.
    #[must_use]
    pub const fn holding(&self) -> Option<&Problem> {
        self.pipeline.record().holding()
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        self.pipeline.cancel()
    }

    /// Where the store keeps what.
    #[must_use]
    pub fn layout(&self) -> &holdpoint_registry::Layout {
        self.pipeline.record().ledger().store().layout()
    }
}

/// A request's id stands for one command: a retry of it is answered, another command under it is a mistake.
fn used_otherwise(id: &str) -> Reply {
    Reply::Refused {
        code: Refusal::BadInput,
        text: format!("the request id {id:?} was used for another command; nothing was done"),
        hint: Some("every new command has an id of its own".to_owned()),
    }
}

fn refused(text: &str) -> Reply {
    Reply::Refused { code: Refusal::NotNow, text: text.to_owned(), hint: None }
}

/// Where the versions lie that tests read: their working folder is the crate's.
#[cfg(test)]
pub(crate) const MANIFESTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../manifests");

#[cfg(test)]
mod machine;
#[cfg(test)]
mod test_pipeline;
#[cfg(test)]
mod tests;
