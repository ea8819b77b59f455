//! Questions about the record that take long, read beside the engine: each on a thread of its own, over connections of its
//! own that only read. The engine waits for none of them.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_protocol::health::HealthAsked;
use holdpoint_registry::Layout;

use crate::health_series::{HealthError, HealthReader, Present};
use crate::view::lookup;

/// The most questions that are read at a time.
const READING_MAX: usize = 2;

/// Questions whose answers are kept for whoever asked; the oldest one that is answered goes first.
const KEPT_MAX: usize = 16;

/// A question that takes long.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Asked {
    Health(HealthAsked),
    VerifyAudit,
}

impl Asked {
    /// What a command asks, if it is read beside the engine.
    pub(crate) const fn of(command: &Command) -> Option<Self> {
        match command {
            Command::Health { asked } => Some(Self::Health(*asked)),
            Command::VerifyAudit => Some(Self::VerifyAudit),
            _ => None,
        }
    }
}

/// One question, and its answer once there is one.
struct Reading {
    id: String,
    asked: Asked,
    answer: Arc<Mutex<Option<Reply>>>,
}

impl Reading {
    fn answered(&self) -> Option<Reply> {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn is_open(&self) -> bool {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).is_none()
    }
}

/// See the module's head.
#[derive(Default)]
pub(crate) struct Readings(VecDeque<Reading>);

/// The answer to a question, read here and now.
pub(crate) fn read(layout: &Layout, asked: Asked, present: Present) -> Reply {
    match asked {
        Asked::Health(asked) => health(layout, &asked, present),
        Asked::VerifyAudit => {
            lookup::verify_audit(layout).unwrap_or_else(|error| Reply::refused(Refusal::Store, &error))
        }
    }
}

fn health(layout: &Layout, asked: &HealthAsked, present: Present) -> Reply {
    let read = HealthReader::open(layout).map_err(HealthError::from);
    match read.and_then(|reader| reader.read(asked, Some(present))) {
        Ok(series) => Reply::Health { series: Box::new(series) },
        Err(error @ HealthError::Asked(_)) => Reply::refused(Refusal::BadInput, &error),
        Err(error @ HealthError::Store(_)) => Reply::refused(Refusal::Store, &error),
    }
}

impl Readings {
    /// Begins to read. `None`: the answer comes later, see [`Self::answer_of`].
    pub(crate) fn begin(
        &mut self,
        id: &str,
        asked: Asked,
        (layout, present): (&Layout, Present),
    ) -> Option<Reply> {
        if let Some(known) = self.0.iter().find(|reading| reading.id == id && reading.asked == asked) {
            return known.answered();
        }
        let refuse = |text: &str| {
            let hint = Some("ask again when one of them is answered".to_owned());
            Some(Reply::Refused { code: Refusal::NotNow, text: text.to_owned(), hint })
        };
        if self.0.iter().filter(|reading| reading.is_open()).count() >= READING_MAX {
            return refuse(&format!("{READING_MAX} questions about the record are being read already"));
        }
        while self.0.len() >= KEPT_MAX {
            let Some(oldest) = self.0.iter().position(|reading| !reading.is_open()) else { break };
            self.0.remove(oldest);
        }
        let answer = Arc::new(Mutex::new(None));
        let (slot, layout) = (Arc::clone(&answer), layout.clone());
        let work = move || {
            let reply = catch_unwind(AssertUnwindSafe(|| read(&layout, asked, present)));
            // Whoever asked must not be left without a word.
            let reply = reply.unwrap_or_else(|_| Reply::Refused {
                code: Refusal::Store,
                text: "the reading of the record failed".to_owned(),
                hint: Some("look at `holdpoint audit verify`".to_owned()),
            });
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(reply);
        };
        let thread = std::thread::Builder::new().name("reading".to_owned());
        if thread.spawn(work).is_err() {
            return refuse("no thread could be started to read the record");
        }
        self.0.push_back(Reading { id: id.to_owned(), asked, answer });
        None
    }

    /// The answer to a question, once it was read.
    pub(crate) fn answer_of(&self, id: &str) -> Option<Reply> {
        self.0.iter().rev().find(|reading| reading.id == id)?.answered()
    }
}
