//! Finds the rerun viewer that is installed on this machine, and starts it beside this program.
//!
//! Owns the search and the accepted versions. The viewer shares neither terminal nor process group with this program.
//! Must not wait for the viewer, and needs no scene crate.

use std::borrow::Cow;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::net::{Ipv4Addr, TcpListener};
use std::os::unix::fs::OpenOptionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use holdpoint_text::file::{NO_LINK, regular};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The oldest viewer that reads what this program writes.
pub const OLDEST: ViewerVersion = ViewerVersion([0, 36, 0]);

/// How to install a version that fits.
pub const INSTALL: &str = "pip install rerun-sdk==0.36.3";

/// The name of the viewer's program.
const PROGRAM: &str = "rerun";

/// The start of its answer to `--version`; other programs of the same name answer differently.
const ANSWER_START: &str = "rerun-cli ";

/// The time limit of an answer to `--version`.
const PATIENCE: Duration = Duration::from_secs(5);

/// The interval between checks for the answer.
const PAUSE: Duration = Duration::from_millis(10);

/// The most bytes read of an answer.
const ANSWER_BYTES_MAX: u64 = 4_096;

/// The most folders read of a Python installation.
const PYTHONS_MAX: usize = 32;

/// The largest viewer log that is appended to, bytes; a larger one is truncated first.
const LOG_BYTES_MAX: u64 = 1 << 20;

/// The name of the viewer's log in the folder of logs.
pub const LOG_NAME: &str = "viewer.log";

/// A viewer's version: major, minor, patch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ViewerVersion(pub [u64; 3]);

impl fmt::Display for ViewerVersion {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self([major, minor, patch]) = self;
        write!(out, "{major}.{minor}.{patch}")
    }
}

impl ViewerVersion {
    /// Reads `rerun-cli 0.36.3 (...) ...`.
    fn parse(answer: &str) -> Option<Self> {
        let version = answer.strip_prefix(ANSWER_START)?.split_whitespace().next()?;
        // 0.37.0-alpha.1 counts as 0.37.0.
        let number = version.split(['-', '+']).next()?;
        let mut parts = number.split('.').map(|part| part.parse::<u64>().ok());
        let mut next = || parts.next().flatten();
        Some(Self([next()?, next()?, next()?]))
    }
}

/// A viewer that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Viewer {
    /// The program itself, not the script that starts it.
    pub program: PathBuf,
    pub version: ViewerVersion,
}

/// Why there is no viewer, or why it could not be started.
#[derive(Debug, thiserror::Error)]
pub enum ViewerError {
    #[error("there is no scene viewer: no `rerun` on PATH")]
    NotFound,
    /// The installed one is too old.
    #[error("the scene viewer {program:?} is version {found}; {OLDEST} or newer is needed")]
    TooOld { program: PathBuf, found: ViewerVersion },
    /// No display is available.
    #[error("there is no screen for the scene viewer: neither DISPLAY nor WAYLAND_DISPLAY is set")]
    NoScreen,
    /// Its log cannot be written.
    #[error("cannot write the scene viewer's log {path:?}: {source}")]
    Log { path: PathBuf, source: std::io::Error },
    /// It cannot be started.
    #[error("cannot start the scene viewer {program:?}: {source}")]
    Start { program: PathBuf, source: std::io::Error },
}

impl Hint for ViewerError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::NotFound | Self::TooOld { .. } | Self::NoScreen | Self::Start { .. } => {
                ErrorReason::Environment.into()
            }
            Self::Log { path, .. } => ErrorDetails::of_path(ErrorReason::CannotWrite, path),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::NotFound | Self::TooOld { .. } | Self::Start { .. } => Some(INSTALL.into()),
            Self::NoScreen | Self::Log { .. } => None,
        }
    }
}

/// A viewer that was started. Dropping this does not end it.
#[derive(Debug)]
pub struct RunningViewer {
    /// Its process, which leads a process group of its own.
    pub process: u32,
    /// The file with its output.
    pub log: PathBuf,
    ended: Receiver<bool>,
}

impl RunningViewer {
    /// Whether the viewer exited within this time, and if so whether cleanly. `None` while it runs.
    ///
    /// A viewer that cannot draw exits at once, so a caller can report that.
    #[must_use]
    pub fn ended_within(&self, patience: Duration) -> Option<bool> {
        self.ended.recv_timeout(patience).ok()
    }
}

/// Whether the environment names a display.
#[must_use]
pub fn has_screen() -> bool {
    let set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    cfg!(target_os = "macos") || set("DISPLAY") || set("WAYLAND_DISPLAY")
}

/// The first viewer in the folders of `path`, a value of PATH.
///
/// Waits up to five seconds for each program's answer to `--version`; do not call it from a thread that draws.
///
/// # Errors
/// [`ViewerError::NotFound`], [`ViewerError::TooOld`].
pub fn find(path: Option<&OsStr>) -> Result<Viewer, ViewerError> {
    for folder in std::env::split_paths(path.unwrap_or_default()) {
        let named = folder.join(PROGRAM);
        if !is_executable(&named) {
            continue;
        }
        let program = script_target(&named).unwrap_or(named);
        let Some(version) = version_of(&program) else { continue };
        if version < OLDEST {
            return Err(ViewerError::TooOld { program, found: version });
        }
        return Ok(Viewer { program, version });
    }
    Err(ViewerError::NotFound)
}

impl Viewer {
    /// Starts the viewer on recordings (files) or a live scene (an address), with its output in a log in the folder
    /// `logs`.
    ///
    /// The viewer gets its own process group: it survives the end of this program's group and can be ended as one. A
    /// thread waits for it, so that no zombie remains.
    ///
    /// # Errors
    /// [`ViewerError::Log`], [`ViewerError::Start`].
    pub fn open<T: AsRef<OsStr>>(&self, shown: &[T], logs: &Path) -> Result<RunningViewer, ViewerError> {
        let log = logs.join(LOG_NAME);
        let refused = |source| ViewerError::Log { path: log.clone(), source };
        let output = open_log(&log).map_err(refused)?;
        let errors = output.try_clone().map_err(refused)?;
        // The viewer also listens: on this machine only, and away from the port of a live scene.
        let child = Command::new(&self.program)
            .args(["--bind", "127.0.0.1", "--port", &free_port(), "--"])
            .args(shown)
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors)
            .process_group(0)
            .spawn()
            .map_err(|source| ViewerError::Start { program: self.program.clone(), source })?;
        let process = child.id();
        let ended =
            reap(child).map_err(|source| ViewerError::Start { program: self.program.clone(), source })?;
        Ok(RunningViewer { process, log, ended })
    }
}

/// A free port, or the viewer's own choice if there is none. By default the viewer takes the port of the live scene.
fn free_port() -> String {
    let probe = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|probe| probe.local_addr());
    probe.map_or_else(|_| "auto".to_owned(), |address| address.port().to_string())
}

/// Waits for a child on its own thread and reports whether it exited cleanly.
fn reap(mut child: Child) -> std::io::Result<Receiver<bool>> {
    let (tell, ended) = sync_channel(1);
    std::thread::Builder::new().name("viewer-reaper".to_owned()).spawn(move || {
        let in_order = child.wait().is_ok_and(|status| status.success());
        // The receiver may be gone.
        let _ = tell.try_send(in_order);
    })?;
    Ok(ended)
}

/// Opens a log for appending, or truncates it if it is too large.
fn open_log(path: &Path) -> std::io::Result<File> {
    let file = OpenOptions::new()
        .append(true)
        .create(true)
        .mode(0o600)
        .custom_flags(NO_LINK)
        .open(path)
        .and_then(regular)?;
    if file.metadata()?.len() > LOG_BYTES_MAX {
        file.set_len(0)?;
    }
    Ok(file)
}

fn is_executable(path: &Path) -> bool {
    path.is_file() && rustix::fs::access(path, rustix::fs::Access::EXEC_OK).is_ok()
}

/// The program that pip's script of the same name starts; `None` if this is not such a script.
///
/// The script only waits for the program, and ending the script leaves the program running.
fn script_target(named: &Path) -> Option<PathBuf> {
    let script = named.canonicalize().ok()?;
    let mut start = [0; 2];
    File::open(&script).ok()?.read_exact(&mut start).ok()?;
    if &start != b"#!" {
        return None;
    }
    // <prefix>/bin/rerun beside <prefix>/lib/python3.N/site-packages/rerun_sdk/rerun_cli.
    let prefix = script.parent()?.parent()?;
    let libraries = ["lib", "lib64"].map(|name| prefix.join(name));
    let entries = libraries.iter().filter_map(|library| std::fs::read_dir(library).ok()).flatten();
    let is_python =
        |path: &PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("python"));
    let pythons = entries.flatten().map(|entry| entry.path()).filter(is_python).take(PYTHONS_MAX);
    let inside = |python: PathBuf| {
        ["site-packages", "dist-packages"].into_iter().flat_map(move |packages| {
            let folder = python.join(packages).join("rerun_sdk").join("rerun_cli");
            [folder.join("Rerun.app/Contents/MacOS/Rerun"), folder.join(PROGRAM)]
        })
    };
    // One folder may have two names (lib64), and several Pythons may share the script: the last is taken.
    let programs = pythons.flat_map(inside).filter(|path| is_executable(path));
    programs.filter_map(|path| path.canonicalize().ok()).max()
}

/// The answer of a program to `--version`; `None` if it is not a viewer or does not answer.
fn version_of(program: &Path) -> Option<ViewerVersion> {
    let mut child = Command::new(program)
        .arg("--version")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .process_group(0)
        .spawn()
        .ok()?;
    let since = Instant::now();
    let ended = loop {
        match child.try_wait() {
            Ok(Some(status)) => break status.success(),
            Ok(None) if since.elapsed() < PATIENCE => std::thread::sleep(PAUSE),
            Ok(None) | Err(_) => break false,
        }
    };
    if !ended {
        // It has its own group, so its children end with it.
        if let Some(group) = i32::try_from(child.id()).ok().and_then(rustix::process::Pid::from_raw) {
            let _ = rustix::process::kill_process_group(group, rustix::process::Signal::KILL);
        }
        let _ = child.wait();
        return None;
    }
    let mut answer = Vec::new();
    child.stdout.take()?.take(ANSWER_BYTES_MAX).read_to_end(&mut answer).ok()?;
    ViewerVersion::parse(&String::from_utf8_lossy(&answer))
}

/// The present value of PATH.
#[must_use]
pub fn path() -> Option<OsString> {
    std::env::var_os("PATH")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A program named `rerun` that gives this answer and writes down its arguments.
    fn program(folder: &Path, answer: &str) -> PathBuf {
        std::fs::create_dir_all(folder).unwrap();
        let path = folder.join(PROGRAM);
        let text = format!(
            "#!/bin/sh\n[ \"$1\" = --version ] && echo '{answer}' && exit 0\necho \"$@\" > \"$0.asked\"\necho said\n"
        );
        std::fs::write(&path, text).unwrap();
        let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
        std::fs::set_permissions(&path, mode).unwrap();
        path
    }

    #[test]
    fn viewer_versions_are_parsed() {
        for (answer, expected) in [
            ("rerun-cli 0.36.3 (base) [rustc 1.95.0]", Some([0, 36, 3])),
            ("rerun-cli 0.37.0-alpha.1+dev", Some([0, 37, 0])),
            ("rerun-cli 1.2.3\nVideo features", Some([1, 2, 3])),
            ("rerun 0.13.0", None),
            ("rerun-cli 0.36", None),
            ("", None),
        ] {
            assert_eq!(ViewerVersion::parse(answer), expected.map(ViewerVersion), "{answer}");
        }
        assert!(
            ViewerVersion([0, 36, 3]) >= OLDEST
                && ViewerVersion([0, 35, 9]) < OLDEST
                && ViewerVersion([1, 0, 0]) > OLDEST
        );
    }

    #[test]
    fn the_first_viewer_on_the_path_is_used() {
        let root = tempfile::tempdir().unwrap();
        let (other, good) = (root.path().join("other"), root.path().join("good"));
        program(&other, "rerun 0.13.0");
        let expected = program(&good, "rerun-cli 0.36.3 (base)");
        let path = std::env::join_paths([root.path().join("none"), other, good]).unwrap();
        let found = find(Some(&path)).unwrap();
        assert_eq!(found, Viewer { program: expected, version: ViewerVersion([0, 36, 3]) });
        assert!(matches!(find(None), Err(ViewerError::NotFound)));
    }

    #[test]
    fn an_unusable_viewer_is_reported_with_hint() {
        let root = tempfile::tempdir().unwrap();
        program(root.path(), "rerun-cli 0.35.2 (base)");
        let error = find(Some(root.path().as_os_str())).unwrap_err();
        assert!(matches!(error, ViewerError::TooOld { found: ViewerVersion([0, 35, 2]), .. }), "{error}");
        assert_eq!(error.hint().as_deref(), Some(INSTALL), "{error}");
        let program = root.path().join(PROGRAM);
        std::fs::set_permissions(&program, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
        let error = find(Some(root.path().as_os_str())).unwrap_err();
        assert_eq!(error.hint().as_deref(), Some(INSTALL), "{error}");
    }

    #[test]
    fn the_program_behind_pips_script_is_found() {
        let root = tempfile::tempdir().unwrap();
        let inside = root.path().join("lib/python3.12/site-packages/rerun_sdk/rerun_cli");
        let behind = program(&inside, "rerun-cli 0.36.3 (base)");
        program(&root.path().join("bin"), "rerun-cli 0.36.3 (script)");
        let shim = root.path().join("shim");
        std::fs::create_dir(&shim).unwrap();
        std::os::unix::fs::symlink(root.path().join("bin/rerun"), shim.join(PROGRAM)).unwrap();
        for folder in [root.path().join("bin"), shim] {
            let found = find(Some(folder.as_os_str())).unwrap().program;
            assert_eq!(found.canonicalize().unwrap(), behind.canonicalize().unwrap(), "{folder:?}");
        }
    }

    #[test]
    fn the_viewer_runs_detached_and_logs_its_output() {
        let root = tempfile::tempdir().unwrap();
        let program = program(root.path(), "rerun-cli 0.36.3");
        let viewer = Viewer { program: program.clone(), version: OLDEST };
        let opened = viewer.open(&["a b.rrd", "-c.rrd"], root.path()).unwrap();
        assert_eq!(opened.ended_within(Duration::from_secs(30)), Some(true));
        let arguments = std::fs::read_to_string(root.path().join("rerun.asked")).unwrap();
        let port = arguments.strip_prefix("--bind 127.0.0.1 --port ").and_then(|rest| rest.split_once(' '));
        let (port, shown) = port.unwrap();
        assert!(port.parse::<u16>().is_ok_and(|port| port != 0), "{arguments}");
        assert_eq!(shown, "-- a b.rrd -c.rrd\n");
        assert_eq!(std::fs::read_to_string(&opened.log).unwrap(), "said\n");
        let nowhere = viewer.open(&["a.rrd"], &root.path().join("none")).unwrap_err();
        assert!(matches!(nowhere, ViewerError::Log { .. }), "{nowhere}");
        let gone = Viewer { program: root.path().join("gone"), version: OLDEST };
        assert!(matches!(gone.open(&["a.rrd"], root.path()), Err(ViewerError::Start { .. })));
    }
}
