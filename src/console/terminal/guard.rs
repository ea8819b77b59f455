//! The guard: a thread of its own that hears signals and notices a lost terminal, and ends the program if the
//! run loop does not.
//!
//! The loop may hang in a write to a terminal that takes no more bytes; this thread never writes before it has
//! given the loop its time. Must not talk to the engine: the loop ends it in good order, and if it cannot, the
//! store holds what was decided and nothing more.

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

/// How long the loop has to end after it was asked to: hold, persist, restore. Less than the five seconds that are
/// promised, so that they suffice for the rest.
pub const PATIENCE: Duration = Duration::from_secs(4);

/// How long a terminal has to take the sequences that restore it, once the loop has failed to.
const LAST_WRITE: Duration = Duration::from_millis(300);

/// The exit code of a program that was told to end: held.
const EXIT_HELD: i32 = 3;

/// Why the program should end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    Told,
    /// SIGHUP, or the other end of the terminal is gone: nothing can be written there.
    Gone,
}

/// The running guard. Dropping it ends the watch.
#[derive(Debug)]
pub struct RunningGuard {
    endings: mpsc::Receiver<Ending>,
    done: CancellationToken,
}

impl RunningGuard {
    /// Starts the watch.
    ///
    /// # Errors
    /// If no thread, no signal handler or no file descriptor can be had.
    pub fn start() -> io::Result<Self> {
        let (sender, endings) = mpsc::channel(4);
        let done = CancellationToken::new();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let watch = {
            let _inside = runtime.enter();
            Watch::new(sender)?
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

    /// The next reason to end. Safe to cancel. Never comes back if the watch is over.
    pub async fn ending(&mut self) -> Ending {
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

struct Watch {
    told: mpsc::Sender<Ending>,
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
    hang_up: tokio::signal::unix::Signal,
    terminal: AsyncFd<OwnedFd>,
}

impl Watch {
    fn new(told: mpsc::Sender<Ending>) -> io::Result<Self> {
        let terminal = rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3)?;
        // The descriptor is a copy that nobody else closes: it lives as long as what watches it.
        #[allow(deprecated, reason = "the replacement is unsafe, and this program has no unsafe code")]
        let terminal = AsyncFd::with_interest(terminal, Interest::READABLE)?;
        Ok(Self {
            told,
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
            hang_up: signal(SignalKind::hangup())?,
            terminal,
        })
    }

    /// Waits for a reason to end, tells it, and gives the loop its time. A second signal ends at once; a hang-up
    /// comes as a signal, as a lost terminal, or as both, and is one.
    async fn run(mut self) {
        let first = self.next().await;
        // A full channel holds a reason already.
        self.told.try_send(first).ok();
        let mut gone = first == Ending::Gone;
        let deadline = Instant::now() + PATIENCE;
        loop {
            tokio::select! {
                () = tokio::time::sleep_until(deadline) => break,
                _ = self.terminate.recv() => break,
                _ = self.interrupt.recv() => break,
                () = closed(&self.terminal), if !gone => gone = true,
            }
        }
        leave(gone);
    }

    async fn next(&mut self) -> Ending {
        tokio::select! {
            _ = self.terminate.recv() => Ending::Told,
            _ = self.interrupt.recv() => Ending::Told,
            _ = self.hang_up.recv() => Ending::Gone,
            () = closed(&self.terminal) => Ending::Gone,
        }
    }
}

/// Comes back once the other end of the terminal is closed.
async fn closed(terminal: &AsyncFd<OwnedFd>) {
    loop {
        match terminal.ready(Interest::READABLE).await {
            Ok(ready) if ready.ready().is_read_closed() => return,
            // Somebody typed; the input thread reads it.
            Ok(mut ready) => ready.clear_ready(),
            Err(_) => return,
        }
    }
}

/// Ends the process. The terminal gets its sequences if it takes them in time.
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
