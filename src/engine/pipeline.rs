//! The pipeline: takes every candidate through the seven stages, one slice of work at a time.
//!
//! It owns the parts (record, evidence, questions, monitors, live world, the stage under way) and says whose turn it
//! is; each stage gets the parts it needs and nothing else. It decides nothing itself (the rules in governance do) and
//! does nothing twice: each call to [`Pipeline::advance`] is one slice, between two slices commands are taken. A
//! fault of its own makes it hold: nothing is approved or activated by it.

mod beginning;
mod commands;
pub(crate) mod concurrent;
mod doubts;
mod halted;
mod parked;
pub mod rehearsal;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::loosened::LetIn;
use holdpoint_governance::omitted::Omitted;
use holdpoint_governance::own_profile::ProfileTexts;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::film::Film;
use holdpoint_protocol::sink::Pictures;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_runtime::capability::Capability;

use crate::bound::{self, ContextSet, RunSeed};
use crate::bound_robot::BoundRobot;
use crate::cell::Cell;
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::doubted_clock;
use crate::fault::Fault;
use crate::goal;
use crate::halt;
use crate::health::CellHealth;
use crate::ledger::{FamilyEntry, Ledger};
use crate::monitors::Monitors;
use crate::people::approvals::Approvals;
use crate::people::signed_calls::SignedCalls;
use crate::record::Record;
use crate::restart;
use crate::retake;
use crate::stages::activation::Activation;
use crate::stages::again::AgainRun;
use crate::stages::confirmation::{self, ConfirmationRun};
use crate::stages::emergency;
use crate::stages::monitoring::Live;
use crate::stages::resume::{self, Resumption};
use crate::stages::sandbox::{Sandbox, SandboxRun};
use crate::stages::shadow::{self, ShadowRun, ShadowStep};
use crate::trial::Trials;
use crate::trial::cache::EpisodeCache;
use crate::view::snapshot::SnapshotView;
use crate::world::LiveWorld;
use crate::world::switch::{Controls, Switch};

/// What a pipeline is made with.
pub struct PipelineSettings {
    /// Seed of the run.
    pub seed: u64,
    pub jobs: usize,
    pub profile: Profile,
    pub table: PolicyTable,
    /// The texts of a profile that does not come with the program: they go on record.
    pub own: Option<ProfileTexts>,
    pub cell: Cell,
    /// Where episodes of active versions are kept.
    pub cache: EpisodeCache,
    /// What reaches into it from other threads.
    pub controls: Controls,
    /// What an experiment leaves out.
    pub omitted: Omitted,
}

/// What a slice of work came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Something was done; there may be more.
    Worked,
    /// Nothing is left to do before a deadline (virtual ms) or a command.
    Idle { next_ms: Option<u64> },
}

/// The stage that is being worked on.
enum Work {
    Sandbox(Box<SandboxRun>),
    Shadow(Box<ShadowRun>),
    Confirmation(Box<ConfirmationRun>),
    Again(Box<AgainRun>),
}

impl Work {
    fn id(&self) -> &CapabilityId {
        match self {
            Self::Sandbox(run) => run.id(),
            Self::Shadow(run) => run.id(),
            Self::Confirmation(run) => run.id(),
            Self::Again(run) => run.id(),
        }
    }
}

/// See the module's head.
pub struct Pipeline {
    context: Context,
    trials: Trials,
    record: Record,
    dossiers: Dossiers,
    approvals: Approvals,
    signed_calls: SignedCalls,
    monitors: Monitors,
    world: LiveWorld,
    resumptions: Vec<Resumption>,
    health: CellHealth,
    /// The agent the store is for.
    agent: Digest,
    work: Option<Work>,
    /// Stages of versions that a person paused meanwhile.
    parked: Vec<Work>,
    /// Stages begin by a call alone.
    on_call: bool,
}

impl Pipeline {
    /// A pipeline over an open ledger. Bootstraps `baselines` that the ledger does not know, marks
    /// what an interrupted engine left as not done, and sets the context.
    ///
    /// # Errors
    /// [`Fault`] if any of it cannot be written.
    pub fn new(
        settings: PipelineSettings,
        mut ledger: Ledger,
        clock: Clock,
        baselines: Vec<Capability>,
    ) -> Result<Self, Fault> {
        let PipelineSettings { seed, jobs, profile, table, own, cell, cache, controls, omitted } = settings;
        let seeds = cache.seed_key(ledger.store(), clock.is_scripted().then_some(seed))?;
        let mut context = Context::new(profile, table, own, cell)?.seeded(seeds).without(omitted);
        let Controls { switch, cancel } = controls;
        let world = LiveWorld::new(context.cell.clone(), switch)?;
        ledger.begin_persons()?;
        let agent = bound::agent(&ledger.store().views()?)?.unwrap_or_else(|| world.cell.agent_hash());
        let lets_in = LetIn { class: context.profile.name, scripted: clock.is_scripted() };
        ledger.bind(&BoundRobot::of(&context.cell), lets_in);
        let run_seed = if clock.is_scripted() { RunSeed::OfScript } else { RunSeed::OfStore(seed) };
        let voided = match bound::set_context(&context, &mut ledger, agent, (clock.now_ms(), run_seed))? {
            ContextSet::InForce(voided) => voided,
            ContextSet::Unauthorized(why) => {
                context.unauthorized = Some(why);
                world.switch().latch();
                None
            }
        };
        let mut pipeline = Self {
            world,
            agent,
            context,
            trials: Trials::new(seed, jobs, cache, cancel),
            record: Record::new(ledger, clock),
            dossiers: Dossiers::default(),
            approvals: Approvals::default(),
            signed_calls: SignedCalls::new()?,
            monitors: Monitors::default(),
            resumptions: Vec::new(),
            health: CellHealth::default(),
            work: None,
            parked: Vec::new(),
            on_call: false,
        };
        pipeline.record.recall_alarms()?;
        doubted_clock::recall(&mut pipeline.record)?;
        doubted_clock::look(&mut pipeline.record)?;
        pipeline.health = CellHealth::recall(&pipeline.context, &pipeline.record)?;
        halt::come_up(&mut pipeline.record, &mut pipeline.world)?;
        if let Some(goal) = goal::recall(&pipeline.record.ledger().store().views()?)? {
            pipeline.world.cell.set_goal(goal);
        }
        // Whoever stopped the cell before there was an engine is on record before anything else is.
        pipeline.take_in_halt();
        pipeline.announce(voided);
        if let Err(fault) = pipeline.bound_agent().check() {
            pipeline.hold(&fault.held());
            return Ok(pipeline);
        }
        pipeline.look_at_authorization();
        for baseline in baselines {
            let family = baseline.id().family;
            if pipeline.context.unauthorized.is_none() && pipeline.record.ledger().family(&family).is_err() {
                pipeline.bootstrap(baseline)?;
            }
        }
        let mut approvals = Approvals::default();
        restart::recover(&mut pipeline.live(), &mut approvals)?;
        pipeline.approvals = approvals;
        Ok(pipeline)
    }

    /// What stages 6 and 7 work on.
    pub(crate) fn live(&mut self) -> Live<'_> {
        self.live_and_approvals().0
    }

    /// What stages 6 and 7 work on, and what waits for people.
    fn live_and_approvals(&mut self) -> (Live<'_>, &mut Approvals) {
        let live = Live {
            context: &self.context,
            seed: self.trials.seed(),
            record: &mut self.record,
            dossiers: &mut self.dossiers,
            monitors: &mut self.monitors,
            world: &mut self.world,
            resumptions: &mut self.resumptions,
            health: &mut self.health,
        };
        (live, &mut self.approvals)
    }

    /// What stage 5 works on.
    pub(crate) fn activation(&mut self) -> Activation<'_> {
        Activation {
            context: &self.context,
            agent: self.bound_agent(),
            sequence_runs: self.world.is_running() || self.world.is_halted(),
            cell_stands: self.world.is_halted(),
            record: &mut self.record,
            dossiers: &mut self.dossiers,
            approvals: &mut self.approvals,
            monitors: &mut self.monitors,
        }
    }

    /// One slice of work.
    pub fn advance(&mut self) -> Progress {
        self.take_in_halt();
        let profile = self.context.profile.name;
        if self.record.holding().is_none()
            && let Err(error) = halt::begin_work(&mut self.record, &mut self.world, profile)
        {
            self.hold(&Fault::from(error).held());
        }
        if let Err(error) = doubted_clock::look(&mut self.record)
            && self.record.holding().is_none()
        {
            self.hold(&Fault::from(error).held());
        }
        if self.record.holding().is_some() {
            self.look_at_alarms();
            self.collect_sequence(false);
            return Progress::Idle { next_ms: None };
        }
        match self.slice() {
            Ok(progress) => progress,
            // Interrupted on purpose: the stage stays marked as running and is run again at the next start.
            Err(_) if self.trials.is_cancelled() => Progress::Idle { next_ms: None },
            Err(fault) => {
                self.hold(&fault.held());
                Progress::Idle { next_ms: None }
            }
        }
    }

    fn slice(&mut self) -> Result<Progress, Fault> {
        self.record.ledger().store().unaltered()?;
        self.look_at_alarms();
        self.unpark();
        if self.world.is_halted() {
            return self.halted_slice();
        }
        if self.world.is_paced() {
            return self.concurrent_slice();
        }
        if self.look_at_deadlines()? || self.activation().take_granted()? {
            return Ok(Progress::Worked);
        }
        if !self.resumptions.is_empty() {
            // A version was taken off while the cell was stopped.
            let report = self.live().sequence(None)?;
            resume::look_at(&self.context, &mut self.record, &mut self.resumptions, &report)?;
            return Ok(Progress::Worked);
        }
        if self.world.take_due() {
            self.live().sequence(None)?;
            return Ok(Progress::Worked);
        }
        match self.work.take() {
            Some(Work::Sandbox(run)) => {
                self.sandbox_slice(run)?;
                return Ok(Progress::Worked);
            }
            Some(Work::Shadow(run)) => {
                self.shadow_slice(run)?;
                return Ok(Progress::Worked);
            }
            Some(Work::Confirmation(run)) => {
                self.confirmation_slice(run)?;
                return Ok(Progress::Worked);
            }
            Some(Work::Again(run)) => {
                self.again_slice(run)?;
                return Ok(Progress::Worked);
            }
            None => {}
        }
        if let Some(id) = confirmation::next(&self.monitors, &self.dossiers).filter(|_| !self.on_call) {
            self.begin_confirmation(&id)?;
            return Ok(Progress::Worked);
        }
        if !self.on_call && self.begin_again()? {
            return Ok(Progress::Worked);
        }
        if let Some((id, stage)) = self.next_stage() {
            self.begin(&id, stage)?;
            return Ok(Progress::Worked);
        }
        if self.record.ledger().families().any(|(_, entry)| has_provisional(entry)) {
            self.live().sequence(None)?;
            return Ok(Progress::Worked);
        }
        Ok(Progress::Idle { next_ms: self.next_deadline_ms() })
    }

    /// Prompts and escalations whose time is over. Tells whether anything was done.
    pub(crate) fn look_at_deadlines(&mut self) -> Result<bool, Fault> {
        if self.activation().look_at_deadlines()? || self.live().look_at_monitors()? {
            return Ok(true);
        }
        let (mut live, approvals) = self.live_and_approvals();
        emergency::look_at_reviews(&mut live, approvals)
    }

    pub(crate) fn next_deadline_ms(&self) -> Option<u64> {
        let monitors = self.monitors.next_ms(self.world.cell.link_is_up());
        let people = self.approvals.next().map(|until| self.record.engine_ms_at(until));
        people.into_iter().chain(monitors).min()
    }

    fn look_at_alarms(&mut self) {
        self.record.look_at_alarms(&self.monitors, self.world.works());
    }

    /// The first candidate, in order of family and registration, with a stage to begin.
    fn next_stage(&self) -> Option<(CapabilityId, Stage)> {
        if self.on_call {
            return None;
        }
        for (_, entry) in self.record.ledger().families() {
            for (member, version) in entry.members.iter().zip(&entry.state.versions) {
                let id = member.capability.id();
                if version.flags.paused || version.flags.awaiting_approval || self.dossiers.is_held(&id) {
                    continue;
                }
                // Nothing can be compared with nobody: a stopped family is re-armed first.
                let compares = matches!(version.state, State::Validated | State::Sandboxed | State::Demoted);
                if compares && entry.active().is_none() {
                    continue;
                }
                let stage = match (version.state, version.flags.running) {
                    (State::Registered, None) => Some(Stage::Validation),
                    (State::Validated, None) => Some(Stage::Sandbox),
                    (State::Sandboxed, None) => Some(Stage::Shadow),
                    (State::Shadowed, None) => Some(Stage::Activation),
                    (State::Demoted, Some(stage)) => Some(stage),
                    _ => None,
                };
                if let Some(stage) = stage {
                    return Some((id, stage));
                }
            }
        }
        None
    }

    fn sandbox_slice(&mut self, run: Box<SandboxRun>) -> Result<(), Fault> {
        let mut sandbox = Sandbox {
            context: &self.context,
            trials: &self.trials,
            record: &mut self.record,
            dossiers: &mut self.dossiers,
        };
        let step = sandbox.slice(run)?;
        self.live_due_for(step.episodes);
        self.work = step.run.map(Work::Sandbox);
        Ok(())
    }

    /// One live sequence with the candidate in shadow.
    fn shadow_slice(&mut self, run: Box<ShadowRun>) -> Result<(), Fault> {
        self.work = Some(Work::Shadow(run));
        let Some(mut along) = self.shadow_to_take()? else { return Ok(()) };
        let task = along.task();
        let report = self.live().sequence(Some(&mut along))?;
        // A live task that somebody stopped says nothing about the candidate beside it.
        let live = report.task(task).map(|done| &done.record).filter(|_| !self.world.is_halted());
        let id = along.id();
        let (trace, fork) = along.conclude(live, report.seed);
        self.shadow_worked(&id, trace, fork)
    }

    /// What goes along with the next sequence; `None` if no candidate is in shadow, or if it cannot go on.
    fn shadow_to_take(&mut self) -> Result<Option<crate::world::shadow::Shadow>, Fault> {
        let mut run = match self.work.take() {
            Some(Work::Shadow(run)) => run,
            other => {
                self.work = other;
                return Ok(None);
            }
        };
        let Self { context, record, dossiers, monitors, .. } = self;
        let along = shadow::take_along(context, record, dossiers, monitors, &mut run)?;
        if along.is_some() {
            self.work = Some(Work::Shadow(run));
        }
        Ok(along)
    }

    /// Takes in what a candidate did in one sequence, if it is still in shadow.
    fn shadow_worked(
        &mut self,
        id: &CapabilityId,
        trace: Option<crate::world::shadow::ShadowTrace>,
        fork: Option<holdpoint_sim::world::World>,
    ) -> Result<(), Fault> {
        match self.work.take() {
            Some(Work::Shadow(run)) if run.id() == id => {
                let Self { context, record, dossiers, .. } = self;
                match shadow::take_in(context, record, dossiers, run, trace, fork)? {
                    ShadowStep::GoOn(run) => self.work = Some(Work::Shadow(run)),
                    ShadowStep::WorkAgain(run) => self.begin_again_in_shadow(run)?,
                    ShadowStep::Over => {}
                }
            }
            // The candidate left shadow meanwhile.
            other => self.work = other,
        }
        Ok(())
    }

    /// The live world works on while a candidate is evaluated: so many sequences fall due.
    fn live_due_for(&mut self, episodes: u64) {
        let share = f64::from(self.context.profile.evaluation.live_sequences_per_100_episodes) / 100.0;
        self.world.fall_due(share * f64::from(u32::try_from(episodes).unwrap_or(u32::MAX)));
    }

    /// A sequence of the live world falls due.
    pub(crate) fn work_one(&mut self) {
        self.world.fall_due(1.0);
    }

    /// The running stage of a version that left it.
    fn forget_work(&mut self, id: &CapabilityId) {
        self.approvals.close(id);
        self.work.take_if(|work| work.id() == id);
        self.parked.retain(|work| work.id() != id);
    }

    /// From now on pictures of the live world go to `pictures`, which must not wait.
    pub fn draw_live_world(&mut self, pictures: Pictures) {
        self.world.pictures = Some(pictures);
    }

    /// From now on the live world works on a thread of its own: `times` simulated seconds in a second (absent: as
    /// fast as it computes). Pictures of it go to `pictures`.
    pub fn pace_live_world(&mut self, times: Option<f64>, pictures: Pictures) {
        self.trials.work_in_small_parts();
        self.world.pictures = Some(pictures);
        self.world.work_on_a_thread(times);
    }

    /// Sequences that the live world has begun.
    #[must_use]
    pub const fn sequences(&self) -> u64 {
        self.world.cell.sequences()
    }

    /// Stops the arm where it works now. The sequence is over soon after.
    pub(crate) fn stop_arm(&self) {
        self.world.stop();
    }

    /// Whether the arm is being stopped.
    #[must_use]
    pub(crate) fn is_stopping(&self) -> bool {
        self.world.is_stopping()
    }

    /// How things stand.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let view = SnapshotView {
            context: &self.context,
            seed: self.trials.seed(),
            record: &self.record,
            dossiers: &self.dossiers,
            approvals: &self.approvals,
            signed_calls: &self.signed_calls,
            monitors: &self.monitors,
            world: &self.world,
        };
        view.snapshot()
    }

    /// What a version was refused for in the sandbox, worked again to be seen.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(crate) fn films_of_refusal(&self, id: &CapabilityId) -> Result<Vec<Film>, Fault> {
        retake::of_refusal(&self.context, &self.record, &self.dossiers, id)
    }

    /// Stops the arm where it works now, from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<Switch> {
        self.world.switch()
    }

    /// What is judged under, to try what happens under something else.
    #[cfg(test)]
    pub(crate) const fn context_mut(&mut self) -> &mut Context {
        &mut self.context
    }

    /// What is written and told.
    #[must_use]
    pub const fn record(&self) -> &Record {
        &self.record
    }

    /// Events since the last call, in order.
    pub fn drain_events(&mut self) -> Vec<EventKind> {
        self.record.take_events()
    }

    /// Tells something about scenes.
    pub fn tell_scene(&mut self, text: String, failed: bool) {
        self.record.tell(EventKind::Scene { text, failed });
    }

    /// Puts a closed recording on record, in the form that whoever keeps recordings gives it, and tells of it. A
    /// recording is for people: nothing that decides reads it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn keep_recording(
        &mut self,
        version: &CapabilityId,
        (kind, body): (RecordKind, String),
        told: EventKind,
    ) -> Result<(), Fault> {
        self.record.note(kind, version.to_string(), body)?;
        self.record.tell(told);
        Ok(())
    }

    /// A script's clock jumps to a deadline. Tells whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.record.jump_to(at_ms)
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        self.trials.cancel()
    }

    /// From now on nothing is approved, activated or begun; what is active stays.
    pub(crate) fn hold(&mut self, why: &(impl holdpoint_text::Hint + ?Sized)) {
        self.work = None;
        self.parked.clear();
        self.record.hold(why);
    }

    /// The engine ends in an orderly way: the sequence that runs is stopped and collected, open records are closed.
    pub(crate) fn end(&mut self) {
        self.world.stop();
        self.collect_sequence(true);
        self.take_in_halt();
        // What cannot be written lies beside the database, for the next engine.
        drop(halt::write_again(&mut self.record, &mut self.world));
        if self.record.holding().is_none()
            && let Err(fault) = resume::end(&self.context, &mut self.record, &mut self.resumptions)
        {
            self.hold(&fault.held());
        }
        // What cannot be written leaves a beginning without an end, which stops the next engine.
        drop(halt::end_work(&mut self.record, &mut self.world));
    }
}

fn has_provisional(entry: &FamilyEntry) -> bool {
    let active = entry.state.active().and_then(|version| entry.state.get(version));
    active.is_some_and(|version| version.flags.provisional && !version.flags.rollback_pending)
}
