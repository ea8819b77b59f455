//! Versions that harm, made from the baselines one parameter at a time, and versions that do not: the result of the
//! comparison of behavior for each. The expectations were written before the first run. Two of them named another
//! measure than the one that finds the case. For the firmer grip it was the peak, where the sustained force varies
//! less. For the hard landing it was the landing speed, where the tool's jerk is found first.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_body::TaskKind;
use holdpoint_governance::behavior::{self, BehaviorAssessment};
use holdpoint_governance::evidence::{EvidenceBinding, Pair, PairedEvidence};
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::embedded;
use holdpoint_trials::episodes::batch;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};
use holdpoint_trials::worker_pool::WorkerPool;
use toml::{Table, Value};

use crate::candidate_pool::draft::Draft;

/// The expected result of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum HarmExpectation {
    /// Incompatible, with this measure among the reasons.
    Harms(HarmKind),
    /// Not compatible, for any reason.
    Stopped,
    /// Compatible: no measure is worse.
    Kept,
    /// The sandbox's episodes do not show it: no measure moves. Listed here so that it is not taken for covered.
    Unseen,
}

struct HarmCase {
    name: &'static str,
    task: TaskKind,
    params: &'static [(&'static str, f64)],
    declared_n: Option<f64>,
    expected: HarmExpectation,
}

const fn case(
    name: &'static str,
    task: TaskKind,
    params: &'static [(&'static str, f64)],
    expected: HarmExpectation,
) -> HarmCase {
    HarmCase { name, task, params, declared_n: None, expected }
}

use HarmExpectation::{Harms, Kept, Stopped, Unseen};
use TaskKind::{Align, Grasp, Place};

const CASES: &[HarmCase] = &[
    // More grip force, declared: 18 N baseline, 25.2 N measured.
    HarmCase {
        declared_n: Some(30.0),
        ..case("grip +40 %", Grasp, &[("grip_force_n", 25.2)], Harms(HarmKind::GripHeld))
    },
    HarmCase {
        declared_n: Some(36.0),
        ..case("grip +65 %", Grasp, &[("grip_force_n", 29.7)], Harms(HarmKind::GripPeak))
    },
    // More than is declared: 25 N.
    case("asks 38 N, declares 25", Grasp, &[("grip_force_n", 38.0)], Harms(HarmKind::ExcessDepth)),
    case("asks 28 N, declares 25", Grasp, &[("grip_force_n", 28.0)], Harms(HarmKind::ExcessDepth)),
    // Opens the gripper above the surface: a fall of about 20 and 7 mm.
    case("drops from 30 mm", Place, &[("release_gap_m", 0.03)], Harms(HarmKind::DropHeight)),
    case("drops from 15 mm", Place, &[("release_gap_m", 0.015)], Harms(HarmKind::DropHeight)),
    // Opens the gripper before the object is down.
    case(
        "releases early",
        Place,
        &[("release_gap_m", 0.01), ("settle_secs", 0.0)],
        Harms(HarmKind::LandingSpeed),
    ),
    case(
        "releases early and fast",
        Place,
        &[("release_gap_m", 0.012), ("release_speed_m_s", 0.4)],
        Harms(HarmKind::LandingSpeed),
    ),
    // Comes in hard.
    case("slams the hand shut", Grasp, &[("close_speed_m_s", 0.6)], Harms(HarmKind::TouchSpeed)),
    case(
        "slams the object down",
        Place,
        &[("lower_speed_m_s", 0.4), ("contact_force_n", 30.0)],
        // Jerk was significant until its margin had to let an honest, faster retreat pass; landing speed and force are
        // inconclusive.
        Stopped,
    ),
    case(
        "strikes what it grasps",
        Grasp,
        &[("descend_speed_m_s", 0.4), ("contact_speed_m_s", 0.35), ("contact_stop_n", 60.0)],
        Stopped,
    ),
    // A bet on latency: it harms if camera frames are late, and the sandbox's are not.
    case("does not settle", Grasp, &[("settle_secs", 0.0)], Unseen),
    // Too weak for the heavier objects.
    case("holds with 2 N", Grasp, &[("grip_force_n", 2.0), ("slip_check", 0.0)], Stopped),
    case("holds with 1.5 N", Grasp, &[("grip_force_n", 1.5), ("slip_check", 0.0)], Stopped),
    // Nothing worse.
    case("slower", Grasp, &[("approach_speed_m_s", 0.28), ("lift_speed_m_s", 0.24)], Kept),
    case("gentler", Grasp, &[("grip_force_n", 16.5), ("close_speed_m_s", 0.1)], Kept),
    case("higher approach", Grasp, &[("approach_height_m", 0.11), ("lift_height_m", 0.145)], Kept),
    case("sets down slower", Place, &[("lower_speed_m_s", 0.08), ("retreat_speed_m_s", 0.25)], Kept),
    case("looks longer", Align, &[("measure_pictures", 12.0), ("tolerance_m", 0.0018)], Kept),
];

/// Cell, rules and baselines.
struct HarmBench {
    cell: Cell,
    profile: Profile,
    terms: SkillTerms,
    baselines: BTreeMap<&'static str, Capability>,
}

impl HarmBench {
    fn new(name: ProfileName) -> Self {
        let (cell, profile) = (Cell::of(&SimCells, None).unwrap(), Profile::builtin(name).unwrap());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let baselines = embedded::baselines().unwrap().into_iter();
        let baselines = baselines
            .filter_map(|version| {
                let task = TaskKind::named(version.id().family.as_str())?;
                Some((task.name(), version))
            })
            .collect();
        Self { cell, profile, terms, baselines }
    }

    fn altered_version(&self, case: &HarmCase) -> Capability {
        let baseline = &self.baselines[case.task.name()];
        let mut draft = Draft::of(baseline).unwrap();
        for (name, value) in case.params {
            let value = match draft.params.get(*name).unwrap() {
                Value::Boolean(_) => Value::Boolean(*value != 0.0),
                #[allow(clippy::cast_possible_truncation)]
                Value::Integer(_) => Value::Integer(*value as i64),
                _ => Value::Float(*value),
            };
            draft.param(name, value);
        }
        if let Some(declared) = case.declared_n {
            draft.field(&["permissions", "max_force_n"], declared);
        }
        draft.field(&["version"], "1.0.1");
        let submission: Table = baseline.package.submission.parse().unwrap();
        Capability::load(case.name, draft.package(&submission)).unwrap()
    }

    fn work(
        &self,
        worker_pool: &WorkerPool<TaskRecord>,
        version: &Capability,
        run: u64,
        pairs: u64,
    ) -> Vec<TaskRecord> {
        let declared = &version.manifest.permissions;
        let terms = self.terms.clone().capped(declared.max_speed_m_s, declared.max_force_n);
        let seeds = (0..pairs).map(|index| episode_seed(run, SeedPurpose::Perturbation, index));
        let cancel = AtomicBool::new(false);
        batch(worker_pool, &cancel, &self.cell, (version, &terms), Conditions::Sandbox, seeds).unwrap()
    }

    fn assess(&self, active: &[TaskRecord], candidate: &[TaskRecord]) -> BehaviorAssessment {
        judge(pairs_of(active, candidate), &self.profile)
    }
}

pub(super) fn pairs_of(active: &[TaskRecord], candidate: &[TaskRecord]) -> Vec<Pair> {
    let both = active.iter().zip(candidate);
    both.filter_map(|(old, new)| {
        let (active, candidate) = (old.values()?, new.values()?);
        Some(Pair { seed: old.seed, active, candidate, live_like: false })
    })
    .collect()
}

fn binding() -> EvidenceBinding {
    let digest = Digest::of_parts("test", &[]);
    EvidenceBinding {
        candidate: digest,
        active: Some(digest),
        profile: digest,
        policy: digest,
        environment: digest,
        neighbours: None,
        anchor: None,
    }
}

/// The assessment of these pairs, with a budget of their number.
pub(super) fn judge(pairs: Vec<Pair>, profile: &Profile) -> BehaviorAssessment {
    let mut profile = profile.clone();
    profile.evaluation.sandbox_pairs = u32::try_from(pairs.len()).unwrap();
    let evidence = PairedEvidence { binding: binding(), pairs, hard_stops: Vec::new() };
    behavior::assess(&evidence, &binding(), &profile)
}

/// Whether the result is the expected one.
fn is_as_expected(expected: HarmExpectation, found: &BehaviorAssessment) -> bool {
    let outcome = found.assessment.outcome;
    match expected {
        Harms(kind) => {
            let is_found = found.harm.iter().any(|harm| harm.kind == kind && harm.is_established());
            outcome == BehaviorOutcome::Incompatible && is_found
        }
        Stopped => matches!(outcome, BehaviorOutcome::Incompatible | BehaviorOutcome::Suspicious),
        Kept | Unseen => outcome == BehaviorOutcome::Compatible,
    }
}

pub(super) fn assessment_text(found: &BehaviorAssessment) -> String {
    let reasons: Vec<String> = found.assessment.reasons.iter().map(holdpoint_wording::line).collect();
    format!("{:?}: {}", found.assessment.outcome, reasons.join("; "))
}

fn named(name: &str) -> &'static HarmCase {
    CASES.iter().find(|case| case.name == name).unwrap()
}

/// Part of the table in an ordinary run: the cases that need a single family's baseline once.
fn print_cases(names: &[&str], pairs: u64) {
    let (bench, worker_pool) = (HarmBench::new(ProfileName::Sim), WorkerPool::new(1));
    let task = named(names[0]).task;
    let active = bench.work(&worker_pool, &bench.baselines[task.name()], CALIBRATION_FROM_RUN, pairs);
    for name in names {
        let case = named(name);
        let candidate = bench.work(&worker_pool, &bench.altered_version(case), CALIBRATION_FROM_RUN, pairs);
        let found = bench.assess(&active, &candidate);
        assert!(is_as_expected(case.expected, &found), "{name}: {}", assessment_text(&found));
    }
}

#[test]
fn a_place_that_drops_is_stopped_and_a_slower_one_is_not() {
    // Of 120 pairs of equally good versions one in six is doubted, of 200 one in 25.
    print_cases(&["drops from 30 mm", "slams the object down", "sets down slower"], 200);
}

#[test]
fn success_does_not_excuse_excess_force() {
    print_cases(&["grip +40 %", "asks 38 N, declares 25", "slams the hand shut"], 80);
}

/// The whole table over five seeds, under the profiles that `HARM_PROFILES` names; without it, nothing: half an hour each.
#[test]
fn all_harm_cases_hold_over_five_seeds() {
    let Ok(wanted) = std::env::var("HARM_PROFILES") else { return };
    let worker_pool = WorkerPool::new(2);
    let mut wrong = 0;
    for name in ProfileName::ALL.into_iter().filter(|name| wanted.is_empty() || wanted.contains(name.name()))
    {
        let bench = HarmBench::new(name);
        let pairs = u64::from(bench.profile.evaluation.sandbox_pairs);
        for run in (0..5).map(|seed| CALIBRATION_FROM_RUN + 10 + seed) {
            let actives: BTreeMap<_, _> = bench
                .baselines
                .iter()
                .map(|(task, version)| (*task, bench.work(&worker_pool, version, run, pairs)))
                .collect();
            for case in CASES {
                let candidate = bench.work(&worker_pool, &bench.altered_version(case), run, pairs);
                let found = bench.assess(&actives[case.task.name()], &candidate);
                let is_right = is_as_expected(case.expected, &found);
                wrong += u32::from(!is_right);
                let mark = if is_right { "as expected" } else { "OTHERWISE" };
                println!(
                    "{name} run {run} {}: {mark} {:?}: {}",
                    case.name,
                    case.expected,
                    assessment_text(&found)
                );
            }
        }
    }
    println!("{wrong} otherwise than expected");
}

/// A bootstrap sample of the measured pairs.
fn redrawn(measured: &[Pair], seed: u64, pairs: u64) -> Vec<Pair> {
    let mut state = seed;
    let mut draw = |seed| {
        // SplitMix64, as every stream of this program.
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let index = (z ^ (z >> 31)) % measured.len() as u64;
        Pair { seed, ..measured[usize::try_from(index).unwrap()] }
    };
    (0..pairs).map(&mut draw).collect()
}

/// How often an equally good version stays compatible, and how often a worse one is found. The cached pairs of each
/// version are sampled again, and each measure gets worse by fractions of its margin in every episode. As the whole
/// table, under the profiles that `HARM_PROFILES` names.
#[test]
fn error_rates_and_power_of_harm_are_measured() {
    let number = |name: &str, usual: u64| -> u64 {
        std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
    };
    let (runs, shifts) = (number("HARM_RUNS", 500), number("HARM_SHIFTS", 40));
    let Ok(wanted) = std::env::var("HARM_PROFILES") else { return };
    let worker_pool = WorkerPool::new(2);
    for name in ProfileName::ALL.into_iter().filter(|name| wanted.is_empty() || wanted.contains(name.name()))
    {
        let bench = HarmBench::new(name);
        let pairs = u64::from(bench.profile.evaluation.sandbox_pairs);
        for case in CASES.iter().filter(|case| case.expected == Kept) {
            let active =
                bench.work(&worker_pool, &bench.baselines[case.task.name()], CALIBRATION_FROM_RUN + 50, 600);
            let candidate =
                bench.work(&worker_pool, &bench.altered_version(case), CALIBRATION_FROM_RUN + 50, 600);
            let measured = pairs_of(&active, &candidate);
            let past = |pair: &&Pair| pair.active.harm.is_some_and(|harm| bench.profile.harm.is_past(&harm));
            let past = measured.iter().filter(past).count();
            let mut outcomes: BTreeMap<String, u64> = BTreeMap::new();
            for run in 0..runs {
                let found = judge(redrawn(&measured, run, pairs), &bench.profile);
                let harm = found.harm.iter().filter(|harm| !harm.is_within_tolerance());
                let kinds: Vec<&str> = harm.map(|harm| harm.kind.name()).collect();
                let label = format!("{:?} {}", found.assessment.outcome, kinds.join(" "));
                *outcomes.entry(label).or_default() += 1;
            }
            println!(
                "{name} {} {runs} runs, {past} of {} baseline episodes past a limit: {outcomes:?}",
                case.name,
                measured.len()
            );
            for kind in HarmKind::ALL {
                let tolerance = bench.profile.harm.of(kind).mean;
                let mut powers = Vec::new();
                for factor in [0.5, 1.0, 1.25, 1.5, 2.0] {
                    let (mut stopped, mut established) = (0, 0);
                    for run in 0..shifts {
                        let mut worse = redrawn(&measured, run, pairs);
                        for pair in &mut worse {
                            let harm = pair.candidate.harm.as_mut().unwrap();
                            *harm.of_mut(kind) += kind.worsening(1.0, 0.0) * factor * tolerance;
                            *harm = harm.rounded();
                        }
                        let found = judge(worse, &bench.profile);
                        let of = found.harm.iter().find(|harm| harm.kind == kind).unwrap();
                        stopped += u32::from(!of.is_within_tolerance());
                        established += u32::from(of.is_established());
                    }
                    powers.push(format!("{factor}: {stopped}/{established}"));
                }
                println!("{name} {} {kind} ({tolerance}) of {shifts}: {}", case.name, powers.join(", "));
            }
        }
    }
}
