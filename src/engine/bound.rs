//! What a store is for: the robot it was made with, and the agent whose capabilities it holds.
//!
//! Both are on record in the store's context. Another robot is refused before anything is written, with the way out;
//! another agent holds.

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::LifecycleEvent;
use holdpoint_governance::loosened::{Rules, told};
use holdpoint_governance::omitted::Omitted;
use holdpoint_governance::own_profile::ProfileTexts;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, titled};
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{AuditBody, Change, ContextRules, ProfileCourse, StoreError, Views};
use holdpoint_text::Hint as _;

use crate::bound_robot::BoundRobot;
use crate::cell::COMPUTED_BY;
use crate::context::{Context, ContextRecord};
use crate::fault::Fault;
use crate::ledger::{Ledger, Note};

/// The agent a store is for beside the one that dispatches.
#[derive(Clone, Copy, Debug)]
pub struct BoundAgent {
    /// Hash of the identity on record.
    pub recorded: Digest,
    /// Hash of the identity of the agent at work.
    pub present: Digest,
}

impl BoundAgent {
    /// Whether they are the same.
    #[must_use]
    pub fn is_same(&self) -> bool {
        self.recorded == self.present
    }

    /// Nothing becomes active under another agent.
    ///
    /// # Errors
    /// If it is another one, which makes the engine hold.
    pub(crate) fn check(&self) -> Result<(), Fault> {
        if self.is_same() {
            return Ok(());
        }
        Err(Fault::Impossible(format!(
            "the agent is not the one this store is for: its identity is {}, {} is on record; use the program that \
             made the store, or another store",
            self.present.short(),
            self.recorded.short()
        )))
    }
}

/// What a store says it was judged under; absent if nobody has started on it. A record that cannot be read is an error:
/// whatever it names must not be bound anew.
///
/// # Errors
/// If the store or the record cannot be read.
pub fn context_record(views: &Views) -> Result<Option<ContextRecord>, StoreError> {
    let Some((_, _, json)) = views.context()? else { return Ok(None) };
    let read = serde_json::from_str(&json).map_err(|error| StoreError::Invalid {
        what: "the store's context record",
        value: json.chars().take(SHOWN_CHARS).collect(),
        allowed: format!(
            "JSON with profile and policy, as an engine writes it ({error}); restore the store from a copy"
        ),
    });
    read.map(Some)
}

/// The most characters of an unreadable record that an error repeats.
const SHOWN_CHARS: usize = 80;

/// The robot that a store is for; absent if nobody has started on it, or an earlier version did.
///
/// # Errors
/// If the store cannot be read.
pub fn robot(views: &Views) -> Result<Option<BoundRobot>, StoreError> {
    Ok(context_record(views)?.and_then(|context| context.robot))
}

/// No active pointer was set with another robot, whatever the context says.
///
/// # Errors
/// [`StoreError::OtherRobot`], or if the store cannot be read.
pub(crate) fn check_pointers(views: &Views, given: &BoundRobot) -> Result<(), StoreError> {
    match views.pointer_robots()?.into_iter().find(|(_, robot)| *robot != given.digest) {
        Some((family, recorded)) => {
            Err(StoreError::OtherRobot { family, recorded, given: given.to_string() })
        }
        None => Ok(()),
    }
}

/// The agent that a store is for; absent as for [`robot`].
pub(crate) fn agent(views: &Views) -> Result<Option<Digest>, StoreError> {
    Ok(context_record(views)?.and_then(|context| context.agent))
}

/// What was left out in a store; absent as for [`robot`].
pub(crate) fn left_out(views: &Views) -> Result<Option<Omitted>, StoreError> {
    Ok(context_record(views)?.map(|context| context.omitted))
}

/// The seed of a run, as a store keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RunSeed {
    /// A script has its own.
    OfScript,
    /// The same in every life of an engine on the store.
    OfStore(u64),
}

impl RunSeed {
    const fn of_life(self) -> Option<u64> {
        match self {
            Self::OfScript => None,
            Self::OfStore(seed) => Some(seed),
        }
    }

    /// Whoever could choose the seed of each life would try candidates under one after another.
    ///
    /// # Errors
    /// [`StoreError::Invalid`] if the store has another one.
    pub(crate) fn check(self, recorded: Option<u64>) -> Result<(), StoreError> {
        match (self.of_life(), recorded) {
            (Some(asked), Some(recorded)) if asked != recorded => Err(StoreError::Invalid {
                what: "--seed",
                value: asked.to_string(),
                allowed: format!("{recorded}, with which this store was begun: start without --seed"),
            }),
            _ => Ok(()),
        }
    }
}

/// The seed that a store was begun with; absent if nobody but a script has started on it, or an earlier version did.
///
/// # Errors
/// If the store cannot be read.
pub fn seed(views: &Views) -> Result<Option<u64>, StoreError> {
    Ok(context_record(views)?.and_then(|context| context.seed))
}

/// What was voided at a start.
pub(crate) struct VoidedNow {
    pub(crate) families: Vec<Family>,
    /// What changed, one sentence.
    pub(crate) reason: String,
}

/// What is another now than in a store's last context, in a sentence.
fn what_changed(before: &ContextRecord, context: &Context) -> String {
    let another_build = before.computed_by != COMPUTED_BY;
    let another_robot = before.robot.as_ref().is_some_and(|robot| !robot.is(&BoundRobot::of(&context.cell)));
    // The environment is the digest of robot, scene and build together.
    let environment = before.environment != Some(context.cell.digest());
    let own_policies = before.policy != context.table.digest && before.profile == context.profile_digest;
    let all = [
        (before.profile != context.profile_digest, "the profile"),
        (own_policies, "the policies"),
        (another_robot, "the robot"),
        (another_build, "the build that computes evidence"),
        (environment && !another_build && !another_robot, "the scene"),
    ];
    let changed: Vec<&str> = all.into_iter().filter_map(|(differs, what)| differs.then_some(what)).collect();
    if changed.is_empty() {
        return "what evidence is bound to changed; what was gathered before is void".to_owned();
    }
    format!("another than before: {}; what was gathered under the former is void", changed.join(", "))
}

/// How a store is used from now on.
pub(crate) enum ContextSet {
    /// Under a context that is on record; with what was voided for it, if there was anything before.
    InForce(Option<VoidedNow>),
    /// No administrator authorized the profile as this program has it, and why they have to: nothing is written.
    Unauthorized(String),
}

/// A profile that a store is to be used under.
#[derive(Clone, Copy, Debug)]
pub struct AskedRules<'a> {
    pub profile: &'a Profile,
    pub table: &'a PolicyTable,
    /// The texts of a profile that does not come with the program.
    pub own: Option<&'a ProfileTexts>,
    /// Whether a script asks.
    pub scripted: bool,
}

/// How a store may be used under a profile.
#[derive(Debug)]
pub enum Begin {
    /// Under these rules.
    Authorized(ContextRules),
    /// It comes up and activates nothing, and why: the profile is the one on record, and another one by this program.
    Unauthorized(String),
}

/// Whether a store may be used under a profile next. `last` is the last record of its chain.
///
/// # Errors
/// [`StoreError::UnauthorizedProfile`] where it takes an administrator's authorization and has none; another one where what comes
/// with the program does not parse.
pub fn may_begin(
    course: &ProfileCourse,
    (before, last): (Option<&ContextRecord>, u64),
    asked: AskedRules<'_>,
) -> Result<Begin, StoreError> {
    let AskedRules { profile, table, own, scripted } = asked;
    if scripted && course.was_live() {
        return Err(StoreError::ScriptAfterLive);
    }
    let class = profile.name;
    let rules = Rules::of(profile, table).map_err(|error| StoreError::Invalid {
        what: "profile",
        value: class.to_string(),
        allowed: error.sentence(),
    })?;
    let rules = course.next(&rules, scripted);
    let Err(problem) = course.check(last.saturating_add(1), class, &rules) else {
        return Ok(Begin::Authorized(rules));
    };
    let is_as_on_record = course.last().is_some_and(|last| last.class == class)
        && before.is_some_and(|before| before.own.as_ref() == own);
    if scripted || !is_as_on_record {
        let named = own.map_or_else(|| class.name().to_owned(), |texts| texts.file.clone());
        return Err(StoreError::UnauthorizedProfile { named, problem });
    }
    let told = told(&rules.loosened);
    Ok(Begin::Unauthorized(format!(
        "no administrator authorized the profile {} as this program has it ({told}); nothing becomes active and the arm stands \
         until one signs: end the engine, `holdpoint profile allow --by ADMIN --reason TEXT`, and start it again",
        titled(class, profile.site.as_ref())
    )))
}

/// Sets profile, policies and build in the store if they changed; what was gathered under others is void. Tells what
/// was voided, if there was anything before.
pub(crate) fn set_context(
    context: &Context,
    ledger: &mut Ledger,
    agent: Digest,
    (at_ms, seed): (u64, RunSeed),
) -> Result<ContextSet, Fault> {
    let name = context.profile.name;
    let views = ledger.store().views()?;
    let known = views.context()?;
    let before = context_record(&views)?;
    let end = views.head()?.seq;
    drop(views);
    let course = &ledger.store().opening().profiles;
    let scripted = matches!(seed, RunSeed::OfScript);
    let asked =
        AskedRules { profile: &context.profile, table: &context.table, own: context.own.as_ref(), scripted };
    let rules = match may_begin(course, (before.as_ref(), end), asked)? {
        Begin::Authorized(rules) => rules,
        Begin::Unauthorized(why) => return Ok(ContextSet::Unauthorized(why)),
    };
    let recorded = before.as_ref().and_then(|before| before.seed);
    // From a script it goes over to somebody else, whose seed the store keeps from then on.
    let left_by_a_script = course.scripted() && !scripted;
    let same = known.is_some_and(|(profile, policy, _)| profile == name && policy == context.digest);
    let on_record = course.last().and_then(|last| last.rules);
    if same && on_record == Some(rules.digest) && !left_by_a_script {
        return Ok(ContextSet::InForce(None));
    }
    let voids = !same || on_record.is_some_and(|digest| digest != rules.digest);
    let reason = before.as_ref().map_or_else(
        || "a profile, policies and a robot are in force for the first time".to_owned(),
        |before| what_changed(before, context),
    );
    let json = serde_json::to_string(&ContextRecord {
        agent: Some(agent),
        computed_by: COMPUTED_BY.to_owned(),
        environment: Some(context.cell.digest()),
        omitted: context.omitted,
        own: context.own.clone(),
        policy: context.table.digest,
        profile: context.profile_digest,
        robot: Some(BoundRobot::of(&context.cell)),
        seed: recorded.or(seed.of_life()),
        site: context.profile.site.clone(),
    })?;
    // The context is the present one alone; what was in force before is read in the chain.
    let loaded = context.profile.site.as_ref().map(|site| AuditBody {
        kind: RecordKind::ProfileLoaded,
        subject: site.to_string(),
        body: json.clone(),
    });
    let rules = Some(Box::new(rules));
    let change = Change::SetContext { profile: name, policy_digest: context.digest, json, rules };
    ledger.write(vec![change], loaded.into_iter().collect(), at_ms)?;
    if !voids {
        return Ok(ContextSet::InForce(None));
    }
    let families: Vec<Family> = ledger.families().map(|(family, _)| family.clone()).collect();
    for family in &families {
        let event = LifecycleEvent::ContextChanged { needs_approval: context.needs_approval() };
        ledger.transition(family, event, at_ms, Note::because(reason.clone()))?;
    }
    let voided = before.is_some() && !families.is_empty();
    Ok(ContextSet::InForce(voided.then_some(VoidedNow { families, reason })))
}

#[cfg(test)]
mod tests;
