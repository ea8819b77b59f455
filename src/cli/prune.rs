//! What `recordings prune` removes, and how. The choice is a pure function; each removal is recorded before the
//! file is removed. Never touches a recording of an open upgrade.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::CliError;
use holdpoint_approvals::Nonce;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_recordings::audit_record::{REMOVED_KIND, RecordingRemoval};
use holdpoint_recordings::recording_folder::{self, RecordingFile};
use holdpoint_registry::{Store, Views};
use holdpoint_store::{AuditBody, Transaction, VersionDetail};
use holdpoint_wording::program::recordings as sentences;
use holdpoint_wording::program::recordings::RemovalLimit;

/// The recordings to keep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct PruneLimits {
    /// The number of newest upgrades to keep.
    pub(super) keep: Option<usize>,
    /// The age limit.
    pub(super) older_than_secs: Option<u64>,
    pub(super) bytes_max: Option<u64>,
}

/// All recordings of one upgrade, kept or removed together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct UpgradeRecordings {
    pub(super) version: CapabilityId,
    /// Its files, in order.
    pub(super) files: Vec<RecordingFile>,
    /// Whether it may still be written to, or is unknown: then it stays.
    pub(super) open: bool,
}

impl UpgradeRecordings {
    fn bytes(&self) -> u64 {
        self.files.iter().map(|filed| filed.bytes).sum()
    }

    fn written_secs(&self) -> u64 {
        self.files.iter().map(|filed| filed.written_secs).max().unwrap_or(0)
    }
}

/// Recordings by upgrade, and whether the upgrade is over according to the store.
pub(super) fn upgrades(files: Vec<RecordingFile>, views: &Views) -> Result<Vec<UpgradeRecordings>, CliError> {
    let mut by_version: BTreeMap<CapabilityId, Vec<RecordingFile>> = BTreeMap::new();
    for filed in files {
        by_version.entry(filed.name.version.clone()).or_default().push(filed);
    }
    let upgrade = |(version, files)| {
        let detail = views.version(&version).map_err(CliError::usage)?;
        let open = detail.is_none_or(|detail| is_open(&detail));
        Ok(UpgradeRecordings { version, files, open })
    };
    by_version.into_iter().map(upgrade).collect()
}

/// Whether an upgrade may still be written to. A demoted version is evaluated again.
fn is_open(detail: &VersionDetail) -> bool {
    let flags = detail.summary.flags;
    match detail.summary.state {
        State::Active => flags.provisional || flags.rollback_pending,
        State::Superseded | State::RolledBack | State::Rejected => false,
        State::Registered | State::Validated | State::Sandboxed | State::Shadowed | State::Demoted => true,
    }
}

/// The upgrades to remove, each with the reason, oldest first. Open ones count toward the limits and stay.
pub(super) fn choose(
    mut upgrades: Vec<UpgradeRecordings>,
    limits: PruneLimits,
    now_secs: u64,
) -> Vec<(UpgradeRecordings, String)> {
    // Newest first; equal times by name, so the choice does not depend on the folder's order.
    upgrades.sort_by(|a, b| (b.written_secs(), &b.version).cmp(&(a.written_secs(), &a.version)));
    let mut total: u64 = upgrades.iter().map(UpgradeRecordings::bytes).sum();
    let mut chosen = Vec::new();
    for (place, upgrade) in upgrades.into_iter().enumerate().rev() {
        if upgrade.open {
            continue;
        }
        let age_secs = now_secs.saturating_sub(upgrade.written_secs());
        let limit = match limits {
            PruneLimits { keep: Some(keep), .. } if place >= keep => RemovalLimit::Newest(keep),
            PruneLimits { older_than_secs: Some(limit), .. } if age_secs > limit => {
                RemovalLimit::Days(limit / 86_400)
            }
            PruneLimits { bytes_max: Some(limit), .. } if total > limit => {
                RemovalLimit::Mebibytes(limit >> 20)
            }
            PruneLimits { .. } => continue,
        };
        total = total.saturating_sub(upgrade.bytes());
        chosen.push((upgrade, sentences::removal_reason(limit)));
    }
    chosen
}

/// Opens the store for this verb alone.
///
/// # Errors
/// If an engine runs on it, or it cannot be opened.
pub(super) fn take_store(data: &Path) -> Result<Store, CliError> {
    Store::open(data).map_err(CliError::usage)
}

/// Records the removal and its reason, then removes the file. After an interruption the file remains, and the next
/// prune finds it again.
///
/// # Errors
/// If the record cannot be written (the file then remains), or the file cannot be removed.
pub(super) fn remove(
    store: &Store,
    version: &CapabilityId,
    filed: &RecordingFile,
    reason: &str,
) -> Result<(), CliError> {
    let cannot = |error: std::io::Error| {
        let path = &filed.path;
        CliError::usage(format!("cannot remove {path:?}: {error}")).with_unwritable(path, &error)
    };
    let removed = RecordingRemoval {
        file: filed.file.clone(),
        sha256: recording_folder::digest(&filed.path).map_err(cannot)?,
        bytes: filed.bytes,
        reason: reason.to_owned(),
    };
    let views = store.views().map_err(CliError::usage)?;
    let nonce = Nonce::random().map_err(CliError::internal)?;
    let record = AuditBody {
        kind: REMOVED_KIND,
        subject: version.to_string(),
        body: serde_json::to_string(&removed).map_err(CliError::internal)?,
    };
    let transaction = Transaction {
        command_id: format!("recordings-prune-{}", nonce.as_str()),
        at_ms: views.head().map_err(CliError::usage)?.at_ms,
        wall_ms: wall_ms(),
        changes: Vec::new(),
        audit: vec![record],
    };
    store.commit(transaction).map_err(CliError::usage)?;
    std::fs::remove_file(&filed.path).map_err(cannot)
}

/// Wall time, seconds since 1970.
pub(super) fn now_secs() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

/// The wall time for a transaction, ms since 1970; 0 if the machine has none.
pub(super) fn wall_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.ok().and_then(|since| i64::try_from(since.as_millis()).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: u64 = 86_400;

    fn upgrade(version: &str, day: u64, mib: u64, open: bool) -> UpgradeRecordings {
        let file = format!("{}-0123abcd.rrd", version.replace('@', "-"));
        let filed = RecordingFile {
            name: recording_folder::RecordingName::parse(&file).unwrap(),
            path: file.clone().into(),
            file,
            bytes: mib << 20,
            written_secs: day * DAY,
        };
        UpgradeRecordings { version: version.parse().unwrap(), files: vec![filed], open }
    }

    #[test]
    fn recordings_beyond_the_limits_are_selected_for_removal() {
        let all = || {
            vec![
                upgrade("a@1.0.0", 10, 1, false),
                upgrade("a@1.1.0", 20, 2, true),
                upgrade("a@1.2.0", 30, 4, false),
                upgrade("a@1.3.0", 40, 8, false),
            ]
        };
        let limits = |keep, days: Option<u64>, mib: Option<u64>| PruneLimits {
            keep,
            older_than_secs: days.map(|days| days * DAY),
            bytes_max: mib.map(|mib| mib << 20),
        };
        for (limits, expected) in [
            (limits(Some(4), None, None), &[][..]),
            (limits(Some(2), None, None), &["a@1.0.0"]),
            (limits(Some(0), None, None), &["a@1.0.0", "a@1.2.0", "a@1.3.0"]),
            (limits(None, Some(30), None), &[]),
            (limits(None, Some(29), None), &["a@1.0.0"]),
            (limits(None, Some(9), None), &["a@1.0.0", "a@1.2.0"]),
            (limits(None, None, Some(15)), &[]),
            (limits(None, None, Some(14)), &["a@1.0.0"]),
            (limits(None, None, Some(10)), &["a@1.0.0", "a@1.2.0"]),
            (limits(None, None, Some(0)), &["a@1.0.0", "a@1.2.0", "a@1.3.0"]),
            (limits(Some(3), Some(9), Some(100)), &["a@1.0.0", "a@1.2.0"]),
            (limits(None, None, None), &[]),
        ] {
            let chosen = choose(all(), limits, 40 * DAY);
            let names: Vec<String> = chosen.iter().map(|(upgrade, _)| upgrade.version.to_string()).collect();
            assert_eq!(names, expected, "{limits:?}");
        }
    }
}
