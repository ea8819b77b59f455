//! Changes of the witnesses on record; where robots or people are at risk, by an administrator's signed authorization.

use crate::transaction::apply::Applier;
use holdpoint_approvals::SignedWitnessAct;
use holdpoint_governance::profile::ProfileName;
use holdpoint_store::StoreError;

/// Whether a profile requires an administrator's signed authorization to change witnesses.
#[must_use]
pub const fn witnesses_are_signed(profile: ProfileName) -> bool {
    profile.is_at_risk()
}

impl Applier<'_> {
    /// Checks the administrator's authorization, for this end of the chain; without a required one nothing is done.
    pub(crate) fn check_witness_act(
        &self,
        (folder, present): (&str, bool),
        act: Option<&SignedWitnessAct>,
    ) -> Result<(), StoreError> {
        let profile = match self.context() {
            Ok((profile, ..)) => Some(profile),
            Err(StoreError::NotFound { .. }) => None,
            Err(error) => return Err(error),
        };
        let refused = |problem: String| StoreError::invalid("authorization of the witness", folder, problem);
        let Some(signed) = act else {
            return match profile.filter(|profile| witnesses_are_signed(*profile)) {
                None => Ok(()),
                Some(profile) => {
                    Err(refused(format!("an administrator signs it under the profile {profile}")))
                }
            };
        };
        let persons = self.persons()?;
        let checked = signed.check(&persons, (folder, present), self.head.hash);
        let checked = checked.and_then(|()| match profile {
            Some(profile) if profile.is_beside_people() => signed.check_guarded(&persons),
            Some(_) | None => Ok(()),
        });
        checked.map_err(|error| refused(error.to_string()))
    }
}
