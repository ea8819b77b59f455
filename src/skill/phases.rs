//! What is the same in every run of a phased controller: the phase and its clock, the hooks, the time limit and the end.
//!
//! A controller is then its phases and nothing else. Decides nothing about the work.

use holdpoint_body::{Command, FailureSignal, Observation, Pose};

use super::motion::{AbortStyle, HookRun, RollbackStyle, ticks};
use crate::{Hook, Skill};

/// What a controller's parameters say of the frame around its phases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseFrame {
    /// Seconds the whole work may take.
    pub timeout_secs: f64,
    /// What the safe-abort hook does.
    pub abort: AbortStyle,
    /// What the rollback hook does.
    pub rollback: RollbackStyle,
    /// Height the hooks bring the tool to, m.
    pub safe_height_m: f64,
    /// Tool speed of the hooks, m/s.
    pub hook_speed_m_s: f64,
}

/// A controller that works in phases.
pub trait Phased: Send {
    type Phase: Copy + Send;
    /// The one it begins in.
    const FIRST: Self::Phase;

    /// What its parameters say of the frame.
    fn frame(&self) -> PhaseFrame;

    /// One decision in the present phase.
    fn work(&mut self, run: &mut PhaseRun<Self::Phase>, seen: &Observation) -> Command;
}

/// Where a run stands.
#[derive(Clone, Debug)]
pub struct PhaseRun<P> {
    pub phase: P,
    /// Ticks in it, 1 in its first.
    pub tick: u64,
    /// Whether the phase has sent its command.
    pub commanded: bool,
    /// Where the tool was sent last.
    pub target: Pose,
    ended: Option<PhaseRunEnd>,
}

/// How the work ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PhaseRunEnd {
    Done,
    Failed(FailureSignal),
}

impl<P> PhaseRun<P> {
    /// Goes to a phase.
    pub fn go(&mut self, phase: P) {
        self.phase = phase;
        self.tick = 0;
        self.commanded = false;
    }

    /// Ends the task, with a failure or without; the next tick reports it.
    pub const fn finish(&mut self, failure: Option<FailureSignal>) -> Command {
        self.ended = Some(match failure {
            None => PhaseRunEnd::Done,
            Some(signal) => PhaseRunEnd::Failed(signal),
        });
        Command::Hold
    }
}

/// One run of a phased controller.
#[derive(Clone, Debug)]
pub struct PhaseRunner<C: Phased> {
    controller: C,
    run: PhaseRun<C::Phase>,
    began: Option<u64>,
    hook: Option<HookRun>,
}

impl<C: Phased> PhaseRunner<C> {
    pub const fn new(controller: C) -> Self {
        let run =
            PhaseRun { phase: C::FIRST, tick: 0, commanded: false, target: Pose::IDENTITY, ended: None };
        Self { controller, run, began: None, hook: None }
    }
}

impl<C: Phased + Clone + 'static> Skill for PhaseRunner<C> {
    fn tick(&mut self, seen: &Observation) -> Command {
        let frame = self.controller.frame();
        if let Some(hook) = &mut self.hook {
            return hook.tick(seen, frame.safe_height_m, frame.hook_speed_m_s);
        }
        let began = *self.began.get_or_insert(seen.tick);
        if seen.tick.saturating_sub(began) > ticks(frame.timeout_secs) {
            self.run.ended.get_or_insert(PhaseRunEnd::Failed(FailureSignal::TimedOut));
        }
        match self.run.ended {
            Some(PhaseRunEnd::Done) => Command::Done,
            Some(PhaseRunEnd::Failed(signal)) => Command::Fail { signal },
            None => {
                self.run.tick += 1;
                self.controller.work(&mut self.run, seen)
            }
        }
    }

    fn enter(&mut self, hook: Hook) {
        let frame = self.controller.frame();
        self.hook = Some(HookRun::begin(hook, frame.abort, frame.rollback));
    }

    fn fork(&self) -> Option<Box<dyn Skill>> {
        Some(Box::new(self.clone()))
    }
}
