//! A stop of the cell, asked of the engine in another process: by a mark in the store's folder and over the socket at
//! once. It counts as one stop, and the process that has the store alone confirms it.

use std::io::ErrorKind;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use super::DoorError;
use super::client::Client;
use crate::stop_mark::{self, OwnMark};
use holdpoint_approvals::Nonce;
use holdpoint_protocol::command::{Command, Reply, Request, StopKept};
use holdpoint_registry::{Layout, LockHolder, lock_holder};
use holdpoint_text::Hint as _;

/// How long it is waited for a confirmation.
const CONFIRMED_WITHIN: Duration = Duration::from_secs(3);

/// How long an engine is waited for at its socket; less, so that it is said why.
const HELLO_WITHIN: Duration = Duration::from_secs(2);

/// How long the engine's own words are waited for once it has taken the mark.
const WORDS_WITHIN: Duration = Duration::from_millis(1500);

/// Time between two looks at the mark.
const LOOK_EVERY: Duration = Duration::from_millis(5);

/// What to do where a stop is not confirmed.
pub const NOT_CONFIRMED_HINT: &str =
    "press the emergency stop of the cell; `holdpoint status` shows what the store says";

/// The text for a stop that was not confirmed.
#[must_use]
pub fn not_confirmed(why: &str) -> String {
    format!("it is NOT CONFIRMED that the arm is stopped: {why}")
}

/// The text for a stop that the engine took from the store's folder.
#[must_use]
pub fn stopped_by_mark(instead: &str) -> String {
    format!("the cell is stopped: the process that has the store took the stop from its folder ({instead})")
}

/// A stop of the cell that is to be asked for.
#[derive(Clone, Debug)]
pub struct StopCall {
    request: Request,
    by: String,
    reason: String,
}

/// What became of it.
#[derive(Debug)]
pub enum StopOutcome {
    /// The engine answered itself.
    Answered(Reply),
    /// The engine stopped the cell by the mark; why its own words were not heard.
    Marked(String),
    /// No process has the store.
    NoEngine,
    /// It is not known whether the arm is stopped, and why.
    NotConfirmed(String),
}

/// What came over the socket.
enum Said {
    Engine(Reply),
    /// Nothing that is known to be the engine's.
    Nothing(String),
}

impl StopCall {
    /// A stop with an id of its own.
    ///
    /// # Errors
    /// If the system gives no random number.
    pub fn new(by: String, reason: String) -> Result<Self, DoorError> {
        Ok(Self::with_id(Nonce::random()?.as_str().to_owned(), by, reason))
    }

    /// A stop with this id.
    #[must_use]
    pub fn with_id(id: String, by: String, reason: String) -> Self {
        let command = Command::Stop { by: by.clone(), reason: reason.clone() };
        Self { request: Request::unsigned(id, command), by, reason }
    }

    /// The request, for an engine of one's own.
    #[must_use]
    pub fn request(&self) -> Request {
        self.request.clone()
    }

    /// Takes its mark away, where no engine is there to take it.
    pub fn withdraw(&self, layout: &Layout) {
        stop_mark::settle(layout, &self.request.id);
    }

    /// Asks whatever engine is at work on the store, and waits for the confirmation, for 3 s at most.
    #[must_use]
    pub fn ask(&self, layout: &Layout) -> StopOutcome {
        let until = Instant::now() + CONFIRMED_WITHIN;
        let mut mark = AskedMark::default();
        // It lies there before anything is asked over the socket: the engine sees it whatever answers there.
        mark.put(layout, self);
        let (tell, told) = sync_channel(1);
        let (request, of) = (self.request.clone(), layout.clone());
        let asking = std::thread::Builder::new().name("stop-asker".to_owned());
        let mut said = asking
            .spawn(move || ask_socket(&of, &request, until, &tell))
            .err()
            .map(|error| format!("no thread could be started: {error}"));
        let mut taken: Option<Instant> = None;
        loop {
            if said.is_none() {
                match next(&told) {
                    Some(Said::Engine(reply)) => {
                        mark.settle(layout, self, &reply);
                        return StopOutcome::Answered(reply);
                    }
                    Some(Said::Nothing(why)) => said = Some(why),
                    None => {}
                }
            } else {
                std::thread::sleep(LOOK_EVERY);
            }
            let holder = lock_holder(layout.folder());
            // Whether an engine took it, the kernel does not tell in another PID namespace.
            if taken.is_none() && holder != LockHolder::Untold {
                mark.put(layout, self);
            }
            if holder == LockHolder::Nobody && said.is_some() {
                return StopOutcome::NoEngine;
            }
            if taken.is_none() && matches!(holder, LockHolder::Process(process) if mark.is_taken_by(process))
            {
                taken = Some(Instant::now());
            }
            if let Some(since) = taken
                && (said.is_some() || since.elapsed() > WORDS_WITHIN)
            {
                let silent = || "nobody answered at the socket".to_owned();
                return StopOutcome::Marked(said.unwrap_or_else(silent));
            }
            if Instant::now() >= until {
                return StopOutcome::NotConfirmed(why_not(holder, said, &mark));
            }
        }
    }
}

fn why_not(holder: LockHolder, said: Option<String>, mark: &AskedMark) -> String {
    let mut why = said.unwrap_or_else(|| {
        let secs = CONFIRMED_WITHIN.as_secs();
        match holder {
            LockHolder::Process(process) => {
                format!("process {process}, which has the store, did not answer within {secs} s")
            }
            LockHolder::Nobody | LockHolder::Untold => format!("nobody answered within {secs} s"),
        }
    });
    if let Some(problem) = &mark.problem {
        why.push_str(&format!("; no mark could be put into the store's folder: {problem}"));
    } else if holder == LockHolder::Untold {
        why.push_str("; a mark of the stop was made in the store's folder, and whether an engine has taken it cannot be told here");
    } else {
        why.push_str(
            "; the mark of the stop was made in the store's folder, and no engine is known to have taken it",
        );
    }
    why
}

fn next(told: &Receiver<Said>) -> Option<Said> {
    match told.recv_timeout(LOOK_EVERY) {
        Ok(said) => Some(said),
        Err(RecvTimeoutError::Timeout) => None,
        Err(RecvTimeoutError::Disconnected) => Some(Said::Nothing("the asking thread failed".to_owned())),
    }
}

/// The mark of a stop, as far as the folder takes one.
#[derive(Default)]
struct AskedMark {
    own: Option<OwnMark>,
    /// Why there is none.
    problem: Option<String>,
    /// Whether it is of no use to try again.
    refused: bool,
    /// Whether the own one was not there at the last look.
    was_removed: bool,
}

impl AskedMark {
    /// Puts it there, unless it lies there already. Where another stop is asked for meanwhile, it waits for its turn. Where it
    /// was removed and no engine has taken it, it is put there again.
    fn put(&mut self, layout: &Layout, stop: &StopCall) {
        if let Some(own) = &self.own {
            // An engine that removes it shares its lock first; the next look sees that.
            if !std::mem::replace(&mut self.was_removed, own.is_removed()) || !self.was_removed {
                return;
            }
            (self.own, self.was_removed) = (None, false);
        }
        if self.refused {
            return;
        }
        match OwnMark::put(layout, &stop.request.id, &stop.by, &stop.reason) {
            Ok(own) => (self.own, self.problem) = (Some(own), None),
            Err(error) => {
                self.refused = error.kind() != ErrorKind::AlreadyExists;
                self.problem = Some(error.to_string());
            }
        }
    }

    /// Takes its mark away where the stop is on record or kept beside it: one that was made after the engine had heard of the stop
    /// over the socket is removed by nobody else.
    fn settle(&self, layout: &Layout, stop: &StopCall, reply: &Reply) {
        let is_kept = matches!(reply, Reply::Stopped { kept, .. } if *kept != StopKept::InMemory);
        if self.own.is_some() && is_kept {
            stop.withdraw(layout);
        }
    }

    fn is_taken_by(&self, process: i32) -> bool {
        // By its own mark alone: the lock of another's may be shared for a stop that is over.
        self.own.as_ref().is_some_and(|mark| mark.is_shared_by(process))
    }
}

/// Asks over the socket. An engine that is coming up, or takes its name back, is waited for.
fn ask_socket(layout: &Layout, request: &Request, until: Instant, tell: &SyncSender<Said>) {
    let said = loop {
        match ask_once(layout, request) {
            Ok(Some(said)) => break said,
            Ok(None) | Err(DoorError::Ended { .. } | DoorError::Closed { .. }) => {}
            Err(error) => break Said::Nothing(error.sentence()),
        }
        if lock_holder(layout.folder()) == LockHolder::Nobody || Instant::now() + LOOK_EVERY >= until {
            break Said::Nothing("nobody answers at the socket".to_owned());
        }
        std::thread::sleep(LOOK_EVERY);
    };
    // The caller may have heard enough.
    drop(tell.try_send(said));
}

fn ask_once(layout: &Layout, request: &Request) -> Result<Option<Said>, DoorError> {
    let Some(mut client) = Client::connect_within(layout, HELLO_WITHIN)? else { return Ok(None) };
    if let Some(doubt) = client.doubt() {
        return Ok(Some(Said::Nothing(doubt.to_string())));
    }
    let reply = client.ask_request(request.clone())?;
    // Where the first connection broke, another one was made.
    Ok(Some(client.doubt().map_or_else(|| Said::Engine(reply), |doubt| Said::Nothing(doubt.to_string()))))
}
