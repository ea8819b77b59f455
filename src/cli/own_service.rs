//! The engine of a console that found none: `holdpoint serve` in a session of its own, and a seat at it.
//!
//! Owns how it is started, what it is started with, and how long it may take. Must not decide what becomes of it later: that
//! is the engine's, by who sits at it.

use std::ffi::{OsStr, OsString};
use std::fs::{File, OpenOptions};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use super::chosen::AskedProfile;
use super::run::{LivePace, RunArgs};
use crate::error::ErrorDocument;
use holdpoint_console::run::Begun;
use holdpoint_engine::door::{DoorError, SHOWN_TO_NOBODY};
use holdpoint_engine::host::{EndFault, Host, HostConfig};
use holdpoint_protocol::seat::Sitting;
use holdpoint_registry::{Layout, StoreError, lock_owner};
use holdpoint_text::{Hint as _, Problem, Untrusted};

/// How long it may take until it answers. Its door is open before the record is read, so the store's size is no matter.
pub const UP_WITHIN: Duration = Duration::from_secs(20);

/// For how long it goes on with nobody, unless told otherwise, s: long enough to come back after a line that broke.
pub const LINGER_SECS: u32 = 60;

/// The file beside the store's other logs that it prints faults into.
pub const LOG_NAME: &str = "engine.log";

/// The most bytes of it that are kept; a longer one is put aside at the next start, in place of the one before.
const LOG_BYTES_MAX: u64 = 1024 * 1024;

/// The most bytes of its end that are read for its own words.
const WORDS_BYTES_MAX: u64 = 4096;

/// The pause between two looks.
const LOOK: Duration = Duration::from_millis(5);

/// The pause between two looks while somebody else has the store.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// See the module's head.
pub(super) struct OwnService {
    layout: Layout,
    words: Vec<OsString>,
    /// What was asked for that another engine knows nothing of.
    asked: Vec<&'static str>,
}

impl OwnService {
    /// One for the store in this folder, with what `run` was told.
    pub(super) fn new(data: &Path, args: &RunArgs) -> Self {
        let mut words: Vec<OsString> =
            ["serve", "--own-session", "--quiet", "--json", "--data"].map(Into::into).into();
        words.push(data.into());
        let mut say = |name: &str, value: &OsStr| {
            // One word each: a value may begin with a dash.
            let mut word = OsString::from(name);
            word.push("=");
            word.push(value);
            words.push(word);
        };
        say("--attended", args.linger.unwrap_or(LINGER_SECS).to_string().as_ref());
        match &args.engine.profile {
            Some(AskedProfile::BuiltIn(name)) => say("--profile", name.name().as_ref()),
            Some(AskedProfile::Own(name)) => say("--profile", name.as_str().as_ref()),
            Some(AskedProfile::File(path)) => say("--profile", path.as_ref()),
            None => {}
        }
        if let Some(seed) = args.engine.seed {
            say("--seed", seed.to_string().as_ref());
        }
        if let Some(robot) = &args.engine.robot {
            say("--robot", robot.as_ref());
        }
        if let Some(jobs) = args.engine.jobs {
            say("--jobs", jobs.to_string().as_ref());
        }
        match args.pace {
            Some(LivePace::Times(times)) => say("--pace", times.to_string().as_ref()),
            Some(LivePace::Max) => say("--pace", "max".as_ref()),
            None => {}
        }
        if let Some(view) = args.scenes.view {
            say("--view", view.to_string().as_ref());
        }
        if args.scenes.no_recording {
            words.push("--no-recording".into());
        }
        Self { layout: Layout::new(data), words, asked: args.for_a_start() }
    }

    /// Starts it and sits down. Where no process can be started at all, the engine is started `here`, and that is said.
    pub(super) fn begin(self, sitting: Sitting, here: HostConfig) -> Result<Begun, EndFault> {
        self.layout.create().map_err(|error| EndFault::of(error.sentence()))?;
        let path = self.layout.logs().join(LOG_NAME);
        let begun = Log::open(path).and_then(|log| Ok((self.spawn(&log)?, log)));
        match begun {
            Ok((child, log)) => {
                let (host, is_own) = self.sit_down(child, &log, &sitting)?;
                let notice = (!is_own && !self.asked.is_empty()).then(|| {
                    let asked = self.asked.join(", ");
                    format!("another console was quicker: this one sits at its engine, and {asked} counts for nothing")
                });
                Ok(Begun { host, notice })
            }
            Err(error) => {
                let notice = format!(
                    "the engine lives in this console and ends with it: no process of its own could be started ({error})"
                );
                Ok(Begun { host: Host::start(here), notice: Some(notice) })
            }
        }
    }

    fn spawn(&self, log: &Log) -> io::Result<Child> {
        Command::new(std::env::current_exe()?)
            .args(&self.words)
            // A manager of services knows the console, and not this.
            .env_remove("NOTIFY_SOCKET")
            .env_remove("WATCHDOG_USEC")
            .stdin(Stdio::null())
            .stdout(log.file.try_clone()?)
            .stderr(log.file.try_clone()?)
            .spawn()
    }

    /// Waits until it answers. Where another console was quicker, its engine is as good: tells whether it is this one's.
    fn sit_down(&self, mut child: Child, log: &Log, sitting: &Sitting) -> Result<(Host, bool), EndFault> {
        let until = Instant::now() + UP_WITHIN;
        let mut ended: Option<ExitStatus> = None;
        loop {
            let found = Host::find(&self.layout, sitting.clone());
            match found {
                Ok(Some(host)) => {
                    let is_own = host.process() == i32::try_from(child.id()).ok();
                    // Nobody else waits for the end of its process.
                    let wait = move || drop(child.wait());
                    drop(std::thread::Builder::new().name("service".to_owned()).spawn(wait));
                    return Ok((host, is_own));
                }
                // Another one holds the store and shows itself to nobody, or has no seat left.
                Err(DoorError::Closed { text, .. }) if text != SHOWN_TO_NOBODY => {
                    return Err(EndFault::in_use(text));
                }
                Err(DoorError::Closed { .. }) if ended.is_some() => {
                    return Err(EndFault::in_use(log.words()));
                }
                // Whoever has it is of another version, or silent.
                Err(error @ (DoorError::Silent { .. } | DoorError::Protocol { .. })) if ended.is_some() => {
                    return Err(EndFault::in_use(error.sentence()));
                }
                // There is none yet, or it is about to be there.
                Ok(None) | Err(_) => {}
            }
            if ended.is_none() {
                ended = child.try_wait().ok().flatten();
            }
            let taken = ended.is_some() && matches!(lock_owner(&self.layout), Ok(Some(_)));
            if ended.is_some() && !taken {
                // The engine that had the store has let go of it meanwhile.
                let is_free = log.found_store_in_use() && Instant::now() < until;
                let Some(again) = is_free.then(|| self.spawn(log).ok()).flatten() else {
                    return Err(EndFault::of(log.words()));
                };
                (child, ended) = (again, None);
            }
            if Instant::now() >= until {
                return Err(match ended {
                    Some(_) => EndFault::in_use(log.words()),
                    None => Self::give_up(child, log),
                });
            }
            std::thread::sleep(if taken { LOOK_AGAIN } else { LOOK });
        }
    }

    /// One that does not answer is ended: what is not seen must not work.
    fn give_up(mut child: Child, log: &Log) -> EndFault {
        drop(child.kill());
        drop(child.wait());
        let secs = UP_WITHIN.as_secs();
        EndFault::of(format!("the engine did not answer within {secs} s and was ended; {}", log.words()))
    }
}

/// What it prints.
struct Log {
    path: PathBuf,
    file: File,
    /// Where its words begin.
    from: u64,
}

impl Log {
    fn open(path: PathBuf) -> io::Result<Self> {
        if std::fs::metadata(&path).is_ok_and(|found| found.len() > LOG_BYTES_MAX) {
            std::fs::rename(&path, path.with_extension("log.1"))?;
        }
        let file = OpenOptions::new().append(true).create(true).mode(0o600).open(&path)?;
        let from = file.metadata()?.len();
        Ok(Self { path, file, from })
    }

    /// Its last words: the error if it printed one, else its last line, with where the rest is.
    fn words(&self) -> String {
        let text = self.read().unwrap_or_default();
        let last_line = || text.lines().map(str::trim).rfind(|line| !line.is_empty());
        let said = match error_in(&text) {
            Some(ErrorDocument { error, hint, .. }) => Problem::from((error, hint)).sentence(),
            None => last_line().map_or_else(
                || format!("it ended without a word; its log is {:?}", self.path),
                ToOwned::to_owned,
            ),
        };
        Untrusted::new(said).line().into_string()
    }

    /// Whether it ended because another engine works on the store.
    fn found_store_in_use(&self) -> bool {
        let error = error_in(&self.read().unwrap_or_default());
        error.and_then(|error| error.reason).as_deref() == Some(StoreError::IN_USE)
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

/// The last error among the lines that were printed.
fn error_in(text: &str) -> Option<ErrorDocument> {
    text.lines().rev().find_map(|line| serde_json::from_str(line).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::CliError;
    use clap::Parser as _;
    use std::io::Write as _;

    #[derive(clap::Parser)]
    struct Run {
        #[command(flatten)]
        args: RunArgs,
    }

    /// What the engine is started with is what was said on the command line, and nothing else.
    #[test]
    fn the_service_is_told_what_the_console_was_told() {
        let words = |said: &[&str]| -> Vec<String> {
            let args = Run::parse_from([&["run"], said].concat()).args;
            let service = OwnService::new(Path::new("/data"), &args);
            service.words.into_iter().map(|word| word.into_string().unwrap()).collect()
        };
        let always = ["serve", "--own-session", "--quiet", "--json", "--data", "/data"];
        assert_eq!(words(&[]), [&always[..], &["--attended=60"]].concat());
        let said = [
            "--profile=human",
            "--seed=7",
            "--robot=a.urdf",
            "--jobs=1",
            "--pace=0.5",
            "--view=127.0.0.1:9876",
            "--no-recording",
        ];
        let rest = [&["--attended=5"][..], &said].concat();
        assert_eq!(words(&[&["--linger=5"][..], &said].concat()), [&always[..], &rest].concat());
        for value in ["--profile=press-3", "--profile=./own.toml", "--pace=max"] {
            assert!(words(&[value]).contains(&value.to_owned()), "{value}");
        }
        // How the console looks is nothing to the engine.
        assert_eq!(words(&["--ascii", "--as", "ana", "--read-only"]), words(&[]));
    }

    #[test]
    fn its_last_words_are_its_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(LOG_NAME);
        std::fs::write(&path, "error: an older one\n").unwrap();
        let log = Log::open(path).unwrap();
        assert!(
            log.words().contains("without a word") && log.words().contains("engine.log"),
            "{}",
            log.words()
        );
        let mut file = log.file.try_clone().unwrap();
        let error = Problem::new("the disk is full\u{1b}[2J").with_hint("make room");
        writeln!(file, "something").unwrap();
        CliError::usage(error).print_json(&mut file);
        assert!(!log.found_store_in_use());
        let words = log.words();
        assert!(words.starts_with("the disk is full") && words.ends_with(". Hint: make room"), "{words}");
        assert!(!words.contains('\u{1b}'), "{words:?}");
        let in_use = StoreError::InUse { path: "/data".into(), owner: "process 7".to_owned() };
        CliError::usage(in_use).print_json(&mut file);
        assert!(log.found_store_in_use());
        // A long one is put aside.
        file.set_len(LOG_BYTES_MAX + 1).unwrap();
        let log = Log::open(folder.path().join(LOG_NAME)).unwrap();
        assert_eq!((log.from, folder.path().join("engine.log.1").is_file()), (0, true));
    }
}
