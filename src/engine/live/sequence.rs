//! One sequence of the live world in three steps: begun with all it takes, worked, ended.
//!
//! Begun and ended on the engine's thread; run there in one slice, or on a thread of its own at the pace of a clock.
//! A running sequence owns its arm, its agent, its monitors and its view of the active versions, so that the engine
//! cannot change them meanwhile.

use std::collections::BTreeMap;
use std::sync::Arc;

use holdpoint_body::TaskKind;
use holdpoint_cell::TrialCell;

use super::listener::Listener;
use super::shadow::ShadowTrace;
use super::station::{LiveStation, RunningSequence, SequenceReport};
use super::supervisor::{MonitorQuestions, SequenceSupervisor};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::start_domain::{OutsideResponse, StartDomain, StartObservation};
use holdpoint_protocol::clock::Clock;
use holdpoint_protocol::video_frame::EnvelopeView;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::limits::Envelope;
use holdpoint_runtime::recovery::RecoveryReport;
use holdpoint_runtime::start_check::StartCheck;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell_frame;
use holdpoint_trials::seeds::{SeedPurpose, SeedSource};

use crate::fault::EngineFault;
use crate::live::monitors::Monitors;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_binding::{not_admitted, start_domain};
use holdpoint_record::evidence_file::EvidenceFiles;
use holdpoint_record::version_table::VersionTable;

/// The versions that were active when the sequence began, those behind them, and what their evidence covers.
pub(crate) struct VersionsAtStart {
    active: BTreeMap<Family, Capability>,
    /// The superseded versions behind each active one, the newest first; empty unless the profile lets them run tasks.
    earlier: BTreeMap<Family, Vec<Capability>>,
    domains: BTreeMap<CapabilityId, Arc<StartDomain>>,
    outside: OutsideResponse,
}

impl ActiveView for VersionsAtStart {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.active.get(family)
    }

    fn start_check(&self, version: &CapabilityId) -> Option<StartCheck> {
        let domain = self.domains.get(version)?;
        Some(StartCheck::new(Arc::clone(domain), self.outside != OutsideResponse::Count))
    }

    fn covering(&self, family: &Family, seen: &StartObservation) -> Option<&Capability> {
        let covers = |version: &&Capability| {
            self.domains.get(&version.id()).is_some_and(|domain| domain.misses(seen).is_empty())
        };
        self.earlier.get(family)?.iter().find(covers)
    }
}

impl VersionsAtStart {
    /// The active versions that are admitted to the arm now. A version whose rollback has begun commands nothing any more.
    fn new(context: &Context, version_table: &VersionTable, evidence_files: &EvidenceFiles) -> Self {
        let outside = context.profile.domain.outside;
        let is_admitted = |version: &Capability| not_admitted(context, version_table, version).is_none();
        let mut active = BTreeMap::new();
        let mut earlier = BTreeMap::new();
        for (family, entry) in version_table.families() {
            let version = entry.state.active().and_then(|version| entry.state.get(version));
            let is_revoked = version.is_some_and(|version| version.flags.rollback_pending);
            let Some(member) = entry.active().filter(|member| !is_revoked && is_admitted(&member.capability))
            else {
                continue;
            };
            active.insert(family.clone(), member.capability.clone());
            if outside == OutsideResponse::LastCovering {
                let behind = entry.predecessors().map(|member| &member.capability);
                let behind: Vec<Capability> =
                    behind.filter(|version| is_admitted(version)).cloned().collect();
                earlier.insert(family.clone(), behind);
            }
        }
        let mut versions = Self { active, earlier, domains: BTreeMap::new(), outside };
        let domains =
            versions.all().map(|version| (version.id(), start_domain(context, evidence_files, version)));
        versions.domains = domains.collect();
        versions
    }

    /// Every version that may run a task.
    fn all(&self) -> impl Iterator<Item = &Capability> {
        self.active.values().chain(self.earlier.values().flatten())
    }

    /// The version that runs a task.
    pub(crate) fn at_work(&self, task: TaskKind) -> Option<CapabilityId> {
        self.active.get(&Family::from(task)).map(Capability::id)
    }
}

/// A sequence that is about to be worked.
pub(crate) struct StartedSequence {
    index: u64,
    seed: u64,
    running: RunningSequence,
    actives: VersionsAtStart,
    terms: Vec<(CapabilityId, SkillTerms)>,
    spare: SkillTerms,
    supervisor: SequenceSupervisor,
    link_up: bool,
}

/// A sequence that has run.
pub(crate) struct FinishedSequence {
    pub(crate) index: u64,
    pub(crate) running: RunningSequence,
    pub(crate) report: SequenceReport,
    pub(crate) supervisor: SequenceSupervisor,
    pub(crate) link_up: bool,
    /// What the guard held each version to.
    pub(crate) envelopes: BTreeMap<CapabilityId, Envelope>,
    /// The arm was stopped from outside.
    pub(crate) stopped: Option<StoppedTask>,
    /// What shadow came to, if a candidate was in shadow.
    pub(crate) shadow: Option<ShadowResult>,
}

/// A task that was stopped in flight.
#[derive(Clone, Debug)]
pub(crate) struct StoppedTask {
    /// Who was at work.
    pub(crate) id: Option<CapabilityId>,
    /// When, ticks of the live world.
    pub(crate) world_tick: u64,
    /// When, virtual ticks of the engine.
    pub(crate) tick: u64,
    /// What was done to stop the arm.
    pub(crate) report: Option<RecoveryReport>,
    /// A person stopped the cell, rather than asked for something the arm has to stand for.
    pub(crate) halted: bool,
}

impl StoppedTask {
    /// A sequence worked in step, whose last task was stopped.
    pub(crate) fn here(report: &SequenceReport, tick: u64) -> Self {
        let last = report.tasks.last().map(|done| (done.id.clone(), done.record.recovered));
        let (id, report) = last.unzip();
        Self { id, world_tick: 0, tick, report: report.flatten(), halted: true }
    }
}

/// What a candidate in shadow gave in one sequence.
pub(crate) struct ShadowResult {
    pub(crate) id: CapabilityId,
    pub(crate) trace: Option<ShadowTrace>,
    pub(crate) fork: Option<Box<dyn TrialCell>>,
}

impl StartedSequence {
    pub(crate) const fn index(&self) -> u64 {
        self.index
    }

    /// Who works what in it, and the envelope that holds them.
    pub(crate) fn workers(&self) -> Vec<(TaskKind, CapabilityId, EnvelopeView)> {
        let worker = |task: TaskKind| {
            let id = self.actives.at_work(task)?;
            let terms =
                self.terms.iter().find(|(known, _)| *known == id).map_or(&self.spare, |(_, terms)| terms);
            Some((task, id, cell_frame::envelope(terms.envelope())))
        };
        self.running.tasks().iter().copied().filter_map(worker).collect()
    }

    /// Reports questions of its monitors while it runs.
    pub(crate) fn tell_at_once(&mut self, questions: MonitorQuestions) {
        self.supervisor.tell_at_once(questions);
    }

    pub(crate) fn run(self, listener: &mut dyn Listener) -> FinishedSequence {
        let Self { index, seed, mut running, actives, terms, spare, mut supervisor, link_up } = self;
        let choose = |capability: &Capability| {
            let id = capability.id();
            let known = terms.iter().find(|(known, _)| *known == id);
            known.map_or_else(|| spare.clone(), |(_, terms)| terms.clone())
        };
        let report = running.run(&actives, &choose, seed, listener, Some(&mut supervisor));
        let envelopes = terms.iter().map(|(id, terms)| (id.clone(), *terms.envelope())).collect();
        let (stopped, shadow) = (None, None);
        FinishedSequence { index, running, report, supervisor, link_up, envelopes, stopped, shadow }
    }
}

/// Gives arm, agent and monitors to one sequence. `terms_of` says what a version runs under; `paced`: it is worked
/// at the pace of a clock, which does not wait for a version that computes too long.
///
/// # Errors
/// If another sequence has them.
pub(crate) fn begin(
    context: &Context,
    (version_table, clock): (&VersionTable, &Clock),
    (evidence_files, monitors): (&EvidenceFiles, &Monitors),
    cell: &mut LiveStation,
    seeds: SeedSource,
    paced: bool,
    terms_of: &dyn Fn(&Capability) -> SkillTerms,
) -> Result<StartedSequence, EngineFault> {
    let actives = VersionsAtStart::new(context, version_table, evidence_files);
    let is_in_sequence =
        |version: &&Capability| cell.tasks().iter().any(|task| Family::from(*task) == version.id().family);
    let terms = actives
        .all()
        .filter(is_in_sequence)
        .map(|version| {
            let terms = terms_of(version);
            let declared = version.manifest.permissions.resources.cpu_us_per_tick;
            (version.id(), if paced { terms.on_a_clock(declared) } else { terms })
        })
        .collect();
    let spare = context.terms();
    let link_up = cell.link_is_up();
    // The engine's own copy is read meanwhile and never changed.
    let supervisor = SequenceSupervisor::new(monitors.for_sequence(), clock.clone(), link_up);
    let running = cell
        .start_sequence()
        .ok_or_else(|| EngineFault::Impossible("the live world is at work already".to_owned()))?;
    let index = running.sequence();
    let seed = seeds.seed(SeedPurpose::Live, index);
    Ok(StartedSequence { index, seed, running, actives, terms, spare, supervisor, link_up })
}
