//! The history of a store's profiles, as its records tell it: which change of profile needed an administrator's signed
//! authorization, and whether the record before it is that authorization.
//!
//! A change needs one in a store that was used where robots or people are at risk. So does a profile that is less strict
//! than its built-in one, because an option on a command line could otherwise disable its requirements.
//! [`needs_authorization`] tells which change needs one.

use serde::{Deserialize, Serialize};

use holdpoint_approvals::{PersonDirectory, PersonError, RulesChange, SignedProfileAct};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::profile_downgrade::{
    ActiveProfile, AdmissionContext, DowngradedField, IncomingProfile, PreviousProfile, ProfileRules,
    ProfileSettings, downgrade_summary, needs_authorization,
};

/// The rules of a profile in its record's form. Fields are in the order of their names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContextRules {
    /// Names numbers and policies.
    pub digest: Digest,
    /// Fields that are less strict than before, or than in the built-in profile.
    pub loosened: Vec<DowngradedField>,
    /// Whether a script takes it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub scripted: bool,
    /// Every number and ruling, for comparison.
    pub settings: ProfileSettings,
}

/// A script may name any person, and signs with no key.
const SCRIPT_AFTER_LIVE: &str =
    "an engine that was no script's used this store under real or human, and no script uses it after that";

/// The checked part of a profile's record, whether it is allowed or in force.
#[derive(Debug, Deserialize)]
pub struct ProfileChangeBody {
    pub change: RecordedProfileChange,
}

/// A change of profile in its record's form.
#[derive(Debug, Deserialize)]
pub struct RecordedProfileChange {
    profile: ProfileName,
    #[serde(default)]
    looser_by_word: bool,
    #[serde(default)]
    rules: Option<ContextRules>,
    #[serde(default)]
    act: Option<RecordedAct>,
}

impl RecordedProfileChange {
    /// The rules in force from this record on.
    #[must_use]
    pub fn admission_context(&self) -> AdmissionContext {
        let scripted = self.rules.as_ref().is_some_and(|rules| rules.scripted);
        AdmissionContext { class: self.profile, scripted }
    }
}

/// The subject of an authorization on record.
#[derive(Debug, Deserialize)]
struct RecordedAct {
    #[serde(default)]
    act: Option<RecordedActRules>,
}

#[derive(Debug, Deserialize)]
struct RecordedActRules {
    #[serde(default)]
    rules: Option<RulesChange>,
}

/// An authorization on record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedAuthorization {
    seq: u64,
    profile: ProfileName,
    /// Absent in earlier versions, which authorized a class.
    rules: Option<RulesChange>,
}

/// The history of a store's profiles, as far as its records were read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileHistory {
    last: Option<ActiveProfile>,
    /// Of the last one; absent where its record is of an earlier version.
    settings: Option<ProfileSettings>,
    /// A script took the last one.
    scripted: bool,
    /// A session other than a script used a profile.
    was_used: bool,
    /// One of the classes `real` and `human` was.
    was_live: bool,
    /// The rules of the last used authorization, while they are in force.
    authorized: Option<Digest>,
    authorization: Option<RecordedAuthorization>,
    /// Earlier versions required no authorization: their records count until the first record of one that does.
    asked: bool,
    /// Later versions required one for a less strict class alone: their records count until the first record with
    /// rules.
    ruled: bool,
}

impl ProfileHistory {
    /// The profile in force.
    #[must_use]
    pub const fn last(&self) -> Option<ActiveProfile> {
        self.last
    }

    /// The settings of the profile in force; absent where they are not on record.
    #[must_use]
    pub const fn settings(&self) -> Option<&ProfileSettings> {
        self.settings.as_ref()
    }

    /// Whether a session other than a script used the store, under any profile.
    #[must_use]
    pub const fn was_used(&self) -> bool {
        self.was_used
    }

    /// Whether a session other than a script used it where robots or people are at risk: no script may use it after
    /// that.
    #[must_use]
    pub const fn was_live(&self) -> bool {
        self.was_live
    }

    /// Whether a script set the profile in force.
    #[must_use]
    pub const fn scripted(&self) -> bool {
        self.scripted
    }

    /// Whether these rules need an authorization to come into force, or to stay.
    #[must_use]
    pub fn needs(&self, class: ProfileName, rules: &ContextRules) -> bool {
        let next = IncomingProfile {
            class,
            rules: rules.digest,
            is_looser: !rules.loosened.is_empty(),
            scripted: rules.scripted,
        };
        needs_authorization(self.last, self.authorized, &next)
    }

    /// These rules as the next ones in force.
    #[must_use]
    pub fn next(&self, rules: &ProfileRules, scripted: bool) -> ContextRules {
        let before = match (self.last, &self.settings) {
            (Some(last), Some(settings)) if last.class.is_at_risk() => PreviousProfile::Known(settings),
            (Some(last), None) if last.class.is_at_risk() => PreviousProfile::Unknown,
            (Some(_) | None, _) => PreviousProfile::Nothing,
        };
        let ProfileRules { digest, settings, .. } = rules;
        ContextRules {
            digest: *digest,
            loosened: rules.downgraded_fields(before),
            scripted,
            settings: settings.clone(),
        }
    }

    /// The change that an administrator signs for these rules.
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
        let is_authorized = self.authorization.as_ref().is_some_and(|word| {
            word.seq.checked_add(1) == Some(seq)
                && word.profile == class
                && word.rules.as_ref() == Some(&self.change_to(rules))
        });
        if is_authorized || !self.needs(class, rules) {
            return Ok(());
        }
        let summary = downgrade_summary(&rules.loosened);
        Err(format!(
            "{}, {summary}; an administrator must authorize this change right before it, and none did",
            self.change_description(class)
        ))
    }

    fn change_description(&self, class: ProfileName) -> String {
        match self.last {
            Some(last) if last.class != class => {
                format!("it goes over from the profile {} to {class}", last.class)
            }
            Some(_) => format!("it changes the profile {class}"),
            None => format!("it begins with the profile {class}"),
        }
    }

    /// An authorization.
    pub fn allow(&mut self, seq: u64, profile: ProfileName, rules: Option<RulesChange>) {
        self.authorization = Some(RecordedAuthorization { seq, profile, rules });
        self.asked = true;
    }

    /// As [`Self::allow`], from a record.
    pub fn allow_on_record(&mut self, seq: u64, change: RecordedProfileChange) {
        let rules = change.act.and_then(|act| act.act).and_then(|act| act.rules);
        self.allow(seq, change.profile, rules);
    }

    /// A record by which a profile comes into force.
    ///
    /// # Errors
    /// As [`Self::set`].
    pub fn take(&mut self, seq: u64, change: RecordedProfileChange) -> Result<(), String> {
        let RecordedProfileChange { profile, looser_by_word, rules, .. } = change;
        self.set(seq, profile, looser_by_word, rules)
    }

    /// Puts a profile in force, even if the result is an error.
    ///
    /// # Errors
    /// If it needs an authorization, and the record before it is not its authorization.
    pub fn set(
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
        self.was_live |= class.is_at_risk() && !self.scripted;
        let digest = rules.as_ref().map(|rules| rules.digest);
        self.authorized = match &rules {
            Some(rules) if checked.is_ok() && self.needs(class, rules) => digest,
            _ => self.authorized.filter(|authorized| Some(*authorized) == digest),
        };
        self.last = Some(ActiveProfile { class, rules: digest });
        self.settings = rules.map(|rules| rules.settings);
        checked
    }

    /// As [`Self::check`], for a record of an earlier version, without rules.
    fn check_of_earlier(&self, seq: u64, class: ProfileName, looser_by_word: bool) -> Result<(), String> {
        let last = self.last.map(|last| last.class);
        if self.ruled && (class.is_at_risk() || last.is_some_and(ProfileName::is_at_risk)) {
            return Err(format!("{}, and does not name its rules", self.change_description(class)));
        }
        let is_authorized = self.authorization.as_ref().is_some_and(|authorization| {
            authorization.seq.checked_add(1) == Some(seq) && authorization.profile == class
        });
        if (self.asked || looser_by_word) && last.is_some_and(|last| class < last) && !is_authorized {
            let step = self.change_description(class);
            return Err(format!(
                "{step}; an administrator must authorize this change right before it, and none did"
            ));
        }
        Ok(())
    }

    /// From here on no record counts as one of an earlier version.
    pub const fn require_authorization(&mut self) {
        (self.asked, self.ruled) = (true, true);
    }
}

/// Under a profile with approvers, before or after the change, only the administrator may be able to give the
/// authorization.
///
/// # Errors
/// If another person could.
pub fn check_key_guarded(
    act: &SignedProfileAct,
    persons: &PersonDirectory,
    last: Option<ProfileName>,
) -> Result<(), PersonError> {
    // Earlier versions checked the profile in force alone.
    let next = act.act().rules.as_ref().map(|_| act.act().profile);
    let is_beside_people = [last, next].into_iter().flatten().any(ProfileName::is_beside_people);
    if is_beside_people { act.check_guarded(persons) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ProfileName::{Human, Real, Sim};
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::Profile;
    use holdpoint_governance::profile::fields::{FIELDS, ProfileField, StricterDirection, default_of};

    fn rules(text: &str, is_looser: bool) -> ContextRules {
        let one = DowngradedField {
            before: "none".to_owned(),
            field: text.to_owned(),
            now: "1".to_owned(),
            shipped: "0".to_owned(),
        };
        ContextRules {
            digest: Digest::of_parts("test", &[text.as_bytes()]),
            loosened: if is_looser { vec![one] } else { Vec::new() },
            scripted: false,
            settings: ProfileSettings::from([(text.to_owned(), "1".to_owned())]),
        }
    }

    #[test]
    fn earlier_records_are_valid_until_authorizations_are_required() {
        let mut history = ProfileHistory::default();
        for (seq, profile) in [(1, Human), (2, Sim), (3, Real)] {
            history.set(seq, profile, false, None).unwrap();
        }
        // From here on an authorization is required, also by a record that denies it.
        history.set(4, Human, true, None).unwrap();
        assert!(history.set(5, Real, false, None).unwrap_err().contains(&format!("{Human} to {Real}")));
        history.set(6, Human, true, None).unwrap();
        // Right before it, and for it.
        history.allow(7, Sim, None);
        assert!(history.set(9, Sim, true, None).is_err());
        history.set(10, Human, true, None).unwrap();
        history.allow(11, Real, None);
        assert!(history.set(12, Sim, true, None).is_err());
        history.set(13, Human, true, None).unwrap();
        history.allow(14, Sim, None);
        history.set(15, Sim, true, None).unwrap();
        assert_eq!(history.last().map(|last| last.class), Some(Sim));
        // Later versions require one for the rules, and no record lacks rules any more.
        history.set(16, Human, true, Some(rules("human", false))).unwrap();
        assert!(history.set(17, Human, true, None).is_err());
        history.allow(18, Sim, None);
        assert!(history.set(19, Sim, true, None).is_err());
    }

    #[test]
    fn authorization_covers_only_the_listed_change_right_after_it() {
        let begun = || {
            let mut history = ProfileHistory::default();
            history.set(1, Human, false, Some(rules("a", false))).unwrap();
            history
        };
        let next = rules("b", true);
        assert!(begun().set(2, Human, false, Some(next.clone())).unwrap_err().contains("1 field is"));
        let good = begun().change_to(&next);
        let allowed = |change: &RulesChange, profile: ProfileName, seq: u64| {
            let mut history = begun();
            history.allow(2, profile, Some(change.clone()));
            history.set(seq, Human, false, Some(next.clone())).map(|()| history)
        };
        let mut history = allowed(&good, Human, 3).unwrap();
        assert!(allowed(&good, Human, 4).is_err(), "something came between");
        assert!(allowed(&good, Real, 3).is_err());
        assert!(allowed(&RulesChange { from: None, ..good.clone() }, Human, 3).is_err());
        assert!(allowed(&RulesChange { to: rules("c", true).digest, ..good.clone() }, Human, 3).is_err());
        assert!(allowed(&RulesChange { loosened: Vec::new(), ..good.clone() }, Human, 3).is_err());
        // It is valid while those rules are in force, and then used up.
        history.set(4, Human, false, Some(next.clone())).unwrap();
        history.allow(5, Human, Some(history.change_to(&rules("a", false))));
        history.set(6, Human, false, Some(rules("a", false))).unwrap();
        assert!(history.set(7, Human, false, Some(next)).is_err());
    }

    /// The blind mutant: each number of the table alone, moved to where it is less strict, in a profile that parses.
    #[test]
    fn no_single_number_becomes_less_strict_without_an_authorization() {
        for class in [Real, Human] {
            let shipped = Profile::builtin(class).unwrap();
            let table = PolicyTable::builtin(&shipped).unwrap();
            let of = |profile: &Profile| ProfileRules::of(profile, &table).unwrap();
            let as_shipped = ProfileHistory::default().next(&of(&shipped), false);
            let mut begun = ProfileHistory::default();
            begun.set(1, class, false, Some(as_shipped)).unwrap();
            for ProfileField { path, lowest, highest, tighter, .. } in FIELDS {
                let mut value = serde_json::to_value(&shipped).unwrap();
                let pointer = format!("/{}", path.replace('.', "/"));
                // A number at the value that it has without being set is not written.
                let now = value
                    .pointer(&pointer)
                    .map_or_else(|| default_of(path), serde_json::Value::as_f64)
                    .unwrap();
                let loosest = match tighter {
                    StricterDirection::Lower => highest,
                    StricterDirection::Higher => lowest,
                    StricterDirection::Neither if now > *lowest => lowest,
                    StricterDirection::Neither => highest,
                };
                if (loosest - now).abs() < f64::EPSILON {
                    continue;
                }
                // A whole number is kept as one.
                let number = serde_json::from_str(&loosest.to_string()).unwrap();
                match value.pointer_mut(&pointer) {
                    Some(written) => *written = number,
                    None => {
                        let (table, key) = path.split_once('.').unwrap();
                        value[table][key] = number;
                    }
                }
                let loose = of(&serde_json::from_value(value).unwrap());
                for (history, seq) in [(&ProfileHistory::default(), 1), (&begun, 2)] {
                    let next = history.next(&loose, false);
                    let refused = history.check(seq, class, &next).unwrap_err();
                    assert!(refused.contains(&format!(": {path}")), "{class}: {refused}");
                }
            }
        }
    }

    #[test]
    fn rules_of_a_script_authorize_no_other_session() {
        let (loose, mut script) = (rules("a", true), rules("a", true));
        script.scripted = true;
        let mut history = ProfileHistory::default();
        history.set(1, Real, false, Some(script.clone())).unwrap();
        assert!(history.needs(Real, &loose) && !history.needs(Real, &script));
        // After a session other than a script, no script is accepted.
        history.allow(2, Real, Some(history.change_to(&loose)));
        history.set(3, Real, false, Some(loose)).unwrap();
        history.allow(4, Real, Some(history.change_to(&script)));
        assert_eq!(history.check(5, Real, &script).unwrap_err(), SCRIPT_AFTER_LIVE);
    }
}
