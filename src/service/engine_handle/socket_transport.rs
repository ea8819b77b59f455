//! The engine of another process, used like a local one: one thread receives its data, another sends requests, and a stop
//! waits for neither.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use tokio::sync::{mpsc, watch};

use super::remote_engine::{code, stop};
use super::update::{EngineEndError, EngineUpdate, OUTSTANDING_MAX};
use super::{RequestRejected, take_place};
use crate::control_socket::{
    Client, ConsoleConnection, ConsoleMessage, ControlSocketError, PresenceSender, StopCall, UnverifiedOrigin,
};
use holdpoint_approvals::Nonce;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_store::Layout;
use holdpoint_text::Hint as _;
use holdpoint_wording::program::engine::ended_by;

/// How long the reader waits for a message before it checks that a receiver is left.
const RECEIVE_TIMEOUT: Duration = Duration::from_millis(250);

/// The channels for received data.
type DisplayChannels = (
    mpsc::Sender<EngineUpdate>,
    watch::Sender<Option<Arc<Snapshot>>>,
    watch::Sender<Option<Arc<VideoFrame>>>,
);

/// See the module comment.
pub(super) struct SocketTransport {
    layout: Layout,
    requests: SyncSender<Request>,
    outstanding: Arc<AtomicUsize>,
    updates: mpsc::Sender<EngineUpdate>,
    /// Makes this console's request ids unique: every console counts from the same number.
    id_prefix: Nonce,
    console: u64,
    process: i32,
    unverified_origin: Option<UnverifiedOrigin>,
    presence: ConsolePresence,
    presence_sender: PresenceSender,
}

impl SocketTransport {
    /// Attaches to the engine.
    pub(super) fn start(
        layout: &Layout,
        client: Client,
        presence: ConsolePresence,
        channels: DisplayChannels,
    ) -> Result<Self, ControlSocketError> {
        let attachment = client.attach(presence.clone())?;
        let (console, process, presence_sender) =
            (attachment.console_number(), attachment.process(), attachment.presence_sender()?);
        let unverified_origin = attachment.unverified_origin();
        let (requests, incoming) = sync_channel(OUTSTANDING_MAX);
        let outstanding = Arc::new(AtomicUsize::new(0));
        let updates = channels.0.clone();
        let thread = |name: &str| std::thread::Builder::new().name(name.to_owned());
        let path = layout.folder().to_owned();
        let failed =
            |source| ControlSocketError::Io { what: "start a thread for", path: path.clone(), source };
        thread("attached-reader").spawn(move || receive(attachment, &channels)).map_err(failed)?;
        let id_prefix = Nonce::random()?;
        let (asker_layout, asker_prefix) = (layout.clone(), id_prefix.clone());
        let (answers, places) = (updates.clone(), Arc::clone(&outstanding));
        thread("attached-asker")
            .spawn(move || {
                forward_requests(
                    (&asker_layout, &asker_prefix, unverified_origin),
                    &incoming,
                    &answers,
                    &places,
                );
            })
            .map_err(failed)?;
        Ok(Self {
            layout: layout.clone(),
            requests,
            outstanding,
            updates,
            id_prefix,
            console,
            process,
            unverified_origin,
            presence,
            presence_sender,
        })
    }

    /// Process id of the engine.
    pub(super) const fn process(&self) -> i32 {
        self.process
    }

    /// Why the data is not known to come from the engine.
    pub(super) const fn unverified_origin(&self) -> Option<UnverifiedOrigin> {
        self.unverified_origin
    }

    /// Sends the presence if it changed. Returns the console's number.
    pub(super) fn set_presence(&mut self, presence: ConsolePresence) -> u64 {
        if presence != self.presence {
            self.presence = presence.clone();
            self.presence_sender.send_presence(presence);
        }
        self.console
    }

    /// As [`super::EngineHandle::submit`]. A request that stops the arm or tightens an envelope uses a separate connection, since
    /// earlier requests may be answered late.
    pub(super) fn submit(&self, request: Request) -> Result<(), RequestRejected> {
        let is_stop = matches!(request.command, Command::Stop { .. });
        let has_place = take_place(&self.outstanding);
        if !has_place && !is_stop {
            return Err(RequestRejected::Busy(Box::new(request)));
        }
        if request.command.stops_what_acts() || request.command.stops_the_arm() {
            let (layout, updates, places) =
                (self.layout.clone(), self.updates.clone(), Arc::clone(&self.outstanding));
            let (stop_request, id_prefix, origin) =
                (request.clone(), self.id_prefix.clone(), self.unverified_origin);
            let spawned = std::thread::Builder::new().name("attached-stop".to_owned()).spawn(move || {
                let place = has_place.then_some(&*places);
                send_and_deliver(&mut None, (&layout, &id_prefix, origin), stop_request, &updates, place);
            });
            if spawned.is_ok() {
                return Ok(());
            }
        }
        self.requests.try_send(request).map_err(|refused| {
            if has_place {
                give_place_back(&self.outstanding);
            }
            match refused {
                TrySendError::Full(request) => RequestRejected::Busy(Box::new(request)),
                TrySendError::Disconnected(request) => RequestRejected::Ended(Box::new(request)),
            }
        })
    }
}

fn give_place_back(outstanding: &AtomicUsize) {
    let decrement = |count: usize| Some(count.saturating_sub(1));
    let _ = outstanding.fetch_update(Ordering::AcqRel, Ordering::Acquire, decrement);
}

/// Receives data until no receiver is left or the engine is gone. Waits for a slow front end: the engine drops what this
/// does not read, and sends the count.
fn receive(mut attachment: ConsoleConnection, (updates, snapshots, frames): &DisplayChannels) {
    let mut is_up = false;
    while !updates.is_closed() {
        let message = match attachment.next(RECEIVE_TIMEOUT) {
            Ok(None) => continue,
            Ok(Some(message)) => message,
            Err(error) => {
                snapshots.send_replace(None);
                let fault = match error {
                    ControlSocketError::Closed { text, .. } => EngineEndError::reported(text),
                    error => EngineEndError::of(error.sentence()),
                };
                drop(updates.blocking_send(EngineUpdate::Ended(Err(fault))));
                return;
            }
        };
        let update = match message {
            ConsoleMessage::Event(event) => EngineUpdate::Events(vec![*event]),
            ConsoleMessage::Missed(missed) => EngineUpdate::Lagged { missed },
            ConsoleMessage::Snapshot(snapshot) => {
                // A snapshot from before the record was read is shown, but no request is possible yet.
                let comes_up = !is_up && snapshot.reading.is_none();
                snapshots.send_replace(Some(Arc::from(snapshot)));
                if !comes_up {
                    continue;
                }
                is_up = true;
                EngineUpdate::Started
            }
            ConsoleMessage::Picture(frame) => {
                frames.send_replace(Some(Arc::from(frame)));
                continue;
            }
            ConsoleMessage::Past { events, earlier } => EngineUpdate::Past { events, earlier },
            ConsoleMessage::Ended { by } => {
                let text = ended_by(&by);
                drop(updates.blocking_send(EngineUpdate::Ended(Err(EngineEndError::orderly(text)))));
                return;
            }
        };
        if updates.blocking_send(update).is_err() {
            return;
        }
    }
}

/// Sends one request after the other, until no sender is left.
fn forward_requests(
    to: (&Layout, &Nonce, Option<UnverifiedOrigin>),
    incoming: &Receiver<Request>,
    updates: &mpsc::Sender<EngineUpdate>,
    places: &AtomicUsize,
) {
    let mut client = None;
    while let Ok(request) = incoming.recv() {
        send_and_deliver(&mut client, to, request, updates, Some(places));
    }
}

/// Sends a request and delivers its reply to the front end.
fn send_and_deliver(
    client: &mut Option<Client>,
    (layout, id_prefix, console_origin): (&Layout, &Nonce, Option<UnverifiedOrigin>),
    request: Request,
    updates: &mpsc::Sender<EngineUpdate>,
    places: Option<&AtomicUsize>,
) {
    let id = request.id.clone();
    let sent = Request { id: format!("{}-{id}", id_prefix.as_str()), ..request };
    let reply = if let Command::Stop { by, reason } = sent.command {
        stop(&StopCall::with_id(sent.id, by, reason), layout)
    } else {
        send_request(client, (layout, console_origin), sent)
            .unwrap_or_else(|error| Reply::refused(code(&error), &error))
    };
    if let Some(places) = places {
        give_place_back(places);
    }
    // The receiver may be gone.
    drop(updates.blocking_send(EngineUpdate::Answer { id, reply }));
}

/// Sends over the present connection, or a new one: the engine closes idle ones, and runs a request id only once. If the
/// origin of this console's own connection is unverified, the screen marks the data it reads. Otherwise requests go only to
/// a process that is known to be the engine.
fn send_request(
    client: &mut Option<Client>,
    (layout, console_origin): (&Layout, Option<UnverifiedOrigin>),
    request: Request,
) -> Result<Reply, ControlSocketError> {
    let ended = || ControlSocketError::Ended { path: crate::control_socket::socket_path(layout) };
    let mut connection = match client.take() {
        Some(connection) => connection,
        None => Client::connect(layout)?.ok_or_else(ended)?,
    };
    let (only_reads, takes_authority) =
        (request.command.only_reads(), request.command.takes_authority_away());
    if let Some(origin) = connection.unverified_origin()
        && (console_origin.is_none() || !(only_reads || takes_authority))
    {
        return Ok(origin.unasked());
    }
    let reply = connection.send_request(request)?;
    let origin = connection.unverified_origin();
    *client = Some(connection);
    // The screen marks data that was read; whether a command ran is unknown.
    Ok(match origin.filter(|_| !only_reads) {
        Some(origin) => origin.in_place_of(&reply),
        None => reply,
    })
}
