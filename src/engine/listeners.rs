//! An engine's listeners: what it draws and tells goes to them, what becomes of a recording goes on record.
//!
//! The engine never waits for them but at its end, and there not for long. No decision hangs on any of it.

use std::sync::Arc;
use std::time::Duration;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::{Closed, MakeSink, Pictures, Report, Serve, Setup, Sink};
use holdpoint_recordings::record::{KIND, Recorded};
use holdpoint_text::Hint;

use crate::Engine;
use crate::recordings;

/// How long a script that ends waits for its recordings to be closed: nobody waits for it.
const PATIENCE_SCRIPT: Duration = Duration::from_mins(1);

/// How long a live engine does: a console gives it three seconds for everything. What is not ended by then is mended
/// and put on record at the next start.
const PATIENCE_LIVE: Duration = Duration::from_secs(2);

/// The running listeners of one engine.
#[derive(Default)]
pub struct Listeners {
    sinks: Vec<Box<dyn Sink>>,
}

impl Listeners {
    /// Starts them. One that does not start is told and left out: the engine works as well without.
    pub fn start(engine: &mut Engine, makers: Vec<MakeSink>) -> Self {
        let mut sinks = Vec::new();
        for make in makers {
            let made = setup(engine).and_then(make);
            match made {
                Ok(sink) => sinks.push(sink),
                Err(text) => engine.pipeline.tell_scene(text, true),
            }
        }
        Self { sinks }
    }

    /// Takes pictures of the live world for all of them; absent if nobody wants any.
    #[must_use]
    pub fn pictures(&self) -> Option<Pictures> {
        let mut takers: Vec<Pictures> = self.sinks.iter().filter_map(|sink| sink.pictures()).collect();
        match takers.len() {
            0 => None,
            1 => takers.pop(),
            _ => Some(Arc::new(move |picture| takers.iter().for_each(|take| take(picture.clone())))),
        }
    }

    /// How a live viewer is served; absent if nobody can.
    #[must_use]
    pub fn serve(&self) -> Option<Serve> {
        self.sinks.iter().find_map(|sink| sink.serve())
    }

    /// Hands over what happened. After a refusal in the sandbox, where no live arm moved, comes what it was refused for.
    pub fn events(&mut self, engine: &mut Engine, events: &[Event]) {
        if self.sinks.is_empty() {
            return;
        }
        let mut rest = events;
        while let Some((at, version)) = rest.iter().enumerate().find_map(refused_in_sandbox) {
            let (before, after) = rest.split_at(at + 1);
            self.hand_over(engine, before);
            rest = after;
            match engine.pipeline.films_of_refusal(version) {
                Ok(films) => {
                    self.sinks
                        .iter_mut()
                        .for_each(|sink| films.iter().for_each(|film| sink.film(version, film)));
                }
                Err(fault) => {
                    let text = format!(
                        "{version}: what it was refused for is not in its recording: {}",
                        fault.sentence()
                    );
                    engine.pipeline.tell_scene(text, true);
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

    /// Puts on record what became of recordings meanwhile.
    pub fn settle(&mut self, engine: &mut Engine) {
        let reports: Vec<Report> = self.sinks.iter_mut().flat_map(|sink| sink.reports()).collect();
        take_in(engine, reports);
    }

    /// Ends them: closes what is to be closed, and puts it on record.
    pub fn finish(&mut self, engine: &mut Engine) {
        let scripted = engine.is_scripted();
        let patience = if scripted { PATIENCE_SCRIPT } else { PATIENCE_LIVE };
        for sink in self.sinks.drain(..) {
            take_in(engine, sink.finish(patience));
        }
    }
}

/// Where a version was refused that had come no further than the sandbox.
const fn refused_in_sandbox((at, event): (usize, &Event)) -> Option<(usize, &CapabilityId)> {
    match &event.kind {
        EventKind::StateChanged { version, from: State::Validated, to: State::Rejected, .. } => {
            Some((at, version))
        }
        _ => None,
    }
}

fn setup(engine: &Engine) -> Result<Setup, String> {
    let views = engine.pipeline.record().ledger().store().views().map_err(|error| error.sentence())?;
    let on_record = recordings::on_record(&views).map_err(|error| error.sentence())?;
    Ok(Setup {
        recordings: engine.layout().recordings(),
        closed: on_record.0.into_keys().collect(),
        scripted: engine.is_scripted(),
    })
}

fn take_in(engine: &mut Engine, reports: Vec<Report>) {
    for report in reports {
        match report {
            Report::Closed(closed) => {
                let views = engine.pipeline.record().ledger().store().views();
                let found = views.map_err(|error| error.sentence()).and_then(|views| {
                    recordings::contradiction(&views, &closed).map_err(|error| error.sentence())
                });
                match found {
                    Ok(None) => {}
                    Ok(Some(why)) | Err(why) => {
                        let text = format!("{} is not put on record: {why}", closed.file);
                        engine.pipeline.tell_scene(text, true);
                        continue;
                    }
                }
                if let Err(text) = put_on_record(engine, closed) {
                    engine.fail(&format!("the digest of a recording cannot be put on record: {text}"));
                }
            }
            Report::Failed { version, text } => {
                let of = version.map_or_else(String::new, |version| format!("{version}: "));
                engine.pipeline.tell_scene(format!("{of}{text}"), true);
            }
            Report::Serving { url } => {
                engine.pipeline.tell_scene(format!("a viewer may connect to {url}"), false);
            }
            Report::NotServing { text } => engine.pipeline.tell_scene(text, true),
        }
    }
}

fn put_on_record(engine: &mut Engine, closed: Closed) -> Result<(), String> {
    let Closed { version, outcome, file, digest, bytes, pictures, dropped } = closed;
    let recorded = Recorded {
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
    let told = EventKind::RecordingKept { version: version.clone(), file, digest, bytes, pictures, dropped };
    engine.pipeline.keep_recording(&version, (KIND, body), told).map_err(|fault| fault.sentence())
}
