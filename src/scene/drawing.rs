//! Turns events and snapshots of the engine into rows: one drawing per upgrade, and one for the live viewer.
//!
//! Owns which entity shows what. It reads events, snapshots and video frames and writes rows; it decides nothing about
//! files. Entities: `world/..` is the scene, `plots/..` are charts, `phase`, `log/..` and `upgrade` give the progress
//! of the upgrade, and `record/..` is data that only reading back needs.

mod log_text;
mod plots;
mod readback;
mod scenery;
mod style;
pub mod theme;
mod world;

use std::collections::BTreeMap;

pub use readback::{FrameFacts, RecordingHead, RecordingTail, head, paths, tail};

use super::rows::{PendingRows, RowIds, RowTime};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::film::{FilmFrame, FilmMark};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::{Scenery, VideoFrame, WorldPoint};
use holdpoint_recordings::recording::FilmSpan;

/// A drawing: pending rows, and the state that it keeps between them.
#[derive(Debug)]
pub struct Drawing {
    rows: PendingRows,
    /// The version whose charts are drawn; absent until the live viewer's drawing knows.
    version: Option<CapabilityId>,
    since_ms: Option<u64>,
    sequence: u64,
    wall_clock: bool,
    path_every_ms: u64,
    trails: [Trail; 2],
    twin_shown: bool,
    /// The sequence whose blocks are drawn.
    blocks_sequence: Option<u64>,
    /// Limits by path: when they were last written, ms, and their values.
    limits: BTreeMap<String, (u64, f64)>,
    /// Points of the shadow series that are drawn.
    shadow_drawn: usize,
    /// Pairs that are drawn.
    pairs_drawn: u64,
    /// Episodes of the monitor that are drawn.
    monitored: u32,
    /// The drawn part of the upgrade's document.
    upgrade: log_text::UpgradeFacts,
}

/// The path of one tool in the running sequence.
#[derive(Debug, Default)]
struct Trail {
    sequence: u64,
    points: Vec<WorldPoint>,
    drawn_ms: Option<u64>,
}

impl Drawing {
    /// An empty drawing. The paths of the tools are renewed every `path_every_ms`.
    #[must_use]
    pub fn new(ids: RowIds, version: Option<CapabilityId>, wall_clock: bool, path_every_ms: u64) -> Self {
        Self {
            rows: PendingRows::new(ids),
            version,
            since_ms: None,
            sequence: 0,
            wall_clock,
            path_every_ms,
            trails: [Trail::default(), Trail::default()],
            twin_shown: false,
            blocks_sequence: None,
            limits: BTreeMap::new(),
            shadow_drawn: 0,
            pairs_drawn: 0,
            monitored: 0,
            upgrade: log_text::UpgradeFacts::default(),
        }
    }

    /// Static data: the fixed scene and the style of everything drawn.
    pub fn begin(&mut self, scenery: &Scenery) {
        scenery::draw(&mut self.rows, scenery);
        style::draw(&mut self.rows);
    }

    /// A frame of the live cell.
    pub fn video_frame(&mut self, frame: &VideoFrame) {
        self.sequence = frame.sequence;
        let time = self.row_time(frame.at_ms, frame.sequence);
        let with_blocks = self.blocks_sequence != Some(frame.sequence);
        self.draw_world(frame, &time);
        self.draw_tool(frame, &time);
        readback::frame(&mut self.rows, frame, &time, with_blocks);
        self.blocks_sequence = Some(frame.sequence);
    }

    /// Begins a part of an evaluation, drawn as a sequence of this number.
    pub fn film(&mut self, span: &FilmSpan, sequence: u64) {
        self.sequence = sequence;
        let time = self.row_time(span.from_ms, sequence);
        self.log_film(span, &time);
        readback::film(&mut self.rows, span, &time);
    }

    /// A frame of one version in a part of an evaluation, as columns.
    pub fn columns(&mut self, who: &str, frame: &FilmFrame, at_ms: u64) {
        let time = self.row_time(at_ms, self.sequence);
        self.draw_columns(who, frame, &time);
    }

    /// An event of one version in a part of an evaluation.
    pub fn mark(&mut self, who: &str, mark: &FilmMark, at_ms: u64) {
        let time = self.row_time(at_ms, self.sequence);
        self.log_mark(who, mark, &time);
    }

    pub fn event(&mut self, event: &Event) {
        let time = self.row_time(event.at_ms, self.sequence);
        self.draw_event(event, &time);
        self.log_event(event, &time);
        readback::event(&mut self.rows, event, &time);
    }

    /// Draws the news of a snapshot.
    pub fn snapshot(&mut self, snapshot: &Snapshot) {
        let time = self.row_time(snapshot.at_ms, self.sequence);
        self.draw_snapshot(snapshot, &time);
    }

    /// Draws the charts of another version from now on.
    pub fn turn_to(&mut self, version: &CapabilityId) {
        if self.version.as_ref() != Some(version) {
            self.version = Some(version.clone());
            self.shadow_drawn = 0;
            self.pairs_drawn = 0;
            self.monitored = 0;
            self.upgrade = log_text::UpgradeFacts::default();
        }
    }

    /// The pending rows.
    pub const fn rows(&mut self) -> &mut PendingRows {
        &mut self.rows
    }

    fn row_time(&mut self, at_ms: u64, sequence: u64) -> RowTime {
        let since_ms = *self.since_ms.get_or_insert(at_ms);
        let wall = self.wall_clock.then(wall_nanos);
        RowTime::new(at_ms, since_ms, sequence, wall)
    }
}

/// Wall time, ns since 1970.
fn wall_nanos() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

/// A foreign name as one part of an entity's path: lowercase letters, digits, `-` and `_`.
fn part(name: &str) -> String {
    let cleaned: String = name
        .chars()
        .take(48)
        .map(|letter| if letter.is_ascii_alphanumeric() || letter == '-' { letter } else { '_' })
        .collect();
    if cleaned.is_empty() { "_".to_owned() } else { cleaned }
}

#[cfg(test)]
mod tests {
    #[test]
    fn foreign_name_becomes_one_path_part() {
        for (name, part) in [("fixture wall", "fixture_wall"), ("a/b\u{1b}[", "a_b__"), ("", "_")] {
            assert_eq!(super::part(name), part);
        }
    }
}
