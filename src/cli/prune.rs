//! What `recordings prune` removes, and how: the choice is pure, a removal is on the audit record before the file is
//! gone. Must not touch a recording of an upgrade that is still open.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::CliError;
use holdpoint_approvals::Nonce;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_recordings::folder::{self, Filed};
use holdpoint_recordings::record::{REMOVED_KIND, Removed};
use holdpoint_registry::{AuditBody, Store, Transaction, VersionDetail, Views};

/// What is to remain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Limits {
    /// The upgrades written last.
    pub(super) keep: Option<usize>,
    /// What was written longer ago goes.
    pub(super) older_than_secs: Option<u64>,
    pub(super) bytes_max: Option<u64>,
}

/// All recordings of one upgrade: they are kept or removed together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Upgrade {
    pub(super) version: CapabilityId,
    /// Its files, in order.
    pub(super) files: Vec<Filed>,
    /// Whether it may still be written to, or nothing is known of it: then it stays.
    pub(super) open: bool,
}

impl Upgrade {
    fn bytes(&self) -> u64 {
        self.files.iter().map(|filed| filed.bytes).sum()
    }

    fn written_secs(&self) -> u64 {
        self.files.iter().map(|filed| filed.written_secs).max().unwrap_or(0)
    }
}

/// Recordings by upgrade, with whether the store says that it is over.
pub(super) fn upgrades(files: Vec<Filed>, views: &Views) -> Result<Vec<Upgrade>, CliError> {
    let mut by_version: BTreeMap<CapabilityId, Vec<Filed>> = BTreeMap::new();
    for filed in files {
        by_version.entry(filed.name.version.clone()).or_default().push(filed);
    }
    let upgrade = |(version, files)| {
        let detail = views.version(&version).map_err(CliError::usage)?;
        let open = detail.is_none_or(|detail| is_open(&detail));
        Ok(Upgrade { version, files, open })
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

/// The upgrades that go, each with the reason, oldest first. Open ones count and stay.
pub(super) fn choose(mut upgrades: Vec<Upgrade>, limits: Limits, now_secs: u64) -> Vec<(Upgrade, String)> {
    // The newest first; equal times by name, so that the choice does not hang on the order of a folder.
    upgrades.sort_by(|a, b| (b.written_secs(), &b.version).cmp(&(a.written_secs(), &a.version)));
    let mut total: u64 = upgrades.iter().map(Upgrade::bytes).sum();
    let mut chosen = Vec::new();
    for (place, upgrade) in upgrades.into_iter().enumerate().rev() {
        if upgrade.open {
            continue;
        }
        let age_secs = now_secs.saturating_sub(upgrade.written_secs());
        let reason = match limits {
            Limits { keep: Some(keep), .. } if place >= keep => {
                format!("the {keep} written last are kept")
            }
            Limits { older_than_secs: Some(limit), .. } if age_secs > limit => {
                format!("written more than {} days ago", limit / 86_400)
            }
            Limits { bytes_max: Some(limit), .. } if total > limit => {
                format!("all together may have {} MiB", limit >> 20)
            }
            Limits { .. } => continue,
        };
        total = total.saturating_sub(upgrade.bytes());
        chosen.push((upgrade, reason));
    }
    chosen
}

/// Takes the store for this verb alone.
///
/// # Errors
/// If an engine runs on it, or it cannot be opened.
pub(super) fn take_store(data: &Path) -> Result<Store, CliError> {
    Store::open(data).map_err(CliError::usage)
}

/// Writes down that a recording goes and why, then removes it. Where this ends in between, the file is left, and the
/// next prune finds it again.
///
/// # Errors
/// If the record cannot be written: then the file is still there. Where the file cannot be removed.
pub(super) fn remove(
    store: &Store,
    version: &CapabilityId,
    filed: &Filed,
    reason: &str,
) -> Result<(), CliError> {
    let cannot = |error: std::io::Error| CliError::usage(format!("cannot remove {:?}: {error}", filed.path));
    let removed = Removed {
        file: filed.file.clone(),
        sha256: folder::digest(&filed.path).map_err(cannot)?,
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

/// The machine's time as a transaction keeps it, ms since 1970; 0 where the machine has none.
pub(super) fn wall_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.ok().and_then(|since| i64::try_from(since.as_millis()).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY: u64 = 86_400;

    fn upgrade(version: &str, day: u64, mib: u64, open: bool) -> Upgrade {
        let file = format!("{}-0123abcd.rrd", version.replace('@', "-"));
        let filed = Filed {
            name: folder::Name::parse(&file).unwrap(),
            path: file.clone().into(),
            file,
            bytes: mib << 20,
            written_secs: day * DAY,
        };
        Upgrade { version: version.parse().unwrap(), files: vec![filed], open }
    }

    #[test]
    fn what_goes() {
        let all = || {
            vec![
                upgrade("a@1.0.0", 10, 1, false),
                upgrade("a@1.1.0", 20, 2, true),
                upgrade("a@1.2.0", 30, 4, false),
                upgrade("a@1.3.0", 40, 8, false),
            ]
        };
        let limits = |keep, days: Option<u64>, mib: Option<u64>| Limits {
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
