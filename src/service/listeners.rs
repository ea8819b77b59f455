//! An engine's listeners: they receive its camera frames and events, and the outcome of recordings goes on record.
//!
//! The engine waits for them only at its end, and only briefly. No decision depends on them.

use std::sync::Arc;
use std::time::Duration;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::{
    ClosedRecording, MakeSink, ServeScene, Sink, SinkReport, SinkSetup, VideoFrameSink,
};
use holdpoint_recordings::audit_record::{KIND, RecordingClosure};
use holdpoint_text::Hint;

use crate::recordings;
use holdpoint_engine::Engine;
use holdpoint_wording::program::engine as sentences;

/// How long a script waits at its end for its recordings to close.
const PATIENCE_SCRIPT: Duration = Duration::from_mins(1);

/// How long a live engine waits: a console allows it three seconds in all. An unfinished recording is repaired and recorded
/// at the next start.
const PATIENCE_LIVE: Duration = Duration::from_secs(2);

/// The running listeners of one engine.
#[derive(Default)]
pub struct Listeners {
    sinks: Vec<Box<dyn Sink>>,
}

impl Listeners {
    /// Starts them. A failed one is reported and left out.
    pub fn start(engine: &mut Engine, makers: Vec<MakeSink>) -> Self {
        let mut sinks = Vec::new();
        for make in makers {
            let made = setup(engine).and_then(make);
            match made {
                Ok(sink) => sinks.push(sink),
                Err(text) => engine.tell_scene(text, true),
            }
        }
        Self { sinks }
    }

    /// Sends frames of the live cell to all of them; absent if no listener uses them.
    #[must_use]
    pub fn video_frames(&self) -> Option<VideoFrameSink> {
        let mut takers: Vec<VideoFrameSink> =
            self.sinks.iter().filter_map(|sink| sink.video_frames()).collect();
        match takers.len() {
            0 => None,
            1 => takers.pop(),
            _ => Some(Arc::new(move |frame| takers.iter().for_each(|take| take(frame.clone())))),
        }
    }

    /// Serves a live viewer; absent if no listener can.
    #[must_use]
    pub fn serve(&self) -> Option<ServeScene> {
        self.sinks.iter().find_map(|sink| sink.serve())
    }

    /// Delivers events. After a rejection in the sandbox, which moves no live arm, adds films of its causes.
    pub fn events(&mut self, engine: &mut Engine, events: &[Event]) {
        if self.sinks.is_empty() {
            return;
        }
        let mut rest = events;
        while let Some((at, version)) = rest.iter().enumerate().find_map(refused_in_sandbox) {
            let (before, after) = rest.split_at(at + 1);
            self.hand_over(engine, before);
            rest = after;
            match engine.films_of_refusal(version) {
                Ok(films) => {
                    self.sinks
                        .iter_mut()
                        .for_each(|sink| films.iter().for_each(|film| sink.film(version, film)));
                }
                Err(fault) => {
                    engine.tell_scene(sentences::cause_not_recorded(version, &fault.sentence()), true);
                }
            }
        }
        self.hand_over(engine, rest);
    }

    fn hand_over(&mut self, engine: &Engine, events: &[Event]) {
        for sink in &mut self.sinks {
            sink.events(events, &|| engine.snapshot());
        }
    }

    /// Records the outcome of recordings since the last call.
    pub fn settle(&mut self, engine: &mut Engine) {
        let reports: Vec<SinkReport> = self.sinks.iter_mut().flat_map(|sink| sink.reports()).collect();
        record_reports(engine, reports);
    }

    /// Ends them: closes and records their recordings.
    pub fn finish(&mut self, engine: &mut Engine) {
        let scripted = engine.is_scripted();
        let patience = if scripted { PATIENCE_SCRIPT } else { PATIENCE_LIVE };
        for sink in self.sinks.drain(..) {
            record_reports(engine, sink.finish(patience));
        }
    }
}

/// A rejection of a version that had not passed the sandbox.
const fn refused_in_sandbox((at, event): (usize, &Event)) -> Option<(usize, &CapabilityId)> {
    match &event.kind {
        EventKind::StateChanged { version, from: State::Validated, to: State::Rejected, .. } => {
            Some((at, version))
        }
        _ => None,
    }
}

fn setup(engine: &Engine) -> Result<SinkSetup, String> {
    let views = engine.views().map_err(|error| error.sentence())?;
    let on_record = recordings::on_record(&*views).map_err(|error| error.sentence())?;
    Ok(SinkSetup {
        recordings: engine.layout().recordings(),
        closed: on_record.0.into_keys().collect(),
        scripted: engine.is_scripted(),
    })
}

fn record_reports(engine: &mut Engine, reports: Vec<SinkReport>) {
    for report in reports {
        match report {
            SinkReport::Closed(closed) => {
                let views = engine.views();
                let found = views.map_err(|error| error.sentence()).and_then(|views| {
                    recordings::contradiction(&*views, &closed).map_err(|error| error.sentence())
                });
                match found {
                    Ok(None) => {}
                    Ok(Some(why)) | Err(why) => {
                        engine.tell_scene(sentences::not_recorded(&closed.file, &why), true);
                        continue;
                    }
                }
                if let Err(text) = put_on_record(engine, closed) {
                    engine.fail(&format!("the digest of a recording cannot be recorded: {text}"));
                }
            }
            SinkReport::Failed { version, text } => {
                let of = version.map_or_else(String::new, |version| format!("{version}: "));
                engine.tell_scene(format!("{of}{text}"), true);
            }
            SinkReport::Serving { url } => {
                engine.tell_scene(sentences::serves_viewer(url), false);
            }
            SinkReport::NotServing { text } => engine.tell_scene(text, true),
        }
    }
}

fn put_on_record(engine: &mut Engine, closed: ClosedRecording) -> Result<(), String> {
    let ClosedRecording { version, outcome, file, digest, bytes, frames: pictures, dropped } = closed;
    let recorded = RecordingClosure {
        file: file.clone(),
        sha256: digest,
        bytes,
        pictures,
        dropped_pictures: dropped.0,
        dropped_events: dropped.1,
        outcome,
    };
    let body = serde_json::to_string(&recorded).map_err(|error| error.to_string())?;
    let dropped = [dropped.0, dropped.1];
    let event = EventKind::RecordingKept { version: version.clone(), file, digest, bytes, pictures, dropped };
    engine.keep_recording(&version, (KIND, body), event).map_err(|fault| fault.sentence())
}
