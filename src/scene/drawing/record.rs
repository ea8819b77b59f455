//! What reading back needs beyond what a viewer draws, as JSON text in entities of its own.

use serde::{Deserialize, Serialize};

use re_sdk_types::archetypes::TextLog;

use crate::rows::{Moment, Rows};
use holdpoint_body::TaskKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::words::Word;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::picture::{Block, EnvelopePicture, Picture, Scenery};
use holdpoint_recordings::recording::{About, FilmSpan};

/// Where it is kept.
pub mod paths {
    /// One text: a [`super::RecordingHead`].
    pub const HEAD: &str = "record/head";
    /// One text: a [`super::Tail`], in ended files.
    pub const TAIL: &str = "record/tail";
    /// A text for each picture: a [`super::PictureFacts`].
    pub const FRAME: &str = "record/frame";
    /// A text for each event.
    pub const EVENT: &str = "record/event";
    /// A text for each piece of an evaluation that was worked again: a [`FilmSpan`](super::FilmSpan).
    pub const FILM: &str = "record/film";
}

/// What is known when a recording begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingHead {
    pub about: About,
    /// What does not move.
    pub scenery: Scenery,
}

/// What is known when it ends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tail {
    /// How the upgrade ended; absent if only the program did.
    pub outcome: Option<Word<UpgradeEnd>>,
    /// Pictures and events that were dropped before they came here.
    pub dropped: (u64, u64),
}

/// What a picture holds beside its geometry. Short names: there is one for each picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PictureFacts {
    /// The picture's [`Picture::sequence`].
    #[serde(rename = "s")]
    pub sequence: u64,
    /// The picture's [`Picture::at_ms`].
    #[serde(rename = "t")]
    pub at_ms: u64,
    /// The picture's [`Picture::at_secs`].
    #[serde(rename = "w")]
    pub at_secs: f64,
    /// The picture's [`Picture::task`].
    #[serde(rename = "k", default, skip_serializing_if = "Option::is_none")]
    pub task: Option<TaskKind>,
    /// The picture's [`Picture::version`].
    #[serde(rename = "v", default, skip_serializing_if = "Option::is_none")]
    pub version: Option<CapabilityId>,
    #[serde(rename = "n", default, skip_serializing_if = "Option::is_none")]
    pub twin: Option<CapabilityId>,
    /// Held, held by the twin, unexpected contact, stopped.
    #[serde(rename = "x")]
    pub flags: [bool; 4],
    /// Half the object's edge, m: the live world's and the twin's.
    #[serde(rename = "h")]
    pub half_m: [f32; 2],
    /// Speed, force at the pads, force on the surroundings.
    #[serde(rename = "f")]
    pub tool: [f32; 3],
    /// The picture's [`Picture::envelope`].
    #[serde(rename = "e", default, skip_serializing_if = "Option::is_none")]
    pub envelope: Option<EnvelopePicture>,
    /// The contacts' forces, which arrows show scaled.
    #[serde(rename = "c", default, skip_serializing_if = "Vec::is_empty")]
    pub forces_n: Vec<[f32; 3]>,
    /// [`Picture::blocks`], said once in a sequence.
    #[serde(rename = "b", default, skip_serializing_if = "Vec::is_empty")]
    pub blocks: Vec<Block>,
}

pub fn head(rows: &mut Rows, head: &RecordingHead) {
    always(rows, paths::HEAD, head);
}

pub fn tail(rows: &mut Rows, tail: &Tail) {
    always(rows, paths::TAIL, tail);
}

fn always<T: Serialize>(rows: &mut Rows, path: &str, value: &T) {
    if let Ok(text) = serde_json::to_string(value) {
        rows.always(path, &TextLog::new(text));
    }
}

pub(super) fn event(rows: &mut Rows, event: &Event, moment: &Moment) {
    if let Ok(text) = serde_json::to_string(event) {
        rows.at(paths::EVENT, moment, &TextLog::new(text));
    }
}

pub(super) fn film(rows: &mut Rows, seen: &FilmSpan, moment: &Moment) {
    if let Ok(text) = serde_json::to_string(seen) {
        rows.at(paths::FILM, moment, &TextLog::new(text));
    }
}

/// Writes what a picture holds beside its geometry.
pub(super) fn frame(rows: &mut Rows, picture: &Picture, moment: &Moment, says_blocks: bool) {
    let twin = picture.twin.as_ref();
    let frame = PictureFacts {
        sequence: picture.sequence,
        at_ms: picture.at_ms,
        at_secs: picture.at_secs,
        task: picture.task,
        version: picture.version.clone(),
        twin: twin.map(|twin| twin.version.clone()),
        flags: [
            picture.body.held,
            twin.is_some_and(|twin| twin.body.held),
            picture.unexpected_contact,
            picture.stopped,
        ],
        half_m: [picture.body.object_half_m, twin.map_or(0.0, |twin| twin.body.object_half_m)],
        tool: [picture.speed_m_s, picture.force_n, picture.contact_n],
        envelope: picture.envelope,
        forces_n: picture.contacts.iter().map(|contact| contact.force_n).collect(),
        blocks: if says_blocks { picture.blocks.clone() } else { Vec::new() },
    };
    if let Ok(text) = serde_json::to_string(&frame) {
        rows.at(paths::FRAME, moment, &TextLog::new(text));
    }
}
