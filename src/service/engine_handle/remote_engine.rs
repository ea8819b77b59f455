//! The engine of another process, asked over the store's socket while this process has no engine.

use std::time::{Duration, Instant};

use crate::control_socket::{
    Client, ControlSocketError, NOT_CONFIRMED_HINT, StopCall, StopOutcome, not_confirmed, socket_path,
};
use holdpoint_protocol::command::{Command, Refusal, Reply, StopPersistence};
use holdpoint_store::{Layout, lock_owner};
use holdpoint_text::Problem;
use holdpoint_wording::program::engine::{OTHER_PROCESS as WHO, stopped_by_mark};

/// Interval between checks whether a store is free.
const END_LOOK: Duration = Duration::from_millis(20);

/// The engine of a store, if one runs.
#[derive(Clone, Debug)]
pub struct RemoteEngine {
    layout: Layout,
}

impl RemoteEngine {
    pub(super) const fn new(layout: Layout) -> Self {
        Self { layout }
    }

    /// Waits, at most this long, until no process has the store, so that the next engine finds it free.
    pub fn wait_for_end(&self, patience: Duration) {
        let until = Instant::now() + patience;
        while Instant::now() < until && matches!(lock_owner(&self.layout), Ok(Some(_))) {
            std::thread::sleep(END_LOOK);
        }
    }

    /// Sends it a command and waits for the answer; a refusal if there is no engine.
    #[must_use]
    pub fn send(&self, command: Command) -> Reply {
        if let Command::Stop { by, reason } = command {
            return match StopCall::new(by, reason) {
                Ok(call) => with_origin(stop(&call, &self.layout)),
                Err(error) => Reply::refused(code(&error), &error),
            };
        }
        let exchange = |mut client: Client| {
            let reply = client.send(command)?;
            Ok(client.unverified_origin().map_or(reply.clone(), |origin| origin.in_place_of(&reply)))
        };
        match Client::connect(&self.layout).and_then(|client| client.map(exchange).transpose()) {
            Ok(Some(reply)) => with_origin(reply),
            Ok(None) => {
                if let Ok(Some(owner)) = lock_owner(&self.layout) {
                    let path = socket_path(&self.layout);
                    let text = format!("the store is in use by {owner}, and no process answers at {path:?}");
                    let hint =
                        "ask again in a second, when it listens again; else end that process with `kill`";
                    return Reply::refused(Refusal::NoAnswer, &Problem::new(text).with_hint(hint));
                }
                no_engine_reply()
            }
            Err(error) => Reply::refused(code(&error), &error),
        }
    }
}

fn no_engine_reply() -> Reply {
    let hint = "`holdpoint stop` in a shell keeps the next one stopped";
    let problem = Problem::new("no engine is running on this store").with_hint(hint);
    Reply::refused(Refusal::NotNow, &problem)
}

/// Stops the cell, and describes the outcome.
pub(super) fn stop(call: &StopCall, layout: &Layout) -> Reply {
    match call.send(layout) {
        StopOutcome::Answered(reply) => reply,
        StopOutcome::Marked(instead) => {
            Reply::Stopped { text: stopped_by_mark(&instead), kept: StopPersistence::InMark }
        }
        StopOutcome::NoEngine => {
            // A refused stop must not stop a later engine.
            call.withdraw(layout);
            no_engine_reply()
        }
        StopOutcome::NotConfirmed(why) => {
            let problem = Problem::new(not_confirmed(&why)).with_hint(NOT_CONFIRMED_HINT);
            Reply::refused(Refusal::NoAnswer, &problem)
        }
    }
}

/// Its answer, with its origin.
fn with_origin(reply: Reply) -> Reply {
    match reply {
        Reply::Accepted { text, version } => Reply::Accepted { text: format!("{WHO}: {text}"), version },
        Reply::Stopped { text, kept } => Reply::Stopped { text: format!("{WHO}: {text}"), kept },
        Reply::Refused { code, text, hint } => Reply::Refused { code, text: format!("{WHO}: {text}"), hint },
        other => other,
    }
}

/// The refusal for a request that no engine answered.
pub(super) const fn code(error: &ControlSocketError) -> Refusal {
    match error {
        ControlSocketError::NoAnswer { .. }
        | ControlSocketError::Silent { .. }
        | ControlSocketError::Ended { .. } => Refusal::NoAnswer,
        ControlSocketError::PathTooLong { .. }
        | ControlSocketError::Taken { .. }
        | ControlSocketError::Locked { .. }
        | ControlSocketError::GroupRefused { .. }
        | ControlSocketError::Io { .. }
        | ControlSocketError::Foreign { .. }
        | ControlSocketError::Protocol { .. }
        | ControlSocketError::Closed { .. }
        | ControlSocketError::Random(_) => Refusal::BadInput,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_store_without_an_engine_refuses_with_a_hint() {
        let folder = tempfile::tempdir().unwrap();
        let stop = Command::Stop { by: String::new(), reason: String::new() };
        let reply = RemoteEngine::new(Layout::new(folder.path())).send(stop);
        let Reply::Refused { code: Refusal::NotNow, hint, .. } = reply else { panic!("{reply:?}") };
        assert!(hint.is_some_and(|hint| hint.contains("holdpoint stop")));
    }
}
