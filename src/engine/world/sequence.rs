//! One sequence of the live world in three steps: begun with all it takes, worked, ended.
//!
//! Begun and ended on the engine's thread; run there in one slice, or on a thread of its own at the pace of a clock.
//! A running sequence owns its arm, its agent, its monitors and its view of the active versions, so that the engine
//! cannot change them meanwhile.

use std::collections::BTreeMap;

use holdpoint_body::TaskKind;
use holdpoint_sim::world::World;

use super::cell_frame;
use super::listener::Listener;
use super::live::{LiveCell, RunningSequence, SequenceReport};
use super::shadow::ShadowTrace;
use super::supervisor::{MonitorQuestions, SequenceSupervisor};
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::video_frame::EnvelopeView;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::recovery::RecoveryReport;
use holdpoint_runtime::terms::SkillTerms;

use crate::context::Context;
use crate::evidence_binding::not_admitted;
use crate::fault::EngineFault;
use crate::monitors::Monitors;
use crate::recorder::EngineRecorder;
use crate::trial::seeds::{SeedPurpose, SeedSource};

/// The versions that were active when the sequence began.
pub(crate) struct VersionsAtStart(BTreeMap<Family, Capability>);

impl ActiveView for VersionsAtStart {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.0.get(family)
    }
}

impl VersionsAtStart {
    /// The version that runs a task.
    pub(crate) fn at_work(&self, task: TaskKind) -> Option<CapabilityId> {
        self.0.get(&Family::from(task)).map(Capability::id)
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
    pub(crate) fork: Option<World>,
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
        TaskKind::SEQUENCE.into_iter().filter_map(worker).collect()
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
        FinishedSequence { index, running, report, supervisor, link_up, stopped: None, shadow: None }
    }
}

/// Gives arm, agent and monitors to one sequence. `terms_of` says what a version runs under; `paced`: it is worked
/// at the pace of a clock, which does not wait for a version that computes too long.
///
/// # Errors
/// If another sequence has them.
pub(crate) fn begin(
    context: &Context,
    record: &EngineRecorder,
    monitors: &Monitors,
    cell: &mut LiveCell,
    seeds: SeedSource,
    paced: bool,
    terms_of: &dyn Fn(&Capability) -> SkillTerms,
) -> Result<StartedSequence, EngineFault> {
    let actives: BTreeMap<Family, Capability> = record
        .version_table()
        .families()
        .filter_map(|(family, entry)| Some((family.clone(), entry.active()?.capability.clone())))
        .filter(|(_, active)| not_admitted(context, record.version_table(), active).is_none())
        .collect();
    let terms = TaskKind::SEQUENCE
        .into_iter()
        .filter_map(|task| actives.get(&Family::from(task)))
        .map(|active| {
            let terms = terms_of(active);
            let declared = active.manifest.permissions.resources.cpu_us_per_tick;
            (active.id(), if paced { terms.on_a_clock(declared) } else { terms })
        })
        .collect();
    let spare = context.terms();
    let link_up = cell.link_is_up();
    // The engine's own copy is read meanwhile and never changed.
    let supervisor = SequenceSupervisor::new(monitors.clone(), record.clock().clone(), link_up);
    let running = cell
        .start_sequence()
        .ok_or_else(|| EngineFault::Impossible("the live world is at work already".to_owned()))?;
    let index = running.sequence();
    let seed = seeds.seed(SeedPurpose::Live, index);
    Ok(StartedSequence {
        index,
        seed,
        running,
        actives: VersionsAtStart(actives),
        terms,
        spare,
        supervisor,
        link_up,
    })
}
