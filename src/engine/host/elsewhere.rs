//! The engine in another process, which is at work on the store while this process has none: asked over the store's socket.

use std::time::{Duration, Instant};

use crate::door::{
    Client, DoorError, NOT_CONFIRMED_HINT, StopCall, StopOutcome, not_confirmed, socket_path, stopped_by_mark,
};
use holdpoint_protocol::command::{Command, Refusal, Reply, StopKept};
use holdpoint_registry::{Layout, lock_owner};
use holdpoint_text::Problem;

/// How often it is looked whether a store is free.
const END_LOOK: Duration = Duration::from_millis(20);

/// Whatever engine is at work on a store.
#[derive(Clone, Debug)]
pub struct EngineElsewhere {
    layout: Layout,
}

impl EngineElsewhere {
    pub(super) const fn new(layout: Layout) -> Self {
        Self { layout }
    }

    /// Waits, but not for longer than this, until no process has the store: whoever starts an engine then finds it free.
    pub fn wait_for_end(&self, patience: Duration) {
        let until = Instant::now() + patience;
        while Instant::now() < until && matches!(lock_owner(&self.layout), Ok(Some(_))) {
            std::thread::sleep(END_LOOK);
        }
    }

    /// Asks it, and tells what it answered, or that there is none. Waits for the answer.
    #[must_use]
    pub fn ask(&self, command: Command) -> Reply {
        if let Command::Stop { by, reason } = command {
            return match StopCall::new(by, reason) {
                Ok(call) => said(stop(&call, &self.layout)),
                Err(error) => Reply::refused(code(&error), &error),
            };
        }
        let asked = |mut client: Client| {
            let reply = client.ask(command)?;
            Ok(client.doubt().map_or(reply.clone(), |doubt| doubt.in_place_of(&reply)))
        };
        match Client::connect(&self.layout).and_then(|client| client.map(asked).transpose()) {
            Ok(Some(reply)) => said(reply),
            Ok(None) => {
                if let Ok(Some(owner)) = lock_owner(&self.layout) {
                    let path = socket_path(&self.layout);
                    let text = format!("the store is in use by {owner}, and nobody answers at {path:?}");
                    let hint = "ask again in a second: an engine listens there anew; if it does not, end that process with `kill`";
                    return Reply::refused(Refusal::NoAnswer, &Problem::new(text).with_hint(hint));
                }
                nobody_at_work()
            }
            Err(error) => Reply::refused(code(&error), &error),
        }
    }
}

fn nobody_at_work() -> Reply {
    let hint = "`holdpoint stop` in a shell keeps the next one stopped";
    let problem = Problem::new("no engine is at work on this store").with_hint(hint);
    Reply::refused(Refusal::NotNow, &problem)
}

/// Stops the cell, and tells what is known of it.
pub(super) fn stop(call: &StopCall, layout: &Layout) -> Reply {
    match call.ask(layout) {
        StopOutcome::Answered(reply) => reply,
        StopOutcome::Marked(instead) => {
            Reply::Stopped { text: stopped_by_mark(&instead), kept: StopKept::InMark }
        }
        StopOutcome::NoEngine => {
            // What is refused stops no engine that comes later.
            call.withdraw(layout);
            nobody_at_work()
        }
        StopOutcome::NotConfirmed(why) => {
            let problem = Problem::new(not_confirmed(&why)).with_hint(NOT_CONFIRMED_HINT);
            Reply::refused(Refusal::NoAnswer, &problem)
        }
    }
}

/// Its answer, with whose it is.
fn said(reply: Reply) -> Reply {
    const WHO: &str = "the engine at work, in another process";
    match reply {
        Reply::Accepted { text, version } => Reply::Accepted { text: format!("{WHO}: {text}"), version },
        Reply::Stopped { text, kept } => Reply::Stopped { text: format!("{WHO}: {text}"), kept },
        Reply::Refused { code, text, hint } => Reply::Refused { code, text: format!("{WHO}: {text}"), hint },
        other => other,
    }
}

/// What became of a request that no engine answered.
pub(super) const fn code(error: &DoorError) -> Refusal {
    match error {
        DoorError::NoAnswer { .. } | DoorError::Silent { .. } | DoorError::Ended { .. } => Refusal::NoAnswer,
        DoorError::PathTooLong { .. }
        | DoorError::Taken { .. }
        | DoorError::Io { .. }
        | DoorError::Foreign { .. }
        | DoorError::Protocol { .. }
        | DoorError::Closed { .. }
        | DoorError::Random(_) => Refusal::BadInput,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_store_that_nobody_works_on_says_so_and_what_helps() {
        let folder = tempfile::tempdir().unwrap();
        let stop = Command::Stop { by: String::new(), reason: String::new() };
        let reply = EngineElsewhere::new(Layout::new(folder.path())).ask(stop);
        let Reply::Refused { code: Refusal::NotNow, text, hint } = reply else { panic!("{reply:?}") };
        assert!(text.contains("no engine is at work"), "{text}");
        assert!(hint.is_some_and(|hint| hint.contains("holdpoint stop")));
    }
}
