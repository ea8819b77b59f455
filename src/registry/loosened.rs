//! A store that was used where robots or people are at risk is used under a looser profile by an administrator's signed word
//! alone: else an option on a command line would do away with what the stricter one asks for.

use rusqlite::OptionalExtension;
use serde::Deserialize;

use super::apply::Applier;
use super::change::{Change, Transaction, command_id};
use super::error::StoreError;
use super::store::Store;
use holdpoint_approvals::SignedProfileAct;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;

/// Whether going over from one profile to another takes an administrator's signed word.
#[must_use]
pub fn loosening_is_signed(last: ProfileName, next: ProfileName) -> bool {
    next < last
}

/// Puts an administrator's word on record that the store may be used under a looser profile next. It counts as long as nothing
/// else is on record after it.
///
/// # Errors
/// If the store was not used yet, the profile is no looser one, or whoever signed may not.
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

/// The part of a word's record that is looked at.
#[derive(Deserialize)]
struct AllowedOnRecord {
    change: AllowedProfile,
}

#[derive(Deserialize)]
struct AllowedProfile {
    profile: ProfileName,
}

impl Applier<'_> {
    /// The word on a looser profile is an administrator's, for this end of the chain, and of use.
    pub(super) fn check_profile_act(
        &self,
        profile: ProfileName,
        act: &SignedProfileAct,
    ) -> Result<(), StoreError> {
        let refused = |problem: String| StoreError::invalid("word on the profile", profile, problem);
        let (last, ..) = self.context()?;
        if !loosening_is_signed(last, profile) {
            return Err(refused(format!("a looser one than {last}, under which the store was last used")));
        }
        let persons = self.persons()?;
        let checked = act.check(&persons, profile, self.head.hash);
        let checked = checked.and_then(|()| match last {
            ProfileName::Human => act.check_guarded(&persons),
            ProfileName::Sim | ProfileName::Real => Ok(()),
        });
        checked.map_err(|error| refused(error.to_string()))
    }

    /// A looser profile than the last one comes into force right after an administrator's word that it may.
    pub(super) fn check_profile(&self, next: ProfileName) -> Result<(), StoreError> {
        let last = match self.context() {
            Ok((last, ..)) => last,
            Err(StoreError::NotFound { .. }) => return Ok(()),
            Err(error) => return Err(error),
        };
        if !loosening_is_signed(last, next) {
            return Ok(());
        }
        let body: Option<String> = self
            .connection
            .query_row(
                "SELECT body FROM audit WHERE seq = ?1 AND kind = ?2",
                (self.head.seq, RecordKind::ProfileAllowed.name()),
                |row| row.get(0),
            )
            .optional()
            .map_err(StoreError::sql("read the word on the profile"))?;
        let allowed = body.and_then(|body| serde_json::from_str::<AllowedOnRecord>(&body).ok());
        if allowed.is_some_and(|allowed| allowed.change.profile == next) {
            return Ok(());
        }
        Err(StoreError::LooserProfile { last, next })
    }
}
