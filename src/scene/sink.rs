//! The sink's thread: takes items from the queue, passes them to the files and the live viewer, and reports the result.

use std::fs::File;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use super::feed::{Feed, FeedItem, FeedReceiver, queue};
use super::limits::{FLUSH_EVERY, PATIENCE, REPORTS_MAX, SEND_EVERY};
use super::live_view::LiveServer;
use super::router::{Router, display_folder};
use super::writer::OpenFile;
use super::{SceneConfig, SceneError};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::film::Film;
use holdpoint_protocol::sink::{ServeScene, Sink, SinkReport, VideoFrameSink};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_text::Hint;
use holdpoint_text::file::create_fresh;

/// The running sink. After a drop it ends by itself.
#[derive(Debug)]
pub struct SceneSink {
    feed: Feed,
    reports: Receiver<SinkReport>,
}

impl SceneSink {
    /// Starts the sink.
    ///
    /// # Errors
    /// If the folder cannot be made, or no thread can start. A taken port is a report, not an error.
    pub fn start(config: SceneConfig) -> Result<Self, SceneError> {
        Self::start_with(config, Box::new(open))
    }

    /// As above, with files made by `open`.
    fn start_with(config: SceneConfig, open: Box<OpenFile>) -> Result<Self, SceneError> {
        if let Some(folder) = &config.recordings {
            std::fs::create_dir_all(folder)
                .map_err(|source| SceneError::Folder { path: display_folder(folder), source })?;
        }
        let (feed, drain) = queue();
        let (sender, reports) = sync_channel(REPORTS_MAX);
        std::thread::Builder::new()
            .name("scene".to_owned())
            .spawn(move || SinkWorker::new(config, open, sender).run(&drain))
            .map_err(SceneError::Thread)?;
        Ok(Self { feed, reports })
    }

    /// The queue's open end, for the engine.
    #[must_use]
    pub fn feed(&self) -> Feed {
        self.feed.clone()
    }

    /// The pending reports; never waits.
    #[must_use]
    pub fn reports(&mut self) -> Vec<SinkReport> {
        self.reports.try_iter().collect()
    }

    /// Ends the sink: writes pending rows and completes every file; waits at most `patience`.
    #[must_use]
    pub fn finish(self, patience: Duration) -> Vec<SinkReport> {
        let until = Instant::now() + patience;
        let mut reports = Vec::new();
        let mut requested = self.feed.end();
        loop {
            let left = until.saturating_duration_since(Instant::now());
            // A full queue is asked again.
            let wait = if requested { left } else { left.min(Duration::from_millis(10)) };
            match self.reports.recv_timeout(wait) {
                Ok(report) => reports.push(report),
                Err(RecvTimeoutError::Disconnected) => return reports,
                Err(RecvTimeoutError::Timeout) if left.is_zero() => return reports,
                Err(RecvTimeoutError::Timeout) => requested = requested || self.feed.end(),
            }
        }
    }
}

impl Sink for SceneSink {
    fn video_frames(&self) -> Option<VideoFrameSink> {
        let feed = self.feed();
        Some(Arc::new(move |frame| feed.video_frame(frame)))
    }

    fn serve(&self) -> Option<ServeScene> {
        let feed = self.feed();
        Some(Arc::new(move |address| feed.serve(address)))
    }

    fn events(&mut self, events: &[Event], state: &dyn Fn() -> Snapshot) {
        self.feed.events(events, state);
    }

    fn film(&mut self, version: &CapabilityId, film: &Film) {
        self.feed.film(version, film);
    }

    fn reports(&mut self) -> Vec<SinkReport> {
        Self::reports(self)
    }

    fn finish(self: Box<Self>, patience: Duration) -> Vec<SinkReport> {
        Self::finish(*self, patience)
    }
}

/// Makes a recording's file. In a self-test build, `HOLDPOINT_TEST_DISK=full` makes one on a full disk.
fn open(path: &Path) -> std::io::Result<File> {
    let full = || std::env::var_os("HOLDPOINT_TEST_DISK").is_some_and(|value| value == "full");
    if cfg!(debug_assertions) && full() {
        return File::options().write(true).open("/dev/full");
    }
    create_fresh(path)
}

impl Drop for SceneSink {
    fn drop(&mut self) {
        // If the queue is full, the thread ends when the engine's feed is gone too.
        let _ = self.feed.end();
    }
}

struct SinkWorker {
    router: Option<Router>,
    live: Option<LiveServer>,
    view: Option<SocketAddr>,
    reports: SyncSender<SinkReport>,
    last: Option<Box<Snapshot>>,
    flushed: Instant,
    sent: Instant,
}

impl SinkWorker {
    fn new(config: SceneConfig, open: Box<OpenFile>, reports: SyncSender<SinkReport>) -> Self {
        let SceneConfig { recordings, closed, view, wall_clock } = config;
        let router = recordings.map(|folder| Router::new(folder, closed, wall_clock, open));
        Self { router, live: None, view, reports, last: None, flushed: Instant::now(), sent: Instant::now() }
    }

    fn run(mut self, drain: &FeedReceiver) {
        if let Some(address) = self.view.take() {
            self.serve(address);
        }
        if let Some(router) = &mut self.router {
            router.recover();
        }
        self.send_reports();
        loop {
            match drain.next(PATIENCE) {
                Ok(Some(FeedItem::End)) | Err(_) => break,
                Ok(Some(item)) => self.take(item, drain),
                Ok(None) => {}
            }
            if self.sent.elapsed() >= SEND_EVERY {
                self.sent = Instant::now();
                if let Some(live) = &mut self.live {
                    live.flush();
                }
            }
            if self.flushed.elapsed() >= FLUSH_EVERY {
                self.flushed = Instant::now();
                if let Some(router) = &mut self.router {
                    router.flush();
                }
            }
            self.send_reports();
        }
        if let Some(live) = &mut self.live {
            live.flush();
        }
        if let Some(router) = &mut self.router {
            router.end(drain.dropped.counts());
        }
        self.send_reports();
    }

    fn take(&mut self, item: FeedItem, drain: &FeedReceiver) {
        match item {
            FeedItem::Frame(picture) => {
                if let Some(live) = &mut self.live {
                    live.video_frame(&picture);
                }
                if let Some(router) = &mut self.router {
                    router.video_frame(Arc::new(*picture));
                }
            }
            FeedItem::Events(events, snapshot) => {
                if let Some(live) = &mut self.live {
                    live.events(&events, snapshot.as_deref());
                    live.flush();
                }
                if let Some(router) = &mut self.router {
                    router.events(&events, snapshot.as_deref(), drain.dropped.counts());
                }
                if snapshot.is_some() {
                    self.last = snapshot;
                }
            }
            FeedItem::Film(version, film) => {
                if let Some(router) = &mut self.router {
                    router.film(&version, &film);
                }
            }
            FeedItem::Serve(address) => self.serve(address),
            FeedItem::End => {}
        }
    }

    fn serve(&mut self, address: SocketAddr) {
        if let Some(live) = &self.live {
            // There is one live scene; a second request gets its address.
            self.send_report(SinkReport::Serving { url: live.url().to_owned() });
            return;
        }
        match LiveServer::start(address) {
            Ok((mut live, report)) => {
                if let Some(snapshot) = &self.last {
                    live.look(snapshot);
                }
                self.live = Some(live);
                self.send_report(report);
            }
            Err(problem) => self.send_report(SinkReport::NotServing { text: problem.sentence() }),
        }
    }

    fn send_reports(&mut self) {
        let reports = self.router.as_mut().map(Router::reports).unwrap_or_default();
        for report in reports {
            self.send_report(report);
        }
    }

    fn send_report(&self, report: SinkReport) {
        // If the queue is full, the report is lost: the next start reports a completed file that is not on record
        // again.
        let _ = self.reports.try_send(report);
    }
}
