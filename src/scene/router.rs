//! Sorts what comes to the upgrades it belongs to: opens, feeds and ends their files.
//!
//! A fault of one file is reported once and ends that file; the others go on.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::compact::{self, StartFindings};
use super::config::shown;
use super::drawing::RecordingHead;
use super::limits::{OPEN_MAX, RING_MAX, RING_MS};
use super::writer::{Open, RecordingPlace, Writer};
use super::{read, words};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::words::Word;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::film::Film;
use holdpoint_protocol::picture::{Picture, Scenery};
use holdpoint_protocol::sink::{Closed, Report};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_recordings::folder::file_stem;
use holdpoint_recordings::recording::About;
use holdpoint_text::{Hint, Problem, Untrusted};

/// What a recording begins with.
#[derive(Debug, Default)]
struct Known {
    profile: Word<ProfileName>,
    robot: String,
    seed: u64,
    scenery: Scenery,
    digests: BTreeMap<CapabilityId, Digest>,
    active: BTreeMap<Family, CapabilityId>,
}

pub struct Router {
    folder: PathBuf,
    /// Names of files that are never touched again.
    closed: BTreeSet<String>,
    wall_clock: bool,
    open: Box<Open>,
    known: Known,
    writers: BTreeMap<CapabilityId, Writer>,
    /// Versions whose recording failed: nothing more is written of them until their upgrade ends.
    failed: BTreeSet<CapabilityId>,
    ring: VecDeque<Arc<Picture>>,
    reports: Vec<Report>,
}

impl Router {
    /// A router over a folder, which exists.
    #[must_use]
    pub fn new(folder: PathBuf, closed: BTreeSet<String>, wall_clock: bool, open: Box<Open>) -> Self {
        Self {
            folder,
            closed,
            wall_clock,
            open,
            known: Known::default(),
            writers: BTreeMap::new(),
            failed: BTreeSet::new(),
            ring: VecDeque::new(),
            reports: Vec::new(),
        }
    }

    /// Mends what an earlier life left behind, and tells of files that were ended and not put on record.
    pub fn recover(&mut self) {
        for (name, path) in recordings(&self.folder) {
            if self.closed.contains(&name) {
                continue;
            }
            let (stem, _) = segment_of(&name);
            match compact::mend(stem, &path, (0, 0)) {
                Ok(StartFindings::Open) => {}
                Ok(StartFindings::Ended(ended, outcome)) => {
                    let Ok(recording) = read(&path) else { continue };
                    self.closed.insert(name.clone());
                    self.reports.push(Report::Closed(Closed {
                        version: recording.about.version,
                        outcome,
                        file: name,
                        digest: ended.digest,
                        bytes: ended.bytes,
                        pictures: ended.pictures,
                        dropped: recording.dropped,
                    }));
                }
                Err(error) => self.reports.push(Report::Failed { version: None, text: error.to_string() }),
            }
        }
    }

    /// A moment of the live cell.
    pub fn picture(&mut self, picture: Arc<Picture>) {
        let taking: Vec<CapabilityId> = self
            .writers
            .iter()
            .filter(|(_, writer)| writer.takes_pictures())
            .map(|(id, _)| id.clone())
            .collect();
        for version in taking {
            self.with(&version, |writer| writer.picture(&picture));
        }
        let oldest_ms = picture.at_ms.saturating_sub(RING_MS);
        self.ring.push_back(picture);
        while self.ring.len() > RING_MAX || self.ring.front().is_some_and(|first| first.at_ms < oldest_ms) {
            self.ring.pop_front();
        }
    }

    /// A piece of a version's evaluation, worked again.
    pub fn film(&mut self, version: &CapabilityId, film: &Film) {
        self.with(version, |writer| writer.film(film));
    }

    /// Things that happened, and how they stood afterwards.
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
        if let Some(version) = words::version_of(&event.kind).cloned() {
            if let EventKind::Registered { digest, .. } = &event.kind {
                self.known.digests.insert(version.clone(), *digest);
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

    /// Begins a recording, unless too many are open or nothing is known of the version.
    fn begin(&mut self, version: &CapabilityId, at_ms: u64) {
        let Some(digest) = self.known.digests.get(version).copied() else { return };
        if self.writers.len() >= OPEN_MAX {
            let text = format!("{OPEN_MAX} recordings are open, which is as many as can be");
            self.fail(version, Problem::new(text).with_hint("end an upgrade"));
            return;
        }
        let head = self.known.head(version, digest);
        let place = self.place(&file_stem(version, &digest));
        match Writer::begin(head, place, self.wall_clock, at_ms, &self.open) {
            Ok(writer) => {
                self.writers.insert(version.clone(), writer);
            }
            Err(error) => self.fail(version, cannot_write(&error)),
        }
    }

    /// The next segment's place, after those that are there.
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

    /// Pictures came before the event that makes them part of a recording.
    fn recall(&mut self, event: &Event) {
        let Some(version) = words::version_of(&event.kind).cloned() else { return };
        let Some(writer) = self.writers.get(&version) else { return };
        let of_twin =
            |picture: &Arc<Picture>| picture.twin.as_ref().is_some_and(|twin| twin.version == version);
        let pictures: Vec<Arc<Picture>> = match &event.kind {
            EventKind::StageStarted { stage: Stage::Shadow, .. } => {
                self.ring.iter().filter(|picture| of_twin(picture)).cloned().collect()
            }
            EventKind::Monitor { .. } | EventKind::Rung { .. } | EventKind::RolledBack { .. }
                if !writer.takes_pictures() =>
            {
                self.ring.iter().cloned().collect()
            }
            _ => return,
        };
        self.with(&version, |writer| writer.earlier(pictures));
    }

    fn close(&mut self, version: &CapabilityId, outcome: UpgradeEnd, dropped: (u64, u64)) {
        self.failed.remove(version);
        let Some(writer) = self.writers.remove(version) else { return };
        match writer.end(Some(outcome), dropped) {
            Ok(Some(closed)) => {
                self.closed.insert(closed.file.clone());
                self.reports.push(Report::Closed(closed));
            }
            Ok(None) => {}
            Err(error) => {
                let text = error.to_string();
                self.reports.push(Report::Failed { version: Some(version.clone()), text });
            }
        }
    }

    pub fn flush(&mut self) {
        let ids: Vec<CapabilityId> = self.writers.keys().cloned().collect();
        for version in ids {
            self.with(&version, Writer::flush);
        }
    }

    /// Ends every file in good order; their upgrades go on in the next life.
    pub fn end(&mut self, dropped: (u64, u64)) {
        for (version, writer) in std::mem::take(&mut self.writers) {
            if let Err(error) = writer.end(None, dropped) {
                self.reports.push(Report::Failed { version: Some(version), text: error.to_string() });
            }
        }
    }

    /// What there is to tell since the last time.
    pub fn reports(&mut self) -> Vec<Report> {
        std::mem::take(&mut self.reports)
    }

    fn with(&mut self, version: &CapabilityId, act: impl FnOnce(&mut Writer) -> std::io::Result<()>) {
        let Some(writer) = self.writers.get_mut(version) else { return };
        if let Err(error) = act(writer) {
            self.writers.remove(version);
            self.fail(version, cannot_write(&error));
        }
    }

    fn fail(&mut self, version: &CapabilityId, problem: Problem) {
        self.failed.insert(version.clone());
        self.reports.push(Report::Failed { version: Some(version.clone()), text: problem.sentence() });
    }
}

fn cannot_write(error: &std::io::Error) -> Problem {
    let why = Untrusted::new(error.to_string()).line().into_string();
    Problem::new(format!("the recording cannot be written: \"{why}\"")).with_hint("make room on the disk")
}

impl Known {
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

    /// Who is active after an event.
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
        let about = About {
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

/// Whether a version's recording begins with an event. A version that was made from none, as those that the cell was
/// commissioned with, has one only once it is judged.
const fn begins(kind: &EventKind) -> bool {
    matches!(
        kind,
        EventKind::Registered { parent: Some(_), .. }
            | EventKind::StageStarted { .. }
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
    // The digest's eight digits end the stem: what is short and a number is a segment.
    match numbered {
        Some((of, number)) if number >= 2 && of.rsplit_once('-').is_some_and(|(_, end)| end.len() == 8) => {
            (of, number)
        }
        _ => (stem, 1),
    }
}

/// A folder, for a message.
#[must_use]
pub fn folder_shown(folder: &Path) -> String {
    shown(folder)
}

#[cfg(test)]
mod tests;
