//! The socket's thread: accepts connections, checks the account, reads calls, writes answers.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncWrite, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{broadcast, oneshot};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, timeout};
use tokio_util::sync::CancellationToken;

use super::accounts::{AllowedAccounts, ClientAccount};
use super::attached_console::{EventBacklog, LET_GO_AFTER, LiveDocuments};
use super::call_line::{ReadLine, SHORT_CALL_BYTES_MAX, read_call};
use super::connection_limits::{ASKING_MAX, ConnectionLimits, Crowding, IDLE_MAX};
use super::console_registry::ConsoleRegistry;
use super::fd_reserve;
use super::socket_file::{BoundSocket, SocketPlace};
use super::{SceneServerSlot, SignalHandling, SocketMessage};
use holdpoint_engine::decide::halt::{self, StopFollowUp};
use holdpoint_engine::live::stop_switch::{StopRequest, StopSwitch};
use holdpoint_protocol::account_role::AccountRole;
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply};
use holdpoint_protocol::wire::{
    self, ANSWER_BYTES_MAX, CALL_BYTES_MAX, ClientMessage, ID_BYTES_MAX, PROTOCOL, ServerMessage,
};
use holdpoint_record::caller;
use holdpoint_store::StopMarks;
use holdpoint_wording::program::engine::ENDED_BY_SIGNAL;

/// How long a connection may stay silent.
const IDLE_TIME_MAX: Duration = Duration::from_mins(1);

/// How long a client may take to read a reply.
const WRITE_MAX: Duration = Duration::from_secs(10);

/// How long the thread waits for open connections when the socket closes.
const CLOSING_MAX: Duration = Duration::from_millis(500);

/// How long a stop waits for the engine's own answer; the arm stops meanwhile. While another program locks the database,
/// the engine cannot write its record and cannot answer either.
const STOP_ANSWER_MAX: Duration = Duration::from_secs(1);

/// How long it may take to store a stop beside the record.
const STOP_KEPT_MAX: Duration = Duration::from_secs(1);

/// What helps with a request that has a field or a value that is not allowed.
const SCHEMA_HINT: &str = "`holdpoint schema command` prints the fields and the values of every command";

/// Interval between checks that the socket still has its name.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long a connection beyond the limit may stay silent.
const CROWDED_TIME_MAX: Duration = Duration::from_secs(1);

/// How many turns others get to close before a connection counts as open.
const TURNS_TO_CLOSE: usize = 4;

/// Pause after a failed accept, so that a lack of file descriptors does not keep a core busy.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// The data of the socket's thread.
#[derive(Clone)]
pub(super) struct ControlSocketServer {
    pub(super) requests: SyncSender<SocketMessage>,
    /// A separate queue for requests that take authority away.
    pub(super) braking: SyncSender<SocketMessage>,
    /// A separate queue for cheap requests, which others' reads do not delay.
    pub(super) looking: SyncSender<SocketMessage>,
    /// Whether a wake is queued: at most one, since it takes a place among the requests.
    pub(super) woken: Arc<AtomicBool>,
    pub(super) events: broadcast::Sender<Arc<str>>,
    pub(super) endings: Arc<AtomicUsize>,
    pub(super) cancel: Arc<AtomicBool>,
    pub(super) switch: Arc<StopSwitch>,
    pub(super) stop: CancellationToken,
    pub(super) classes: ConnectionLimits,
    pub(super) consoles: Arc<ConsoleRegistry>,
    pub(super) shown: Arc<LiveDocuments>,
    pub(super) past: Arc<Mutex<EventBacklog>>,
    pub(super) scenes: SceneServerSlot,
    pub(super) names_taken: Arc<AtomicU64>,
    pub(super) accounts: AllowedAccounts,
    /// Stores a stop that the engine does not record in time.
    pub(super) marks: StopMarks,
}

impl ControlSocketServer {
    pub(super) fn start(self, listener: BoundSocket, signals: SignalHandling) -> io::Result<JoinHandle<()>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let listener = {
            let _inside = runtime.enter();
            if signals == SignalHandling::Handled {
                for kind in [SignalKind::terminate(), SignalKind::interrupt(), SignalKind::hangup()] {
                    let (server, mut signal) = (self.clone(), signal(kind)?);
                    runtime.spawn(async move {
                        while signal.recv().await.is_some() {
                            server.consoles.note_ending(|| ENDED_BY_SIGNAL.to_owned());
                            if server.endings.fetch_add(1, Ordering::AcqRel) > 0 {
                                server.cancel.store(true, Ordering::Release);
                            }
                            // A full queue wakes the engine as well.
                            server.wake();
                        }
                    });
                }
            }
            (UnixListener::from_std(listener.listener)?, listener.place)
        };
        std::thread::Builder::new().name("engine-door".to_owned()).spawn(move || {
            runtime.block_on(self.accept(listener));
            runtime.shutdown_timeout(CLOSING_MAX);
        })
    }

    /// Wakes a waiting engine. A full queue wakes it as well.
    fn wake(&self) {
        if !self.woken.swap(true, Ordering::AcqRel) && self.requests.try_send(SocketMessage::Wake).is_err() {
            self.woken.store(false, Ordering::Release);
        }
    }

    async fn accept(self, (mut listener, mut place): (UnixListener, SocketPlace)) {
        let mut open = JoinSet::new();
        let mut lost = false;
        let mut look = tokio::time::interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let most = fd_reserve::connections_max();
        let mut spare = fd_reserve::spare();
        loop {
            let accepted = tokio::select! {
                () = self.stop.cancelled() => break,
                _ = look.tick() => {
                    // Removing the name also removed the way to stop the cell. A failed attempt is repeated.
                    if place.is_ours() {
                        continue;
                    }
                    if !std::mem::replace(&mut lost, true) {
                        self.names_taken.fetch_add(1, Ordering::AcqRel);
                        self.wake();
                    }
                    if let Ok(rebound) = place.rebind()
                        && let Ok(bound_listener) = UnixListener::from_std(rebound.listener)
                    {
                        (listener, place, lost) = (bound_listener, rebound.place, false);
                    }
                    continue;
                }
                Some(_) = open.join_next(), if !open.is_empty() => continue,
                accepted = listener.accept() => accepted,
            };
            let Ok((stream, _)) = accepted else {
                // No descriptors are left: the spare one serves the connection that waits.
                self.classes.make_room();
                if spare.take().is_none() {
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
                continue;
            };
            let mut crowded = open.len() >= most;
            if crowded && self.classes.make_room() {
                // It closes at its next turn.
                for _ in 0..TURNS_TO_CLOSE {
                    tokio::task::yield_now().await;
                    while open.try_join_next().is_some() {}
                }
                crowded = open.len() >= most;
            }
            if open.len() >= most + fd_reserve::CROWDED_MAX {
                continue;
            }
            spare = spare.or_else(fd_reserve::spare);
            let Ok(peer) = stream.peer_cred() else { continue };
            // A process of another account gets no answer.
            let Some(account) = self.accounts.of(peer.uid()) else { continue };
            let connection = self.classes.begin_connection(account.uid);
            let beyond = if account.is_owner { 0 } else { connection.beyond_limit() };
            if beyond > fd_reserve::CROWDED_MAX {
                continue;
            }
            let crowding = match (crowded, beyond) {
                (true, _) => Some(Crowding::Process),
                (false, 0) => None,
                (false, _) => Some(Crowding::Account),
            };
            let caller = caller::named(peer.uid(), peer.pid().and_then(|pid| u32::try_from(pid).ok()));
            let server = self.clone();
            open.spawn(async move {
                // A client that disconnects or does not read is not an error of the engine.
                drop(server.connection(stream, (caller, account), crowding).await);
                drop(connection);
            });
        }
        drop(listener);
        let closing = async { while open.join_next().await.is_some() {} };
        drop(timeout(CLOSING_MAX, closing).await);
    }

    /// `crowding`: why there is no room for it, so that its first request must take authority away.
    async fn connection(
        self,
        stream: UnixStream,
        (caller, account): (Caller, ClientAccount),
        crowding: Option<Crowding>,
    ) -> io::Result<()> {
        let (mut reader, mut writer) = greet(stream).await?;
        let call_bytes_max = match account.role {
            AccountRole::Observer => SHORT_CALL_BYTES_MAX,
            AccountRole::Operator | AccountRole::Administrator => CALL_BYTES_MAX,
        };
        let idle_max = if crowding.is_some() { CROWDED_TIME_MAX } else { IDLE_TIME_MAX };
        loop {
            let silent = self.classes.begin_idle();
            let call = tokio::select! {
                () = self.stop.cancelled() => return Ok(()),
                () = silent.gives_way() => {
                    let text = format!("there is room for {IDLE_MAX} connections that ask for nothing at most, and others were newer; connect again");
                    return write(&mut writer, &ServerMessage::Closed { text }).await;
                }
                read = timeout(idle_max, read_call(&mut reader, call_bytes_max)) => match read {
                    Ok(call) => call?,
                    Err(_) => return Ok(()),
                },
            };
            drop(silent);
            match call {
                ReadLine::Nothing => return Ok(()),
                ReadLine::Refused(text) if crowding.is_none() => {
                    let hint = Some(SCHEMA_HINT.to_owned());
                    let reply = Box::new(Reply::Refused { code: Refusal::BadInput, text, hint });
                    write(&mut writer, &ServerMessage::Reply { reply }).await?;
                }
                ReadLine::Bad(text) | ReadLine::Refused(text) => {
                    return write(&mut writer, &ServerMessage::Closed { text }).await;
                }
                ReadLine::Call(call) if crowding.is_some() && !takes_authority_away(&call) => {
                    let text = crowding.map(Crowding::text).unwrap_or_default();
                    return write(&mut writer, &ServerMessage::Closed { text }).await;
                }
                ReadLine::Call(call @ (ClientMessage::Subscribe {} | ClientMessage::Attach { .. })) => {
                    let _place = match self.classes.observer(account) {
                        Ok(place) => place,
                        Err(text) => return write(&mut writer, &ServerMessage::Closed { text }).await,
                    };
                    return match call {
                        ClientMessage::Attach { sitting } => {
                            self.attend(reader, writer, (&caller, account.role), sitting).await
                        }
                        _ => self.send_events(reader, writer).await,
                    };
                }
                ReadLine::Call(ClientMessage::Keep {} | ClientMessage::Scene { .. })
                    if account.role < AccountRole::Operator =>
                {
                    let text = account.refusal(AccountRole::Operator).unwrap_or_default();
                    return write(&mut writer, &ServerMessage::Closed { text }).await;
                }
                ReadLine::Call(ClientMessage::Keep {}) => {
                    self.consoles.disable_idle_exit();
                    write(&mut writer, &ServerMessage::Kept).await?;
                }
                ReadLine::Call(ClientMessage::Scene { address }) => {
                    // The process that starts an engine may have it listen for other machines; a client may not.
                    let served =
                        address.ip().is_loopback() && self.scenes.get().is_some_and(|serve| serve(address));
                    write(&mut writer, &ServerMessage::Scene { served }).await?;
                }
                ReadLine::Call(ClientMessage::Sit { .. }) => {
                    let text = "this connection is not attached: `attach` comes first".to_owned();
                    return write(&mut writer, &ServerMessage::Closed { text }).await;
                }
                ReadLine::Call(ClientMessage::Ask { request }) => {
                    let needed = AccountRole::needed_for(&request.command);
                    let reply = match account.refusal(needed) {
                        None => self.handle_request(request, &caller).await,
                        Some(text) => {
                            let uid = account.uid;
                            let hint = format!(
                                "the option `--account {uid}={needed}` of `holdpoint serve` gives the role"
                            );
                            Reply::Refused { code: Refusal::NotAllowed, text, hint: Some(hint) }
                        }
                    };
                    write(&mut writer, &ServerMessage::Reply { reply: Box::new(reply) }).await?;
                }
            }
        }
    }

    async fn handle_request(
        &self,
        request: Box<holdpoint_protocol::command::Request>,
        caller: &Caller,
    ) -> Reply {
        let mut stop = None;
        if let Command::Stop { by, reason } = &request.command {
            // At once, whatever the engine does, and however many requests wait.
            let (id, by, reason) = (request.id.clone(), by.clone(), reason.clone());
            let stop_request = StopRequest { id, by, reason, caller: caller.clone() };
            self.switch.halt(stop_request.clone());
            stop = Some(stop_request);
        }
        let refused = |code, text: &str| Reply::Refused { code, text: text.to_owned(), hint: None };
        if request.id.is_empty() || request.id.len() > ID_BYTES_MAX {
            let text = format!("the id of a command has 1 to {ID_BYTES_MAX} bytes, not {}", request.id.len());
            return refused(Refusal::BadInput, &text);
        }
        let Some(_place) = self.classes.request(&request.command) else {
            return self.late(stop, StopFollowUp::Next).await;
        };
        let (answer, reply) = oneshot::channel();
        let id = request.id.clone();
        // At once as well: the version loses control now, whatever the engine does.
        self.switch.brake(&request);
        let brakes = request.command.takes_authority_away();
        let looks = matches!(request.command, Command::Snapshot | Command::Question { .. });
        let queue = match (brakes, looks) {
            (true, _) => &self.braking,
            (false, true) => &self.looking,
            (false, false) => &self.requests,
        };
        match queue.try_send(SocketMessage::Request(request, caller.clone(), answer)) {
            // It wakes a waiting engine; a full queue wakes it as well.
            Ok(()) if brakes || looks => self.wake(),
            Ok(()) => {}
            Err(TrySendError::Full(_)) => {
                self.switch.taken(&id);
                return self.late(stop, StopFollowUp::Next).await;
            }
            Err(TrySendError::Disconnected(_)) => return self.ended(stop).await,
        }
        // An engine that ends drops waiting requests; the first of the two events answers.
        tokio::select! {
            biased;
            reply = reply => match reply {
                Ok(reply) => reply,
                Err(_) => self.ended(stop).await,
            },
            () = self.stop.cancelled() => self.ended(stop).await,
            () = tokio::time::sleep(STOP_ANSWER_MAX), if stop.is_some() => self.late(stop, StopFollowUp::Next).await,
        }
    }

    /// The answer of an engine that ends; a stop is stored for the next engine.
    async fn ended(&self, stop: Option<StopRequest>) -> Reply {
        match stop {
            Some(_) => self.late(stop, StopFollowUp::NextEngine).await,
            None => {
                let text = "the engine is ending".to_owned();
                Reply::Refused { code: Refusal::NotNow, text, hint: None }
            }
        }
    }

    /// The answer where the engine does not answer in time. A stop is stored beside the record until then.
    async fn late(&self, stop: Option<StopRequest>, follow_up: StopFollowUp) -> Reply {
        let Some(request) = stop else {
            return Reply::Refused {
                code: Refusal::NotNow,
                text: format!("{ASKING_MAX} requests are being answered, the most allowed"),
                hint: Some("try again in a moment; `stop` needs no place".to_owned()),
            };
        };
        // While stops wait, the first of them is stored; it stops the next engine for all.
        let first = self.switch.first_stop();
        let marks = self.marks.clone();
        let store = move || halt::stopped_meanwhile(first.as_ref().unwrap_or(&request), &marks, follow_up);
        let reply = timeout(STOP_KEPT_MAX, tokio::task::spawn_blocking(store)).await;
        reply.ok().and_then(Result::ok).unwrap_or_else(|| halt::stopped_in_memory(follow_up, None))
    }

    /// Sends events until the client disconnects or the socket closes. A slow client receives the number of lost events; one
    /// that reads nothing is disconnected, so that it keeps no place.
    async fn send_events(
        &self,
        mut reader: BufReader<OwnedReadHalf>,
        mut writer: OwnedWriteHalf,
    ) -> io::Result<()> {
        let mut events = self.events.subscribe();
        write(&mut writer, &ServerMessage::Subscribed).await?;
        loop {
            let next = tokio::select! {
                () = self.stop.cancelled() => return self.rest(events, &mut writer).await,
                // The client disconnects, or sends a call that is not allowed here.
                _ = reader.fill_buf() => return Ok(()),
                told = events.recv() => told,
            };
            let line = match next {
                Ok(line) => line,
                Err(broadcast::error::RecvError::Lagged(missed)) => {
                    wire::line(&ServerMessage::Lagged { missed })?.into()
                }
                Err(broadcast::error::RecvError::Closed) => return Ok(()),
            };
            tokio::select! {
                () = self.stop.cancelled() => return Ok(()),
                _ = reader.fill_buf() => return Ok(()),
                written = write_event(&mut writer, line.as_bytes(), LET_GO_AFTER) => written?,
            }
        }
    }

    /// Sends the remaining events when the socket closes.
    pub(super) async fn rest(
        &self,
        mut events: broadcast::Receiver<Arc<str>>,
        writer: &mut OwnedWriteHalf,
    ) -> io::Result<()> {
        let send = async {
            loop {
                let line = match events.try_recv() {
                    Ok(line) => line,
                    Err(broadcast::error::TryRecvError::Lagged(missed)) => {
                        wire::line(&ServerMessage::Lagged { missed })?.into()
                    }
                    Err(broadcast::error::TryRecvError::Empty | broadcast::error::TryRecvError::Closed) => {
                        return Ok(());
                    }
                };
                writer.write_all(line.as_bytes()).await?;
            }
        };
        timeout(CLOSING_MAX, send).await.unwrap_or(Ok(()))
    }
}

fn takes_authority_away(call: &ClientMessage) -> bool {
    matches!(call, ClientMessage::Ask { request } if request.command.takes_authority_away())
}

/// Both halves of a connection after the greeting.
async fn greet(stream: UnixStream) -> io::Result<(BufReader<OwnedReadHalf>, OwnedWriteHalf)> {
    let (reader, mut writer) = stream.into_split();
    let version = env!("CARGO_PKG_VERSION").to_owned();
    write(&mut writer, &ServerMessage::Hello { protocol: PROTOCOL, version, process: std::process::id() })
        .await?;
    Ok((BufReader::new(reader), writer))
}

pub(super) async fn write(writer: &mut OwnedWriteHalf, answer: &ServerMessage) -> io::Result<()> {
    let mut line = wire::line(answer)?;
    if line.len() > ANSWER_BYTES_MAX {
        let text = format!("the answer has {} bytes; at most {ANSWER_BYTES_MAX} are allowed", line.len());
        line = wire::line(&ServerMessage::Closed { text })?;
    }
    match timeout(WRITE_MAX, writer.write_all(line.as_bytes())).await {
        Ok(written) => written,
        Err(_) => Err(io::ErrorKind::TimedOut.into()),
    }
}

/// Writes a line to a subscriber.
///
/// # Errors
/// [`io::ErrorKind::TimedOut`] if it reads nothing for so long.
async fn write_event(
    writer: &mut (impl AsyncWrite + Unpin),
    line: &[u8],
    let_go_after: Duration,
) -> io::Result<()> {
    let mut rest = line;
    while !rest.is_empty() {
        let written =
            timeout(let_go_after, writer.write(rest)).await.map_err(|_| io::ErrorKind::TimedOut)??;
        if written == 0 {
            return Err(io::ErrorKind::WriteZero.into());
        }
        rest = rest.get(written..).unwrap_or_default();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Such a subscriber kept its place for as long as it lived.
    #[tokio::test]
    async fn a_subscriber_that_reads_nothing_is_disconnected() {
        let (mut writer, _reader) = tokio::io::duplex(64);
        let limit = Duration::from_millis(50);
        write_event(&mut writer, &[b'x'; 64], limit).await.unwrap();
        let error = write_event(&mut writer, b"x", limit).await.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::TimedOut);
    }
}
