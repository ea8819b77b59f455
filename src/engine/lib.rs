//! The engine's single entry point: commands in, events out, and snapshots.
//!
//! The engine numbers events, and remembers answers so that a repeated command is carried out once. Authority lies with the
//! pipeline and the rules behind it. It is synchronous: its owner calls [`Engine::submit`] and [`Engine::advance`] in turn.

pub mod build_digest;
pub mod decide;
pub mod fault;
pub mod live;
pub(crate) mod queries;

use std::borrow::Cow;
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, atomic::AtomicBool};

use crate::decide::people::signed_calls::Signer;
use crate::decide::pipeline::concurrent::CommandTiming;
use crate::decide::pipeline::{Pipeline, PipelineSettings, SliceOutcome};
use crate::decide::store_identity;
use crate::fault::EngineFault;
use crate::live::stop_switch::{Controls, StopRequest, StopSwitch};
use holdpoint_explain::health_series::PresentTime;
use holdpoint_explain::record_query::{self, QueryQueue, RecordQuery};
use holdpoint_governance::ablation::{AblatedParts, AblationPart};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::site_profile::{ChosenProfile, ProfileTexts, SiteProfileError};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply, Request};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::VideoFrameSink;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_record::persisted_clock::{self, PersistedClock};
use holdpoint_record::store_robot::StoreRobot;
use holdpoint_record::version_table::{VersionTable, VersionTableError};
use holdpoint_record::wall_clock::{SystemClocks, WallClock};
use holdpoint_registry::Store;
use holdpoint_runtime::capability::{Capability, PackageError};
use holdpoint_runtime::skill::component::keep_compiled_in;
use holdpoint_store::{Layout, OpenStore, ReadableStore, StoreError};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint, Problem};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_wording::command_effect::{EngineEffect, engine_effect};

const ANSWERS_KEPT: usize = 1024;

struct AnsweredRequest {
    id: String,
    command: Digest,
    reply: Reply,
}

struct QueuedRequest {
    request: Request,
    caller: Caller,
    /// The signer; absent if no signature is required.
    signer: Option<Signer>,
}

fn fingerprint(command: &Command) -> Digest {
    Digest::of_parts("holdpoint.command.v1", &[&serde_json::to_vec(command).unwrap_or_default()])
}

const WAITING_MAX: usize = 64;

/// Why an engine could not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The store cannot be used.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The registry cannot be read.
    #[error(transparent)]
    VersionTable(#[from] VersionTableError),
    /// A profile or its policies cannot be used.
    #[error(transparent)]
    Profile(#[from] SiteProfileError),
    /// A baseline does not load.
    #[error(transparent)]
    Baseline(#[from] PackageError),
    /// The cell cannot be built.
    #[error(transparent)]
    Cell(#[from] holdpoint_cell::CellError),
    /// The store is for another robot. Nothing was written.
    #[error("this store is for the robot {recorded}, not for {given}")]
    OtherRobot { recorded: Box<StoreRobot>, given: Box<StoreRobot> },
    /// The start omits parts without being an experiment, or the store belongs to another experiment.
    #[error("{0}")]
    Omitted(String),
    /// The start could not be written.
    #[error(transparent)]
    Fault(#[from] EngineFault),
}

impl Hint for StartError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Store(error) => error.details(),
            Self::VersionTable(error) => error.details(),
            Self::Profile(error) => error.details(),
            Self::Baseline(error) => error.details(),
            Self::Fault(error) => error.details(),
            Self::OtherRobot { .. } => Some(ErrorReason::OtherRobot.into()),
            Self::Omitted(_) => Some(ErrorReason::NotAllowed.into()),
            Self::Cell(_) => Some(ErrorReason::Internal.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::VersionTable(error) => error.hint(),
            Self::Profile(error) => error.hint(),
            Self::Baseline(error) => error.hint(),
            Self::Fault(error) => error.hint(),
            Self::OtherRobot { recorded, .. } => Some(
                match &recorded.file {
                    Some(file) => format!(
                        "start with `--robot {}`, or choose another store with `--data`: measurements on one robot do \
                         not apply to another",
                        file.display()
                    ),
                    None => "start without `--robot` and `--site`, or choose another store with `--data`: measurements on \
                             one robot do not apply to another"
                        .to_owned(),
                }
                .into(),
            ),
            Self::Omitted(_) => Some(
                "a version that was activated with parts omitted never controls an arm; use another store".into(),
            ),
            Self::Cell(_) => None,
        }
    }
}

/// The settings of an engine.
pub struct Config<'a> {
    pub data: &'a Path,
    pub profile: ChosenProfile,
    /// The seeds of episodes. Where they are not secret, no version that is activated controls a live cell later.
    pub seeds: EpisodeSeeds,
    pub jobs: usize,
    /// Whether time is virtual (a script) or follows the machine's.
    pub scripted: bool,
    pub cell: Cell,
    /// Where episodes of active versions are cached.
    pub cache: EpisodeCache,
}

/// The deviations of an experiment from a regular engine.
#[cfg(any(test, feature = "experiments"))]
#[derive(Clone, Debug, Default)]
pub struct Experiment {
    /// The omitted parts.
    pub omitted: AblatedParts,
    /// Versions that replace the baselines of their families.
    pub first: Vec<Capability>,
}

/// The rules that an engine starts with.
pub struct StartRules {
    pub profile: Profile,
    pub table: PolicyTable,
    /// The texts of a custom profile.
    pub own: Option<ProfileTexts>,
    baselines: Vec<Capability>,
    omitted: AblatedParts,
}

impl StartRules {
    /// The rules of a regular engine.
    ///
    /// # Errors
    /// [`StartError`] if profile or baselines cannot be used.
    pub fn of(config: &Config<'_>) -> Result<Self, StartError> {
        if let Some(unknown) = config.profile.unknown_zone(&config.cell.zones) {
            return Err(StartError::Profile(unknown.into()));
        }
        let (profile, table) = config.profile.rules()?;
        let (own, omitted) = (config.profile.texts().cloned(), AblatedParts::default());
        Ok(Self { profile, table, own, baselines: config.cell.baselines()?, omitted })
    }
}

/// See the module comment.
pub struct Engine {
    pipeline: Pipeline,
    next_seq: u64,
    answers: VecDeque<AnsweredRequest>,
    waiting: VecDeque<QueuedRequest>,
    calls: u64,
    readings: QueryQueue,
    persisted_clock: PersistedClock,
    ended: bool,
}

impl Engine {
    /// Opens the store and starts; finishes or undoes the interrupted work of an earlier engine.
    ///
    /// # Errors
    /// [`StartError`]; the store is then unchanged, except for completed recovery.
    pub fn start(config: Config<'_>) -> Result<Self, StartError> {
        let rules = StartRules::of(&config)?;
        let store = Store::open(config.data)?;
        Self::on(config, rules, Box::new(store), Controls::default())
    }

    /// As [`Engine::start`], for an experiment: only in a script, on a store of its own.
    ///
    /// # Errors
    /// As [`Engine::start`]; [`StartError::Omitted`] if parts are omitted outside a script.
    #[cfg(any(test, feature = "experiments"))]
    pub fn start_experiment(config: Config<'_>, experiment: Experiment) -> Result<Self, StartError> {
        let Experiment { omitted, first } = experiment;
        if !omitted.is_none() && !config.scripted {
            return Err(StartError::Omitted("only a script can omit parts".to_owned()));
        }
        // The gate requires at least one of them, and would put every candidate on hold.
        if omitted.has(AblationPart::Sandbox) && omitted.has(AblationPart::Shadow) {
            let text =
                "sandbox and shadow cannot both be omitted: a version would have no behavioral evidence";
            return Err(StartError::Omitted(text.to_owned()));
        }
        let mut rules = StartRules::of(&config)?;
        for version in first {
            let family = version.id().family;
            match rules.baselines.iter_mut().find(|baseline| baseline.id().family == family) {
                Some(baseline) => *baseline = version,
                None => rules.baselines.push(version),
            }
        }
        rules.omitted = omitted;
        let store = Store::open(config.data)?;
        Self::on(config, rules, Box::new(store), Controls::default())
    }

    /// As [`Engine::start`], on a store that is open already, with controls that other threads have.
    ///
    /// # Errors
    /// As [`Engine::start`].
    pub fn on(
        config: Config<'_>,
        rules: StartRules,
        store: Box<dyn OpenStore>,
        controls: Controls,
    ) -> Result<Self, StartError> {
        let StartRules { profile, table, own, baselines, omitted } = rules;
        let opening = store.opening();
        let (clock, stored_clock, wall) = if config.scripted {
            let at_ms = opening.head.at_ms;
            (
                Clock::scripted(at_ms),
                PersistedClock::none(),
                WallClock::scripted(at_ms, opening.newest_record),
            )
        } else {
            let from_ms = persisted_clock::resumed_ms(store.layout(), &*store.views()?)?;
            let (newest, jump_max_s) = (opening.newest_record, profile.clock.jump_max_s);
            let wall = WallClock::of_machine(Box::new(SystemClocks), newest, jump_max_s);
            (Clock::real(from_ms), PersistedClock::begin(store.layout(), from_ms), wall)
        };
        keep_compiled_in(
            store.layout().compiled(),
            store.result_cache().secret().derived("compiled components")?,
        );
        let version_table = VersionTable::open(store, wall)?;
        let given = StoreRobot::of(&config.cell);
        let other =
            store_identity::robot(&*version_table.store().views()?)?.filter(|recorded| !recorded.is(&given));
        if let Some(recorded) = other {
            return Err(StartError::OtherRobot { recorded: Box::new(recorded), given: Box::new(given) });
        }
        store_identity::check_pointers(&*version_table.store().views()?, &given)?;
        if let Some(parts) =
            store_identity::omitted(&*version_table.store().views()?)?.filter(|parts| *parts != omitted)
        {
            let parts: Vec<&str> = parts.parts().into_iter().map(AblationPart::name).collect();
            let parts = if parts.is_empty() { "nothing".to_owned() } else { parts.join(", ") };
            return Err(StartError::Omitted(format!("{parts} was omitted in this store")));
        }
        let settings = PipelineSettings {
            seeds: config.seeds,
            jobs: config.jobs,
            profile,
            table,
            own,
            cell: config.cell,
            cache: config.cache,
            controls,
            omitted,
        };
        let pipeline =
            Pipeline::new(settings, version_table, clock, baselines).map_err(|fault| match fault {
                EngineFault::Store(error) | EngineFault::VersionTable(VersionTableError::Store(error))
                    if error.refuses_start() =>
                {
                    error.into()
                }
                fault => StartError::Fault(fault),
            })?;
        // Covers rows read since the check of the tables.
        pipeline.record().version_table().store().check_undisturbed()?;
        Ok(Self {
            pipeline,
            next_seq: 1,
            answers: VecDeque::new(),
            waiting: VecDeque::new(),
            calls: 0,
            readings: QueryQueue::default(),
            persisted_clock: stored_clock,
            ended: false,
        })
    }

    /// Carries out one request, and waits if it has to. A repeated id gets the same answer and has no further effect.
    pub fn submit(&mut self, request: Request) -> Reply {
        if let Some(query) = RecordQuery::of(&request.command) {
            return record_query::read(&*self.reader(), query, self.present());
        }
        let id = request.id.clone();
        if let Some(reply) = self.offer(request) {
            return reply;
        }
        self.pipeline.collect_sequence(true);
        self.carry_out_waiting();
        self.answer_of(&id).unwrap_or_else(|| refused("the engine is ending"))
    }

    /// As [`Engine::submit`], but without waiting: `None` if [`Engine::answer_of`] has the answer only after a live sequence.
    pub fn offer(&mut self, request: Request) -> Option<Reply> {
        let caller = self.pipeline.own_caller();
        self.offer_for(request, caller)
    }

    /// As [`Engine::offer`], for another process.
    pub fn offer_for(&mut self, request: Request, caller: Caller) -> Option<Reply> {
        let id = request.id.clone();
        let reply = self.take(request, caller);
        self.pipeline.switch().taken(&id);
        reply
    }

    /// Whether the arm is stopping for a request that waits.
    #[must_use]
    pub fn is_braking(&self) -> bool {
        !self.waiting.is_empty() && self.pipeline.is_stopping()
    }

    fn take(&mut self, request: Request, caller: Caller) -> Option<Reply> {
        if let Some(query) = RecordQuery::of(&request.command) {
            let (reader, present) = (self.reader(), self.present());
            return self.readings.begin(&request.id, query, (reader, present));
        }
        if matches!(request.command, Command::Stop { .. }) {
            // A stop is carried out even if its id was used before or waits.
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
        let signer = match self.pipeline.admit(&request) {
            Ok(signer) => signer,
            Err(refused) => return Some(refused),
        };
        let timing = self.pipeline.timing(&request.command);
        let admitted = QueuedRequest { request, caller, signer };
        match timing {
            CommandTiming::Now => return Some(self.carry_out(admitted)),
            CommandTiming::Between => {}
            CommandTiming::Stop => self.pipeline.stop_arm(),
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

    fn carry_out(&mut self, admitted: QueuedRequest) -> Reply {
        let QueuedRequest { request, caller, signer } = admitted;
        let remembered = (!request.command.only_reads()).then(|| fingerprint(&request.command));
        let reply = match request.command {
            Command::Snapshot => Reply::Snapshot { snapshot: Box::new(self.snapshot()) },
            Command::Shutdown => {
                self.pipeline.end();
                self.persisted_clock.store(self.now_ms());
                self.ended = true;
                Reply::Accepted { text: engine_effect(&EngineEffect::Ends), version: None }
            }
            Command::Stop { by, reason } => {
                let id = request.id.clone();
                self.pipeline.halt(StopRequest { id, by, reason, caller })
            }
            _ if self.ended => refused("the engine is ending"),
            command => match queries::answer(&mut self.pipeline, &command, signer.as_ref()) {
                Some(reply) => reply,
                None => self.pipeline.command_of(command, &caller, signer.as_ref()),
            },
        };
        if let Some(command) = remembered {
            self.answers.push_back(AnsweredRequest { id: request.id, command, reply: reply.clone() });
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

    /// Runs one slice.
    pub fn advance(&mut self) -> SliceOutcome {
        if self.ended {
            return SliceOutcome::Idle { next_ms: None };
        }
        self.persisted_clock.store_if_due(self.now_ms());
        if !self.waiting.is_empty() {
            if self.pipeline.collect_sequence(false) {
                self.carry_out_waiting();
                return SliceOutcome::Ran;
            }
            if self.pipeline.is_stopping() {
                // The arm comes to a standstill; no stage begins meanwhile.
                return SliceOutcome::Idle { next_ms: Some(self.now_ms()) };
            }
        }
        self.pipeline.advance()
    }

    /// Makes a live sequence due: without a separate thread, the next slice runs it.
    pub fn work_one(&mut self) {
        self.pipeline.work_one();
    }

    /// From now on sends frames of the live cell to `sink`, which must not wait. Has no other effect.
    pub fn draw_live_world(&mut self, sink: VideoFrameSink) {
        self.pipeline.draw_live_world(sink);
    }

    /// As [`Pipeline::pace_live_world`]; `sink` must not wait.
    pub fn pace_live_world(&mut self, times: Option<f64>, sink: VideoFrameSink) {
        self.pipeline.pace_live_world(times, sink);
    }

    /// The switch that stops the arm from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<StopSwitch> {
        self.pipeline.switch()
    }

    /// Halts the engine after a failure of its thread: nothing is approved, activated or begun from now on.
    pub fn fail(&mut self, why: &str) {
        self.pipeline.hold(why);
    }

    /// Another program has taken the name of the socket, for the `times`-th time.
    pub fn name_taken(&mut self, times: u64) {
        self.pipeline.name_taken(times);
    }

    /// Advances a script's clock to a deadline. Returns whether it moved.
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

    fn present(&self) -> PresentTime {
        let wall_ms = self.pipeline.record().version_table().wall().machine_time().map(WallTime::ms);
        PresentTime { at_ms: self.now_ms(), wall_ms }
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

    /// Whether a request ended the engine.
    #[must_use]
    pub const fn has_ended(&self) -> bool {
        self.ended
    }

    /// Why the engine is halted, if it is.
    #[must_use]
    pub const fn holding(&self) -> Option<&Problem> {
        self.pipeline.record().holding()
    }

    /// As [`Pipeline::tell_scene`].
    pub fn tell_scene(&mut self, text: String, failed: bool) {
        self.pipeline.tell_scene(text, failed);
    }

    /// As [`Pipeline::keep_recording`].
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn keep_recording(
        &mut self,
        version: &CapabilityId,
        record: (RecordKind, String),
        event: EventKind,
    ) -> Result<(), EngineFault> {
        self.pipeline.keep_recording(version, record, event)
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        self.pipeline.cancel()
    }

    fn reader(&self) -> Arc<dyn ReadableStore> {
        self.pipeline.record().version_table().store().reader()
    }

    /// The files of the store.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        self.pipeline.record().version_table().store().layout()
    }
}

/// An id identifies one command: a repeated command gets its answer, another command under the id is refused.
fn used_otherwise(id: &str) -> Reply {
    Reply::Refused {
        code: Refusal::BadInput,
        text: format!("the request id {id:?} was used for another command; it had no effect"),
        hint: Some("give every new command a new id".to_owned()),
    }
}

fn refused(text: &str) -> Reply {
    Reply::Refused { code: Refusal::NotNow, text: text.to_owned(), hint: None }
}

#[cfg(test)]
pub(crate) const MANIFESTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../manifests");

#[cfg(test)]
#[path = "../../tests/support/folder_copy.rs"]
mod folder_copy;
#[cfg(test)]
mod lifecycle_model;
#[cfg(test)]
#[path = "../../tests/support/quick_folder.rs"]
mod quick_folder;
#[cfg(test)]
mod test_pipeline;
#[cfg(test)]
mod tests;
