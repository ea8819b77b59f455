//! A version whose runs are recorded: each observation that its code receives, after its manifest withheld the rest.
//!
//! The commands are the code's own. Changes nothing that a run sees or asks for.

use std::sync::{Arc, Mutex};

use holdpoint_body::{Command, Observation, TaskKind};
use holdpoint_governance::exports::Interface;
use holdpoint_governance::ids::Digest;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::{ConfinementReport, Hook, Skill, SkillBundle};

/// What one run saw until a hook ended its task.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SeenRun {
    /// One a tick.
    pub(super) seen: Vec<Observation>,
    /// Tick of the first command that moves the arm.
    pub(super) first_motion_command: Option<u64>,
}

/// The runs of a version that ended, in order.
pub(super) type RunLog = Arc<Mutex<Vec<SeenRun>>>;

/// The same version with its runs recorded.
pub(super) fn recorded(version: &Capability) -> (Capability, RunLog) {
    let log = RunLog::default();
    let bundle = RecordedBundle { bundle: Arc::clone(&version.bundle), log: Arc::clone(&log) };
    let mut version = version.clone();
    version.bundle = Arc::new(bundle);
    (version, log)
}

struct RecordedBundle {
    bundle: Arc<dyn SkillBundle>,
    log: RunLog,
}

impl SkillBundle for RecordedBundle {
    fn digest(&self) -> Digest {
        self.bundle.digest()
    }

    fn interface(&self) -> Interface {
        self.bundle.interface()
    }

    fn task(&self) -> TaskKind {
        self.bundle.task()
    }

    fn start(&self, seed: u64) -> Box<dyn Skill> {
        Box::new(RecordedSkill {
            skill: self.bundle.start(seed),
            run: SeenRun::default(),
            is_hook_entered: false,
            log: Arc::clone(&self.log),
        })
    }
}

struct RecordedSkill {
    skill: Box<dyn Skill>,
    run: SeenRun,
    is_hook_entered: bool,
    log: RunLog,
}

impl Skill for RecordedSkill {
    fn tick(&mut self, seen: &Observation) -> Command {
        let command = self.skill.tick(seen);
        if !self.is_hook_entered {
            let moves = matches!(command, Command::ToolPose { .. } | Command::Joints { .. });
            if moves && self.run.first_motion_command.is_none() {
                self.run.first_motion_command = Some(seen.tick);
            }
            self.run.seen.push(seen.clone());
        }
        command
    }

    fn enter(&mut self, hook: Hook) {
        self.is_hook_entered = true;
        self.skill.enter(hook);
    }

    fn confined(&self) -> ConfinementReport {
        self.skill.confined()
    }
}

impl Drop for RecordedSkill {
    fn drop(&mut self) {
        if let Ok(mut log) = self.log.lock() {
            log.push(std::mem::take(&mut self.run));
        }
    }
}
