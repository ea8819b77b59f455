//! Assigns items to upgrades: opens, feeds and completes their files.
//!
//! A fault of one file is reported once and ends that file; the others continue.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::compact::{self, FileAtStart};
use super::config::display_path;
use super::drawing::RecordingHead;
use super::limits::{OPEN_MAX, RING_MAX, RING_MS};
use super::reader;
use super::writer::{OpenFile, RecordingPlace, RecordingWriter};
use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::film::Film;
use holdpoint_protocol::sink::{ClosedRecording, SinkReport};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::{Scenery, VideoFrame};
use holdpoint_recordings::recording::RecordingSubject;
use holdpoint_recordings::recording_folder::file_stem;
use holdpoint_text::{Hint, Problem, Untrusted};

/// The first data of a recording.
#[derive(Debug, Default)]
struct RecordingPreamble {
    profile: Lenient<ProfileName>,
    robot: String,
    seed: Option<u64>,
    scenery: Scenery,
    digests: BTreeMap<CapabilityId, Digest>,
    /// The registrations of versions in the queue: their recordings begin with them.
    registered: BTreeMap<CapabilityId, Event>,
    active: BTreeMap<Family, CapabilityId>,
}

pub struct Router {
    folder: PathBuf,
    /// Names of files that are never modified again.
    closed: BTreeSet<String>,
    wall_clock: bool,
    open: Box<OpenFile>,
    known: RecordingPreamble,
    writers: BTreeMap<CapabilityId, RecordingWriter>,
    /// Versions whose recording failed: no more is written of them until their upgrade ends.
    failed: BTreeSet<CapabilityId>,
    ring: VecDeque<Arc<VideoFrame>>,
    reports: Vec<SinkReport>,
}

impl Router {
    /// A router over an existing folder.
    #[must_use]
    pub fn new(folder: PathBuf, closed: BTreeSet<String>, wall_clock: bool, open: Box<OpenFile>) -> Self {
        Self {
            folder,
            closed,
            wall_clock,
            open,
            known: RecordingPreamble::default(),
            writers: BTreeMap::new(),
            failed: BTreeSet::new(),
            ring: VecDeque::new(),
            reports: Vec::new(),
        }
    }

    /// Repairs the files of an earlier session, and reports completed files that are not on record.
    pub fn recover(&mut self) {
        for (name, path) in recordings(&self.folder) {
            if self.closed.contains(&name) {
                continue;
            }
            let (stem, _) = segment_of(&name);
            match compact::mend(stem, &path, (0, 0)) {
                Ok(FileAtStart::Open) => {}
                Ok(FileAtStart::Ended(ended, outcome)) => {
                    let Ok(recording) = reader::read(&path) else { continue };
                    self.closed.insert(name.clone());
                    self.reports.push(SinkReport::Closed(ClosedRecording {
                        version: recording.about.version,
                        outcome,
                        file: name,
                        digest: ended.digest,
                        bytes: ended.bytes,
                        frames: ended.frames,
                        dropped: recording.dropped,
                    }));
                }
                Err(error) => {
                    self.reports.push(SinkReport::Failed { version: None, text: error.to_string() });
                }
            }
        }
    }

    /// A frame of the live cell.
    pub fn video_frame(&mut self, frame: Arc<VideoFrame>) {
        let taking: Vec<CapabilityId> = self
            .writers
            .iter()
            .filter(|(_, writer)| writer.takes_frames())
            .map(|(id, _)| id.clone())
            .collect();
        for version in taking {
            self.with(&version, |writer| writer.video_frame(&frame));
        }
        let oldest_ms = frame.at_ms.saturating_sub(RING_MS);
        self.ring.push_back(frame);
        while self.ring.len() > RING_MAX || self.ring.front().is_some_and(|first| first.at_ms < oldest_ms) {
            self.ring.pop_front();
        }
    }

    /// A re-run part of a version's evaluation.
    pub fn film(&mut self, version: &CapabilityId, film: &Film) {
        self.with(version, |writer| writer.film(film));
    }

    /// Events, and the snapshot after them.
    pub fn events(&mut self, events: &[Event], snapshot: Option<&Snapshot>, dropped: (u64, u64)) {
        if let Some(snapshot) = snapshot {
            self.known.learn(snapshot);
        }
        for event in events {
            self.event(event, dropped);
        }
        if let Some(snapshot) = snapshot {
            let ids: Vec<CapabilityId> = self.writers.keys().cloned().collect();
            for version in ids {
                self.with(&version, |writer| writer.snapshot(snapshot));
            }
        }
    }

    fn event(&mut self, event: &Event, dropped: (u64, u64)) {
        if let Some(version) = event.kind.version().cloned() {
            if let EventKind::Registered { digest, parent, .. } = &event.kind {
                self.known.digests.insert(version.clone(), *digest);
                if parent.is_some() {
                    self.known.registered.insert(version.clone(), event.clone());
                }
            }
            if begins(&event.kind) && !self.writers.contains_key(&version) && !self.failed.contains(&version)
            {
                self.begin(&version, event.at_ms);
            }
        }
        self.recall(event);
        let ids: Vec<CapabilityId> = self.writers.keys().cloned().collect();
        for version in ids {
            self.with(&version, |writer| writer.event(event));
        }
        self.known.follow(&event.kind);
        if let EventKind::AuditClosed { version, outcome, .. } = &event.kind {
            self.close(version, *outcome, dropped);
        }
    }

    /// Begins a recording, unless too many are open or the version is unknown.
    fn begin(&mut self, version: &CapabilityId, at_ms: u64) {
        let Some(digest) = self.known.digests.get(version).copied() else { return };
        if self.writers.len() >= OPEN_MAX {
            let text = format!("{OPEN_MAX} recordings are open, which is as many as can be");
            self.fail(version, Problem::new(text).with_hint("end an upgrade"));
            return;
        }
        let head = self.known.head(version, digest);
        let place = self.place(&file_stem(version, &digest));
        let registered = self.known.registered.remove(version);
        let at_ms = registered.as_ref().map_or(at_ms, |event| event.at_ms);
        match RecordingWriter::begin(head, place, self.wall_clock, at_ms, &self.open) {
            Ok(writer) => {
                self.writers.insert(version.clone(), writer);
                if let Some(event) = registered {
                    self.with(version, |writer| writer.event(&event));
                }
            }
            Err(error) => self.fail(version, cannot_write(&error)),
        }
    }

    /// The path of the next segment.
    fn place(&self, stem: &str) -> RecordingPlace {
        let mut segments = Vec::new();
        let mut last = 0;
        for (name, path) in recordings(&self.folder) {
            let (of, number) = segment_of(&name);
            if of == stem {
                last = last.max(number);
                if !self.closed.contains(&name) {
                    segments.push((number, path));
                }
            }
        }
        segments.sort();
        let segment = last.saturating_add(1);
        let name = if segment == 1 { format!("{stem}.rrd") } else { format!("{stem}.{segment}.rrd") };
        segments.push((segment, self.folder.join(name)));
        RecordingPlace {
            stem: stem.to_owned(),
            segments: segments.into_iter().map(|(_, path)| path).collect(),
            segment,
        }
    }

    /// Frames came before the event that makes them part of a recording.
    fn recall(&mut self, event: &Event) {
        let Some(version) = event.kind.version().cloned() else { return };
        let Some(writer) = self.writers.get(&version) else { return };
        let of_twin =
            |frame: &Arc<VideoFrame>| frame.twin.as_ref().is_some_and(|twin| twin.version == version);
        let frames: Vec<Arc<VideoFrame>> = match &event.kind {
            EventKind::StageStarted { stage: Stage::Shadow, .. } => {
                self.ring.iter().filter(|frame| of_twin(frame)).cloned().collect()
            }
            EventKind::Monitor { .. } | EventKind::Rung { .. } | EventKind::RolledBack { .. }
                if !writer.takes_frames() =>
            {
                self.ring.iter().cloned().collect()
            }
            _ => return,
        };
        self.with(&version, |writer| writer.earlier(frames));
    }

    fn close(&mut self, version: &CapabilityId, outcome: UpgradeEnd, dropped: (u64, u64)) {
        self.failed.remove(version);
        self.known.registered.remove(version);
        let Some(writer) = self.writers.remove(version) else { return };
        match writer.end(Some(outcome), dropped) {
            Ok(Some(closed)) => {
                self.closed.insert(closed.file.clone());
                self.reports.push(SinkReport::Closed(closed));
            }
            Ok(None) => {}
            Err(error) => {
                let text = error.to_string();
                self.reports.push(SinkReport::Failed { version: Some(version.clone()), text });
            }
        }
    }

    pub fn flush(&mut self) {
        let ids: Vec<CapabilityId> = self.writers.keys().cloned().collect();
        for version in ids {
            self.with(&version, RecordingWriter::flush);
        }
    }

    /// Completes every file; their upgrades continue in the next session.
    pub fn end(&mut self, dropped: (u64, u64)) {
        for (version, writer) in std::mem::take(&mut self.writers) {
            if let Err(error) = writer.end(None, dropped) {
                self.reports.push(SinkReport::Failed { version: Some(version), text: error.to_string() });
            }
        }
    }

    /// The reports since the last call.
    pub fn reports(&mut self) -> Vec<SinkReport> {
        std::mem::take(&mut self.reports)
    }

    fn with(
        &mut self,
        version: &CapabilityId,
        act: impl FnOnce(&mut RecordingWriter) -> std::io::Result<()>,
    ) {
        let Some(writer) = self.writers.get_mut(version) else { return };
        if let Err(error) = act(writer) {
            self.writers.remove(version);
            self.fail(version, cannot_write(&error));
        }
    }

    fn fail(&mut self, version: &CapabilityId, problem: Problem) {
        self.failed.insert(version.clone());
        self.reports.push(SinkReport::Failed { version: Some(version.clone()), text: problem.sentence() });
    }
}

fn cannot_write(error: &std::io::Error) -> Problem {
    let why = Untrusted::new(error.to_string()).line().into_string();
    Problem::new(format!("the recording cannot be written: \"{why}\"")).with_hint("make room on the disk")
}

impl RecordingPreamble {
    fn learn(&mut self, snapshot: &Snapshot) {
        self.profile = snapshot.profile.into();
        self.robot.clone_from(&snapshot.robot);
        self.seed = snapshot.seed;
        self.scenery.clone_from(&snapshot.scenery);
        for view in &snapshot.candidates {
            self.digests.insert(view.version.clone(), view.digest);
        }
        if self.active.is_empty() {
            let active = snapshot.families.iter().filter_map(|view| view.active.clone());
            self.active.extend(active.map(|version| (version.family.clone(), version)));
        }
    }

    /// The active version after an event.
    fn follow(&mut self, kind: &EventKind) {
        match kind {
            EventKind::EngineStarted { active, .. } => {
                self.active =
                    active.iter().map(|version| (version.family.clone(), version.clone())).collect();
            }
            EventKind::Activated { version, .. } => {
                self.active.insert(version.family.clone(), version.clone());
            }
            EventKind::RolledBack { version, restored, .. } => {
                self.active.remove(&version.family);
                if let Some(restored) = restored {
                    self.active.insert(restored.family.clone(), restored.clone());
                }
            }
            _ => {}
        }
    }

    fn head(&self, version: &CapabilityId, digest: Digest) -> RecordingHead {
        let about = RecordingSubject {
            version: version.clone(),
            digest,
            predecessor: self.active.get(&version.family).filter(|active| *active != version).cloned(),
            profile: self.profile.clone(),
            robot: self.robot.clone(),
            seed: self.seed,
            engine_build: format!("holdpoint {}", env!("CARGO_PKG_VERSION")),
        };
        RecordingHead { about, scenery: self.scenery.clone() }
    }
}

/// Whether a version's recording is opened by an event. A queued version has none: it would take the place of one that
/// is evaluated.
const fn begins(kind: &EventKind) -> bool {
    matches!(
        kind,
        EventKind::StageStarted { .. }
            | EventKind::Decided { .. }
            | EventKind::Monitor { .. }
            | EventKind::Rung { .. }
            | EventKind::RolledBack { .. }
    )
}

/// The recordings in a folder, by name.
fn recordings(folder: &Path) -> Vec<(String, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut names: Vec<(String, PathBuf)> = entries
        .filter_map(|entry| {
            let entry = entry.ok()?;
            let name = entry.file_name().into_string().ok()?;
            (name.ends_with(".rrd") && entry.file_type().ok()?.is_file()).then(|| (name, entry.path()))
        })
        .collect();
    names.sort();
    names
}

/// A file's recording and the number of its segment.
fn segment_of(name: &str) -> (&str, u32) {
    let stem = name.strip_suffix(".rrd").unwrap_or(name);
    let numbered = stem.rsplit_once('.').and_then(|(stem, number)| Some((stem, number.parse().ok()?)));
    // The digest's eight digits end the stem: a short number is a segment.
    match numbered {
        Some((of, number)) if number >= 2 && of.rsplit_once('-').is_some_and(|(_, end)| end.len() == 8) => {
            (of, number)
        }
        _ => (stem, 1),
    }
}

/// A folder, for a message.
#[must_use]
pub fn display_folder(folder: &Path) -> String {
    display_path(folder)
}

#[cfg(test)]
mod tests;
