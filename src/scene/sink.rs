//! The sink's thread: takes what waits in the queue, hands it to the files and to the live viewer, tells what became
//! of it.

use std::fs::File;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use super::feed::{Drain, Feed, Item, queue};
use super::limits::{FLUSH_EVERY, PATIENCE, REPORTS_MAX, SEND_EVERY};
use super::live::LiveServer;
use super::router::{Router, folder_shown};
use super::writer::Open;
use super::{SceneConfig, SceneError};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::film::Film;
use holdpoint_protocol::sink::{Pictures, Report, Serve, Sink};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_text::Hint;
use holdpoint_text::file::anew;

/// The running sink. Dropped, it ends by itself and nobody waits for it.
#[derive(Debug)]
pub struct Scenes {
    feed: Feed,
    reports: Receiver<Report>,
}

impl Scenes {
    /// Starts it.
    ///
    /// # Errors
    /// If the folder cannot be made, or no thread be started. A port that is taken is no error but a report.
    pub fn start(config: SceneConfig) -> Result<Self, SceneError> {
        Self::start_with(config, Box::new(open))
    }

    /// As above, with files made by `open`.
    fn start_with(config: SceneConfig, open: Box<Open>) -> Result<Self, SceneError> {
        if let Some(folder) = &config.recordings {
            std::fs::create_dir_all(folder)
                .map_err(|source| SceneError::Folder { path: folder_shown(folder), source })?;
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

    /// What there is to tell; never waits.
    #[must_use]
    pub fn reports(&mut self) -> Vec<Report> {
        self.reports.try_iter().collect()
    }

    /// Ends it: writes what waits and ends every file in good order, and waits at most `patience` for that.
    #[must_use]
    pub fn finish(self, patience: Duration) -> Vec<Report> {
        let until = Instant::now() + patience;
        let mut reports = Vec::new();
        let mut asked = self.feed.end();
        loop {
            let left = until.saturating_duration_since(Instant::now());
            // A full queue is asked again.
            let wait = if asked { left } else { left.min(Duration::from_millis(10)) };
            match self.reports.recv_timeout(wait) {
                Ok(report) => reports.push(report),
                Err(RecvTimeoutError::Disconnected) => return reports,
                Err(RecvTimeoutError::Timeout) if left.is_zero() => return reports,
                Err(RecvTimeoutError::Timeout) => asked = asked || self.feed.end(),
            }
        }
    }
}

impl Sink for Scenes {
    fn pictures(&self) -> Option<Pictures> {
        let feed = self.feed();
        Some(Arc::new(move |picture| feed.picture(picture)))
    }

    fn serve(&self) -> Option<Serve> {
        let feed = self.feed();
        Some(Arc::new(move |address| feed.serve(address)))
    }

    fn events(&mut self, events: &[Event], state: &dyn Fn() -> Snapshot) {
        self.feed.events(events, state);
    }

    fn film(&mut self, version: &CapabilityId, film: &Film) {
        self.feed.film(version, film);
    }

    fn reports(&mut self) -> Vec<Report> {
        Self::reports(self)
    }

    fn finish(self: Box<Self>, patience: Duration) -> Vec<Report> {
        Self::finish(*self, patience)
    }
}

/// Makes a recording's file. In a build that checks itself `HOLDPOINT_TEST_DISK=full` makes one on a disk without room.
fn open(path: &Path) -> std::io::Result<File> {
    let full = || std::env::var_os("HOLDPOINT_TEST_DISK").is_some_and(|value| value == "full");
    if cfg!(debug_assertions) && full() {
        return File::options().write(true).open("/dev/full");
    }
    anew(path)
}

impl Drop for Scenes {
    fn drop(&mut self) {
        // If the queue is full, the thread ends when the engine's feed is gone too.
        let _ = self.feed.end();
    }
}

struct SinkWorker {
    router: Option<Router>,
    live: Option<LiveServer>,
    view: Option<SocketAddr>,
    reports: SyncSender<Report>,
    last: Option<Box<Snapshot>>,
    flushed: Instant,
    sent: Instant,
}

impl SinkWorker {
    fn new(config: SceneConfig, open: Box<Open>, reports: SyncSender<Report>) -> Self {
        let SceneConfig { recordings, closed, view, wall_clock } = config;
        let router = recordings.map(|folder| Router::new(folder, closed, wall_clock, open));
        Self { router, live: None, view, reports, last: None, flushed: Instant::now(), sent: Instant::now() }
    }

    fn run(mut self, drain: &Drain) {
        if let Some(address) = self.view.take() {
            self.serve(address);
        }
        if let Some(router) = &mut self.router {
            router.recover();
        }
        self.tell();
        loop {
            match drain.next(PATIENCE) {
                Ok(Some(Item::End)) | Err(_) => break,
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
            self.tell();
        }
        if let Some(live) = &mut self.live {
            live.flush();
        }
        if let Some(router) = &mut self.router {
            router.end(drain.dropped.counts());
        }
        self.tell();
    }

    fn take(&mut self, item: Item, drain: &Drain) {
        match item {
            Item::Picture(picture) => {
                if let Some(live) = &mut self.live {
                    live.picture(&picture);
                }
                if let Some(router) = &mut self.router {
                    router.picture(Arc::new(*picture));
                }
            }
            Item::Events(events, snapshot) => {
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
            Item::Film(version, film) => {
                if let Some(router) = &mut self.router {
                    router.film(&version, &film);
                }
            }
            Item::Serve(address) => self.serve(address),
            Item::End => {}
        }
    }

    fn serve(&mut self, address: SocketAddr) {
        if let Some(live) = &self.live {
            // There is one live scene; who asks again is told where.
            self.say(Report::Serving { url: live.url().to_owned() });
            return;
        }
        match LiveServer::start(address) {
            Ok((mut live, report)) => {
                if let Some(snapshot) = &self.last {
                    live.look(snapshot);
                }
                self.live = Some(live);
                self.say(report);
            }
            Err(problem) => self.say(Report::NotServing { text: problem.sentence() }),
        }
    }

    fn tell(&mut self) {
        let reports = self.router.as_mut().map(Router::reports).unwrap_or_default();
        for report in reports {
            self.say(report);
        }
    }

    fn say(&self, report: Report) {
        // Who does not listen misses it: an ended file that is not on record is told again at the next start.
        let _ = self.reports.try_send(report);
    }
}
