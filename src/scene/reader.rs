//! Turns a file back into plain values, also one without an end and a torn one.
//!
//! Adds nothing: the recording has only what the file has.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::Path;

use rerun::archetypes::{Arrows3D, Boxes3D, Points3D, Scalars, TextLog};
use rerun::components::{Position3D, Scalar, Text};
use rerun::external::re_log_encoding::DecoderApp;
use rerun::log::{Chunk, LogMsg};
use rerun::{Component, ComponentDescriptor};

use super::ReadError;
use super::decoder_guard::guarded;
use super::drawing::{FrameFacts, RecordingHead, RecordingTail, paths};
use super::limits::{FILMS_MAX, READ_BYTES_MAX, TEXT_WIDTH_MAX};
use super::rows::TICK;
use super::size_check::credible_bytes;
use holdpoint_protocol::clock::TICKS_PER_SECOND;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::video_frame::{
    ArmView, CONTACTS_MAX, Contact, NO_TURN, Orientation, SceneBlock, Twin, VideoFrame, WorldPoint,
};
use holdpoint_recordings::recording::{FilmSpan, Recording, Series};

/// The content of a recording file, in the order of writing.
#[derive(Debug)]
pub struct RecordingContents {
    /// The chunks; those of the layout are left out.
    pub chunks: Vec<Chunk>,
    /// The final data; absent if a kill left the file without an end.
    pub tail: Option<RecordingTail>,
}

/// Everything readable in a file; a torn end is left out.
///
/// # Errors
/// If it cannot be opened, is too large or damaged, or is not a recording.
pub fn contents(path: &Path) -> Result<RecordingContents, ReadError> {
    guarded(path, || decode_chunks(path))
}

fn decode_chunks(path: &Path) -> Result<RecordingContents, ReadError> {
    let file = holdpoint_text::file::open(path).map_err(|source| ReadError::file(path, source))?;
    let mut bytes = Vec::new();
    file.take(READ_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(|source| ReadError::file(path, source))?;
    let length = bytes.len() as u64;
    if length > READ_BYTES_MAX {
        return Err(ReadError::foreign(path, format!("it has more than {READ_BYTES_MAX} bytes")));
    }
    // Data after a torn message cannot be trusted.
    bytes.truncate(credible_bytes(&bytes));
    let mut decoder = DecoderApp::new();
    decoder.push_byte_chunk(bytes);
    let mut chunks = Vec::new();
    let mut messages = 0_u64;
    loop {
        match decoder.try_read() {
            Ok(Some(message)) => {
                messages += 1;
                if let LogMsg::ArrowMsg(store, arrow) = message
                    && store.is_recording()
                    && let Ok(chunk) = Chunk::from_arrow_msg(&arrow)
                {
                    chunks.push(chunk);
                }
            }
            Ok(None) => break,
            Err(error) if messages == 0 => return Err(ReadError::foreign(path, error.to_string())),
            Err(_) => break,
        }
    }
    let tail = texts(&chunks, paths::TAIL).last().and_then(|text| serde_json::from_str(text).ok());
    Ok(RecordingContents { chunks, tail })
}

/// A file as plain values.
///
/// # Errors
/// If it cannot be read, is damaged, or is not a recording of an upgrade.
pub fn read(path: &Path) -> Result<Recording, ReadError> {
    guarded(path, || decode_recording(path))
}

fn decode_recording(path: &Path) -> Result<Recording, ReadError> {
    let RecordingContents { chunks, tail } = decode_chunks(path)?;
    let head = head(&chunks).ok_or_else(|| ReadError::foreign(path, "it does not say whose it is"))?;
    let mut events: Vec<Event> =
        texts(&chunks, paths::EVENT).iter().filter_map(|text| serde_json::from_str(text).ok()).collect();
    events.sort_by_key(|event| event.at_ms);
    Ok(Recording {
        about: head.about,
        scenery: head.scenery,
        pictures: video_frames(&chunks),
        events,
        series: series(&chunks),
        films: films(&chunks),
        dropped: tail.as_ref().map_or((0, 0), |tail| tail.dropped),
        outcome: tail.and_then(|tail| tail.outcome),
    })
}

/// The parts of an evaluation in it. No engine writes more of them than an evaluation has, or longer texts.
fn films(chunks: &[Chunk]) -> Vec<FilmSpan> {
    let texts = texts(chunks, paths::FILM);
    let within_limit = texts.iter().filter(|text| text.len() <= 8 * TEXT_WIDTH_MAX);
    within_limit.filter_map(|text| serde_json::from_str(text).ok()).take(FILMS_MAX).collect()
}

/// The data known when a recording began; with several segments, those of the first.
#[must_use]
pub fn head(chunks: &[Chunk]) -> Option<RecordingHead> {
    texts(chunks, paths::HEAD).first().and_then(|text| serde_json::from_str(text).ok())
}

/// The chunks of an entity.
fn chunks_of<'a>(chunks: &'a [Chunk], path: &str) -> impl Iterator<Item = &'a Chunk> {
    let path = rerun::EntityPath::parse_forgiving(path);
    chunks.iter().filter(move |chunk| *chunk.entity_path() == path)
}

/// The texts of an entity.
fn texts(chunks: &[Chunk], path: &str) -> Vec<String> {
    let component = TextLog::descriptor_text().component;
    let rows = chunks_of(chunks, path).flat_map(|chunk| {
        chunk
            .iter_component::<Text>(component)
            .filter_map(|row| row.first().map(|text| text.as_str().to_owned()))
            .collect::<Vec<_>>()
    });
    rows.collect()
}

/// A component of an entity by tick.
fn column<C: Component + Clone>(
    chunks: &[Chunk],
    path: &str,
    component: &ComponentDescriptor,
) -> BTreeMap<i64, Vec<C>> {
    let mut column = BTreeMap::new();
    for chunk in chunks_of(chunks, path).filter(|chunk| !chunk.is_static()) {
        let ticks = chunk.iter_component_indices(TICK.into(), component.component);
        let values = chunk.iter_component::<C>(component.component);
        column.extend(ticks.zip(values).map(|((tick, _), row)| (tick.as_i64(), row.as_slice().to_vec())));
    }
    column
}

struct Bodies {
    joints: BTreeMap<i64, Vec<WorldPoint>>,
    pads: BTreeMap<i64, Vec<WorldPoint>>,
    hands: BTreeMap<i64, Vec<Orientation>>,
    objects: BTreeMap<i64, Vec<WorldPoint>>,
    turns: BTreeMap<i64, Vec<Orientation>>,
}

impl Bodies {
    fn of(chunks: &[Chunk], root: &str) -> Self {
        use rerun::components::{RotationQuat, Translation3D};
        let points = |path: &str| {
            let rows = column::<Translation3D>(chunks, path, &Boxes3D::descriptor_centers());
            rows.into_iter()
                .map(|(tick, row)| (tick, row.into_iter().map(|point| point.0.0).collect()))
                .collect()
        };
        let turns = |path: &str| {
            let rows = column::<RotationQuat>(chunks, path, &Boxes3D::descriptor_quaternions());
            rows.into_iter()
                .map(|(tick, row)| (tick, row.into_iter().map(|turn| turn.0.0).collect()))
                .collect()
        };
        let joints =
            column::<Position3D>(chunks, &format!("{root}/arm/joints"), &Points3D::descriptor_positions());
        Self {
            joints: joints.into_iter().map(|(tick, row)| (tick, positions(row))).collect(),
            pads: points(&format!("{root}/gripper")),
            hands: turns(&format!("{root}/gripper")),
            objects: points(&format!("{root}/object")),
            turns: turns(&format!("{root}/object")),
        }
    }

    fn at(&self, tick: i64, held: bool, object_half_m: f32) -> Option<ArmView> {
        let first = |rows: &BTreeMap<i64, Vec<Orientation>>| {
            rows.get(&tick).and_then(|row| row.first()).copied().unwrap_or(NO_TURN)
        };
        Some(ArmView {
            links: self.joints.get(&tick)?.clone(),
            pads: <[WorldPoint; 2]>::try_from(self.pads.get(&tick)?.as_slice()).ok()?,
            hand: first(&self.hands),
            object: *self.objects.get(&tick)?.first()?,
            object_turn: first(&self.turns),
            object_half_m,
            held,
        })
    }
}

fn positions(row: Vec<Position3D>) -> Vec<WorldPoint> {
    row.into_iter().map(|position| position.0.0).collect()
}

fn video_frames(chunks: &[Chunk]) -> Vec<VideoFrame> {
    let live = Bodies::of(chunks, "world");
    let twin = Bodies::of(chunks, "world/twin");
    let contacts = column::<Position3D>(chunks, "world/contacts", &Arrows3D::descriptor_origins());
    let frames = column::<Text>(chunks, paths::FRAME, &TextLog::descriptor_text());
    let frames: Vec<(i64, FrameFacts)> = frames
        .into_iter()
        .filter_map(|(tick, row)| Some((tick, serde_json::from_str(row.first()?.as_str()).ok()?)))
        .collect();
    // Written once in a sequence, and valid for all of it.
    let with_blocks = frames.iter().filter(|(_, frame)| !frame.blocks.is_empty());
    let blocks: BTreeMap<u64, Vec<SceneBlock>> =
        with_blocks.map(|(_, frame)| (frame.sequence, frame.blocks.clone())).collect();
    let video_frames = frames.into_iter().filter_map(|(tick, mut frame)| {
        frame.blocks = blocks.get(&frame.sequence).cloned().unwrap_or_default();
        video_frame(tick, frame, &live, &twin, contacts.get(&tick).cloned().unwrap_or_default())
    });
    let mut video_frames: Vec<VideoFrame> = video_frames.collect();
    video_frames.sort_by_key(|frame| frame.at_ms);
    video_frames
}

fn video_frame(
    tick: i64,
    frame: FrameFacts,
    live: &Bodies,
    twin: &Bodies,
    contact_points: Vec<Position3D>,
) -> Option<VideoFrame> {
    let [held, twin_held, unexpected_contact, stopped] = frame.flags;
    let [half_m, twin_half_m] = frame.half_m;
    let [speed_m_s, force_n, contact_n] = frame.tool;
    let contacts = positions(contact_points).into_iter().zip(frame.forces_n);
    Some(VideoFrame {
        sequence: frame.sequence,
        at_ms: frame.at_ms,
        at_secs: frame.at_secs,
        task: frame.task,
        version: frame.version,
        body: live.at(tick, held, half_m)?,
        speed_m_s,
        force_n,
        contact_n,
        envelope: frame.envelope,
        blocks: frame.blocks,
        contacts: contacts.take(CONTACTS_MAX).map(|(at, force_n)| Contact { at, force_n }).collect(),
        unexpected_contact,
        stopped,
        twin: frame
            .twin
            .and_then(|version| Some(Twin { version, body: twin.at(tick, twin_held, twin_half_m)? })),
    })
}

fn series(chunks: &[Chunk]) -> Vec<Series> {
    let mut names: Vec<String> = chunks
        .iter()
        .filter(|chunk| !chunk.is_static())
        .filter_map(|chunk| chunk.entity_path().to_string().strip_prefix("/plots/").map(ToOwned::to_owned))
        .collect();
    names.sort();
    names.dedup();
    let series = names.into_iter().map(|name| {
        let rows = column::<Scalar>(chunks, &format!("plots/{name}"), &Scalars::descriptor_scalars());
        let points =
            rows.into_iter().filter_map(|(tick, row)| Some((ms_of(tick), row.first()?.0.0))).collect();
        Series { name, points }
    });
    series.filter(|series| !series.points.is_empty()).collect()
}

/// The first virtual time of a tick, ms.
fn ms_of(tick: i64) -> u64 {
    u64::try_from(tick).unwrap_or(0).saturating_mul(1_000).div_ceil(TICKS_PER_SECOND)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_of_a_tick_maps_back_to_the_tick() {
        for tick in [0_u64, 1, 7, 239, 240, 1_234_567] {
            assert_eq!(holdpoint_protocol::clock::tick_of(ms_of(i64::try_from(tick).unwrap())), tick);
        }
    }
}
