//! `holdpoint doctor`: whether this machine and terminal have what Holdpoint needs. Changes nothing.

use std::io::IsTerminal;
use std::path::Path;

use clap::Args;
use serde::Serialize;

use super::output::TextTable;
use super::recordings::size;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_audit::witness::witness_heads;
use holdpoint_recordings::{recording_folder, viewer};
use holdpoint_registry::store_info;
use holdpoint_store::Layout;
use holdpoint_text::Hint;
use holdpoint_wording::program::doctor as sentences;

/// The oldest SQLite without the WAL-reset defect.
const SQLITE_MIN: (u32, u32, u32) = (3, 51, 3);

/// The smallest terminal that shows more than alarms and approvals, columns and rows.
const TERMINAL_MIN: (u16, u16) = (60, 16);

/// The terminal that shows everything, columns and rows.
const TERMINAL_FULL: (u16, u16) = (100, 30);

/// The libraries whose versions are reported.
const LIBRARIES: [&str; 7] =
    ["rapier3d", "nalgebra", "rusqlite", "cedar-policy", "ed25519-dalek", "sha2", "tokio"];

/// The arguments of `doctor`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 2 if something required is missing.

Examples:
  holdpoint doctor
  holdpoint doctor --data /tmp/try --json")]
pub struct DoctorArgs {}

/// The status of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FindingStatus {
    /// As required, or for information.
    Ok,
    /// Works in part.
    Limited,
    /// Does not work.
    Missing,
}

impl FindingStatus {
    const fn label(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Limited => "limited",
            Self::Missing => "MISSING",
        }
    }
}

/// One finding.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DoctorFinding {
    /// The item.
    pub item: String,
    /// Whether it works.
    pub standing: FindingStatus,
    /// The result, and the remedy.
    pub detail: String,
}

fn finding(item: &str, status: FindingStatus, detail: impl Into<String>) -> DoctorFinding {
    DoctorFinding { item: item.to_owned(), standing: status, detail: detail.into() }
}

/// Checks and prints.
///
/// # Errors
/// If the output cannot be written.
pub fn run(context: &CliContext, _args: &DoctorArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let variable = |name: &str| std::env::var(name).ok();
    let size = terminal_size::terminal_size().map(|(width, height)| (width.0, height.0));
    let mut findings = vec![finding("holdpoint", FindingStatus::Ok, env!("CARGO_PKG_VERSION"))];
    findings.extend(terminal(std::io::stdout().is_terminal(), size, variable));
    findings.push(store(&context.data));
    findings.extend(witnesses(&context.data));
    findings.push(sqlite(rusqlite::version()));
    findings.push(recordings(&context.data));
    findings.push(viewer(viewer::path().as_deref()));
    findings.extend(libraries(include_str!("../../Cargo.lock")));
    out.answer(&serde_json::json!({ "checks": findings }), |out| {
        let mut table = TextTable::new(&["item", "standing", "detail"]);
        for finding in &findings {
            table.row([finding.item.as_str(), finding.standing.label(), &finding.detail]);
        }
        out.table(&table)
    })?;
    let missing = findings.iter().any(|finding| finding.standing == FindingStatus::Missing);
    Ok(if missing { Exit::Usage } else { Exit::Confirmed })
}

fn terminal(
    is_terminal: bool,
    size: Option<(u16, u16)>,
    variable: impl Fn(&str) -> Option<String>,
) -> Vec<DoctorFinding> {
    let set = |name: &str| variable(name).filter(|value| !value.is_empty());
    let term = set("TERM").unwrap_or_else(|| "not set".to_owned());
    let screen = match (is_terminal, size) {
        _ if term == "dumb" => (FindingStatus::Limited, sentences::DUMB_TERMINAL.to_owned()),
        (false, _) | (true, None) => (FindingStatus::Limited, sentences::NO_TERMINAL.to_owned()),
        (true, Some((width, height))) => {
            let fits = |(w, h): (u16, u16)| width >= w && height >= h;
            let status = if fits(TERMINAL_MIN) { FindingStatus::Ok } else { FindingStatus::Limited };
            (status, sentences::terminal_size(width, height, fits(TERMINAL_FULL), fits(TERMINAL_MIN)))
        }
    };
    let color = if set("NO_COLOR").is_some() {
        sentences::NO_COLOR
    } else if set("COLORTERM").is_some_and(|value| value == "truecolor" || value == "24bit") {
        "16 million"
    } else if term.contains("256color") {
        "256"
    } else if term == "dumb" || term == "not set" {
        "none"
    } else {
        "16"
    };
    let locale = ["LC_ALL", "LC_CTYPE", "LANG"].into_iter().find_map(set).unwrap_or_default();
    let unicode = locale.to_lowercase().replace('-', "").contains("utf8");
    vec![
        finding("terminal", screen.0, screen.1),
        finding("colors", FindingStatus::Ok, sentences::colors(color, &term)),
        finding(
            "characters",
            if unicode { FindingStatus::Ok } else { FindingStatus::Limited },
            if unicode { "UTF-8" } else { sentences::NO_UTF8 },
        ),
    ]
}

/// Whether the store's folder, or its nearest existing ancestor, is writable.
fn store(data: &Path) -> DoctorFinding {
    let exists = data.exists();
    let Some(nearest) = data.ancestors().find(|path| path.is_dir() || path.as_os_str().is_empty()) else {
        return finding("store", FindingStatus::Missing, sentences::no_parent_folder(data.display()));
    };
    let nearest = if nearest.as_os_str().is_empty() { Path::new(".") } else { nearest };
    let shown = data.display();
    if exists && !data.is_dir() {
        return finding("store", FindingStatus::Missing, sentences::no_folder(shown));
    }
    match rustix::fs::access(nearest, rustix::fs::Access::WRITE_OK | rustix::fs::Access::EXEC_OK) {
        Err(error) => {
            finding("store", FindingStatus::Missing, sentences::not_writable(nearest.display(), error))
        }
        Ok(()) if Layout::new(data).database().is_file() => {
            finding("store", FindingStatus::Ok, sentences::store_is_in(shown))
        }
        Ok(()) => finding("store", FindingStatus::Ok, sentences::store_will_be_created_in(shown)),
    }
}

/// Whether the store's witnesses are writable.
fn witnesses(data: &Path) -> Vec<DoctorFinding> {
    let database = Layout::new(data).database();
    if !database.is_file() {
        return Vec::new();
    }
    let known = store_info(data).map(|info| (info.store_id, info.witnesses));
    let (store_id, folders) = match known {
        Ok(known) => known,
        Err(error) => return vec![finding("witnesses", FindingStatus::Limited, error.sentence())],
    };
    let look = |folder: String| match witness_heads(&folder, &store_id) {
        Ok(heads) => {
            let detail = sentences::witness(&folder, usize::try_from(heads).unwrap_or(0));
            finding("witness", FindingStatus::Ok, detail)
        }
        Err(problem) => finding("witness", FindingStatus::Limited, format!("{folder}: {problem}")),
    };
    folders.into_iter().map(look).collect()
}

fn sqlite(version: &str) -> DoctorFinding {
    let mut parts = version.split('.').map(|part| part.parse::<u32>().ok());
    let mut next = || parts.next().flatten();
    match (next(), next(), next()) {
        (Some(a), Some(b), Some(c)) if (a, b, c) >= SQLITE_MIN => {
            finding("sqlite", FindingStatus::Ok, version)
        }
        _ => finding("sqlite", FindingStatus::Missing, sentences::too_old(version, SQLITE_MIN)),
    }
}

/// Whether a scene viewer is available, and which.
fn viewer(path: Option<&std::ffi::OsStr>) -> DoctorFinding {
    match viewer::find(path) {
        Ok(found) => finding(
            "viewer",
            FindingStatus::Ok,
            sentences::scene_viewer(found.version, found.program.display()),
        ),
        Err(error) => finding("viewer", FindingStatus::Limited, error.sentence()),
    }
}

/// The size of the store's recordings.
fn recordings(data: &Path) -> DoctorFinding {
    let folder = Layout::new(data).recordings();
    match recording_folder::list(&folder) {
        Ok(files) => {
            let bytes = files.iter().map(|filed| filed.bytes).sum();
            let detail = sentences::recordings(files.len(), &size(bytes), folder.display());
            finding("recordings", FindingStatus::Ok, detail)
        }
        Err(error) => {
            let detail = sentences::unreadable_folder(folder.display(), error);
            finding("recordings", FindingStatus::Limited, detail)
        }
    }
}

/// The versions this program was built with, from its lock file.
fn libraries(lock: &str) -> Vec<DoctorFinding> {
    // If the lock file has several versions, dependents name the version they use; ours use the newest.
    let packages = || lock.split("[[package]]").map(str::trim_start);
    let own = || packages().filter(|package| package.starts_with("name = \"holdpoint"));
    let version_of = |library: &str| {
        let named = own().flat_map(str::lines).filter_map(|line| {
            let used = line.trim().strip_prefix('"')?.trim_end_matches(['"', ',']).strip_prefix(library)?;
            used.strip_prefix(' ')
        });
        let numbers = |version: &&str| {
            version.split('.').map(|part| part.parse::<u64>().unwrap_or(0)).collect::<Vec<_>>()
        };
        named.max_by_key(numbers).or_else(|| {
            let only =
                packages().find_map(|package| package.strip_prefix(&format!("name = \"{library}\"\n")))?;
            only.strip_prefix("version = \"")?.lines().next()?.strip_suffix('"')
        })
    };
    LIBRARIES
        .into_iter()
        .filter_map(|library| version_of(library).map(|version| finding(library, FindingStatus::Ok, version)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terminal_findings_follow_size_and_type() {
        for (tty, size, term, expected) in [
            (true, Some((120, 40)), "xterm-256color", FindingStatus::Ok),
            (true, Some((80, 24)), "xterm", FindingStatus::Ok),
            (true, Some((59, 24)), "xterm", FindingStatus::Limited),
            (true, Some((120, 40)), "dumb", FindingStatus::Limited),
            (true, None, "xterm", FindingStatus::Limited),
            (false, Some((120, 40)), "xterm", FindingStatus::Limited),
        ] {
            let findings = terminal(tty, size, |name| (name == "TERM").then(|| term.to_owned()));
            assert_eq!(findings[0].standing, expected, "{tty} {size:?} {term}");
        }
        for (name, value, expected) in [
            ("COLORTERM", "truecolor", "16 million"),
            ("NO_COLOR", "1", "none: NO_COLOR"),
            ("TERM", "screen-256color", "256 "),
            ("TERM", "linux", "16 "),
        ] {
            let findings = terminal(true, None, |key| (key == name).then(|| value.to_owned()));
            assert!(findings[1].detail.starts_with(expected), "{name}: {}", findings[1].detail);
        }
    }

    #[test]
    fn store_folder_and_sqlite_version_are_checked() {
        let root = tempfile::tempdir().unwrap();
        std::fs::write(root.path().join("file"), "").unwrap();
        for (path, expected) in
            [("", FindingStatus::Ok), ("deep/below", FindingStatus::Ok), ("file", FindingStatus::Missing)]
        {
            assert_eq!(store(&root.path().join(path)).standing, expected, "{path}");
        }
        assert!(!root.path().join("deep").exists(), "a check must not create folders");
        for (version, expected) in [
            ("3.51.3", FindingStatus::Ok),
            ("4.0.0", FindingStatus::Ok),
            ("3.51.2", FindingStatus::Missing),
            ("x", FindingStatus::Missing),
        ] {
            assert_eq!(sqlite(version).standing, expected, "{version}");
        }
        assert_eq!(sqlite(rusqlite::version()).standing, FindingStatus::Ok);
    }

    #[test]
    fn every_library_is_in_the_lock_file() {
        let found = libraries(include_str!("../../Cargo.lock"));
        assert_eq!(found.iter().map(|finding| finding.item.as_str()).collect::<Vec<_>>(), LIBRARIES);
        // The one that this program uses, not another dependency's.
        let sha2 = found.iter().find(|finding| finding.item == "sha2").unwrap();
        assert!(sha2.detail.starts_with("0.11."), "{}", sha2.detail);
    }

    #[test]
    fn the_viewer_shows_its_version_and_recordings_their_size() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("rerun");
        let program = |version: &str| {
            std::fs::write(&path, format!("#!/bin/sh\necho 'rerun-cli {version}'\n")).unwrap();
            let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
            std::fs::set_permissions(&path, mode).unwrap();
            viewer(Some(root.path().as_os_str()))
        };
        let found = program("0.36.3 (base)");
        assert_eq!(
            (found.standing, found.detail),
            (FindingStatus::Ok, format!("rerun 0.36.3 in {}", path.display()))
        );
        let old = program("0.30.0");
        assert!(old.standing == FindingStatus::Limited && old.detail.contains("0.30.0"), "{old:?}");
        assert!(viewer(None).detail.contains(viewer::INSTALL));
        let folder = Layout::new(root.path()).recordings();
        assert!(recordings(root.path()).detail.starts_with("0 files, 0 B in "));
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("grasp-1.1.0-0123abcd.rrd"), vec![0; 2048]).unwrap();
        assert_eq!(recordings(root.path()).detail, format!("1 file, 2.0 KiB in {}", folder.display()));
    }
}
