//! Turns what the engine tells into rows: one drawing per upgrade, and one for the live viewer.
//!
//! Owns which entity shows what. It reads events, snapshots and pictures and writes rows; it decides nothing about
//! files. Entities: `world/..` is the scene, `plots/..` are charts, `phase`, `log/..` and `upgrade` say how far the
//! upgrade is, and `record/..` is what reading back needs and a viewer need not show.

mod plots;
mod record;
mod scenery;
mod style;
mod tell;
pub mod theme;
mod world;

use std::collections::BTreeMap;

pub use record::{PictureFacts, RecordingHead, Tail, head, paths, tail};

use super::rows::{Ids, Moment, Rows};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::film::{FilmFrame, FilmMark};
use holdpoint_protocol::picture::{Picture, Point, Scenery};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_recordings::recording::FilmSpan;

/// A drawing: rows that wait, and what has to be remembered between two of them.
#[derive(Debug)]
pub struct Drawing {
    rows: Rows,
    /// Whose charts are drawn; absent until the live viewer's drawing knows.
    version: Option<CapabilityId>,
    since_ms: Option<u64>,
    sequence: u64,
    wall_clock: bool,
    path_every_ms: u64,
    trails: [Trail; 2],
    twin_shown: bool,
    /// The sequence whose blocks are drawn.
    standing: Option<u64>,
    /// Limits by path: when they were last said, ms, and what.
    limits: BTreeMap<String, (u64, f64)>,
    /// Points of the shadow series that are drawn.
    shadow_drawn: usize,
    /// Pairs that are drawn.
    pairs_drawn: u64,
    /// Episodes of the monitor that are drawn.
    monitored: u32,
    /// What is drawn of the upgrade's document.
    upgrade: tell::UpgradeFacts,
}

/// The way of one tool in the running sequence.
#[derive(Debug, Default)]
struct Trail {
    sequence: u64,
    points: Vec<Point>,
    said_ms: Option<u64>,
}

impl Drawing {
    /// An empty one. The paths of the tools are renewed every `path_every_ms`.
    #[must_use]
    pub fn new(ids: Ids, version: Option<CapabilityId>, wall_clock: bool, path_every_ms: u64) -> Self {
        Self {
            rows: Rows::new(ids),
            version,
            since_ms: None,
            sequence: 0,
            wall_clock,
            path_every_ms,
            trails: [Trail::default(), Trail::default()],
            twin_shown: false,
            standing: None,
            limits: BTreeMap::new(),
            shadow_drawn: 0,
            pairs_drawn: 0,
            monitored: 0,
            upgrade: tell::UpgradeFacts::default(),
        }
    }

    /// What holds always: the scene that does not move, and how everything is drawn.
    pub fn begin(&mut self, scenery: &Scenery) {
        scenery::draw(&mut self.rows, scenery);
        style::draw(&mut self.rows);
    }

    /// A moment of the live cell.
    pub fn picture(&mut self, picture: &Picture) {
        self.sequence = picture.sequence;
        let moment = self.moment(picture.at_ms, picture.sequence);
        let says_blocks = self.standing != Some(picture.sequence);
        self.draw_world(picture, &moment);
        self.draw_tool(picture, &moment);
        record::frame(&mut self.rows, picture, &moment, says_blocks);
        self.standing = Some(picture.sequence);
    }

    /// A piece of an evaluation begins, which is drawn as a sequence of this number.
    pub fn film(&mut self, seen: &FilmSpan, sequence: u64) {
        self.sequence = sequence;
        let moment = self.moment(seen.from_ms, sequence);
        self.tell_film(seen, &moment);
        record::film(&mut self.rows, seen, &moment);
    }

    /// A moment of one version in a piece of an evaluation, as columns.
    pub fn columns(&mut self, who: &str, frame: &FilmFrame, at_ms: u64) {
        let moment = self.moment(at_ms, self.sequence);
        self.draw_columns(who, frame, &moment);
    }

    /// Something that happened to one version in a piece of an evaluation.
    pub fn mark(&mut self, who: &str, mark: &FilmMark, at_ms: u64) {
        let moment = self.moment(at_ms, self.sequence);
        self.tell_mark(who, mark, &moment);
    }

    pub fn event(&mut self, event: &Event) {
        let moment = self.moment(event.at_ms, self.sequence);
        self.draw_event(event, &moment);
        self.tell(event, &moment);
        record::event(&mut self.rows, event, &moment);
    }

    /// How things stand: what of it is new.
    pub fn snapshot(&mut self, snapshot: &Snapshot) {
        let moment = self.moment(snapshot.at_ms, self.sequence);
        self.draw_snapshot(snapshot, &moment);
    }

    /// Draws another version's charts from now on.
    pub fn turn_to(&mut self, version: &CapabilityId) {
        if self.version.as_ref() != Some(version) {
            self.version = Some(version.clone());
            self.shadow_drawn = 0;
            self.pairs_drawn = 0;
            self.monitored = 0;
            self.upgrade = tell::UpgradeFacts::default();
        }
    }

    /// The rows that wait.
    pub const fn rows(&mut self) -> &mut Rows {
        &mut self.rows
    }

    fn moment(&mut self, at_ms: u64, sequence: u64) -> Moment {
        let since_ms = *self.since_ms.get_or_insert(at_ms);
        let wall = self.wall_clock.then(wall_nanos);
        Moment::new(at_ms, since_ms, sequence, wall)
    }
}

/// The machine's time, ns since 1970.
fn wall_nanos() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

/// A foreign name as one part of an entity's path: small letters, digits, `-` and `_`.
fn part(name: &str) -> String {
    let kept: String = name
        .chars()
        .take(48)
        .map(|letter| if letter.is_ascii_alphanumeric() || letter == '-' { letter } else { '_' })
        .collect();
    if kept.is_empty() { "_".to_owned() } else { kept }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_foreign_name_is_one_part_of_a_path() {
        for (name, part) in [("fixture wall", "fixture_wall"), ("a/b\u{1b}[", "a_b__"), ("", "_")] {
            assert_eq!(super::part(name), part);
        }
    }
}
