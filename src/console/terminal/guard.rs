//! The guard: a separate thread that handles signals and a lost terminal, and ends the program if the run loop does
//! not.
//!
//! The loop may hang in a write to a terminal that takes no more bytes, so this thread writes only after the loop's
//! time is over. Must not talk to the engine: the loop shuts it down cleanly; if it cannot, the store holds every
//! decision.

use std::io;
use std::os::fd::OwnedFd;
use std::time::Duration;

use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::modes;

/// How long the loop has to end after a request: hold, persist, restore. Less than the promised five seconds, so that
/// they suffice for the rest.
pub const PATIENCE: Duration = Duration::from_secs(4);

/// How long a terminal has to accept the restoring sequences, once the loop has failed to send them.
const LAST_WRITE: Duration = Duration::from_millis(300);

/// The exit code after a request to end: held.
const EXIT_HELD: i32 = 3;

/// Why the program should end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndSignal {
    Signalled,
    /// SIGHUP, or the other end of the terminal is closed: nothing can be written there.
    TerminalLost,
}

/// The running guard. Dropping it ends the watch.
#[derive(Debug)]
pub struct RunningGuard {
    endings: mpsc::Receiver<EndSignal>,
    done: CancellationToken,
}

impl RunningGuard {
    /// Starts the watch.
    ///
    /// # Errors
    /// If no thread, signal handler or file descriptor is available.
    pub fn start() -> io::Result<Self> {
        let (sender, endings) = mpsc::channel(4);
        let done = CancellationToken::new();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let watch = {
            let _inside = runtime.enter();
            SignalWatch::new(sender)?
        };
        let stopped = done.clone();
        std::thread::Builder::new().name("console-guard".to_owned()).spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = stopped.cancelled() => {}
                    () = watch.run() => {}
                }
            });
        })?;
        Ok(Self { endings, done })
    }

    /// The next reason to end. Safe to cancel. Never returns once the watch is over.
    pub async fn ending(&mut self) -> EndSignal {
        match self.endings.recv().await {
            Some(ending) => ending,
            None => std::future::pending().await,
        }
    }
}

impl Drop for RunningGuard {
    fn drop(&mut self) {
        self.done.cancel();
    }
}

struct SignalWatch {
    sender: mpsc::Sender<EndSignal>,
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
    hang_up: tokio::signal::unix::Signal,
    terminal: AsyncFd<OwnedFd>,
}

impl SignalWatch {
    fn new(sender: mpsc::Sender<EndSignal>) -> io::Result<Self> {
        let terminal = rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3)?;
        // Only the guard closes this descriptor, which is a copy: it lives as long as the watch.
        #[allow(deprecated, reason = "the replacement is unsafe, and this program has no unsafe code")]
        let terminal = AsyncFd::with_interest(terminal, Interest::READABLE)?;
        Ok(Self {
            sender,
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hang_up: signal(SignalKind::hangup())?,
            terminal,
        })
    }

    /// Waits for a reason to end, reports it, and gives the loop its time. A second signal ends at once; a hang-up
    /// counts once, as a signal, a lost terminal, or both.
    async fn run(mut self) {
        let first = self.next().await;
        // A full channel already contains a reason.
        self.sender.try_send(first).ok();
        let mut gone = first == EndSignal::TerminalLost;
        let deadline = Instant::now() + PATIENCE;
        loop {
            tokio::select! {
                () = tokio::time::sleep_until(deadline) => break,
                _ = self.terminate.recv() => break,
                _ = self.interrupt.recv() => break,
                () = wait_closed(&self.terminal), if !gone => gone = true,
            }
        }
        leave(gone);
    }

    async fn next(&mut self) -> EndSignal {
        tokio::select! {
            _ = self.terminate.recv() => EndSignal::Signalled,
            _ = self.interrupt.recv() => EndSignal::Signalled,
            _ = self.hang_up.recv() => EndSignal::TerminalLost,
            () = wait_closed(&self.terminal) => EndSignal::TerminalLost,
        }
    }
}

/// Returns once the other end of the terminal is closed.
async fn wait_closed(terminal: &AsyncFd<OwnedFd>) {
    loop {
        match terminal.ready(Interest::READABLE).await {
            Ok(ready) if ready.ready().is_read_closed() => return,
            // A key was pressed; the input thread reads it.
            Ok(mut ready) => ready.clear_ready(),
            Err(_) => return,
        }
    }
}

/// Ends the process. The terminal gets its restoring sequences if it accepts them in time.
fn leave(gone: bool) {
    if !gone {
        let (sender, written) = std::sync::mpsc::sync_channel(1);
        let spawned = std::thread::Builder::new().name("console-leave".to_owned()).spawn(move || {
            modes::restore_settings_first();
            sender.send(()).ok();
        });
        if spawned.is_ok() {
            written.recv_timeout(LAST_WRITE).ok();
        }
    }
    std::process::exit(EXIT_HELD);
}
