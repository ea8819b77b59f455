//! The engine as a service: it works on a store until it is told to end, prints what happens, and submits nothing.
//!
//! Who reads what is printed is no concern of the engine's: a reader that goes away, or a disk that is full, ends the
//! printing and nothing else.

use std::io::Write;

use super::notify::Manager;
use super::printer::Printer;
use crate::error::{CliError, Exit};
use holdpoint_engine::host::{EndFault, Host, HostConfig, Update};
use holdpoint_protocol::event::{Event, EventKind};

/// What a service works on.
pub struct Service {
    pub host: HostConfig,
    /// Whether events are printed as JSON lines.
    pub json: bool,
    /// Whether the sequences of the live cell are left out.
    pub quiet: bool,
    /// Whether events are printed that are faults, and no others: what is printed is kept in a file.
    pub only_faults: bool,
}

/// Works until a signal or a command ends the engine.
///
/// # Errors
/// [`CliError`] with exit code 2 if the engine does not come up, 70 if it ends by a fault.
pub fn serve(service: Service, out: &mut dyn Write) -> Result<Exit, CliError> {
    let manager = Manager::from_environment()?;
    let mut host = Host::start(service.host);
    let told = manager.map(|manager| manager.start(host.snapshots.clone())).transpose()?;
    let mut stream = ServiceStream {
        printer: Some(Printer::new(out, service.json)),
        quiet: service.quiet,
        only_faults: service.only_faults,
        up: false,
        faulted: false,
    };
    let ended = loop {
        match host.updates.blocking_recv() {
            Some(Update::Started) => stream.up = true,
            Some(Update::Events(events)) => stream.tell(&events),
            Some(Update::Lagged { missed }) => {
                stream.note(&format!("{missed} events were not printed: the reader is too slow"));
            }
            // Nobody asks anything here.
            Some(Update::Answer { .. } | Update::Past { .. } | Update::Returned(_)) => {}
            Some(Update::Ended(ended)) => break ended,
            None => break Err(EndFault::of("the engine's thread is gone")),
        }
    };
    // The engine's thread lets go of its side, which ends the other as well.
    drop(host);
    if let Some(told) = told {
        drop(told.join());
    }
    stream.end(ended)
}

/// What is printed of an engine's life.
struct ServiceStream<'a> {
    /// Absent once nobody reads any more.
    printer: Option<Printer<'a>>,
    quiet: bool,
    only_faults: bool,
    /// Whether the engine came up.
    up: bool,
    /// Whether it held because of a fault of its own.
    faulted: bool,
}

impl ServiceStream<'_> {
    fn tell(&mut self, events: &[Event]) {
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

    /// How the service ended. One that was told to end has done what it was for.
    fn end(mut self, ended: Result<(), EndFault>) -> Result<Exit, CliError> {
        match ended {
            Ok(()) if self.faulted => {
                self.note("ended; the engine had been holding because of a fault");
                Ok(Exit::Held)
            }
            Ok(()) => {
                self.note("ended in good order");
                Ok(Exit::Confirmed)
            }
            Err(why) if self.up => Err(CliError::internal(why.text)),
            Err(why) => Err(CliError::usage(why.text)),
        }
    }
}
