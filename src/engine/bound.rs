//! What a store is for: the robot it was made with, and the agent whose capabilities it holds.
//!
//! Both are on record in the store's context. Another robot is refused before anything is written, with the way out;
//! another agent holds.

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::LifecycleEvent;
use holdpoint_governance::omitted::Omitted;
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{AuditBody, Change, StoreError, Views};

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

/// Sets profile, policies and build in the store if they changed; what was gathered under others is void. Tells what
/// was voided, if there was anything before.
pub(crate) fn set_context(
    context: &Context,
    ledger: &mut Ledger,
    agent: Digest,
    at_ms: u64,
) -> Result<Option<VoidedNow>, Fault> {
    let name = context.profile.name;
    let views = ledger.store().views()?;
    let known = views.context()?;
    let before = context_record(&views)?;
    drop(views);
    let same = known.is_some_and(|(profile, policy, _)| profile == name && policy == context.digest);
    if same {
        return Ok(None);
    }
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
        site: context.profile.site.clone(),
    })?;
    // The context is the present one alone; what was in force before is read in the chain.
    let loaded = context.profile.site.as_ref().map(|site| AuditBody {
        kind: RecordKind::ProfileLoaded,
        subject: site.to_string(),
        body: json.clone(),
    });
    let change =
        Change::SetContext { profile: name, policy_digest: context.digest, json, looser_by_word: true };
    ledger.write(vec![change], loaded.into_iter().collect(), at_ms)?;
    let families: Vec<Family> = ledger.families().map(|(family, _)| family.clone()).collect();
    for family in &families {
        let event = LifecycleEvent::ContextChanged { needs_approval: context.needs_approval() };
        ledger.transition(family, event, at_ms, Note::because(reason.clone()))?;
    }
    Ok((before.is_some() && !families.is_empty()).then_some(VoidedNow { families, reason }))
}
