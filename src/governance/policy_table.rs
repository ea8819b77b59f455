//! Policies compiled to a table: text in, one verdict for every mode out. The only file that knows Cedar.
//!
//! This is a compile step, done when a policy set is loaded: afterward the checks and the runtime guard read the table
//! and evaluate no policy. Everything fails closed: a text that does not validate is refused as a whole, a mode whose
//! evaluation errs is uncovered (Cedar itself skips an erroring `forbid`), and a permit that does not name both
//! command kind and zone covers nothing.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;

use cedar_policy::{
    ActionConstraint, Authorizer, Context, Decision, Effect, Entities, EntityId, EntityTypeName, EntityUid,
    Policy, PolicySet, PrincipalConstraint, Request, ResourceConstraint, RestrictedExpression, Schema,
    ValidationMode, Validator,
};
use serde::{Deserialize, Serialize};

use super::ids::Digest;
use super::mode::{ModeKey, ZoneName};
use super::profile::{Profile, ProfileName};
use super::submission::{Provenance, Risk};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};

/// The largest policy text, bytes; checked before it is parsed.
pub const POLICY_BYTES_MAX: usize = 64 * 1024;

/// The most policies in a set, over all files.
pub const POLICIES_MAX: usize = 256;

/// The most zones that a policy set may name, those of the shipped policies included.
const ZONES_MAX: usize = 20;

/// The names that policies may use, with the zones left out. A text with any other does not validate.
const SCHEMA: &str = r#"
entity Skill;
entity Cell;
entity Zone enum [ZONES];
action "tool-pose", "joints", "gripper", "stop", "direct" appliesTo {
    principal: [Skill],
    resource: [Zone],
    context: { channel: String, authority: Long, profile: String }
};
action "activate" appliesTo {
    principal: [Skill],
    resource: [Cell],
    context: { profile: String, risk: String, provenance: String }
};
"#;

/// A policy text with the name it has in errors.
#[derive(Clone, Copy, Debug)]
pub struct PolicySource<'a> {
    /// Name of the file, for messages and as a part of policy ids.
    pub file: &'a str,
    /// One or more Cedar policies; templates are refused.
    pub text: &'a str,
}

/// An envelope tighter than the profile's, from a policy's annotations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvelopeCap {
    /// Largest speed of the tool center point, m/s.
    pub speed_max_m_s: f64,
    /// Largest force on anything touched, N.
    pub force_max_n: f64,
}

/// The verdict of the policies on one mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "verdict")]
pub enum ModeRuling {
    /// Allowed within the profile's limits.
    Allow,
    /// Allowed within a tighter envelope.
    AllowTighter(EnvelopeCap),
    /// Allowed for a version that people have approved; denied for any other.
    Review,
    /// Denied by a `forbid` policy.
    Forbid,
    /// No policy names it, or its evaluation failed: denied.
    Uncovered,
}

/// One row of the table: a mode and its verdict.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModeEntry {
    /// Channel, command, zone and authority the row is about.
    pub mode: ModeKey,
    /// The guard's answer to a command in this mode.
    pub verdict: ModeRuling,
    /// The policies that made it, by id; or the evaluation's error.
    pub because: Vec<String>,
}

/// The verdict of site policies on one kind of activation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActivationTerms {
    /// Risk tier of the versions the row is about.
    pub risk: Risk,
    /// How the versions the row is about came about.
    pub provenance: Provenance,
    /// A policy forbids it, or its evaluation failed.
    pub forbidden: bool,
    /// A permit with `@review` requires approval, also where the profile requires none.
    #[serde(default)]
    pub review: bool,
    /// The policies that made it, by id; or the evaluation's error.
    pub because: Vec<String>,
}

/// A policy set compiled for one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyTable {
    /// SHA-256 over the texts, the schema and the profile.
    pub digest: Digest,
    /// The profile it was compiled for; it applies to no other.
    pub profile: ProfileName,
    /// A ruling for every mode in the zones that the shipped policies or these policies name, sorted by mode. In any other
    /// zone every mode is uncovered.
    pub modes: Vec<ModeEntry>,
    /// A row for every pair of risk tier and provenance, sorted.
    pub activations: Vec<ActivationTerms>,
}

/// What is wrong with policies that compile. The texts are foreign.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "problem", rename_all = "kebab-case")]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum PolicyProblem {
    /// A policy cannot be evaluated for a mode or an activation, which is denied therefore.
    Errs { error: String },
    /// No ruling follows from the policy, named by its `@id` or Cedar's id: it names no command and zone, its
    /// condition is never met, or others override it everywhere.
    CoversNothing { policy: String },
}

/// A policy text that was refused; no table exists.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum PolicyError {
    /// More than 64 KiB of text in a file, or more than 256 policies or 20 zones in the set.
    #[error("{file}: {found} are too many; up to {allowed} are allowed")]
    TooMany { file: String, found: String, allowed: String },
    /// Cedar's parser does not accept the text.
    #[error("{file}: {message}")]
    Syntax { file: String, message: String },
    /// A name that does not exist, a type that does not fit, or a form this table has no place for.
    #[error("{file}: the policy {policy:?}: {message}")]
    Policy { file: String, policy: String, message: String, hint: &'static str },
    /// The program's own schema or a request could not be built.
    #[error("the policy vocabulary could not be built: {0}")]
    Vocabulary(String),
}

impl Hint for PolicyError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::TooMany { file, .. } | Self::Syntax { file, .. } | Self::Policy { file, .. } => {
                ErrorDetails::of_file(ErrorReason::BadFile, file.as_str())
            }
            Self::Vocabulary(_) => ErrorReason::Internal.into(),
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Policy { hint, .. } => Some((*hint).into()),
            Self::TooMany { .. } | Self::Syntax { .. } | Self::Vocabulary(_) => None,
        }
    }
}

impl PolicyTable {
    /// Compiles policy texts for a profile.
    ///
    /// # Errors
    /// [`PolicyError`]: a text too large, not Cedar, naming what does not exist, constraining the principal
    /// (it would silently never apply) or using an annotation other than `id`, `reason`, `review`,
    /// `speed_max_m_s` and `force_max_n`.
    pub fn compile(profile: &Profile, sources: &[PolicySource<'_>]) -> Result<Self, PolicyError> {
        let vocabulary = |e: &dyn std::fmt::Display| PolicyError::Vocabulary(e.to_string());
        let judge = CedarEvaluator::load(profile, sources)?;
        let modes = ModeKey::all(&judge.zones).into_iter().map(|mode| judge.mode(mode));
        let modes = modes.collect::<Result<_, _>>()?;
        let mut activations = Vec::new();
        for risk in Risk::ALL {
            for provenance in Provenance::ALL {
                activations.push(judge.activation(risk, provenance)?);
            }
        }
        let profile_digest = profile.digest().map_err(|e| vocabulary(&e))?;
        let schema = schema_text(&judge.zones);
        let mut parts: Vec<&[u8]> = vec![schema.as_bytes(), profile_digest.bytes()];
        parts.extend(sources.iter().map(|source| source.text.as_bytes()));
        let digest = Digest::of_parts("holdpoint.policy.v1", &parts);
        Ok(Self { digest, profile: profile.name, modes, activations })
    }

    /// The problems of policies that compile: errors first, then policies without effect.
    ///
    /// # Errors
    /// As [`PolicyTable::compile`].
    pub fn problems(
        profile: &Profile,
        sources: &[PolicySource<'_>],
    ) -> Result<Vec<PolicyProblem>, PolicyError> {
        let judge = CedarEvaluator::load(profile, sources)?;
        let (mut errors, mut effective) = (BTreeSet::new(), BTreeSet::new());
        for mode in ModeKey::all(&judge.zones) {
            let CedarDecision { allowed, rules, error } = judge.decide_mode(mode)?;
            let deciding = rules.into_iter().filter(|rule| !allowed || rule.names_mode);
            effective.extend(deciding.map(|rule| &*rule.name));
            errors.extend(error);
        }
        for risk in Risk::ALL {
            for provenance in Provenance::ALL {
                let CedarDecision { rules, error, .. } = judge.decide_activation(risk, provenance)?;
                let deciding = rules.into_iter().filter(|rule| rule.review || rule.effect == Effect::Forbid);
                effective.extend(deciding.map(|rule| &*rule.name));
                errors.extend(error);
            }
        }
        let all: BTreeSet<&str> = judge.rules.values().map(|rule| &*rule.name).collect();
        let without_effect = all.difference(&effective).map(|policy| (*policy).to_owned());
        let without_effect = without_effect.map(|policy| PolicyProblem::CoversNothing { policy });
        let errors = errors.into_iter().map(|error| PolicyProblem::Errs { error });
        Ok(errors.chain(without_effect).collect())
    }

    /// Compiles the policies that come with the program.
    ///
    /// # Errors
    /// As [`PolicyTable::compile`]; a test compiles all three.
    pub fn builtin(profile: &Profile) -> Result<Self, PolicyError> {
        let (file, text) = Profile::builtin_policy(profile.name);
        Self::compile(profile, &[PolicySource { file, text }])
    }

    /// The verdict of a mode; one outside the table is uncovered.
    #[must_use]
    pub fn verdict(&self, mode: &ModeKey) -> ModeRuling {
        self.entry(mode).map_or(ModeRuling::Uncovered, |entry| entry.verdict)
    }

    /// The row of a mode; `None` is read as uncovered.
    #[must_use]
    pub fn entry(&self, mode: &ModeKey) -> Option<&ModeEntry> {
        // The rows are sorted; in a table that is not, a mode is not found and so denied.
        self.modes.binary_search_by(|entry| entry.mode.cmp(mode)).ok().and_then(|index| self.modes.get(index))
    }

    /// Whether a site policy requires approval of an activation that the profile may leave without, and which.
    #[must_use]
    pub fn activation_reviewed(&self, risk: Risk, provenance: Provenance) -> Option<&[String]> {
        let row = self.activations.iter().find(|row| row.risk == risk && row.provenance == provenance)?;
        row.review.then_some(&*row.because)
    }

    /// Whether a site policy forbids an activation, and which; one outside the table is forbidden.
    #[must_use]
    pub fn activation_forbidden(&self, risk: Risk, provenance: Provenance) -> Option<Vec<String>> {
        match self.activations.iter().find(|entry| entry.risk == risk && entry.provenance == provenance) {
            Some(entry) => entry.forbidden.then(|| entry.because.clone()),
            None => Some(vec!["no entry for this kind of activation".into()]),
        }
    }
}

/// What the table needs of one policy beside Cedar's own judgment.
struct PolicyRule {
    name: String,
    effect: Effect,
    names_mode: bool,
    review: bool,
    speed_max_m_s: Option<f64>,
    force_max_n: Option<f64>,
}

/// The schema with these zones.
fn schema_text(zones: &BTreeSet<ZoneName>) -> String {
    let names: Vec<String> = zones.iter().map(|zone| format!("\"{}\"", zone.name())).collect();
    SCHEMA.replace("ZONES", &names.join(", "))
}

fn too_many(source: &PolicySource<'_>, found: String, allowed: usize) -> PolicyError {
    PolicyError::TooMany { file: source.file.to_owned(), found, allowed: allowed.to_string() }
}

fn refuse(source: &PolicySource<'_>, policy: &str, message: String, hint: &'static str) -> PolicyError {
    PolicyError::Policy { file: source.file.to_owned(), policy: policy.to_owned(), message, hint }
}

fn parse(source: &PolicySource<'_>) -> Result<PolicySet, PolicyError> {
    if source.text.len() > POLICY_BYTES_MAX {
        return Err(too_many(source, format!("{} bytes", source.text.len()), POLICY_BYTES_MAX));
    }
    let parsed = PolicySet::from_str(source.text)
        .map_err(|e| PolicyError::Syntax { file: source.file.to_owned(), message: e.to_string() })?;
    if parsed.templates().next().is_some() {
        let message = "templates have no place here".into();
        return Err(refuse(source, "template", message, "write out each policy"));
    }
    Ok(parsed)
}

/// Adds the zones that policies name. The caller compares them with those of a cell. A name that no zone can have is left
/// out, so the policy does not validate.
fn add_zones(
    source: &PolicySource<'_>,
    parsed: &PolicySet,
    zones: &mut BTreeSet<ZoneName>,
) -> Result<(), PolicyError> {
    for policy in parsed.policies() {
        let named = policy.entity_literals();
        let named = named.iter().filter(|entity| entity.type_name().to_string() == "Zone");
        zones.extend(named.filter_map(|zone| ZoneName::try_from(zone.id().unescaped()).ok()));
    }
    if zones.len() > ZONES_MAX {
        return Err(too_many(source, format!("{} zones", zones.len()), ZONES_MAX));
    }
    Ok(())
}

fn load(
    source: &PolicySource<'_>,
    parsed: &PolicySet,
    schema: &Schema,
    set: &mut PolicySet,
    rules: &mut BTreeMap<String, PolicyRule>,
) -> Result<(), PolicyError> {
    let validation = Validator::new(schema.clone()).validate(parsed, ValidationMode::Strict);
    if let Some(error) = validation.validation_errors().next() {
        let hint = "commands are tool-pose, joints, gripper, stop, direct and activate; zones are work, tray, \
                    transit, human and those of the cell; context has channel, authority, profile (activate: profile, \
                    risk, provenance)";
        return Err(refuse(source, error.policy_id().as_ref(), error.to_string(), hint));
    }
    for policy in parsed.policies() {
        if rules.len() >= POLICIES_MAX {
            return Err(too_many(source, "policies".into(), POLICIES_MAX));
        }
        let rule =
            rule(policy).map_err(|(message, hint)| refuse(source, policy.id().as_ref(), message, hint))?;
        let id = format!("{}#{}", source.file, policy.id());
        let renamed = policy.new_id(cedar_policy::PolicyId::new(&id));
        let name = rule.name.clone();
        set.add(renamed).map_err(|e| refuse(source, &name, e.to_string(), "give each file its own name"))?;
        rules.insert(id, rule);
    }
    Ok(())
}

fn rule(policy: &Policy) -> Result<PolicyRule, (String, &'static str)> {
    if policy.principal_constraint() != PrincipalConstraint::Any {
        return Err((
            "it constrains the principal".into(),
            "write `principal` alone: a mode is judged for every skill",
        ));
    }
    let number = |text: &str, key: &str| match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        Ok(_) | Err(_) => {
            Err((format!("@{key}({text:?}) is no number above 0"), "write e.g. @speed_max_m_s(\"0.25\")"))
        }
    };
    let mut rule = PolicyRule {
        name: policy.id().to_string(),
        effect: policy.effect(),
        names_mode: matches!(policy.action_constraint(), ActionConstraint::Eq(_) | ActionConstraint::In(_))
            && matches!(policy.resource_constraint(), ResourceConstraint::Eq(_)),
        review: false,
        speed_max_m_s: None,
        force_max_n: None,
    };
    for (key, value) in policy.annotations() {
        match key {
            "id" => value.clone_into(&mut rule.name),
            "reason" => {}
            "review" => rule.review = true,
            "speed_max_m_s" => rule.speed_max_m_s = Some(number(value, key)?),
            "force_max_n" => rule.force_max_n = Some(number(value, key)?),
            _ => {
                let hint = "annotations are id, reason, review, speed_max_m_s and force_max_n";
                return Err((format!("the annotation @{key} does not exist"), hint));
            }
        }
    }
    let limits = rule.review || rule.speed_max_m_s.is_some() || rule.force_max_n.is_some();
    if rule.effect == Effect::Forbid && limits {
        return Err(("a forbid carries a limit or a review".into(), "limits and reviews belong to a permit"));
    }
    Ok(rule)
}

struct CedarEvaluator<'a> {
    authorizer: Authorizer,
    set: PolicySet,
    rules: BTreeMap<String, PolicyRule>,
    profile: &'a Profile,
    /// The zones that the shipped policies name, and those that these policies name.
    zones: BTreeSet<ZoneName>,
}

/// Cedar's response: its decision, the determining policies, and an error if there was any.
struct CedarDecision<'r> {
    allowed: bool,
    rules: Vec<&'r PolicyRule>,
    error: Option<String>,
}

impl<'a> CedarEvaluator<'a> {
    fn load(profile: &'a Profile, sources: &[PolicySource<'_>]) -> Result<Self, PolicyError> {
        let parsed = sources.iter().map(parse).collect::<Result<Vec<PolicySet>, _>>()?;
        let mut zones = BTreeSet::from(ZoneName::SHIPPED);
        for (source, parsed) in sources.iter().zip(&parsed) {
            add_zones(source, parsed, &mut zones)?;
        }
        let schema = schema_text(&zones);
        let schema = Schema::from_cedarschema_str(&schema);
        let (schema, _) = schema.map_err(|e| PolicyError::Vocabulary(e.to_string()))?;
        let mut set = PolicySet::new();
        let mut rules = BTreeMap::new();
        for (source, parsed) in sources.iter().zip(&parsed) {
            load(source, parsed, &schema, &mut set, &mut rules)?;
        }
        Ok(Self { authorizer: Authorizer::new(), set, rules, profile, zones })
    }
}

impl CedarEvaluator<'_> {
    fn authorize(
        &self,
        action: &str,
        resource: (&str, &str),
        context: Vec<(&str, RestrictedExpression)>,
    ) -> Result<CedarDecision<'_>, PolicyError> {
        let vocabulary = |e: &dyn std::fmt::Display| PolicyError::Vocabulary(e.to_string());
        let uid = |kind: &str, id: &str| {
            let kind = EntityTypeName::from_str(kind).map_err(|e| vocabulary(&e))?;
            Ok::<_, PolicyError>(EntityUid::from_type_name_and_id(kind, EntityId::new(id)))
        };
        let pairs = context.into_iter().map(|(key, value)| (key.to_owned(), value));
        let context = Context::from_pairs(pairs).map_err(|e| vocabulary(&e))?;
        let request = Request::new(
            uid("Skill", "any")?,
            uid("Action", action)?,
            uid(resource.0, resource.1)?,
            context,
            None,
        )
        .map_err(|e| vocabulary(&e))?;
        let response = self.authorizer.is_authorized(&request, &self.set, &Entities::empty());
        let diagnostics = response.diagnostics();
        let mut rules: Vec<&PolicyRule> =
            diagnostics.reason().filter_map(|id| self.rules.get(AsRef::<str>::as_ref(id))).collect();
        rules.sort_by(|a, b| a.name.cmp(&b.name));
        let error = diagnostics.errors().map(ToString::to_string).min();
        Ok(CedarDecision { allowed: response.decision() == Decision::Allow, rules, error })
    }

    fn decide_mode(&self, mode: ModeKey) -> Result<CedarDecision<'_>, PolicyError> {
        let text = |text: &str| RestrictedExpression::new_string(text.to_owned());
        let context = vec![
            ("channel", text(mode.channel.name())),
            ("authority", RestrictedExpression::new_long(i64::from(mode.authority.level()))),
            ("profile", text(self.profile.name.name())),
        ];
        self.authorize(mode.command.name(), ("Zone", mode.zone.name()), context)
    }

    fn mode(&self, mode: ModeKey) -> Result<ModeEntry, PolicyError> {
        let decision = self.decide_mode(mode)?;
        let names: Vec<String> = decision.rules.iter().map(|rule| rule.name.clone()).collect();
        if let Some(error) = decision.error {
            return Ok(ModeEntry { mode, verdict: ModeRuling::Uncovered, because: vec![error] });
        }
        if !decision.allowed {
            let verdict = if names.is_empty() { ModeRuling::Uncovered } else { ModeRuling::Forbid };
            return Ok(ModeEntry { mode, verdict, because: names });
        }
        let naming: Vec<&PolicyRule> = decision.rules.into_iter().filter(|rule| rule.names_mode).collect();
        let because = naming.iter().map(|rule| rule.name.clone()).collect();
        Ok(ModeEntry { mode, verdict: self.permitted(&naming), because })
    }

    /// Of several permits the most restrictive applies.
    fn permitted(&self, naming: &[&PolicyRule]) -> ModeRuling {
        if naming.is_empty() {
            return ModeRuling::Uncovered;
        }
        if naming.iter().any(|rule| rule.review) {
            return ModeRuling::Review;
        }
        let limits = &self.profile.runtime;
        let least = |caps: &mut dyn Iterator<Item = f64>, limit: f64| caps.fold(limit, f64::min);
        let speed =
            least(&mut naming.iter().filter_map(|rule| rule.speed_max_m_s), limits.tool_speed_max_m_s);
        let force = least(&mut naming.iter().filter_map(|rule| rule.force_max_n), limits.contact_force_max_n);
        if speed < limits.tool_speed_max_m_s || force < limits.contact_force_max_n {
            return ModeRuling::AllowTighter(EnvelopeCap { speed_max_m_s: speed, force_max_n: force });
        }
        ModeRuling::Allow
    }

    fn decide_activation(
        &self,
        risk: Risk,
        provenance: Provenance,
    ) -> Result<CedarDecision<'_>, PolicyError> {
        let text = |text: &str| RestrictedExpression::new_string(text.to_owned());
        let context = vec![
            ("profile", text(self.profile.name.name())),
            ("risk", text(risk.name())),
            ("provenance", text(provenance.name())),
        ];
        self.authorize("activate", ("Cell", "cell"), context)
    }

    fn activation(&self, risk: Risk, provenance: Provenance) -> Result<ActivationTerms, PolicyError> {
        let decision = self.decide_activation(risk, provenance)?;
        let forbids: Vec<String> = decision
            .rules
            .iter()
            .filter(|rule| rule.effect == Effect::Forbid)
            .map(|rule| rule.name.clone())
            .collect();
        let forbidden = decision.error.is_some() || !forbids.is_empty();
        let reviews: Vec<String> =
            decision.rules.iter().filter(|rule| rule.review).map(|rule| rule.name.clone()).collect();
        let review = !forbidden && !reviews.is_empty();
        let because = decision.error.map_or(if review { reviews } else { forbids }, |error| vec![error]);
        Ok(ActivationTerms { risk, provenance, forbidden, review, because })
    }
}
