//! A store that was used where robots or people are at risk is used under a looser profile by an administrator's signed word
//! alone: else an option on a command line would do away with what the stricter one asks for.

use rusqlite::{Connection, OptionalExtension};
use serde::Deserialize;

use super::apply::Applier;
use super::audit::{self, COLUMNS, Head};
use super::change::{Change, Transaction, command_id};
use super::error::StoreError;
use super::store::Store;
use super::views::Views;
use super::words::guarded;
use holdpoint_approvals::SignedProfileAct;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::words::Word;

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

/// The part of a record of a profile that is looked at, whether it is allowed or in force.
#[derive(Deserialize)]
pub(crate) struct OnRecord {
    change: ProfileOnRecord,
}

#[derive(Deserialize)]
struct ProfileOnRecord {
    profile: ProfileName,
    #[serde(default)]
    looser_by_word: bool,
}

/// How the profiles of a store followed each other, as far as its records were read.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Course {
    last: Option<ProfileName>,
    /// The last word: its record, and what it allows.
    word: Option<(u64, ProfileName)>,
    /// Earlier versions asked for no word: what they wrote counts until the first record of one that does.
    asked: bool,
}

impl Course {
    /// The profile in force.
    pub(crate) const fn last(&self) -> Option<ProfileName> {
        self.last
    }

    /// A word.
    pub(crate) const fn allow(&mut self, seq: u64, profile: ProfileName) {
        (self.word, self.asked) = (Some((seq, profile)), true);
    }

    /// A record by which a profile comes into force.
    ///
    /// # Errors
    /// As [`Course::set`].
    pub(crate) fn take(&mut self, seq: u64, set: &OnRecord) -> Result<(), String> {
        self.set(seq, set.change.profile, set.change.looser_by_word)
    }

    /// A profile comes into force.
    ///
    /// # Errors
    /// If it is a looser one, and the record before it is no word that it may.
    pub(crate) fn set(&mut self, seq: u64, next: ProfileName, looser_by_word: bool) -> Result<(), String> {
        self.asked |= looser_by_word;
        let last = self.last.replace(next).filter(|last| loosening_is_signed(*last, next));
        match last {
            Some(last) if self.asked && self.word != Some((seq.saturating_sub(1), next)) => Err(format!(
                "it goes over from the profile {last} to {next}, and the record before it is no administrator's word that it may"
            )),
            _ => Ok(()),
        }
    }
}

/// The first record after these that goes over to a looser profile, and what to say of it: nobody signed the records there, so
/// that neither a word among them counts, nor that one is of a version that asked for none, nor what cannot be read. What is
/// signed is judged elsewhere.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn first_unsaid(connection: &Connection, signed: u64) -> rusqlite::Result<Option<(u64, String)>> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        // By no index: one that is false hides records.
        connection.prepare("SELECT seq, kind, body FROM audit WHERE +kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut course = Course::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let is_signed = seq <= signed;
        course.asked |= !is_signed;
        let problem = match serde_json::from_str::<OnRecord>(&body) {
            Ok(found) if kind == RecordKind::ContextSet.name() => course.take(seq, &found).err(),
            Ok(found) if is_signed => {
                course.allow(seq, found.change.profile);
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

/// The profile that the record at the end of the chain lets a store be used under; absent if it is no word, or not that record.
fn newest_word(connection: &Connection, end: Head) -> rusqlite::Result<Option<ProfileName>> {
    let newest = connection
        .query_row(&format!("SELECT {COLUMNS} FROM audit WHERE seq = ?1"), [end.seq], audit::read)
        .optional()?;
    let word = newest.filter(|record| {
        record.expected_hash() == end.hash && record.kind == Word::Known(RecordKind::ProfileAllowed)
    });
    let found = word.and_then(|record| serde_json::from_str::<OnRecord>(&record.body).ok());
    Ok(found.map(|found| found.change.profile))
}

/// A looser profile follows another one where the end of the chain is a word that it may.
fn check_follows(
    connection: &Connection,
    (last, next): (ProfileName, ProfileName),
    end: Head,
) -> Result<(), StoreError> {
    if !loosening_is_signed(last, next) {
        return Ok(());
    }
    match newest_word(connection, end).map_err(StoreError::sql("read the word on the profile"))? {
        Some(allowed) if allowed == next => Ok(()),
        Some(_) | None => Err(StoreError::LooserProfile { last, next }),
    }
}

impl Views {
    /// Whether the store may be used under this profile next, as its rows have it. The engine that starts holds them against
    /// the chain; this is for whoever wants to tell before.
    ///
    /// # Errors
    /// [`StoreError::LooserProfile`], or if the store cannot be read.
    pub fn may_follow(&self, next: ProfileName) -> Result<(), StoreError> {
        match self.context()? {
            Some((last, ..)) => check_follows(&self.connection, (last, next), self.head()?),
            None => Ok(()),
        }
    }
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
        let checked = checked.and_then(|()| guarded(act, &persons, Some(last)));
        checked.map_err(|error| refused(error.to_string()))
    }

    /// A looser profile than the last one comes into force right after an administrator's word that it may.
    pub(super) fn check_profile(&self, next: ProfileName) -> Result<(), StoreError> {
        match self.context() {
            // The rows were held against the chain, and its newest record is held against what it was when it was read or
            // written: whoever edits it makes no word of it.
            Ok((last, ..)) => check_follows(self.connection, (last, next), self.head),
            Err(StoreError::NotFound { .. }) => Ok(()),
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_earlier_version_wrote_counts_until_one_asked_for_words() {
        use ProfileName::{Human, Real, Sim};
        let mut course = Course::default();
        for (seq, profile) in [(1, Human), (2, Sim), (3, Real)] {
            course.set(seq, profile, false).unwrap();
        }
        // From here on a word is asked for, also by what says that none is.
        course.set(4, Human, true).unwrap();
        assert!(course.set(5, Real, false).unwrap_err().contains("from the profile human to real"));
        course.set(6, Human, true).unwrap();
        // Right before it, and for it.
        course.allow(7, Sim);
        assert!(course.set(9, Sim, true).is_err());
        course.set(10, Human, true).unwrap();
        course.allow(11, Real);
        assert!(course.set(12, Sim, true).is_err());
        course.set(13, Human, true).unwrap();
        course.allow(14, Sim);
        course.set(15, Sim, true).unwrap();
        assert_eq!(course.last(), Some(Sim));
    }
}
