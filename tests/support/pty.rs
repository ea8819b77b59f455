//! The program on its own terminal: keys go in, bytes come out, and a parser gives the visible screen.
//!
//! Each wait is for a condition, never for a time. Only the reading thread touches the parser's input.

#[path = "quick_folder.rs"]
mod quick_folder;

use std::ffi::OsStr;
use std::io::{Read as _, Write};
use std::num::NonZeroU16;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use portable_pty::{Child, CommandBuilder, ExitStatus, MasterPty, PtySize, native_pty_system};
use quick_folder::quick_folder;

/// Longer than any step takes on two busy cores.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// The end of a frame: a synchronized update of the screen.
const FRAME_END: &[u8] = b"\x1b[?2026l";

/// The output so far.
struct ScreenState {
    parser: vt100::Parser,
    raw: Vec<u8>,
    chunks: u64,
    closed: bool,
}

/// A running console.
pub struct Console {
    child: Box<dyn Child + Send + Sync>,
    master: Option<Box<dyn MasterPty + Send>>,
    writer: Option<Box<dyn Write + Send>>,
    seen: Arc<(Mutex<ScreenState>, Condvar)>,
    let_go: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

/// A separate home and store.
pub struct Home {
    folder: tempfile::TempDir,
}

impl Home {
    pub fn new() -> Self {
        Self { folder: quick_folder() }
    }

    /// For the whole life of the process, whose end does not remove it.
    pub fn on_disk() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    pub fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// The log file that fd 2 goes to.
    pub fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("state/holdpoint/holdpoint.log")).unwrap_or_default()
    }

    /// The log of an engine that a console started.
    pub fn engine_log(&self) -> String {
        std::fs::read_to_string(self.data().join("logs/engine.log")).unwrap_or_default()
    }

    /// The variables of a program in this home.
    fn variables(&self) -> Vec<(&'static str, PathBuf)> {
        let inside = |name: &str| self.folder.path().join(name);
        vec![
            ("HOME", inside("home")),
            ("XDG_STATE_HOME", inside("state")),
            ("XDG_CONFIG_HOME", inside("config")),
            ("XDG_DATA_HOME", inside("share")),
        ]
    }

    /// The program without a terminal.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(program());
        command.args(arguments).arg("--data").arg(self.data()).envs(self.variables());
        command
    }

    /// Runs the program without a terminal.
    pub fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().unwrap()
    }

    /// Runs the program without a terminal and accepts only success.
    pub fn must(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Opens the console on a terminal of this size, in columns and rows.
    pub fn console(&self, arguments: &[&str], size: (u16, u16)) -> Console {
        self.console_with(arguments, size, &[])
    }

    /// As [`Home::console`], with more variables.
    pub fn console_with(&self, arguments: &[&str], size: (u16, u16), variables: &[(&str, &str)]) -> Console {
        let mut command = CommandBuilder::new(program());
        command.args(arguments.iter().map(OsStr::new));
        command.arg("--data");
        command.arg(self.data());
        self.set_environment(&mut command);
        for (name, value) in variables {
            command.env(name, value);
        }
        Console::spawn(command, size)
    }

    /// Runs a line of a shell on a terminal of this size. The line names the program `holdpoint`; its store is the
    /// default one of this home.
    pub fn shell(&self, line: &str, size: (u16, u16)) -> Console {
        let mut path = program().parent().unwrap().as_os_str().to_owned();
        if let Some(rest) = std::env::var_os("PATH") {
            path.push(":");
            path.push(rest);
        }
        let mut command = CommandBuilder::new("sh");
        command.args(["-c", line]);
        command.env("PATH", path);
        self.set_environment(&mut command);
        Console::spawn(command, size)
    }

    /// Gives a program this home, and a terminal with known abilities.
    fn set_environment(&self, command: &mut CommandBuilder) {
        command.cwd(self.folder.path());
        for variable in ["NO_COLOR", "COLORTERM", "HOLDPOINT_TEST_PANIC", "RUST_BACKTRACE"] {
            command.env_remove(variable);
        }
        for (name, value) in self.variables() {
            command.env(name, value);
        }
        command.env("TERM", "xterm-256color");
        // The background is known, so that the console does not wait for an answer that this terminal does not give.
        command.env("COLORFGBG", "15;0");
    }
}

impl Console {
    fn spawn(command: CommandBuilder, (columns, rows): (u16, u16)) -> Self {
        let pair = native_pty_system().openpty(pty_size(columns, rows)).unwrap();
        let child = pair.slave.spawn_command(command).unwrap();
        drop(pair.slave);
        let mut output = pair.master.try_clone_reader().unwrap();
        let writer = pair.master.take_writer().unwrap();
        let parser = vt100::Parser::new(nonzero(rows), nonzero(columns), 0);
        let seen = ScreenState { parser, raw: Vec::new(), chunks: 0, closed: false };
        let seen = Arc::new((Mutex::new(seen), Condvar::new()));
        let let_go = Arc::new(AtomicBool::new(false));
        let (reader_seen, stops) = (Arc::clone(&seen), Arc::clone(&let_go));
        let reader = std::thread::spawn(move || {
            let mut bytes = [0; 16 * 1024];
            loop {
                let count = output.read(&mut bytes).unwrap_or(0);
                // A failed test has already reported this.
                let Ok(mut seen) = reader_seen.0.lock() else { return };
                seen.parser.process(&bytes[..count]);
                seen.raw.extend_from_slice(&bytes[..count]);
                seen.chunks += 1;
                seen.closed = count == 0;
                reader_seen.1.notify_all();
                if count == 0 || stops.load(Ordering::Acquire) {
                    return;
                }
            }
        });
        Self { child, master: Some(pair.master), writer: Some(writer), seen, let_go, reader: Some(reader) }
    }

    /// Waits until the screen meets a condition.
    pub fn wait_for(&self, what: &str, is: impl Fn(&vt100::Screen) -> bool) {
        self.wait_until(what, |seen| is(seen.parser.screen()));
    }

    /// Waits until a text is on the screen.
    pub fn wait_for_text(&self, text: &str) {
        self.wait_for(text, |screen| screen.contents().contains(text));
    }

    /// As [`Console::wait_for`], for at most this time.
    pub fn wait_for_within(&self, patience: Duration, what: &str, is: impl Fn(&vt100::Screen) -> bool) {
        drop(self.seen_when(patience, what, |seen| is(seen.parser.screen())));
    }

    /// The screen once a whole frame meets a condition.
    pub fn screen_when(
        &self,
        patience: Duration,
        what: &str,
        is: impl Fn(&vt100::Screen) -> bool,
    ) -> vt100::Screen {
        let is_met = |seen: &ScreenState| seen.raw.ends_with(FRAME_END) && is(seen.parser.screen());
        self.seen_when(patience, what, is_met).parser.screen().clone()
    }

    /// Waits until the bytes so far meet a condition or the program ends. Returns whether they meet it.
    pub fn met_before_end(&self, patience: Duration, what: &str, is: impl Fn(&[u8]) -> bool) -> bool {
        let is_over = |seen: &ScreenState| seen.closed || is(&seen.raw);
        let seen = self.seen_when(patience, what, is_over);
        is(&seen.raw)
    }

    /// Waits until the bytes so far meet a condition.
    pub fn wait_for_bytes(&self, what: &str, is: impl Fn(&[u8]) -> bool) {
        self.wait_until(what, |seen| is(&seen.raw));
    }

    /// Waits until the output since the last clearing, on a screen of this size, meets a condition. After a change of
    /// size, older output does not count.
    pub fn wait_for_repainted(&self, what: &str, size: (u16, u16), is: impl Fn(&vt100::Screen) -> bool) {
        self.wait_until(what, |seen| {
            let clear = b"\x1b[2J";
            let cleared = seen.raw.windows(clear.len()).rposition(|bytes| bytes == clear).unwrap_or(0);
            let mut parser = vt100::Parser::new(nonzero(size.1), nonzero(size.0), 0);
            parser.process(&seen.raw[cleared..]);
            is(parser.screen())
        });
    }

    fn wait_until(&self, what: &str, is: impl Fn(&ScreenState) -> bool) {
        drop(self.seen_when(PATIENCE, what, is));
    }

    /// The output so far, once it meets a condition.
    fn seen_when(
        &self,
        patience: Duration,
        what: &str,
        is: impl Fn(&ScreenState) -> bool,
    ) -> MutexGuard<'_, ScreenState> {
        let until = Instant::now() + patience;
        let mut seen = self.lock();
        while !is(&seen) {
            let left = until.saturating_duration_since(Instant::now());
            let screen = seen.parser.screen().contents();
            let ended = if seen.closed { ", the program has ended" } else { "" };
            assert!(
                !left.is_zero() && !seen.closed,
                "waited too long for {what:?}{ended}; on the screen:\n{screen}"
            );
            seen = self.seen.1.wait_timeout(seen, left).unwrap().0;
        }
        seen
    }

    /// The text of the screen.
    pub fn contents(&self) -> String {
        self.lock().parser.screen().contents()
    }

    /// Every byte so far.
    pub fn raw(&self) -> String {
        String::from_utf8_lossy(&self.lock().raw).into_owned()
    }

    fn lock(&self) -> MutexGuard<'_, ScreenState> {
        self.seen.0.lock().unwrap()
    }

    /// Presses keys.
    pub fn keys(&mut self, keys: &str) {
        let writer = self.writer.as_mut().unwrap();
        writer.write_all(keys.as_bytes()).unwrap();
        writer.flush().unwrap();
    }

    /// Resizes the terminal. Later output is read at that size.
    pub fn resize(&self, columns: u16, rows: u16) {
        self.lock().parser.set_size(nonzero(rows), nonzero(columns));
        self.master.as_ref().unwrap().resize(pty_size(columns, rows)).unwrap();
    }

    /// Sends a signal.
    pub fn signal(&self, signal: rustix::process::Signal) {
        let id = i32::try_from(self.child.process_id().unwrap()).unwrap();
        rustix::process::kill_process(rustix::process::Pid::from_raw(id).unwrap(), signal).unwrap();
    }

    /// The process.
    pub fn id(&self) -> u32 {
        self.child.process_id().unwrap()
    }

    /// Whether the terminal is in a shell's state: lines, echo, signals.
    pub fn is_cooked(&self) -> bool {
        use rustix::termios::LocalModes;
        let path = self.master.as_ref().unwrap().tty_name().unwrap();
        let tty = std::fs::File::open(path).unwrap();
        let modes = rustix::termios::tcgetattr(tty).unwrap().local_modes;
        modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG)
    }

    /// Sets a shell's state, as a shell does while the program is suspended.
    pub fn cook(&self) {
        use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
        let path = self.master.as_ref().unwrap().tty_name().unwrap();
        let tty = std::fs::File::open(path).unwrap();
        let mut settings = tcgetattr(&tty).unwrap();
        settings.local_modes |= LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG;
        tcsetattr(&tty, OptionalActions::Now, &settings).unwrap();
    }

    /// Waits for the end of the program and of its output.
    pub fn end(&mut self) -> ExitStatus {
        self.end_within(PATIENCE)
    }

    /// As [`Console::end`], for at most this time.
    pub fn end_within(&mut self, patience: Duration) -> ExitStatus {
        let until = Instant::now() + patience;
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(Instant::now() < until, "the program does not end; on the screen:\n{}", self.contents());
            // The end of the program closes its side of the terminal, which wakes the reader.
            let seen = self.lock();
            drop(self.seen.1.wait_timeout(seen, Duration::from_millis(20)).unwrap());
        };
        if let Some(reader) = self.reader.take() {
            reader.join().unwrap();
        }
        status
    }

    /// Closes this side of the terminal, like closing a window. Returns how long the program took to end, and its
    /// status.
    pub fn hang_up(&mut self) -> (Duration, ExitStatus) {
        self.let_go.store(true, Ordering::Release);
        // The next frame releases the reader; there are at least two a second.
        self.reader.take().unwrap().join().unwrap();
        drop(self.writer.take());
        let begun = Instant::now();
        drop(self.master.take());
        let status = self.child.wait().unwrap();
        (begun.elapsed(), status)
    }
}

impl Drop for Console {
    fn drop(&mut self) {
        // A failed test leaves no program behind.
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// The program that was built with this test, or beside the folder of this example.
fn program() -> PathBuf {
    match option_env!("CARGO_BIN_EXE_holdpoint") {
        Some(path) => PathBuf::from(path),
        None => std::env::current_exe().unwrap().ancestors().nth(2).unwrap().join("holdpoint"),
    }
}

fn pty_size(columns: u16, rows: u16) -> PtySize {
    PtySize { rows, cols: columns, pixel_width: 0, pixel_height: 0 }
}

fn nonzero(value: u16) -> NonZeroU16 {
    NonZeroU16::new(value).unwrap()
}
