//! One upgrade's file: rows become chunks in it, and a fault of the disk ends this file alone.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::PathBuf;
use std::sync::Arc;

use rerun::AnyValues;
use rerun::components;
use rerun::{EntityPath, RecordingInfo, StoreId};

use super::compact;
use super::drawing::{self, Drawing, RecordingHead, RecordingTail};
use super::file::{FramedWriter, message, opening, store};
use super::frame_sampling::{EventWeight, FrameSampler};
use super::limits::{FILE_BYTES_MAX, FILM_GAP_MS, PATH_EVERY_MS};
use super::rows::RowIds;
use super::{ReadError, blueprint};
use holdpoint_governance::alarms::AlarmState;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::film::Film;
use holdpoint_protocol::sink::ClosedRecording;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_text::Untrusted;

/// How a file is made; tests make some that cannot be written.
pub type OpenFile = dyn Fn(&std::path::Path) -> io::Result<File> + Send;

/// The file an upgrade is recorded in.
#[derive(Clone, Debug)]
pub struct RecordingPlace {
    pub stem: String,
    /// Its segments that are not closed, in order; the last one is being written.
    pub segments: Vec<PathBuf>,
    /// The number of the last one, counting from 1.
    pub segment: u32,
}

pub struct RecordingWriter {
    pub head: RecordingHead,
    place: RecordingPlace,
    store: StoreId,
    framed: FramedWriter<BufWriter<File>>,
    drawing: Drawing,
    pace: FrameSampler,
    shadow: bool,
    active: bool,
    /// The live cell's last sequence that ended.
    worked: Option<u64>,
    /// End of the parts of its evaluation, virtual ms; at first the start of the file.
    filmed_ms: u64,
    /// Number of these parts.
    films: u64,
    /// The newest shadowed sequence in which twin and live cell diverged.
    disagreed: Option<u64>,
}

impl RecordingWriter {
    /// Begins a file with the known data.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn begin(
        head: RecordingHead,
        place: RecordingPlace,
        wall_clock: bool,
        at_ms: u64,
        open: &OpenFile,
    ) -> io::Result<Self> {
        let path = place.segments.last().ok_or_else(|| io::Error::other("no file is named"))?;
        let mut framed = FramedWriter::open_ended(BufWriter::new(open(path)?))?;
        let store = store(&place.stem);
        let mut ids = RowIds::of_segment(place.segment);
        for layout in blueprint::messages()? {
            framed.write(&layout)?;
        }
        framed.write(&opening(&store, &mut ids))?;
        let version = head.about.version.clone();
        let mut drawing = Drawing::new(ids, Some(version), wall_clock, PATH_EVERY_MS);
        drawing.begin(&head.scenery);
        drawing::head(drawing.rows(), &head);
        properties(&mut drawing, &head);
        drawing.introduce(&head.about, at_ms);
        let pace = FrameSampler::default();
        let mut writer = Self {
            head,
            place,
            store,
            framed,
            drawing,
            pace,
            shadow: false,
            active: false,
            worked: None,
            filmed_ms: at_ms,
            films: 0,
            disagreed: None,
        };
        writer.flush()?;
        Ok(writer)
    }

    /// Whether frames that arrive now are part of it.
    #[must_use]
    pub const fn takes_frames(&self) -> bool {
        self.shadow || self.active
    }

    /// A frame that is part of it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn video_frame(&mut self, frame: &Arc<VideoFrame>) -> io::Result<()> {
        let mut chosen = self.pace.on_frame(frame);
        if frame.stopped || frame.unexpected_contact {
            chosen.extend(self.pace.on_event(Some(frame.sequence), EventWeight::Notable));
        }
        self.draw(&chosen)
    }

    /// Earlier frames that turn out to be part of it.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn earlier(&mut self, frames: Vec<Arc<VideoFrame>>) -> io::Result<()> {
        let chosen = self.pace.new_frames(frames);
        self.draw(&chosen)
    }

    /// A re-run part of its evaluation: frames of both versions, their joints and tools as columns, the events in the
    /// log. The first part is placed at the start of the file, each further one after the one before.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn film(&mut self, film: &Film) -> io::Result<()> {
        let from_ms = self.filmed_ms;
        let at_ms = |tick: u64| from_ms.saturating_add(holdpoint_recordings::episode_recording::at_ms(tick));
        self.films += 1;
        let span = holdpoint_recordings::episode_recording::span(film, from_ms);
        self.drawing.film(&span, self.films);
        for mut frame in holdpoint_recordings::episode_recording::video_frames(film) {
            frame.at_ms = from_ms.saturating_add(frame.at_ms);
            frame.sequence = self.films;
            self.earlier(vec![Arc::new(frame)])?;
        }
        for (who, run) in [("candidate", &film.candidate), ("active", &film.active)] {
            for mark in &run.marks {
                self.drawing.mark(who, mark, at_ms(mark.tick));
            }
            for frame in &run.frames {
                if self.is_full() {
                    break;
                }
                self.drawing.columns(who, frame, at_ms(frame.tick));
                if self.drawing.rows().are_many() {
                    self.flush()?;
                }
            }
        }
        self.filmed_ms = span.until_ms.saturating_add(FILM_GAP_MS);
        Ok(())
    }

    fn draw(&mut self, chosen: &[Arc<VideoFrame>]) -> io::Result<()> {
        for frame in chosen {
            if self.is_full() {
                return Ok(());
            }
            self.drawing.video_frame(frame);
            if self.drawing.rows().are_many() {
                self.flush()?;
            }
        }
        Ok(())
    }

    /// Whether the file is too large for more frames.
    fn is_full(&self) -> bool {
        self.framed.written() >= FILE_BYTES_MAX
    }

    /// An event.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn event(&mut self, event: &Event) -> io::Result<()> {
        let ours = event.kind.version().is_none_or(|version| *version == self.head.about.version);
        if matches!(event.kind, EventKind::Progress { .. }) && (!ours || self.is_full()) {
            return Ok(());
        }
        self.drawing.event(event);
        if let EventKind::Sequence { index, .. } = &event.kind {
            self.worked = Some(*index);
        }
        if ours {
            self.turn(&event.kind);
            if let Some((sequence, news)) = event_weight(&event.kind) {
                let held_back = self.pace.on_event(sequence, news);
                if self.takes_frames() {
                    self.draw(&held_back)?;
                }
            }
        }
        if ours && matters(&event.kind) {
            self.flush()?;
        }
        Ok(())
    }

    /// Which frames are part of it from now on.
    fn turn(&mut self, kind: &EventKind) {
        match kind {
            EventKind::StageStarted { stage: Stage::Shadow, .. } => self.shadow = true,
            EventKind::Decided { stage: Stage::Shadow, .. } => self.shadow = false,
            EventKind::Activated { .. }
            | EventKind::Monitor { .. }
            | EventKind::Rung { .. }
            | EventKind::RolledBack { .. } => self.active = true,
            _ => {}
        }
    }

    /// A snapshot.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn snapshot(&mut self, snapshot: &Snapshot) -> io::Result<()> {
        self.drawing.snapshot(snapshot);
        let view = snapshot.candidates.iter().find(|view| view.version == self.head.about.version);
        let Some(shadow) = view.and_then(|view| view.shadow.as_ref()) else { return Ok(()) };
        let newest = shadow.disagreements.first().map(|disagreement| disagreement.index);
        if newest.is_none() || newest == self.disagreed {
            return Ok(());
        }
        self.disagreed = newest;
        let held_back = self.pace.on_event(self.worked, EventWeight::Notable);
        self.draw(&held_back)
    }

    /// Writes the pending rows.
    ///
    /// # Errors
    /// If they cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        let mut chunks = self.drawing.rows().take().0;
        // A frame's record comes last: if a kill tears the block, no record refers to a missing frame.
        let frames = EntityPath::parse_forgiving(drawing::paths::FRAME);
        chunks.sort_by_key(|chunk| *chunk.entity_path() == frames);
        for chunk in chunks {
            self.framed.write(&message(&self.store, &chunk)?)?;
        }
        self.framed.flush()
    }

    /// Ends the file: finally with an outcome, or until the next session.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn end(
        mut self,
        outcome: Option<UpgradeEnd>,
        dropped: (u64, u64),
    ) -> Result<Option<ClosedRecording>, ReadError> {
        let into = self.place.segments.first().cloned().unwrap_or_default();
        let failed = |source| ReadError::file(&into, source);
        self.flush().map_err(failed)?;
        self.framed.finish().map_err(failed)?;
        let Some(outcome) = outcome else {
            if let Some(last) = self.place.segments.last() {
                compact::mend(&self.place.stem, last, dropped)?;
            }
            return Ok(None);
        };
        let tail = RecordingTail { outcome: Some(outcome.into()), dropped };
        let ended = compact::join(&self.place.stem, &self.place.segments, &into, &tail)?;
        Ok(Some(ClosedRecording {
            version: self.head.about.version.clone(),
            outcome: outcome.into(),
            file: into.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default(),
            digest: ended.digest,
            bytes: ended.bytes,
            frames: ended.frames,
            dropped,
        }))
    }
}

/// Whether an event makes a sequence worth its full rate.
fn event_weight(kind: &EventKind) -> Option<(Option<u64>, EventWeight)> {
    match kind {
        EventKind::Sequence { index, success: false, .. } => Some((Some(*index), EventWeight::Notable)),
        EventKind::Sequence { index, tasks, .. }
            if tasks.iter().any(|task| task.violation || task.anomaly) =>
        {
            Some((Some(*index), EventWeight::Notable))
        }
        EventKind::Monitor { .. } | EventKind::Rung { .. } | EventKind::RolledBack { .. } => {
            Some((None, EventWeight::Decisive))
        }
        EventKind::Alarm { state, .. } if *state != AlarmState::Normal => Some((None, EventWeight::Notable)),
        _ => None,
    }
}

/// Whether an event should be on disk at once.
const fn matters(kind: &EventKind) -> bool {
    matches!(
        kind,
        EventKind::Decided { .. }
            | EventKind::Activated { .. }
            | EventKind::Monitor { .. }
            | EventKind::Rung { .. }
            | EventKind::RolledBack { .. }
            | EventKind::Sequence { .. }
            | EventKind::AuditClosed { .. }
    )
}

/// The recording's properties, which a viewer shows in its selection panel.
fn properties(drawing: &mut Drawing, head: &RecordingHead) {
    let about = &head.about;
    let text = |text: &str| components::Text::from(Untrusted::new(text).line().as_str());
    let name = format!("upgrade {}", about.version);
    drawing.rows().always("__properties", &RecordingInfo::new().with_name(name.as_str()));
    let predecessor = about.predecessor.as_ref().map_or_else(|| "none".to_owned(), ToString::to_string);
    let facts = AnyValues::default()
        .with_component::<components::Text>("candidate", [text(&about.version.to_string())])
        .with_component::<components::Text>("digest", [text(&about.digest.to_string())])
        .with_component::<components::Text>("predecessor", [text(&predecessor)])
        .with_component::<components::Text>("profile", [text(&about.profile.to_string())])
        .with_component::<components::Text>("robot", [text(&about.robot)])
        .with_component::<components::Text>("seed", [text(&holdpoint_wording::seeds::named(about.seed))])
        .with_component::<components::Text>("engine", [text(&about.engine_build)]);
    drawing.rows().always("__properties/upgrade", &facts);
}
