//! Notifications for a service manager, in systemd's notification protocol (`sd_notify(3)`): ready, alive, state,
//! stopping.
//!
//! Alive means only that the engine's own thread responded: a front end that waits for a slow reader is no reason
//! to restart the engine, and a running front end is no evidence of it.

use std::ffi::OsString;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::ffi::OsStrExt as _;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::watch;

use crate::error::CliError;
use holdpoint_governance::profile::titled;
use holdpoint_protocol::snapshot::Snapshot;
use holdpoint_text::{ErrorReason, Untrusted};
use holdpoint_wording::program::run as sentences;
use holdpoint_wording::program::run::ServiceCounts;

/// The shortest watchdog interval: the engine responds once a second.
const WATCHDOG_LEAST: Duration = Duration::from_secs(5);

/// How often the engine is reported alive in one watchdog interval.
const PER_SPAN: u32 = 3;

type Snapshots = watch::Receiver<Option<Arc<Snapshot>>>;

/// The socket of the service manager, and its watchdog interval.
pub(super) struct ServiceManager {
    socket: UnixDatagram,
    address: SocketAddr,
    watchdog: Option<Duration>,
}

impl ServiceManager {
    /// The service manager that the environment names; absent if it names none.
    ///
    /// # Errors
    /// If the environment's values are invalid.
    pub(super) fn from_environment() -> Result<Option<Self>, CliError> {
        Self::of(|name| std::env::var_os(name))
    }

    fn of(variable: impl Fn(&str) -> Option<OsString>) -> Result<Option<Self>, CliError> {
        let Some(name) = variable("NOTIFY_SOCKET").filter(|name| !name.is_empty()) else { return Ok(None) };
        let refuse = |allowed: &str| {
            let name = Untrusted::new(name.to_string_lossy()).line().into_string();
            CliError::usage(format!("NOTIFY_SOCKET is {name:?}; {allowed}"))
                .with_details(ErrorReason::Environment)
        };
        let address = match name.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name),
            [b'/', ..] => SocketAddr::from_pathname(&name),
            _ => return Err(refuse("an absolute path, or @ and a name, is allowed")),
        };
        let address = address.map_err(|error| refuse(&error.to_string()))?;
        let socket = UnixDatagram::unbound().map_err(|error| {
            CliError::usage(format!("cannot reach the service manager: {error}"))
                .with_details(ErrorReason::Environment)
        })?;
        Ok(Some(Self { socket, address, watchdog: watchdog(&variable)? }))
    }

    /// A manager that does not listen cannot be notified.
    fn send(&self, text: &str) {
        drop(self.socket.send_to_addr(text.as_bytes(), &self.address));
    }

    /// Reports the state of the engine of these snapshots, on a thread of its own that ends with the engine.
    ///
    /// # Errors
    /// If no thread starts.
    pub(super) fn start(self, snapshots: Snapshots) -> Result<JoinHandle<()>, CliError> {
        let no_thread =
            |error: std::io::Error| CliError::internal(format!("cannot notify the service manager: {error}"));
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(no_thread)?;
        let work = move || runtime.block_on(self.follow(snapshots));
        std::thread::Builder::new().name("service-manager".to_owned()).spawn(work).map_err(no_thread)
    }

    async fn follow(self, mut snapshots: Snapshots) {
        let mut endings: Option<TerminationSignals> = None;
        let (mut ready, mut stopping) = (false, false);
        let mut last_status = String::new();
        let mut alive = Instant::now();
        loop {
            tokio::select! {
                () = ending(endings.as_mut()) => {
                    self.send(sentences::SERVICE_STOPPING);
                    (stopping, endings) = (true, None);
                    continue;
                }
                changed = snapshots.changed() => {
                    if changed.is_err() {
                        // The engine has ended.
                        if !stopping {
                            self.send("STOPPING=1");
                        }
                        return;
                    }
                }
            }
            let newest = snapshots.borrow_and_update().clone();
            let Some(newest) = newest else { continue };
            let status = status(&newest);
            if newest.reading.is_some() {
                // The engine is still starting and runs no command. Its socket handles the signals.
                if last_status != status {
                    self.send(&format!("STATUS={status}"));
                    last_status = status;
                }
                continue;
            }
            if !ready {
                // The engine handles signals by now, so hearing them here loses none.
                endings = TerminationSignals::new();
                self.send("READY=1");
                ready = true;
            }
            if last_status != status && !stopping {
                self.send(&format!("STATUS={status}"));
                last_status = status;
            }
            if self.watchdog.is_some_and(|span| alive.elapsed() >= span / PER_SPAN) {
                self.send("WATCHDOG=1");
                alive = Instant::now();
            }
        }
    }
}

/// The watchdog interval, if it watches this process.
fn watchdog(variable: impl Fn(&str) -> Option<OsString>) -> Result<Option<Duration>, CliError> {
    let number = |name: &str| match variable(name) {
        None => Ok(None),
        Some(text) => match text.to_str().and_then(|text| text.parse::<u64>().ok()) {
            Some(number) => Ok(Some(number)),
            None => {
                let text = Untrusted::new(text.to_string_lossy()).line().into_string();
                let text = format!("{name} is {text:?}; a whole number is allowed");
                Err(CliError::usage(text).with_details(ErrorReason::Environment))
            }
        },
    };
    if number("WATCHDOG_PID")?.is_some_and(|process| process != u64::from(std::process::id())) {
        return Ok(None);
    }
    let Some(span) = number("WATCHDOG_USEC")?.filter(|span| *span > 0).map(Duration::from_micros) else {
        return Ok(None);
    };
    if span < WATCHDOG_LEAST {
        let text = format!("the watchdog interval is {span:?}; at least {WATCHDOG_LEAST:?} are needed");
        let error = CliError::usage(text).with_hint("set WatchdogSec=60 in the unit");
        return Err(error.with_details(ErrorReason::Environment));
    }
    Ok(Some(span))
}

/// The state in one line.
fn status(snapshot: &Snapshot) -> String {
    if snapshot.reading.is_some() {
        return sentences::verifying(snapshot.reading);
    }
    if let Some(why) = &snapshot.holding {
        return sentences::halted(Untrusted::new(why).line());
    }
    let counts = ServiceCounts {
        active: snapshot.families.iter().filter(|family| family.active.is_some()).count(),
        families: snapshot.families.len(),
        open: snapshot.candidates.iter().filter(|view| !view.state.is_terminal()).count(),
        waiting: snapshot.prompts.len() + snapshot.questions.len(),
        alarms: snapshot.alarms.len(),
    };
    sentences::service_status(&titled(snapshot.profile, snapshot.site.as_ref()), counts)
}

/// The signals that end the process.
struct TerminationSignals {
    terminate: Signal,
    interrupt: Signal,
}

impl TerminationSignals {
    fn new() -> Option<Self> {
        let (terminate, interrupt) = (signal(SignalKind::terminate()), signal(SignalKind::interrupt()));
        Some(Self { terminate: terminate.ok()?, interrupt: interrupt.ok()? })
    }
}

/// Returns when the process gets a signal to end; never without signals.
async fn ending(endings: Option<&mut TerminationSignals>) {
    let Some(endings) = endings else { return std::future::pending().await };
    tokio::select! {
        _ = endings.terminate.recv() => {}
        _ = endings.interrupt.recv() => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(clippy::option_option, reason = "no message, no period, or a period: the function's own result")]
    fn from(variables: &[(&str, &str)]) -> Result<Option<Option<Duration>>, CliError> {
        let variable = |name: &str| {
            variables.iter().find(|(known, _)| *known == name).map(|(_, value)| OsString::from(value))
        };
        ServiceManager::of(variable).map(|manager| manager.map(|manager| manager.watchdog))
    }

    #[test]
    fn the_environment_sets_socket_and_watchdog() {
        let socket = ("NOTIFY_SOCKET", "/run/manager");
        let own = std::process::id().to_string();
        for (variables, expected) in [
            (&[][..], None),
            (&[("NOTIFY_SOCKET", "")], None),
            (&[socket], Some(None)),
            (&[("NOTIFY_SOCKET", "@manager")], Some(None)),
            (&[socket, ("WATCHDOG_USEC", "60000000")], Some(Some(Duration::from_mins(1)))),
            (&[socket, ("WATCHDOG_USEC", "60000000"), ("WATCHDOG_PID", "1")], Some(None)),
            (
                &[socket, ("WATCHDOG_USEC", "60000000"), ("WATCHDOG_PID", &own)],
                Some(Some(Duration::from_mins(1))),
            ),
        ] {
            assert_eq!(from(variables).unwrap(), expected, "{variables:?}");
        }
        for variables in [
            &[("NOTIFY_SOCKET", "vsock:2:1")][..],
            &[socket, ("WATCHDOG_USEC", "soon")],
            &[socket, ("WATCHDOG_USEC", "1000000")],
        ] {
            let error = from(variables).unwrap_err();
            assert_eq!(error.details().unwrap().reason, ErrorReason::Environment, "{variables:?}: {error}");
        }
    }
}
