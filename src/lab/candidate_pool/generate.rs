//! Draws a pool and writes it: packages, index, and the truth beside the folder. Equal seeds give equal bytes.
//!
//! Every choice comes from one stream a candidate, seeded by purpose, seed, family, set and place in the set, so a
//! pool of more sets begins like one of fewer. Seeds from 100 on are for calibration and draw from other streams.

use std::collections::BTreeSet;
use std::path::Path;

use holdpoint_cell::rng::Stream;
use toml::{Table, Value};

use super::component_faults::{self, block::Kind};
use super::draft::Draft;
use super::kind::{CandidateKind, Preset};
use super::mutant;
use super::paper_kinds::Listed;
use super::recipes::{Recipe, RecipeKind, recipes};
use super::structure::{INTERFACE, Mechanism, PERMISSION};
use super::truth_file::{PoolTruth, TruthEntry};
use super::{FORMAT, INDEX_FILE, PoolCandidate, PoolError, PoolIndex, display_path, sha256, truth_path};
use crate::wording::packages;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::submission::Package;
use holdpoint_governance::submission::Provenance;
use holdpoint_runtime::capability::Capability;
use holdpoint_text::Hint;

/// The most sets of a pool.
pub const SETS_MAX: u32 = 400;

/// The families of a pool.
pub const FAMILIES: [&str; 3] = ["grasp", "align", "place"];

/// Run seeds from this on are for calibration.
const CALIBRATION_FROM: u64 = 100;

/// Pools from this seed on are the paper's experiments': they draw from streams of their own.
pub const PAPER_FROM: u64 = 1 << 32;

/// Possible authors of a submission; independent of the candidate.
const AUTHORS: [&str; 5] = ["skill-lab", "motion-team", "line-seven", "integration", "night-shift"];

/// The settings of a pool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolSpec {
    /// The seed; from 100 on for calibration.
    pub seed: u64,
    /// How many times each kind occurs in a family, 1 to [`SETS_MAX`].
    pub sets: u32,
    pub preset: Preset,
}

/// A generated pool, not yet written.
#[derive(Clone, Debug, PartialEq)]
pub struct SampledPool {
    pub index: PoolIndex,
    /// The packages, in the index's order.
    pub packages: Vec<Package>,
    /// The truth file's bytes.
    pub truth: Vec<u8>,
}

/// Generates a pool.
///
/// # Errors
/// [`PoolError::Sets`]; [`PoolError::Generated`] if a package would not load, which is a fault of the table.
pub fn draw(spec: PoolSpec) -> Result<SampledPool, PoolError> {
    if !(1..=SETS_MAX).contains(&spec.sets) {
        return Err(PoolError::Sets { sets: spec.sets, allowed: SETS_MAX });
    }
    let fault = |name: &str, problem: String| PoolError::Generated { name: name.to_owned(), problem };
    let recipes = recipes().map_err(|error| fault("(the table)", error.to_string()))?;
    let baselines =
        holdpoint_trials::embedded::baselines().map_err(|error| fault("(a baseline)", error.sentence()))?;
    let mut candidates = Vec::new();
    let mut entries = Vec::new();
    let mut packages = Vec::new();
    for family in FAMILIES {
        let baseline = baselines.iter().find(|baseline| baseline.id().family.as_str() == family);
        let baseline = baseline.ok_or_else(|| fault(family, "there is no baseline".to_owned()))?;
        let mut drafts = Vec::new();
        for set in 0..spec.sets {
            drafts.extend(draw_set(spec, family, set, baseline, &recipes)?);
        }
        let mut stream = stream_of(spec.seed, family, "names", 0, 0);
        shuffle(&mut drafts, &mut stream);
        let versions = versions(drafts.len(), &mut stream);
        for (number, ((kind, mechanism, mut draft), version)) in drafts.into_iter().zip(versions).enumerate()
        {
            let name = format!("{family}-{:03}", number + 1);
            draft.manifest.insert("version".to_owned(), Value::from(version.to_string()));
            let package = draft.package(&submission(&mut stream));
            let loaded =
                Capability::load(&name, package.clone()).map_err(|error| fault(&name, error.sentence()))?;
            let id = loaded.id();
            candidates.push(PoolCandidate { name: name.clone(), family: id.family, version: id.version });
            let what = draft.differences();
            entries.push(TruthEntry {
                name,
                class: kind.class(),
                kind: mechanism,
                dimension: kind.dimension(),
                what,
            });
            packages.push(package);
        }
    }
    let truth = json(&PoolTruth { format: FORMAT, entries })?;
    let index = PoolIndex {
        format: FORMAT,
        generator: env!("CARGO_PKG_VERSION").to_owned(),
        seed: spec.seed,
        preset: spec.preset,
        sets: spec.sets,
        truth_digest: sha256(&truth),
        candidates,
    };
    Ok(SampledPool { index, packages, truth })
}

/// Generates a pool and writes it to a new folder, the truth beside it.
///
/// # Errors
/// As [`draw`]; [`PoolError::Exists`] or [`PoolError::File`] if it cannot be written.
pub fn write(spec: PoolSpec, dir: &Path) -> Result<PoolIndex, PoolError> {
    let drawn = draw(spec)?;
    let truth = truth_path(dir);
    if let Some(there) = [dir, &truth].into_iter().find(|path| path.exists()) {
        return Err(PoolError::Exists(display_path(there)));
    }
    std::fs::create_dir_all(dir).map_err(|source| PoolError::File { file: display_path(dir), source })?;
    for (candidate, package) in drawn.index.candidates.iter().zip(&drawn.packages) {
        let folder = dir.join(&candidate.name);
        std::fs::create_dir(&folder)
            .map_err(|source| PoolError::File { file: display_path(&folder), source })?;
        for (file, text) in [
            ("manifest.toml", &package.manifest),
            ("submission.toml", &package.submission),
            ("params.toml", &package.params),
        ] {
            put(&folder.join(file), text.as_bytes())?;
        }
        if let Some(component) = &package.component {
            put(&folder.join(component_faults::FILE), component.bytes())?;
        }
    }
    put(&truth, &drawn.truth)?;
    // The index comes last: a folder without one is no pool.
    put(&dir.join(INDEX_FILE), &json(&drawn.index)?)?;
    Ok(drawn.index)
}

fn put(path: &Path, bytes: &[u8]) -> Result<(), PoolError> {
    std::fs::write(path, bytes).map_err(|source| PoolError::File { file: display_path(path), source })
}

fn json<T: serde::Serialize>(value: &T) -> Result<Vec<u8>, PoolError> {
    let mut bytes = serde_json::to_vec_pretty(value)
        .map_err(|error| PoolError::Content { file: INDEX_FILE.to_owned(), problem: error.to_string() })?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// A candidate that has no name yet: its kind, the truth's word for it, and the draft.
type UnnamedCandidate = (CandidateKind, String, Draft);

fn draw_set(
    spec: PoolSpec,
    family: &str,
    set: u32,
    baseline: &Capability,
    recipes: &[Recipe],
) -> Result<Vec<UnnamedCandidate>, PoolError> {
    let mut stream = stream_of(spec.seed, family, "mechanisms", set, 0);
    let mut interface = INTERFACE;
    let mut permission = PERMISSION;
    shuffle(&mut interface, &mut stream);
    shuffle(&mut permission, &mut stream);
    // One order of the ways a set: two candidates of a kind are made in different ones.
    let (listed, mut ordered): (Vec<&Recipe>, Vec<&Recipe>) = recipes
        .iter()
        .filter(|recipe| recipe.family.as_str() == family)
        .partition(|recipe| recipe.makes == RecipeKind::Listed);
    shuffle(&mut ordered, &mut stream);
    ordered.sort_by_key(|recipe| !recipe.first);
    let recipes_for = |makes: RecipeKind| -> Vec<&Recipe> {
        ordered.iter().copied().filter(|recipe| recipe.makes == makes).collect()
    };
    let plain = recipes_for(RecipeKind::Plain);
    let mut candidates = Vec::new();
    for (place, kind) in spec.preset.kinds().into_iter().enumerate() {
        let mut draft = Draft::of(baseline)?;
        let place = u32::try_from(place).unwrap_or(u32::MAX);
        let mut stream = stream_of(spec.seed, family, "candidate", set, place);
        if !matches!(kind, CandidateKind::Mutant | CandidateKind::Unchanged | CandidateKind::Negligible) {
            for recipe in &plain {
                apply(recipe, &mut draft, &mut stream);
            }
        }
        let mechanism = match kind {
            CandidateKind::Interface(which) => structural(&interface, which, &mut draft, family, &mut stream),
            CandidateKind::Permission(which) => {
                structural(&permission, which, &mut draft, family, &mut stream)
            }
            CandidateKind::Behavior(which) | CandidateKind::Recovery(which) => {
                by_recipe(&recipes_for(RecipeKind::of(kind)), which, kind, &mut draft, &mut stream)
            }
            CandidateKind::Improved
            | CandidateKind::Lateral
            | CandidateKind::MinorGain
            | CandidateKind::Efficiency
            | CandidateKind::Robust
            | CandidateKind::Stable
            | CandidateKind::MarginalBehavior
            | CandidateKind::MarginalRecovery => {
                by_recipe(&recipes_for(RecipeKind::of(kind)), 0, kind, &mut draft, &mut stream)
            }
            CandidateKind::Listed(kind) => by_list(kind, &listed, &mut draft, &mut stream),
            CandidateKind::Unchanged => Some("unchanged".to_owned()),
            CandidateKind::Negligible => {
                mutant::nudge(&mut draft, baseline, &mut stream)?;
                Some("negligible".to_owned())
            }
            CandidateKind::Mutant => {
                mutant::damage(&mut draft, baseline, &mut stream)?;
                Some("mutant".to_owned())
            }
            CandidateKind::Component(_) => {
                let fault = kind.fault().unwrap_or(Kind::Honest);
                component_faults::write(fault, &mut draft, &mut stream)?;
                Some(format!("code-{}", fault.name()))
            }
        };
        let mechanism = mechanism.ok_or_else(|| PoolError::Generated {
            name: format!("{family} {kind:?}"),
            problem: "the table has no recipe for it".to_owned(),
        })?;
        candidates.push((kind, mechanism, draft));
    }
    Ok(candidates)
}

fn structural(
    mechanisms: &[Mechanism],
    which: u8,
    draft: &mut Draft,
    family: &str,
    stream: &mut Stream,
) -> Option<String> {
    let (name, change) = mechanisms.get(usize::from(which))?;
    change(draft, family, stream);
    Some((*name).to_owned())
}

fn by_recipe(
    recipes: &[&Recipe],
    which: u8,
    kind: CandidateKind,
    draft: &mut Draft,
    stream: &mut Stream,
) -> Option<String> {
    let recipe = recipes.get(usize::from(which))?;
    apply(recipe, draft, stream);
    let name = match kind {
        CandidateKind::Improved => "improved",
        CandidateKind::Lateral => "lateral",
        CandidateKind::MinorGain => "minor-gain",
        CandidateKind::Efficiency => "efficiency",
        CandidateKind::Robust => "robust",
        CandidateKind::Stable => "stable",
        CandidateKind::Interface(_) => "interface",
        CandidateKind::Permission(_) => "permission",
        CandidateKind::Behavior(_) => "behavior",
        CandidateKind::Recovery(_) => "recovery",
        CandidateKind::MarginalBehavior => "marginal-behavior",
        CandidateKind::MarginalRecovery => "marginal-recovery",
        CandidateKind::Listed(listed) => listed.name(),
        CandidateKind::Unchanged => "unchanged",
        CandidateKind::Negligible => "negligible",
        CandidateKind::Mutant | CandidateKind::Component(_) => "mutant",
    };
    let named = !recipe.mechanism.is_empty() && kind.class() == super::Class::Faulty;
    Some(if named { format!("{name}-{}", recipe.mechanism) } else { name.to_owned() })
}

/// A kind of appendix C: by its recipe, if parameters make it, and by what stands in the manifest.
fn by_list(listed: Listed, recipes: &[&Recipe], draft: &mut Draft, stream: &mut Stream) -> Option<String> {
    if listed.has_recipe() {
        let named = |recipe: &&&Recipe| recipe.mechanism == listed.name();
        apply(recipes.iter().find(named)?, draft, stream);
    }
    listed.write(draft, stream);
    Some(listed.name().to_owned())
}

/// Writes a recipe into a draft; every draw is made, in the table's order.
fn apply(recipe: &Recipe, draft: &mut Draft, stream: &mut Stream) {
    for (name, value) in &recipe.set {
        draft.param(name, value.clone());
    }
    // A hand that opens when it is stopped is a command, and what a version sends it has to declare.
    if recipe.set.get("abort").and_then(Value::as_str) == Some("release") {
        draft.add_list_item(&["permissions", "channels"], "gripper");
        draft.add_list_item(&["permissions", "commands"], "gripper");
    }
    for (name, range) in &recipe.real {
        draft.param(name, number(stream, *range));
    }
    for (name, range) in &recipe.whole {
        draft.param(name, i64::from(sample_integer(stream, *range)));
    }
    if let Some(range) = recipe.stop_time_ms {
        let path = ["recovery", "safe_abort", "stop_time_max_ms"];
        draft.field(&path, i64::from(sample_integer(stream, range)));
    }
    for (name, value) in [("max_speed_m_s", recipe.max_speed_m_s), ("max_force_n", recipe.max_force_n)] {
        if let Some(value) = value {
            draft.field(&["permissions", name], value);
        }
    }
}

/// Uniform in a range, to four decimals, as a person may write it.
pub(super) fn number(stream: &mut Stream, [low, high]: [f64; 2]) -> f64 {
    (stream.uniform(low, high) * 1e4).round() / 1e4
}

/// Uniform among whole numbers, both ends included.
pub(super) fn sample_integer(stream: &mut Stream, [low, high]: [u32; 2]) -> u32 {
    let span = u64::from(high.saturating_sub(low)) + 1;
    low + u32::try_from(stream.bits() % span).unwrap_or(0)
}

/// Puts items into an order that the stream draws.
pub(crate) fn shuffle<T>(items: &mut [T], stream: &mut Stream) {
    for last in (1..items.len()).rev() {
        let other = sample_integer(stream, [0, u32::try_from(last).unwrap_or(u32::MAX)]);
        items.swap(last, other as usize);
    }
}

/// Distinct versions above 1.0.0, in an order without meaning.
fn versions(count: usize, stream: &mut Stream) -> Vec<semver::Version> {
    let mut taken = BTreeSet::new();
    let mut found = Vec::with_capacity(count);
    let minors = u32::try_from(count / 4).unwrap_or(u32::MAX).saturating_add(9);
    while found.len() < count {
        let (minor, patch) = (sample_integer(stream, [1, minors]), sample_integer(stream, [0, 9]));
        if taken.insert((minor, patch)) {
            found.push(semver::Version::new(1, u64::from(minor), u64::from(patch)));
        }
    }
    found
}

fn submission(stream: &mut Stream) -> Table {
    let mut choose = |options: &[&str]| {
        let last = u32::try_from(options.len()).unwrap_or(1).saturating_sub(1);
        options.get(sample_integer(stream, [0, last]) as usize).copied().unwrap_or_default().to_owned()
    };
    let mut table = Table::new();
    table.insert("author".to_owned(), Value::from(choose(&AUTHORS)));
    let provenances = Provenance::ALL.map(Provenance::name);
    table.insert("provenance".to_owned(), Value::from(choose(&provenances)));
    table.insert("parent".to_owned(), Value::from("1.0.0"));
    table.insert("estimated_risk".to_owned(), Value::from(choose(&["low", "low", "medium"])));
    table.insert("summary".to_owned(), Value::from(choose(&packages::SUMMARIES)));
    table
}

/// The stream of one thing to draw.
fn stream_of(seed: u64, family: &str, what: &str, set: u32, place: u32) -> Stream {
    let purpose = match seed {
        PAPER_FROM.. => "paper",
        CALIBRATION_FROM.. => "calibration",
        _ => "experiment",
    };
    let at = format!("{seed}/{set}/{place}");
    let parts = [purpose.as_bytes(), family.as_bytes(), what.as_bytes(), at.as_bytes()];
    let digest = Digest::of_parts("holdpoint.pool.v1", &parts);
    let state = digest.bytes().iter().take(8).fold(0_u64, |state, byte| state << 8 | u64::from(*byte));
    Stream::from_state(state)
}
