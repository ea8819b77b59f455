//! The engine as a service: it runs on a store until a signal or a command ends it, prints events, and submits
//! nothing.
//!
//! The printing never affects the engine: a reader that goes away or a full disk only ends the printing.

use std::io::Write;

use super::notify::ServiceManager;
use super::printer::Printer;
use crate::error::{CliError, Exit};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_service::engine_handle::{EngineEndError, EngineHandle, EngineUpdate, LaunchConfig};
use holdpoint_wording::program::run as sentences;

/// The configuration of a service.
pub struct ServiceSetup {
    pub host: LaunchConfig,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Whether the sequences of the live cell are omitted.
    pub quiet: bool,
    /// Whether only faults are printed, because the output goes to a log file.
    pub only_faults: bool,
}

/// Runs until a signal or a command ends the engine.
///
/// # Errors
/// [`CliError`] with exit code 2 if the engine does not start, 75 if another process prevents that for now, 70 if it ends
/// by a fault.
pub fn serve(service: ServiceSetup, out: &mut dyn Write) -> Result<Exit, CliError> {
    let manager = ServiceManager::from_environment()?;
    let mut host = EngineHandle::start(service.host);
    let notifier = manager.map(|manager| manager.start(host.snapshots.clone())).transpose()?;
    let mut stream = ServiceStream {
        printer: Some(Printer::new(out, service.json)),
        quiet: service.quiet,
        only_faults: service.only_faults,
        up: false,
        faulted: false,
    };
    let ended = loop {
        match host.updates.blocking_recv() {
            Some(EngineUpdate::Started) => stream.up = true,
            Some(EngineUpdate::Events(events)) => stream.print_events(&events),
            Some(EngineUpdate::Lagged { missed }) => {
                stream.note(&sentences::missed_events(missed));
            }
            // This side sends no requests.
            Some(EngineUpdate::Answer { .. } | EngineUpdate::Past { .. } | EngineUpdate::Returned(_)) => {}
            Some(EngineUpdate::Ended(ended)) => break ended,
            None => break Err(EngineEndError::of("the engine's thread is gone")),
        }
    };
    // The engine's thread drops its side, which ends the other one, too.
    drop(host);
    if let Some(notifier) = notifier {
        drop(notifier.join());
    }
    stream.end(ended)
}

/// The output of an engine's session.
struct ServiceStream<'a> {
    /// Absent once the reader is gone.
    printer: Option<Printer<'a>>,
    quiet: bool,
    only_faults: bool,
    /// Whether the engine started.
    up: bool,
    /// Whether it halted because of a fault of its own.
    faulted: bool,
}

impl ServiceStream<'_> {
    fn print_events(&mut self, events: &[Event]) {
        for event in events {
            self.faulted |= matches!(event.kind, EventKind::Fault { .. });
            let is_fault = matches!(event.kind, EventKind::Fault { .. });
            let is_sequence = matches!(event.kind, EventKind::Sequence { .. });
            if (self.quiet && is_sequence) || (self.only_faults && !is_fault) {
                continue;
            }
            self.print(|printer| printer.event(event));
        }
    }

    fn note(&mut self, text: &str) {
        self.print(|printer| printer.note(text));
    }

    fn print(&mut self, print: impl FnOnce(&mut Printer<'_>) -> Result<(), CliError>) {
        if self.printer.as_mut().is_some_and(|printer| print(printer).is_err()) {
            self.printer = None;
        }
    }

    /// The exit code of the service. An end on request is a success.
    fn end(mut self, ended: Result<(), EngineEndError>) -> Result<Exit, CliError> {
        match ended {
            Ok(()) if self.faulted => {
                self.note(sentences::ENDED_HALTED);
                Ok(Exit::Held)
            }
            Ok(()) => {
                self.note(sentences::ENDED_CLEANLY);
                Ok(Exit::Confirmed)
            }
            Err(ended) => {
                let error =
                    if self.up { CliError::internal(&ended) } else { CliError::usage(ended.text.clone()) };
                let error = if ended.busy { CliError::busy(ended.text) } else { error };
                let error = match ended.hint {
                    Some(hint) => error.with_hint(hint),
                    None => error,
                };
                Err(match ended.details {
                    Some(details) => error.with_details(details),
                    None => error,
                })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_engine::StartError;
    use holdpoint_service::bootstrap::BootstrapError;
    use holdpoint_service::control_socket::ControlSocketError;
    use holdpoint_store::StoreError;
    use holdpoint_text::ErrorReason;

    /// systemd starts the service again: a person is needed for exit code 2 alone.
    #[test]
    fn a_start_that_another_process_prevents_ends_as_busy_with_its_hint() {
        let stream =
            ServiceStream { printer: None, quiet: false, only_faults: false, up: false, faulted: false };
        let (path, holder, hint) = ("/run/x".into(), "process 7".to_owned(), "`sudo kill 7`".to_owned());
        let locked = BootstrapError::Socket(ControlSocketError::Locked { path, holder, hint });
        let error = stream.end(Err(locked.into())).unwrap_err();
        assert_eq!(error.exit(), Exit::Busy);
        assert!(error.hint().is_some_and(|hint| hint.raw() == "`sudo kill 7`"));
    }

    /// A console starts the service again if another engine had the store, and reads that from the reason.
    #[test]
    fn a_start_that_finds_the_store_in_use_ends_with_that_reason() {
        let stream =
            ServiceStream { printer: None, quiet: false, only_faults: false, up: false, faulted: false };
        let in_use = StoreError::InUse { path: "/data".into(), owner: "process 7".to_owned() };
        let error = stream.end(Err(StartError::Store(in_use).into())).unwrap_err();
        assert_eq!(error.exit(), Exit::Usage);
        assert_eq!(error.details().map(|details| details.reason), Some(ErrorReason::StoreInUse));
    }
}
