//! The context of all decisions in one session of the engine: profile, compiled policies, and the cell.

use std::sync::Arc;

use holdpoint_governance::ablation::AblatedParts;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::policy::{PolicyError, PolicySource, PolicyTable};
use holdpoint_governance::profile::{Profile, SiteName};
use holdpoint_governance::site_profile::ProfileTexts;
use holdpoint_runtime::seeds::SeedKey;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::site::StoreSite;
use serde::{Deserialize, Serialize};

use crate::store_robot::StoreRobot;

/// The content of a store's context record: the digests its decisions were made under. Fields are sorted by name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContextRecord {
    /// The agent whose capabilities the store contains; earlier versions name none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agent: Option<Digest>,
    /// The build that computed the evidence ([`Cell::computed_by`]); earlier versions name none.
    #[serde(default)]
    pub computed_by: String,
    /// Robot, scene and distributions; earlier versions name none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<Digest>,
    /// The parts that an experiment omits; such a store serves that experiment only.
    #[serde(default, skip_serializing_if = "AblatedParts::is_none")]
    pub omitted: AblatedParts,
    /// The texts of a custom profile, so that an engine can restart without its files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own: Option<ProfileTexts>,
    pub policy: Digest,
    pub profile: Digest,
    /// The robot that the store was made with; earlier versions name none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<StoreRobot>,
    /// The seed of every session on the store, in stores of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The profile's name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
    /// The site file; absent for the built-in site, and in earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site_file: Option<StoreSite>,
}

/// The digest of a profile, its compiled policies, and a cell (robot, scene, distributions, and what computes episodes).
#[must_use]
pub fn digest(profile: &Digest, policy: &Digest, cell: &Digest) -> Digest {
    Digest::of_parts("holdpoint.context.v3", &[profile.bytes(), policy.bytes(), cell.bytes()])
}

/// The fixed context of a session. Nothing in it changes after the start.
pub struct Context {
    pub profile: Arc<Profile>,
    pub profile_digest: Digest,
    pub table: Arc<PolicyTable>,
    /// The texts of a custom profile.
    pub own: Option<ProfileTexts>,
    /// Digest of profile, policies, robot, scene and what computes episodes. Approval requests and approvals are bound to it.
    pub digest: Digest,
    /// Robot, scene and distributions.
    pub cell: Cell,
    /// The parts that an experiment omits; nothing outside experiments.
    pub omitted: AblatedParts,
    /// Why no version may be activated: no administrator authorized the profile in its present form. Absent if one did, or if
    /// none is required.
    pub unauthorized: Option<Notice>,
    seeds: SeedKey,
}

impl Context {
    /// A context of a profile with its compiled policies and a cell.
    ///
    /// # Errors
    /// If the profile has no canonical form.
    pub fn new(
        profile: Profile,
        table: PolicyTable,
        own: Option<ProfileTexts>,
        cell: Cell,
    ) -> Result<Self, serde_json::Error> {
        let profile_digest = profile.digest()?;
        let digest = digest(&profile_digest, &table.digest, &cell.digest());
        let (profile, table, seeds) = (Arc::new(profile), Arc::new(table), SeedKey::of_run(0));
        let (omitted, unauthorized) = (AblatedParts::default(), None);
        Ok(Self { profile, profile_digest, table, own, digest, cell, omitted, unauthorized, seeds })
    }

    /// The same without these parts. Results are bound to the omission and count nowhere else.
    #[must_use]
    pub fn without(mut self, omitted: AblatedParts) -> Self {
        if !omitted.is_none() {
            let parts: Vec<&[u8]> = omitted.parts().into_iter().map(|part| part.name().as_bytes()).collect();
            let left_out = Digest::of_parts("holdpoint.left-out.v1", &parts);
            self.digest =
                Digest::of_parts("holdpoint.context.left-out.v1", &[self.digest.bytes(), left_out.bytes()]);
        }
        self.omitted = omitted;
        self
    }

    /// The same, with the seeds of bundles sampled under this key.
    #[must_use]
    pub fn seeded(mut self, seeds: SeedKey) -> Self {
        self.seeds = seeds;
        self
    }

    /// Compiles the policies in force again, to compare the result with the table.
    ///
    /// # Errors
    /// If the text no longer compiles.
    pub fn recompiled(&self) -> Result<PolicyTable, PolicyError> {
        match &self.own {
            None => PolicyTable::builtin(&self.profile),
            Some(texts) => {
                let source = PolicySource { file: &texts.policy_file, text: &texts.policy };
                PolicyTable::compile(&self.profile, &[source])
            }
        }
    }

    /// The profile's terms, before any cap of a version.
    #[must_use]
    pub fn terms(&self) -> SkillTerms {
        SkillTerms::new(
            &self.profile,
            Arc::clone(&self.table),
            Arc::clone(&self.cell.geometry),
            Arc::clone(&self.cell.zones),
        )
        .seeded(self.seeds.clone())
    }

    /// Whether every activation requires approval.
    #[must_use]
    pub fn needs_approval(&self) -> bool {
        self.profile.activation.approval_bound
    }

    /// Whether some activations require approval, so that identities must be certain.
    #[must_use]
    pub fn may_need_approval(&self) -> bool {
        self.profile.approval.quorum_high > 0
    }

    /// The limits of kappa I, P, B, R.
    #[must_use]
    pub fn thresholds(&self) -> [f64; 4] {
        let limits = &self.profile.thresholds;
        [limits.interface(), limits.policy(), limits.behavior(), limits.recovery()]
    }
}
