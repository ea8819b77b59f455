//! Versions whose own task is as good as before and whose handover is not: the verdict of their own pairs, and what
//! whole sequences add. The expectations were written before the run over five seeds. The cases were found on another
//! seed, because baselines measure their input and compensate for most of it. Of 70, 66 had the expected result: under
//! one of the five seeds all four bad ones were inconclusive and not rejected.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_body::TaskKind;
use holdpoint_cell::rng::Stream;
use holdpoint_governance::behavior::{
    self, BehaviorAssessment, SequenceComparison, SequenceEvidence, SequencePair, SequenceStep,
};
use holdpoint_governance::finding::Finding;
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
use holdpoint_trials::sequences::{TrialTeam, run_sequence};
use holdpoint_trials::trial_lab::TrialSubject;
use holdpoint_trials::worker::Worker;
use holdpoint_trials::worker_pool::{PoolJob, WorkerPool};
use toml::{Table, Value};

use crate::candidate_pool::draft::Draft;
use crate::harm_cases::{assessment_text, judge, pairs_of};

/// Cell, rules and baselines.
struct SequenceBench {
    cell: Cell,
    profile: Profile,
    terms: SkillTerms,
    baselines: BTreeMap<TaskKind, Capability>,
}

impl SequenceBench {
    fn new() -> Self {
        let (cell, profile) =
            (Cell::of(&SimCells, None).unwrap(), Profile::builtin(ProfileName::Sim).unwrap());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let works = |version: &Capability| TaskKind::named(version.id().family.as_str());
        let baselines = embedded::baselines().unwrap().into_iter();
        let baselines = baselines.filter_map(|version| Some((works(&version)?, version))).collect();
        Self { cell, profile, terms, baselines }
    }

    /// The baseline of a task with some of its parameter file replaced.
    fn altered_version(&self, task: TaskKind, changes: &str) -> Capability {
        let baseline = &self.baselines[&task];
        let mut draft = Draft::of(baseline).unwrap();
        for (name, value) in changes.parse::<Table>().unwrap() {
            if name == "declared_n" {
                draft.field(&["permissions", "max_force_n"], value);
            } else {
                draft.param(&name, value);
            }
        }
        draft.field(&["version"], Value::from("1.0.1"));
        let submission: Table = baseline.package.submission.parse().unwrap();
        Capability::load("case", draft.package(&submission)).unwrap()
    }

    fn trial_subject(&self, version: &Capability) -> TrialSubject {
        let declared = &version.manifest.permissions;
        let terms = self.terms.clone().capped(declared.max_speed_m_s, declared.max_force_n);
        TrialSubject { version: version.clone(), terms, fallback: None }
    }

    fn episodes(&self, version: &Capability, run: u64, pairs: u64) -> Vec<TaskRecord> {
        let seeds = (0..pairs).map(|index| episode_seed(run, SeedPurpose::Perturbation, index));
        let (worker_pool, cancel) = (WorkerPool::new(2), AtomicBool::new(false));
        let terms = self.trial_subject(version).terms;
        batch(&worker_pool, &cancel, &self.cell, (version, &terms), Conditions::Sandbox, seeds).unwrap()
    }

    fn sequences(
        &self,
        version: &Capability,
        beside: &[Capability],
        run: u64,
        count: u64,
    ) -> Vec<Vec<TaskRecord>> {
        let task = version.bundle.task();
        let others = self
            .baselines
            .values()
            .filter(|other| !beside.iter().any(|known| known.bundle.task() == other.bundle.task()));
        let beside = others.chain(beside).map(|other| self.trial_subject(other));
        let team = TrialTeam::excluding(&self.cell.spec.tasks, task, beside);
        let shared = Arc::new((self.cell.clone(), team, self.trial_subject(version)));
        let job = |index| {
            let (seed, shared) = (episode_seed(run, SeedPurpose::Sequence, index), Arc::clone(&shared));
            let work = move |worker: &mut Worker| {
                let (cell, team, own) = &*shared;
                run_sequence(worker, cell, &team.lineup_with(&cell.spec.tasks, own).unwrap(), seed)
            };
            PoolJob { key: Digest::of_parts("case", &[&seed.to_le_bytes()]), work: Box::new(work) }
        };
        let worker_pool: WorkerPool<Vec<TaskRecord>> = WorkerPool::new(2);
        worker_pool.run_jobs((0..count).map(job).collect(), &AtomicBool::new(false)).unwrap()
    }

    fn evidence(
        &self,
        task: TaskKind,
        active: &[Vec<TaskRecord>],
        candidate: &[Vec<TaskRecord>],
    ) -> SequenceEvidence {
        let steps = |records: &[TaskRecord]| -> Option<Vec<SequenceStep>> {
            records.iter().map(|one| Some(SequenceStep { task: one.task, values: one.values()? })).collect()
        };
        let pair = |(old, new): (&Vec<TaskRecord>, &Vec<TaskRecord>)| {
            let seed = old.first()?.seed;
            Some(SequencePair { seed, active: steps(old)?, candidate: steps(new)? })
        };
        let pairs: Vec<SequencePair> = active.iter().zip(candidate).filter_map(pair).collect();
        let others = self.baselines.iter().filter(|(other, _)| **other != task);
        SequenceEvidence {
            task,
            sequence: self.cell.spec.tasks.clone(),
            beside: others.map(|(_, version)| version.id()).collect(),
            wanted: u32::try_from(pairs.len()).unwrap(),
            pairs,
        }
    }
}

/// The expected result of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SequenceExpectation {
    /// Compatible by its own pairs, and incompatible by its sequences, because the next skill fails.
    BadHandover,
    /// Compatible by both.
    Kept,
}

struct SequenceCase {
    name: &'static str,
    task: TaskKind,
    /// The differences from the baseline's parameters.
    changes: &'static str,
    /// The version beside it that is not a baseline.
    beside: &'static [(TaskKind, &'static str)],
    expected: SequenceExpectation,
}

use SequenceExpectation::{BadHandover, Kept};
use TaskKind::{Align, Grasp, Place};

/// An align that assumes the object in the middle of the gripper, where the baseline measures it.
const TRUSTING: &[(TaskKind, &str)] = &[(Align, "measure_pictures = 0")];

/// A place that lowers slowly and has little time: enough for an object that hangs 50 mm above its target.
const UNHURRIED: &[(TaskKind, &str)] =
    &[(Place, "lower_speed_m_s = 0.025\ntimeout_secs = 3.6\nretries_max = 0")];

const fn case(
    name: &'static str,
    task: TaskKind,
    changes: &'static str,
    beside: &'static [(TaskKind, &'static str)],
    expected: SequenceExpectation,
) -> SequenceCase {
    SequenceCase { name, task, changes, beside, expected }
}

const CASES: &[SequenceCase] = &[
    case(
        "holds 12 mm off the middle",
        Grasp,
        "alteration = [{ kind = \"input\", input = \"object-x\", offset = 0.012 }]",
        TRUSTING,
        BadHandover,
    ),
    case(
        "holds 8 mm off the middle",
        Grasp,
        "alteration = [{ kind = \"input\", input = \"object-x\", offset = 0.008 }]",
        TRUSTING,
        BadHandover,
    ),
    case("holds the upper edge", Grasp, "grasp_offset_m = 0.024", TRUSTING, BadHandover),
    case("ends high over the tray", Align, "hover_height_m = 0.067", UNHURRIED, BadHandover),
    // The same versions beside baselines, which compensate.
    case(
        "holds 8 mm off the middle, and it is measured",
        Grasp,
        "alteration = [{ kind = \"input\", input = \"object-x\", offset = 0.008 }]",
        &[],
        Kept,
    ),
    case("holds the upper edge, and it is measured", Grasp, "grasp_offset_m = 0.024", &[], Kept),
    case("ends high, and there is time", Align, "hover_height_m = 0.067", &[], Kept),
    // Nothing worse.
    case("slower", Grasp, "approach_speed_m_s = 0.28\nlift_speed_m_s = 0.24", &[], Kept),
    case("gentler", Grasp, "grip_force_n = 16.5\nclose_speed_m_s = 0.1", &[], Kept),
    case("higher approach", Grasp, "approach_height_m = 0.11\nlift_height_m = 0.145", &[], Kept),
    case("sets down slower", Place, "lower_speed_m_s = 0.08\nretreat_speed_m_s = 0.25", &[], Kept),
    case("looks longer", Align, "measure_pictures = 12\ntolerance_m = 0.0018", &[], Kept),
    case(
        "slower, beside one that trusts",
        Grasp,
        "approach_speed_m_s = 0.28\nlift_speed_m_s = 0.24",
        TRUSTING,
        Kept,
    ),
    case(
        "looks longer, beside one in a hurry",
        Align,
        "measure_pictures = 12\ntolerance_m = 0.0018",
        UNHURRIED,
        Kept,
    ),
];

/// The results of baselines under a run's seed: episodes by task, sequences by task and the versions beside.
#[derive(Default)]
struct BaselineRecords {
    episodes: BTreeMap<TaskKind, Vec<TaskRecord>>,
    sequences: BTreeMap<(TaskKind, String), Vec<Vec<TaskRecord>>>,
}

/// The verdict on a case by its own pairs, and then with its sequences.
fn assess_case(
    bench: &SequenceBench,
    case: &SequenceCase,
    known: &mut BaselineRecords,
    run: u64,
    (pairs, count): (u64, u64),
) -> (BehaviorAssessment, BehaviorAssessment) {
    let baseline = &bench.baselines[&case.task];
    let version = bench.altered_version(case.task, case.changes);
    let beside: Vec<Capability> =
        case.beside.iter().map(|(task, changes)| bench.altered_version(*task, changes)).collect();
    let own = known.episodes.entry(case.task).or_insert_with(|| bench.episodes(baseline, run, pairs));
    let alone = judge(pairs_of(own, &bench.episodes(&version, run, pairs)), &bench.profile);
    let who = (case.task, format!("{:?}", case.beside));
    let old = known.sequences.entry(who).or_insert_with(|| bench.sequences(baseline, &beside, run, count));
    let evidence = bench.evidence(case.task, old, &bench.sequences(&version, &beside, run, count));
    let mut whole = alone.clone();
    behavior::apply_sequences(&mut whole, Some(&evidence), &bench.profile);
    (alone, whole)
}

fn is_as_expected(case: &SequenceCase, alone: &BehaviorAssessment, whole: &BehaviorAssessment) -> bool {
    let next = TaskKind::SEQUENCE.into_iter().find(|next| *next > case.task);
    match case.expected {
        BadHandover => {
            let is_found = next.is_some_and(|next| {
                whole.assessment.reasons.iter().any(|reason| match &reason.finding {
                    Some(Finding::SequenceWorse { ends: Some(ends), .. }) => {
                        ends.is_next && ends.task == next
                    }
                    _ => false,
                })
            });
            alone.assessment.outcome == BehaviorOutcome::Compatible
                && whole.assessment.outcome == BehaviorOutcome::Incompatible
                && is_found
        }
        Kept => {
            whole.assessment == alone.assessment && whole.assessment.outcome == BehaviorOutcome::Compatible
        }
    }
}

#[test]
fn grip_at_the_edge_passes_alone_and_fails_in_sequences() {
    let bench = SequenceBench::new();
    let count = u64::from(bench.profile.evaluation.sandbox_sequences);
    let mut known = BaselineRecords::default();
    for name in ["holds the upper edge", "holds the upper edge, and it is measured"] {
        let case = CASES.iter().find(|case| case.name == name).unwrap();
        let (alone, whole) = assess_case(&bench, case, &mut known, CALIBRATION_FROM_RUN, (120, count));
        assert!(
            is_as_expected(case, &alone, &whole),
            "{name}: {}; {}",
            assessment_text(&alone),
            assessment_text(&whole)
        );
    }
}

fn number(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual)
}

/// The whole table over five seeds with the profile's budgets, where `SEQUENCE_TABLE` asks for it: some minutes.
#[test]
fn all_sequence_cases_hold_over_five_seeds() {
    if std::env::var("SEQUENCE_TABLE").is_err() {
        return;
    }
    let bench = SequenceBench::new();
    let settings = &bench.profile.evaluation;
    let budget = (u64::from(settings.sandbox_pairs), u64::from(settings.sandbox_sequences));
    let mut wrong = 0;
    for run in (0..5).map(|seed| CALIBRATION_FROM_RUN + 30 + seed) {
        let mut known = BaselineRecords::default();
        for case in CASES {
            let (alone, whole) = assess_case(&bench, case, &mut known, run, budget);
            let is_right = is_as_expected(case, &alone, &whole);
            wrong += u32::from(!is_right);
            let mark = if is_right { "as expected" } else { "OTHERWISE" };
            println!(
                "run {run} {}: {mark} {:?}; alone {}; with sequences {}",
                case.name,
                case.expected,
                assessment_text(&alone),
                assessment_text(&whole)
            );
        }
    }
    println!("{wrong} otherwise than expected");
}

/// Pairs sampled with replacement; `change` gets each with the sample's number.
fn redrawn(
    measured: &SequenceEvidence,
    stream: &mut Stream,
    count: u32,
    change: &dyn Fn(&mut SequencePair, &mut Stream),
) -> SequenceEvidence {
    let pairs = (0..count).map(|seed| {
        #[allow(clippy::cast_possible_truncation)]
        let at = (stream.bits() % measured.pairs.len() as u64) as usize;
        let mut pair = SequencePair { seed: u64::from(seed), ..measured.pairs[at].clone() };
        change(&mut pair, stream);
        pair
    });
    SequenceEvidence { wanted: count, pairs: pairs.collect(), ..measured.clone() }
}

/// Prints how often sequences raise a concern or reject a version: an equally good one, and one whose next skill fails at a
/// given rate. `SEQUENCE_RUNS` is the number of evaluations. Equally good: a `Kept` case, once as measured, and once with
/// the two sides of each pair swapped by a coin toss.
#[test]
fn error_rates_and_power_of_sequences_are_measured() {
    let runs = number("SEQUENCE_RUNS", 0);
    if runs == 0 {
        return;
    }
    let bench = SequenceBench::new();
    let run = CALIBRATION_FROM_RUN + 50;
    let mut stream = Stream::from_state(0x5e90_e4ce);
    let share = |evidence: &dyn Fn(&mut Stream) -> SequenceEvidence, stream: &mut Stream| {
        let mut counts = [0_u64; 2];
        for _ in 0..runs {
            let found = evidence(stream).compare(&bench.profile);
            counts[0] += u64::from(found.iter().any(SequenceComparison::is_concern));
            counts[1] += u64::from(found.iter().any(SequenceComparison::is_established));
        }
        counts
    };
    for name in ["slower", "gentler", "higher approach", "sets down slower", "looks longer"] {
        let case = CASES.iter().find(|case| case.name == name).unwrap();
        let sides = [bench.baselines[&case.task].clone(), bench.altered_version(case.task, case.changes)];
        let [old, new] = sides.map(|one| bench.sequences(&one, &[], run, 250));
        let measured = bench.evidence(case.task, &old, &new);
        for count in [50, 60] {
            let swap = |pair: &mut SequencePair, stream: &mut Stream| {
                if stream.chance(0.5) {
                    std::mem::swap(&mut pair.active, &mut pair.candidate);
                }
            };
            let equal = share(&|stream| redrawn(&measured, stream, count, &swap), &mut stream);
            let as_is = share(&|stream| redrawn(&measured, stream, count, &|_, _| ()), &mut stream);
            println!("{name}, {count} sequences, of {runs}: swapped {equal:?}, as measured {as_is:?}");
            if case.task == Place {
                continue;
            }
            for rate in [0.3, 0.5, 0.8] {
                let next = TaskKind::SEQUENCE.into_iter().find(|next| *next > case.task).unwrap();
                let fails = |pair: &mut SequencePair, stream: &mut Stream| {
                    let at = pair.candidate.iter().position(|step| step.task == next);
                    if let Some(at) = at.filter(|_| stream.chance(rate)) {
                        pair.candidate.truncate(at + 1);
                        pair.candidate[at].values.success = false;
                    }
                };
                let worse = share(&|stream| redrawn(&measured, stream, count, &fails), &mut stream);
                println!("{name}, {count} sequences, next fails in {rate} more: {worse:?}");
            }
        }
    }
}
