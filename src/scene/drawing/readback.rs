//! Data for reading back, beyond what a viewer draws, as JSON text in its own entities.

use serde::{Deserialize, Serialize};

use rerun::archetypes::TextLog;

use crate::rows::{PendingRows, RowTime};
use holdpoint_body::TaskKind;
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::video_frame::{EnvelopeView, SceneBlock, Scenery, VideoFrame};
use holdpoint_recordings::recording::{FilmSpan, RecordingSubject};

/// Entity paths.
pub mod paths {
    /// One text: a [`super::RecordingHead`].
    pub const HEAD: &str = "record/head";
    /// One text: a [`super::RecordingTail`], in ended files.
    pub const TAIL: &str = "record/tail";
    /// A text for each video frame: a [`super::FrameFacts`].
    pub const FRAME: &str = "record/frame";
    /// A text for each event.
    pub const EVENT: &str = "record/event";
    /// A text for each re-run part of an evaluation: a [`FilmSpan`](super::FilmSpan).
    pub const FILM: &str = "record/film";
}

/// The data known when a recording begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingHead {
    pub about: RecordingSubject,
    /// The fixed scene.
    pub scenery: Scenery,
}

/// The data known when it ends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingTail {
    /// How the upgrade ended; absent if only the program ended.
    pub outcome: Option<Lenient<UpgradeEnd>>,
    /// Video frames and events that were dropped on the way.
    pub dropped: (u64, u64),
}

/// Data of a video frame beside its geometry. Names are short because each frame repeats them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameFacts {
    /// [`VideoFrame::sequence`].
    #[serde(rename = "s")]
    pub sequence: u64,
    /// [`VideoFrame::at_ms`].
    #[serde(rename = "t")]
    pub at_ms: u64,
    /// [`VideoFrame::at_secs`].
    #[serde(rename = "w")]
    pub at_secs: f64,
    /// [`VideoFrame::task`].
    #[serde(rename = "k", default, skip_serializing_if = "Option::is_none")]
    pub task: Option<TaskKind>,
    /// [`VideoFrame::version`].
    #[serde(rename = "v", default, skip_serializing_if = "Option::is_none")]
    pub version: Option<CapabilityId>,
    #[serde(rename = "n", default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<CapabilityId>,
    /// Gripped, gripped by the twin, unexpected contact, stopped.
    #[serde(rename = "x")]
    pub flags: [bool; 4],
    /// Half the object's edge, m: the live world's and the twin's.
    #[serde(rename = "h")]
    pub half_m: [f32; 2],
    /// Speed, force at the pads, force on the surroundings.
    #[serde(rename = "f")]
    pub tool: [f32; 3],
    /// [`VideoFrame::envelope`].
    #[serde(rename = "e", default, skip_serializing_if = "Option::is_none")]
    pub envelope: Option<EnvelopeView>,
    /// Forces of the contacts; the arrows are scaled.
    #[serde(rename = "c", default, skip_serializing_if = "Vec::is_empty")]
    pub forces_n: Vec<[f32; 3]>,
    /// [`VideoFrame::blocks`], written once in a sequence.
    #[serde(rename = "b", default, skip_serializing_if = "Vec::is_empty")]
    pub blocks: Vec<SceneBlock>,
}

pub fn head(rows: &mut PendingRows, head: &RecordingHead) {
    always(rows, paths::HEAD, head);
}

pub fn tail(rows: &mut PendingRows, tail: &RecordingTail) {
    always(rows, paths::TAIL, tail);
}

fn always<T: Serialize>(rows: &mut PendingRows, path: &str, value: &T) {
    if let Ok(text) = serde_json::to_string(value) {
        rows.always(path, &TextLog::new(text));
    }
}

pub(super) fn event(rows: &mut PendingRows, event: &Event, time: &RowTime) {
    if let Ok(text) = serde_json::to_string(event) {
        rows.at(paths::EVENT, time, &TextLog::new(text));
    }
}

pub(super) fn film(rows: &mut PendingRows, span: &FilmSpan, time: &RowTime) {
    if let Ok(text) = serde_json::to_string(span) {
        rows.at(paths::FILM, time, &TextLog::new(text));
    }
}

/// Writes the data of a video frame beside its geometry.
pub(super) fn frame(rows: &mut PendingRows, video_frame: &VideoFrame, time: &RowTime, with_blocks: bool) {
    let twin = video_frame.twin.as_ref();
    let frame = FrameFacts {
        sequence: video_frame.sequence,
        at_ms: video_frame.at_ms,
        at_secs: video_frame.at_secs,
        task: video_frame.task,
        version: video_frame.version.clone(),
        twin: twin.map(|twin| twin.version.clone()),
        flags: [
            video_frame.body.held,
            twin.is_some_and(|twin| twin.body.held),
            video_frame.unexpected_contact,
            video_frame.stopped,
        ],
        half_m: [video_frame.body.object_half_m, twin.map_or(0.0, |twin| twin.body.object_half_m)],
        tool: [video_frame.speed_m_s, video_frame.force_n, video_frame.contact_n],
        envelope: video_frame.envelope,
        forces_n: video_frame.contacts.iter().map(|contact| contact.force_n).collect(),
        blocks: if with_blocks { video_frame.blocks.clone() } else { Vec::new() },
    };
    if let Ok(text) = serde_json::to_string(&frame) {
        rows.at(paths::FRAME, time, &TextLog::new(text));
    }
}
