//! The versions that are in force together: one of each family of a sequence, and what they fall back to.

use std::collections::BTreeMap;

use holdpoint_engine::embedded;
use holdpoint_governance::ids::{Digest, Family};
use holdpoint_runtime::capability::Capability;
use holdpoint_text::Hint;

use crate::experiment::ExperimentError;

/// A version in force.
#[derive(Clone, Debug)]
pub struct Member {
    pub version: Capability,
    /// It works under the tighter envelope of a restriction.
    pub restricted: bool,
}

/// See the module's head.
#[derive(Clone, Debug)]
pub struct InForce(BTreeMap<Family, Member>);

impl InForce {
    /// The versions that come with the program.
    ///
    /// # Errors
    /// If one does not load.
    pub fn first() -> Result<Self, ExperimentError> {
        let baselines =
            embedded::baselines().map_err(|error| ExperimentError::Unexpected(error.sentence()))?;
        let member = |version: Capability| (version.id().family, Member { version, restricted: false });
        Ok(Self(baselines.into_iter().map(member).collect()))
    }

    /// The same with another version in its family's place.
    #[must_use]
    pub fn with(&self, version: Capability, restricted: bool) -> Self {
        let mut members = self.0.clone();
        members.insert(version.id().family, Member { version, restricted });
        Self(members)
    }

    /// The members, by family.
    pub fn members(&self) -> impl Iterator<Item = &Member> {
        self.0.values()
    }

    /// The versions, by family.
    #[must_use]
    pub fn versions(&self) -> Vec<Capability> {
        self.members().map(|member| member.version.clone()).collect()
    }

    /// Digest of the versions and of how they work.
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

    #[test]
    fn another_version_or_a_restriction_is_something_else() {
        let first = InForce::first().unwrap();
        let grasp = first.versions().into_iter().find(|one| one.id().family.as_str() == "grasp").unwrap();
        assert_eq!(first.with(grasp.clone(), false).digest(), first.digest());
        assert_ne!(first.with(grasp, true).digest(), first.digest());
        let other = embedded::read(std::path::Path::new("grasp-improved")).unwrap();
        let after = first.with(other, false);
        assert_ne!(after.digest(), first.digest());
        assert_eq!(after.versions().len(), first.versions().len());
    }
}
