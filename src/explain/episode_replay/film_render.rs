//! Renders the record of a world as video frames with the events in them.
//!
//! Puts frames and records into the protocol's form; runs nothing and judges nothing.

use holdpoint_body::TICK_SECS;
use holdpoint_cell::film::EpisodeFrame;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::profile::HarmSettings;
use holdpoint_protocol::film::{
    ExceededLimit, ExceededValue, FilmFrame, FilmMark, FilmedRun, MarkedEvent, OutcomePart,
};
use holdpoint_protocol::video_frame::EnvelopeView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::PolicyHit;
use holdpoint_runtime::recovery::StoppedBy;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_runtime::watcher::RaisedSignal;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::drills::DrillResult;
use holdpoint_trials::worker::Worker;
use holdpoint_wording::film::{marked_event, outcome};

use holdpoint_trials::cell_frame::{self, narrow};

/// Number of limits that a headline names, the one that is exceeded most first; it counts the others.
const NAMED_MAX: usize = 2;

/// A mark of a film, before it is put into words.
#[derive(Debug, PartialEq)]
struct EventMark {
    /// When, ticks.
    tick: u64,
    event: MarkedEvent,
    /// Whether it speaks against the version.
    bad: bool,
}

impl EventMark {
    fn new(tick: u64, event: MarkedEvent, bad: bool) -> Self {
        Self { tick, event, bad }
    }

    fn exceeded(limit: &ExceededLimit) -> Self {
        Self::new(limit.tick, MarkedEvent::Outcome(OutcomePart::Exceeded(*limit)), true)
    }
}

/// Who worked, and where.
pub(crate) struct FilmedWork<'a> {
    pub(crate) version: &'a Capability,
    pub(crate) terms: &'a SkillTerms,
    pub(crate) cell: &'a Cell,
    /// What an episode must not pass, of what it does to its surroundings.
    pub(crate) limits: &'a HarmSettings,
    pub(crate) as_recorded: Option<bool>,
}

impl FilmedWork<'_> {
    /// The film of an episode with its record.
    pub(crate) fn episode(&self, worker: &mut Worker, record: &TaskRecord) -> FilmedRun {
        let mut run = self.run(worker);
        let exceeded = self.exceeded(&run, record.harm.as_ref());
        let mut events = marks(record);
        events.extend(exceeded.iter().map(EventMark::exceeded));
        run.marks = film_marks(events);
        run.ended = outcome(&ended(record, named(&exceeded)));
        run.failed = has_failed(record);
        run
    }

    /// The film of a drill.
    pub(crate) fn drill(
        &self,
        worker: &mut Worker,
        kind: DrillKind,
        result: DrillResult,
        from: Option<u64>,
    ) -> FilmedRun {
        let end = match result {
            DrillResult::Passed => OutcomePart::Drill { kind, passed: true },
            DrillResult::Failed => OutcomePart::Drill { kind, passed: false },
            DrillResult::Infeasible => OutcomePart::DrillNotSetUp,
        };
        let mut run = self.run(worker);
        let exceeded = self.exceeded(&run, None);
        let mut events: Vec<EventMark> = exceeded.iter().map(EventMark::exceeded).collect();
        run.ended = outcome(&[vec![end.clone()], named(&exceeded)].concat());
        events.extend(from.map(|tick| EventMark::new(tick, MarkedEvent::DrillBegan(kind), false)));
        run.failed = result == DrillResult::Failed;
        if let Some(last) = run.frames.last() {
            events.push(EventMark::new(last.tick, MarkedEvent::Outcome(end), run.failed));
        }
        run.marks = film_marks(events);
        run
    }

    fn exceeded(&self, run: &FilmedRun, harm: Option<&HarmMeasures>) -> Vec<ExceededLimit> {
        let transient_factor = self.terms.profile().runtime.transient_factor;
        limit_exceedance(&run.frames, &run.envelope, transient_factor, harm, self.limits)
    }

    /// The run without its result and its events.
    fn run(&self, worker: &mut Worker) -> FilmedRun {
        let frames = worker.take_film();
        // A task from a live start begins at a later tick of its world.
        let from = frames.first().map_or(0, |frame| frame.tick);
        let blocks =
            worker.built_arm().map(|arm| cell_frame::blocks(arm.body().as_ref())).unwrap_or_default();
        FilmedRun {
            version: self.version.id(),
            envelope: cell_frame::envelope(self.terms.envelope()),
            ended: String::new(),
            failed: false,
            as_recorded: self.as_recorded,
            marks: Vec::new(),
            blocks,
            frames: frames.iter().map(|frame| self.frame(frame, from)).collect(),
        }
    }

    fn frame(&self, frame: &EpisodeFrame, from: u64) -> FilmFrame {
        let object_half_m = self.cell.scene.object.half_m;
        FilmFrame {
            tick: frame.tick.saturating_sub(from),
            body: cell_frame::drawn(&self.cell.spec.robot, &frame.seen, &frame.object, object_half_m),
            q: frame.seen.q.iter().map(|at| narrow(*at)).collect(),
            tau: frame.tau.iter().map(|at| narrow(*at)).collect(),
            speed_m_s: narrow(frame.speed_m_s),
            grip_n: narrow(frame.grip_n),
            contact_n: narrow(frame.contact_n),
            touched: frame.touched,
            stopped: frame.stopped,
        }
    }
}

/// The marks in the order of time; of those at one tick, in their order.
fn film_marks(mut events: Vec<EventMark>) -> Vec<FilmMark> {
    events.sort_by_key(|mark| mark.tick);
    let mark = |EventMark { tick, event, bad }| FilmMark { tick, text: marked_event(&event), bad };
    events.into_iter().map(mark).collect()
}

/// The limits that the work passed: of the guard's those that are charted, by more than a transient may, and whatever the
/// profile counts an episode as a bad one by.
fn limit_exceedance(
    frames: &[FilmFrame],
    envelope: &EnvelopeView,
    transient_factor: f64,
    harm: Option<&HarmMeasures>,
    limits: &HarmSettings,
) -> Vec<ExceededLimit> {
    let charted = |limit: f32, of: fn(&FilmFrame) -> f32, value: fn(f32) -> ExceededValue| {
        let most = frames.iter().map(of).fold(0.0, f32::max);
        let times = f64::from(most / limit);
        let past = |frame: &&FilmFrame| f64::from(of(frame) / limit) > transient_factor;
        let tick = frames.iter().find(past)?.tick;
        Some(ExceededLimit { tick, times, value: value(most) })
    };
    let grip = charted(envelope.force_n, |frame| frame.grip_n, |most_n| ExceededValue::Grip { most_n });
    let is_named = |kind| grip.is_some() && matches!(kind, HarmKind::GripPeak | HarmKind::GripHeld);
    let end = frames.last().map_or(0, |frame| frame.tick);
    let harmful = HarmKind::ALL.into_iter().filter(|kind| !is_named(*kind)).filter_map(|kind| {
        let (value, limit) = (harm?.of(kind), limits.of(kind).limit);
        if !kind.is_past(value, limit) {
            return None;
        }
        let times = match (kind.is_worse_when_lower(), value > 0.0) {
            (true, true) => limit / value,
            (true, false) => f64::INFINITY,
            (false, _) => value / limit,
        };
        Some(ExceededLimit { tick: end, times, value: ExceededValue::Harm { kind, value, limit } })
    });
    let harmful: Vec<ExceededLimit> = harmful.collect();
    let speed =
        charted(envelope.speed_m_s, |frame| frame.speed_m_s, |most_m_s| ExceededValue::Speed { most_m_s });
    let mut all: Vec<ExceededLimit> = grip.into_iter().chain(speed).chain(harmful).collect();
    all.sort_by(|a, b| b.times.total_cmp(&a.times));
    all
}

/// Those that a headline names, and how many more there are.
fn named(exceeded: &[ExceededLimit]) -> Vec<OutcomePart> {
    let mut parts: Vec<OutcomePart> =
        exceeded.iter().take(NAMED_MAX).map(|limit| OutcomePart::Exceeded(*limit)).collect();
    let limits = exceeded.len().saturating_sub(NAMED_MAX);
    parts.extend((limits > 0).then_some(OutcomePart::MoreExceeded { limits }));
    parts
}

/// Whether an episode failed, whatever limits of harm it passed.
const fn has_failed(record: &TaskRecord) -> bool {
    !record.success || record.violation || record.hard_stop.is_some() || record.fault.is_some()
}

/// The result of an episode, the gravest first. That a task is done comes before the limits of harm that it passed.
fn ended(record: &TaskRecord, exceeded: Vec<OutcomePart>) -> Vec<OutcomePart> {
    if record.invalid {
        return vec![OutcomePart::SimulatorFailed];
    }
    if record.refused {
        return vec![OutcomePart::CallRefused];
    }
    let mut parts = Vec::new();
    match (record.hard_stop, record.fault) {
        (Some(stop), fault) => parts.push(OutcomePart::HardStop { stop, fault }),
        (None, Some(fault)) => parts.push(OutcomePart::CodeFault(fault)),
        (None, None) => {}
    }
    if record.violation {
        let hits = record.hits.iter().map(|(_, hit)| *hit).filter(|hit| hit.is_violation()).collect();
        parts.push(OutcomePart::Violation { hits });
    }
    let (before, after) = if has_failed(record) { (exceeded, Vec::new()) } else { (Vec::new(), exceeded) };
    parts.extend(before);
    if record.unsafe_continuation_ms > 0 {
        parts.push(OutcomePart::MovedOn { ms: record.unsafe_continuation_ms });
    }
    if record.recovery {
        parts.push(OutcomePart::RecoveryTookOver);
    }
    if record.timeout {
        parts.push(OutcomePart::TimedOut);
    }
    // That it ran out of time stands there already.
    let cause = record.failure_cause().filter(|cause| *cause != FailureCause::Late || !record.timeout);
    parts.push(OutcomePart::Task { done: record.success, cause });
    parts.extend(after);
    if record.retries > 0 {
        parts.push(OutcomePart::Attempts { more: record.retries });
    }
    parts.push(OutcomePart::Took { secs: record.time_secs });
    parts
}

/// What happened in an episode, in order.
fn marks(record: &TaskRecord) -> Vec<EventMark> {
    let guard =
        |(tick, hit): &(u64, PolicyHit)| EventMark::new(*tick, MarkedEvent::Guard(*hit), hit.is_violation());
    let watcher = |raised: &RaisedSignal| {
        EventMark::new(raised.tick, MarkedEvent::Watcher(raised.signal), raised.signal.is_anomaly())
    };
    let mut all: Vec<EventMark> = record.hits.iter().map(guard).collect();
    all.extend(record.signals.iter().map(watcher));
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "ticks of one episode")]
    let end = (record.time_secs / TICK_SECS).round() as u64;
    all.extend(record.declared.map(|signal| EventMark::new(end, MarkedEvent::Declared(signal), false)));
    all.extend(record.recovered.as_ref().map(|report| match report.stopped_by {
        StoppedBy::RollbackHook | StoppedBy::Hook => EventMark::new(end, MarkedEvent::StoppedByHook, false),
        StoppedBy::Interrupt => EventMark::new(end, MarkedEvent::StoppedByInterrupt, true),
        StoppedBy::Nothing => EventMark::new(end, MarkedEvent::NotStopped, true),
    }));
    if !record.invalid && !record.refused {
        let (done, cause) = (record.success, record.failure_cause());
        all.push(EventMark::new(end, MarkedEvent::TaskEnded { done, cause }, !done));
    }
    all.sort_by_key(|mark| mark.tick);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_runtime::watcher::WatcherSignal;

    #[test]
    fn the_gravest_comes_first_and_marks_are_in_order() {
        let record = TaskRecord {
            invalid: false,
            violation: true,
            time_secs: 2.0,
            retries: 2,
            hits: vec![(300, PolicyHit::ForceMeasured), (120, PolicyHit::SpeedClamped)],
            signals: vec![RaisedSignal { signal: WatcherSignal::ObjectSlip, tick: 100 }],
            ..TaskRecord::invalid(TaskKind::Grasp, 3)
        };
        let value = ExceededValue::Grip { most_n: 90.0 };
        let grip = OutcomePart::Exceeded(ExceededLimit { tick: 100, times: 3.0, value });
        assert_eq!(
            ended(&record, vec![grip.clone()]),
            [
                OutcomePart::Violation { hits: vec![PolicyHit::ForceMeasured] },
                grip,
                OutcomePart::Task { done: false, cause: Some(FailureCause::Slipped) },
                OutcomePart::Attempts { more: 2 },
                OutcomePart::Took { secs: 2.0 },
            ]
        );
        let marks: Vec<(u64, bool)> = marks(&record).iter().map(|mark| (mark.tick, mark.bad)).collect();
        assert_eq!(marks, [(100, true), (120, false), (300, true), (480, true)]);
    }

    /// Regression: `time near a limit` headed, as a failure, a version that did the task.
    #[test]
    fn a_task_that_is_done_comes_before_the_limits_that_it_passed() {
        let record = TaskRecord {
            invalid: false,
            success: true,
            time_secs: 2.0,
            ..TaskRecord::invalid(TaskKind::Grasp, 3)
        };
        let value = ExceededValue::Harm { kind: HarmKind::NearTime, value: 1.679, limit: 1.5 };
        let near = OutcomePart::Exceeded(ExceededLimit { tick: 480, times: 1.1, value });
        let done = OutcomePart::Task { done: true, cause: None };
        let took = OutcomePart::Took { secs: 2.0 };
        assert_eq!(ended(&record, vec![near.clone()]), [done, near, took]);
        assert!(!has_failed(&record));
        assert!(has_failed(&TaskRecord { success: false, ..record.clone() }));
        assert!(has_failed(&TaskRecord { violation: true, ..record }));
    }

    /// A limit that was passed three times over stood in a chart and in no headline.
    #[test]
    fn a_limit_that_is_passed_is_named_the_one_passed_most_first() {
        let frame = |tick, grip_n| FilmFrame {
            tick,
            body: holdpoint_protocol::video_frame::ArmView {
                links: Vec::new(),
                pads: [[0.0; 3]; 2],
                hand: holdpoint_protocol::video_frame::NO_TURN,
                object: [0.0; 3],
                object_turn: holdpoint_protocol::video_frame::NO_TURN,
                object_half_m: 0.02,
                held: false,
            },
            q: Vec::new(),
            tau: Vec::new(),
            speed_m_s: 0.3,
            grip_n,
            contact_n: 0.0,
            touched: false,
            stopped: false,
        };
        let envelope = EnvelopeView { speed_m_s: 0.5, force_n: 20.0, contact_n: 60.0 };
        let profile =
            holdpoint_governance::profile::Profile::builtin(holdpoint_governance::profile::ProfileName::Sim)
                .unwrap();
        let limits = &profile.harm;
        let exceedances = |frames: &[FilmFrame], harm: &HarmMeasures| {
            limit_exceedance(frames, &envelope, 2.0, Some(harm), limits)
        };
        let calm = [frame(0, 19.0), frame(8, 38.0)];
        assert!(exceedances(&calm, &HarmMeasures::STILL).is_empty(), "a transient passes nothing");
        let pressed = [frame(0, 19.0), frame(8, 41.0), frame(16, 60.0)];
        let harm = HarmMeasures {
            grip_peak_n: 60.0,
            excess_depth: 0.5,
            zone_clearance_m: -0.1,
            ..HarmMeasures::STILL
        };
        let found = exceedances(&pressed, &harm);
        let past = |kind, value| ExceededValue::Harm { kind, value, limit: limits.of(kind).limit };
        let excess = past(HarmKind::ExcessDepth, 0.5);
        let times = 0.5 / limits.of(HarmKind::ExcessDepth).limit;
        assert_eq!(
            found,
            [
                ExceededLimit { tick: 16, times: f64::INFINITY, value: past(HarmKind::ZoneClearance, -0.1) },
                ExceededLimit { tick: 16, times, value: excess },
                ExceededLimit { tick: 8, times: 3.0, value: ExceededValue::Grip { most_n: 60.0 } },
            ]
        );
        let headline = named(&found);
        assert_eq!(headline.len(), NAMED_MAX + 1);
        assert_eq!(headline[NAMED_MAX], OutcomePart::MoreExceeded { limits: 1 });
    }

    #[test]
    fn an_invalid_run_is_reported() {
        let invalid = TaskRecord::invalid(TaskKind::Grasp, 3);
        assert_eq!(ended(&invalid, Vec::new()), [OutcomePart::SimulatorFailed]);
        assert!(marks(&invalid).is_empty());
    }
}
