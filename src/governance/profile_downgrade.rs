//! Which settings of a profile became less strict, and when that takes an administrator's signed authorization.
//!
//! A setting is a number, a word, or a listed thing of a profile, or what its policies say of one mode. The field
//! table ([`fields`](crate::profile::fields)) defines in which direction a number is less strict; a setting without a
//! direction counts as less strict wherever it differs. Pure: the caller supplies the settings in force before.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::ids::{Digest, canonical_json};
use super::policy_table::{ModeRuling, PolicyError, PolicyTable};
use super::profile::fields::{FIELDS, StricterDirection, WORDS, default_of};
use super::profile::{Profile, ProfileName};
use super::site_profile::SiteProfileError;

/// The settings of a profile and its policies, by their paths, e.g. `runtime.retries_max`; as texts.
pub type ProfileSettings = BTreeMap<String, String>;

/// The most fields that an authorization lists.
pub const DOWNGRADED_FIELDS_MAX: usize = 2048;
/// The placeholder of an absent setting.
const NONE: &str = "none";
/// The placeholder of settings that an earlier version did not record.
const NOT_ON_RECORD: &str = "not on record";
/// The value of a listed thing.
const LISTED: &str = "listed";
/// Where the settings of policies begin.
const POLICY: &str = "policy.";

/// A field that became less strict, as an administrator signs it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DowngradedField {
    /// The value in force before; `none` if there was none, or if it is unknown.
    pub before: String,
    /// Path of the field, e.g. `runtime.retries_max`.
    pub field: String,
    /// The new value.
    pub now: String,
    /// The value in the shipped profile of this class.
    pub shipped: String,
}

impl std::fmt::Display for DowngradedField {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { before, field, now, shipped } = self;
        write!(f, "{field}: {now}, before {before}, shipped {shipped}")
    }
}

/// How far a profile is less strict than the one before it: the number of fields, and the first of them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(tag = "extent", rename_all = "kebab-case", deny_unknown_fields)]
pub enum DowngradeExtent {
    /// No field is less strict.
    NoField,
    /// The profile before is not on record; fields are less strict than in the shipped profile.
    BeforeUnknown {
        /// How many fields.
        fields: u64,
    },
    /// Fields are less strict.
    Fields {
        /// How many fields.
        fields: u64,
        /// The first of them.
        first: DowngradedField,
    },
}

impl DowngradeExtent {
    /// The extent of these less strict fields.
    #[must_use]
    pub fn of(loosened: &[DowngradedField]) -> Self {
        match loosened {
            [] => Self::NoField,
            [first, rest @ ..] if first.before == NOT_ON_RECORD => {
                Self::BeforeUnknown { fields: rest.len() as u64 }
            }
            [first, ..] => Self::Fields { fields: loosened.len() as u64, first: first.clone() },
        }
    }

    /// How a change of profile is shown and refused.
    #[must_use]
    pub fn summary(&self) -> Cow<'static, str> {
        match self {
            Self::NoField => "no field is less strict".into(),
            Self::BeforeUnknown { fields } => format!(
                "what was in force before is not on record, {fields} fields are less strict than in the profile \
                 that comes with the program"
            )
            .into(),
            Self::Fields { fields: 1, first } => format!("1 field is less strict: {first}").into(),
            Self::Fields { fields, first } => {
                format!("{fields} fields are less strict, the first of them {first}").into()
            }
        }
    }
}

/// The settings in force before a profile.
#[derive(Clone, Copy, Debug)]
pub enum PreviousProfile<'a> {
    /// None, or a profile of the class `sim`: only the shipped profile is compared.
    Nothing,
    /// These settings.
    Known(&'a ProfileSettings),
    /// A profile whose settings are not on record; earlier versions recorded only digests.
    Unknown,
}

/// The digest of a profile with its policies, independent of the compiling program.
#[must_use]
pub fn rules_digest(profile: &Digest, policy: &Digest) -> Digest {
    Digest::of_parts("holdpoint.rules.v1", &[profile.bytes(), policy.bytes()])
}

/// Every setting of a profile and its compiled policies but its own name, which loosens nothing. A number that has the
/// value it has without being set is absent, as in the settings that earlier versions recorded.
#[must_use]
pub fn settings(profile: &Profile, table: &PolicyTable) -> ProfileSettings {
    let mut settings = ProfileSettings::new();
    // A profile that cannot be serialized has no settings, so each of them counts as less strict.
    walk("", &serde_json::to_value(profile).unwrap_or_default(), &mut settings);
    settings.remove("site");
    for entry in &table.modes {
        let path = format!("{POLICY}{}", entry.mode);
        let (verdict, cap) = match entry.verdict {
            ModeRuling::Allow => ("allow", None),
            ModeRuling::AllowTighter(cap) => ("allow", Some(cap)),
            ModeRuling::Review => ("review", None),
            // A denied mode is absent, whatever denies it.
            ModeRuling::Forbid | ModeRuling::Uncovered => continue,
        };
        if let Some(cap) = cap {
            settings.insert(format!("{path}.speed_max_m_s"), cap.speed_max_m_s.to_string());
            settings.insert(format!("{path}.force_max_n"), cap.force_max_n.to_string());
        }
        settings.insert(path, verdict.to_owned());
    }
    for row in &table.activations {
        let verdict = match (row.forbidden, row.review) {
            (true, _) => "forbidden",
            (false, true) => "review",
            (false, false) => "allow",
        };
        let path = format!("{POLICY}activate.{}.{}", row.risk.name(), row.provenance.name());
        settings.insert(path, verdict.to_owned());
    }
    settings
}

/// A profile with its policies, for comparisons.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProfileRules {
    /// Its class.
    pub class: ProfileName,
    /// [`rules_digest`] of it.
    pub digest: Digest,
    /// Its settings.
    pub settings: ProfileSettings,
    /// Those of the profile of its class that comes with the program.
    pub shipped: ProfileSettings,
}

impl ProfileRules {
    /// The rules of a profile with its compiled policies.
    ///
    /// # Errors
    /// If a shipped profile does not parse, which a test rules out.
    pub fn of(profile: &Profile, table: &PolicyTable) -> Result<Self, SiteProfileError> {
        let shipped = Profile::builtin(profile.name)?;
        let shipped = settings(&shipped, &PolicyTable::builtin(&shipped)?);
        let digest = profile.digest().map_err(|error| PolicyError::Vocabulary(error.to_string()))?;
        let digest = rules_digest(&digest, &table.digest);
        Ok(Self { class: profile.name, digest, settings: settings(profile, table), shipped })
    }

    /// As [`downgraded_fields`].
    #[must_use]
    pub fn downgraded_fields(&self, before: PreviousProfile<'_>) -> Vec<DowngradedField> {
        downgraded_fields(before, &self.shipped, &self.settings)
    }
}

fn walk(path: &str, value: &Value, settings: &mut ProfileSettings) {
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    let mut set = |text: String| drop(settings.insert(path.to_owned(), text));
    match value {
        Value::Null => {}
        Value::Bool(is_set) => set(is_set.to_string()),
        // A whole number reads the same as an integer or a float.
        Value::Number(number) => set(number.as_f64().map_or_else(|| number.to_string(), |it| it.to_string())),
        Value::String(text) => set(text.clone()),
        Value::Object(map) => {
            for (key, value) in map {
                walk(&join(key), value, settings);
            }
        }
        Value::Array(values) if values.iter().all(Value::is_number) => {
            for (index, value) in values.iter().enumerate() {
                walk(&join(&index.to_string()), value, settings);
            }
        }
        Value::Array(values) => {
            for value in values {
                let text = match value {
                    Value::String(text) => text.clone(),
                    value => canonical_json(value).unwrap_or_default(),
                };
                settings.insert(join(&text), LISTED.to_owned());
            }
        }
    }
}

/// How two values of a setting compare.
enum SettingOrder {
    /// Numbers, by the field table.
    Number(StricterDirection),
    /// Words, the least strict first.
    Words(&'static [&'static str]),
    /// More of them is tighter.
    Listed,
    /// No direction.
    Unordered,
}

/// Priorities of alarms.
const PRIORITIES: &[&str] = &["low", "medium", "high"];
/// Verdicts of policies on a mode or an activation; an absent mode is denied.
const VERDICTS: &[&str] = &["allow", "review", NONE, "forbidden"];

fn order(field: &str) -> SettingOrder {
    if let Some(rest) = field.strip_prefix(POLICY) {
        // Without its own cap a mode has the profile's, which is a separate setting.
        let is_cap = rest.ends_with(".speed_max_m_s") || rest.ends_with(".force_max_n");
        return if is_cap {
            SettingOrder::Number(StricterDirection::Lower)
        } else {
            SettingOrder::Words(VERDICTS)
        };
    }
    if field.starts_with("runtime.keep_out.") || field.starts_with("freeze.") {
        return SettingOrder::Listed;
    }
    if field.starts_with("alarms.") {
        return SettingOrder::Words(PRIORITIES);
    }
    if let Some((_, words)) = WORDS.iter().find(|(path, _)| *path == field) {
        return SettingOrder::Words(words);
    }
    FIELDS
        .iter()
        .find(|known| known.path == field)
        .map_or(SettingOrder::Unordered, |known| SettingOrder::Number(known.tighter))
}

/// Whether a setting is less strict now. A difference that is not known to be stricter counts as less strict.
fn is_less_strict(field: &str, before: Option<&String>, now: Option<&String>) -> bool {
    if before == now {
        return false;
    }
    match order(field) {
        SettingOrder::Listed => now.is_none(),
        SettingOrder::Unordered | SettingOrder::Number(StricterDirection::Neither) => true,
        SettingOrder::Words(words) => {
            let rank = |value: Option<&String>| {
                let value = value.map_or(NONE, String::as_str);
                words.iter().position(|word| *word == value)
            };
            match (rank(before), rank(now)) {
                (Some(before), Some(now)) => now < before,
                _ => true,
            }
        }
        SettingOrder::Number(tighter) => {
            let is_policy = field.starts_with(POLICY);
            let number = |value: Option<&String>| match value {
                Some(value) => value.parse::<f64>().ok(),
                None if is_policy => Some(f64::INFINITY),
                None => default_of(field),
            };
            let (Some(before), Some(now)) = (number(before), number(now)) else { return true };
            if tighter == StricterDirection::Lower { now > before } else { now < before }
        }
    }
}

/// Every field of `next` that is less strict than before, or than the shipped profile of its class, in the order of
/// their paths. The class `sim` promises nothing: its shipped profile is shown but not compared.
#[must_use]
pub fn downgraded_fields(
    before: PreviousProfile<'_>,
    shipped: &ProfileSettings,
    next: &ProfileSettings,
) -> Vec<DowngradedField> {
    let known = match before {
        PreviousProfile::Known(settings) => Some(settings),
        PreviousProfile::Nothing | PreviousProfile::Unknown => None,
    };
    let is_promise = next.get("name").is_none_or(|class| class != ProfileName::Sim.name());
    let measures = [known, is_promise.then_some(shipped)];
    let fields: BTreeSet<&String> =
        measures.into_iter().flatten().flat_map(BTreeMap::keys).chain(next.keys()).collect();
    let text = |settings: Option<&ProfileSettings>, field: &str| {
        let value = settings.and_then(|settings| settings.get(field)).cloned();
        let default = || settings.and(default_of(field)).map(|value| value.to_string());
        value.or_else(default).unwrap_or_else(|| NONE.to_owned())
    };
    let mut found: Vec<DowngradedField> = fields
        .into_iter()
        .filter(|field| {
            measures
                .into_iter()
                .flatten()
                .any(|than| is_less_strict(field, than.get(*field), next.get(*field)))
        })
        .map(|field| DowngradedField {
            before: text(known, field),
            field: field.clone(),
            now: text(Some(next), field),
            shipped: text(Some(shipped), field),
        })
        .collect();
    if matches!(before, PreviousProfile::Unknown) {
        let name = |settings: &ProfileSettings| text(Some(settings), "name");
        let unknown = DowngradedField {
            before: NOT_ON_RECORD.to_owned(),
            field: "profile".to_owned(),
            now: name(next),
            shipped: name(shipped),
        };
        found.insert(0, unknown);
    }
    found
}

/// A profile that is in force.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActiveProfile {
    /// Its class.
    pub class: ProfileName,
    /// [`rules_digest`] of it; records of earlier versions have none.
    pub rules: Option<Digest>,
}

/// The circumstances under which the gate activated a version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AdmissionContext {
    /// The profile's class.
    pub class: ProfileName,
    /// Whether a script requested it: its people are simulated, and its seed is its own.
    pub scripted: bool,
}

impl AdmissionContext {
    /// The assumption without a record.
    pub const LEAST: Self = Self { class: ProfileName::Sim, scripted: true };

    /// Whether a version activated so may stay in control now: under no stricter class, and outside scripts only if no
    /// script decided.
    #[must_use]
    pub fn suffices(self, now: Self) -> bool {
        !now.class.is_at_risk() || (self.class >= now.class && (now.scripted || !self.scripted))
    }
}

/// A profile that is to come into force.
#[derive(Clone, Copy, Debug)]
pub struct IncomingProfile {
    /// Its class.
    pub class: ProfileName,
    /// [`rules_digest`] of it.
    pub rules: Digest,
    /// Whether [`downgraded_fields`] returns any field.
    pub is_looser: bool,
    /// Whether a script uses it, for the simulated cell of its own store.
    pub scripted: bool,
}

/// Whether a profile takes an administrator's signed authorization. `authorized` is the digest of the rules that the
/// last used authorization permits. A script needs none: its store was never used under `real` or `human` by another
/// engine, and no later engine inherits what it left in force.
#[must_use]
pub fn needs_authorization(
    last: Option<ActiveProfile>,
    authorized: Option<Digest>,
    next: &IncomingProfile,
) -> bool {
    if next.scripted {
        return false;
    }
    let looser = next.class.is_at_risk() && next.is_looser;
    match last {
        Some(last) if last.rules == Some(next.rules) => looser && authorized != Some(next.rules),
        Some(last) if last.class.is_at_risk() => true,
        Some(_) | None => looser,
    }
}

/// As [`DowngradeExtent::summary`].
#[must_use]
pub fn downgrade_summary(loosened: &[DowngradedField]) -> Cow<'static, str> {
    DowngradeExtent::of(loosened).summary()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::fields::ProfileField;

    /// The settings of a shipped profile, with the numbers that its JSON form leaves out at their value.
    fn shipped(name: ProfileName) -> ProfileSettings {
        let profile = Profile::builtin(name).unwrap();
        let mut settings = settings(&profile, &PolicyTable::builtin(&profile).unwrap());
        for ProfileField { path, .. } in FIELDS {
            if let Some(value) = default_of(path) {
                settings.entry((*path).to_owned()).or_insert_with(|| value.to_string());
            }
        }
        settings
    }

    #[test]
    fn every_setting_of_the_shipped_profiles_has_a_strictness_order() {
        for name in ProfileName::ALL {
            let settings = shipped(name);
            for ProfileField { path, .. } in FIELDS {
                assert!(settings.contains_key(*path), "{path}");
            }
            let unordered: Vec<&str> = settings
                .keys()
                .map(String::as_str)
                .filter(|path| matches!(order(path), SettingOrder::Unordered))
                .collect();
            assert_eq!(
                unordered,
                ["thresholds.preset"],
                "a new setting needs a direction, or a reason for none"
            );
            for (field, value) in &settings {
                if let SettingOrder::Words(words) = order(field) {
                    assert!(words.contains(&value.as_str()), "{field}: {value}");
                }
            }
        }
    }

    /// The blind mutant: each field alone, moved to where it is less strict.
    #[test]
    fn less_strict_field_is_found_and_a_stricter_one_is_not() {
        for name in [ProfileName::Real, ProfileName::Human] {
            let shipped = shipped(name);
            for (field, value) in &shipped {
                let (looser, tighter): (Vec<Option<String>>, Vec<Option<String>>) = match order(field) {
                    SettingOrder::Number(tighter) => {
                        let number: f64 = value.parse().unwrap();
                        let (up, down) =
                            (Some((number + 0.01).to_string()), Some((number - 0.01).to_string()));
                        match tighter {
                            StricterDirection::Lower => (vec![up], vec![down]),
                            StricterDirection::Higher => (vec![down], vec![up]),
                            StricterDirection::Neither => (vec![up, down, None], vec![]),
                        }
                    }
                    SettingOrder::Words(words) => {
                        let at = words.iter().position(|word| word == value).unwrap();
                        let of = |words: &[&str]| words.iter().map(|word| Some((*word).to_owned())).collect();
                        (of(&words[..at]), of(&words[at + 1..]))
                    }
                    SettingOrder::Listed => (vec![None], vec![]),
                    SettingOrder::Unordered => (vec![Some("another".to_owned()), None], vec![]),
                };
                let with = |value: &Option<String>| {
                    let mut next = shipped.clone();
                    match value {
                        Some(value) => drop(next.insert(field.clone(), value.clone())),
                        None => drop(next.remove(field)),
                    }
                    next
                };
                for value in &looser {
                    let next = with(value);
                    // A class that promises less is compared with the profile before, and with no shipped one.
                    let of_class = (PreviousProfile::Nothing, &shipped);
                    let measures = [of_class, (PreviousProfile::Known(&shipped), &next)];
                    for (before, shipped) in &measures[usize::from(field == "name")..] {
                        let found = downgraded_fields(*before, shipped, &next);
                        let fields: Vec<&str> = found.iter().map(|one| one.field.as_str()).collect();
                        assert_eq!(fields, [field], "{value:?}");
                    }
                }
                for value in &tighter {
                    assert_eq!(
                        downgraded_fields(PreviousProfile::Known(&shipped), &shipped, &with(value)),
                        [],
                        "{field}"
                    );
                }
            }
        }
    }

    #[test]
    fn an_added_rule_is_less_strict_unless_it_forbids() {
        let shipped = shipped(ProfileName::Human);
        let with = |field: &str, value: &str| {
            let mut next = shipped.clone();
            next.insert(field.to_owned(), value.to_owned());
            downgraded_fields(PreviousProfile::Known(&shipped), &shipped, &next).len()
        };
        assert_eq!(with("monitor.new_limit", "3"), 1, "the direction of the change is not known");
        assert_eq!(with("policy.arm/direct in human at authority 3", "review"), 1);
        assert_eq!(with("policy.arm/direct in human at authority 3", "allow"), 1);
        assert_eq!(with("runtime.keep_out.tray", LISTED), 0);
        assert_eq!(with("freeze.{\"from_s\":1.0}", LISTED), 0);
        // A cap where there was none.
        assert_eq!(with("policy.arm/joints in work at authority 0.speed_max_m_s", "0.1"), 0);
    }

    #[test]
    fn an_unrecorded_profile_is_reported_as_unknown() {
        let shipped = shipped(ProfileName::Real);
        let found = downgraded_fields(PreviousProfile::Unknown, &shipped, &shipped);
        assert_eq!(found.len(), 1);
        assert_eq!((&*found[0].field, &*found[0].before), ("profile", "not on record"));
        assert_eq!(DowngradeExtent::of(&found), DowngradeExtent::BeforeUnknown { fields: 0 });
        assert_eq!(downgraded_fields(PreviousProfile::Nothing, &shipped, &shipped), []);
    }

    #[test]
    fn changes_under_real_or_human_and_less_strict_ones_need_an_authorization() {
        use ProfileName::{Human, Real, Sim};
        let rules = |text: &str| Digest::of_parts("test", &[text.as_bytes()]);
        let incoming = |class, of: &str, is_looser| IncomingProfile {
            class,
            rules: rules(of),
            is_looser,
            scripted: false,
        };
        let last = |class, of: &str| Some(ActiveProfile { class, rules: Some(rules(of)) });
        let needs = |last, next| needs_authorization(last, None, &next);
        for (last, next, expected) in [
            (None, incoming(Sim, "a", true), false),
            (None, incoming(Human, "a", false), false),
            (None, incoming(Real, "a", true), true),
            (last(Sim, "a"), incoming(Sim, "b", true), false),
            (last(Sim, "a"), incoming(Human, "b", false), false),
            (last(Sim, "a"), incoming(Human, "b", true), true),
            (last(Real, "a"), incoming(Real, "a", false), false),
            (last(Real, "a"), incoming(Real, "a", true), true),
            (last(Real, "a"), incoming(Real, "b", false), true),
            (last(Real, "a"), incoming(Human, "b", false), true),
            (last(Human, "a"), incoming(Sim, "b", false), true),
            (Some(ActiveProfile { class: Human, rules: None }), incoming(Human, "a", false), true),
        ] {
            assert_eq!(needs(last, next), expected, "{last:?} {next:?}");
        }
        let loose = incoming(Real, "a", true);
        assert!(!needs_authorization(last(Real, "a"), Some(rules("a")), &loose), "authorized before");
        assert!(needs_authorization(last(Real, "a"), Some(rules("b")), &loose));
        // A script on a store of its own, and the engine that continues with its store.
        let script = IncomingProfile { scripted: true, ..loose };
        assert!(!needs_authorization(last(Human, "b"), None, &script));
        assert!(needs_authorization(last(Real, "a"), None, &loose));
    }

    #[test]
    fn version_stays_active_only_where_its_admission_suffices() {
        use ProfileName::{Human, Real, Sim};
        let by = |class, scripted| AdmissionContext { class, scripted };
        let strictest = ProfileName::ALL.into_iter().max().unwrap();
        for class in ProfileName::ALL {
            for scripted in [false, true] {
                assert!(by(class, scripted).suffices(by(Sim, false)), "no one is at risk under sim");
                assert!(!by(class, true).suffices(by(Real, false)), "a script's people are played");
                assert!(by(strictest, scripted).suffices(by(class, true)));
            }
        }
        for (admission, now, stays) in
            [(Sim, Real, false), (Sim, Human, false), (Real, Human, false), (Human, Real, true)]
        {
            assert_eq!(by(admission, false).suffices(by(now, false)), stays, "{admission} {now}");
            assert!(!AdmissionContext::LEAST.suffices(by(now, true)), "{now}");
        }
    }
}
