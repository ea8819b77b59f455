//! Only an administrator's signed authorization changes a profile of a store that was used where robots or people are
//! at risk. The same holds for a profile that is less strict than its built-in one, because an option on a command line
//! could otherwise disable its requirements. [`ProfileHistory`] tells which change needs one.

use rusqlite::Connection;

use super::apply::Applier;
use super::change::{Change, Transaction, command_id};
use super::error::StoreError;
use super::store::Store;
use super::views::Views;
use holdpoint_approvals::SignedProfileAct;
use holdpoint_audit::profile_history::{ContextRules, ProfileChangeBody, ProfileHistory, check_key_guarded};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::DOWNGRADED_FIELDS_MAX;
use holdpoint_governance::record::RecordKind;

/// Puts an administrator's authorization of a change of profile on record. It is valid while no other record follows
/// it.
///
/// # Errors
/// If the signer may not authorize, or not this change.
pub fn allow_profile(
    store: &Store,
    profile: ProfileName,
    (by, act): (String, SignedProfileAct),
    wall_ms: i64,
) -> Result<(), StoreError> {
    let head = store.views()?.head()?;
    store
        .commit(Transaction {
            command_id: command_id("profile")?,
            at_ms: head.at_ms,
            wall_ms,
            changes: vec![Change::AllowProfile { profile, by, act: Box::new(act) }],
            audit: Vec::new(),
        })
        .map(drop)
}

/// The first later record that changes a profile without an authorization, with its problem. The records there are
/// unsigned. An authorization among them therefore does not count, nor do earlier forms or unreadable records. Other
/// checks judge the signed records.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn first_unauthorized(
    connection: &Connection,
    signed: u64,
) -> rusqlite::Result<Option<(u64, String)>> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        // Without an index: a false one hides records.
        connection.prepare("SELECT seq, kind, body FROM audit WHERE +kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut history = ProfileHistory::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let is_signed = seq <= signed;
        if !is_signed {
            history.require_authorization();
        }
        let problem = match serde_json::from_str::<ProfileChangeBody>(&body) {
            Ok(found) if kind == RecordKind::ContextSet.name() => history.take(seq, found.change).err(),
            Ok(found) if is_signed => {
                history.allow_on_record(seq, found.change);
                None
            }
            Ok(_) => None,
            Err(error) => Some(format!("it cannot be read which profile it is about: {error}")),
        };
        if let Some(problem) = problem.filter(|_| !is_signed) {
            return Ok(Some((seq, problem)));
        }
    }
    Ok(None)
}

/// The history of a store's profiles, from its records.
fn profile_history(connection: &Connection) -> rusqlite::Result<ProfileHistory> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        connection.prepare("SELECT seq, kind, body FROM audit WHERE kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut history = ProfileHistory::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let Ok(found) = serde_json::from_str::<ProfileChangeBody>(&body) else { continue };
        if kind == RecordKind::ContextSet.name() {
            drop(history.take(seq, found.change));
        } else {
            history.allow_on_record(seq, found.change);
        }
    }
    Ok(history)
}

impl Views {
    /// The history of the profiles from the records, unchecked, for messages before a start. The starting engine
    /// compares it with the chain.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn profiles(&self) -> Result<ProfileHistory, StoreError> {
        profile_history(&self.connection).map_err(StoreError::sql("read the profiles on record"))
    }
}

impl Applier<'_> {
    /// The authorization is an administrator's, for this end of the chain and for the profile in force.
    pub(super) fn check_profile_act(
        &self,
        profile: ProfileName,
        act: &SignedProfileAct,
    ) -> Result<(), StoreError> {
        let refused = |problem: String| StoreError::invalid("authorization of the profile", profile, problem);
        let history = self.profile_history();
        let Some(rules) = &act.act().rules else {
            return Err(refused("one that names the rules it is for".to_owned()));
        };
        if rules.from != history.last().and_then(|last| last.rules) {
            return Err(refused("one of a change of the rules in force".to_owned()));
        }
        if rules.loosened.len() > DOWNGRADED_FIELDS_MAX {
            return Err(refused(format!("one that lists at most {DOWNGRADED_FIELDS_MAX} fields")));
        }
        let persons = self.persons()?;
        let checked = act.check(&persons, profile, self.head.hash);
        let checked =
            checked.and_then(|()| check_key_guarded(act, &persons, history.last().map(|last| last.class)));
        checked.map_err(|error| refused(error.to_string()))
    }

    /// Puts a profile in force; if it needs an authorization, right after it.
    pub(super) fn check_profile(&self, class: ProfileName, rules: &ContextRules) -> Result<(), StoreError> {
        if rules.loosened.len() > DOWNGRADED_FIELDS_MAX {
            return Err(StoreError::invalid("loosened fields", rules.loosened.len(), "at most 2048"));
        }
        // The chain's data as read or written here: an edit of the database does not change it.
        let history = self.profile_history();
        history
            .check(self.head.seq.saturating_add(1), class, rules)
            .map_err(|problem| StoreError::UnauthorizedProfile { named: class.name().to_owned(), problem })
    }
}
