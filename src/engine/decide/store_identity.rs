//! The identity of a store: its robot, its site file, and the agent whose capabilities it contains.
//!
//! They are in the store's context record. Another robot is refused before anything is written, with a hint; another agent
//! halts the engine; another site voids the evidence.

use holdpoint_audit::profile_history::{ContextRules, ProfileHistory};
use holdpoint_governance::ablation::AblatedParts;
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::notice::{BoundPart, Notice};
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::profile_downgrade::{DowngradeExtent, ProfileRules};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::site_profile::ProfileTexts;
use holdpoint_store::{AuditBody, Change, RecordViews, StoreError};
use holdpoint_text::Hint as _;
use holdpoint_trials::site::StoreSite;

use crate::fault::EngineFault;
use holdpoint_record::context::{Context, ContextRecord};
use holdpoint_record::store_robot::StoreRobot;
use holdpoint_record::version_table::{TransitionNote, VersionTable};

/// The recorded agent of a store, and the present one.
#[derive(Clone, Copy, Debug)]
pub struct StoreAgent {
    /// Hash of the identity on record.
    pub recorded: Digest,
    /// Hash of the present agent's identity.
    pub present: Digest,
}

impl StoreAgent {
    /// Whether they are the same.
    #[must_use]
    pub fn is_same(&self) -> bool {
        self.recorded == self.present
    }

    /// Refuses activations under another agent.
    ///
    /// # Errors
    /// If it is another agent, which halts the engine.
    pub(crate) fn check(&self) -> Result<(), EngineFault> {
        if self.is_same() {
            return Ok(());
        }
        Err(EngineFault::Impossible(format!(
            "the agent is not the one this store is for: its identity is {}, {} is on record; use the program that \
             made the store, or another store",
            self.present.short(),
            self.recorded.short()
        )))
    }
}

/// A store's context record; absent if no engine has started on it. An unreadable record is an error: its content must not be
/// replaced.
///
/// # Errors
/// If the store or the record cannot be read.
pub fn context_record(views: &dyn RecordViews) -> Result<Option<ContextRecord>, StoreError> {
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

/// The most characters of an unreadable record that an error quotes.
const SHOWN_CHARS: usize = 80;

/// The robot of a store; absent if no engine has started on it, or only one of an earlier version.
///
/// # Errors
/// If the store cannot be read.
pub fn robot(views: &dyn RecordViews) -> Result<Option<StoreRobot>, StoreError> {
    Ok(context_record(views)?.and_then(|context| context.robot))
}

/// The site file of a store; absent for the built-in site, and as for [`robot`].
///
/// # Errors
/// If the store cannot be read.
pub fn site(views: &dyn RecordViews) -> Result<Option<StoreSite>, StoreError> {
    Ok(context_record(views)?.and_then(|context| context.site_file))
}

/// Checks that no active pointer was set with another robot, whatever the context record contains.
///
/// # Errors
/// [`StoreError::OtherRobot`], or if the store cannot be read.
pub(crate) fn check_pointers(views: &dyn RecordViews, given: &StoreRobot) -> Result<(), StoreError> {
    match views.pointer_robots()?.into_iter().find(|(_, robot)| *robot != given.digest) {
        Some((family, recorded)) => {
            Err(StoreError::OtherRobot { family, recorded, given: given.to_string() })
        }
        None => Ok(()),
    }
}

/// The agent of a store; absent as for [`robot`].
///
/// # Errors
/// If the store cannot be read.
pub fn agent(views: &dyn RecordViews) -> Result<Option<Digest>, StoreError> {
    Ok(context_record(views)?.and_then(|context| context.agent))
}

/// The parts omitted in a store; absent as for [`robot`].
pub(crate) fn omitted(views: &dyn RecordViews) -> Result<Option<AblatedParts>, StoreError> {
    Ok(context_record(views)?.map(|context| context.omitted))
}

/// The families voided at a start.
pub(crate) struct VoidedFamilies {
    pub(crate) families: Vec<Family>,
    /// The change, as a sentence.
    pub(crate) reason: Notice,
}

/// The differences from a store's last context, as a sentence.
fn what_changed(before: &ContextRecord, context: &Context) -> Notice {
    let another_build = before.computed_by != context.cell.computed_by();
    let another_robot = before.robot.as_ref().is_some_and(|robot| !robot.is(&StoreRobot::of(&context.cell)));
    let on_record = context.cell.site.as_ref().and_then(|site| site.on_record());
    let another_site = before.site_file.as_ref().map(|site| site.digest) != on_record.map(|site| site.digest);
    // The environment is the digest of robot, scene, site and build together.
    let environment = before.environment != Some(context.cell.digest());
    let own_policies = before.policy != context.table.digest && before.profile == context.profile_digest;
    let all = [
        (before.profile != context.profile_digest, BoundPart::Profile),
        (own_policies, BoundPart::Policies),
        (another_robot, BoundPart::Robot),
        (another_site, BoundPart::Site),
        (another_build, BoundPart::Build),
        (environment && !another_build && !another_robot && !another_site, BoundPart::Scene),
    ];
    let parts = all.into_iter().filter_map(|(differs, part)| differs.then_some(part)).collect();
    Notice::BindingChanged { parts }
}

/// How a store is used from now on.
pub(crate) enum StoreUse {
    /// Under a context that is on record; with the families voided for it, if there was an earlier one.
    InForce(Option<VoidedFamilies>),
    /// No administrator authorized the profile in its present form, and why one must: nothing is written.
    Unauthorized(Notice),
}

/// The profile requested for a store.
#[derive(Clone, Copy, Debug)]
pub struct RequestedRules<'a> {
    pub profile: &'a Profile,
    pub table: &'a PolicyTable,
    /// The texts of a custom profile.
    pub own: Option<&'a ProfileTexts>,
    /// Whether a script requests it.
    pub scripted: bool,
}

/// Whether a store may be used under a profile.
#[derive(Debug)]
pub enum StartPermission {
    /// Under these rules.
    Authorized(ContextRules),
    /// The engine starts but activates nothing; the reason: this program has another form of the recorded profile.
    Unauthorized(Notice),
}

/// Whether a store may be used under a profile next. `last` is the last record of its chain.
///
/// # Errors
/// [`StoreError::UnauthorizedProfile`] if an administrator's authorization is required and missing; another one if an
/// embedded file does not parse.
pub fn may_begin(
    course: &ProfileHistory,
    (before, last): (Option<&ContextRecord>, u64),
    requested: RequestedRules<'_>,
) -> Result<StartPermission, StoreError> {
    let RequestedRules { profile, table, own, scripted } = requested;
    if scripted && course.was_live() {
        return Err(StoreError::ScriptAfterLive);
    }
    let class = profile.name;
    let rules = ProfileRules::of(profile, table).map_err(|error| StoreError::Invalid {
        what: "profile",
        value: class.to_string(),
        allowed: error.sentence(),
    })?;
    let rules = course.next(&rules, scripted);
    let Err(problem) = course.check(last.saturating_add(1), class, &rules) else {
        return Ok(StartPermission::Authorized(rules));
    };
    let is_as_on_record = course.last().is_some_and(|last| last.class == class)
        && before.is_some_and(|before| before.own.as_ref() == own);
    if scripted || !is_as_on_record {
        let named = own.map_or_else(|| class.name().to_owned(), |texts| texts.file.clone());
        return Err(StoreError::UnauthorizedProfile { named, problem });
    }
    Ok(StartPermission::Unauthorized(Notice::ProfileUnauthorized {
        profile: class,
        site: profile.site.clone(),
        less_strict: Some(DowngradeExtent::of(&rules.loosened)),
        summary: String::new(),
    }))
}

/// Records changes of profile, policies and build in the store; evidence gathered under others is void. Returns the voided
/// families, if there was an earlier context.
pub(crate) fn set_context(
    context: &Context,
    version_table: &mut VersionTable,
    agent: Digest,
    (at_ms, scripted): (u64, bool),
) -> Result<StoreUse, EngineFault> {
    let name = context.profile.name;
    let views = version_table.store().views()?;
    let known = views.context()?;
    let before = context_record(&*views)?;
    let end = views.head()?.seq;
    drop(views);
    let course = &version_table.store().opening().profiles;
    let requested = RequestedRules {
        profile: &context.profile,
        table: &context.table,
        own: context.own.as_ref(),
        scripted,
    };
    let rules = match may_begin(course, (before.as_ref(), end), requested)? {
        StartPermission::Authorized(rules) => rules,
        StartPermission::Unauthorized(why) => return Ok(StoreUse::Unauthorized(why)),
    };
    // A store of a script passes to a regular engine.
    let left_by_a_script = course.scripted() && !scripted;
    let same = known.is_some_and(|(profile, policy, _)| profile == name && policy == context.digest);
    let on_record = course.last().and_then(|last| last.rules);
    if same && on_record == Some(rules.digest) && !left_by_a_script {
        return Ok(StoreUse::InForce(None));
    }
    let voids = !same || on_record.is_some_and(|digest| digest != rules.digest);
    let reason = before.as_ref().map_or_else(|| Notice::BindingFirst, |before| what_changed(before, context));
    let json = serde_json::to_string(&ContextRecord {
        agent: Some(agent),
        computed_by: context.cell.computed_by().to_owned(),
        environment: Some(context.cell.digest()),
        omitted: context.omitted,
        own: context.own.clone(),
        policy: context.table.digest,
        profile: context.profile_digest,
        robot: Some(StoreRobot::of(&context.cell)),
        seed: None,
        site: context.profile.site.clone(),
        site_file: context.cell.site.as_ref().and_then(|site| site.on_record()),
    })?;
    // The context is only the present one; earlier ones are in the chain.
    let loaded = context.profile.site.as_ref().map(|site| AuditBody {
        kind: RecordKind::ProfileLoaded,
        subject: site.to_string(),
        body: json.clone(),
    });
    let rules = Some(Box::new(rules));
    let change = Change::SetContext { profile: name, policy_digest: context.digest, json, rules };
    let (before_families, audit) = (vec![change], loaded.into_iter().collect());
    if !voids {
        version_table.write(before_families, audit, at_ms)?;
        return Ok(StoreUse::InForce(None));
    }
    let families: Vec<Family> = version_table.families().map(|(family, _)| family.clone()).collect();
    // In one transaction: after a crash between two, earlier evidence would count under the new context.
    let note = TransitionNote { before: before_families, audit, ..TransitionNote::because(reason.clone()) };
    version_table.change_context(context.needs_approval(), at_ms, note)?;
    let voided = before.is_some() && !families.is_empty();
    Ok(StoreUse::InForce(voided.then_some(VoidedFamilies { families, reason })))
}

#[cfg(test)]
mod tests;
