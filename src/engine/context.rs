//! What everything is judged under in one engine's life: profile, compiled policies, and the cell.

use std::sync::Arc;

use holdpoint_governance::ids::Digest;
use holdpoint_governance::omitted::Omitted;
use holdpoint_governance::own_profile::ProfileTexts;
use holdpoint_governance::policy::{PolicyError, PolicySource, PolicyTable};
use holdpoint_governance::profile::{Profile, SiteName};
use holdpoint_runtime::seeds::SeedKey;
use holdpoint_runtime::terms::SkillTerms;
use serde::{Deserialize, Serialize};

use crate::bound_robot::BoundRobot;
use crate::cell::Cell;

/// What a store says it was judged under: the content of its context record. Fields stand in the order of their names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContextRecord {
    /// The agent whose capabilities the store holds; an earlier version names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agent: Option<Digest>,
    /// What computed the evidence ([`crate::cell::COMPUTED_BY`]); an earlier version names nothing.
    #[serde(default)]
    pub computed_by: String,
    /// Robot, scene and distributions; an earlier version names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub environment: Option<Digest>,
    /// What an experiment leaves out; such a store is good for nothing else.
    #[serde(default, skip_serializing_if = "Omitted::is_nothing")]
    pub omitted: Omitted,
    /// The texts of a profile that does not come with the program, so that an engine can go on under it without them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub own: Option<ProfileTexts>,
    pub policy: Digest,
    pub profile: Digest,
    /// The robot that the store was made with; an earlier version names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<BoundRobot>,
    /// The seed of every life of an engine on the store; absent where only a script was, or an earlier version.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The profile's own name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
}

/// What is judged under, in one digest: of a profile, of its compiled policies, and of a cell (robot, scene,
/// distributions, and what computes episodes).
pub(crate) fn digest(profile: &Digest, policy: &Digest, cell: &Digest) -> Digest {
    Digest::of_parts("holdpoint.context.v3", &[profile.bytes(), policy.bytes(), cell.bytes()])
}

/// The fixed frame of an engine's life. Nothing in it changes after the start.
pub struct Context {
    pub profile: Arc<Profile>,
    pub profile_digest: Digest,
    pub table: Arc<PolicyTable>,
    /// The texts of a profile that does not come with the program.
    pub own: Option<ProfileTexts>,
    /// Digest of profile, policies, robot, scene and what computes episodes: what prompts and approvals are bound to.
    pub digest: Digest,
    /// Robot, scene and distributions.
    pub cell: Cell,
    /// What an experiment leaves out of the way; nothing, outside experiments.
    pub omitted: Omitted,
    /// Why nothing may become active under it: no administrator authorized the profile as this program has it. Absent where one
    /// did, or none has to.
    pub unauthorized: Option<String>,
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
        let (omitted, unauthorized) = (Omitted::default(), None);
        Ok(Self { profile, profile_digest, table, own, digest, cell, omitted, unauthorized, seeds })
    }

    /// The same with these parts of the way left out. What is found so is bound to that: it counts nowhere else.
    #[must_use]
    pub fn without(mut self, omitted: Omitted) -> Self {
        if !omitted.is_none() {
            let parts: Vec<&[u8]> = omitted.parts().into_iter().map(|part| part.name().as_bytes()).collect();
            let left_out = Digest::of_parts("holdpoint.left-out.v1", &parts);
            self.digest =
                Digest::of_parts("holdpoint.context.left-out.v1", &[self.digest.bytes(), left_out.bytes()]);
        }
        self.omitted = omitted;
        self
    }

    /// The same with bundles' seeds drawn under this key.
    #[must_use]
    pub fn seeded(mut self, seeds: SeedKey) -> Self {
        self.seeds = seeds;
        self
    }

    /// The policies compiled again from the text in force, to hold the table against.
    ///
    /// # Errors
    /// If the text does not compile, which it did once.
    pub fn recompiled(&self) -> Result<PolicyTable, PolicyError> {
        match &self.own {
            None => PolicyTable::builtin(&self.profile),
            Some(texts) => {
                let source = PolicySource { file: &texts.policy_file, text: &texts.policy };
                PolicyTable::compile(&self.profile, &[source])
            }
        }
    }

    /// The profile's terms, before anything of a version caps them.
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

    /// Whether people have to approve an activation, whatever it is.
    #[must_use]
    pub fn needs_approval(&self) -> bool {
        self.profile.activation.approval_bound
    }

    /// Whether people are asked about some activations at least, so that it has to be certain who they are.
    #[must_use]
    pub fn asks_people(&self) -> bool {
        self.profile.approval.quorum_high > 0
    }

    /// The limits of kappa I, P, B, R.
    #[must_use]
    pub fn thresholds(&self) -> [f64; 4] {
        let limits = &self.profile.thresholds;
        [limits.interface(), limits.policy(), limits.behavior(), limits.recovery()]
    }
}
