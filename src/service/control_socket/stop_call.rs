//! A stop of the cell by an engine in another process, requested by a mark in the store's folder and over the socket at
//! the same time. It counts as one stop; only the process that has the store confirms it.

use std::io::ErrorKind;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use super::ControlSocketError;
use super::client::Client;
use holdpoint_approvals::Nonce;
use holdpoint_engine::live::stop_mark::{self, OwnStopMark};
use holdpoint_protocol::command::{Command, Reply, Request, StopPersistence};
use holdpoint_store::{Layout, LockHolder, lock_holder};
use holdpoint_text::Hint as _;

/// How long the caller waits for a confirmation.
const CONFIRMED_WITHIN: Duration = Duration::from_secs(3);

/// How long the caller waits for the engine at its socket; less than the above, so that the error names the reason.
const HELLO_WITHIN: Duration = Duration::from_secs(2);

/// How long the caller waits for the engine's answer once the engine has taken the mark.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);

/// Interval between checks of the mark.
const LOOK_EVERY: Duration = Duration::from_millis(5);

pub const NOT_CONFIRMED_HINT: &str =
    "press the emergency stop of the cell; `holdpoint status` shows what the store says";

/// The text for a stop that is not confirmed.
#[must_use]
pub fn not_confirmed(why: &str) -> String {
    format!("it is NOT CONFIRMED that the arm is stopped: {why}")
}

/// A stop of the cell, to be requested.
#[derive(Clone, Debug)]
pub struct StopCall {
    request: Request,
    by: String,
    reason: String,
}

#[derive(Debug)]
pub enum StopOutcome {
    /// The engine answered over the socket.
    Answered(Reply),
    /// The engine stopped the cell by the mark; the reason why its answer is missing.
    Marked(String),
    /// No process has the store.
    NoEngine,
    /// It is not known whether the arm is stopped; the reason.
    NotConfirmed(String),
}

/// The result of the call over the socket.
enum SocketAnswer {
    Engine(Reply),
    /// No answer that is known to come from the engine; the reason.
    Nothing(String),
    /// A process answered that has no store here, such as one that relays the socket; what it says.
    Unverified(String),
}

impl StopCall {
    /// A stop with a new id.
    ///
    /// # Errors
    /// If the system gives no random number.
    pub fn new(by: String, reason: String) -> Result<Self, ControlSocketError> {
        Ok(Self::with_id(Nonce::random()?.as_str().to_owned(), by, reason))
    }

    /// A stop with this id.
    #[must_use]
    pub fn with_id(id: String, by: String, reason: String) -> Self {
        let command = Command::Stop { by: by.clone(), reason: reason.clone() };
        Self { request: Request::unsigned(id, command), by, reason }
    }

    /// The request, for an engine in this process.
    #[must_use]
    pub fn request(&self) -> Request {
        self.request.clone()
    }

    /// Removes the mark of this stop if no engine is there to take it.
    pub fn withdraw(&self, layout: &Layout) {
        stop_mark::settle(layout, &self.request.id);
    }

    /// Asks the engine of the store, if there is one, and waits for the confirmation, at most 3 s.
    #[must_use]
    pub fn send(&self, layout: &Layout) -> StopOutcome {
        let until = Instant::now() + CONFIRMED_WITHIN;
        let mut mark = StopMarkAttempt::default();
        // The mark precedes the request over the socket: the engine sees it even if another process answers there.
        mark.put(layout, self);
        let (sender, answers) = sync_channel(1);
        let (request, of) = (self.request.clone(), layout.clone());
        let builder = std::thread::Builder::new().name("stop-asker".to_owned());
        let mut failure = builder
            .spawn(move || send_over_socket(&of, &request, until, &sender))
            .err()
            .map(|error| format!("no thread could be started: {error}"));
        let mut taken_at: Option<Instant> = None;
        loop {
            if failure.is_none() {
                match next(&answers) {
                    Some(SocketAnswer::Engine(reply)) => {
                        mark.settle(layout, self, &reply);
                        return StopOutcome::Answered(reply);
                    }
                    Some(SocketAnswer::Nothing(why)) => failure = Some(why),
                    Some(SocketAnswer::Unverified(why)) => {
                        // No engine takes a mark from this folder.
                        self.withdraw(layout);
                        return StopOutcome::NotConfirmed(why);
                    }
                    None => {}
                }
            } else {
                std::thread::sleep(LOOK_EVERY);
            }
            let holder = lock_holder(layout.folder());
            // In another PID namespace the kernel does not show whether an engine took it.
            if taken_at.is_none() && holder != LockHolder::Untold {
                mark.put(layout, self);
            }
            if holder == LockHolder::Nobody && failure.is_some() {
                return StopOutcome::NoEngine;
            }
            if taken_at.is_none()
                && matches!(holder, LockHolder::Process(process) if mark.is_taken_by(process))
            {
                taken_at = Some(Instant::now());
            }
            if let Some(since) = taken_at
                && (failure.is_some() || since.elapsed() > ANSWER_WITHIN)
            {
                let silent = || "no process answered at the socket".to_owned();
                return StopOutcome::Marked(failure.unwrap_or_else(silent));
            }
            if Instant::now() >= until {
                mark.put_behind(layout, self);
                return StopOutcome::NotConfirmed(unconfirmed_reason(holder, failure, &mark));
            }
        }
    }
}

fn unconfirmed_reason(holder: LockHolder, failure: Option<String>, mark: &StopMarkAttempt) -> String {
    let mut why = failure.unwrap_or_else(|| {
        let secs = CONFIRMED_WITHIN.as_secs();
        match holder {
            LockHolder::Process(process) => {
                format!("process {process}, which has the store, did not answer within {secs} s")
            }
            LockHolder::Nobody | LockHolder::Untold => format!("no process answered within {secs} s"),
        }
    });
    if mark.is_behind {
        why.push_str(
            "; another stop was requested before and is not taken either: this one waits behind it in the store's folder",
        );
    } else if let Some(problem) = &mark.problem {
        why.push_str(&format!("; no mark could be put into the store's folder: {problem}"));
    } else if holder == LockHolder::Untold {
        why.push_str("; a mark of the stop was made in the store's folder, but it is unknown whether an engine took it");
    } else {
        why.push_str(
            "; the mark of the stop was made in the store's folder, and no engine is known to have taken it",
        );
    }
    why
}

fn next(answers: &Receiver<SocketAnswer>) -> Option<SocketAnswer> {
    match answers.recv_timeout(LOOK_EVERY) {
        Ok(answer) => Some(answer),
        Err(RecvTimeoutError::Timeout) => None,
        Err(RecvTimeoutError::Disconnected) => {
            Some(SocketAnswer::Nothing("the asking thread failed".to_owned()))
        }
    }
}

#[derive(Default)]
struct StopMarkAttempt {
    own: Option<OwnStopMark>,
    /// Why there is no mark.
    problem: Option<String>,
    /// Whether another attempt would fail as well.
    refused: bool,
    /// Whether its own mark was missing at the last check.
    was_removed: bool,
    /// Whether its own mark waits behind that of another stop.
    is_behind: bool,
}

impl StopMarkAttempt {
    /// Creates the mark unless it exists. While another stop's mark exists, the next call tries again. Creates the mark
    /// again if it was removed and no engine has taken it.
    fn put(&mut self, layout: &Layout, stop: &StopCall) {
        if let Some(own) = &self.own {
            // An engine shares the mark's lock before it removes the mark; the next check sees that.
            if !std::mem::replace(&mut self.was_removed, own.is_removed()) || !self.was_removed {
                return;
            }
            (self.own, self.was_removed) = (None, false);
        }
        if self.refused {
            return;
        }
        match OwnStopMark::put(layout, &stop.request.id, &stop.by, &stop.reason) {
            Ok(own) => (self.own, self.problem) = (Some(own), None),
            Err(error) => {
                self.refused = error.kind() != ErrorKind::AlreadyExists;
                self.problem = Some(error.to_string());
            }
        }
    }

    /// Creates the mark behind that of another stop, which no engine has taken.
    fn put_behind(&mut self, layout: &Layout, stop: &StopCall) {
        if self.own.is_some() || self.refused || self.problem.is_none() {
            return;
        }
        match OwnStopMark::put_behind(layout, &stop.request.id, &stop.by, &stop.reason) {
            Ok(own) => (self.own, self.is_behind) = (Some(own), true),
            // The same person's stop waits there for the same reason.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => self.is_behind = true,
            Err(error) => self.problem = Some(error.to_string()),
        }
    }

    /// Removes its mark where the stop is recorded or stored beside the record. No one else removes a mark that was made after
    /// the engine had received the stop over the socket.
    fn settle(&self, layout: &Layout, stop: &StopCall, reply: &Reply) {
        let is_stored = matches!(reply, Reply::Stopped { kept, .. } if *kept != StopPersistence::InMemory);
        if self.own.is_some() && is_stored {
            stop.withdraw(layout);
        }
    }

    fn is_taken_by(&self, process: i32) -> bool {
        // Only its own mark counts: the lock of another's may be shared for an earlier stop.
        self.own.as_ref().is_some_and(|mark| mark.is_shared_by(process))
    }
}

/// Asks over the socket. Waits for an engine that is starting, or that binds its socket's name again.
fn send_over_socket(layout: &Layout, request: &Request, until: Instant, sender: &SyncSender<SocketAnswer>) {
    let answer = loop {
        match try_socket(layout, request) {
            Ok(Some(answer)) => break answer,
            Ok(None) | Err(ControlSocketError::Ended { .. } | ControlSocketError::Closed { .. }) => {}
            Err(error) => break SocketAnswer::Nothing(error.sentence()),
        }
        if lock_holder(layout.folder()) == LockHolder::Nobody || Instant::now() + LOOK_EVERY >= until {
            break SocketAnswer::Nothing("no process answers at the socket".to_owned());
        }
        std::thread::sleep(LOOK_EVERY);
    };
    // The caller may have stopped waiting.
    drop(sender.try_send(answer));
}

fn try_socket(layout: &Layout, request: &Request) -> Result<Option<SocketAnswer>, ControlSocketError> {
    let Some(mut client) = Client::connect_asking(layout, request.clone(), HELLO_WITHIN)? else {
        return Ok(None);
    };
    Ok(Some(match client.unverified_origin() {
        None => SocketAnswer::Engine(client.reply()?),
        Some(origin) if layout.database().exists() => SocketAnswer::Nothing(origin.to_string()),
        // Without a store in the folder, the mark reaches no engine: the answer of the process is all there is.
        Some(origin) => SocketAnswer::Unverified(origin.of(&client.reply()?)),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control_socket::socket_path;
    use holdpoint_protocol::wire::{self, ClientMessage, PROTOCOL, ServerMessage};
    use std::io::{BufRead as _, BufReader, Write as _};
    use std::os::unix::net::UnixListener;

    /// The client read the kernel's list of locks before it sent a stop, and other accounts can make the list slow to read.
    #[test]
    fn a_stop_is_sent_before_the_answering_process_is_verified() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout::new(folder.path());
        std::fs::write(layout.database(), "").unwrap();
        let listener = UnixListener::bind(socket_path(&layout)).unwrap();
        // It does not hold the store, so its answer will not count.
        let server = std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let hello = ServerMessage::Hello { protocol: PROTOCOL, version: String::new(), process: 1 };
            stream.write_all(wire::line(&hello).unwrap().as_bytes()).unwrap();
            let mut line = String::new();
            BufReader::new(stream).read_line(&mut line).unwrap();
            serde_json::from_str::<ClientMessage>(&line).unwrap()
        });
        let stop = StopCall::with_id("a".to_owned(), "ana".to_owned(), String::new());
        let outcome = stop.send(&layout);
        assert!(!matches!(outcome, StopOutcome::Answered(_) | StopOutcome::Marked(_)), "{outcome:?}");
        assert_eq!(server.join().unwrap(), ClientMessage::Ask { request: Box::new(stop.request()) });
    }
}
