//! Which settings of a profile got looser, and when that takes an administrator's signed authorization.
//!
//! A setting is a number, a word, or a listed thing of a profile, or what its policies say of one mode. The field table
//! ([`fields`](crate::profile::fields)) says in which direction a number is looser; a setting without a direction counts as
//! looser wherever it differs. Pure: which settings were in force before, the caller says.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::ids::{Digest, canonical_json};
use super::own_profile::OwnProfileError;
use super::policy_table::{ModeRuling, PolicyError, PolicyTable};
use super::profile::fields::{FIELDS, Tighter};
use super::profile::{Profile, ProfileName};

/// The settings of a profile and its policies, by their paths, e.g. `runtime.retries_max`; as texts.
pub type Settings = BTreeMap<String, String>;

/// The most fields that an authorization lists.
pub const LOOSENED_MAX: usize = 2048;
/// What stands for a setting that is not there.
const NONE: &str = "none";
/// What stands for settings that an earlier version did not put on record.
const NOT_ON_RECORD: &str = "not on record";
/// What a listed thing is set to.
const LISTED: &str = "listed";
/// Where the settings of policies begin.
const POLICY: &str = "policy.";

/// A field that got looser, as an administrator signs it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loosened {
    /// What was in force before; `none` if nothing was, or if it is not known.
    pub before: String,
    /// Path of the field, e.g. `runtime.retries_max`.
    pub field: String,
    /// What comes into force.
    pub now: String,
    /// What the profile of this class that comes with the program has.
    pub shipped: String,
}

impl std::fmt::Display for Loosened {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { before, field, now, shipped } = self;
        write!(f, "{field}: {now}, before {before}, shipped {shipped}")
    }
}

/// What was in force before a profile.
#[derive(Clone, Copy, Debug)]
pub enum Before<'a> {
    /// Nothing, or a profile of the class `sim`: the shipped profile alone is the measure.
    Nothing,
    /// These settings.
    Known(&'a Settings),
    /// A profile whose settings are not on record; earlier versions of the program wrote digests alone.
    Unknown,
}

/// What names a profile with its policies, whatever program compiled them.
#[must_use]
pub fn rules_digest(profile: &Digest, policy: &Digest) -> Digest {
    Digest::of_parts("holdpoint.rules.v1", &[profile.bytes(), policy.bytes()])
}

/// Every setting of a profile and its compiled policies but its own name, which loosens nothing.
#[must_use]
pub fn settings(profile: &Profile, table: &PolicyTable) -> Settings {
    let mut settings = Settings::new();
    // A profile that has no such form has no settings, and so every one of them is looser.
    walk("", &serde_json::to_value(profile).unwrap_or_default(), &mut settings);
    settings.remove("site");
    for entry in &table.modes {
        let path = format!("{POLICY}{}", entry.mode);
        let (verdict, cap) = match entry.verdict {
            ModeRuling::Allow => ("allow", None),
            ModeRuling::AllowTighter(cap) => ("allow", Some(cap)),
            ModeRuling::Review => ("review", None),
            // What is denied is not there, by whatever it is denied.
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

/// A profile with its policies, as it is compared with others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rules {
    /// Its class.
    pub class: ProfileName,
    /// [`rules_digest`] of it.
    pub digest: Digest,
    /// Its settings.
    pub settings: Settings,
    /// Those of the profile of its class that comes with the program.
    pub shipped: Settings,
}

impl Rules {
    /// The rules of a profile with its compiled policies.
    ///
    /// # Errors
    /// If what comes with the program does not parse, which a test rules out.
    pub fn of(profile: &Profile, table: &PolicyTable) -> Result<Self, OwnProfileError> {
        let shipped = Profile::builtin(profile.name)?;
        let shipped = settings(&shipped, &PolicyTable::builtin(&shipped)?);
        let digest = profile.digest().map_err(|error| PolicyError::Vocabulary(error.to_string()))?;
        let digest = rules_digest(&digest, &table.digest);
        Ok(Self { class: profile.name, digest, settings: settings(profile, table), shipped })
    }

    /// As [`loosened`].
    #[must_use]
    pub fn loosened(&self, before: Before<'_>) -> Vec<Loosened> {
        loosened(before, &self.shipped, &self.settings)
    }
}

fn walk(path: &str, value: &Value, settings: &mut Settings) {
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    let mut set = |text: String| drop(settings.insert(path.to_owned(), text));
    match value {
        Value::Null => {}
        Value::Bool(is_set) => set(is_set.to_string()),
        // A whole number reads the same whether it is kept as one or not.
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
enum Order {
    /// Numbers, by the field table.
    Number(Tighter),
    /// Words, the loosest first.
    Words(&'static [&'static str]),
    /// More of them is tighter.
    Listed,
    /// No direction.
    Unordered,
}

/// Settings of which one word is tighter than another.
const WORDS: &[(&str, &[&str])] = &[
    ("name", &["sim", "real", "human"]),
    ("activation.require_improvement", &["false", "true"]),
    ("activation.rollback_coupled", &["false", "true"]),
    ("activation.approval_bound", &["false", "true"]),
    ("approval.break_glass", &["true", "false"]),
];
/// Priorities of alarms.
const PRIORITIES: &[&str] = &["low", "medium", "high"];
/// What policies say of a mode or an activation; a mode that is not there is denied.
const VERDICTS: &[&str] = &["allow", "review", NONE, "forbidden"];

fn order(field: &str) -> Order {
    if let Some(rest) = field.strip_prefix(POLICY) {
        // Without a cap of its own a mode has the profile's, which is a setting of its own.
        let is_cap = rest.ends_with(".speed_max_m_s") || rest.ends_with(".force_max_n");
        return if is_cap { Order::Number(Tighter::Lower) } else { Order::Words(VERDICTS) };
    }
    if field.starts_with("runtime.keep_out.") || field.starts_with("freeze.") {
        return Order::Listed;
    }
    if field.starts_with("alarms.") {
        return Order::Words(PRIORITIES);
    }
    if let Some((_, words)) = WORDS.iter().find(|(path, _)| *path == field) {
        return Order::Words(words);
    }
    FIELDS
        .iter()
        .find(|known| known.path == field)
        .map_or(Order::Unordered, |known| Order::Number(known.tighter))
}

/// Whether a setting is looser now. What is not known to be tighter is looser, wherever it differs.
fn is_looser(field: &str, before: Option<&String>, now: Option<&String>) -> bool {
    if before == now {
        return false;
    }
    match order(field) {
        Order::Listed => now.is_none(),
        Order::Unordered | Order::Number(Tighter::Neither) => true,
        Order::Words(words) => {
            let rank = |value: Option<&String>| {
                let value = value.map_or(NONE, String::as_str);
                words.iter().position(|word| *word == value)
            };
            match (rank(before), rank(now)) {
                (Some(before), Some(now)) => now < before,
                _ => true,
            }
        }
        Order::Number(tighter) => {
            let is_policy = field.starts_with(POLICY);
            let number = |value: Option<&String>| match value {
                Some(value) => value.parse::<f64>().ok(),
                None => is_policy.then_some(f64::INFINITY),
            };
            let (Some(before), Some(now)) = (number(before), number(now)) else { return true };
            if tighter == Tighter::Lower { now > before } else { now < before }
        }
    }
}

/// Every field of `next` that is looser than before, or than the shipped profile of its class, in the order of their paths. The
/// class `sim` promises nothing: its shipped profile is shown and is no measure.
#[must_use]
pub fn loosened(before: Before<'_>, shipped: &Settings, next: &Settings) -> Vec<Loosened> {
    let known = match before {
        Before::Known(settings) => Some(settings),
        Before::Nothing | Before::Unknown => None,
    };
    let is_promise = next.get("name").is_none_or(|class| class != ProfileName::Sim.name());
    let measures = [known, is_promise.then_some(shipped)];
    let fields: BTreeSet<&String> =
        measures.into_iter().flatten().flat_map(BTreeMap::keys).chain(next.keys()).collect();
    let text = |settings: Option<&Settings>, field: &str| {
        settings.and_then(|settings| settings.get(field)).map_or_else(|| NONE.to_owned(), Clone::clone)
    };
    let mut found: Vec<Loosened> = fields
        .into_iter()
        .filter(|field| {
            measures.into_iter().flatten().any(|than| is_looser(field, than.get(*field), next.get(*field)))
        })
        .map(|field| Loosened {
            before: text(known, field),
            field: field.clone(),
            now: text(Some(next), field),
            shipped: text(Some(shipped), field),
        })
        .collect();
    if matches!(before, Before::Unknown) {
        let name = |settings: &Settings| text(Some(settings), "name");
        let unknown = Loosened {
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
pub struct InForce {
    /// Its class.
    pub class: ProfileName,
    /// [`rules_digest`] of it; records of earlier versions have none.
    pub rules: Option<Digest>,
}

/// Under what a version was let into control by the gate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LetIn {
    /// The profile's class.
    pub class: ProfileName,
    /// Whether a script asked: its people are played, and its seed is its own.
    pub scripted: bool,
}

impl LetIn {
    /// What is assumed where nothing is on record.
    pub const LEAST: Self = Self { class: ProfileName::Sim, scripted: true };

    /// Whether a version that was let in so may stay in control now: under no class that asks for more, and nobody lives with
    /// what a script decided.
    #[must_use]
    pub fn suffices(self, now: Self) -> bool {
        !is_at_risk(now.class) || (self.class >= now.class && (now.scripted || !self.scripted))
    }
}

/// A profile that is to come into force.
#[derive(Clone, Copy, Debug)]
pub struct Taken {
    /// Its class.
    pub class: ProfileName,
    /// [`rules_digest`] of it.
    pub rules: Digest,
    /// Whether [`loosened`] names any field.
    pub is_looser: bool,
    /// Whether a script takes it, for the simulated cell of a store of its own.
    pub scripted: bool,
}

/// Whether a class of profile is for a cell where something, or somebody, can be hurt.
#[must_use]
pub const fn is_at_risk(class: ProfileName) -> bool {
    match class {
        ProfileName::Sim => false,
        ProfileName::Real | ProfileName::Human => true,
    }
}

/// Whether a profile takes an administrator's signed authorization. `authorized` are the rules that the last one that was used
/// is for. A script needs none: it uses no store that anybody else used under `real` or `human`, and what it left in force is
/// authorized for nobody else.
#[must_use]
pub fn needs_authorization(last: Option<InForce>, authorized: Option<Digest>, next: &Taken) -> bool {
    if next.scripted {
        return false;
    }
    let looser = is_at_risk(next.class) && next.is_looser;
    match last {
        Some(last) if last.rules == Some(next.rules) => looser && authorized != Some(next.rules),
        Some(last) if is_at_risk(last.class) => true,
        Some(_) | None => looser,
    }
}

/// What a change of profile is shown and refused as: how many fields are looser, and the first of them.
#[must_use]
pub fn told(loosened: &[Loosened]) -> Cow<'static, str> {
    match loosened {
        [] => "no field is looser".into(),
        [first, rest @ ..] if first.before == NOT_ON_RECORD => {
            let than = "than in the profile that comes with the program";
            format!("what was in force before is not on record, {} fields are looser {than}", rest.len())
                .into()
        }
        [one] => format!("1 field is looser: {one}").into(),
        [first, ..] => format!("{} fields are looser, the first of them {first}", loosened.len()).into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::fields::Field;

    fn shipped(name: ProfileName) -> Settings {
        let profile = Profile::builtin(name).unwrap();
        settings(&profile, &PolicyTable::builtin(&profile).unwrap())
    }

    #[test]
    fn every_setting_of_the_shipped_profiles_has_a_place_in_the_order() {
        for name in ProfileName::ALL {
            let settings = shipped(name);
            for Field { path, .. } in FIELDS {
                assert!(settings.contains_key(*path), "{path}");
            }
            let unordered: Vec<&str> = settings
                .keys()
                .map(String::as_str)
                .filter(|path| matches!(order(path), Order::Unordered))
                .collect();
            assert_eq!(
                unordered,
                ["thresholds.preset"],
                "a new setting needs a direction, or a reason for none"
            );
            for (field, value) in &settings {
                if let Order::Words(words) = order(field) {
                    assert!(words.contains(&value.as_str()), "{field}: {value}");
                }
            }
        }
    }

    /// The blind mutant: each field alone, moved to where it is looser.
    #[test]
    fn each_field_alone_is_found_where_it_is_looser_and_not_where_it_is_tighter() {
        for name in [ProfileName::Real, ProfileName::Human] {
            let shipped = shipped(name);
            for (field, value) in &shipped {
                let (looser, tighter): (Vec<Option<String>>, Vec<Option<String>>) = match order(field) {
                    Order::Number(tighter) => {
                        let number: f64 = value.parse().unwrap();
                        let (up, down) =
                            (Some((number + 0.01).to_string()), Some((number - 0.01).to_string()));
                        match tighter {
                            Tighter::Lower => (vec![up], vec![down]),
                            Tighter::Higher => (vec![down], vec![up]),
                            Tighter::Neither => (vec![up, down, None], vec![]),
                        }
                    }
                    Order::Words(words) => {
                        let at = words.iter().position(|word| word == value).unwrap();
                        let of = |words: &[&str]| words.iter().map(|word| Some((*word).to_owned())).collect();
                        (of(&words[..at]), of(&words[at + 1..]))
                    }
                    Order::Listed => (vec![None], vec![]),
                    Order::Unordered => (vec![Some("another".to_owned()), None], vec![]),
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
                    // A class that promises less is held against what was before, and against nothing that is shipped.
                    let of_class = (Before::Nothing, &shipped);
                    let measures = [of_class, (Before::Known(&shipped), &next)];
                    for (before, shipped) in &measures[usize::from(field == "name")..] {
                        let found = loosened(*before, shipped, &next);
                        let fields: Vec<&str> = found.iter().map(|one| one.field.as_str()).collect();
                        assert_eq!(fields, [field], "{value:?}");
                    }
                }
                for value in &tighter {
                    assert_eq!(loosened(Before::Known(&shipped), &shipped, &with(value)), [], "{field}");
                }
            }
        }
    }

    #[test]
    fn what_comes_in_is_looser_unless_it_only_forbids() {
        let shipped = shipped(ProfileName::Human);
        let with = |field: &str, value: &str| {
            let mut next = shipped.clone();
            next.insert(field.to_owned(), value.to_owned());
            loosened(Before::Known(&shipped), &shipped, &next).len()
        };
        assert_eq!(with("monitor.new_limit", "3"), 1, "nobody knows which way it is looser");
        assert_eq!(with("policy.arm/direct in human at authority 3", "review"), 1);
        assert_eq!(with("policy.arm/direct in human at authority 3", "allow"), 1);
        assert_eq!(with("runtime.keep_out.tray", LISTED), 0);
        assert_eq!(with("freeze.{\"from_s\":1.0}", LISTED), 0);
        // A cap where there was none.
        assert_eq!(with("policy.arm/joints in work at authority 0.speed_max_m_s", "0.1"), 0);
    }

    #[test]
    fn what_was_not_on_record_is_said_to_be_unknown() {
        let shipped = shipped(ProfileName::Real);
        let found = loosened(Before::Unknown, &shipped, &shipped);
        assert_eq!(found.len(), 1);
        assert_eq!((&*found[0].field, &*found[0].before), ("profile", "not on record"));
        assert!(told(&found).contains("not on record, 0 fields are looser than"), "{}", told(&found));
        assert_eq!(loosened(Before::Nothing, &shipped, &shipped), []);
    }

    #[test]
    fn a_change_under_real_or_human_takes_an_authorization_and_a_looser_one_always_does() {
        use ProfileName::{Human, Real, Sim};
        let rules = |text: &str| Digest::of_parts("test", &[text.as_bytes()]);
        let taken =
            |class, of: &str, is_looser| Taken { class, rules: rules(of), is_looser, scripted: false };
        let last = |class, of: &str| Some(InForce { class, rules: Some(rules(of)) });
        let needs = |last, next| needs_authorization(last, None, &next);
        for (last, next, expected) in [
            (None, taken(Sim, "a", true), false),
            (None, taken(Human, "a", false), false),
            (None, taken(Real, "a", true), true),
            (last(Sim, "a"), taken(Sim, "b", true), false),
            (last(Sim, "a"), taken(Human, "b", false), false),
            (last(Sim, "a"), taken(Human, "b", true), true),
            (last(Real, "a"), taken(Real, "a", false), false),
            (last(Real, "a"), taken(Real, "a", true), true),
            (last(Real, "a"), taken(Real, "b", false), true),
            (last(Real, "a"), taken(Human, "b", false), true),
            (last(Human, "a"), taken(Sim, "b", false), true),
            (Some(InForce { class: Human, rules: None }), taken(Human, "a", false), true),
        ] {
            assert_eq!(needs(last, next), expected, "{last:?} {next:?}");
        }
        let loose = taken(Real, "a", true);
        assert!(!needs_authorization(last(Real, "a"), Some(rules("a")), &loose), "authorized before");
        assert!(needs_authorization(last(Real, "a"), Some(rules("b")), &loose));
        // A script on a store of its own, and whoever goes on with what it left.
        let script = Taken { scripted: true, ..loose };
        assert!(!needs_authorization(last(Human, "b"), None, &script));
        assert!(needs_authorization(last(Real, "a"), None, &loose));
    }

    #[test]
    fn a_version_stays_where_no_more_is_asked_for_than_it_was_let_in_by() {
        use ProfileName::{Human, Real, Sim};
        let by = |class, scripted| LetIn { class, scripted };
        for class in ProfileName::ALL {
            for scripted in [false, true] {
                assert!(by(class, scripted).suffices(by(Sim, false)), "nobody is at risk under sim");
                assert!(!by(class, true).suffices(by(Real, false)), "a script's people are played");
                assert!(by(Human, scripted).suffices(by(class, true)));
            }
        }
        for (let_in, now, stays) in
            [(Sim, Real, false), (Sim, Human, false), (Real, Human, false), (Human, Real, true)]
        {
            assert_eq!(by(let_in, false).suffices(by(now, false)), stays, "{let_in} {now}");
            assert!(!LetIn::LEAST.suffices(by(now, true)), "{now}");
        }
    }
}
