//! What a store is for: the robot it was made with, and the agent whose capabilities it holds.
//!
//! Both are on record in the store's context. Another robot is refused before anything is written, with the way out;
//! another agent holds.

use std::path::PathBuf;

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_governance::lifecycle::LifecycleEvent;
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{AuditBody, Change, StoreError, Views};
use holdpoint_sim::SimError;
use serde::{Deserialize, Serialize};

use crate::cell::{COMPUTED_BY, Cell};
use crate::context::{Context, ContextRecord};
use crate::fault::Fault;
use crate::ledger::{Ledger, Note};

/// A robot as a store names it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BoundRobot {
    /// Name in its description.
    pub name: String,
    /// Digest of its description, hexadecimal.
    pub digest: String,
    /// The file it was read from; absent for a built-in one.
    pub file: Option<PathBuf>,
}

fn read(views: &Views) -> Result<Option<ContextRecord>, StoreError> {
    Ok(views.context()?.and_then(|(_, _, json)| serde_json::from_str(&json).ok()))
}

/// The robot that a store is for; absent if nobody has started on it, or an earlier version did.
///
/// # Errors
/// If the store cannot be read.
pub fn robot(views: &Views) -> Result<Option<BoundRobot>, StoreError> {
    Ok(read(views)?.and_then(|context| context.robot))
}

/// The agent that a store is for; absent as for [`robot`].
pub(crate) fn agent(views: &Views) -> Result<Option<Digest>, StoreError> {
    Ok(read(views)?.and_then(|context| context.agent))
}

impl BoundRobot {
    /// The robot of a cell.
    #[must_use]
    pub fn of(cell: &Cell) -> Self {
        let digest = format!("{:016x}", cell.model.digest);
        Self { name: cell.model.name.clone(), digest, file: cell.robot_file.clone() }
    }

    /// Whether it is the same robot, wherever its file lies.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        self.digest == other.digest
    }

    /// The cell of this robot.
    ///
    /// # Errors
    /// If its file cannot be read.
    pub fn cell(&self) -> Result<Cell, SimError> {
        match &self.file {
            None => Cell::new(holdpoint_sim::robot::RobotModel::builtin(&self.name)?),
            Some(file) => Cell::of(Some(file)),
        }
    }
}

impl std::fmt::Display for BoundRobot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.file {
            Some(file) => write!(f, "{} ({}, {})", self.name, file.display(), self.digest),
            None => write!(f, "{} (built in, {})", self.name, self.digest),
        }
    }
}

/// Sets profile, policies and build in the store if they changed; what was gathered under others is void.
pub(crate) fn set_context(
    context: &Context,
    ledger: &mut Ledger,
    agent: Digest,
    at_ms: u64,
) -> Result<(), Fault> {
    let name = context.profile.name;
    let known = ledger.store().views()?.context()?;
    let same = known.is_some_and(|(profile, policy, _)| profile == name && policy == context.digest);
    if same {
        return Ok(());
    }
    let json = serde_json::to_string(&ContextRecord {
        agent: Some(agent),
        computed_by: COMPUTED_BY.to_owned(),
        environment: Some(context.cell.digest()),
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
    let change = Change::SetContext { profile: name, policy_digest: context.digest, json };
    ledger.write(vec![change], loaded.into_iter().collect(), at_ms)?;
    let families: Vec<Family> = ledger.families().map(|(family, _)| family.clone()).collect();
    for family in families {
        let event = LifecycleEvent::ContextChanged { needs_approval: context.needs_approval() };
        let note = Note::because(
            "the profile, its policies, the robot, the scene or the build that computes evidence changed",
        );
        ledger.transition(&family, event, at_ms, note)?;
    }
    Ok(())
}
