//! The engine of a console that found none: `holdpoint serve` in a new process session, and a console attached to
//! it.
//!
//! Owns how it starts, with which arguments, and how long the start may take. The engine itself decides when it
//! ends, by the attached consoles.

use std::ffi::{OsStr, OsString};
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use super::profile_choice::RequestedProfile;
use super::run::{LivePace, RunArgs};
use crate::error::ErrorDocument;
use holdpoint_console::run::StartedEngine;
use holdpoint_protocol::console_presence::ConsolePresence;
use holdpoint_service::control_socket::{ControlSocketError, SHOWN_TO_NOBODY};
use holdpoint_service::engine_handle::{EngineEndError, EngineHandle, LaunchConfig};
use holdpoint_store::{Layout, lock_owner};
use holdpoint_text::{ErrorReason, Hint as _, Problem, Untrusted};
use holdpoint_wording::program::run as sentences;

/// The time limit for its first answer. The socket opens before the history is read, so the store's size does not
/// matter.
pub const UP_WITHIN: Duration = Duration::from_secs(20);

/// How long it runs without an attached console by default, s: long enough to reconnect after a broken line.
pub const LINGER_SECS: u32 = 60;

/// The log file for its faults, beside the store's other logs.
pub const LOG_NAME: &str = "engine.log";

/// The size limit of the log, bytes; at the next start a longer one replaces the previous copy.
const LOG_BYTES_MAX: u64 = 1024 * 1024;

/// The bytes at the end of the log that are read for its last message.
const WORDS_BYTES_MAX: u64 = 4096;

/// The pause between two checks.
const LOOK: Duration = Duration::from_millis(5);

/// The pause between two checks while another process has the store.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// See the module comment.
pub(super) struct ConsoleEngine {
    layout: Layout,
    arguments: Vec<OsString>,
    /// Options that do not apply to another engine.
    start_options: Vec<&'static str>,
}

impl ConsoleEngine {
    /// The engine for the store in this folder, with the options of `run`.
    pub(super) fn new(data: &Path, args: &RunArgs) -> Self {
        let mut arguments: Vec<OsString> =
            ["serve", "--own-session", "--quiet", "--json", "--data"].map(Into::into).into();
        arguments.push(data.into());
        let mut add_option = |name: &str, value: &OsStr| {
            // `--option=value`, because a value may begin with a dash.
            let mut argument = OsString::from(name);
            argument.push("=");
            argument.push(value);
            arguments.push(argument);
        };
        add_option("--attended", args.linger.unwrap_or(LINGER_SECS).to_string().as_ref());
        match &args.engine.profile {
            Some(RequestedProfile::BuiltIn(name)) => add_option("--profile", name.name().as_ref()),
            Some(RequestedProfile::Own(name)) => add_option("--profile", name.as_str().as_ref()),
            Some(RequestedProfile::File(path)) => add_option("--profile", path.as_ref()),
            None => {}
        }
        if let Some(robot) = &args.engine.robot {
            add_option("--robot", robot.as_ref());
        }
        if let Some(site) = &args.engine.site {
            add_option("--site", site.as_ref());
        }
        if let Some(jobs) = args.engine.jobs {
            add_option("--jobs", jobs.to_string().as_ref());
        }
        match args.pace {
            Some(LivePace::Times(times)) => add_option("--pace", times.to_string().as_ref()),
            Some(LivePace::Max) => add_option("--pace", "max".as_ref()),
            None => {}
        }
        if let Some(view) = args.scenes.view {
            add_option("--view", view.to_string().as_ref());
        }
        if args.scenes.no_recording {
            arguments.push("--no-recording".into());
        }
        Self { layout: Layout::new(data), arguments, start_options: args.start_options() }
    }

    /// Starts it and attaches. If no process can be started, the engine runs `here` and the console says so.
    pub(super) fn begin(
        self,
        presence: ConsolePresence,
        here: LaunchConfig,
    ) -> Result<StartedEngine, EngineEndError> {
        self.layout.create().map_err(|error| EngineEndError::of(error.sentence()))?;
        let path = self.layout.logs().join(LOG_NAME);
        let process = ServiceLog::open(path).and_then(|log| Ok((self.spawn(&log)?, log)));
        match process {
            Ok((child, log)) => {
                let (host, is_own) = self.attach(child, &log, &presence)?;
                let notice = (!is_own && !self.start_options.is_empty())
                    .then(|| sentences::attached_to_other(&self.start_options.join(", ")));
                Ok(StartedEngine { host, notice })
            }
            Err(error) => {
                let notice = sentences::engine_inside_console(error);
                Ok(StartedEngine { host: EngineHandle::start(here), notice: Some(notice) })
            }
        }
    }

    fn spawn(&self, log: &ServiceLog) -> io::Result<Child> {
        Command::new(std::env::current_exe()?)
            .args(&self.arguments)
            // A service manager knows the console's process only.
            .env_remove("NOTIFY_SOCKET")
            .env_remove("WATCHDOG_USEC")
            .stdin(Stdio::null())
            .stdout(log.file.try_clone()?)
            .stderr(log.file.try_clone()?)
            .spawn()
    }

    /// Waits until it answers; tells whether it is this console's engine. If another console was first, its engine
    /// serves.
    fn attach(
        &self,
        mut child: Child,
        log: &ServiceLog,
        presence: &ConsolePresence,
    ) -> Result<(EngineHandle, bool), EngineEndError> {
        let until = Instant::now() + UP_WITHIN;
        let mut ended: Option<ExitStatus> = None;
        loop {
            let found = EngineHandle::find(&self.layout, presence.clone());
            match found {
                Ok(Some(host)) => {
                    let is_own = host.process() == i32::try_from(child.id()).ok();
                    // Only this process waits for the child's end.
                    let wait = move || drop(child.wait());
                    drop(std::thread::Builder::new().name("service".to_owned()).spawn(wait));
                    return Ok((host, is_own));
                }
                // Another engine holds the store and has no socket yet, or no free place for a console.
                Err(ControlSocketError::Closed { text, .. }) if text != SHOWN_TO_NOBODY => {
                    return Err(EngineEndError::in_use(text));
                }
                Err(ControlSocketError::Closed { .. }) if ended.is_some() => {
                    return Err(EngineEndError::in_use(log.last_error()));
                }
                // The engine that holds the store has another version, or is silent.
                Err(error @ (ControlSocketError::Silent { .. } | ControlSocketError::Protocol { .. }))
                    if ended.is_some() =>
                {
                    return Err(EngineEndError::in_use(error.sentence()));
                }
                // No engine yet, or one that is about to open its socket.
                Ok(None) | Err(_) => {}
            }
            if ended.is_none() {
                ended = child.try_wait().ok().flatten();
            }
            let is_in_use = ended.is_some() && matches!(lock_owner(&self.layout), Ok(Some(_)));
            if ended.is_some() && !is_in_use {
                // The engine that held the store has released it.
                let is_free = log.found_store_in_use() && Instant::now() < until;
                let Some(again) = is_free.then(|| self.spawn(log).ok()).flatten() else {
                    return Err(EngineEndError::of(log.last_error()));
                };
                (child, ended) = (again, None);
            }
            if Instant::now() >= until {
                return Err(match ended {
                    Some(_) => EngineEndError::in_use(log.last_error()),
                    None => Self::give_up(child, log),
                });
            }
            std::thread::sleep(if is_in_use { LOOK_AGAIN } else { LOOK });
        }
    }

    /// Ends an engine that does not answer: no engine may run unseen.
    fn give_up(mut child: Child, log: &ServiceLog) -> EngineEndError {
        drop(child.kill());
        drop(child.wait());
        let secs = UP_WITHIN.as_secs();
        EngineEndError::of(format!(
            "the engine did not answer within {secs} s and was ended; {}",
            log.last_error()
        ))
    }
}

/// The log of the engine.
struct ServiceLog {
    path: PathBuf,
    file: File,
    /// Where this engine's output begins.
    from: u64,
}

impl ServiceLog {
    fn open(path: PathBuf) -> io::Result<Self> {
        if std::fs::metadata(&path).is_ok_and(|found| found.len() > LOG_BYTES_MAX) {
            std::fs::rename(&path, path.with_extension("log.1"))?;
        }
        let file = OpenOptions::new().append(true).create(true).mode(0o600).open(&path)?;
        let from = file.metadata()?.len();
        Ok(Self { path, file, from })
    }

    /// Its last message: the error if it printed one, else its last line, with the path of the log.
    fn last_error(&self) -> String {
        let text = self.read().unwrap_or_default();
        let last_line = || text.lines().map(str::trim).rfind(|line| !line.is_empty());
        let message = match error_in(&text) {
            Some(ErrorDocument { error, hint, .. }) => Problem::from((error, hint)).sentence(),
            None => last_line().map_or_else(
                || format!("it ended without a message; its log is {:?}", self.path),
                ToOwned::to_owned,
            ),
        };
        Untrusted::new(message).line().into_string()
    }

    /// Whether it ended because another engine uses the store.
    fn found_store_in_use(&self) -> bool {
        let error = error_in(&self.read().unwrap_or_default());
        error.is_some_and(|error| error.reason == ErrorReason::StoreInUse.name())
    }

    fn read(&self) -> io::Result<String> {
        let mut file = File::open(&self.path)?;
        let end = file.metadata()?.len();
        file.seek(SeekFrom::Start(self.from.max(end.saturating_sub(WORDS_BYTES_MAX))))?;
        let mut bytes = Vec::new();
        file.take(WORDS_BYTES_MAX).read_to_end(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }
}

/// The last error among the printed lines.
fn error_in(text: &str) -> Option<ErrorDocument> {
    text.lines().rev().find_map(|line| serde_json::from_str(line).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::CliError;
    use clap::Parser as _;
    use holdpoint_store::StoreError;
    use std::io::Write as _;

    #[derive(clap::Parser)]
    struct RunCommandLine {
        #[command(flatten)]
        args: RunArgs,
    }

    /// The engine gets the options of the command line and nothing else.
    #[test]
    fn the_engine_gets_the_options_of_the_console() {
        let arguments_of = |options: &[&str]| -> Vec<String> {
            let args = RunCommandLine::parse_from([&["run"], options].concat()).args;
            let service = ConsoleEngine::new(Path::new("/data"), &args);
            service.arguments.into_iter().map(|argument| argument.into_string().unwrap()).collect()
        };
        let always = ["serve", "--own-session", "--quiet", "--json", "--data", "/data"];
        assert_eq!(arguments_of(&[]), [&always[..], &["--attended=60"]].concat());
        let options = [
            "--profile=human",
            "--robot=a.urdf",
            "--site=site.toml",
            "--jobs=1",
            "--pace=0.5",
            "--view=127.0.0.1:9876",
            "--no-recording",
        ];
        let rest = [&["--attended=5"][..], &options].concat();
        assert_eq!(arguments_of(&[&["--linger=5"][..], &options].concat()), [&always[..], &rest].concat());
        for value in ["--profile=press-3", "--profile=./own.toml", "--pace=max"] {
            assert!(arguments_of(&[value]).contains(&value.to_owned()), "{value}");
        }
        // The look of the console does not concern the engine.
        assert_eq!(arguments_of(&["--ascii", "--as", "ana", "--read-only"]), arguments_of(&[]));
    }

    #[test]
    fn last_error_is_the_printed_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(LOG_NAME);
        std::fs::write(&path, "error: an older one\n").unwrap();
        let log = ServiceLog::open(path).unwrap();
        let message = log.last_error();
        assert!(message.contains(LOG_NAME) && !message.contains("an older one"), "{message}");
        let mut file = log.file.try_clone().unwrap();
        let error = Problem::new("the disk is full\u{1b}[2J").with_hint("make room");
        writeln!(file, "something").unwrap();
        CliError::usage(error).print_json(&mut file);
        assert!(!log.found_store_in_use());
        let message = log.last_error();
        assert!(
            message.starts_with("the disk is full") && message.ends_with(". Hint: make room"),
            "{message}"
        );
        assert!(!message.contains('\u{1b}'), "{message:?}");
        let in_use = StoreError::InUse { path: "/data".into(), owner: "process 7".to_owned() };
        CliError::usage(in_use).print_json(&mut file);
        assert!(log.found_store_in_use());
        // A long log is renamed.
        file.set_len(LOG_BYTES_MAX + 1).unwrap();
        let log = ServiceLog::open(folder.path().join(LOG_NAME)).unwrap();
        assert_eq!((log.from, folder.path().join("engine.log.1").is_file()), (0, true));
    }
}
