//! What everything is judged under in one engine's life: profile, compiled policies, and the cell.

use std::sync::Arc;

use holdpoint_governance::ids::Digest;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::Profile;
use holdpoint_runtime::terms::SkillTerms;

use crate::cell::Cell;

/// The fixed frame of an engine's life. Nothing in it changes after the start.
pub struct Context {
    pub profile: Arc<Profile>,
    pub profile_digest: Digest,
    pub table: Arc<PolicyTable>,
    /// Digest of profile, policies, robot, scene and what computes episodes: what prompts and approvals are bound to.
    pub digest: Digest,
    /// Robot, scene and distributions.
    pub cell: Cell,
}

impl Context {
    /// A context of a profile with its compiled policies and a cell.
    ///
    /// # Errors
    /// If the profile has no canonical form.
    pub fn new(profile: Profile, table: PolicyTable, cell: Cell) -> Result<Self, serde_json::Error> {
        let profile_digest = profile.digest()?;
        let digest = Digest::of_parts(
            "holdpoint.context.v3",
            // Robot, scene and distributions are in the cell's, and what computes episodes.
            &[profile_digest.bytes(), table.digest.bytes(), cell.digest().bytes()],
        );
        Ok(Self { profile: Arc::new(profile), profile_digest, table: Arc::new(table), digest, cell })
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
    }

    /// Whether people have to approve an activation, whatever it is.
    #[must_use]
    pub fn needs_approval(&self) -> bool {
        self.profile.activation.approval_bound
    }

    /// The limits of kappa I, P, B, R.
    #[must_use]
    pub fn thresholds(&self) -> [f64; 4] {
        let limits = &self.profile.thresholds;
        [limits.interface(), limits.policy(), limits.behavior(), limits.recovery()]
    }
}
