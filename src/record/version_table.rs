//! Families, their versions and states: one lifecycle event, one transaction on disk.
//!
//! [`VersionTable::transition`] is the only way to change a state: the pure transition function returns the changes, the store
//! writes all of them with their audit record or none, and only then the memory follows. It decides nothing.

mod anchor;
mod commit;
mod load;
mod recorded;
mod tries;

use std::borrow::Cow;
use std::collections::BTreeMap;

pub use anchor::chosen_anchors;
pub use load::load_member;
use load::load_members;

use crate::check::KNOWN_FAMILIES;
use crate::store_robot::StoreRobot;
use crate::wall_clock::WallClock;
use holdpoint_governance::approval::Requester;
use holdpoint_governance::ids::{CapabilityId, Digest, Family, canonical_json};
use holdpoint_governance::lifecycle::{
    self, FamilyState, LifecycleEvent, LifecycleRefusal, State, Version, VersionRef,
};
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::profile_downgrade::AdmissionContext;
use holdpoint_governance::submission::Package;
use holdpoint_governance::tries::TryLedger;
use holdpoint_governance::version_status::RecordedChanges;
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::{Capability, PackageError};
use holdpoint_store::{
    ActiveCause, AuditBody, Change, NewVersion, OpenStore, Receipt, StoreError, Transaction, VersionHistory,
    command_id,
};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use serde::{Deserialize, Serialize};

/// Why a transition did not take place. Nothing has changed then.
#[derive(Debug, thiserror::Error)]
pub enum VersionTableError {
    /// There is no such family.
    #[error("there is no family {0:?}")]
    UnknownFamily(String),
    /// There is no such version.
    #[error("there is no version {0} in the registry")]
    UnknownVersion(CapabilityId),
    /// It exists already.
    #[error("{0} is registered already")]
    Exists(CapabilityId),
    /// The lifecycle refuses it.
    #[error(transparent)]
    Refused(#[from] LifecycleRefusal),
    /// The store could not write it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A stored version does not load.
    #[error("{id} does not load from the store: {source}")]
    Load { id: CapabilityId, source: PackageError },
    /// A stored record cannot be read.
    #[error("the stored {what} of {of} cannot be read: {source}")]
    Record { what: &'static str, of: String, source: serde_json::Error },
    /// A stored version's digest differs from the recorded one.
    #[error("{id} is not what was registered: its digest is {found}, {recorded} was recorded")]
    DigestDiffers {
        id: CapabilityId,
        /// The present digest.
        found: Digest,
        recorded: Digest,
    },
}

impl Hint for VersionTableError {
    fn details(&self) -> Option<ErrorDetails> {
        Some(match self {
            Self::UnknownFamily(_) | Self::UnknownVersion(_) => ErrorReason::NotFound.into(),
            Self::Exists(_) => ErrorReason::Exists.into(),
            Self::Refused(error) => return error.details(),
            Self::Store(error) => return error.details(),
            Self::Load { .. } | Self::Record { .. } | Self::DigestDiffers { .. } => {
                ErrorReason::StoreRefused.into()
            }
        })
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::UnknownFamily(_) => Some(KNOWN_FAMILIES.into()),
            Self::UnknownVersion(_) => Some("see `holdpoint version list`".into()),
            Self::Exists(_) => Some("a changed candidate needs a new version number".into()),
            Self::Refused(error) => error.hint(),
            Self::Store(error) => error.hint(),
            Self::Load { source, .. } => source.hint(),
            Self::Record { .. } | Self::DigestDiffers { .. } => None,
        }
    }
}

/// Further changes in the transaction of an event.
#[derive(Default)]
pub struct TransitionNote {
    /// The reason.
    pub reason: NoticeOrText,
    /// Why the active pointer moves, if it does.
    pub cause: Option<ActiveCause>,
    /// Written before the state changes (evidence, used approvals).
    pub before: Vec<Change>,
    pub after: Vec<Change>,
    /// Records for the chain.
    pub audit: Vec<AuditBody>,
}

impl TransitionNote {
    /// A note with a reason only.
    #[must_use]
    pub fn because(reason: impl Into<NoticeOrText>) -> Self {
        Self { reason: reason.into(), ..Self::default() }
    }
}

/// A state that changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateMove {
    pub id: CapabilityId,
    pub from: State,
    pub to: State,
}

/// The origin of a version: its requester, and its author's key.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VersionOrigin {
    /// The requester.
    #[serde(default)]
    pub requester: Requester,
    /// The author's public key, hexadecimal digits, where it signed the version or its registration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub author_key: Option<String>,
    /// Whether a script provided it, unverified.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub scripted: bool,
}

impl VersionOrigin {
    /// The origin of a version that a script or the program itself registers.
    #[must_use]
    pub const fn of(requester: Requester) -> Self {
        Self { requester, author_key: None, scripted: false }
    }

    /// The part that a regular engine trusts.
    fn believed(self) -> Self {
        if self.scripted { Self::of(Requester::Script) } else { self }
    }
}

/// A version in the version table.
#[derive(Clone, Debug)]
pub struct VersionEntry {
    /// The version with its bundle.
    pub capability: Capability,
    /// Its requester and its author's key.
    pub origin: VersionOrigin,
    /// Counts state changes; approvals name it.
    pub row_version: u64,
    /// The history of its state.
    pub course: VersionHistory,
}

/// A family in the version table.
#[derive(Clone, Debug)]
pub struct FamilyEntry {
    /// The states of its versions.
    pub state: FamilyState,
    /// The versions, in registration order.
    pub members: Vec<VersionEntry>,
}

impl FamilyEntry {
    #[must_use]
    pub fn active(&self) -> Option<&VersionEntry> {
        self.state.active().and_then(|version| self.members.get(usize::from(version.0)))
    }

    /// The superseded versions behind the active one, the newest first.
    pub fn predecessors(&self) -> impl Iterator<Item = &VersionEntry> {
        let before = move |version: &VersionRef| self.state.get(*version)?.predecessor;
        std::iter::successors(self.state.active().as_ref().and_then(before), before)
            .take(self.members.len())
            .filter(move |version| self.state.state(*version) == Some(State::Superseded))
            .filter_map(move |version| self.members.get(usize::from(version.0)))
    }

    /// A version's place and state.
    #[must_use]
    pub fn find(&self, id: &CapabilityId) -> Option<(VersionRef, &Version, &VersionEntry)> {
        let index = self.members.iter().position(|member| member.capability.id() == *id)?;
        let version = VersionRef(u16::try_from(index).ok()?);
        Some((version, self.state.get(version)?, self.members.get(index)?))
    }
}

/// A package in the registry's submission column.
#[derive(Serialize, Deserialize)]
struct StoredPackage {
    package: Package,
    /// Unknown in records of earlier versions of the program.
    #[serde(default)]
    origin: VersionOrigin,
}

/// Families by name, and the store they are written to.
pub struct VersionTable {
    store: Box<dyn OpenStore>,
    families: BTreeMap<Family, FamilyEntry>,
    /// The versions that people made anchors.
    anchors: BTreeMap<Family, CapabilityId>,
    /// The counted tries.
    tries: BTreeMap<Family, TryLedger>,
    /// What is on record of the present state of each version.
    recorded: BTreeMap<CapabilityId, RecordedChanges>,
    wall: WallClock,
    /// Digest of the robot that activations name.
    robot: Option<String>,
    /// The context of activations.
    admission: AdmissionContext,
}

impl ActiveView for VersionTable {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.families.get(family)?.active().map(|member| &member.capability)
    }
}

impl VersionTable {
    /// Reads the families of a store.
    ///
    /// # Errors
    /// If a version does not load or its digest differs.
    pub fn open(store: Box<dyn OpenStore>, wall: WallClock) -> Result<Self, VersionTableError> {
        let mut families = BTreeMap::new();
        let views = store.views()?;
        for status in views.families()? {
            let Ok(family) = Family::new(status.name.clone()) else { continue };
            let Some(json) = status.state_json else { continue };
            let state: FamilyState = serde_json::from_str(&json).map_err(|source| {
                VersionTableError::Record { what: "standing", of: status.name.clone(), source }
            })?;
            let members = load_members(&*views, &family)?;
            families.insert(family, FamilyEntry { state, members });
        }
        let (anchors, tries) = (chosen_anchors(&*views)?, tries::recorded_tries(&*views)?);
        let ids = families.values().flat_map(|entry: &FamilyEntry| &entry.members);
        let recorded = recorded::of_all(&*views, ids.map(|member| member.capability.id()))?;
        drop(views);
        let admission = AdmissionContext::LEAST;
        Ok(Self { store, families, anchors, tries, recorded, wall, robot: None, admission })
    }

    /// Creates the store's first administrator, if no person was ever enrolled.
    ///
    /// # Errors
    /// If the store cannot write it.
    pub fn begin_persons(&mut self) -> Result<(), StoreError> {
        let wall_ms = self.wall.stamp(self.store.opening().head.at_ms);
        self.store.first_administrator(wall_ms).map(drop)
    }

    /// From now on activations name this robot and this context of profile class and script. A regular engine does not trust the
    /// origins of versions that a script provided.
    pub fn bind(&mut self, robot: &StoreRobot, admission: AdmissionContext) {
        self.robot = Some(robot.digest.clone());
        self.admission = admission;
        if !admission.scripted {
            let members = self.families.values_mut().flat_map(|entry| &mut entry.members);
            members.for_each(|member| member.origin = std::mem::take(&mut member.origin).believed());
        }
    }

    /// The context in which the gate activates now.
    #[must_use]
    pub const fn admission(&self) -> AdmissionContext {
        self.admission
    }

    /// The clock that approvers' deadlines are compared with.
    #[must_use]
    pub const fn wall(&self) -> &WallClock {
        &self.wall
    }

    pub const fn wall_mut(&mut self) -> &mut WallClock {
        &mut self.wall
    }

    #[must_use]
    pub fn store(&self) -> &dyn OpenStore {
        self.store.as_ref()
    }

    pub fn families(&self) -> impl Iterator<Item = (&Family, &FamilyEntry)> {
        self.families.iter()
    }

    /// Every version with its state, by family and registration.
    pub fn versions(&self) -> impl Iterator<Item = (&VersionEntry, &Version)> {
        self.families.values().flat_map(|entry| entry.members.iter().zip(&entry.state.versions))
    }

    /// A family.
    ///
    /// # Errors
    /// [`VersionTableError::UnknownFamily`].
    pub fn family(&self, family: &Family) -> Result<&FamilyEntry, VersionTableError> {
        self.families.get(family).ok_or_else(|| VersionTableError::UnknownFamily(family.to_string()))
    }

    /// A version with its state.
    ///
    /// # Errors
    /// If there is no such family or version.
    pub fn version(
        &self,
        id: &CapabilityId,
    ) -> Result<(VersionRef, &Version, &VersionEntry), VersionTableError> {
        self.family(&id.family)?.find(id).ok_or_else(|| VersionTableError::UnknownVersion(id.clone()))
    }

    /// Reads the present form of a version from the store.
    ///
    /// # Errors
    /// If it is missing, does not load, or its digest differs.
    pub fn reload(&self, id: &CapabilityId) -> Result<Capability, VersionTableError> {
        let registered = self.version(id)?.2.capability.digest();
        let member = load_member(&*self.store.views()?, id)?
            .ok_or_else(|| VersionTableError::UnknownVersion(id.clone()))?;
        let found = member.capability.digest();
        if found == registered {
            Ok(member.capability)
        } else {
            Err(VersionTableError::DigestDiffers { id: id.clone(), found, recorded: registered })
        }
    }

    /// The highest version of a family that meets a requirement and may take over: active or superseded.
    #[must_use]
    pub fn resolve(&self, family: &Family, requirement: &semver::VersionReq) -> Option<&Capability> {
        let entry = self.families.get(family)?;
        let usable = entry.members.iter().zip(&entry.state.versions).filter(|(member, version)| {
            matches!(version.state, State::Active | State::Superseded)
                && requirement.matches(&member.capability.id().version)
        });
        usable.map(|(member, _)| &member.capability).max_by_key(|capability| capability.id().version)
    }

    /// Registers a version; `baseline` activates it without a gate, by an explicit record.
    ///
    /// # Errors
    /// If the version exists, the lifecycle refuses, or the store does.
    pub fn register(
        &mut self,
        (capability, origin): (Capability, VersionOrigin),
        baseline: bool,
        needs_approval: bool,
        at_ms: u64,
        note: TransitionNote,
    ) -> Result<Vec<StateMove>, VersionTableError> {
        let id = capability.id();
        let mut first = Vec::new();
        let before = match self.families.get(&id.family) {
            Some(entry) if entry.find(&id).is_some() => return Err(VersionTableError::Exists(id)),
            Some(entry) => entry.clone(),
            None if baseline => {
                first.push(Change::SetFamily {
                    family: id.family.clone(),
                    safe_stopped: false,
                    reason: Notice::FamilyNew.into(),
                });
                FamilyEntry { state: FamilyState::empty(needs_approval), members: Vec::new() }
            }
            None => return Err(VersionTableError::UnknownFamily(id.family.to_string())),
        };
        let event = if baseline { LifecycleEvent::Bootstrap } else { LifecycleEvent::Register };
        let (state, life) = lifecycle::apply(&before.state, event)?;
        first.push(Change::RegisterVersion(Box::new(new_version(&capability, &origin, baseline)?)));
        let mut entry = before;
        entry.members.push(VersionEntry {
            capability,
            origin,
            row_version: 1,
            course: VersionHistory::default(),
        });
        if baseline {
            first.push(Change::SetState {
                version: id.clone(),
                expected_row_version: 1,
                from: State::Registered,
                to: State::Active,
                reason: note.reason.clone(),
            });
        }
        first.extend(note.before);
        let note = TransitionNote { before: first, ..note };
        self.commit(&id.family, entry, state, &life, at_ms, note)
    }

    /// Applies an event to a family.
    ///
    /// # Errors
    /// If the lifecycle refuses, or the store does. Nothing has changed then.
    pub fn transition(
        &mut self,
        family: &Family,
        event: LifecycleEvent,
        at_ms: u64,
        note: TransitionNote,
    ) -> Result<Vec<StateMove>, VersionTableError> {
        let mut entry = self.family(family)?.clone();
        let (state, life) = lifecycle::apply(&entry.state, event)?;
        let (confirmed, activated) = match event {
            LifecycleEvent::Confirm { version } => (Some(version), None),
            LifecycleEvent::Activate { version } | LifecycleEvent::ActivateUnreviewed { version, .. } => {
                (None, Some(version))
            }
            _ => (None, None),
        };
        for (number, member) in entry.members.iter_mut().enumerate() {
            let is_member =
                |version: Option<VersionRef>| version.is_some_and(|version| usize::from(version.0) == number);
            member.course.confirmed |= is_member(confirmed);
            if is_member(activated) {
                member.course.activated_under = Some(self.admission);
            }
        }
        self.commit(family, entry, state, &life, at_ms, note)
    }

    /// Writes changes that move no state.
    ///
    /// # Errors
    /// If the store refuses them.
    pub fn write(
        &mut self,
        changes: Vec<Change>,
        audit: Vec<AuditBody>,
        at_ms: u64,
    ) -> Result<Receipt, StoreError> {
        let command_id = command_id("engine")?;
        let wall_ms = self.wall.stamp(at_ms);
        let changes_status = recorded::changes_status(&changes, &audit);
        let receipt =
            self.store.commit_sealing(Transaction { command_id, at_ms, wall_ms, changes, audit })?;
        if changes_status {
            self.note_records(&receipt);
        }
        Ok(receipt)
    }
}

impl Drop for VersionTable {
    /// Seals the newest telemetry before the store closes. A failure is found at the next start.
    fn drop(&mut self) {
        if let Some(at_ms) = self.store.telemetry_waits() {
            drop(self.write(Vec::new(), Vec::new(), at_ms));
        }
    }
}

fn new_version(
    capability: &Capability,
    origin: &VersionOrigin,
    baseline: bool,
) -> Result<NewVersion, VersionTableError> {
    let id = capability.id();
    let record = |what| {
        let of = id.to_string();
        move |source| VersionTableError::Record { what, of, source }
    };
    let manifest = &capability.manifest;
    let submission = &capability.submission;
    let parent = submission.parent.clone().map(|version| CapabilityId { family: id.family.clone(), version });
    let stored = StoredPackage { package: (*capability.package).clone(), origin: origin.clone() };
    Ok(NewVersion {
        id: id.clone(),
        parent,
        candidate_digest: capability.digest(),
        manifest_digest: capability.manifest_digest(),
        bundle_digest: capability.bundle.digest(),
        manifest: manifest.canonical().map_err(record("manifest"))?,
        submission: canonical_json(&stored).map_err(record("submission"))?,
        author: submission.author.clone(),
        provenance: submission.provenance,
        risk: submission.estimated_risk,
        permissions: canonical_json(&manifest.permissions).map_err(record("permissions"))?,
        environments: canonical_json(&manifest.deployment.environments).map_err(record("environments"))?,
        baseline,
    })
}
