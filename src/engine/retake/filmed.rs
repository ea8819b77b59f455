//! What a world showed of a piece of work, as pictures with what happened in them.
//!
//! Puts frames and records into the protocol's form and into words; works nothing and judges nothing.

use holdpoint_body::{FailureSignal, TICK_SECS};
use holdpoint_governance::evidence::DrillKind;
use holdpoint_protocol::film::{FilmFrame, FilmMark, FilmedRun};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::recovery::StoppedBy;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::film::Frame;

use crate::cell::Cell;
use crate::trial::drills::DrillResult;
use crate::trial::worker::Worker;
use crate::world::portrait::{self, narrow};

/// Who worked, and where.
pub(crate) struct Worked<'a> {
    pub(crate) version: &'a Capability,
    pub(crate) terms: &'a SkillTerms,
    pub(crate) cell: &'a Cell,
    pub(crate) as_recorded: Option<bool>,
}

impl Worked<'_> {
    /// The film of an episode with its record.
    pub(crate) fn episode(&self, worker: &mut Worker, record: &TaskRecord) -> FilmedRun {
        self.run(worker, ended(record), marks(record))
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
        run.marks.extend(from.map(|tick| FilmMark { tick, text: begins.to_owned(), bad: false }));
        if let Some(last) = run.frames.last() {
            run.marks.push(FilmMark { tick: last.tick, text, bad: result == DrillResult::Failed });
        }
        run
    }

    fn run(&self, worker: &mut Worker, ended: String, marks: Vec<FilmMark>) -> FilmedRun {
        let frames = worker.take_film();
        let blocks = worker.built_arm().map(|arm| portrait::blocks(arm.body())).unwrap_or_default();
        FilmedRun {
            version: self.version.id(),
            envelope: portrait::envelope(self.terms.envelope()),
            ended,
            as_recorded: self.as_recorded,
            marks,
            blocks,
            frames: frames.iter().map(|frame| self.frame(frame)).collect(),
        }
    }

    fn frame(&self, frame: &Frame) -> FilmFrame {
        let object_half_m = self.cell.scene.object.half_m;
        FilmFrame {
            tick: frame.tick,
            body: portrait::drawn(&self.cell.model, &frame.seen, &frame.object, object_half_m),
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

/// What came of an episode, the gravest first.
fn ended(record: &TaskRecord) -> String {
    if record.invalid {
        return "the simulator failed in it".to_owned();
    }
    if record.refused {
        return "the call is refused: what it needs to begin does not hold".to_owned();
    }
    let mut said: Vec<String> = Vec::new();
    said.extend(record.hard_stop.map(|stop| stop.sentence().to_owned()));
    if record.violation {
        said.push("passes a limit".to_owned());
    }
    if record.unsafe_continuation_ms > 0 {
        said.push(format!("moves on for {} ms after it was to stop", record.unsafe_continuation_ms));
    }
    if record.recovery {
        said.push("the recovery manager takes over".to_owned());
    }
    if record.timeout {
        said.push("runs out of time".to_owned());
    }
    said.push(if record.success { "does the task" } else { "does not do the task" }.to_owned());
    match record.retries {
        0 => {}
        1 => said.push("tries once more".to_owned()),
        more => said.push(format!("tries {more} times more")),
    }
    said.push(format!("{:.1} s", record.time_secs));
    said.join(", ")
}

/// A declared signal in words, as its name is written.
fn said(signal: FailureSignal) -> String {
    serde_json::to_value(signal)
        .ok()
        .and_then(|word| Some(word.as_str()?.replace('_', " ")))
        .unwrap_or_default()
}

/// What happened in an episode, in order.
fn marks(record: &TaskRecord) -> Vec<FilmMark> {
    let mark = |tick, text: &str, bad| FilmMark { tick, text: text.to_owned(), bad };
    let hits = record.hits.iter().map(|(tick, hit)| mark(*tick, hit.words(), hit.is_violation()));
    let signals = record.signals.iter();
    let signals = signals.map(|raised| mark(raised.tick, raised.signal.words(), raised.signal.is_anomaly()));
    let mut all: Vec<FilmMark> = hits.chain(signals).collect();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "ticks of one episode")]
    let end = (record.time_secs / TICK_SECS).round() as u64;
    all.extend(
        record.declared.map(|signal| mark(end, &format!("it says that it failed: {}", said(signal)), false)),
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
    use holdpoint_runtime::watcher::{Raised, WatcherSignal};

    #[test]
    fn the_gravest_is_said_first_and_marks_are_in_order() {
        let record = TaskRecord {
            invalid: false,
            violation: true,
            time_secs: 2.0,
            retries: 2,
            hits: vec![(300, PolicyHit::ForceMeasured), (20, PolicyHit::SpeedClamped)],
            signals: vec![Raised { signal: WatcherSignal::ObjectSlip, tick: 100 }],
            ..TaskRecord::invalid(TaskKind::Grasp, 3)
        };
        assert_eq!(ended(&record), "passes a limit, does not do the task, tries 2 times more, 2.0 s");
        let marks: Vec<(u64, bool)> = marks(&record).iter().map(|mark| (mark.tick, mark.bad)).collect();
        assert_eq!(marks, [(20, false), (100, true), (300, true), (480, true)]);
    }

    #[test]
    fn what_was_not_worked_is_said_so() {
        let invalid = TaskRecord::invalid(TaskKind::Grasp, 3);
        assert_eq!(ended(&invalid), "the simulator failed in it");
        assert!(marks(&invalid).is_empty());
    }
}
