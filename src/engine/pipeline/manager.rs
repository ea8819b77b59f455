//! The Upgrade Manager: takes every candidate through the seven stages, one slice of work at a time.
//!
//! It owns the ledger, the live world and the evidence, decides nothing itself (the rules in
//! `governance` do) and does nothing twice: each call to [`UpgradeManager::advance`] is one slice,
//! between two slices commands are taken. A fault of its own makes it hold: nothing is approved or
//! activated by it.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint_sim::SimError;

use super::cache::EpisodeCache;
use super::cell::Cell;
use super::dossier::Dossier;
use super::ledger::{Ledger, LedgerError, Moved, Note};
use super::live::LiveCell;
use super::paced::PacedWorld;
use super::sequence::Stopped;
use super::stages::activation::Prompt;
use super::stages::confirmation::ConfirmationRun;
use super::stages::monitoring::Watch;
use super::stages::resume::Resumption;
use super::stages::sandbox::SandboxRun;
use super::stages::shadowing::ShadowRun;
use holdpoint_governance::alarms::AlarmBook;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::{Event, Stage, State};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{AlarmPriority, Profile};
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::sink::Pictures;
use holdpoint_protocol::snapshot::ProgressView;
use holdpoint_registry::{AuditBody, Change, StoreError};
use holdpoint_runtime::capability::Capability;

/// A fault of the engine's own; it holds from then on.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// A transition could not be written.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The simulation failed.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// A record has no canonical form.
    #[error("a record has no canonical form: {0}")]
    Canonical(#[from] serde_json::Error),
    /// Something that cannot be is.
    #[error("{0}")]
    Impossible(String),
}

/// What a manager is made with.
pub struct Settings {
    /// Seed of the run.
    pub seed: u64,
    /// Workers for evaluation.
    pub jobs: usize,
    /// The profile.
    pub profile: Profile,
    /// Its compiled policies.
    pub table: PolicyTable,
    /// The cell.
    pub cell: Cell,
    /// Where episodes of active versions are kept.
    pub cache: EpisodeCache,
}

/// What a slice of work came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Something was done; there may be more.
    Worked,
    /// Nothing is left to do before a deadline (virtual ms) or a command.
    Idle {
        /// The next deadline.
        next_ms: Option<u64>,
    },
}

/// The stage that is being worked on.
pub(super) enum Work {
    Sandbox(Box<SandboxRun>),
    Shadow(Box<ShadowRun>),
    Confirmation(Box<ConfirmationRun>),
}

/// See the module's head.
pub struct UpgradeManager {
    pub(super) seed: u64,
    pub(super) jobs: usize,
    pub(super) profile: Arc<Profile>,
    pub(super) profile_digest: Digest,
    pub(super) table: Arc<PolicyTable>,
    pub(super) context_digest: Digest,
    pub(super) cell: Cell,
    pub(super) cache: EpisodeCache,
    pub(super) ledger: Ledger,
    pub(super) clock: Clock,
    pub(super) live: LiveCell,
    pub(super) live_due: f64,
    pub(super) pace: Option<f64>,
    pub(super) paced: Option<PacedWorld>,
    /// Where pictures of the live world go.
    pub(super) pictures: Option<Pictures>,
    /// The most pairs or drills of one slice at a time.
    pub(super) part: usize,
    /// How the last sequence was stopped, where it was.
    pub(super) stopped: Option<Stopped>,
    pub(super) resumptions: Vec<Resumption>,
    /// Approved, and waiting for the end of a sequence.
    pub(super) granted: BTreeSet<CapabilityId>,
    pub(super) recent: VecDeque<bool>,
    pub(super) last_tasks: Vec<holdpoint_protocol::event::TaskSummary>,
    pub(super) work: Option<Work>,
    pub(super) dossiers: BTreeMap<CapabilityId, Dossier>,
    pub(super) prompts: BTreeMap<CapabilityId, Prompt>,
    pub(super) watches: BTreeMap<Family, Watch>,
    pub(super) alarms: AlarmBook,
    pub(super) alarms_due_ms: u64,
    pub(super) events: Vec<EventKind>,
    pub(super) holding: Option<String>,
    pub(super) cancel: Arc<AtomicBool>,
}

impl UpgradeManager {
    /// A manager over an open ledger. Bootstraps `baselines` that the ledger does not know, marks
    /// what an interrupted engine left as not done, and sets the context.
    ///
    /// # Errors
    /// [`Fault`] where any of it cannot be written.
    pub fn new(
        settings: Settings,
        mut ledger: Ledger,
        clock: Clock,
        baselines: Vec<Capability>,
    ) -> Result<Self, Fault> {
        let Settings { seed, jobs, profile, table, cell, cache } = settings;
        let profile_digest = profile.digest()?;
        let context_digest =
            Digest::of_parts("holdpoint.context.v1", &[profile_digest.bytes(), table.digest.bytes()]);
        let name = profile.name.name();
        let known = ledger.store().views()?.context()?;
        let changed =
            known.as_ref().is_none_or(|(profile, policy, _)| profile != name || *policy != context_digest);
        let needs_approval = profile.activation.approval_bound;
        let at_ms = clock.now_ms();
        if changed {
            let json = serde_json::json!({ "profile": profile_digest, "policy": table.digest }).to_string();
            let context =
                Change::SetContext { profile: name.to_owned(), policy_digest: context_digest, json };
            ledger.write(vec![context], Vec::new(), at_ms)?;
            let families: Vec<Family> = ledger.families().map(|(family, _)| family.clone()).collect();
            for family in families {
                let event = Event::ContextChanged { needs_approval };
                ledger.transition(
                    &family,
                    event,
                    at_ms,
                    Note::because("the profile or its policies changed"),
                )?;
            }
        }
        let live = LiveCell::new(cell.clone())?;
        let mut manager = Self {
            seed,
            jobs,
            profile: Arc::new(profile),
            profile_digest,
            table: Arc::new(table),
            context_digest,
            cell,
            cache,
            ledger,
            clock,
            live,
            live_due: 0.0,
            pace: None,
            paced: None,
            pictures: None,
            part: usize::MAX,
            stopped: None,
            resumptions: Vec::new(),
            granted: BTreeSet::new(),
            recent: VecDeque::new(),
            last_tasks: Vec::new(),
            work: None,
            dossiers: BTreeMap::new(),
            prompts: BTreeMap::new(),
            watches: BTreeMap::new(),
            alarms: AlarmBook::new(),
            alarms_due_ms: 0,
            events: Vec::new(),
            holding: None,
            cancel: Arc::new(AtomicBool::new(false)),
        };
        manager.announce();
        for baseline in baselines {
            let family = baseline.id().family;
            if manager.ledger.family(&family).is_err() {
                manager.bootstrap(baseline, needs_approval)?;
            }
        }
        manager.recover()?;
        Ok(manager)
    }

    fn announce(&mut self) {
        let active = self
            .ledger
            .families()
            .filter_map(|(_, entry)| entry.active().map(|member| member.capability.id()))
            .collect();
        self.emit(EventKind::EngineStarted {
            profile: self.profile.name,
            robot: self.cell.model.name.clone(),
            seed: self.seed,
            policy: self.context_digest,
            agent: self.live.agent_hash(),
            active,
        });
    }

    fn bootstrap(&mut self, baseline: Capability, needs_approval: bool) -> Result<(), Fault> {
        let id = baseline.id();
        let event = registered_event(&baseline);
        let note = Note {
            cause: Some(holdpoint_registry::ActiveCause::Bootstrap),
            ..Note::because("the version the cell was commissioned with")
        };
        let at_ms = self.clock.now_ms();
        self.ledger.register(baseline, true, needs_approval, at_ms, note)?;
        self.emit(event);
        self.emit(EventKind::StateChanged {
            version: id,
            from: State::Registered,
            to: State::Active,
            reason: "the version the cell was commissioned with".to_owned(),
        });
        Ok(())
    }

    /// One slice of work.
    pub fn advance(&mut self) -> Progress {
        if self.holding.is_some() {
            self.look_at_alarms();
            self.come_home(false);
            return Progress::Idle { next_ms: None };
        }
        match self.slice() {
            Ok(progress) => progress,
            // Interrupted on purpose: the stage stays marked as running and is run again at the next start.
            Err(_) if self.cancel.load(Ordering::Relaxed) => Progress::Idle { next_ms: None },
            Err(fault) => {
                self.hold(&fault.to_string());
                Progress::Idle { next_ms: None }
            }
        }
    }

    fn slice(&mut self) -> Result<Progress, Fault> {
        self.look_at_alarms();
        if self.is_paced() {
            return self.paced_slice();
        }
        if self.look_at_deadlines()? {
            return Ok(Progress::Worked);
        }
        if self.live_due >= 1.0 {
            self.live_due -= 1.0;
            self.live_sequence(None)?;
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
            None => {}
        }
        if let Some(id) = self.next_confirmation() {
            self.begin_confirmation(&id)?;
            return Ok(Progress::Worked);
        }
        if let Some((id, stage)) = self.next_stage() {
            self.begin(&id, stage)?;
            return Ok(Progress::Worked);
        }
        if self.ledger.families().any(|(_, entry)| has_provisional(entry)) {
            self.live_sequence(None)?;
            return Ok(Progress::Worked);
        }
        Ok(Progress::Idle { next_ms: self.next_deadline_ms() })
    }

    /// The first candidate, in order of family and registration, with a stage to begin.
    pub(super) fn next_stage(&self) -> Option<(CapabilityId, Stage)> {
        for (_, entry) in self.ledger.families() {
            for (member, version) in entry.members.iter().zip(&entry.state.versions) {
                let id = member.capability.id();
                let held = self.dossiers.get(&id).is_some_and(|dossier| dossier.held);
                if version.flags.paused || version.flags.awaiting_approval || held {
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

    pub(super) fn begin(&mut self, id: &CapabilityId, stage: Stage) -> Result<(), Fault> {
        match stage {
            Stage::Validation => self.validate(id),
            Stage::Sandbox => self.begin_sandbox(id),
            Stage::Shadow => self.begin_shadow(id),
            Stage::Activation => self.activation(id),
        }
    }

    /// Marks a stage as running and says so. A repeated stage runs already.
    pub(super) fn start_stage(&mut self, id: &CapabilityId, stage: Stage, budget: u64) -> Result<(), Fault> {
        let (version, standing, _) = self.ledger.version(id)?;
        if standing.flags.running != Some(stage) {
            self.transition(
                &id.family.clone(),
                Event::Start { version, stage },
                Note::because("the stage begins"),
            )?;
        }
        self.emit(EventKind::StageStarted { version: id.clone(), stage, budget });
        Ok(())
    }

    /// Applies a lifecycle event and tells what moved.
    pub(super) fn transition(
        &mut self,
        family: &Family,
        event: Event,
        note: Note,
    ) -> Result<Vec<Moved>, Fault> {
        let reason = note.reason.clone();
        let at_ms = self.clock.now_ms();
        let moved = self.ledger.transition(family, event, at_ms, note)?;
        for Moved { id, from, to } in &moved {
            self.events.push(EventKind::StateChanged {
                version: id.clone(),
                from: *from,
                to: *to,
                reason: reason.clone(),
            });
        }
        Ok(moved)
    }

    pub(super) fn progress(&mut self, id: &CapabilityId, stage: Stage, what: &str, done: u64, budget: u64) {
        let now_ms = self.clock.now_ms();
        let before = self.dossier(id).progress.as_ref();
        let since_ms = before.filter(|view| view.stage == stage).map_or(now_ms, |view| view.since_ms);
        let early = early(stage).to_owned();
        let view = ProgressView { stage, what: what.to_owned(), done, budget, since_ms, early };
        self.dossier(id).progress = Some(view);
        self.emit(EventKind::Progress { version: id.clone(), stage, what: what.to_owned(), done, budget });
    }

    pub(super) fn dossier(&mut self, id: &CapabilityId) -> &mut Dossier {
        self.dossiers.entry(id.clone()).or_default()
    }

    pub(super) fn emit(&mut self, event: EventKind) {
        self.events.push(event);
    }

    /// Whether the live world works on a thread of its own.
    pub(super) const fn is_paced(&self) -> bool {
        self.paced.is_some()
    }

    /// Whether the running stage is this version's.
    pub(super) fn works_on(&self, id: &CapabilityId) -> bool {
        match &self.work {
            Some(Work::Sandbox(run)) => run.is_of(id),
            Some(Work::Shadow(run)) => run.is_of(id),
            Some(Work::Confirmation(run)) => run.is_of(id),
            None => false,
        }
    }

    /// Events since the last call, in order.
    pub fn drain_events(&mut self) -> Vec<EventKind> {
        std::mem::take(&mut self.events)
    }

    /// The clock.
    #[must_use]
    pub const fn clock(&self) -> &Clock {
        &self.clock
    }

    /// A script's clock jumps to a deadline. Tells whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        self.clock.jump_to(at_ms)
    }

    /// Why the manager holds, where it does.
    #[must_use]
    pub fn holding(&self) -> Option<&str> {
        self.holding.as_deref()
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.cancel)
    }

    /// From now on nothing is approved, activated or begun; what is active stays.
    pub(super) fn hold(&mut self, why: &str) {
        self.holding = Some(why.to_owned());
        self.work = None;
        self.emit(EventKind::Fault { text: why.to_owned() });
        self.raise("engine-fault", "engine", AlarmPriority::High, true, why);
    }

    /// The active version of a candidate's family.
    pub(super) fn active_of(&self, family: &Family) -> Option<Capability> {
        self.ledger.family(family).ok()?.active().map(|member| member.capability.clone())
    }

    /// A registered version.
    pub(super) fn capability(&self, id: &CapabilityId) -> Result<Capability, Fault> {
        Ok(self.ledger.version(id)?.2.capability.clone())
    }

    /// Closes the record of an upgrade: how it ended, and how many records are about it.
    pub(super) fn close_audit(&mut self, id: &CapabilityId, outcome: UpgradeEnd) -> Result<(), Fault> {
        let detail = self.ledger.store().views()?.version(id)?;
        let records = detail.map_or(0, |detail| detail.audit_links.len() as u64);
        let body = serde_json::json!({ "outcome": outcome, "records": records }).to_string();
        let record = AuditBody {
            kind: holdpoint_governance::record::RecordKind::AuditClosed,
            subject: id.to_string(),
            body,
        };
        let at_ms = self.clock.now_ms();
        self.ledger.write(Vec::new(), vec![record], at_ms)?;
        self.emit(EventKind::AuditClosed { version: id.clone(), outcome, records });
        Ok(())
    }
}

/// What would end a stage before its budget is worked, one sentence.
const fn early(stage: Stage) -> &'static str {
    match stage {
        Stage::Validation | Stage::Activation => "",
        Stage::Sandbox => {
            "a hard stop, or an outcome that the rest of the budget cannot change, ends it before the budget is worked"
        }
        Stage::Shadow => "a hard stop of the twin ends it at once; a doubt that stays lengthens it once",
    }
}

pub(super) fn registered_event(capability: &Capability) -> EventKind {
    let submission = &capability.submission;
    EventKind::Registered {
        version: capability.id(),
        digest: capability.digest(),
        author: submission.author.clone(),
        provenance: submission.provenance,
        risk: submission.estimated_risk,
        parent: submission.parent.as_ref().map(ToString::to_string),
    }
}

fn has_provisional(entry: &super::ledger::Entry) -> bool {
    let active = entry.state.active().and_then(|version| entry.state.get(version));
    active.is_some_and(|version| version.flags.provisional && !version.flags.rollback_pending)
}
