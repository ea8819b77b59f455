//! Binds an engine to the scene sink: what it draws and tells goes to the tap, what became of a recording goes on
//! record.
//!
//! The engine never waits for the sink but at its end, and there not for long. No decision hangs on any of it.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use super::Engine;
use super::event::{Event, EventKind};
use crate::pipeline::painter::Easel;
use crate::scene;
use crate::scene::record::{KIND, OnRecord, Recorded};
use crate::scene::tap::Tap;
use crate::scene::{Closed, Report, SceneConfig, SceneError, Scenes};

/// How long a script that ends waits for its recordings to be closed: nobody waits for it.
const PATIENCE_SCRIPT: Duration = Duration::from_secs(20);

/// How long a live engine does: a console gives it three seconds for everything. What is not ended by then is mended
/// and put on record at the next start.
const PATIENCE_LIVE: Duration = Duration::from_secs(2);

/// What is wanted of scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SceneOptions {
    /// Keep a recording of each upgrade in the store's folder.
    pub record: bool,
    /// Serve a live viewer there.
    pub view: Option<SocketAddr>,
}

impl SceneOptions {
    /// What a run does where nothing else is asked for: record where this program was built with scenes.
    pub const DEFAULT: Self = Self { record: scene::BUILT_IN, view: None };

    /// No scenes at all.
    pub const NONE: Self = Self { record: false, view: None };

    const fn nothing(self) -> bool {
        !self.record && self.view.is_none()
    }
}

/// The running sink of one engine.
pub struct Recorder {
    scenes: Scenes,
}

impl Recorder {
    /// Starts the sink. Absent where nothing is wanted, or where it does not start, which is told then: the engine
    /// works as well without.
    pub fn start(engine: &mut Engine, options: SceneOptions) -> Option<Self> {
        if options.nothing() {
            return None;
        }
        match Self::begin(engine, options) {
            Ok(recorder) => Some(recorder),
            Err(text) => {
                engine.manager.tell_scene(text, true);
                None
            }
        }
    }

    fn begin(engine: &Engine, options: SceneOptions) -> Result<Self, String> {
        let views = engine.manager.ledger().store().views().map_err(|error| error.to_string())?;
        let on_record = OnRecord::read(&views).map_err(|error| error.to_string())?;
        let closed = on_record.0.into_keys().collect();
        let config = SceneConfig {
            recordings: options.record.then(|| engine.layout().recordings()),
            closed,
            view: options.view,
            wall_clock: !engine.manager.clock().is_scripted(),
        };
        let scenes = Scenes::start(config).map_err(|error: SceneError| error.to_string())?;
        Ok(Self { scenes })
    }

    /// Where pictures and events are handed over.
    #[must_use]
    pub fn tap(&self) -> Tap {
        self.scenes.tap()
    }

    /// Takes pictures of the live world.
    #[must_use]
    pub fn easel(&self) -> Easel {
        let tap = self.tap();
        Arc::new(move |picture| tap.picture(picture))
    }

    /// Hands over what happened.
    pub fn events(&self, engine: &Engine, events: &[Event]) {
        self.scenes.tap().events(events, || engine.snapshot());
    }

    /// Puts on record what became of recordings meanwhile.
    pub fn settle(&mut self, engine: &mut Engine) {
        let reports = self.scenes.reports();
        take_in(engine, reports);
    }

    /// Ends the sink: closes what is to be closed, and puts it on record.
    pub fn finish(self, engine: &mut Engine) {
        let scripted = engine.manager.clock().is_scripted();
        let reports = self.scenes.finish(if scripted { PATIENCE_SCRIPT } else { PATIENCE_LIVE });
        take_in(engine, reports);
    }
}

fn take_in(engine: &mut Engine, reports: Vec<Report>) {
    for report in reports {
        match report {
            Report::Closed(closed) => {
                if let Err(text) = put_on_record(engine, closed) {
                    engine.fail(&format!("the digest of a recording cannot be put on record: {text}"));
                }
            }
            Report::Failed { version, text } => {
                let of = version.map_or_else(String::new, |version| format!("{version}: "));
                engine.manager.tell_scene(format!("{of}{text}"), true);
            }
            Report::Serving { url } => {
                engine.manager.tell_scene(format!("a viewer may connect to {url}"), false);
            }
            Report::NotServing { text } => engine.manager.tell_scene(text, true),
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
    engine.manager.keep_recording(&version, (KIND, body), told).map_err(|fault| fault.to_string())
}
