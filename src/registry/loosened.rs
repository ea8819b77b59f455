//! A profile that a store was used under where robots or people are at risk is changed by an administrator's signed
//! authorization alone, and so is any that is looser than the one that comes with the program: else an option on a command line
//! would do away with what it asks for. Which change takes one, [`needs_authorization`] says.

use rusqlite::Connection;
use serde::{Deserialize, Serialize};

use super::apply::Applier;
use super::change::{Change, Transaction, command_id};
use super::error::StoreError;
use super::store::Store;
use super::views::Views;
use super::words::guarded;
use holdpoint_approvals::{RulesChange, SignedProfileAct};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::loosened::{
    Before, InForce, LOOSENED_MAX, LetIn, Loosened, Rules, Settings, Taken, is_at_risk, needs_authorization,
    told,
};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::RecordKind;

/// The rules of a profile that comes into force, as its record has them. Fields stand in the order of their names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContextRules {
    /// Names numbers and policies.
    pub digest: Digest,
    /// Fields that are looser than before, or than what comes with the program.
    pub loosened: Vec<Loosened>,
    /// Whether a script takes it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub scripted: bool,
    /// Every number and ruling, for whoever compares with it.
    pub settings: Settings,
}

/// Puts an administrator's authorization of a change of profile on record. It counts as long as nothing else is on record after
/// it.
///
/// # Errors
/// If whoever signed may not, or not this.
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

/// A script names whom it likes, and signs with no key.
const SCRIPT_AFTER_LIVE: &str =
    "an engine that was no script's used this store under real or human, and no script uses it after that";

/// The part of a record of a profile that is looked at, whether it is allowed or in force.
#[derive(Deserialize)]
pub(crate) struct OnRecord {
    pub(crate) change: ProfileOnRecord,
}

#[derive(Deserialize)]
pub(crate) struct ProfileOnRecord {
    profile: ProfileName,
    #[serde(default)]
    looser_by_word: bool,
    #[serde(default)]
    rules: Option<ContextRules>,
    #[serde(default)]
    act: Option<ActOnRecord>,
}

impl ProfileOnRecord {
    /// What is in force from this record on.
    pub(crate) fn let_in(&self) -> LetIn {
        let scripted = self.rules.as_ref().is_some_and(|rules| rules.scripted);
        LetIn { class: self.profile, scripted }
    }
}

/// Of an authorization on record: what it is for.
#[derive(Deserialize)]
struct ActOnRecord {
    #[serde(default)]
    act: Option<RulesOfAct>,
}

#[derive(Deserialize)]
struct RulesOfAct {
    #[serde(default)]
    rules: Option<RulesChange>,
}

/// An authorization on record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Authorization {
    seq: u64,
    profile: ProfileName,
    /// Absent in earlier versions, which authorized a class.
    rules: Option<RulesChange>,
}

/// How the profiles of a store followed each other, as far as its records were read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileCourse {
    last: Option<InForce>,
    /// Of the last one; absent where its record is of an earlier version.
    settings: Option<Settings>,
    /// A script took the last one.
    scripted: bool,
    /// A profile was taken by somebody else than a script.
    was_used: bool,
    /// One of the classes `real` and `human` was.
    was_live: bool,
    /// The rules that the last authorization that was used is for, as long as they are in force.
    authorized: Option<Digest>,
    /// The last authorization.
    word: Option<Authorization>,
    /// Earlier versions asked for no authorization: what they wrote counts until the first record of one that does.
    asked: bool,
    /// Then for one of a looser class alone: what those wrote counts until the first record with rules.
    ruled: bool,
}

impl ProfileCourse {
    /// The profile in force.
    #[must_use]
    pub const fn last(&self) -> Option<InForce> {
        self.last
    }

    /// The settings of the profile in force; absent where they are not on record.
    #[must_use]
    pub const fn settings(&self) -> Option<&Settings> {
        self.settings.as_ref()
    }

    /// Whether the store was used by somebody else than a script, under whatever profile.
    #[must_use]
    pub const fn was_used(&self) -> bool {
        self.was_used
    }

    /// Whether it was used by somebody else than a script where robots or people are at risk: no script uses it after that.
    #[must_use]
    pub const fn was_live(&self) -> bool {
        self.was_live
    }

    /// Whether a script took the profile in force.
    #[must_use]
    pub const fn scripted(&self) -> bool {
        self.scripted
    }

    /// Whether these rules take an authorization to come into force, or to stay there.
    #[must_use]
    pub fn needs(&self, class: ProfileName, rules: &ContextRules) -> bool {
        let next = Taken {
            class,
            rules: rules.digest,
            is_looser: !rules.loosened.is_empty(),
            scripted: rules.scripted,
        };
        needs_authorization(self.last, self.authorized, &next)
    }

    /// These rules as they would come into force next.
    #[must_use]
    pub fn next(&self, rules: &Rules, scripted: bool) -> ContextRules {
        let before = match (self.last, &self.settings) {
            (Some(last), Some(settings)) if is_at_risk(last.class) => Before::Known(settings),
            (Some(last), None) if is_at_risk(last.class) => Before::Unknown,
            (Some(_) | None, _) => Before::Nothing,
        };
        let Rules { digest, settings, .. } = rules;
        ContextRules {
            digest: *digest,
            loosened: rules.loosened(before),
            scripted,
            settings: settings.clone(),
        }
    }

    /// What an administrator signs for these rules to come into force next.
    #[must_use]
    pub fn change_to(&self, rules: &ContextRules) -> RulesChange {
        RulesChange {
            from: self.last.and_then(|last| last.rules),
            loosened: rules.loosened.clone(),
            to: rules.digest,
        }
    }

    /// Whether these rules may come into force as record `seq`.
    ///
    /// # Errors
    /// Why not.
    pub fn check(&self, seq: u64, class: ProfileName, rules: &ContextRules) -> Result<(), String> {
        if rules.scripted && self.was_live {
            return Err(SCRIPT_AFTER_LIVE.to_owned());
        }
        let is_authorized = self.word.as_ref().is_some_and(|word| {
            word.seq.checked_add(1) == Some(seq)
                && word.profile == class
                && word.rules.as_ref() == Some(&self.change_to(rules))
        });
        if is_authorized || !self.needs(class, rules) {
            return Ok(());
        }
        let told = told(&rules.loosened);
        Err(format!(
            "{}, {told}, and the record before it is no administrator's authorization of that",
            self.step(class)
        ))
    }

    /// The change to a class, in words.
    fn step(&self, class: ProfileName) -> String {
        match self.last {
            Some(last) if last.class != class => {
                format!("it goes over from the profile {} to {class}", last.class)
            }
            Some(_) => format!("it changes the profile {class}"),
            None => format!("it begins with the profile {class}"),
        }
    }

    /// An authorization.
    pub(crate) fn allow(&mut self, seq: u64, profile: ProfileName, rules: Option<RulesChange>) {
        self.word = Some(Authorization { seq, profile, rules });
        self.asked = true;
    }

    /// As [`Self::allow`], from a record.
    pub(crate) fn allow_on_record(&mut self, seq: u64, said: ProfileOnRecord) {
        let rules = said.act.and_then(|act| act.act).and_then(|act| act.rules);
        self.allow(seq, said.profile, rules);
    }

    /// A record by which a profile comes into force.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub(crate) fn take(&mut self, seq: u64, set: ProfileOnRecord) -> Result<(), String> {
        let ProfileOnRecord { profile, looser_by_word, rules, .. } = set;
        self.set(seq, profile, looser_by_word, rules)
    }

    /// A profile comes into force. It does so too where that is an error, which tells what is wrong.
    ///
    /// # Errors
    /// If it takes an authorization, and the record before it is none of it.
    pub(crate) fn set(
        &mut self,
        seq: u64,
        class: ProfileName,
        looser_by_word: bool,
        rules: Option<ContextRules>,
    ) -> Result<(), String> {
        let checked = match &rules {
            Some(rules) => self.check(seq, class, rules),
            None => self.check_of_earlier(seq, class, looser_by_word),
        };
        self.asked |= looser_by_word;
        self.ruled |= rules.is_some();
        self.scripted = rules.as_ref().is_some_and(|rules| rules.scripted);
        self.was_used |= !self.scripted;
        self.was_live |= is_at_risk(class) && !self.scripted;
        let digest = rules.as_ref().map(|rules| rules.digest);
        self.authorized = match &rules {
            Some(rules) if checked.is_ok() && self.needs(class, rules) => digest,
            _ => self.authorized.filter(|authorized| Some(*authorized) == digest),
        };
        self.last = Some(InForce { class, rules: digest });
        self.settings = rules.map(|rules| rules.settings);
        checked
    }

    /// As [`Self::check`], of a record of an earlier version, which names no rules.
    fn check_of_earlier(&self, seq: u64, class: ProfileName, looser_by_word: bool) -> Result<(), String> {
        let last = self.last.map(|last| last.class);
        if self.ruled && (is_at_risk(class) || last.is_some_and(is_at_risk)) {
            return Err(format!("{}, and does not say by what rules", self.step(class)));
        }
        let is_word = self
            .word
            .as_ref()
            .is_some_and(|word| word.seq.checked_add(1) == Some(seq) && word.profile == class);
        if (self.asked || looser_by_word) && last.is_some_and(|last| class < last) && !is_word {
            let step = self.step(class);
            return Err(format!(
                "{step}, and the record before it is no administrator's authorization of that"
            ));
        }
        Ok(())
    }

    /// From here on nothing counts as written by an earlier version.
    const fn ask(&mut self) {
        (self.asked, self.ruled) = (true, true);
    }
}

/// The first record after these that changes a profile without an authorization, and what to say of it: nobody signed the
/// records there, so that neither an authorization among them counts, nor that one is of a version that asked for none, nor what
/// cannot be read. What is signed is judged elsewhere.
///
/// # Errors
/// If the store cannot be read.
pub(crate) fn first_unauthorized(
    connection: &Connection,
    signed: u64,
) -> rusqlite::Result<Option<(u64, String)>> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        // By no index: one that is false hides records.
        connection.prepare("SELECT seq, kind, body FROM audit WHERE +kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut course = ProfileCourse::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let is_signed = seq <= signed;
        if !is_signed {
            course.ask();
        }
        let problem = match serde_json::from_str::<OnRecord>(&body) {
            Ok(found) if kind == RecordKind::ContextSet.name() => course.take(seq, found.change).err(),
            Ok(found) if is_signed => {
                course.allow_on_record(seq, found.change);
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

/// How the profiles of a store followed each other, as its records have it.
fn course_of(connection: &Connection) -> rusqlite::Result<ProfileCourse> {
    let kinds = [RecordKind::ContextSet.name(), RecordKind::ProfileAllowed.name()];
    let mut select =
        connection.prepare("SELECT seq, kind, body FROM audit WHERE kind IN (?1, ?2) ORDER BY seq")?;
    let mut rows = select.query(kinds)?;
    let mut course = ProfileCourse::default();
    while let Some(row) = rows.next()? {
        let (seq, kind, body): (u64, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let Ok(found) = serde_json::from_str::<OnRecord>(&body) else { continue };
        if kind == RecordKind::ContextSet.name() {
            drop(course.take(seq, found.change));
        } else {
            course.allow_on_record(seq, found.change);
        }
    }
    Ok(course)
}

impl Views {
    /// How the profiles followed each other, as the records have it. The engine that starts holds it against the chain; this is
    /// for whoever wants to tell before.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn profiles(&self) -> Result<ProfileCourse, StoreError> {
        course_of(&self.connection).map_err(StoreError::sql("read the profiles on record"))
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
        let course = self.course();
        let Some(rules) = &act.act().rules else {
            return Err(refused("one that names the rules it is for".to_owned()));
        };
        if rules.from != course.last.and_then(|last| last.rules) {
            return Err(refused("one of a change of the rules in force".to_owned()));
        }
        if rules.loosened.len() > LOOSENED_MAX {
            return Err(refused(format!("one that lists at most {LOOSENED_MAX} fields")));
        }
        let persons = self.persons()?;
        let checked = act.check(&persons, profile, self.head.hash);
        let checked = checked.and_then(|()| guarded(act, &persons, course.last.map(|last| last.class)));
        checked.map_err(|error| refused(error.to_string()))
    }

    /// A profile comes into force; where it takes an authorization, right after it.
    pub(super) fn check_profile(&self, class: ProfileName, rules: &ContextRules) -> Result<(), StoreError> {
        if rules.loosened.len() > LOOSENED_MAX {
            return Err(StoreError::invalid("loosened fields", rules.loosened.len(), "at most 2048"));
        }
        // What the chain says as it was read or written here: whoever edits the database changes none of it.
        let course = self.course();
        course
            .check(self.head.seq.saturating_add(1), class, rules)
            .map_err(|problem| StoreError::UnauthorizedProfile { named: class.name().to_owned(), problem })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ProfileName::{Human, Real, Sim};
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::Profile;
    use holdpoint_governance::profile::fields::{FIELDS, Field, Tighter};

    fn rules(text: &str, is_looser: bool) -> ContextRules {
        let one = Loosened {
            before: "none".to_owned(),
            field: text.to_owned(),
            now: "1".to_owned(),
            shipped: "0".to_owned(),
        };
        ContextRules {
            digest: Digest::of_parts("test", &[text.as_bytes()]),
            loosened: if is_looser { vec![one] } else { Vec::new() },
            scripted: false,
            settings: Settings::from([(text.to_owned(), "1".to_owned())]),
        }
    }

    #[test]
    fn what_an_earlier_version_wrote_counts_until_one_asked_for_authorizations() {
        let mut course = ProfileCourse::default();
        for (seq, profile) in [(1, Human), (2, Sim), (3, Real)] {
            course.set(seq, profile, false, None).unwrap();
        }
        // From here on an authorization is asked for, also by what says that none is.
        course.set(4, Human, true, None).unwrap();
        assert!(course.set(5, Real, false, None).unwrap_err().contains("from the profile human to real"));
        course.set(6, Human, true, None).unwrap();
        // Right before it, and for it.
        course.allow(7, Sim, None);
        assert!(course.set(9, Sim, true, None).is_err());
        course.set(10, Human, true, None).unwrap();
        course.allow(11, Real, None);
        assert!(course.set(12, Sim, true, None).is_err());
        course.set(13, Human, true, None).unwrap();
        course.allow(14, Sim, None);
        course.set(15, Sim, true, None).unwrap();
        assert_eq!(course.last().map(|last| last.class), Some(Sim));
        // Then for one of the rules, and no record goes without them any more.
        course.set(16, Human, true, Some(rules("human", false))).unwrap();
        assert!(course.set(17, Human, true, None).unwrap_err().contains("does not say by what rules"));
        course.allow(18, Sim, None);
        assert!(course.set(19, Sim, true, None).is_err());
    }

    #[test]
    fn an_authorization_is_of_one_change_with_its_list_and_right_before_it() {
        let begun = || {
            let mut course = ProfileCourse::default();
            course.set(1, Human, false, Some(rules("a", false))).unwrap();
            course
        };
        let next = rules("b", true);
        assert!(
            begun().set(2, Human, false, Some(next.clone())).unwrap_err().contains("1 field is looser: b")
        );
        let good = begun().change_to(&next);
        let allowed = |change: &RulesChange, profile: ProfileName, seq: u64| {
            let mut course = begun();
            course.allow(2, profile, Some(change.clone()));
            course.set(seq, Human, false, Some(next.clone())).map(|()| course)
        };
        let mut course = allowed(&good, Human, 3).unwrap();
        assert!(allowed(&good, Human, 4).is_err(), "something came between");
        assert!(allowed(&good, Real, 3).is_err());
        assert!(allowed(&RulesChange { from: None, ..good.clone() }, Human, 3).is_err());
        assert!(allowed(&RulesChange { to: rules("c", true).digest, ..good.clone() }, Human, 3).is_err());
        assert!(allowed(&RulesChange { loosened: Vec::new(), ..good.clone() }, Human, 3).is_err());
        // It holds as long as those rules are in force, and is used up then.
        course.set(4, Human, false, Some(next.clone())).unwrap();
        course.allow(5, Human, Some(course.change_to(&rules("a", false))));
        course.set(6, Human, false, Some(rules("a", false))).unwrap();
        assert!(course.set(7, Human, false, Some(next)).is_err());
    }

    /// The blind mutant: each number of the table alone, moved to where it is looser, in a profile that parses.
    #[test]
    fn no_number_alone_is_looser_without_an_authorization() {
        for class in [Real, Human] {
            let shipped = Profile::builtin(class).unwrap();
            let table = PolicyTable::builtin(&shipped).unwrap();
            let of = |profile: &Profile| Rules::of(profile, &table).unwrap();
            let as_shipped = ProfileCourse::default().next(&of(&shipped), false);
            let mut begun = ProfileCourse::default();
            begun.set(1, class, false, Some(as_shipped)).unwrap();
            for Field { path, lowest, highest, tighter, .. } in FIELDS {
                let mut value = serde_json::to_value(&shipped).unwrap();
                let pointer = format!("/{}", path.replace('.', "/"));
                let number = value.pointer_mut(&pointer).unwrap();
                let now = number.as_f64().unwrap();
                let loosest = match tighter {
                    Tighter::Lower => highest,
                    Tighter::Higher => lowest,
                    Tighter::Neither if now > *lowest => lowest,
                    Tighter::Neither => highest,
                };
                if (loosest - now).abs() < f64::EPSILON {
                    continue;
                }
                // A whole number is kept as one.
                *number = serde_json::from_str(&loosest.to_string()).unwrap();
                let loose = of(&serde_json::from_value(value).unwrap());
                for (course, seq) in [(&ProfileCourse::default(), 1), (&begun, 2)] {
                    let next = course.next(&loose, false);
                    let refused = course.check(seq, class, &next).unwrap_err();
                    assert!(refused.contains(&format!("1 field is looser: {path}")), "{class}: {refused}");
                }
            }
        }
    }

    #[test]
    fn what_a_script_left_in_force_is_authorized_for_nobody() {
        let (loose, mut script) = (rules("a", true), rules("a", true));
        script.scripted = true;
        let mut course = ProfileCourse::default();
        course.set(1, Real, false, Some(script.clone())).unwrap();
        assert!(course.needs(Real, &loose) && !course.needs(Real, &script));
        // Once somebody used it otherwise, no script does.
        course.allow(2, Real, Some(course.change_to(&loose)));
        course.set(3, Real, false, Some(loose)).unwrap();
        course.allow(4, Real, Some(course.change_to(&script)));
        assert_eq!(course.check(5, Real, &script).unwrap_err(), SCRIPT_AFTER_LIVE);
    }
}
