//! The data of a live viewer: every frame, every event, and the charts of the running upgrade.

use std::net::SocketAddr;

use rerun::StoreId;

use super::blueprint;
use super::drawing::Drawing;
use super::file::{message, opening, store};
use super::limits::LIVE_PATH_EVERY_MS;
use super::rows::RowIds;
use super::server::Server;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::sink::SinkReport;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
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
    /// Why it cannot be served.
    pub fn start(address: SocketAddr) -> Result<(Self, SinkReport), Problem> {
        let server = Server::start(address)?;
        let report = SinkReport::Serving { url: server.url().to_owned() };
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        // Lets a viewer that stays open over two runs keep them apart.
        let store = store(&format!("live-{}-{}", since.as_secs(), std::process::id()));
        let mut ids = RowIds::of_segment(1);
        for layout in blueprint::messages().map_err(|error| error.to_string())? {
            server.send(layout);
        }
        server.send(opening(&store, &mut ids));
        let mut drawing = Drawing::new(ids, None, true, LIVE_PATH_EVERY_MS);
        let name = rerun::RecordingInfo::new().with_name("live cell");
        drawing.rows().always("__properties", &name);
        Ok((Self { server, store, drawing, begun: false }, report))
    }

    /// The address for viewers.
    #[must_use]
    pub fn url(&self) -> &str {
        self.server.url()
    }

    /// A frame of the live cell.
    pub fn video_frame(&mut self, frame: &VideoFrame) {
        self.drawing.video_frame(frame);
        if self.drawing.rows().are_many() {
            self.flush();
        }
    }

    /// Events, and the snapshot after them.
    pub fn events(&mut self, events: &[Event], snapshot: Option<&Snapshot>) {
        for event in events {
            if let (
                EventKind::Registered { parent: Some(_), .. }
                | EventKind::StageStarted { .. }
                | EventKind::Activated { .. }
                | EventKind::Monitor { .. }
                | EventKind::Rung { .. },
                Some(version),
            ) = (&event.kind, event.kind.version())
            {
                self.drawing.turn_to(version);
            }
            self.drawing.event(event);
        }
        if let Some(snapshot) = snapshot {
            self.look(snapshot);
        }
    }

    /// A snapshot; the first one also draws the fixed scene.
    pub fn look(&mut self, snapshot: &Snapshot) {
        if !self.begun {
            self.begun = true;
            self.drawing.begin(&snapshot.scenery);
        }
        self.drawing.snapshot(snapshot);
    }

    /// Sends the pending rows.
    pub fn flush(&mut self) {
        for chunk in self.drawing.rows().take().0 {
            // A chunk that makes no message is a defect of this program; a viewer can do without it.
            if let Ok(message) = message(&self.store, &chunk) {
                self.server.send(message);
            }
        }
    }
}
