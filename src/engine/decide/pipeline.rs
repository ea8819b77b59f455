//! The pipeline: takes every candidate through the seven stages, one slice at a time.
//!
//! It owns the parts (record, evidence, approvals, monitors, live cell, the running stage), selects the next stage, and gives
//! each stage the parts it needs. The rules in governance decide. Each call to [`Pipeline::advance`] runs one slice; commands
//! run between two slices. After a fault of its own the pipeline is halted: it approves and activates nothing.

mod commands;
mod concerns;
pub(crate) mod concurrent;
mod evaluation_time;
#[cfg(feature = "experiments")]
pub mod experiment;
mod halted;
mod parked;
mod seed_keys;
pub mod snapshot;
mod stage_work;
mod startup;

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_governance::ablation::AblatedParts;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::profile_downgrade::AdmissionContext;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::site_profile::ProfileTexts;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::sink::VideoFrameSink;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::seeds::SeedKey;
use holdpoint_trials::Trials;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

use self::snapshot::SnapshotView;
use self::stage_work::StageWork;
use crate::decide::health::CellHealth;
use crate::decide::people::approvals::Approvals;
use crate::decide::people::signed_calls::SignedCalls;
use crate::decide::recorder::EngineRecorder;
use crate::decide::stages::activation::Activation;
use crate::decide::stages::live_harm::LiveHarmWatch;
use crate::decide::stages::monitoring::LiveMonitoring;
use crate::decide::stages::resume::{self, Resumption};
use crate::decide::stages::sandbox::{Sandbox, SandboxRun};
use crate::decide::stages::shadow::{self, ShadowRun, ShadowStep};
use crate::decide::stages::{break_glass, confirmation};
use crate::decide::store_identity::{self, StoreUse};
use crate::decide::{clock_mismatch, goal, halt, restart};
use crate::fault::EngineFault;
use crate::live::LiveWorld;
use crate::live::monitors::Monitors;
use crate::live::stop_switch::{Controls, StopSwitch};
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::store_robot::StoreRobot;
use holdpoint_record::version_table::{FamilyEntry, VersionTable};

/// The settings of a pipeline.
pub struct PipelineSettings {
    /// The seeds of its episodes.
    pub seeds: EpisodeSeeds,
    pub jobs: usize,
    pub profile: Profile,
    pub table: PolicyTable,
    /// The texts of a custom profile, which are recorded.
    pub own: Option<ProfileTexts>,
    pub cell: Cell,
    /// Where episodes of active versions are cached.
    pub cache: EpisodeCache,
    /// The controls for other threads.
    pub controls: Controls,
    /// The parts that an experiment omits.
    pub omitted: AblatedParts,
}

/// The outcome of a slice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SliceOutcome {
    /// It did something; there may be more.
    Ran,
    /// There is nothing to do before a deadline (virtual ms) or a command.
    Idle { next_ms: Option<u64> },
}

/// See the module comment.
pub struct Pipeline {
    context: Context,
    trials: Trials,
    record: EngineRecorder,
    evidence_files: EvidenceFiles,
    approvals: Approvals,
    signed_calls: SignedCalls,
    monitors: Monitors,
    world: LiveWorld,
    resumptions: Vec<Resumption>,
    health: CellHealth,
    live_harm: LiveHarmWatch,
    agent: Digest,
    work: Option<StageWork>,
    /// Stages of versions that are paused or on hold, and of resumed ones until no other is under way.
    parked: Vec<StageWork>,
    /// Stages begin only by a call.
    on_call: bool,
}

impl Pipeline {
    /// A pipeline over an open version table. Registers missing `baselines`, undoes interrupted stages, and sets the context.
    ///
    /// # Errors
    /// [`EngineFault`] if any of it cannot be written.
    pub fn new(
        settings: PipelineSettings,
        mut version_table: VersionTable,
        clock: Clock,
        baselines: Vec<Capability>,
    ) -> Result<Self, EngineFault> {
        let PipelineSettings { seeds, jobs, profile, table, own, cell, cache, controls, omitted } = settings;
        // A bundle's seed follows from its episode's alone, so that an episode can be run again from the record.
        let bundle_seeds = SeedKey::of_run(seeds.of_run().unwrap_or_default());
        let mut context = Context::new(profile, table, own, cell)?.seeded(bundle_seeds).without(omitted);
        let Controls { switch, cancel } = controls;
        let world = LiveWorld::new(context.cell.clone(), switch)?;
        version_table.begin_persons()?;
        let agent = store_identity::agent(&*version_table.store().views()?)?
            .unwrap_or_else(|| world.cell.agent_hash());
        // A decision with known seeds counts as a script's decision.
        let scripted = clock.is_scripted() || seeds.of_run().is_some();
        let admission = AdmissionContext { class: context.profile.name, scripted };
        version_table.bind(&StoreRobot::of(&context.cell), admission);
        let voided = match store_identity::set_context(
            &context,
            &mut version_table,
            agent,
            (clock.now_ms(), scripted),
        )? {
            StoreUse::InForce(voided) => voided,
            StoreUse::Unauthorized(why) => {
                context.unauthorized = Some(why);
                world.switch().latch();
                None
            }
        };
        let mut pipeline = Self {
            world,
            agent,
            context,
            trials: Trials::new(jobs, cache, cancel),
            record: EngineRecorder::new(version_table, clock),
            evidence_files: EvidenceFiles::default(),
            approvals: Approvals::default(),
            signed_calls: SignedCalls::new()?,
            monitors: Monitors::default(),
            resumptions: Vec::new(),
            health: CellHealth::default(),
            live_harm: LiveHarmWatch::default(),
            work: None,
            parked: Vec::new(),
            on_call: false,
        };
        pipeline.record.begin_keys(seeds)?;
        pipeline.record.recall_alarms()?;
        clock_mismatch::recall(&mut pipeline.record)?;
        clock_mismatch::check(&mut pipeline.record)?;
        pipeline.health = CellHealth::recall(&pipeline.context, &pipeline.record)?;
        halt::restore_stop(&mut pipeline.record, &mut pipeline.world)?;
        let tasks = pipeline.world.cell.tasks();
        let goal = goal::recall(&*pipeline.record.version_table().store().views()?, tasks)?;
        if let Some(goal) = goal {
            pipeline.world.cell.goal = goal;
        }
        // A stop from before the start is recorded first.
        pipeline.take_in_halt();
        pipeline.announce(voided);
        if let Err(fault) = pipeline.bound_agent().check() {
            pipeline.hold(&fault.halt_problem());
            return Ok(pipeline);
        }
        pipeline.look_at_authorization();
        for baseline in baselines {
            let family = baseline.id().family;
            if pipeline.context.unauthorized.is_none()
                && pipeline.record.version_table().family(&family).is_err()
            {
                pipeline.bootstrap(baseline)?;
            }
        }
        let mut approvals = Approvals::default();
        restart::recover(&mut pipeline.live(), &mut approvals)?;
        pipeline.approvals = approvals;
        Ok(pipeline)
    }

    pub(crate) fn live(&mut self) -> LiveMonitoring<'_> {
        self.live_and_approvals().0
    }

    fn live_and_approvals(&mut self) -> (LiveMonitoring<'_>, &mut Approvals) {
        let live = LiveMonitoring {
            context: &self.context,
            record: &mut self.record,
            evidence_files: &mut self.evidence_files,
            monitors: &mut self.monitors,
            world: &mut self.world,
            resumptions: &mut self.resumptions,
            health: &mut self.health,
            live_harm: &mut self.live_harm,
            is_starting: false,
        };
        (live, &mut self.approvals)
    }

    pub(crate) fn activation(&mut self) -> Activation<'_> {
        Activation {
            context: &self.context,
            agent: self.bound_agent(),
            sequence_runs: self.world.is_running() || self.world.is_halted(),
            cell_stands: self.world.is_halted(),
            record: &mut self.record,
            evidence_files: &mut self.evidence_files,
            approvals: &mut self.approvals,
            monitors: &mut self.monitors,
        }
    }

    /// Runs one slice.
    pub fn advance(&mut self) -> SliceOutcome {
        self.take_in_halt();
        let profile = self.context.profile.name;
        if self.record.holding().is_none()
            && let Err(error) = halt::begin_work(&mut self.record, &mut self.world, profile)
        {
            self.hold(&EngineFault::from(error).halt_problem());
        }
        if let Err(error) = clock_mismatch::check(&mut self.record)
            && self.record.holding().is_none()
        {
            self.hold(&EngineFault::from(error).halt_problem());
        }
        if self.record.holding().is_some() {
            self.look_at_alarms();
            self.collect_sequence(false);
            return SliceOutcome::Idle { next_ms: None };
        }
        match self.slice().and_then(|progress| self.reveal_finished_keys().map(|()| progress)) {
            Ok(progress) => progress,
            // Interrupted on purpose: the stage stays marked as running and runs again at the next start.
            Err(_) if self.trials.is_cancelled() => SliceOutcome::Idle { next_ms: None },
            // Also if only the end of a candidate's stage cannot be written: what was measured is nowhere else, and the next
            // live task could not be put on record either. The next engine runs the stage again.
            Err(fault) => {
                self.hold(&fault.halt_problem());
                SliceOutcome::Idle { next_ms: None }
            }
        }
    }

    fn slice(&mut self) -> Result<SliceOutcome, EngineFault> {
        self.record.version_table().store().check_unaltered()?;
        self.look_at_alarms();
        self.unpark();
        if self.world.is_halted() {
            return self.halted_slice();
        }
        if self.world.is_paced() {
            return self.concurrent_slice();
        }
        if self.look_at_deadlines()? || self.activation().take_granted()? {
            return Ok(SliceOutcome::Ran);
        }
        if !self.resumptions.is_empty() {
            // A version was rolled back while the cell was stopped.
            let report = self.live().sequence(None)?;
            resume::look_at(&self.context, &mut self.record, &mut self.resumptions, &report)?;
            return Ok(SliceOutcome::Ran);
        }
        if self.world.take_due() {
            self.live().sequence(None)?;
            return Ok(SliceOutcome::Ran);
        }
        if let Some(work) = self.work.take() {
            self.work_slice(work)?;
            return Ok(SliceOutcome::Ran);
        }
        if let Some(id) = confirmation::next(&self.monitors, &self.evidence_files).filter(|_| !self.on_call) {
            self.begin_confirmation(&id)?;
            return Ok(SliceOutcome::Ran);
        }
        if !self.on_call && self.begin_re_evaluation()? {
            return Ok(SliceOutcome::Ran);
        }
        if let Some((id, stage)) = self.next_stage() {
            self.begin(&id, stage)?;
            return Ok(SliceOutcome::Ran);
        }
        if self.record.version_table().families().any(|(_, entry)| has_provisional(entry)) {
            self.live().sequence(None)?;
            return Ok(SliceOutcome::Ran);
        }
        Ok(SliceOutcome::Idle { next_ms: self.next_deadline_ms() })
    }

    /// Handles expired approval requests and escalations. Returns whether there were any.
    pub(crate) fn look_at_deadlines(&mut self) -> Result<bool, EngineFault> {
        if self.activation().look_at_deadlines()? || self.live().look_at_monitors()? {
            return Ok(true);
        }
        let (mut live, approvals) = self.live_and_approvals();
        break_glass::look_at_reviews(&mut live, approvals)
    }

    pub(crate) fn next_deadline_ms(&self) -> Option<u64> {
        let monitors = self.monitors.next_ms(self.world.cell.link_is_up());
        let people = self.approvals.next().map(|until| self.record.engine_ms_at(until));
        people.into_iter().chain(monitors).min()
    }

    fn look_at_alarms(&mut self) {
        self.record.look_at_alarms(&self.monitors, self.world.works());
    }

    /// The first candidate, by family and registration, with a stage to begin.
    fn next_stage(&self) -> Option<(CapabilityId, Stage)> {
        if self.on_call {
            return None;
        }
        for (_, entry) in self.record.version_table().families() {
            for (member, version) in entry.members.iter().zip(&entry.state.versions) {
                let id = member.capability.id();
                if version.flags.paused || version.flags.awaiting_approval || self.evidence_files.is_held(&id)
                {
                    continue;
                }
                // A comparison needs an active version: a stopped family is reactivated first.
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

    /// Runs a slice of the stage that is under way.
    fn work_slice(&mut self, work: StageWork) -> Result<(), EngineFault> {
        match work {
            StageWork::Sandbox(run) => self.sandbox_slice(run),
            StageWork::Shadow(run) => self.shadow_slice(run),
            StageWork::Confirmation(run) => self.confirmation_slice(run),
            StageWork::ReEvaluation(run) => self.re_evaluation_slice(run),
        }
    }

    fn sandbox_slice(&mut self, run: Box<SandboxRun>) -> Result<(), EngineFault> {
        let (id, begun_ms) = (run.id.clone(), self.record.now_ms());
        let mut sandbox = Sandbox {
            context: &self.context,
            trials: &self.trials,
            record: &mut self.record,
            evidence_files: &mut self.evidence_files,
        };
        let step = sandbox.slice(run)?;
        self.note_slice_time(&id, begun_ms);
        self.live_due_for(step.episodes);
        self.work = step.run.map(StageWork::Sandbox);
        Ok(())
    }

    fn shadow_slice(&mut self, run: Box<ShadowRun>) -> Result<(), EngineFault> {
        self.work = Some(StageWork::Shadow(run));
        let Some(mut along) = self.shadow_to_take()? else { return Ok(()) };
        if self.trials.jobs() > 1 && self.world.frame_sink.is_none() {
            along.run_twin_beside(Box::new(|_, _| {}));
        }
        let task = along.task();
        let report = self.live().sequence(Some(&mut along))?;
        // A live task that was stopped is no comparison for the candidate.
        let live = report.task(task).map(|done| &done.record).filter(|_| !self.world.is_halted());
        let id = along.id();
        let (trace, fork) = along.conclude(live, report.seed);
        self.shadow_worked(&id, trace, fork)
    }

    /// The shadow of the next sequence; `None` if no candidate is in shadow, or if it cannot continue.
    fn shadow_to_take(&mut self) -> Result<Option<crate::live::shadow::Shadow>, EngineFault> {
        let mut run = match self.work.take() {
            Some(StageWork::Shadow(run)) => run,
            other => {
                self.work = other;
                return Ok(None);
            }
        };
        let Self { context, record, evidence_files, monitors, .. } = self;
        let shadow = shadow::take_along(context, record, evidence_files, monitors, &mut run)?;
        if shadow.is_some() {
            self.work = Some(StageWork::Shadow(run));
        }
        Ok(shadow)
    }

    /// Adds the results of one sequence in shadow, if the candidate is still in shadow.
    fn shadow_worked(
        &mut self,
        id: &CapabilityId,
        trace: Option<crate::live::shadow::ShadowTrace>,
        fork: Option<Box<dyn holdpoint_cell::TrialCell>>,
    ) -> Result<(), EngineFault> {
        match self.work.take() {
            Some(StageWork::Shadow(run)) if run.id == *id => {
                let Self { context, record, evidence_files, .. } = self;
                match shadow::take_in(context, record, evidence_files, run, trace, fork)? {
                    ShadowStep::GoOn(run) => self.work = Some(StageWork::Shadow(run)),
                    ShadowStep::ReEvaluate(run) => self.begin_again_in_shadow(run)?,
                    ShadowStep::Over => {}
                }
            }
            other => self.work = other,
        }
        Ok(())
    }

    /// Makes live sequences due while a candidate is evaluated.
    fn live_due_for(&mut self, episodes: u64) {
        let share = f64::from(self.context.profile.evaluation.live_sequences_per_100_episodes) / 100.0;
        self.world.fall_due(share * f64::from(u32::try_from(episodes).unwrap_or(u32::MAX)));
    }

    pub(crate) fn work_one(&mut self) {
        self.world.fall_due(1.0);
    }

    fn forget_work(&mut self, id: &CapabilityId) {
        self.approvals.close(id);
        self.work.take_if(|work| work.id() == id);
        self.parked.retain(|work| work.id() != id);
    }

    /// From now on sends frames of the live cell to `sink`, which must not wait.
    pub fn draw_live_world(&mut self, sink: VideoFrameSink) {
        self.world.frame_sink = Some(sink);
    }

    /// Runs the live cell on its own thread, at `times` real time (absent: unlimited); its frames go to `sink`.
    pub fn pace_live_world(&mut self, times: Option<f64>, sink: VideoFrameSink) {
        self.trials.work_in_small_parts();
        self.world.frame_sink = Some(sink);
        self.world.work_on_a_thread(times);
    }

    /// The number of live sequences begun.
    #[must_use]
    pub const fn sequences(&self) -> u64 {
        self.world.cell.sequences()
    }

    pub(crate) fn stop_arm(&self) {
        self.world.stop();
    }

    #[must_use]
    pub(crate) fn is_stopping(&self) -> bool {
        self.world.is_stopping()
    }

    /// The current state.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let view = SnapshotView {
            context: &self.context,
            record: &self.record,
            evidence_files: &self.evidence_files,
            approvals: &self.approvals,
            signed_calls: &self.signed_calls,
            monitors: &self.monitors,
            world: &self.world,
            parked: &self.parked,
        };
        view.snapshot()
    }

    /// The switch that stops the arm from any thread.
    #[must_use]
    pub fn switch(&self) -> Arc<StopSwitch> {
        self.world.switch()
    }

    #[cfg(test)]
    pub(crate) const fn context_mut(&mut self) -> &mut Context {
        &mut self.context
    }

    /// The record.
    #[must_use]
    pub const fn record(&self) -> &EngineRecorder {
        &self.record
    }

    /// Events since the last call, in order.
    pub fn drain_events(&mut self) -> Vec<EventKind> {
        self.record.take_events()
    }

    /// Publishes a message about scenes.
    pub fn tell_scene(&mut self, text: String, failed: bool) {
        self.record.tell(EventKind::Scene { text, failed });
    }

    /// Records a closed recording, in the form of its recorder, and publishes it. No decision reads a recording.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn keep_recording(
        &mut self,
        version: &CapabilityId,
        (kind, body): (RecordKind, String),
        event: EventKind,
    ) -> Result<(), EngineFault> {
        self.record.note(kind, version.to_string(), body)?;
        self.record.tell(event);
        Ok(())
    }

    /// Advances a script's clock to a deadline. Returns whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.record.jump_to(at_ms)
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        self.trials.cancel()
    }

    /// Halts the pipeline: from now on nothing is approved, activated or begun; active versions stay active.
    pub(crate) fn hold(&mut self, why: &(impl holdpoint_text::Hint + ?Sized)) {
        self.work = None;
        self.parked.clear();
        self.record.hold(why);
    }

    /// Ends the engine cleanly: stops and collects the running sequence, and closes open records.
    pub(crate) fn end(&mut self) {
        self.world.stop();
        self.collect_sequence(true);
        self.take_in_halt();
        // Stops that cannot be written stay beside the database, for the next engine.
        drop(halt::write_again(&mut self.record, &mut self.world));
        if self.record.holding().is_none()
            && let Err(fault) = resume::end(&self.context, &mut self.record, &mut self.resumptions)
        {
            self.hold(&fault.halt_problem());
        }
        // If this fails, the record has a beginning without an end, which stops the cell at the next start.
        drop(halt::end_work(&mut self.record, &mut self.world));
    }
}

fn has_provisional(entry: &FamilyEntry) -> bool {
    let active = entry.state.active().and_then(|version| entry.state.get(version));
    active.is_some_and(|version| version.flags.provisional && !version.flags.rollback_pending)
}
