//! Names the build by what takes a candidate through the stages. The name by what computes an episode is
//! [`holdpoint_trials::cell::computed_by`].

use holdpoint_governance::ids::Digest;
use holdpoint_trials::cell::computed_by;

/// Digest of the stages, the record and the profiles (`build.rs`).
const DECIDED_BY: &str = env!("HOLDPOINT_DECIDED_BY");

/// Digest of what decides about a version: [`computed_by`], the stages, the record and the profiles. Cached decisions of
/// an experiment are bound to it.
#[must_use]
pub fn decided_by(cell_build: &str) -> String {
    let computed_by = computed_by(cell_build);
    Digest::of_parts("holdpoint.decided-by.v1", &[DECIDED_BY.as_bytes(), computed_by.as_bytes()]).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_cell_or_another_build_decides_differently() {
        assert_eq!(DECIDED_BY.len(), 64, "the build script names the build: {DECIDED_BY:?}");
        let here = decided_by(holdpoint_sim::BUILD);
        assert_ne!(here, decided_by("another cell's build"));
        assert_ne!(here, computed_by(holdpoint_sim::BUILD));
    }
}
