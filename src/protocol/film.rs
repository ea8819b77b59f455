//! A film: which piece of an evaluation to re-run, and its video frames.
//!
//! Nothing of it is stored. It is computed from its recorded inputs (versions, cell, terms, seed) and compared with
//! the recorded result. It decides nothing.

mod outcome;
mod selection;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use holdpoint_body::TaskKind;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::phase::WorkPhase;

use crate::video_frame::{ArmView, EnvelopeView, SceneBlock, Scenery};

pub use self::outcome::{ExceededLimit, ExceededValue, MarkedEvent, OutcomePart};
pub use self::selection::{
    BreakCause, CodeFaultCount, FilmRefusal, ReplayDifference, SelectionFailure, SelectionReason,
};

holdpoint_governance::closed_set! {
    /// The kind of work to film.
    FilmSubject, "kind of work", {
        /// A paired episode of the sandbox, perturbed.
        Episode = "episode",
        /// An episode of the sandbox with the candidate alone, first undisturbed, then under stress.
        Alone = "alone",
        /// A recovery drill of the sandbox.
        Drill = "drill",
        /// A paired episode of the confirmation.
        Confirmation = "confirmation",
    }
}

/// The piece of work to film.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmRequest {
    /// The kind of work.
    pub of: FilmSubject,
    /// Its place among those on record, from 1; absent for the worst of them: for drills, of those that failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<u32>,
}

/// One frame of a piece of work, 30 per simulated second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmFrame {
    /// Ticks since the episode began; 240 are a second.
    pub tick: u64,
    /// Arm and object.
    pub body: ArmView,
    /// Measured joint positions, rad, from the base on.
    pub q: Vec<f32>,
    /// Measured joint torques, N m, from the base on.
    pub tau: Vec<f32>,
    /// Largest measured speed of the tool since the frame before, m/s.
    pub speed_m_s: f32,
    /// Largest measured force of the pads on the object since the frame before, N.
    pub grip_n: f32,
    /// Largest measured force on the surroundings since the frame before, N.
    pub contact_n: f32,
    /// Whether there was a contact since the frame before that no task makes.
    pub touched: bool,
    /// Whether the arm received a stop, or the skill declared that it failed.
    pub stopped: bool,
}

/// Something that happened in a piece of work.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmMark {
    /// When, ticks since the episode began.
    pub tick: u64,
    /// What, a few words.
    pub text: String,
    /// Whether it speaks against the version.
    pub bad: bool,
}

/// One version's performance of a piece of work.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmedRun {
    /// The version.
    pub version: CapabilityId,
    /// The limits of its guard.
    pub envelope: EnvelopeView,
    /// The result, in words, the gravest first.
    pub ended: String,
    /// Whether it failed. A limit of harm that is passed in a task that is done speaks against a version, and is no failure.
    #[serde(default)]
    pub failed: bool,
    /// Whether the record has exactly this result; absent if the record has none.
    pub as_recorded: Option<bool>,
    /// What happened, in order.
    pub marks: Vec<FilmMark>,
    /// The blocks in the cell: the parts of the tray, and the clutter.
    pub blocks: Vec<SceneBlock>,
    /// The video frames, in order; none if it could not be run.
    pub frames: Vec<FilmFrame>,
}

impl FilmedRun {
    /// The first event that speaks against the version, ticks; absent if there is none.
    #[must_use]
    pub fn failed_at(&self) -> Option<u64> {
        self.marks.iter().find(|mark| mark.bad).map(|mark| mark.tick)
    }

    /// The frame that shows a moment: the last one before it, or the first.
    #[must_use]
    pub fn frame_at(&self, tick: u64) -> Option<&FilmFrame> {
        let after = self.frames.partition_point(|frame| frame.tick <= tick);
        self.frames.get(after.saturating_sub(1))
    }
}

/// The same piece of work by a candidate and by the version it was compared with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Film {
    /// The kind of work.
    pub of: FilmSubject,
    /// Its place among those on record, from 1.
    pub number: u32,
    /// How many there are on record one by one.
    pub count: u32,
    /// Of failed drills: how many more failed than are on record one by one.
    #[serde(default)]
    pub beyond: u32,
    /// The task.
    pub task: TaskKind,
    /// The seed of the episode.
    pub seed: u64,
    /// The kind of a drill.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drill: Option<DrillKind>,
    /// The phase in which a drill began.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase: Option<WorkPhase>,
    /// Why this one was selected as the worst; empty otherwise.
    pub why: String,
    /// Differences from the original (another build, profile or cell), one sentence each; empty if there are none.
    pub doubts: Vec<String>,
    /// The fixed objects.
    pub scenery: Scenery,
    /// The candidate's performance.
    pub candidate: FilmedRun,
    /// The performance of the version it was compared with.
    pub active: FilmedRun,
}

impl Film {
    /// When the longer of the two ends, ticks.
    #[must_use]
    pub fn end(&self) -> u64 {
        let last = |run: &FilmedRun| run.frames.last().map_or(0, |frame| frame.tick);
        last(&self.candidate).max(last(&self.active))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(ticks: &[u64], marks: Vec<FilmMark>) -> FilmedRun {
        let body = ArmView {
            links: vec![[0.0; 3]; 2],
            pads: [[0.0; 3]; 2],
            hand: crate::video_frame::NO_TURN,
            object: [0.0; 3],
            object_turn: crate::video_frame::NO_TURN,
            object_half_m: 0.02,
            held: false,
        };
        let frame = |tick: &u64| FilmFrame {
            tick: *tick,
            body: body.clone(),
            q: Vec::new(),
            tau: Vec::new(),
            speed_m_s: 0.0,
            grip_n: 0.0,
            contact_n: 0.0,
            touched: false,
            stopped: false,
        };
        FilmedRun {
            version: "grasp@1.0.0".parse().unwrap(),
            envelope: EnvelopeView { speed_m_s: 1.0, force_n: 1.0, contact_n: 1.0 },
            ended: String::new(),
            failed: false,
            as_recorded: None,
            marks,
            blocks: Vec::new(),
            frames: ticks.iter().map(frame).collect(),
        }
    }

    #[test]
    fn a_tick_is_shown_by_the_frame_before_it() {
        let run = run(&[0, 8, 16], Vec::new());
        let at = |tick| run.frame_at(tick).map(|frame| frame.tick);
        assert_eq!([at(0), at(7), at(8), at(500)], [Some(0), Some(0), Some(8), Some(16)]);
        assert!(self::run(&[], Vec::new()).frame_at(3).is_none());
    }

    #[test]
    fn the_first_bad_mark_is_where_it_failed() {
        let mark = |tick, bad| FilmMark { tick, text: String::new(), bad };
        assert_eq!(run(&[], vec![mark(3, false), mark(9, true), mark(12, true)]).failed_at(), Some(9));
        assert_eq!(run(&[], vec![mark(3, false)]).failed_at(), None);
    }
}
