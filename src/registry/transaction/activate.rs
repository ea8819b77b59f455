//! The active pointer: the one change that decides which version controls the robot, with all its preconditions.

use rusqlite::params;

use crate::transaction::apply::{Applier, ChangeEffect, check_json, checked_reason};
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::notice::NoticeOrText;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{ActiveCause, StoreError};

/// A family's row in the store.
struct FamilyPointers {
    active: Option<String>,
    pinned: Option<String>,
    bootstrapped: bool,
    void_seq: u64,
}

impl Applier<'_> {
    fn family(&self, family: &Family) -> Result<FamilyPointers, StoreError> {
        self.find(
            "find a family",
            "SELECT active, pinned, bootstrapped, void_seq FROM family WHERE name = ?1",
            [family.as_str()],
            |row| {
                Ok(FamilyPointers {
                    active: row.get(0)?,
                    pinned: row.get(1)?,
                    bootstrapped: row.get(2)?,
                    void_seq: row.get(3)?,
                })
            },
        )?
        .ok_or_else(|| StoreError::NotFound { what: "family", name: family.to_string() })
    }

    /// A pointer stays with the robot it was set for.
    pub(crate) fn check_robot(&self, family: &Family, robot: Option<&str>) -> Result<(), StoreError> {
        let Some(given) = robot else { return Ok(()) };
        if given.len() != 16 || !given.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f')) {
            return Err(StoreError::invalid("digest of a robot", given, "16 hexadecimal digits"));
        }
        let sql = "SELECT robot FROM family WHERE name = ?1";
        let recorded: Option<String> =
            self.find("find a family", sql, [family.as_str()], |row| row.get(0))?.flatten();
        match recorded {
            Some(recorded) if recorded != given => {
                Err(StoreError::OtherRobot { family: family.to_string(), recorded, given: given.to_owned() })
            }
            Some(_) | None => Ok(()),
        }
    }

    /// Moves the active pointer after checking the preconditions of its cause.
    pub(crate) fn set_active(
        &mut self,
        family: &Family,
        active: Option<&CapabilityId>,
        pinned: Option<&CapabilityId>,
        cause: &ActiveCause,
        robot: Option<&str>,
    ) -> Result<ChangeEffect, StoreError> {
        let before = self.family(family)?;
        let refuse = |problem: &str| Err(StoreError::Invariant(format!("{family}: {problem}")));
        if [active, pinned].into_iter().flatten().any(|version| version.family != *family) {
            return refuse("the active version and its rollback target must be of the family");
        }
        let active_name = active.map(ToString::to_string);
        let pinned_name = pinned.map(ToString::to_string);
        match (cause, active) {
            (ActiveCause::Vacate, None) => {}
            (ActiveCause::Vacate, Some(_)) => return refuse("a vacated family has no active version"),
            (_, None) => return refuse("only a vacated family has no active version"),
            (ActiveCause::Bootstrap, Some(version)) => {
                if before.bootstrapped {
                    return refuse("it has its first version already; a new one must pass the gate");
                }
                if !self.is_baseline(version)? {
                    return refuse("its first version must be registered as baseline");
                }
            }
            (ActiveCause::Gate { evidence, approvals_needed }, Some(version)) => {
                if before.active.is_some() && pinned_name != before.active {
                    return refuse("the version that is replaced must be pinned as rollback target");
                }
                self.check_gate(version, *evidence, *approvals_needed, before.void_seq)?;
            }
            (ActiveCause::Restore, Some(_)) => {
                if before.pinned.is_none() || before.pinned != active_name {
                    return refuse("only the pinned rollback target can be restored");
                }
            }
            (ActiveCause::Rearm, Some(version)) => {
                if before.active.is_some() || !self.was_active(version)? {
                    return refuse(
                        "only a stopped family can be reactivated, with a version that was active before",
                    );
                }
            }
        }
        self.write_active(family, (active, pinned), cause, robot)
    }

    /// Moves an active pointer after the checks.
    pub(crate) fn write_active(
        &self,
        family: &Family,
        (active, pinned): (Option<&CapabilityId>, Option<&CapabilityId>),
        cause: &ActiveCause,
        robot: Option<&str>,
    ) -> Result<ChangeEffect, StoreError> {
        let [active_name, pinned_name] = [active, pinned].map(|version| version.map(ToString::to_string));
        let gate = match cause {
            ActiveCause::Gate { evidence, approvals_needed } => {
                (Some(evidence.to_string()), *approvals_needed)
            }
            ActiveCause::Bootstrap | ActiveCause::Restore | ActiveCause::Vacate | ActiveCause::Rearm => {
                (None, 0)
            }
        };
        let seq = self.next_seq();
        self.execute(
            "set the active version",
            "UPDATE family SET active = ?2, pinned = ?3, bootstrapped = 1, robot = coalesce(?4, robot) WHERE name = ?1",
            params![family.as_str(), active_name, pinned_name, robot],
        )?;
        let cause_name = cause.kind().name();
        self.execute(
            "keep the activation",
            "INSERT INTO activation (seq, family, active, pinned, cause, gate_digest, approvals_needed, at_ms,
               robot)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
            params![seq, family.as_str(), active_name, pinned_name, cause_name, gate.0, gate.1, self.at_ms, robot],
        )?;
        let subject = active_name.unwrap_or_else(|| family.to_string());
        Ok(ChangeEffect::new(RecordKind::ActiveSet, subject))
    }

    /// Whether a version was registered as its family's first.
    pub(crate) fn is_baseline(&self, version: &CapabilityId) -> Result<bool, StoreError> {
        let name = version.to_string();
        self.find("find a version", "SELECT baseline FROM version WHERE name = ?1", [&name], |row| {
            row.get(0)
        })?
        .ok_or(StoreError::NotFound { what: "version", name })
    }

    fn was_active(&self, version: &CapabilityId) -> Result<bool, StoreError> {
        let sql = "SELECT 1 FROM activation WHERE family = ?1 AND active = ?2 LIMIT 1";
        let name = version.to_string();
        self.exists("look up activations", sql, [version.family.as_str(), &name])
    }

    /// A current gate record for this version at its row version, and enough consumed approvals.
    fn check_gate(
        &self,
        version: &CapabilityId,
        evidence: Digest,
        approvals_needed: u32,
        void_seq: u64,
    ) -> Result<(), StoreError> {
        let name = version.to_string();
        let (_, row_version) = self.version(version)?;
        let (_, _, context_seq) = self.context()?;
        let found = self.exists(
            "look up the gate record",
            "SELECT 1 FROM evidence WHERE version = ?1 AND kind = 'gate' AND digest = ?2 AND row_version = ?3
               AND seq > ?4 AND seq > ?5",
            params![
                name,
                evidence.to_string(),
                self.row_version_before(&name, row_version),
                void_seq,
                context_seq
            ],
        )?;
        if !found {
            return Err(StoreError::Invariant(format!(
                "{name} has no current gate record {}: nothing becomes active without one",
                evidence.short()
            )));
        }
        let approvers = self.approved_by(&name);
        if approvers < approvals_needed as usize {
            return Err(StoreError::Invariant(format!(
                "{name} needs the approval of {approvals_needed} people in this transaction, {approvers} gave it"
            )));
        }
        Ok(())
    }

    /// Stops or reactivates a family; makes it if it is new.
    pub(crate) fn set_family(
        &mut self,
        family: &Family,
        safe_stopped: bool,
        reason: &NoticeOrText,
    ) -> Result<ChangeEffect, StoreError> {
        let reason = checked_reason(reason)?;
        self.execute(
            "set a family",
            "INSERT INTO family (name, bootstrapped, safe_stopped, reason, void_seq) VALUES (?1, 0, ?2, ?3, 0)
             ON CONFLICT (name) DO UPDATE SET safe_stopped = ?2, reason = ?3",
            params![family.as_str(), safe_stopped, reason],
        )?;
        Ok(ChangeEffect::new(RecordKind::FamilySet, family))
    }

    /// Keeps the lifecycle model's view of a family.
    pub(crate) fn set_family_state(
        &mut self,
        family: &Family,
        json: &str,
    ) -> Result<ChangeEffect, StoreError> {
        check_json("standing", json)?;
        self.family(family)?;
        let sql = "UPDATE family SET standing = ?2 WHERE name = ?1";
        self.execute("keep a family's standing", sql, params![family.as_str(), json])?;
        Ok(ChangeEffect::new(RecordKind::StandingSet, family))
    }

    /// Voids everything recorded for the family so far.
    pub(crate) fn void_family(
        &mut self,
        family: &Family,
        reason: &NoticeOrText,
    ) -> Result<ChangeEffect, StoreError> {
        checked_reason(reason)?;
        self.family(family)?;
        self.execute(
            "void a family's evidence",
            "UPDATE family SET void_seq = ?2 WHERE name = ?1",
            params![family.as_str(), self.next_seq()],
        )?;
        Ok(ChangeEffect::new(RecordKind::FamilyVoided, family))
    }
}
