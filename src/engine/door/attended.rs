//! A connection that is a seat: events, the newest snapshot and the newest picture, to whoever reads them in time.
//!
//! What is shown is written into a document once for all seats, when one of them sends it: nobody attached costs nothing,
//! and the engine's own thread does none of it.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use serde::Serialize;
use tokio::io::{AsyncWrite, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::{broadcast, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::seats::Seat;
use super::server::{DoorServer, Read, read_call, write};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::picture::Picture;
use holdpoint_protocol::seat::Sitting;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::wire::{self, Answer, Call};

/// The most changes of a seat that wait to be read.
const SITTINGS_MAX: usize = 8;

/// How long a seat may take nothing before the others are shown that it does not read.
pub const READS_WITHIN: Duration = Duration::from_secs(5);

/// How long a seat may take nothing before it is let go. A console that comes to itself again sits down anew.
pub const LET_GO_AFTER: Duration = Duration::from_secs(20);

/// The most events that whoever sits down is told of what was before.
pub const PAST_MAX: usize = 200;

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

/// The newest events, for whoever sits down later.
#[derive(Debug, Default)]
pub(super) struct Past {
    events: VecDeque<Event>,
    earlier: u64,
}

impl Past {
    /// Keeps an event. Progress is in the snapshot, and a run of sequences is one line of a story.
    pub(super) fn note(&mut self, event: &Event) {
        let is_sequence = |event: &Event| matches!(event.kind, EventKind::Sequence { .. });
        if matches!(event.kind, EventKind::Progress { .. }) {
            return;
        }
        if let Some(last) = self.events.back_mut().filter(|last| is_sequence(last) && is_sequence(event)) {
            last.clone_from(event);
            return;
        }
        if self.events.len() >= PAST_MAX {
            self.events.pop_front();
            self.earlier += 1;
        }
        self.events.push_back(event.clone());
    }

    fn told(&self) -> Answer {
        Answer::Past { events: self.events.iter().cloned().collect(), earlier: self.earlier }
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
        // Nothing happens in between: what is not in the one is told by the other.
        let (past, mut events) = {
            let past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
            (past.told(), self.events.subscribe())
        };
        write(&mut writer, &Answer::Attached { seat: seat.number() }).await?;
        write(&mut writer, &past).await?;
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
                        written = show(&mut writer, line.as_bytes(), &seat, (READS_WITHIN, LET_GO_AFTER)) => {
                            written?;
                        }
                    }
                }
                Next::Nothing => {}
                Next::Bad(text) => return write(&mut writer, &Answer::Closed { text }).await,
                Next::Gone => return Ok(()),
                Next::Ending => {
                    self.rest(events, &mut writer).await?;
                    if let Some(text) = self.seats.failure() {
                        return write(&mut writer, &Answer::Closed { text }).await;
                    }
                    return match self.seats.ending() {
                        Some(by) => write(&mut writer, &Answer::Ended { by }).await,
                        None => Ok(()),
                    };
                }
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

/// Writes a line to a seat that may take nothing for so long before it is shown as not reading, and for so long before it is
/// let go. One that is slow and takes something is waited for: nobody else waits.
async fn show(
    writer: &mut (impl AsyncWrite + Unpin),
    line: &[u8],
    seat: &Seat,
    (reads_within, let_go_after): (Duration, Duration),
) -> io::Result<()> {
    let mut rest = line;
    while !rest.is_empty() {
        let written = match timeout(reads_within, writer.write(rest)).await {
            Ok(written) => written?,
            Err(_) => {
                seat.reads(false);
                let patience = let_go_after.saturating_sub(reads_within);
                timeout(patience, writer.write(rest)).await.map_err(|_| io::ErrorKind::TimedOut)??
            }
        };
        if written == 0 {
            return Err(io::ErrorKind::WriteZero.into());
        }
        seat.reads(true);
        rest = rest.get(written..).unwrap_or_default();
    }
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::door::seats::Seats;

    /// A console that was stopped was shown as present for ever, and its connection was never closed.
    #[tokio::test]
    async fn who_takes_nothing_is_shown_as_such_and_let_go() {
        let seats = Arc::new(Seats::default());
        let seat = seats.sit(Some(7), Sitting::default());
        let reads = || !seats.views()[0].not_reading;
        let (mut writer, mut reader) = tokio::io::duplex(64);
        let limits = (Duration::from_millis(50), Duration::from_mins(5));
        let line = [b'x'; 200];
        // It takes nothing at first, and then all of it.
        let late = async {
            while reads() {
                tokio::task::yield_now().await;
            }
            let mut taken = vec![0; line.len()];
            tokio::io::AsyncReadExt::read_exact(&mut reader, &mut taken).await.unwrap();
        };
        let (shown, ()) = tokio::join!(show(&mut writer, &line, &seat, limits), late);
        shown.unwrap();
        assert!(reads(), "it reads again");
        // It never takes anything.
        let limits = (Duration::from_millis(50), Duration::from_millis(100));
        let error = show(&mut writer, &line, &seat, limits).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert!(!reads());
    }

    #[test]
    fn what_was_before_is_bounded_and_a_run_of_sequences_is_one_line() {
        let mut past = Past::default();
        let sequence = |index| EventKind::Sequence { index, success: true, tasks: Vec::new(), refused: None };
        let fault = |text: String| EventKind::Fault { text };
        for seq in 0..1_000 {
            past.note(&Event { seq, at_ms: seq, kind: sequence(seq) });
        }
        assert_eq!((past.events.len(), past.events[0].seq, past.earlier), (1, 999, 0));
        for seq in 1_000..1_000 + PAST_MAX as u64 {
            past.note(&Event { seq, at_ms: seq, kind: fault(seq.to_string()) });
        }
        assert_eq!((past.events.len(), past.events[0].seq, past.earlier), (PAST_MAX, 1_000, 1));
    }
}
