//! The round protocol (paper section 7.8): round 0 has the first versions. In every further round one family yields a
//! candidate, the arm decides, and the active versions run the round's held-out sequences.

use std::collections::BTreeMap;

use holdpoint_governance::ids::{Digest, Family};
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use super::PaperSetup;
use super::active_families::ActiveFamilies;
use super::arm::{Arm, ArmAction, ArmContext, set_digest, version_of};
use super::candidate_stream::{PlantedCandidate, rounds_of};
use super::held_out::{HeldOutSequence, evaluate};
use super::preset::PresetSize;
use crate::candidate_pool::Class;
use crate::ground_truth::{HarmClass, TruthBench};
use crate::pipeline_experiments::{ExperimentError, ProgressFn, workers_each};
use crate::side_by_side::side_by_side;
use crate::wording::progress;

/// A candidate that an arm got, the arm's decision, and the candidate's truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OfferedCandidate {
    pub name: String,
    pub family: Family,
    /// The planted fault.
    pub class: Class,
    pub kind: String,
    pub step: ArmAction,
    /// The referee's harm class for it, compared with the version it replaced; absent if not activated or not judged.
    pub harm: Option<HarmClass>,
    /// The referee finds it significantly worse in something, harm or not.
    pub worse: Option<bool>,
}

/// One arm in one round of one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RoundRow {
    pub seed: u64,
    pub round: u32,
    pub arm: Arm,
    /// Absent in round 0.
    pub offered: Option<OfferedCandidate>,
    /// Digest of the active versions at its end.
    pub in_force: Digest,
    /// A version with a real planted fault is active at its end.
    pub faulty_in_force: bool,
    /// A version that does damage or danger, by the referee, is active at its end; absent if the referee judges none.
    pub harmful_in_force: Option<bool>,
    pub score: HeldOutScore,
}

/// Held-out sequences, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldOutScore {
    pub sequences: u64,
    pub done: u64,
    pub violation: u64,
    pub near: u64,
    pub anomaly: u64,
    /// The arm moved when it was due to be at standstill, by the referee.
    pub moved_on: u64,
    /// How long motion went on after declared failures and stops, ms in all.
    pub continued_ms: u64,
    /// Damage or danger, by the referee.
    pub damage: u64,
    /// Danger, by the referee.
    pub danger: u64,
    pub retries: u64,
    /// Mean time of the sequences that were done, s; 0 without one.
    pub time_s: f64,
}

impl HeldOutScore {
    /// Counts sequences.
    #[must_use]
    pub fn of(sequences: &[HeldOutSequence]) -> Self {
        let count = |of: fn(&HeldOutSequence) -> bool| sequences.iter().filter(|one| of(one)).count() as u64;
        let done: Vec<f64> = sequences.iter().filter(|one| one.done).map(|one| one.time_s).collect();
        Self {
            sequences: sequences.len() as u64,
            done: done.len() as u64,
            violation: count(|one| one.violation),
            near: count(|one| one.near),
            anomaly: count(|one| one.anomaly),
            moved_on: count(|one| one.moved_on),
            continued_ms: sequences.iter().map(|one| one.continued_ms).sum(),
            damage: count(|one| one.harm >= HarmClass::Damage),
            danger: count(|one| one.harm >= HarmClass::Danger),
            retries: sequences.iter().map(|one| u64::from(one.retries)).sum(),
            time_s: done.iter().sum::<f64>() / done.len().max(1) as f64,
        }
    }
}

/// Runs the rounds of every seed for every arm. The rows come in the order of seeds, arms and rounds.
///
/// # Errors
/// If a candidate does not come to an end, or a result cannot be cached.
pub fn rounds(
    setup: &PaperSetup,
    size: PresetSize,
    arms: &[Arm],
    tell: &ProgressFn<'_>,
) -> Result<Vec<RoundRow>, ExperimentError> {
    let seeds = setup.of_shard(size.run_seeds());
    let workers = workers_each(setup.jobs, seeds.len());
    let of_seeds = side_by_side(
        setup.jobs,
        seeds.len(),
        |worker, at| of_seed((setup, workers), size, arms, seeds[at], worker),
        |at, _| progress::rounds(seeds[at]),
        tell,
    )?;
    Ok(of_seeds.into_iter().flatten().collect())
}

fn of_seed(
    (setup, workers): (&PaperSetup, usize),
    size: PresetSize,
    arms: &[Arm],
    seed: u64,
    worker: &mut Worker,
) -> Result<Vec<RoundRow>, ExperimentError> {
    let upgrades = rounds_of(seed, size.rounds)?;
    let mut verdicts = BTreeMap::new();
    let mut rows = Vec::new();
    for arm in arms {
        let mut run = ArmRun {
            setup,
            workers,
            size,
            seed,
            arm: *arm,
            in_force: ActiveFamilies::first()?,
            planted: BTreeMap::new(),
        };
        rows.push(run.row(worker, 0, None)?);
        for (upgrade, round) in upgrades.iter().zip(1..) {
            let offered = run.offer(worker, upgrade, round, &mut verdicts)?;
            rows.push(run.row(worker, round, Some(offered))?);
        }
    }
    Ok(rows)
}

/// The referee's verdicts on versions, by the versions they were judged beside.
type RefereeCache = BTreeMap<Digest, (HarmClass, bool)>;

/// An arm on its way through the rounds of a seed.
struct ArmRun<'a> {
    setup: &'a PaperSetup,
    /// Workers for one decision.
    workers: usize,
    size: PresetSize,
    seed: u64,
    arm: Arm,
    in_force: ActiveFamilies,
    /// Of the upgrades in force: the planted faults, and the referee's verdicts.
    planted: BTreeMap<Family, (Class, Option<HarmClass>)>,
}

impl ArmRun<'_> {
    fn offer(
        &mut self,
        worker: &mut Worker,
        upgrade: &PlantedCandidate,
        round: u32,
        verdicts: &mut RefereeCache,
    ) -> Result<OfferedCandidate, ExperimentError> {
        let version = version_of(upgrade)?;
        let context = ArmContext {
            setup: self.setup,
            upgrade,
            version: &version,
            before: &self.in_force,
            seed: self.seed,
            round,
            workers: self.workers,
        };
        let step = self.arm.decide(&context, worker)?;
        // Everything is decided: the truth of the version is read only now.
        let truth = if step.activated && self.size.judged_by > 0 {
            let key = set_digest(&version, &self.in_force);
            let known = match verdicts.get(&key) {
                Some(known) => *known,
                None => {
                    let (setup, team) = (self.setup, self.in_force.versions());
                    let bench = TruthBench::with_team(
                        setup.cell.clone(),
                        setup.cache.clone(),
                        team,
                        self.size.judged_by,
                    )?;
                    let truth = bench.truth(worker, bench.judged_version(version.clone()))?;
                    *verdicts.entry(key).or_insert((truth.class, truth.is_worse()))
                }
            };
            Some(known)
        } else {
            None
        };
        if step.in_force {
            self.planted
                .insert(upgrade.family.clone(), (upgrade.planted.class, truth.map(|(class, _)| class)));
            self.in_force = self.in_force.with(version, step.restricted);
        }
        Ok(OfferedCandidate {
            name: upgrade.name.clone(),
            family: upgrade.family.clone(),
            class: upgrade.planted.class,
            kind: upgrade.planted.kind.clone(),
            step,
            harm: truth.map(|(class, _)| class),
            worse: truth.map(|(_, worse)| worse),
        })
    }

    fn row(
        &self,
        worker: &mut Worker,
        round: u32,
        offered: Option<OfferedCandidate>,
    ) -> Result<RoundRow, ExperimentError> {
        let sequences = evaluate(self.setup, worker, &self.in_force, self.seed, round, self.size.sequences)?;
        let is_faulty = |class: Class| matches!(class, Class::Faulty | Class::Marginal);
        let harmful = |harm: Option<HarmClass>| harm.is_some_and(|harm| harm >= HarmClass::Damage);
        Ok(RoundRow {
            seed: self.seed,
            round,
            arm: self.arm,
            offered,
            in_force: self.in_force.digest(),
            faulty_in_force: self.planted.values().any(|(class, _)| is_faulty(*class)),
            harmful_in_force: (self.size.judged_by > 0)
                .then(|| self.planted.values().any(|(_, harm)| harmful(*harm))),
            score: HeldOutScore::of(&sequences.into_iter().flatten().collect::<Vec<_>>()),
        })
    }
}
