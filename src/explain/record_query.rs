//! Long queries of the record, beside the engine: each runs on its own thread over its own read-only connections. The engine
//! waits for none of them.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

use holdpoint_protocol::command::{Command, Refusal, Reply};
use holdpoint_protocol::health::HealthQuery;
use holdpoint_store::ReadableStore;

use crate::health_series::{HealthError, HealthReader, PresentTime};
use crate::view::lookup;

/// The most queries that run at a time.
const READING_MAX: usize = 2;

/// The most queries with stored answers; the oldest answered one is dropped first.
const STORED_MAX: usize = 16;

/// A long query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RecordQuery {
    Health(HealthQuery),
    VerifyAudit,
}

impl RecordQuery {
    /// The query of a command, if it runs beside the engine.
    #[must_use]
    pub const fn of(command: &Command) -> Option<Self> {
        match command {
            Command::Health { asked } => Some(Self::Health(*asked)),
            Command::VerifyAudit => Some(Self::VerifyAudit),
            _ => None,
        }
    }
}

/// One query, and its answer once there is one.
struct RunningQuery {
    id: String,
    query: RecordQuery,
    answer: Arc<Mutex<Option<Reply>>>,
}

impl RunningQuery {
    fn answered(&self) -> Option<Reply> {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn is_open(&self) -> bool {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).is_none()
    }
}

/// The queries that run or are answered, in the order of their start.
#[derive(Default)]
pub struct QueryQueue(VecDeque<RunningQuery>);

/// The answer to a query, read on this thread.
#[must_use]
pub fn read(reader: &dyn ReadableStore, query: RecordQuery, present: PresentTime) -> Reply {
    match query {
        RecordQuery::Health(query) => health(reader, &query, present),
        RecordQuery::VerifyAudit => {
            lookup::verify_audit(reader).unwrap_or_else(|error| Reply::refused(Refusal::Store, &error))
        }
    }
}

fn health(reader: &dyn ReadableStore, query: &HealthQuery, present: PresentTime) -> Reply {
    let read = HealthReader::open(reader).map_err(HealthError::from);
    match read.and_then(|reader| reader.read(query, Some(present))) {
        Ok(series) => Reply::Health { series: Box::new(series) },
        Err(error @ HealthError::InvalidQuery(_)) => Reply::refused(Refusal::BadInput, &error),
        Err(error @ HealthError::Store(_)) => Reply::refused(Refusal::Store, &error),
    }
}

impl QueryQueue {
    /// Begins to read. `None`: the answer comes later, see [`Self::answer_of`].
    pub fn begin(
        &mut self,
        id: &str,
        query: RecordQuery,
        (reader, present): (Arc<dyn ReadableStore>, PresentTime),
    ) -> Option<Reply> {
        if let Some(running) = self.0.iter().find(|running| running.id == id && running.query == query) {
            return running.answered();
        }
        let refuse = |text: &str| {
            let hint = Some("repeat the query when one of them has ended".to_owned());
            Some(Reply::Refused { code: Refusal::NotNow, text: text.to_owned(), hint })
        };
        if self.0.iter().filter(|running| running.is_open()).count() >= READING_MAX {
            return refuse(&format!("the engine already reads the record for {READING_MAX} queries"));
        }
        while self.0.len() >= STORED_MAX {
            let Some(oldest) = self.0.iter().position(|running| !running.is_open()) else { break };
            self.0.remove(oldest);
        }
        let answer = Arc::new(Mutex::new(None));
        let slot = Arc::clone(&answer);
        let work = move || {
            let reply = catch_unwind(AssertUnwindSafe(|| read(&*reader, query, present)));
            // The client must get an answer.
            let reply = reply.unwrap_or_else(|_| Reply::Refused {
                code: Refusal::Store,
                text: "the query of the record failed".to_owned(),
                hint: Some("look at `holdpoint audit verify`".to_owned()),
            });
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = Some(reply);
        };
        let thread = std::thread::Builder::new().name("reading".to_owned());
        if thread.spawn(work).is_err() {
            return refuse("no thread could be started to read the record");
        }
        self.0.push_back(RunningQuery { id: id.to_owned(), query, answer });
        None
    }

    /// The answer to a query, once it is complete.
    #[must_use]
    pub fn answer_of(&self, id: &str) -> Option<Reply> {
        self.0.iter().rev().find(|reading| reading.id == id)?.answered()
    }
}
