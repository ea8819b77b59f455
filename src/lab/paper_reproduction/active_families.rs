//! The versions that are active together: one of each family of a sequence, and their fallback.

use std::collections::BTreeMap;

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_runtime::capability::Capability;

use crate::pipeline_experiments::{ExperimentError, baselines};

/// An active version.
#[derive(Clone, Debug)]
pub struct ActiveMember {
    pub version: Capability,
    /// It runs in the tighter envelope of a restriction.
    pub restricted: bool,
}

/// See the module's head.
#[derive(Clone, Debug)]
pub struct ActiveFamilies(BTreeMap<Family, ActiveMember>);

impl ActiveFamilies {
    /// The versions that come with the program.
    ///
    /// # Errors
    /// If one does not load.
    pub fn first() -> Result<Self, ExperimentError> {
        let baselines = baselines()?;
        let member = |version: Capability| (version.id().family, ActiveMember { version, restricted: false });
        Ok(Self(baselines.into_iter().map(member).collect()))
    }

    /// The same with another version in its family's place.
    #[must_use]
    pub fn with(&self, version: Capability, restricted: bool) -> Self {
        let mut members = self.0.clone();
        members.insert(version.id().family, ActiveMember { version, restricted });
        Self(members)
    }

    /// The members, by family.
    pub fn members(&self) -> impl Iterator<Item = &ActiveMember> {
        self.0.values()
    }

    /// The versions, by family.
    #[must_use]
    pub fn versions(&self) -> Vec<Capability> {
        self.members().map(|member| member.version.clone()).collect()
    }

    /// Digest of the versions and of their envelopes.
    #[must_use]
    pub fn digest(&self) -> Digest {
        let parts: Vec<Vec<u8>> = self
            .members()
            .map(|member| {
                [member.version.digest().bytes().as_slice(), &[u8::from(member.restricted)]].concat()
            })
            .collect();
        let parts: Vec<&[u8]> = parts.iter().map(Vec::as_slice).collect();
        Digest::of_parts("holdpoint.in-force.v1", &parts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_trials::embedded;

    #[test]
    fn another_version_or_a_restriction_is_a_difference() {
        let first = ActiveFamilies::first().unwrap();
        let grasp = first.versions().into_iter().find(|one| one.id().family.as_str() == "grasp").unwrap();
        assert_eq!(first.with(grasp.clone(), false).digest(), first.digest());
        assert_ne!(first.with(grasp, true).digest(), first.digest());
        let other = embedded::read(std::path::Path::new("grasp-improved")).unwrap();
        let after = first.with(other, false);
        assert_ne!(after.digest(), first.digest());
        assert_eq!(after.versions().len(), first.versions().len());
    }
}
