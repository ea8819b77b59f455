//! The socket's thread: accepts, checks who it is, reads calls, writes answers.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::unix::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{UnixListener, UnixStream};
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::{broadcast, oneshot};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, timeout};
use tokio_util::sync::CancellationToken;

use super::accounts::{Account, Accounts};
use super::attended::{Past, Shown};
use super::classes::{ASKING_MAX, Classes, IDLE_MAX, OBSERVERS_MAX};
use super::room;
use super::seats::Seats;
use super::socket::{BoundSocket, SocketPlace};
use super::{Incoming, Scenes, Signals};
use crate::caller;
use crate::halt;
use crate::world::switch::{AskedStop, Switch};
use holdpoint_protocol::command::{Caller, Command, Refusal, Reply, StopKept};
use holdpoint_protocol::wire::{
    self, ANSWER_BYTES_MAX, Answer, CALL_BYTES_MAX, Call, ID_BYTES_MAX, PROTOCOL,
};
use holdpoint_registry::StopMarks;

/// How long a connection may say nothing.
const IDLE_TIME_MAX: Duration = Duration::from_mins(1);

/// How long a reply may take to be read.
const WRITE_MAX: Duration = Duration::from_secs(10);

/// How long open connections are waited for when the door closes.
const CLOSING_MAX: Duration = Duration::from_millis(500);

/// How long a stop waits for the engine's own answer. The arm is being stopped meanwhile; an engine that cannot write its
/// record, because another program keeps the database for itself, would keep the answer as well.
const STOP_ANSWER_MAX: Duration = Duration::from_secs(1);

/// How long it may take to keep a stop beside the record.
const STOP_KEPT_MAX: Duration = Duration::from_secs(1);

/// What becomes of a stop that the engine has not put on record yet.
const NEXT: &str = "the engine puts it on record next";

/// How often it is looked whether the socket still has its name.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// How long a connection may say nothing for which there is no room.
const CROWDED_TIME_MAX: Duration = Duration::from_secs(1);

/// How often others get their turn before a connection that gave way is taken for open.
const TURNS_TO_CLOSE: usize = 4;

/// Pause after a failed accept, so that a lack of file descriptors does not take a core.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// What the socket's thread works with.
#[derive(Clone)]
pub(super) struct DoorServer {
    pub(super) requests: SyncSender<Incoming>,
    /// What takes authority away has a queue of its own.
    pub(super) braking: SyncSender<Incoming>,
    /// So have looks, which others' reading does not keep waiting.
    pub(super) looking: SyncSender<Incoming>,
    /// Whether a wake is on its way: there is one at a time, for it takes a place among the requests.
    pub(super) woken: Arc<AtomicBool>,
    pub(super) events: broadcast::Sender<Arc<str>>,
    pub(super) endings: Arc<AtomicUsize>,
    pub(super) cancel: Arc<AtomicBool>,
    pub(super) switch: Arc<Switch>,
    pub(super) stop: CancellationToken,
    pub(super) classes: Classes,
    pub(super) seats: Arc<Seats>,
    pub(super) shown: Arc<Shown>,
    pub(super) past: Arc<Mutex<Past>>,
    pub(super) scenes: Scenes,
    pub(super) names_taken: Arc<AtomicU64>,
    pub(super) accounts: Accounts,
    /// Where a stop is kept that the engine does not put on record in time.
    pub(super) marks: StopMarks,
}

impl DoorServer {
    pub(super) fn start(self, listener: BoundSocket, signals: Signals) -> io::Result<JoinHandle<()>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let listener = {
            let _inside = runtime.enter();
            if signals == Signals::Taken {
                for kind in [SignalKind::terminate(), SignalKind::interrupt(), SignalKind::hangup()] {
                    let (server, mut signal) = (self.clone(), signal(kind)?);
                    runtime.spawn(async move {
                        while signal.recv().await.is_some() {
                            server.seats.note_ending(|| "a signal to its process".to_owned());
                            if server.endings.fetch_add(1, Ordering::AcqRel) > 0 {
                                server.cancel.store(true, Ordering::Release);
                            }
                            // A full queue wakes the engine just as well.
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

    /// Wakes an engine that waits. A full queue wakes it just as well.
    fn wake(&self) {
        if !self.woken.swap(true, Ordering::AcqRel) && self.requests.try_send(Incoming::Wake).is_err() {
            self.woken.store(false, Ordering::Release);
        }
    }

    async fn accept(self, (mut listener, mut place): (UnixListener, SocketPlace)) {
        let mut open = JoinSet::new();
        let mut lost = false;
        let mut look = tokio::time::interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let most = room::connections_max();
        let mut spare = room::spare();
        loop {
            let accepted = tokio::select! {
                () = self.stop.cancelled() => break,
                _ = look.tick() => {
                    // Whoever removed it took the way to stop with it. What cannot be had now is tried again.
                    if place.is_ours() {
                        continue;
                    }
                    if !std::mem::replace(&mut lost, true) {
                        self.names_taken.fetch_add(1, Ordering::AcqRel);
                        self.wake();
                    }
                    if let Ok(anew) = place.bind_anew()
                        && let Ok(anew_listener) = UnixListener::from_std(anew.listener)
                    {
                        (listener, place, lost) = (anew_listener, anew.place, false);
                    }
                    continue;
                }
                Some(_) = open.join_next(), if !open.is_empty() => continue,
                accepted = listener.accept() => accepted,
            };
            let Ok((stream, _)) = accepted else {
                // There are no descriptors left: the spare one is for whoever is at the door.
                self.classes.make_room();
                if spare.take().is_none() {
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                }
                continue;
            };
            let mut crowded = open.len() >= most;
            if crowded && self.classes.make_room() {
                // It closes as soon as it is its turn.
                for _ in 0..TURNS_TO_CLOSE {
                    tokio::task::yield_now().await;
                    while open.try_join_next().is_some() {}
                }
                crowded = open.len() >= most;
            }
            if open.len() >= most + room::CROWDED_MAX {
                continue;
            }
            spare = spare.or_else(room::spare);
            let Ok(peer) = stream.peer_cred() else { continue };
            // Somebody else's process gets no word.
            let Some(account) = self.accounts.of(peer.uid()) else { continue };
            let caller = caller::named(peer.uid(), peer.pid().and_then(|pid| u32::try_from(pid).ok()));
            let server = self.clone();
            open.spawn(async move {
                // A client that goes away, or does not read, has only itself to tell.
                drop(server.connection(stream, (caller, account), crowded).await);
            });
        }
        drop(listener);
        let closing = async { while open.join_next().await.is_some() {} };
        drop(timeout(CLOSING_MAX, closing).await);
    }

    /// `crowded`: there is no room for it, and it has to take authority away at once.
    async fn connection(
        self,
        stream: UnixStream,
        (caller, account): (Caller, Account),
        crowded: bool,
    ) -> io::Result<()> {
        let (mut reader, mut writer) = greeted(stream).await?;
        let idle_max = if crowded { CROWDED_TIME_MAX } else { IDLE_TIME_MAX };
        loop {
            let silent = self.classes.silent();
            let call = tokio::select! {
                () = self.stop.cancelled() => return Ok(()),
                () = silent.gives_way() => {
                    let text = format!("there is room for {IDLE_MAX} connections that ask for nothing at most, and others were newer; connect again");
                    return write(&mut writer, &Answer::Closed { text }).await;
                }
                read = timeout(idle_max, read_call(&mut reader)) => match read {
                    Ok(call) => call?,
                    Err(_) => return Ok(()),
                },
            };
            drop(silent);
            match call {
                Read::Nothing => return Ok(()),
                Read::Bad(text) => return write(&mut writer, &Answer::Closed { text }).await,
                Read::Call(call) if crowded && !takes_authority_away(&call) => {
                    let text = "this process has no file descriptors left for more connections; one that stops the cell or takes a version's authority away is heard".to_owned();
                    return write(&mut writer, &Answer::Closed { text }).await;
                }
                Read::Call(call @ (Call::Subscribe {} | Call::Attach { .. })) => {
                    let Some(_place) = self.classes.observer() else {
                        let text = format!(
                            "{OBSERVERS_MAX} connections are told events, which is all there may be: end one that watches this engine"
                        );
                        return write(&mut writer, &Answer::Closed { text }).await;
                    };
                    return match call {
                        Call::Attach { sitting } => {
                            let process = match caller {
                                Caller::Process { process, .. } => process,
                                Caller::Script => None,
                            };
                            self.attend(reader, writer, process, sitting).await
                        }
                        _ => self.tell(reader, writer).await,
                    };
                }
                Read::Call(Call::Keep {}) => {
                    self.seats.keep();
                    write(&mut writer, &Answer::Kept).await?;
                }
                Read::Call(Call::Scene { address }) => {
                    // Whoever starts an engine may have it listen for other machines; nobody who asks it may.
                    let served =
                        address.ip().is_loopback() && self.scenes.get().is_some_and(|serve| serve(address));
                    write(&mut writer, &Answer::Scene { served }).await?;
                }
                Read::Call(Call::Sit { .. }) => {
                    let text = "nobody sits here: `attach` comes first".to_owned();
                    return write(&mut writer, &Answer::Closed { text }).await;
                }
                Read::Call(Call::Ask { request }) => {
                    let reply = if account.may(request.command.authority()) {
                        self.ask(request, &caller).await
                    } else {
                        let text = "this account may not ask for that here".to_owned();
                        Reply::Refused { code: Refusal::NotAllowed, text, hint: None }
                    };
                    write(&mut writer, &Answer::Reply { reply: Box::new(reply) }).await?;
                }
            }
        }
    }

    async fn ask(&self, request: Box<holdpoint_protocol::command::Request>, caller: &Caller) -> Reply {
        let mut stop = None;
        if let Command::Stop { by, reason } = &request.command {
            // Here and now, whatever the engine is at, and however many requests wait.
            let (id, by, reason) = (request.id.clone(), by.clone(), reason.clone());
            let asked = AskedStop { id, by, reason, caller: caller.clone() };
            self.switch.halt(asked.clone());
            stop = Some(asked);
        }
        let refused = |code, text: &str| Reply::Refused { code, text: text.to_owned(), hint: None };
        if request.id.is_empty() || request.id.len() > ID_BYTES_MAX {
            let text = format!("the id of a command has 1 to {ID_BYTES_MAX} bytes, not {}", request.id.len());
            return refused(Refusal::BadInput, &text);
        }
        let Some(_place) = self.classes.request(&request.command) else { return self.late(stop, NEXT).await };
        let (answer, reply) = oneshot::channel();
        let id = request.id.clone();
        // Here and now as well: who is at work under that version is so no more, whatever the engine is at.
        self.switch.brake(&request);
        let brakes = request.command.takes_authority_away();
        let looks = matches!(request.command, Command::Snapshot | Command::Question { .. });
        let queue = match (brakes, looks) {
            (true, _) => &self.braking,
            (false, true) => &self.looking,
            (false, false) => &self.requests,
        };
        match queue.try_send(Incoming::Request(request, caller.clone(), answer)) {
            // An engine that waits for something wakes by it; a full queue wakes it just as well.
            Ok(()) if brakes || looks => self.wake(),
            Ok(()) => {}
            Err(TrySendError::Full(_)) => {
                self.switch.taken(&id);
                return self.late(stop, NEXT).await;
            }
            Err(TrySendError::Disconnected(_)) => return self.ended(stop).await,
        }
        // An engine that ends drops what waits; whoever comes first says so.
        tokio::select! {
            biased;
            reply = reply => match reply {
                Ok(reply) => reply,
                Err(_) => self.ended(stop).await,
            },
            () = self.stop.cancelled() => self.ended(stop).await,
            () = tokio::time::sleep(STOP_ANSWER_MAX), if stop.is_some() => self.late(stop, NEXT).await,
        }
    }

    /// The answer where the engine ends: nothing works any more, and a stop is kept for the next engine.
    async fn ended(&self, stop: Option<AskedStop>) -> Reply {
        match stop {
            Some(_) => self.late(stop, "this engine ends, and the next one puts it on record").await,
            None => {
                let text = "the engine is ending".to_owned();
                Reply::Refused { code: Refusal::NotNow, text, hint: None }
            }
        }
    }

    /// The answer for somebody whom the engine does not answer in time: a stop is kept beside the record meanwhile, until
    /// what is `next`.
    async fn late(&self, stop: Option<AskedStop>, next: &'static str) -> Reply {
        let Some(asked) = stop else {
            return Reply::Refused {
                code: Refusal::NotNow,
                text: format!("{ASKING_MAX} requests are being answered, which is all there may be"),
                hint: Some("try again in a moment; `stop` needs no place".to_owned()),
            };
        };
        // As long as one waits, the first of them is kept, which stops the next engine for all.
        let first = self.switch.first_asked();
        let marks = self.marks.clone();
        let keep = move || halt::stopped_meanwhile(first.as_ref().unwrap_or(&asked), &marks, next);
        let kept = timeout(STOP_KEPT_MAX, tokio::task::spawn_blocking(keep)).await;
        kept.ok().and_then(Result::ok).unwrap_or_else(|| Reply::Stopped {
            text: format!("the cell is stopped; {next}; until then {}", halt::KEPT_NOWHERE),
            kept: StopKept::InMemory,
        })
    }

    /// Tells events until the client goes away or the door closes. A slow client is told what it missed.
    async fn tell(&self, mut reader: BufReader<OwnedReadHalf>, mut writer: OwnedWriteHalf) -> io::Result<()> {
        let mut events = self.events.subscribe();
        write(&mut writer, &Answer::Subscribed).await?;
        loop {
            let told = tokio::select! {
                () = self.stop.cancelled() => return self.rest(events, &mut writer).await,
                // The end of the client, or something it must not say here.
                _ = reader.fill_buf() => return Ok(()),
                told = events.recv() => told,
            };
            let line = match told {
                Ok(line) => line,
                Err(broadcast::error::RecvError::Lagged(missed)) => {
                    wire::line(&Answer::Lagged { missed })?.into()
                }
                Err(broadcast::error::RecvError::Closed) => return Ok(()),
            };
            tokio::select! {
                () = self.stop.cancelled() => return Ok(()),
                _ = reader.fill_buf() => return Ok(()),
                written = writer.write_all(line.as_bytes()) => written?,
            }
        }
    }

    /// What was still to be told when the door closed.
    pub(super) async fn rest(
        &self,
        mut events: broadcast::Receiver<Arc<str>>,
        writer: &mut OwnedWriteHalf,
    ) -> io::Result<()> {
        let tell = async {
            loop {
                let line = match events.try_recv() {
                    Ok(line) => line,
                    Err(broadcast::error::TryRecvError::Lagged(missed)) => {
                        wire::line(&Answer::Lagged { missed })?.into()
                    }
                    Err(broadcast::error::TryRecvError::Empty | broadcast::error::TryRecvError::Closed) => {
                        return Ok(());
                    }
                };
                writer.write_all(line.as_bytes()).await?;
            }
        };
        timeout(CLOSING_MAX, tell).await.unwrap_or(Ok(()))
    }
}

fn takes_authority_away(call: &Call) -> bool {
    matches!(call, Call::Ask { request } if request.command.takes_authority_away())
}

/// Both halves of a connection that was told who serves it.
async fn greeted(stream: UnixStream) -> io::Result<(BufReader<OwnedReadHalf>, OwnedWriteHalf)> {
    let (reader, mut writer) = stream.into_split();
    let version = env!("CARGO_PKG_VERSION").to_owned();
    write(&mut writer, &Answer::Hello { protocol: PROTOCOL, version, process: std::process::id() }).await?;
    Ok((BufReader::new(reader), writer))
}

pub(super) enum Read {
    Call(Call),
    Nothing,
    Bad(String),
}

pub(super) async fn read_call(reader: &mut BufReader<OwnedReadHalf>) -> io::Result<Read> {
    let mut line = Vec::new();
    let limit = CALL_BYTES_MAX as u64 + 1;
    reader.take(limit).read_until(b'\n', &mut line).await?;
    if line.last() != Some(&b'\n') {
        let long = line.len() > CALL_BYTES_MAX;
        let text = format!("a line has more than {CALL_BYTES_MAX} bytes, which is not allowed");
        return Ok(if long { Read::Bad(text) } else { Read::Nothing });
    }
    Ok(match serde_json::from_slice(&line) {
        Ok(call) => Read::Call(call),
        Err(error) => Read::Bad(format!("this is no call of protocol {PROTOCOL}: {error}")),
    })
}

pub(super) async fn write(writer: &mut OwnedWriteHalf, answer: &Answer) -> io::Result<()> {
    let mut line = wire::line(answer)?;
    if line.len() > ANSWER_BYTES_MAX {
        let text = format!("the answer has {} bytes; at most {ANSWER_BYTES_MAX} are allowed", line.len());
        line = wire::line(&Answer::Closed { text })?;
    }
    match timeout(WRITE_MAX, writer.write_all(line.as_bytes())).await {
        Ok(written) => written,
        Err(_) => Err(io::ErrorKind::TimedOut.into()),
    }
}
