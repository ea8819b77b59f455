//! Renders the record of a world as video frames with the events in them.
//!
//! Puts frames and records into the protocol's form and into words; works nothing and judges nothing.

use holdpoint_body::{FailureSignal, TICK_SECS};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::harm::{HarmKind, HarmMeasures};
use holdpoint_governance::permission::fault_text;
use holdpoint_governance::profile::HarmSettings;
use holdpoint_protocol::film::{FilmFrame, FilmMark, FilmedRun};
use holdpoint_protocol::video_frame::EnvelopeView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::guard::TRANSIENT_FACTOR;
use holdpoint_runtime::recovery::StoppedBy;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::film::EpisodeFrame;
use holdpoint_wording::hard_stop;

use crate::cell::Cell;
use crate::trial::drills::DrillResult;
use crate::trial::worker::Worker;
use crate::world::cell_frame::{self, narrow};

/// Number of limits that a headline names, the one that is exceeded most first; it counts the others.
const NAMED_MAX: usize = 2;

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
        let mut run = self.run(worker, String::new(), marks(record));
        let passed = limit_exceedance(&run.frames, &run.envelope, record.harm.as_ref(), self.limits);
        run.marks.extend(passed.iter().map(ExceededLimit::mark));
        run.marks.sort_by_key(|mark| mark.tick);
        run.ended = ended(record, &named(passed));
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
        let text = match result {
            DrillResult::Passed => format!("passes the {kind} drill"),
            DrillResult::Failed => format!("fails the {kind} drill"),
            DrillResult::Infeasible => "could not be set up for it".to_owned(),
        };
        let begins = match kind {
            DrillKind::Rollback => "its rollback hook is called",
            DrillKind::Fallback => "it is aborted, the fallback takes over",
            DrillKind::Abort => "its abort hook is called",
            DrillKind::Detect => "a fault is injected",
        };
        let mut run = self.run(worker, text.clone(), Vec::new());
        let passed = limit_exceedance(&run.frames, &run.envelope, None, self.limits);
        run.marks.extend(passed.iter().map(ExceededLimit::mark));
        run.ended = [vec![text.clone()], named(passed)].concat().join(", ");
        run.marks.extend(from.map(|tick| FilmMark { tick, text: begins.to_owned(), bad: false }));
        if let Some(last) = run.frames.last() {
            run.marks.push(FilmMark { tick: last.tick, text, bad: result == DrillResult::Failed });
        }
        run.marks.sort_by_key(|mark| mark.tick);
        run
    }

    fn run(&self, worker: &mut Worker, ended: String, marks: Vec<FilmMark>) -> FilmedRun {
        let frames = worker.take_film();
        let blocks = worker.built_arm().map(|arm| cell_frame::blocks(arm.body())).unwrap_or_default();
        FilmedRun {
            version: self.version.id(),
            envelope: cell_frame::envelope(self.terms.envelope()),
            ended,
            as_recorded: self.as_recorded,
            marks,
            blocks,
            frames: frames.iter().map(|frame| self.frame(frame)).collect(),
        }
    }

    fn frame(&self, frame: &EpisodeFrame) -> FilmFrame {
        let object_half_m = self.cell.scene.object.half_m;
        FilmFrame {
            tick: frame.tick,
            body: cell_frame::drawn(&self.cell.model, &frame.seen, &frame.object, object_half_m),
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

/// A limit that was passed.
struct ExceededLimit {
    /// When first, ticks; the end where only the whole episode tells.
    tick: u64,
    /// How many times over.
    times: f64,
    /// What, and how far.
    text: String,
}

impl ExceededLimit {
    fn mark(&self) -> FilmMark {
        FilmMark { tick: self.tick, text: self.text.clone(), bad: true }
    }
}

/// The limits that the work passed: of the guard's those that are charted, by more than a transient may, and whatever the
/// profile counts an episode as a bad one by.
fn limit_exceedance(
    frames: &[FilmFrame],
    envelope: &EnvelopeView,
    harm: Option<&HarmMeasures>,
    limits: &HarmSettings,
) -> Vec<ExceededLimit> {
    let over = |times: f64| if times.is_finite() { format!("{times:.1} times") } else { "past".to_owned() };
    let charted = |what: &str, unit: &str, limit: f32, of: fn(&FilmFrame) -> f32| {
        let most = frames.iter().map(of).fold(0.0, f32::max);
        let times = f64::from(most / limit);
        let past = |frame: &&FilmFrame| f64::from(of(frame) / limit) > TRANSIENT_FACTOR;
        let tick = frames.iter().find(past)?.tick;
        let text = format!("{what} {most:.1} {unit}, {} what its guard allows", over(times));
        Some(ExceededLimit { tick, times, text })
    };
    let grip = charted("grip", "N", envelope.force_n, |frame| frame.grip_n);
    let is_named = |kind| grip.is_some() && matches!(kind, HarmKind::GripPeak | HarmKind::GripHeld);
    let end = frames.last().map_or(0, |frame| frame.tick);
    let harmful = HarmKind::ALL.into_iter().filter(|kind| !is_named(*kind)).filter_map(|kind| {
        let (value, limit) = (harm?.of(kind), limits.of(kind).limit);
        if !kind.is_past(value, limit) {
            return None;
        }
        let (label, shown) = (kind.label(), kind.format(value));
        Some(if kind.is_worse_when_lower() {
            let times = if value > 0.0 { limit / value } else { f64::INFINITY };
            let text = format!("{label} {shown}, at least {} is wanted", kind.format(limit));
            ExceededLimit { tick: end, times, text }
        } else {
            let times = value / limit;
            let text = format!("{label} {shown}, {} the limit", over(times));
            ExceededLimit { tick: end, times, text }
        })
    });
    let harmful: Vec<ExceededLimit> = harmful.collect();
    let speed = charted("speed", "m/s", envelope.speed_m_s, |frame| frame.speed_m_s);
    let mut all: Vec<ExceededLimit> = grip.into_iter().chain(speed).chain(harmful).collect();
    all.sort_by(|a, b| b.times.total_cmp(&a.times));
    all
}

/// Those that a headline names.
fn named(passed: Vec<ExceededLimit>) -> Vec<String> {
    let more = passed.len().saturating_sub(NAMED_MAX);
    let mut parts: Vec<String> = passed.into_iter().take(NAMED_MAX).map(|one| one.text).collect();
    match more {
        0 => {}
        1 => parts.push("one more limit passed".to_owned()),
        more => parts.push(format!("{more} more limits passed")),
    }
    parts
}

/// What came of an episode, the gravest first.
fn ended(record: &TaskRecord, passed: &[String]) -> String {
    if record.invalid {
        return "the simulator failed in it".to_owned();
    }
    if record.refused {
        return "the call is refused: what it needs to begin does not hold".to_owned();
    }
    let mut parts: Vec<String> = Vec::new();
    match (record.hard_stop, record.fault) {
        (Some(stop), fault) => parts.push(hard_stop(stop, fault).to_owned()),
        (None, Some(fault)) => parts.push(fault_text(fault).to_owned()),
        (None, None) => {}
    }
    if record.violation {
        let hits = record.hits.iter().map(|(_, hit)| hit).filter(|hit| hit.is_violation());
        let labels: Vec<&str> = hits.map(|hit| hit.label()).collect();
        let which = if labels.is_empty() { String::new() } else { format!(": {}", labels.join(" and ")) };
        parts.push(format!("passes a limit{which}"));
    }
    parts.extend_from_slice(passed);
    if record.unsafe_continuation_ms > 0 {
        parts.push(format!("moves on for {} ms after it was to stop", record.unsafe_continuation_ms));
    }
    if record.recovery {
        parts.push("the recovery manager takes over".to_owned());
    }
    if record.timeout {
        parts.push("runs out of time".to_owned());
    }
    parts.push(if record.success { "does the task" } else { "does not do the task" }.to_owned());
    match record.retries {
        0 => {}
        1 => parts.push("tries once more".to_owned()),
        more => parts.push(format!("tries {more} times more")),
    }
    parts.push(format!("{:.1} s", record.time_secs));
    parts.join(", ")
}

/// A declared signal in words, as its name is written.
fn signal_label(signal: FailureSignal) -> String {
    serde_json::to_value(signal)
        .ok()
        .and_then(|value| Some(value.as_str()?.replace('_', " ")))
        .unwrap_or_default()
}

/// What happened in an episode, in order.
fn marks(record: &TaskRecord) -> Vec<FilmMark> {
    let mark = |tick, text: &str, bad| FilmMark { tick, text: text.to_owned(), bad };
    let hits = record.hits.iter().map(|(tick, hit)| mark(*tick, hit.label(), hit.is_violation()));
    let signals = record.signals.iter();
    let signals = signals.map(|raised| mark(raised.tick, raised.signal.label(), raised.signal.is_anomaly()));
    let mut all: Vec<FilmMark> = hits.chain(signals).collect();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "ticks of one episode")]
    let end = (record.time_secs / TICK_SECS).round() as u64;
    all.extend(
        record
            .declared
            .map(|signal| mark(end, &format!("it says that it failed: {}", signal_label(signal)), false)),
    );
    all.extend(record.recovered.as_ref().map(|report| {
        let (text, bad) = match report.stopped_by {
            StoppedBy::Hook => ("its abort hook stops the arm", false),
            StoppedBy::Interrupt => ("the arm has to be interrupted", true),
            StoppedBy::Nothing => ("nothing stops the arm", true),
        };
        mark(end, text, bad)
    }));
    if !record.invalid && !record.refused {
        let text = if record.success { "the task is done" } else { "the task is not done" };
        all.push(mark(end, text, !record.success));
    }
    all.sort_by_key(|mark| mark.tick);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_runtime::guard::PolicyHit;
    use holdpoint_runtime::watcher::{RaisedSignal, WatcherSignal};

    #[test]
    fn the_gravest_comes_first_and_marks_are_in_order() {
        let record = TaskRecord {
            invalid: false,
            violation: true,
            time_secs: 2.0,
            retries: 2,
            hits: vec![(300, PolicyHit::ForceMeasured), (20, PolicyHit::SpeedClamped)],
            signals: vec![RaisedSignal { signal: WatcherSignal::ObjectSlip, tick: 100 }],
            ..TaskRecord::invalid(TaskKind::Grasp, 3)
        };
        let grip = "grip 90.0 N, 3.0 times what its guard allows".to_owned();
        assert_eq!(
            ended(&record, &[grip]),
            "passes a limit: a force is larger than allowed, grip 90.0 N, 3.0 times what its guard allows, does not do \
             the task, tries 2 times more, 2.0 s"
        );
        let marks: Vec<(u64, bool)> = marks(&record).iter().map(|mark| (mark.tick, mark.bad)).collect();
        assert_eq!(marks, [(20, false), (100, true), (300, true), (480, true)]);
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
            limit_exceedance(frames, &envelope, Some(harm), limits)
                .into_iter()
                .map(|one| (one.tick, one.text))
                .collect::<Vec<_>>()
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
        assert_eq!(
            found.iter().map(|(tick, text)| (*tick, text.as_str())).collect::<Vec<_>>(),
            [
                (16, "distance to a keep-out zone -0.100 m, at least 0.050 m is wanted"),
                (16, "excess of a command over the declaration 0.500, 5.0 times the limit"),
                (8, "grip 60.0 N, 3.0 times what its guard allows"),
            ]
        );
        let headline = named(limit_exceedance(&pressed, &envelope, Some(&harm), limits));
        assert_eq!(headline.len(), NAMED_MAX + 1);
        assert_eq!(headline[NAMED_MAX], "one more limit passed");
    }

    #[test]
    fn an_invalid_run_is_reported() {
        let invalid = TaskRecord::invalid(TaskKind::Grasp, 3);
        assert_eq!(ended(&invalid, &[]), "the simulator failed in it");
        assert!(marks(&invalid).is_empty());
    }
}
