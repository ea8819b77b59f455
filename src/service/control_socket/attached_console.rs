//! The connection of an attached console: events, the newest snapshot and the newest camera frame.
//!
//! Each state is serialized once for all consoles, when the first connection sends it. Without an attached console it costs
//! nothing, and the engine's own thread does none of it.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use serde::Serialize;
use tokio::io::{AsyncWrite, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::sync::{broadcast, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout};

use super::call_line::{ReadLine, SHORT_CALL_BYTES_MAX, read_call};
use super::console_registry::ConsoleRegistration;
use super::server::{ControlSocketServer, write};
use holdpoint_protocol::account_role::AccountRole;
use holdpoint_protocol::command::Caller;
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_protocol::wire::{self, ClientMessage, ServerMessage};

/// The most unread presence changes of a console.
const SITTINGS_MAX: usize = 8;

/// How long a console may read nothing before the others show it as not reading.
pub const READS_WITHIN: Duration = Duration::from_secs(5);

/// How long a console may read nothing before the engine closes its connection. The console may attach again.
pub const LET_GO_AFTER: Duration = Duration::from_secs(20);

/// Between two video frames for a console, and between two frames that it draws for data, ms: 8 a second take under 3 % of a
/// core.
pub const FRAME_INTERVAL_MS: u64 = 125;

/// The most earlier events that a newly attached console receives.
pub const PAST_MAX: usize = 200;

/// The answer to a console that attaches to an engine without views.
pub const SHOWN_TO_NOBODY: &str = "this engine accepts no console: it runs a script or writes a plain stream";

/// The views of an attached console, the same as for the console beside the engine.
#[derive(Clone, Debug)]
pub struct LiveViews {
    pub snapshots: watch::Receiver<Option<Arc<Snapshot>>>,
    pub frames: watch::Receiver<Option<Arc<VideoFrame>>>,
}

/// The views, once set, and the newest document of each.
#[derive(Debug, Default)]
pub(super) struct LiveDocuments {
    views: OnceLock<LiveViews>,
    snapshot: Document<Snapshot>,
    frame: Document<VideoFrame>,
}

impl LiveDocuments {
    pub(super) fn set(&self, views: LiveViews) {
        drop(self.views.set(views));
    }

    fn views(&self) -> Option<LiveViews> {
        self.views.get().cloned()
    }
}

/// The newest events, for consoles that attach later.
#[derive(Debug, Default)]
pub(super) struct EventBacklog {
    events: VecDeque<Event>,
    earlier: u64,
}

impl EventBacklog {
    /// Adds an event. Skips progress, which is in the snapshot, and merges a run of sequences into one line.
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

    fn to_answer(&self) -> ServerMessage {
        ServerMessage::Past { events: self.events.iter().cloned().collect(), earlier: self.earlier }
    }
}

/// A value with its serialized document.
#[derive(Debug)]
struct Document<T>(Mutex<Option<(Arc<T>, Arc<str>)>>);

impl<T> Default for Document<T> {
    fn default() -> Self {
        Self(Mutex::new(None))
    }
}

/// An answer by reference, serialized without cloning.
#[derive(Serialize)]
#[serde(rename_all = "kebab-case", tag = "answer")]
enum BorrowedAnswer<'a> {
    Snapshot { snapshot: &'a Snapshot },
    Picture { picture: &'a VideoFrame },
}

impl<T> Document<T> {
    fn of(
        &self,
        what: &Arc<T>,
        write: impl FnOnce(&T) -> serde_json::Result<String>,
    ) -> io::Result<Arc<str>> {
        let mut cached = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, line)) = cached.as_ref().filter(|(of, _)| Arc::ptr_eq(of, what)) {
            return Ok(Arc::clone(line));
        }
        let line: Arc<str> = write(what)?.into();
        *cached = Some((Arc::clone(what), Arc::clone(&line)));
        Ok(line)
    }
}

enum NextMessage {
    Line(Arc<str>),
    Nothing,
    /// The client sent a call that is not allowed here.
    Bad(String),
    Gone,
    Ending,
}

impl ControlSocketServer {
    /// Serves an attached console until its client disconnects or the socket closes.
    pub(super) async fn attend(
        &self,
        reader: BufReader<OwnedReadHalf>,
        mut writer: OwnedWriteHalf,
        (caller, role): (&Caller, AccountRole),
        presence: ConsolePresence,
    ) -> io::Result<()> {
        if let Some(text) = presence.invalid_field() {
            return write(&mut writer, &ServerMessage::Closed { text }).await;
        }
        let Some(mut views) = self.shown.views() else {
            let text = SHOWN_TO_NOBODY.to_owned();
            return write(&mut writer, &ServerMessage::Closed { text }).await;
        };
        let seat = self.consoles.attach(caller, role, presence);
        // Atomic: every event is either in the backlog or in the subscription.
        let (past, mut events) = {
            let past = self.past.lock().unwrap_or_else(PoisonError::into_inner);
            (past.to_answer(), self.events.subscribe())
        };
        write(&mut writer, &ServerMessage::Attached { seat: seat.number() }).await?;
        write(&mut writer, &past).await?;
        // The present values are new to this console.
        views.snapshots.mark_changed();
        views.frames.mark_changed();
        // A task of its own reads, so that other events do not drop a half-read line.
        let (sender, mut calls) = mpsc::channel(SITTINGS_MAX);
        let mut reading = JoinSet::new();
        reading.spawn(listen(reader, sender));
        let mut frame_due = Instant::now();
        loop {
            match self.next(&seat, (&mut views, &mut frame_due), &mut events, &mut calls).await? {
                NextMessage::Line(line) => {
                    tokio::select! {
                        () = self.stop.cancelled() => return Ok(()),
                        written = show(&mut writer, line.as_bytes(), &seat, (READS_WITHIN, LET_GO_AFTER)) => {
                            written?;
                        }
                    }
                }
                NextMessage::Nothing => {}
                NextMessage::Bad(text) => return write(&mut writer, &ServerMessage::Closed { text }).await,
                NextMessage::Gone => return Ok(()),
                NextMessage::Ending => {
                    self.rest(events, &mut writer).await?;
                    if let Some(text) = self.consoles.failure() {
                        return write(&mut writer, &ServerMessage::Closed { text }).await;
                    }
                    return match self.consoles.ending() {
                        Some(by) => write(&mut writer, &ServerMessage::Ended { by }).await,
                        None => Ok(()),
                    };
                }
            }
        }
    }

    async fn next(
        &self,
        seat: &ConsoleRegistration,
        (views, frame_due): (&mut LiveViews, &mut Instant),
        events: &mut broadcast::Receiver<Arc<str>>,
        sayings: &mut mpsc::Receiver<ReadLine>,
    ) -> io::Result<NextMessage> {
        Ok(tokio::select! {
            () = self.stop.cancelled() => NextMessage::Ending,
            said = sayings.recv() => match said {
                Some(ReadLine::Call(ClientMessage::Sit { sitting })) => match sitting.invalid_field() {
                    None => {
                        seat.set_presence(sitting);
                        NextMessage::Nothing
                    }
                    Some(text) => NextMessage::Bad(text),
                },
                Some(ReadLine::Call(_)) => {
                    NextMessage::Bad("an attached connection accepts only `sit`: use another connection".to_owned())
                }
                Some(ReadLine::Bad(text) | ReadLine::Refused(text)) => NextMessage::Bad(text),
                Some(ReadLine::Nothing) | None => NextMessage::Gone,
            },
            told = events.recv() => match told {
                Ok(line) => NextMessage::Line(line),
                Err(broadcast::error::RecvError::Lagged(missed)) => {
                    NextMessage::Line(wire::line(&ServerMessage::Lagged { missed })?.into())
                }
                Err(broadcast::error::RecvError::Closed) => NextMessage::Gone,
            },
            Ok(()) = views.snapshots.changed() => {
                let newest = views.snapshots.borrow_and_update().clone();
                let document = newest.map(|snapshot| {
                    let write = |snapshot: &Snapshot| wire::line(&BorrowedAnswer::Snapshot { snapshot });
                    self.shown.snapshot.of(&snapshot, write)
                });
                document.transpose()?.map_or(NextMessage::Nothing, NextMessage::Line)
            }
            Ok(()) = newer_frame(&mut views.frames, frame_due) => {
                let newest = views.frames.borrow_and_update().clone();
                let document = newest.map(|picture| {
                    let write = |picture: &VideoFrame| wire::line(&BorrowedAnswer::Picture { picture });
                    self.shown.frame.of(&picture, write)
                });
                document.transpose()?.map_or(NextMessage::Nothing, NextMessage::Line)
            }
        })
    }
}

/// Waits until a frame is due and there is one that the console has not received. The next one is due an interval later.
async fn newer_frame<T>(
    frames: &mut watch::Receiver<T>,
    due: &mut Instant,
) -> Result<(), watch::error::RecvError> {
    sleep_until(*due).await;
    frames.changed().await?;
    *due = Instant::now() + Duration::from_millis(FRAME_INTERVAL_MS);
    Ok(())
}

/// Writes a line to a console. After the first limit without progress the console counts as not reading, after the second
/// the connection is closed. A slow console that reads something is waited for, which delays no one else.
async fn show(
    writer: &mut (impl AsyncWrite + Unpin),
    line: &[u8],
    seat: &ConsoleRegistration,
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

/// Reads the client's calls until it disconnects, or sends one that is not allowed.
async fn listen(mut reader: BufReader<OwnedReadHalf>, sender: mpsc::Sender<ReadLine>) {
    loop {
        let read = read_call(&mut reader, SHORT_CALL_BYTES_MAX).await.unwrap_or(ReadLine::Nothing);
        let goes_on = matches!(read, ReadLine::Call(_));
        if sender.send(read).await.is_err() || !goes_on {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control_socket::console_registry::ConsoleRegistry;

    /// A stopped console was shown as present forever, and its connection was never closed.
    #[tokio::test]
    async fn a_console_that_reads_nothing_is_disconnected() {
        let seats = Arc::new(ConsoleRegistry::default());
        let seat = seats.attach(&Caller::Script, AccountRole::Observer, ConsolePresence::default());
        let reads = || !seats.views()[0].not_reading;
        let (mut writer, mut reader) = tokio::io::duplex(64);
        let limits = (Duration::from_millis(50), Duration::from_mins(5));
        let line = [b'x'; 200];
        // It reads nothing at first, and then everything.
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
        // It never reads anything.
        let limits = (Duration::from_millis(50), Duration::from_millis(100));
        let error = show(&mut writer, &line, &seat, limits).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
        assert!(!reads());
    }

    /// Each of 30 frames a second was sent, and the console drew a quarter of them.
    #[tokio::test]
    async fn newer_frames_are_an_interval_apart_and_the_newest_is_sent() {
        let begun = Instant::now();
        let (sender, mut frames) = watch::channel(0);
        let mut due = begun;
        sender.send_replace(1);
        newer_frame(&mut frames, &mut due).await.unwrap();
        let waiting = newer_frame(&mut frames, &mut due);
        sender.send_replace(2);
        waiting.await.unwrap();
        assert!(begun.elapsed() >= Duration::from_millis(FRAME_INTERVAL_MS));
        assert_eq!(*frames.borrow_and_update(), 2);
    }

    #[test]
    fn the_backlog_is_bounded_and_merges_sequences() {
        let mut past = EventBacklog::default();
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
