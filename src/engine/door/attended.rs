//! A connection that is a seat: events, the newest snapshot and the newest picture, to whoever reads them in time.
//!
//! What is shown is written into a document once for all seats, when one of them sends it: nobody attached costs nothing,
//! and the engine's own thread does none of it.

use std::io;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use serde::Serialize;
use tokio::io::{AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::{broadcast, mpsc, watch};
use tokio::task::JoinSet;

use super::seats::Seat;
use super::server::{DoorServer, Read, read_call, write};
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::seat::Sitting;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::wire::{self, Answer, Call};

/// The most changes of a seat that wait to be read.
const SITTINGS_MAX: usize = 8;

/// What a connection is told that wants a seat where there are none.
pub const SHOWN_TO_NOBODY: &str =
    "this engine shows itself to nobody: it works for a script or a plain stream";

/// What is shown to whoever is attached: the same that the front end beside the engine is shown.
#[derive(Clone, Debug)]
pub struct LiveViews {
    pub snapshots: watch::Receiver<Option<Arc<Snapshot>>>,
    pub pictures: watch::Receiver<Option<Arc<Picture>>>,
}

/// The views, once there are any, and the newest document of each.
#[derive(Debug, Default)]
pub(super) struct Shown {
    views: OnceLock<LiveViews>,
    snapshot: Document<Snapshot>,
    picture: Document<Picture>,
}

impl Shown {
    /// There are views from now on.
    pub(super) fn set(&self, views: LiveViews) {
        drop(self.views.set(views));
    }

    fn views(&self) -> Option<LiveViews> {
        self.views.get().cloned()
    }
}

/// Something with the document that was written of it.
#[derive(Debug)]
struct Document<T>(Mutex<Option<(Arc<T>, Arc<str>)>>);

impl<T> Default for Document<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

/// An answer with a reference in it: nothing has to be cloned to be written.
#[derive(Serialize)]
#[serde(rename_all = "kebab-case", tag = "answer")]
enum ShownAnswer<'a> {
    Snapshot { snapshot: &'a Snapshot },
    Picture { picture: &'a Picture },
}

impl<T> Document<T> {
    fn of(
        &self,
        what: &Arc<T>,
        write: impl FnOnce(&T) -> serde_json::Result<String>,
    ) -> io::Result<Arc<str>> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, line)) = kept.as_ref().filter(|(of, _)| Arc::ptr_eq(of, what)) {
            return Ok(Arc::clone(line));
        }
        let line: Arc<str> = write(what)?.into();
        *kept = Some((Arc::clone(what), Arc::clone(&line)));
        Ok(line)
    }
}

/// What a seat is sent next.
enum Next {
    Line(Arc<str>),
    Nothing,
    /// The client says something that has no place here.
    Bad(String),
    Gone,
    Ending,
}

impl DoorServer {
    /// Shows the engine to a seat until its client goes or the door closes.
    pub(super) async fn attend(
        &self,
        reader: BufReader<OwnedReadHalf>,
        mut writer: OwnedWriteHalf,
        process: Option<u32>,
        sitting: Sitting,
    ) -> io::Result<()> {
        if let Some(text) = sitting.problem() {
            return write(&mut writer, &Answer::Closed { text }).await;
        }
        let Some(mut views) = self.shown.views() else {
            let text = SHOWN_TO_NOBODY.to_owned();
            return write(&mut writer, &Answer::Closed { text }).await;
        };
        let seat = self.seats.sit(process, sitting);
        let mut events = self.events.subscribe();
        write(&mut writer, &Answer::Attached { seat: seat.number() }).await?;
        // What is there already is new to whoever comes.
        views.snapshots.mark_changed();
        views.pictures.mark_changed();
        // A line that was read half must not be lost to what else happens: it has a task of its own.
        let (said, mut sayings) = mpsc::channel(SITTINGS_MAX);
        let mut reading = JoinSet::new();
        reading.spawn(listen(reader, said));
        loop {
            match self.next(&seat, &mut views, &mut events, &mut sayings).await? {
                Next::Line(line) => {
                    tokio::select! {
                        () = self.stop.cancelled() => return Ok(()),
                        written = writer.write_all(line.as_bytes()) => written?,
                    }
                }
                Next::Nothing => {}
                Next::Bad(text) => return write(&mut writer, &Answer::Closed { text }).await,
                Next::Gone => return Ok(()),
                Next::Ending => return self.rest(events, writer).await,
            }
        }
    }

    async fn next(
        &self,
        seat: &Seat,
        views: &mut LiveViews,
        events: &mut broadcast::Receiver<Arc<str>>,
        sayings: &mut mpsc::Receiver<Read>,
    ) -> io::Result<Next> {
        Ok(tokio::select! {
            () = self.stop.cancelled() => Next::Ending,
            said = sayings.recv() => match said {
                Some(Read::Call(Call::Sit { sitting })) => match sitting.problem() {
                    None => {
                        seat.say(sitting);
                        Next::Nothing
                    }
                    Some(text) => Next::Bad(text),
                },
                Some(Read::Call(_)) => {
                    Next::Bad("a connection that is attached takes `sit` alone: ask on another one".to_owned())
                }
                Some(Read::Bad(text)) => Next::Bad(text),
                Some(Read::Nothing) | None => Next::Gone,
            },
            told = events.recv() => match told {
                Ok(line) => Next::Line(line),
                Err(broadcast::error::RecvError::Lagged(missed)) => {
                    Next::Line(wire::line(&Answer::Lagged { missed })?.into())
                }
                Err(broadcast::error::RecvError::Closed) => Next::Gone,
            },
            Ok(()) = views.snapshots.changed() => {
                let newest = views.snapshots.borrow_and_update().clone();
                let document = newest.map(|snapshot| {
                    let write = |snapshot: &Snapshot| wire::line(&ShownAnswer::Snapshot { snapshot });
                    self.shown.snapshot.of(&snapshot, write)
                });
                document.transpose()?.map_or(Next::Nothing, Next::Line)
            }
            Ok(()) = views.pictures.changed() => {
                let newest = views.pictures.borrow_and_update().clone();
                let document = newest.map(|picture| {
                    let write = |picture: &Picture| wire::line(&ShownAnswer::Picture { picture });
                    self.shown.picture.of(&picture, write)
                });
                document.transpose()?.map_or(Next::Nothing, Next::Line)
            }
        })
    }
}

/// Reads what a client says until it goes, or says what it must not.
async fn listen(mut reader: BufReader<OwnedReadHalf>, said: mpsc::Sender<Read>) {
    loop {
        let read = read_call(&mut reader).await.unwrap_or(Read::Nothing);
        let goes_on = matches!(read, Read::Call(_));
        if said.send(read).await.is_err() || !goes_on {
            return;
        }
    }
}
