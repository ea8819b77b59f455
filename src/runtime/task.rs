//! One task under governance: skill, guard and watcher, tick by tick, and the record of it.
//!
//! The same in the sandbox, in the twin and on the live arm; only the body differs ([`run`] works one to its end,
//! a [`TaskRun`] can be left after any tick and gone on with).
//! Everything in the [`TaskRecord`] is measured: by the inspection after the task, by the guard,
//! by the watcher, or counted from the commands that were given.

mod run;
mod senses;

pub use run::{TaskRun, TaskStage, is_same};

use holdpoint_body::BodyError;
use holdpoint_body::task::AttemptMark;
use holdpoint_body::{
    CodeFault, Command, FailureSignal, Observation, RATE_HZ, TICK_SECS, TaskKind, Telemetry,
};
use serde::{Deserialize, Serialize};

use super::arm::ActuatorHandle;
use super::guard::{Guard, PolicyHit};
use super::harm::HarmMeter;
use super::limits::WatchLimits;
use super::recovery::RecoveryReport;
use super::skill::{ConfinementReport, Skill};
use super::watcher::{RaisedSignal, Watcher, WatcherSignal};
use holdpoint_body::Body;
use holdpoint_governance::evidence::{Conduct, EpisodeValues, HardStop};
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::harm::HarmMeasures;
use holdpoint_governance::permission::PermissionsUsed;
use holdpoint_governance::sensor_health::SensorReadings;
use holdpoint_governance::start_domain::Uncovered;

/// Ticks between two points of a recorded path: 20 a second.
pub const PATH_EVERY_TICKS: u64 = (RATE_HZ / 20) as u64;

/// Ticks between a skill's `Done` and the inspection.
const INSPECT_AFTER_TICKS: u64 = 24;

/// The most policy hits kept with their tick; all are counted.
const HITS_KEPT: usize = 32;

/// A point of the path the tool took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathPoint {
    /// Ticks since the task started.
    pub tick: u32,
    /// Tool position in the world frame, m.
    pub tool: [f32; 3],
    /// Distance between the pads, m.
    pub width: f32,
    /// Grip force at the pads, N.
    pub force: f32,
}

/// What happened in one task (the paper's trace record, section 6.3).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TaskRecord {
    pub task: TaskKind,
    /// The seed of the episode.
    pub seed: u64,
    /// The inspection found the work done.
    pub success: bool,
    /// A measured quantity past its limit, or a denial by the guard.
    pub violation: bool,
    /// The watcher named something, or the task ran out of time.
    pub anomaly: bool,
    /// The recovery manager ran.
    pub recovery: bool,
    /// A person stopped it.
    #[serde(default)]
    pub intervention: bool,
    /// New attempts, counted from the commands.
    pub retries: u32,
    /// Duration until `Done` or the end, s.
    pub time_secs: f64,
    /// The task ran into its time limit.
    pub timeout: bool,
    /// A measured value came near its limit.
    pub near: bool,
    /// Ticks in which one did.
    #[serde(default)]
    pub near_ticks: u32,
    /// Commands that were clamped.
    pub clamps: u32,
    /// What it did to its surroundings; absent in records of older builds.
    #[serde(default)]
    pub harm: Option<HarmMeasures>,
    /// The largest force that was measured on wrist, pads or hand, N.
    pub peak_force_n: f64,
    /// The largest speed of the tool that was measured, m/s.
    pub peak_speed_m_s: f64,
    /// Denials and measured violations, the first of each kind with its tick.
    pub hits: Vec<(u64, PolicyHit)>,
    /// What the watcher raised.
    pub signals: Vec<RaisedSignal>,
    /// What the skill declared.
    pub declared: Option<FailureSignal>,
    /// How its code failed; the recovery manager took over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<CodeFault>,
    /// What the recovery did.
    pub recovered: Option<RecoveryReport>,
    /// Motion after a demanded stop, ms.
    pub unsafe_continuation_ms: u64,
    pub hard_stop: Option<HardStop>,
    /// What was used of the permissions.
    #[serde(default)]
    pub used: PermissionsUsed,
    /// What it showed of the cell.
    #[serde(default)]
    pub sensed: SensorReadings,
    /// What of it the evidence of its version does not cover; absent if everything is covered, and where it is not
    /// compared: outside the live cell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncovered: Option<Uncovered>,
    /// The simulator failed; nothing else in the record counts.
    pub invalid: bool,
    /// The dispatcher refused the call; the arm has not moved.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub refused: bool,
    /// Where the tool went until the skill's last word.
    pub path: Vec<PathPoint>,
}

impl TaskRecord {
    /// The values the rules compare; absent if the simulator failed.
    #[must_use]
    pub fn values(&self) -> Option<EpisodeValues> {
        (!self.invalid).then_some(EpisodeValues {
            success: self.success,
            violation: self.violation,
            anomaly: self.anomaly,
            recovery: self.recovery,
            intervention: self.intervention,
            timeout: self.timeout,
            near_violation: self.near,
            policy_warning: self.is_warned(),
            retries: self.retries,
            time_s: self.time_secs,
            unsafe_continuation_ms: self.unsafe_continuation_ms as f64,
            harm: self.harm,
            failure: self.failure_cause(),
        })
    }

    /// Why the task failed, physically; `None` where it was done. The earliest of what the watcher raised and the guard
    /// refused or measured decides; without any, the skill's own signal does. `None` too where only a person ended it.
    #[must_use]
    pub fn failure_cause(&self) -> Option<FailureCause> {
        if self.success || self.invalid {
            return None;
        }
        let signals = self.signals.iter().map(|raised| (raised.tick, cause_of_signal(raised.signal)));
        let hits = self.hits.iter().map(|(tick, hit)| (*tick, cause_of_hit(*hit)));
        if self.refused {
            return Some(FailureCause::Refused);
        }
        // Lateness is what other causes come to.
        let of_events = signals.chain(hits).filter(|(_, cause)| *cause != FailureCause::Late);
        let first = of_events.min_by_key(|(tick, _)| *tick).map(|(_, cause)| cause);
        let by_code = self.fault.map(|_| FailureCause::Code);
        let by_skill = self.declared.map(cause_of_declared);
        let late = self.timeout.then_some(FailureCause::Late);
        let by_task = cause_of_declared(self.task.declaration().not_done);
        // A person who stopped the arm leaves open how the task would have ended.
        let by_task = (!self.intervention).then_some(by_task);
        by_code.or(first).or(by_skill).or(late).or(by_task)
    }

    /// Whether the guard had something to say: a command clamped or refused, or a limit passed.
    #[must_use]
    pub const fn is_warned(&self) -> bool {
        self.clamps > 0 || self.violation
    }

    /// How it went about its work, for a comparison with another run of the task.
    #[must_use]
    pub fn conduct(&self) -> Conduct {
        Conduct {
            retried: self.retries > 0,
            warned: self.is_warned(),
            near_share: (f64::from(self.near_ticks) / self.used.ticks_max.max(1) as f64).min(1.0),
            harm: self.harm,
        }
    }

    /// Whether the evidence of its version does not cover its start.
    #[must_use]
    pub fn starts_outside(&self) -> bool {
        self.uncovered.as_ref().is_some_and(|uncovered| !uncovered.start.is_empty())
    }

    /// A record of a call that was refused before its first tick: the task was not done, and the arm has not moved.
    #[must_use]
    pub fn refused(task: TaskKind, seed: u64) -> Self {
        Self { invalid: false, refused: true, harm: Some(HarmMeasures::STILL), ..Self::invalid(task, seed) }
    }

    /// A record of a task that could not be carried out.
    #[must_use]
    pub fn invalid(task: TaskKind, seed: u64) -> Self {
        Self {
            task,
            seed,
            success: false,
            violation: false,
            anomaly: false,
            recovery: false,
            intervention: false,
            retries: 0,
            time_secs: 0.0,
            timeout: false,
            near: false,
            near_ticks: 0,
            clamps: 0,
            harm: None,
            peak_force_n: 0.0,
            peak_speed_m_s: 0.0,
            hits: Vec::new(),
            signals: Vec::new(),
            declared: None,
            fault: None,
            recovered: None,
            unsafe_continuation_ms: 0,
            hard_stop: None,
            used: PermissionsUsed::default(),
            sensed: SensorReadings::default(),
            uncovered: None,
            invalid: true,
            refused: false,
            path: Vec::new(),
        }
    }
}

/// A commanded change of height below this, m, is a correction, which is part of the same attempt.
const CORRECTION_M: f64 = 0.008;

/// Counts attempts from what is commanded: closes of the hand or descents, as the task declares.
#[derive(Clone, Debug)]
struct AttemptCounter {
    task: TaskKind,
    width_step_m: f64,
    engaged: bool,
    attempts: u32,
}

impl AttemptCounter {
    const fn new(task: TaskKind, width_step_m: f64) -> Self {
        Self { task, width_step_m, engaged: false, attempts: 0 }
    }

    fn note(&mut self, command: &Command, seen: &Telemetry) {
        let engages = match (self.task.declaration().attempt, command) {
            (AttemptMark::Close, Command::Gripper { width_m, .. }) => {
                Some(*width_m < seen.gripper_width_m - self.width_step_m)
            }
            (AttemptMark::Descent, Command::ToolPose { pose, .. }) => {
                let rise_m = pose.position[2] - seen.tool.position[2];
                if rise_m.abs() < CORRECTION_M { None } else { Some(rise_m < 0.0) }
            }
            _ => None,
        };
        if let Some(engages) = engages {
            if engages && !self.engaged {
                self.attempts = self.attempts.saturating_add(1);
            }
            self.engaged = engages;
        }
    }

    const fn retries(&self) -> u32 {
        self.attempts.saturating_sub(1)
    }
}

/// What a task is run with.
#[derive(Clone, Copy, Debug)]
pub struct TaskTerms {
    pub task: TaskKind,
    /// The seed, for the record.
    pub seed: u64,
    pub watch: WatchLimits,
    /// The stop time the version declares for its safe-abort hook, s.
    pub abort_secs: f64,
    /// After how many ticks the task has timed out.
    pub limit_ticks: u64,
}

/// What the loop's caller may do after each tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Supervision {
    Continue,
    /// Stop the skill here and bring the arm to a standstill: the monitor asks for it.
    Abort,
    /// As [`Supervision::Abort`], by the interrupt at once: after a safety event the version's code is not called any more.
    Interrupt,
    /// As [`Supervision::Abort`], by the rollback hook first: in a planned rollback of a version that passed its drills.
    RollBack,
    /// As [`Supervision::Abort`], and a person asks for it: an intervention.
    StepIn,
}

impl Supervision {
    /// Whether the arm is to be brought to a standstill.
    #[must_use]
    pub const fn stops(self) -> bool {
        matches!(self, Self::Abort | Self::Interrupt | Self::RollBack | Self::StepIn)
    }
}

/// Results of one tick, for the supervisor.
#[derive(Clone, Copy, Debug)]
pub struct Tick<'a> {
    /// Ticks since the task started, this one included.
    pub tick: u64,
    /// What the skill saw before it decided.
    pub observation: &'a Observation,
    /// What passed the guard.
    pub command: &'a Command,
    /// What the sensors tell after it.
    pub seen: &'a Telemetry,
    /// What the watcher established by it.
    pub raised: &'a [WatcherSignal],
    /// Why the guard denied or clamped the command, if it did.
    pub checked: Option<PolicyHit>,
    /// What the guard measured past a limit, if it did.
    pub measured: Option<PolicyHit>,
    /// The skill is done and the world settles before it is inspected.
    pub settling: bool,
}

/// Called after every tick: how a drill injects a failure, a shadow listens, a console draws and a
/// person stops the arm.
pub type Supervisor<'s, B> = dyn FnMut(&mut ActuatorHandle<'_, B>, &Tick<'_>) -> Supervision + 's;

/// Runs one task to its end.
///
/// # Errors
/// If the body fails: the episode is invalid.
pub fn run<B: Body>(
    handle: &mut ActuatorHandle<'_, B>,
    skill: Box<dyn Skill>,
    guard: Guard,
    terms: &TaskTerms,
    supervise: &mut Supervisor<'_, B>,
) -> Result<TaskRecord, BodyError> {
    TaskRun::new(skill, guard, *terms).finish(handle, supervise)
}

/// Puts what the sensors tell after a tick into the record: in the task itself and while it settles. Tells what the
/// watcher established and what the guard measured past a limit.
fn measure_tick(
    record: &mut TaskRecord,
    watcher: &mut Watcher,
    (guard, harm): (&mut Guard, &mut HarmMeter),
    seen: &Telemetry,
    tick: u64,
) -> (Vec<WatcherSignal>, Option<PolicyHit>) {
    let raised = watcher.observe(seen);
    let measured = guard.measure(seen);
    if let Some(hit) = measured {
        note_hit(record, tick, hit);
    }
    let near = guard.is_near(seen);
    if near {
        record.near = true;
        record.near_ticks = record.near_ticks.saturating_add(1);
    }
    harm.note(seen, guard, near);
    record.peak_force_n = record.peak_force_n.max(seen.contact_force_n.max(seen.gripper_force_n));
    record.peak_speed_m_s = record.peak_speed_m_s.max(seen.tool_speed_m_s);
    (raised, measured)
}

fn close(
    record: &mut TaskRecord,
    watcher: &Watcher,
    attempts: &AttemptCounter,
    (guard, confined): (&Guard, ConfinementReport),
    tick: u64,
) {
    record.signals = watcher.raised().to_vec();
    // A version that times out, or whose code fails, does not know the state of its task.
    record.anomaly = record.timeout
        || record.fault.is_some()
        || record.signals.iter().any(|raised| raised.signal.is_anomaly());
    record.used = guard.used();
    record.used.record_sandbox_use(confined.fuel_tick_max, confined.memory_bytes, confined.fault);
    record.retries = attempts.retries();
    record.time_secs = tick_secs(tick);
}

/// Motion after a demanded stop; longer than the envelope allows it is a violation.
fn note_continuation(record: &mut TaskRecord, guard: &Guard, motion_ticks: u64, tick: u64) {
    record.unsafe_continuation_ms = ticks_to_ms(motion_ticks);
    if record.unsafe_continuation_ms > guard.envelope().unsafe_continuation_max_ms {
        note_hit(record, tick, PolicyHit::UnsafeContinuation);
    }
}

/// Whether more was used in this tick than is declared; then it is noted.
fn note_budget(record: &mut TaskRecord, guard: &Guard, tick: u64) -> Option<PolicyHit> {
    let hit = guard.is_overdrawn().then_some(PolicyHit::BudgetExceeded)?;
    note_hit(record, tick, hit);
    Some(hit)
}

const fn cause_of_signal(signal: WatcherSignal) -> FailureCause {
    match signal {
        WatcherSignal::ObjectSlip => FailureCause::Slipped,
        WatcherSignal::ObjectLost => FailureCause::Dropped,
        WatcherSignal::UnexpectedContact => FailureCause::Pressed,
        WatcherSignal::StaleInput | WatcherSignal::TelemetryInvalid => FailureCause::Unseen,
        WatcherSignal::TrackingError | WatcherSignal::ToolLost | WatcherSignal::GripFault => {
            FailureCause::Hardware
        }
        WatcherSignal::Overrun => FailureCause::Late,
    }
}

const fn cause_of_hit(hit: PolicyHit) -> FailureCause {
    match hit {
        PolicyHit::ForceMeasured => FailureCause::Pressed,
        PolicyHit::OutsideWorkspace => FailureCause::OutOfReach,
        PolicyHit::NotFinite => FailureCause::Code,
        PolicyHit::ModeUncovered
        | PolicyHit::ModeForbidden
        | PolicyHit::ModeUnreviewed
        | PolicyHit::KeepOut
        | PolicyHit::KeepOutEntered
        | PolicyHit::PredictedCollision
        | PolicyHit::SpeedClamped
        | PolicyHit::ForceClamped
        | PolicyHit::SpeedMeasured
        | PolicyHit::RetriesExceeded
        | PolicyHit::CommandUndeclared
        | PolicyHit::ZoneUndeclared
        | PolicyHit::BudgetExceeded
        | PolicyHit::UnsafeContinuation
        | PolicyHit::PermissionWithdrawn => FailureCause::Refused,
    }
}

const fn cause_of_declared(signal: FailureSignal) -> FailureCause {
    match signal {
        FailureSignal::TargetNotFound | FailureSignal::InputStale => FailureCause::Unseen,
        FailureSignal::GraspMissed => FailureCause::Missed,
        FailureSignal::ObjectSlipped => FailureCause::Slipped,
        FailureSignal::UnexpectedContact => FailureCause::Pressed,
        FailureSignal::AlignmentLost | FailureSignal::PlacementMissed => FailureCause::Misplaced,
        FailureSignal::ToolUnavailable => FailureCause::Hardware,
        FailureSignal::TimedOut => FailureCause::Late,
    }
}

fn note_hit(record: &mut TaskRecord, tick: u64, hit: PolicyHit) {
    if !hit.is_violation() {
        record.clamps = record.clamps.saturating_add(1);
        return;
    }
    record.violation = true;
    record.hard_stop = record.hard_stop.or_else(|| hit.hard_stop());
    if record.hits.len() < HITS_KEPT && !record.hits.iter().any(|(_, known)| *known == hit) {
        record.hits.push((tick, hit));
    }
}

fn note_path(record: &mut TaskRecord, seen: &Telemetry, tick: u64) {
    if tick.is_multiple_of(PATH_EVERY_TICKS) {
        // Drawing and envelopes need a tenth of a millimeter; f32 holds far more.
        #[allow(clippy::cast_possible_truncation)]
        record.path.push(PathPoint {
            tick: u32::try_from(tick).unwrap_or(u32::MAX),
            tool: seen.tool.position.map(|v| v as f32),
            width: seen.gripper_width_m as f32,
            force: seen.gripper_force_n as f32,
        });
    }
}

fn tick_secs(tick: u64) -> f64 {
    tick as f64 * TICK_SECS
}

const fn ticks_to_ms(ticks: u64) -> u64 {
    ticks * 1000 / RATE_HZ as u64
}

#[cfg(test)]
mod tests;
