//! One sequence of the live world in three steps: begun with all it takes, worked, ended.
//!
//! Begun and ended on the engine's thread; worked there in one slice, or on a thread of its own at the pace of a
//! clock. What is worked owns its arm, its agent, its monitors and its view of the active versions, so that nothing
//! the engine does meanwhile reaches into it.

use std::collections::BTreeMap;

use holdpoint_body::TaskKind;
use holdpoint_sim::world::World;

use super::live::{Listener, Outing, SequenceReport};
use super::manager::{Fault, UpgradeManager};
use super::portrait;
use super::seeds::{Purpose, episode_seed};
use super::sentry::{Questions, Sentry};
use super::shadow::ShadowTrace;
use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_protocol::picture::Envelope;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::recovery::RecoveryReport;
use holdpoint_runtime::terms::Terms;

/// The versions that were active when the sequence began.
pub(super) struct Actives(BTreeMap<Family, Capability>);

impl ActiveView for Actives {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.0.get(family)
    }
}

impl Actives {
    /// Who works a task.
    pub(super) fn at_work(&self, task: TaskKind) -> Option<CapabilityId> {
        self.0.get(&Family::from(task)).map(Capability::id)
    }
}

/// A sequence that is about to be worked.
pub(super) struct Begun {
    index: u64,
    seed: u64,
    outing: Outing,
    actives: Actives,
    terms: Vec<(CapabilityId, Terms)>,
    spare: Terms,
    sentry: Sentry,
    link_up: bool,
}

/// A sequence that was worked.
pub(super) struct Worked {
    pub(super) index: u64,
    pub(super) outing: Outing,
    pub(super) report: SequenceReport,
    pub(super) sentry: Sentry,
    pub(super) link_up: bool,
    /// The arm was stopped from outside.
    pub(super) stopped: Option<Stopped>,
    /// What shadow came to, where a candidate was in shadow.
    pub(super) shadow: Option<Shadowed>,
}

/// A task that somebody stopped in flight.
#[derive(Clone, Debug)]
pub(super) struct Stopped {
    /// Who was at work.
    pub(super) id: Option<CapabilityId>,
    /// When, ticks of the live world.
    pub(super) world_tick: u64,
    /// When, virtual ticks of the engine.
    pub(super) tick: u64,
    /// What was done to stop the arm.
    pub(super) report: Option<RecoveryReport>,
}

/// What a candidate in shadow gave in one sequence.
pub(super) struct Shadowed {
    pub(super) id: CapabilityId,
    pub(super) trace: Option<ShadowTrace>,
    pub(super) fork: Option<World>,
}

impl Begun {
    /// Which sequence.
    pub(super) const fn index(&self) -> u64 {
        self.index
    }

    /// Who works what in it, and the envelope that holds them.
    pub(super) fn workers(&self) -> Vec<(TaskKind, CapabilityId, Envelope)> {
        let worker = |task: TaskKind| {
            let id = self.actives.at_work(task)?;
            let terms =
                self.terms.iter().find(|(known, _)| *known == id).map_or(&self.spare, |(_, terms)| terms);
            Some((task, id, portrait::envelope(terms.envelope())))
        };
        TaskKind::SEQUENCE.into_iter().filter_map(worker).collect()
    }

    /// Questions of its monitors are told while it runs.
    pub(super) fn tell_at_once(&mut self, questions: Questions) {
        self.sentry.tell_at_once(questions);
    }

    /// Works it.
    pub(super) fn work(self, listener: &mut dyn Listener) -> Worked {
        let Self { index, seed, mut outing, actives, terms, spare, mut sentry, link_up } = self;
        let choose = |capability: &Capability| {
            let id = capability.id();
            let known = terms.iter().find(|(known, _)| *known == id);
            known.map_or_else(|| spare.clone(), |(_, terms)| terms.clone())
        };
        let report = outing.run(&actives, &choose, seed, listener, Some(&mut sentry));
        Worked { index, outing, report, sentry, link_up, stopped: None, shadow: None }
    }
}

impl UpgradeManager {
    /// Lets arm, agent and monitors out for one sequence.
    pub(super) fn begin_sequence(&mut self) -> Result<Begun, Fault> {
        let actives: BTreeMap<Family, Capability> = self
            .ledger
            .families()
            .filter_map(|(family, entry)| Some((family.clone(), entry.active()?.capability.clone())))
            .collect();
        let terms = TaskKind::SEQUENCE
            .into_iter()
            .filter_map(|task| actives.get(&Family::from(task)))
            .map(|active| (active.id(), self.terms_of(active)))
            .collect();
        let spare = self.terms_of_profile();
        let link_up = self.live.link_is_up();
        // The engine's own copy is looked at meanwhile and changed by nobody.
        let sentry = Sentry::new(self.watches.clone(), self.clock.clone(), link_up);
        let outing = self
            .live
            .let_out()
            .ok_or_else(|| Fault::Impossible("the live world is at work already".to_owned()))?;
        let index = outing.sequence();
        let seed = episode_seed(self.seed, Purpose::Live, index);
        Ok(Begun { index, seed, outing, actives: Actives(actives), terms, spare, sentry, link_up })
    }
}
