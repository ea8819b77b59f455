//! A trial that begins as in the live cell runs the task of the live cell.

use std::collections::BTreeMap;
use std::sync::Arc;

use holdpoint_body::TaskKind;
use holdpoint_governance::ids::Family;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_runtime::agent::ActiveView;
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::embedded;
use holdpoint_trials::live_start::{alone_from_live_start, pair_from_live_start};
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};
use holdpoint_trials::sequences::TrialTeam;
use holdpoint_trials::trial_subject::TrialSubject;
use holdpoint_trials::worker::Worker;

use super::LiveStation;
use crate::live::listener::NoListener;

struct StationBench {
    cell: Cell,
    terms: SkillTerms,
    active: BTreeMap<Family, Capability>,
}

impl ActiveView for StationBench {
    fn active(&self, family: &Family) -> Option<&Capability> {
        self.active.get(family)
    }
}

impl StationBench {
    fn new() -> Self {
        let (cell, profile) =
            (Cell::of(&SimCells, None).unwrap(), Profile::builtin(ProfileName::Sim).unwrap());
        let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        let baselines = embedded::baselines().unwrap().into_iter();
        let in_sequence = baselines.filter(|version| version.id().family.as_str() != "park");
        let active = in_sequence.map(|version| (version.id().family, version)).collect();
        Self { cell, terms, active }
    }

    fn subject(&self, task: TaskKind) -> TrialSubject {
        let version = self.active[&Family::from(task)].clone();
        TrialSubject { version, terms: self.terms.clone(), fallback: None }
    }

    fn team(&self, task: TaskKind) -> TrialTeam {
        TrialTeam::excluding(&self.cell.spec.tasks, task, TaskKind::SEQUENCE.map(|task| self.subject(task)))
    }
}

/// The tasks of live sequences come out the same when each is run by itself from its live start.
#[test]
fn task_from_its_live_start_is_the_task_of_the_live_cell() {
    let bench = StationBench::new();
    let mut live = LiveStation::new(bench.cell.clone()).unwrap();
    let mut worker = Worker::new();
    let seeds = (0..8).map(|index| episode_seed(CALIBRATION_FROM_RUN + 11, SeedPurpose::Live, index));
    let mut compared = BTreeMap::new();
    for seed in seeds {
        let report = live.run_sequence(&bench, &|_| bench.terms.clone(), seed, &mut NoListener, None);
        for done in &report.tasks {
            let task = done.record.task;
            let (subject, team) = (bench.subject(task), bench.team(task));
            let found = alone_from_live_start(&mut worker, &bench.cell, &team, &subject, seed);
            assert_eq!(found, done.record, "{task} {seed}");
            let pair = [&subject, &subject];
            let both = pair_from_live_start(&mut worker, &bench.cell, &team, pair, seed);
            assert_eq!(both, [found.clone(), found], "{task} {seed}");
            *compared.entry(task).or_insert(0) += 1;
        }
    }
    assert_eq!(compared.len(), TaskKind::SEQUENCE.len(), "{compared:?}");
}
