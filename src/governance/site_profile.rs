//! Profiles that do not come with the program: a site's own numbers and policies, from texts.
//!
//! A site's profile names its class (`sim`, `real` or `human`) and itself (`site`). Candidates, approvals and rules
//! refer to the class, which decides what the profile has to require ([`profile::class_limits`](super::profile)). Its
//! own name says which numbers these are. Both texts are stored, so that a store can show its rules without the files.
//! Opens no file.

use std::borrow::Cow;

use holdpoint_body::Zone;
use serde::{Deserialize, Serialize};

use super::mode::{Authority, CommandKind, ModeKey, UnknownZone, ZoneName};
use super::policy::{ModeRuling, PolicyError, PolicyProblem, PolicySource, PolicyTable};
use super::profile::{ClassRisk, Profile, ProfileName, ReasonedNumber, SiteName};
use super::text_error::TextError;
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The profile in force.
#[derive(Clone, Debug)]
pub enum ChosenProfile {
    /// One that comes with the program.
    BuiltIn(ProfileName),
    /// A site's own.
    Own(Box<SiteProfile>),
}

impl From<ProfileName> for ChosenProfile {
    fn from(name: ProfileName) -> Self {
        Self::BuiltIn(name)
    }
}

impl ChosenProfile {
    /// The numbers and the compiled policies.
    ///
    /// # Errors
    /// If those that come with the program do not parse, which a test rules out.
    pub fn rules(&self) -> Result<(Profile, PolicyTable), SiteProfileError> {
        match self {
            Self::BuiltIn(name) => {
                let profile = Profile::builtin(*name)?;
                let table = PolicyTable::builtin(&profile)?;
                Ok((profile, table))
            }
            Self::Own(own) => Ok((own.profile.clone(), own.table.clone())),
        }
    }

    /// What two files say: a profile that comes with the program if they are its own, else a site's.
    ///
    /// # Errors
    /// As [`SiteProfile::parse`].
    pub fn of(texts: ProfileTexts) -> Result<Self, SiteProfileError> {
        let profile = Profile::parse(&texts.file, &texts.profile)?;
        let shipped = Profile::builtin(profile.name)?;
        if profile == shipped && texts.policy == Profile::builtin_policy(profile.name).1 {
            return Ok(Self::BuiltIn(profile.name));
        }
        SiteProfile::parse(texts).map(|own| Self::Own(Box::new(own)))
    }

    /// Every number with its reason, and with the number of the shipped profile of its class where that is another.
    ///
    /// # Errors
    /// As [`ChosenProfile::rules`].
    pub fn numbers(&self) -> Result<Vec<ReasonedNumber>, SiteProfileError> {
        let (profile, _) = self.rules()?;
        let (_, shipped_text) = Profile::builtin_text(profile.name);
        let text = self.texts().map_or(shipped_text, |texts| &texts.profile);
        Ok(profile.reasoned(text)?)
    }

    /// The problems of its policies, which compile.
    ///
    /// # Errors
    /// As [`ChosenProfile::rules`].
    pub fn policy_problems(&self) -> Result<Vec<PolicyProblem>, SiteProfileError> {
        let (profile, _) = self.rules()?;
        let (file, text) = match self.texts() {
            Some(texts) => (texts.policy_file.as_str(), texts.policy.as_str()),
            None => Profile::builtin_policy(profile.name),
        };
        Ok(PolicyTable::problems(&profile, &[PolicySource { file, text }])?)
    }

    /// The first zone that its policies or its keep-out list name and a cell with these zones does not have. The shipped
    /// profiles name only zones that texts may name in every cell.
    #[must_use]
    pub fn unknown_zone(&self, cell: &[Zone]) -> Option<UnknownZone> {
        let Self::Own(own) = self else { return None };
        let of_policies = own.table.modes.iter().map(|entry| &entry.mode.zone);
        let keep_out = &own.profile.runtime.keep_out;
        UnknownZone::among((own.texts.policy_file.as_str(), "resource"), of_policies, cell)
            .or_else(|| UnknownZone::among((own.texts.file.as_str(), "runtime.keep_out"), keep_out, cell))
    }

    /// The texts of a site's profile, not of a shipped one.
    #[must_use]
    pub fn texts(&self) -> Option<&ProfileTexts> {
        match self {
            Self::BuiltIn(_) => None,
            Self::Own(own) => Some(&own.texts),
        }
    }
}

/// A profile and its policies as in their files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileTexts {
    /// Name of the profile's file, for messages.
    pub file: String,
    /// The profile, TOML.
    pub profile: String,
    /// Name of the policies' file, for messages.
    pub policy_file: String,
    /// The policies, Cedar.
    pub policy: String,
}

/// A site's own profile with its policies, checked and compiled.
#[derive(Clone, Debug)]
pub struct SiteProfile {
    texts: ProfileTexts,
    profile: Profile,
    table: PolicyTable,
}

/// Invalid texts of a profile; none of their values is used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum SiteProfileError {
    /// The profile does not parse, or contradicts itself.
    #[error(transparent)]
    Profile(#[from] TextError),
    /// The policies do not compile.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A text names a zone that the cell does not have.
    #[error(transparent)]
    Zone(#[from] UnknownZone),
    /// The policies allow by themselves what the class leaves to people, or to no one.
    #[error("{file}: {mode} is allowed by {because}, which a profile of class {class} must not")]
    TooOpen { file: String, mode: String, because: String, class: ProfileName },
}

impl Hint for SiteProfileError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Profile(error) => error.details(),
            Self::Policy(error) => error.details(),
            Self::Zone(error) => error.details(),
            Self::TooOpen { file, .. } => Some(ErrorDetails::of_file(ErrorReason::BadFile, file.as_str())),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Profile(error) => error.hint(),
            Self::Policy(error) => error.hint(),
            Self::Zone(error) => error.hint(),
            Self::TooOpen { .. } => {
                Some("annotate the permit with @review, or let it name fewer zones or less authority".into())
            }
        }
    }
}

impl SiteProfile {
    /// Parses, checks and compiles.
    ///
    /// # Errors
    /// [`SiteProfileError`], the first there is: the text does not parse; a number is out of its range, contradicts
    /// another, is less strict than its class permits, or differs from the shipped profile of its class without a
    /// reason; it has no name of its own; the policies do not compile, or allow what its class must not.
    pub fn parse(texts: ProfileTexts) -> Result<Self, SiteProfileError> {
        let profile = Profile::parse(&texts.file, &texts.profile)?;
        if let Some((field, value, allowed)) = profile.own_problem(&texts.profile) {
            return Err(TextError::value(&texts.file, &texts.profile, &field, &value, &allowed).into());
        }
        Self::compile(texts, profile)
    }

    fn compile(texts: ProfileTexts, profile: Profile) -> Result<Self, SiteProfileError> {
        let source = PolicySource { file: &texts.policy_file, text: &texts.policy };
        let table = PolicyTable::compile(&profile, &[source])?;
        too_open(&profile, &table, &texts.policy_file)?;
        Ok(Self { texts, profile, table })
    }

    /// As [`SiteProfile::parse`], of texts that an earlier version of the program accepted. A newer field takes the
    /// value of the shipped profile of its class, a removed one is left out, and a number needs no reason for
    /// differing from an older shipped value. The authorizing administrator sees both.
    ///
    /// # Errors
    /// As [`SiteProfile::parse`], if that does not help.
    pub fn migrate_texts(texts: ProfileTexts) -> Result<Self, SiteProfileError> {
        let error = match Self::parse(texts.clone()) {
            Err(error @ SiteProfileError::Profile(_)) => error,
            parsed => return parsed,
        };
        let Some(text) = carried_text(&texts.profile) else { return Err(error) };
        let profile = Profile::parse(&texts.file, &text)?;
        if profile.site.is_none() || profile.weaker_than_class().is_some() {
            return Err(error);
        }
        Self::compile(texts, profile)
    }

    /// The numbers.
    #[must_use]
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The compiled policies.
    #[must_use]
    pub const fn table(&self) -> &PolicyTable {
        &self.table
    }

    /// Its own name.
    #[must_use]
    pub const fn site(&self) -> Option<&SiteName> {
        self.profile.site.as_ref()
    }
}

/// The shipped profile of a text's class with what the text says of its fields.
fn carried_text(text: &str) -> Option<String> {
    fn overlay(fields: &mut toml::Table, own: toml::Table) {
        for (name, value) in own {
            match (fields.get_mut(&name), value) {
                (Some(toml::Value::Table(fields)), toml::Value::Table(own)) => overlay(fields, own),
                (Some(field), value) if field.same_type(&value) => *field = value,
                (None, value) if ["site", "freeze"].contains(&name.as_str()) => {
                    fields.insert(name, value);
                }
                (Some(_) | None, _) => {}
            }
        }
    }
    let own: toml::Table = text.parse().ok()?;
    let class: ProfileName = own.get("name")?.as_str()?.parse().ok()?;
    let mut fields: toml::Table = Profile::builtin_text(class).1.parse().ok()?;
    overlay(&mut fields, own);
    Some(fields.to_string())
}

/// Beside a person, and where the cell is real, nothing goes past the guard; beside a person what is of high risk is
/// never allowed without one (paper: approval for higher-risk activation).
fn too_open(profile: &Profile, table: &PolicyTable, file: &str) -> Result<(), SiteProfileError> {
    let class = profile.name;
    let closed = |mode: &ModeKey| match class.declaration().risk {
        ClassRisk::Nothing => false,
        ClassRisk::Machine => mode.command == CommandKind::Direct,
        ClassRisk::People => {
            let of_high_risk = mode.zone == ZoneName::Human || mode.authority >= Authority::HIGH_RISK_FROM;
            mode.command == CommandKind::Direct || (of_high_risk && mode.command != CommandKind::Stop)
        }
    };
    let allowed = |ruling: ModeRuling| match ruling {
        ModeRuling::Allow | ModeRuling::AllowTighter(_) => true,
        ModeRuling::Review | ModeRuling::Forbid | ModeRuling::Uncovered => false,
    };
    match table.modes.iter().find(|entry| closed(&entry.mode) && allowed(entry.verdict)) {
        None => Ok(()),
        Some(entry) => Err(SiteProfileError::TooOpen {
            file: file.to_owned(),
            mode: entry.mode.to_string(),
            because: entry.because.join(", "),
            class,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HUMAN: &str = include_str!("../../profiles/human.toml");
    const POLICY: &str = include_str!("../../profiles/human.cedar");

    fn parse(profile: &str, policy: &str) -> Result<SiteProfile, SiteProfileError> {
        let texts = ProfileTexts {
            file: "line-4.toml".to_owned(),
            profile: profile.to_owned(),
            policy_file: "line-4.cedar".to_owned(),
            policy: policy.to_owned(),
        };
        SiteProfile::parse(texts)
    }

    fn line_4(from: &str, to: &str) -> String {
        assert!(HUMAN.contains(from), "{from}");
        HUMAN.replace("name = \"human\"", "name = \"human\"\nsite = \"line-4\"").replace(from, to)
    }

    #[test]
    fn site_profile_has_its_own_digest_and_a_class() {
        let own = parse(&line_4("timeout_s = 600.0 ", "timeout_s = 900.0 "), POLICY).unwrap();
        assert_eq!(own.profile().name, ProfileName::Human);
        assert_eq!(own.site().map(ToString::to_string).as_deref(), Some("line-4"));
        let shipped = Profile::builtin(ProfileName::Human).unwrap();
        assert_ne!(own.profile().digest().unwrap(), shipped.digest().unwrap());
        assert_ne!(own.table().digest, PolicyTable::builtin(&shipped).unwrap().digest);
        let numbers = ChosenProfile::Own(Box::new(own)).numbers().unwrap();
        let number = |path: &str| numbers.iter().find(|number| number.path == path).unwrap();
        assert!(number("runtime.tool_speed_max_m_s").reason.as_ref().unwrap().contains("ISO 10218"));
        assert_eq!(number("approval.timeout_s").shipped, Some(600.0));
        assert_eq!(number("approval.valid_s").shipped, None, "that one is the same");
        // Every number of a shipped profile has a reason.
        for name in ProfileName::ALL {
            let numbers = ChosenProfile::from(name).numbers().unwrap();
            assert!(numbers.len() > 50 && numbers.iter().all(|number| number.reason.is_some()), "{name}");
        }
    }

    #[test]
    fn zones_of_a_site_profile_are_compared_with_those_of_the_cell() {
        let cell =
            |name: &str| [Zone { name: name.to_owned(), min_m: [0.0; 3], max_m: [1.0; 3], keep_out: false }];
        let permit = "permit (principal, action == Action::\"stop\", resource == Zone::\"shelf\");";
        let field = |keep_out: &str, policy: &str, cell: &[Zone]| {
            let own = parse(&line_4("keep_out = [\"human\"]", keep_out), policy).unwrap();
            ChosenProfile::Own(Box::new(own)).unknown_zone(cell).map(|unknown| unknown.field)
        };
        let (shipped, shelf) = ("keep_out = [\"human\"]", format!("{POLICY}\n{permit}"));
        assert_eq!(field(shipped, POLICY, &[]), None);
        assert_eq!(field(shipped, &shelf, &cell("shelf")), None);
        assert_eq!(field(shipped, &shelf, &cell("oven")), Some("resource"));
        let oven = "keep_out = [\"human\", \"oven\"]";
        assert_eq!(field(oven, POLICY, &cell("oven")), None);
        assert_eq!(field(oven, POLICY, &cell("shelf")), Some("runtime.keep_out"));
    }

    /// A field that the program of then did not have, one that it had, and a number that was shipped then.
    #[test]
    fn profile_texts_of_an_earlier_version_are_updated() {
        let number = |line: &str| {
            let (name, _) = line.split_once('=').unwrap();
            HUMAN.lines().find(|known| known.starts_with(name)).unwrap().to_owned()
        };
        let slow = number("slow_factor = ");
        let then = line_4("retries_max = 1 ", "gone = 7\nretries_max = 0 ").replace(&slow, "");
        let then = then.replace("valid_s = 900.0 ", "valid_s = 850.0\n#");
        let texts = |profile: &str| ProfileTexts {
            file: "line-4.toml".to_owned(),
            profile: profile.to_owned(),
            policy_file: "line-4.cedar".to_owned(),
            policy: POLICY.to_owned(),
        };
        assert!(SiteProfile::parse(texts(&then)).is_err());
        let carried = SiteProfile::migrate_texts(texts(&then)).unwrap();
        let shipped = Profile::builtin(ProfileName::Human).unwrap();
        assert_eq!(carried.texts.profile, then, "the texts stay as they were");
        assert_eq!((carried.profile.runtime.retries_max, carried.profile.approval.valid_s), (0, 850.0));
        assert_eq!(carried.profile.monitor.slow_factor, shipped.monitor.slow_factor);
        assert_eq!(carried.site().map(ToString::to_string).as_deref(), Some("line-4"));
        // What this version takes is carried as it is, and what cannot be meant is still refused.
        let now = line_4("timeout_s = 600.0 ", "timeout_s = 500.0 ");
        let same = SiteProfile::parse(texts(&now)).unwrap();
        assert_eq!(SiteProfile::migrate_texts(texts(&now)).unwrap().profile, same.profile);
        assert!(
            SiteProfile::migrate_texts(texts(&now.replace("timeout_s = 500.0 ", "timeout_s = -1.0 ")))
                .is_err()
        );
        assert!(
            SiteProfile::migrate_texts(texts(&now.replace("retries_max = 1 ", "retries_max = 3 "))).is_err()
        );
    }

    #[test]
    fn shipped_profile_files_are_the_built_in_profiles() {
        let texts = |policy: &str| ProfileTexts {
            file: "human.toml".to_owned(),
            profile: HUMAN.to_owned(),
            policy_file: "human.cedar".to_owned(),
            policy: policy.to_owned(),
        };
        assert!(matches!(ChosenProfile::of(texts(POLICY)), Ok(ChosenProfile::BuiltIn(ProfileName::Human))));
        // Other policies make another profile, which needs a name.
        let error = ChosenProfile::of(texts(&POLICY.replace("0.15", "0.1"))).unwrap_err();
        let SiteProfileError::Profile(TextError::Value { field, .. }) = &error else { panic!("{error}") };
        assert_eq!(field, "site");
    }

    #[test]
    fn invalid_profile_gives_one_error_with_file_field_and_allowed_range() {
        for (from, to, field, value) in [
            ("site = \"line-4\"\n", "", "site", "none"),
            // The parser refuses these two.
            ("\"line-4\"", "\"human\"", "", "\"human\""),
            ("retries_max", "retries", "", "`retries`"),
            ("quorum_low = 1 ", "quorum_low = 0 ", "approval.quorum_low", "0"),
            ("timeout_s = 600.0 ", "timeout_s = inf ", "approval.timeout_s", "no finite number"),
            ("tool_speed_max_m_s = 0.25 ", "tool_speed_max_m_s = -1.0 ", "runtime.tool_speed_max_m_s", "-1"),
            ("tool_speed_max_m_s = 0.25 ", "tool_speed_max_m_s = 0.6 ", "runtime.tool_speed_max_m_s", "0.6"),
            ("scale = 1.0 ", "scale = 7.0 ", "thresholds.scale", "7"),
            ("sandbox_pairs = 300 ", "sandbox_pairs = 0 ", "evaluation.sandbox_pairs", "0"),
            (
                "timeout_s = 600.0                     # a shift lead is back within ten minutes; then it holds",
                "timeout_s = 500.0",
                "approval.timeout_s",
                "500",
            ),
        ] {
            let error = parse(&line_4("", "").replace(from, to), POLICY).unwrap_err();
            match &error {
                SiteProfileError::Profile(TextError::Value { file, field: named, value: shown, .. }) => {
                    let found = (file.as_str(), named.as_str(), shown.as_str());
                    assert_eq!(found, ("line-4.toml", field, value), "{error}");
                }
                SiteProfileError::Profile(TextError::Syntax { file, message, .. }) => {
                    assert_eq!((file.as_str(), ""), ("line-4.toml", field), "{error}");
                    assert!(message.contains(value), "{error}");
                }
                _ => panic!("{from}: {error}"),
            }
        }
    }

    #[test]
    fn site_policies_cannot_permit_modes_that_the_class_reserves_for_people() {
        let open = |policy: &str| parse(&line_4("", ""), &(POLICY.replace("forbid", "permit") + policy));
        let too_open = |error: SiteProfileError| match error {
            SiteProfileError::TooOpen { file, because, class, .. } => (file, because, class),
            error => panic!("{error}"),
        };
        let (file, _, class) = too_open(open("").unwrap_err());
        assert_eq!((file.as_str(), class), ("line-4.cedar", ProfileName::Human));
        let reviewed = POLICY.replace("@review(\"changes state that other skills use\")\n", "");
        let (_, because, _) = too_open(parse(&line_4("", ""), &reviewed).unwrap_err());
        assert!(because.contains("shared-state"), "{because}");
        assert!(
            parse(&line_4("", ""), "permit (principal, action, resource) when { context.size > 1 };")
                .is_err()
        );
        assert!(parse(&line_4("", ""), POLICY).is_ok());
    }
}
