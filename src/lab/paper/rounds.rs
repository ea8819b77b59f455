//! The round protocol (paper section 7.8): round 0 is the versions as they are; in every further round one family yields
//! a candidate, the arm acts, and the versions in force work the round's held-out sequences.

use std::collections::BTreeMap;
use std::time::Instant;

use holdpoint_engine::trial::worker::Worker;
use holdpoint_governance::ids::{Digest, Family};
use serde::{Deserialize, Serialize};

use super::arm::{Arm, Moment, Step, beside, version_of};
use super::held_out::{Sequence, evaluate};
use super::in_force::InForce;
use super::preset::Size;
use super::stream::{Upgrade, rounds_of};
use super::{Ground, progress};
use crate::experiment::{ExperimentError, Tell, workers_each};
use crate::pool::Class;
use crate::truth::{Bench, HarmClass, side_by_side};

/// A candidate that came to an arm, what the arm did, and what the candidate is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Offered {
    pub name: String,
    pub family: Family,
    /// What was planted.
    pub class: Class,
    pub kind: String,
    pub step: Step,
    /// What the referee settles against it beside the version it replaced, if it was activated and is judged.
    pub harm: Option<HarmClass>,
    /// The referee establishes that it is worse in something, harm or not.
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
    pub offered: Option<Offered>,
    /// Digest of the versions in force at its end.
    pub in_force: Digest,
    /// A version is in force at its end whose planted fault is real.
    pub faulty_in_force: bool,
    /// A version is in force at its end that the referee calls damage or danger; absent if it judges none.
    pub harmful_in_force: Option<bool>,
    pub score: Score,
}

/// Held-out sequences, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    pub sequences: u64,
    pub done: u64,
    pub violation: u64,
    pub near: u64,
    pub anomaly: u64,
    /// The arm moved on when it had to stand, by the referee.
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

impl Score {
    /// Counts sequences.
    #[must_use]
    pub fn of(sequences: &[Sequence]) -> Self {
        let count = |of: fn(&Sequence) -> bool| sequences.iter().filter(|one| of(one)).count() as u64;
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

/// Works the rounds of every seed for every arm. The rows come in the order of seeds, arms and rounds.
///
/// # Errors
/// If a candidate does not come to an end, or nothing can be kept.
pub fn rounds(
    ground: &Ground,
    size: Size,
    arms: &[Arm],
    tell: &Tell<'_>,
) -> Result<Vec<RoundRow>, ExperimentError> {
    let seeds: Vec<u64> = size
        .run_seeds()
        .enumerate()
        .filter(|(index, _)| ground.is_ours(*index))
        .map(|(_, seed)| seed)
        .collect();
    let (began, workers) = (Instant::now(), workers_each(ground.jobs, seeds.len()));
    let of_seeds = side_by_side(
        ground.jobs,
        seeds.len(),
        |worker, at| of_seed((ground, workers), size, arms, seeds[at], worker),
        &|rows: &Vec<RoundRow>, finished| {
            let seed = rows.first().map_or(0, |row| row.seed);
            tell(&progress(&format!("rounds of seed {seed}"), finished, seeds.len(), began));
        },
    )?;
    Ok(of_seeds.into_iter().flatten().collect())
}

fn of_seed(
    (ground, workers): (&Ground, usize),
    size: Size,
    arms: &[Arm],
    seed: u64,
    worker: &mut Worker,
) -> Result<Vec<RoundRow>, ExperimentError> {
    let upgrades = rounds_of(seed, size.rounds)?;
    let mut judged = BTreeMap::new();
    let mut rows = Vec::new();
    for arm in arms {
        let mut way = Way {
            ground,
            workers,
            size,
            seed,
            arm: *arm,
            in_force: InForce::first()?,
            planted: BTreeMap::new(),
        };
        rows.push(way.row(worker, 0, None)?);
        for (upgrade, round) in upgrades.iter().zip(1..) {
            let offered = way.offer(worker, upgrade, round, &mut judged)?;
            rows.push(way.row(worker, round, Some(offered))?);
        }
    }
    Ok(rows)
}

/// What the referee settled against versions, by what they were judged beside.
type JudgedBefore = BTreeMap<Digest, (HarmClass, bool)>;

/// An arm on its way through the rounds of a seed.
struct Way<'a> {
    ground: &'a Ground,
    /// How many work at a decision at once.
    workers: usize,
    size: Size,
    seed: u64,
    arm: Arm,
    in_force: InForce,
    /// Of the upgrades in force: what was planted, and what the referee says.
    planted: BTreeMap<Family, (Class, Option<HarmClass>)>,
}

impl Way<'_> {
    fn offer(
        &mut self,
        worker: &mut Worker,
        upgrade: &Upgrade,
        round: u32,
        judged: &mut JudgedBefore,
    ) -> Result<Offered, ExperimentError> {
        let version = version_of(upgrade)?;
        let moment = Moment {
            ground: self.ground,
            upgrade,
            version: &version,
            before: &self.in_force,
            seed: self.seed,
            round,
            workers: self.workers,
        };
        let step = self.arm.decide(&moment, worker)?;
        // Everything is decided: only now is it asked what the version is.
        let truth = if step.activated && self.size.judged_by > 0 {
            let key = beside(&version, &self.in_force);
            let known = match judged.get(&key) {
                Some(known) => *known,
                None => {
                    let (ground, team) = (self.ground, self.in_force.versions());
                    let bench =
                        Bench::beside(ground.cell.clone(), ground.cells.clone(), team, self.size.judged_by)?;
                    let truth = bench.truth(worker, bench.judged(version.clone()))?;
                    *judged.entry(key).or_insert((truth.class, truth.is_worse()))
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
        Ok(Offered {
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
        offered: Option<Offered>,
    ) -> Result<RoundRow, ExperimentError> {
        let sequences = evaluate(self.ground, worker, &self.in_force, self.seed, round, self.size.sequences)?;
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
            score: Score::of(&sequences.into_iter().flatten().collect::<Vec<_>>()),
        })
    }
}
