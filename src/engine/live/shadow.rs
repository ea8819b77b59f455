//! Shadow: the candidate beside the active version, at two depths, with no right to the arm.
//!
//! Same observations: the candidate decides tick by tick on what the active version sees; its
//! commands go to a [`CommandRecorder`]. Twin: at the start of the family's task the live world is forked;
//! the candidate drives the fork under the same disturbances. A cell that cannot be forked has a twin at the observed
//! state, or none (`twin_start.rs`). Sources: paper sections 5.2 (stage 4) and 6.7; design rule 5.4.

use std::panic::resume_unwind;
use std::thread::JoinHandle;

use holdpoint_body::{Body, Command, GuardVerdict, Pose, TaskKind};
use holdpoint_cell::{RobotCell, TrialCell};
use serde::{Deserialize, Serialize};

use super::forked_task::ForkedTask;
use super::listener::Listener;
use super::twin_start::TwinStart;
use holdpoint_governance::evidence::{OutputSequence, ShadowSequence};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::profile::EvaluationSettings;
use holdpoint_runtime::agent::dispatcher::admit;
use holdpoint_runtime::arm::CommandRecorder;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::skill::Skill;
use holdpoint_runtime::task::{PathPoint, Supervision, TaskRecord, Tick};
use holdpoint_runtime::terms::SkillTerms;

/// The divergence while one side has not decided yet: a difference in time, which the mean over ticks measures.
const UNDECIDED_DIVERGENCE: f64 = 0.5;

/// Setpoints in force on the two channels.
#[derive(Clone, Copy, Debug, Default)]
struct Setpoints {
    pose: Option<Pose>,
    width_m: Option<f64>,
}

impl Setpoints {
    fn note(&mut self, command: &Command) {
        match command {
            Command::ToolPose { pose, .. } => self.pose = Some(*pose),
            Command::Gripper { width_m, .. } => self.width_m = Some(*width_m),
            Command::Joints { .. } | Command::Hold | Command::Stop | Command::Done | Command::Fail { .. } => {
            }
        }
    }

    /// Distance of two setpoints in [0, 1]: the larger of the two channels'. From closed to open, `width_max_m`, is 1.
    fn divergence(&self, other: &Self, settings: &EvaluationSettings, width_max_m: f64) -> f64 {
        let arm = match (&self.pose, &other.pose) {
            (Some(a), Some(b)) => (a.distance_m(b) / settings.divergence_full_m).min(1.0),
            (None, None) => 0.0,
            _ => UNDECIDED_DIVERGENCE,
        };
        let gripper = match (self.width_m, other.width_m) {
            (Some(a), Some(b)) => ((a - b).abs() / width_max_m).min(1.0),
            (None, None) => 0.0,
            _ => UNDECIDED_DIVERGENCE,
        };
        arm.max(gripper)
    }
}

/// The most commands of one side that a [`ShadowTrace`] keeps; a task gives some dozen.
const COMMANDS_KEPT: usize = 256;

/// The record of one shadowed sequence (paper appendix F.2).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShadowTrace {
    /// The version in shadow.
    pub version: CapabilityId,
    /// The family's task within the sequence.
    pub task: TaskKind,
    /// The seed both worlds shared.
    pub seed: u64,
    /// Commands of the active version, with the tick of the task; the first ones.
    pub live_commands: Vec<(u64, Command)>,
    /// Commands the candidate would have given on the same observations.
    pub proposed_commands: Vec<(u64, Command)>,
    /// What the active version did in the live world.
    pub live: TaskRecord,
    /// What the candidate did in the twin; absent in a cell without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<TaskRecord>,
    /// The values the rules use; absent in a cell without a twin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub values: Option<ShadowSequence>,
    /// The values the rules use in a cell without a twin; absent in another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outputs: Option<OutputSequence>,
}

impl ShadowTrace {
    /// The record without the paths if both worlds ended alike: the seed gives them again.
    #[must_use]
    pub fn without_equal_paths(mut self) -> Self {
        let (Some(values), Some(twin)) = (&self.values, &mut self.twin) else { return self };
        let alike = values.live_success == values.twin_success
            && values.live_policy_hit == values.twin_policy_hit
            && values.live_watcher_event == values.twin_watcher_event;
        if alike {
            self.live.path = Vec::new();
            twin.path = Vec::new();
        }
        self
    }
}

/// Listens to a live sequence on behalf of one candidate.
pub struct Shadow {
    candidate: Capability,
    terms: SkillTerms,
    fork: Option<Box<dyn TrialCell>>,
    /// Largest distance between the pads of the robot, m.
    width_max_m: f64,
    /// Where the twin began; absent before the task.
    start: Option<TwinStart>,
    skill: Option<Box<dyn Skill>>,
    /// The dispatcher would not call it, as the live world stands at its task.
    refused: bool,
    recorder: CommandRecorder,
    live_recorder: CommandRecorder,
    live: Setpoints,
    proposed: Setpoints,
    divergence_sum: f64,
    ticks: u32,
    /// The twin works while the live world does, and this sees its ticks.
    beside: Option<TwinWatch>,
    twin: Option<ShadowTwin>,
}

/// Sees every tick of a twin, on the thread that it works on.
pub(crate) type TwinWatch = Box<dyn FnMut(&dyn RobotCell, &Tick<'_>) + Send>;

/// The candidate in its fork of the live world.
enum ShadowTwin {
    Running(JoinHandle<TwinRun>),
    Ran(Box<TwinRun>),
}

/// A twin that has run.
struct TwinRun {
    /// The world, for the next sequence; absent if it failed.
    world: Option<Box<dyn TrialCell>>,
    record: Option<TaskRecord>,
}

impl TwinRun {
    fn of(task: ForkedTask, look: &mut dyn FnMut(&dyn RobotCell, &Tick<'_>)) -> Self {
        let (world, record) = task.run(look).unzip();
        Self { world, record }
    }
}

impl ShadowTwin {
    fn beside(task: ForkedTask, mut watch: TwinWatch) -> Self {
        let thread = std::thread::Builder::new().name("twin".to_owned());
        match thread.spawn(move || TwinRun::of(task, watch.as_mut())) {
            Ok(thread) => Self::Running(thread),
            // The sequence says nothing then, as with a world that failed.
            Err(_) => Self::Ran(Box::new(TwinRun { world: None, record: None })),
        }
    }
}

impl Shadow {
    /// A shadow for a candidate. `fork` is the world the twin will run in.
    #[must_use]
    pub fn new(candidate: Capability, terms: SkillTerms, fork: Box<dyn TrialCell>) -> Self {
        Self {
            candidate,
            terms,
            width_max_m: fork.spec().robot.width_max_m,
            fork: Some(fork),
            start: None,
            skill: None,
            refused: false,
            recorder: CommandRecorder::default(),
            live_recorder: CommandRecorder::default(),
            live: Setpoints::default(),
            proposed: Setpoints::default(),
            divergence_sum: 0.0,
            ticks: 0,
            beside: None,
            twin: None,
        }
    }

    /// Has the twin of the next task work on a thread of its own, while the live world does. The result is the same.
    pub(crate) fn run_twin_beside(&mut self, watch: TwinWatch) {
        self.beside = Some(watch);
    }

    pub(crate) fn id(&self) -> CapabilityId {
        self.candidate.id()
    }

    pub(crate) fn task(&self) -> TaskKind {
        self.candidate.bundle.task()
    }

    fn has_twin(&self) -> bool {
        self.start.is_some_and(TwinStart::has_twin)
    }

    /// Mean distance of the candidate's commands from the active version's.
    fn output_divergence(&self) -> f64 {
        self.divergence_sum / f64::from(self.ticks.max(1))
    }

    /// The twin's task; `None` if it was not reached, or the dispatcher would not call the candidate.
    fn start_twin(&mut self, seed: u64) -> Option<ForkedTask> {
        let (fork, task) = (self.fork.take()?, self.task());
        if self.refused {
            let record = Some(TaskRecord::refused(task, seed));
            self.twin = Some(ShadowTwin::Ran(Box::new(TwinRun { world: Some(fork), record })));
            return None;
        }
        Some(ForkedTask::new(fork, &self.candidate, &self.terms, task, seed))
    }

    fn run_twin(&mut self, seed: u64, look: &mut dyn FnMut(&dyn RobotCell, &Tick<'_>)) {
        if let Some(task) = self.start_twin(seed) {
            self.twin = Some(ShadowTwin::Ran(Box::new(TwinRun::of(task, look))));
        }
    }

    /// Waits for the twin, if it ran.
    fn take_twin(&mut self) -> Option<TwinRun> {
        match self.twin.take()? {
            ShadowTwin::Ran(ran) => Some(*ran),
            ShadowTwin::Running(thread) => match thread.join() {
                Ok(ran) => Some(ran),
                Err(panic) => resume_unwind(panic),
            },
        }
    }

    /// Runs the twin before the live task, so that a screen can draw both side by side. The result is the same: the
    /// twin starts where the live world stands now.
    pub(crate) fn run_twin_ahead(
        &mut self,
        task: TaskKind,
        seed: u64,
        look: &mut dyn FnMut(&dyn RobotCell, &Tick<'_>),
    ) {
        if task == self.task() && self.has_twin() && self.twin.is_none() {
            self.run_twin(seed, look);
        }
    }

    /// After the live task: runs the twin, if it has not run yet, and compares. Absent if the task was not
    /// reached or a world failed. The world comes back for the next sequence.
    #[must_use]
    pub fn conclude(
        mut self,
        live: Option<&TaskRecord>,
        seed: u64,
    ) -> (Option<ShadowTrace>, Option<Box<dyn TrialCell>>) {
        let (Some(live), Some(start)) = (live, self.start) else {
            let ran = self.take_twin().and_then(|ran| ran.world);
            return (None, self.fork.take().or(ran));
        };
        if !start.has_twin() {
            let compared = !live.invalid && (self.refused || self.ticks > 0);
            let trace = compared.then(|| self.trace_of_outputs(live, seed));
            return (trace, self.fork.take());
        }
        if self.twin.is_none() {
            self.run_twin(seed, &mut |_, _| {});
        }
        let Some(TwinRun { world, record: Some(twin) }) = self.take_twin() else { return (None, None) };
        if live.invalid {
            return (None, world);
        }
        let values = ShadowSequence {
            seed,
            live_success: live.success,
            twin_success: twin.success,
            live_policy_hit: live.violation,
            twin_policy_hit: twin.violation,
            live_watcher_event: live.anomaly,
            twin_watcher_event: twin.anomaly,
            output_divergence: self.output_divergence(),
            envelope_divergence: outside_tube(
                &live.path,
                &twin.path,
                self.terms.profile().evaluation.tube_radius_m,
            ),
            live_conduct: live.conduct(),
            twin_conduct: twin.conduct(),
            twin_difference: start.difference(),
        };
        let trace = ShadowTrace { twin: Some(twin), values: Some(values), ..self.trace(live, seed) };
        (Some(trace), world)
    }

    /// The record of a sequence without a twin. A candidate that the dispatcher would not call commands nothing, which
    /// is the largest divergence.
    fn trace_of_outputs(&self, live: &TaskRecord, seed: u64) -> ShadowTrace {
        let output_divergence = if self.refused { 1.0 } else { self.output_divergence() };
        ShadowTrace { outputs: Some(OutputSequence { seed, output_divergence }), ..self.trace(live, seed) }
    }

    /// The record without what is compared.
    fn trace(&self, live: &TaskRecord, seed: u64) -> ShadowTrace {
        let first =
            |recorder: &CommandRecorder| recorder.commands().iter().take(COMMANDS_KEPT).cloned().collect();
        ShadowTrace {
            version: self.candidate.id(),
            task: self.task(),
            seed,
            live_commands: first(&self.live_recorder),
            proposed_commands: first(&self.recorder),
            live: live.clone(),
            twin: None,
            values: None,
            outputs: None,
        }
    }
}

impl Listener for Shadow {
    fn before_task(&mut self, world: &dyn RobotCell, task: TaskKind, seed: u64) {
        if task != self.task() {
            return;
        }
        let start = self.fork.as_mut().and_then(|fork| TwinStart::at(world, fork.as_mut()));
        if let Some(start) = start {
            self.start = Some(start);
            self.refused = admit(&self.candidate.manifest, &Body::telemetry(world)).is_err();
            self.skill = Some(self.candidate.start(self.terms.bundle_seed(seed)));
            if start.has_twin()
                && let Some(watch) = self.beside.take()
                && let Some(twin) = self.start_twin(seed)
            {
                self.twin = Some(ShadowTwin::beside(twin, watch));
            }
        }
    }

    fn tick(&mut self, _: &dyn RobotCell, task: TaskKind, passed: &Tick<'_>) -> Supervision {
        // The live skill is done: there is nothing left to compare with.
        if task == self.task()
            && !passed.settling
            && !self.refused
            && let Some(skill) = &mut self.skill
        {
            let mut seen = passed.observation.clone();
            seen.guard = GuardVerdict::Allowed;
            let proposal = skill.tick(&seen);
            self.live.note(passed.command);
            self.proposed.note(&proposal);
            self.recorder.record(passed.tick, proposal);
            self.live_recorder.record(passed.tick, passed.command.clone());
            let settings = &self.terms.profile().evaluation;
            self.divergence_sum += self.live.divergence(&self.proposed, settings, self.width_max_m);
            self.ticks += 1;
        }
        Supervision::Continue
    }
}

/// Share of the twin's points that lie farther than a radius, m, from the live path, in [0, 1].
#[must_use]
pub fn outside_tube(live: &[PathPoint], twin: &[PathPoint], radius_m: f64) -> f64 {
    if twin.is_empty() {
        return 0.0;
    }
    #[allow(clippy::cast_possible_truncation, reason = "at most a meter, in the precision of a path")]
    let radius = radius_m as f32;
    let radius2 = radius * radius;
    let near = |point: &PathPoint| {
        live.iter().any(|other| {
            let d: f32 =
                (0..3).map(|i| (point.tool[i] - other.tool[i]) * (point.tool[i] - other.tool[i])).sum();
            d <= radius2
        })
    };
    let outside = twin.iter().filter(|point| !near(point)).count();
    outside as f64 / twin.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::profile::{Profile, ProfileName};

    fn path(heights: &[f32]) -> Vec<PathPoint> {
        let point = |(i, z): (usize, &f32)| PathPoint {
            tick: u32::try_from(i).unwrap(),
            tool: [0.5, 0.0, *z],
            width: 0.0,
            force: 0.0,
        };
        heights.iter().enumerate().map(point).collect()
    }

    #[test]
    fn share_outside_the_tube_is_computed() {
        let live = path(&[0.1, 0.12, 0.14]);
        for (twin, expected) in [
            (path(&[0.1, 0.11, 0.15]), 0.0),
            (path(&[0.1, 0.3]), 0.5),
            (path(&[0.5, 0.6]), 1.0),
            (path(&[]), 0.0),
        ] {
            assert!((outside_tube(&live, &twin, 0.03) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn setpoint_divergence_is_that_of_the_larger_channel() {
        let mut a = Setpoints::default();
        let mut b = Setpoints::default();
        let settings = Profile::builtin(ProfileName::Sim).unwrap().evaluation;
        assert!(a.divergence(&b, &settings, 0.08).abs() < 1e-12);
        a.note(&Command::Gripper { width_m: 0.08, speed_m_s: 0.1, force_n: 1.0 });
        b.note(&Command::Gripper { width_m: 0.04, speed_m_s: 0.1, force_n: 1.0 });
        assert!((a.divergence(&b, &settings, 0.08) - 0.5).abs() < 1e-12);
        assert!((a.divergence(&b, &settings, 0.16) - 0.25).abs() < 1e-12);
        let far = Pose { position: [1.0, 0.0, 0.0], ..Pose::IDENTITY };
        a.note(&Command::ToolPose { pose: Pose::IDENTITY, max_speed_m_s: 0.1 });
        b.note(&Command::ToolPose { pose: far, max_speed_m_s: 0.1 });
        assert!((a.divergence(&b, &settings, 0.08) - 1.0).abs() < 1e-12);
    }
}
