//! A task in a fork of the live world: a twin in shadow, or the rollback target in a scene that stopped a version.

use holdpoint_body::TaskKind;
use holdpoint_cell::{RobotCell, TrialCell};
use holdpoint_runtime::arm::Arm;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::Guard;
use holdpoint_runtime::skill::Skill;
use holdpoint_runtime::task::{self, Supervision, TaskRecord, TaskTerms, Tick};
use holdpoint_runtime::terms::SkillTerms;

/// A task about to be worked, with all it takes; it may be worked on another thread.
pub(crate) struct ForkedTask {
    fork: Box<dyn TrialCell>,
    skill: Box<dyn Skill>,
    guard: Guard,
    terms: TaskTerms,
}

impl ForkedTask {
    /// A version's task in a fork that stands at its begin.
    pub(crate) fn new(
        fork: Box<dyn TrialCell>,
        version: &Capability,
        terms: &SkillTerms,
        task: TaskKind,
        seed: u64,
    ) -> Self {
        Self {
            fork,
            skill: version.start(terms.bundle_seed(seed)),
            guard: terms.guard(&version.manifest.permissions),
            terms: terms.task(task, seed, version.abort_secs()),
        }
    }

    /// Works it. `look` sees every tick. Returns the world for the next fork, and the record; a world that diverged is
    /// not used again.
    pub(crate) fn run(
        self,
        look: &mut dyn FnMut(&dyn RobotCell, &Tick<'_>),
    ) -> Option<(Box<dyn TrialCell>, TaskRecord)> {
        let mut arm = Arm::new(self.fork);
        let ran = task::run(&mut arm.handle(), self.skill, self.guard, &self.terms, &mut |handle, passed| {
            look(handle.body().as_ref(), passed);
            Supervision::Continue
        });
        let world = arm.into_body();
        ran.ok().map(|record| (world, record))
    }
}
