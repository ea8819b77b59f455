//! An engine that another process is starting: requests wait for it, and none is lost.

use std::sync::{Mutex, PoisonError};

use tokio::sync::mpsc;

use super::RequestRejected;
use super::update::{EngineUpdate, OUTSTANDING_MAX};
use holdpoint_protocol::command::{Command, Request};

/// The requests for an engine that another process is starting.
pub(super) struct StartingEngine {
    /// Absent once no engine takes them.
    requests: Mutex<Option<Vec<Request>>>,
    /// As long as this lives, the front end waits.
    _updates: mpsc::Sender<EngineUpdate>,
}

impl StartingEngine {
    pub(super) const fn new(updates: mpsc::Sender<EngineUpdate>) -> Self {
        Self { requests: Mutex::new(Some(Vec::new())), _updates: updates }
    }

    /// Takes the waiting requests. No more wait from now on.
    pub(super) fn take(&self) -> Vec<Request> {
        self.requests.lock().unwrap_or_else(PoisonError::into_inner).take().unwrap_or_default()
    }

    pub(super) fn submit(&self, request: Request) -> Result<(), RequestRejected> {
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        match requests.as_mut() {
            // A stop is always accepted.
            Some(requests)
                if requests.len() < OUTSTANDING_MAX || matches!(request.command, Command::Stop { .. }) =>
            {
                requests.push(request);
                Ok(())
            }
            Some(_) => Err(RequestRejected::Busy(Box::new(request))),
            None => Err(RequestRejected::Ended(Box::new(request))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn early_requests_wait_and_stops_are_always_taken() {
        let coming = StartingEngine::new(mpsc::channel(1).0);
        let pace = |id: usize| Request::unsigned(id.to_string(), Command::Pace { times: None });
        for id in 0..OUTSTANDING_MAX {
            assert_eq!(coming.submit(pace(id)), Ok(()));
        }
        assert_eq!(coming.submit(pace(99)), Err(RequestRejected::Busy(Box::new(pace(99)))));
        let stop = Command::Stop { by: "ana".to_owned(), reason: String::new() };
        assert_eq!(coming.submit(Request::unsigned("stop".to_owned(), stop)), Ok(()));
        assert_eq!((coming.take().len(), coming.take().len()), (OUTSTANDING_MAX + 1, 0));
        assert_eq!(coming.submit(pace(0)), Err(RequestRejected::Ended(Box::new(pace(0)))));
    }
}
