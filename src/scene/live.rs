//! What a live viewer is sent: every picture, everything that happens, and the charts of the upgrade that runs.

use std::net::SocketAddr;

use rerun::StoreId;

use super::drawing::Drawing;
use super::file::{message, opening, store};
use super::limits::LIVE_PATH_EVERY_MS;
use super::rows::Ids;
use super::server::Server;
use super::{blueprint, words};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::sink::Report;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_text::Problem;

/// A server and its drawing.
pub struct LiveServer {
    server: Server,
    store: StoreId,
    drawing: Drawing,
    begun: bool,
}

impl LiveServer {
    /// Serves at an address.
    ///
    /// # Errors
    /// Why it cannot be served, for whoever asked.
    pub fn start(address: SocketAddr) -> Result<(Self, Report), Problem> {
        let server = Server::start(address)?;
        let report = Report::Serving { url: server.url().to_owned() };
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        // A viewer that stays open over two runs keeps them apart.
        let store = store(&format!("live-{}-{}", since.as_secs(), std::process::id()));
        let mut ids = Ids::of_segment(1);
        for layout in blueprint::messages().map_err(|error| error.to_string())? {
            server.send(layout);
        }
        server.send(opening(&store, &mut ids));
        let mut drawing = Drawing::new(ids, None, true, LIVE_PATH_EVERY_MS);
        let name = rerun::RecordingInfo::new().with_name("live cell");
        drawing.rows().always("__properties", &name);
        Ok((Self { server, store, drawing, begun: false }, report))
    }

    /// Where a viewer connects.
    #[must_use]
    pub fn url(&self) -> &str {
        self.server.url()
    }

    /// A moment of the live cell.
    pub fn picture(&mut self, picture: &Picture) {
        self.drawing.picture(picture);
        if self.drawing.rows().are_many() {
            self.flush();
        }
    }

    /// Things that happened, and how they stood afterwards.
    pub fn events(&mut self, events: &[Event], snapshot: Option<&Snapshot>) {
        for event in events {
            if let (
                EventKind::Registered { parent: Some(_), .. }
                | EventKind::StageStarted { .. }
                | EventKind::Activated { .. }
                | EventKind::Monitor { .. }
                | EventKind::Rung { .. },
                Some(version),
            ) = (&event.kind, words::version_of(&event.kind))
            {
                self.drawing.turn_to(version);
            }
            self.drawing.event(event);
        }
        if let Some(snapshot) = snapshot {
            self.look(snapshot);
        }
    }

    /// How things stand; the first time also what does not move.
    pub fn look(&mut self, snapshot: &Snapshot) {
        if !self.begun {
            self.begun = true;
            self.drawing.begin(&snapshot.scenery);
        }
        self.drawing.snapshot(snapshot);
    }

    /// Sends the rows that wait.
    pub fn flush(&mut self) {
        for chunk in self.drawing.rows().take().0 {
            // A chunk that makes no message would be a fault of ours; a viewer can do without it.
            if let Ok(message) = message(&self.store, &chunk) {
                self.server.send(message);
            }
        }
    }
}
