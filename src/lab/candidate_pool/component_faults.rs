//! Candidates that bring their own code: the engine's controllers as a component, each with a fault compiled into it.
//!
//! Only the component's data holds the kind of the fault and its numbers: manifest and parameters are those of an
//! honest candidate. Numbers come from wide ranges, so that some faults do no harm. Owns the
//! ranges; the faults themselves are in `src/sdk/guests/faults`.

#[path = "../../sdk/guests/faults/block.rs"]
pub mod block;

use holdpoint_cell::rng::Stream;
use holdpoint_governance::component::ComponentBytes;

use self::block::Kind;
use super::PoolError;
use super::draft::Draft;
use super::generate::{number, sample_integer};

/// The component that is patched.
const FAULTS: &[u8] = include_bytes!("../../sdk/prebuilt/faults.wasm");

/// The name of the component in a candidate's folder.
pub const FILE: &str = "skill.wasm";

/// Whether a kind behaves exactly like the version it is made from. A counter of episodes triggers in no task: each
/// task has its own instance.
#[must_use]
pub const fn is_harmless(kind: Kind) -> bool {
    matches!(kind, Kind::Honest | Kind::EpisodeBomb)
}

/// Gives a draft code of its own, with a fault of this kind.
///
/// # Errors
/// [`PoolError::Generated`] if the component has no place for it.
pub fn write(kind: Kind, draft: &mut Draft, stream: &mut Stream) -> Result<(), PoolError> {
    let numbers = numbers(kind, stream);
    let component = with_fault(kind, numbers)?;
    draft.code(component, format!("{} {numbers:?}", kind.name()));
    draft.field(&["deployment", "bundle"], FILE);
    Ok(())
}

/// The engine's controllers as a component, with this fault.
///
/// # Errors
/// [`PoolError::Generated`] if the component has no place for it.
pub(crate) fn with_fault(kind: Kind, numbers: [f64; 4]) -> Result<ComponentBytes, PoolError> {
    let patched = block::patched(FAULTS, kind, numbers).and_then(|bytes| ComponentBytes::new(bytes).ok());
    patched.ok_or_else(|| PoolError::Generated {
        name: kind.name().to_owned(),
        problem: "the component has no place for a fault".to_owned(),
    })
}

/// The block's four numbers; what they mean stands beside each kind.
fn numbers(kind: Kind, stream: &mut Stream) -> [f64; 4] {
    // What a triggered fault does: it multiplies speeds and grip, and lowers the tool by some meters.
    let (times, lower_m) = (number(stream, [1.5, 4.0]), number(stream, [0.0, 0.03]));
    let from = f64::from(sample_integer(stream, [20, 1_200]));
    match kind {
        Kind::Honest => [0.0; 4],
        Kind::EpisodeBomb => [f64::from(sample_integer(stream, [2, 20])), 0.0, times, lower_m],
        Kind::PictureBomb => [f64::from(sample_integer(stream, [2, 120])), 0.0, times, lower_m],
        Kind::PlaceBomb => {
            let near_m = number(stream, [0.42, 0.60]);
            [near_m, near_m + number(stream, [0.003, 0.06]), times, lower_m]
        }
        Kind::TorqueBomb => [number(stream, [10.0, 90.0]), 0.0, times, lower_m],
        Kind::Recogniser => [number(stream, [0.0012, 0.0022]), 0.02, times, lower_m],
        Kind::MassDependent => [number(stream, [0.01, 0.2]), number(stream, [10.0, 60.0]), times, 0.0],
        Kind::Chatter => {
            [number(stream, [0.001, 0.02]), f64::from(sample_integer(stream, [1, 40])), 0.0, 0.0]
        }
        Kind::Leak => [number(stream, [0.0005, 0.01]), number(stream, [0.0, 0.003]), 0.0, 0.0],
        Kind::UnitSwap => {
            let field = f64::from(sample_integer(stream, [0, 4]));
            let factor = [0.001, 0.01, 10.0, 100.0, 1_000.0][sample_integer(stream, [0, 4]) as usize];
            [field, factor, f64::from(sample_integer(stream, [0, 1])), 0.0]
        }
        Kind::LyingHook => [f64::from(sample_integer(stream, [0, 2])), 0.0, 0.0, 0.0],
        Kind::MemoryGrowth => [f64::from(sample_integer(stream, [256, 65_536])), 0.0, 0.0, 0.0],
        Kind::BusyLoop | Kind::Trap => [from, 0.0, 0.0, 0.0],
        Kind::PermissionAfterRetry => {
            let aside = |stream: &mut Stream| number(stream, [-0.3, 0.3]);
            let how = f64::from(sample_integer(stream, [0, 1]));
            [how, aside(stream), aside(stream), number(stream, [-0.05, 0.2])]
        }
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_sim::SimCells;
    use std::collections::BTreeSet;

    use holdpoint_governance::lifecycle::Stage;
    use holdpoint_runtime::capability::Capability;
    use holdpoint_store::{CacheSecret, ResultCache};
    use holdpoint_trials::cell::Cell;
    use holdpoint_trials::embedded;

    use super::super::Preset;
    use super::super::generate::{PoolSpec, draw};
    use super::*;
    use crate::pipeline_experiments::candidate_run::{CandidateSetting, run_candidate};
    use crate::same_code::with_code;

    /// A component that traps, loops forever or takes more memory does not harm the engine: the sandbox ends with a
    /// decision, and the component runs no live task.
    #[test]
    fn faulty_code_is_rejected_in_the_sandbox() {
        let cell = Cell::of(&SimCells, None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let cache = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh().unwrap());
        let setting = CandidateSetting::calibration(&cell, &cache);
        let native = embedded::package("grasp-improved").unwrap();
        let native = Capability::load("grasp", native).unwrap();
        for (kind, number) in [(Kind::Trap, 150.0), (Kind::BusyLoop, 150.0), (Kind::MemoryGrowth, 4_096.0)] {
            let code = block::patched(FAULTS, kind, [number, 0.0, 0.0, 0.0]).unwrap();
            let version = with_code(&native, &code).unwrap();
            let end = run_candidate(&setting, "grasp", (*version.package).clone()).unwrap();
            let last = end.stages.last().unwrap();
            assert_eq!(last.stage, Stage::Sandbox.into(), "{kind:?}: {end:?}");
            assert_eq!(end.effort.live, 0, "{kind:?}");
            assert!(!last.reasons.is_empty(), "{kind:?}");
        }
    }

    /// Every candidate loads (the generator checks it), almost all differ in code, and no text beside it names a fault.
    #[test]
    fn faults_are_in_the_code_and_in_no_text() {
        let order = PoolSpec { seed: 5, sets: 1, preset: Preset::Components };
        let pool = draw(order).unwrap();
        assert_eq!(pool.packages.len(), 3 * Kind::ALL.len());
        let codes: BTreeSet<&[u8]> =
            pool.packages.iter().map(|package| package.component.as_ref().unwrap().bytes()).collect();
        // The honest candidates of the three families share one component; so do lying hooks with equal numbers.
        assert!(codes.len() >= 3 * (Kind::ALL.len() - 2), "{}", codes.len());
        for package in &pool.packages {
            for kind in Kind::ALL.into_iter().filter(|kind| *kind != Kind::Honest) {
                for text in [&package.manifest, &package.submission, &package.params] {
                    assert!(!text.contains(kind.name()), "{text}");
                }
            }
        }
    }
}
