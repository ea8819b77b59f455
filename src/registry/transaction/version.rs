//! Changes of one version: its registration, state, flags and scores.

use rusqlite::params;

use crate::transaction::apply::{Applier, ChangeEffect, check_json, check_text, checked_reason};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State, VersionFlags};
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{NewVersion, StoreError};

/// The most versions a store holds.
const VERSIONS_MAX: u64 = 100_000;

/// Sorts semantic versions as text (precedence by semver.org, item 11).
fn sort_key(version: &semver::Version) -> String {
    let mut key = format!("{:020}.{:020}.{:020}", version.major, version.minor, version.patch);
    if version.pre.is_empty() {
        key.push('~');
    } else {
        for part in version.pre.split('.') {
            match part.parse::<u64>() {
                Ok(number) => key.push_str(&format!("!0{number:020}")),
                Err(_) => key.push_str(&format!("!1{part}")),
            }
        }
    }
    key.push_str(&format!(" {}", version.build));
    key
}

impl Applier<'_> {
    pub(crate) fn register(&mut self, new: &NewVersion) -> Result<ChangeEffect, StoreError> {
        for (what, text) in [
            ("manifest", &new.manifest),
            ("submission", &new.submission),
            ("permission profile", &new.permissions),
            ("environment scope", &new.environments),
        ] {
            check_json(what, text)?;
        }
        check_text("author", &new.author)?;
        let (name, family) = (new.id.to_string(), new.id.family.to_string());
        check_text("version", &name)?;
        let count: Option<u64> =
            self.find("count versions", "SELECT count(*) FROM version", [], |row| row.get(0))?;
        if count.unwrap_or(0) >= VERSIONS_MAX {
            return Err(StoreError::invalid(
                "number of versions",
                VERSIONS_MAX,
                "no more than that in one store",
            ));
        }
        if self.exists("find a version", "SELECT 1 FROM version WHERE name = ?1", [&name])? {
            return Err(StoreError::Exists { what: "version", name });
        }
        self.execute(
            "register a version",
            "INSERT INTO version (name, family, version, sort_key, parent, state, row_version, baseline,
               candidate_digest, manifest_digest, bundle_digest, author, provenance, risk, permissions, environments,
               manifest, submission, registered_ms, changed_ms)
             VALUES (?1, ?2, ?3, ?4, ?5, 'registered', 1, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?17)",
            params![
                name,
                family,
                new.id.version.to_string(),
                sort_key(&new.id.version),
                new.parent.as_ref().map(ToString::to_string),
                new.baseline,
                new.candidate_digest.to_string(),
                new.manifest_digest.to_string(),
                new.bundle_digest.to_string(),
                new.author,
                new.provenance.name(),
                new.risk.name(),
                new.permissions,
                new.environments,
                new.manifest,
                new.submission,
                self.at_ms,
            ],
        )?;
        self.execute(
            "add a family",
            "INSERT INTO family (name, bootstrapped, safe_stopped, reason, void_seq) VALUES (?1, 0, 0, '', 0)
             ON CONFLICT (name) DO NOTHING",
            [&family],
        )?;
        Ok(ChangeEffect::new(RecordKind::VersionRegistered, &name))
    }

    pub(crate) fn set_state(
        &mut self,
        version: &CapabilityId,
        expected: (u64, State),
        to: State,
        reason: &NoticeOrText,
    ) -> Result<ChangeEffect, StoreError> {
        checked_reason(reason)?;
        let (state, row_version) = self.version(version)?;
        if (row_version, state) != expected {
            return Err(StoreError::Stale {
                version: version.clone(),
                expected: format!("{} (row version {})", expected.1, expected.0),
                found: format!("{state} (row version {row_version})"),
            });
        }
        let name = version.to_string();
        let first = state == State::Registered && to == State::Active && self.is_baseline(version)?;
        if !first && !state.may_become(to) {
            return Err(StoreError::Invariant(format!("{name} cannot go from {state} to {to}")));
        }
        self.write_state(version, row_version, to)
    }

    /// Sets a state after the checks.
    pub(crate) fn write_state(
        &mut self,
        version: &CapabilityId,
        row_version: u64,
        to: State,
    ) -> Result<ChangeEffect, StoreError> {
        let name = version.to_string();
        let terminal = matches!(to, State::Rejected | State::RolledBack);
        self.execute(
            "set a state",
            "UPDATE version SET state = ?2, row_version = row_version + 1, changed_ms = ?3,
               running = CASE WHEN ?4 THEN NULL ELSE running END,
               paused = CASE WHEN ?4 THEN 0 ELSE paused END,
               awaiting_approval = CASE WHEN ?4 THEN 0 ELSE awaiting_approval END,
               provisional = CASE WHEN ?2 = 'active' THEN provisional ELSE 0 END,
               restricted = CASE WHEN ?2 = 'active' THEN restricted ELSE 0 END,
               rollback_pending = CASE WHEN ?2 = 'active' THEN rollback_pending ELSE 0 END
             WHERE name = ?1",
            params![name, to.name(), self.at_ms, terminal],
        )?;
        if to == State::Superseded {
            crate::fp!("old-superseded");
        }
        crate::fp!("state-set");
        self.row_versions_before.entry(name.clone()).or_insert(row_version);
        self.row_versions.push((version.clone(), row_version + 1));
        self.families.insert(version.family.to_string());
        Ok(ChangeEffect::new(RecordKind::StateSet, version))
    }

    pub(crate) fn set_flags(
        &mut self,
        version: &CapabilityId,
        flags: VersionFlags,
    ) -> Result<ChangeEffect, StoreError> {
        self.version(version)?;
        let name = version.to_string();
        self.execute(
            "set flags",
            "UPDATE version SET running = ?2, paused = ?3, awaiting_approval = ?4, provisional = ?5, restricted = ?6,
               rollback_pending = ?7, changed_ms = ?8 WHERE name = ?1",
            params![
                name,
                flags.running.map(Stage::name),
                flags.paused,
                flags.awaiting_approval,
                flags.provisional,
                flags.restricted,
                flags.rollback_pending,
                self.at_ms
            ],
        )?;
        self.families.insert(version.family.to_string());
        Ok(ChangeEffect::new(RecordKind::FlagsSet, version))
    }

    pub(crate) fn set_scores(
        &mut self,
        version: &CapabilityId,
        kappas: &[Option<f64>; 4],
        signature: Option<&str>,
    ) -> Result<ChangeEffect, StoreError> {
        self.version(version)?;
        if let Some(kappa) = kappas.iter().flatten().find(|kappa| !(0.0..=1.0).contains(*kappa)) {
            return Err(StoreError::invalid("kappa", kappa, "a number from 0 to 1, or none"));
        }
        signature.map_or(Ok(()), |text| check_json("behavior signature", text))?;
        let name = version.to_string();
        let [i, p, b, r] = kappas;
        self.execute(
            "set scores",
            "UPDATE version SET kappa_i = ?2, kappa_p = ?3, kappa_b = ?4, kappa_r = ?5, signature = ?6,
               changed_ms = ?7 WHERE name = ?1",
            params![name, i, p, b, r, signature, self.at_ms],
        )?;
        Ok(ChangeEffect::new(RecordKind::ScoresSet, version))
    }
}

#[cfg(test)]
mod tests {
    use super::sort_key;

    #[test]
    fn versions_sort_by_semver() {
        let versions = [
            "0.9.0",
            "1.0.0-alpha",
            "1.0.0-alpha.1",
            "1.0.0-alpha.2",
            "1.0.0-alpha.10",
            "1.0.0-alpha.-y",
            "1.0.0-alpha.x",
            "1.0.0-beta",
            "1.0.0",
            "1.0.0+build",
            "1.2.0",
            "1.10.0",
            "2.0.0",
        ];
        let keys: Vec<_> = versions.iter().map(|text| sort_key(&text.parse().unwrap())).collect();
        let mut sorted = keys.clone();
        sorted.sort();
        assert_eq!(keys, sorted);
    }
}
