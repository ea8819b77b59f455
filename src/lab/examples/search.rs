//! Prints the results of the search for the worst episode beside the same number of random draws. It runs over mutants
//! of a calibration pool, some seeds each. It prints the excess at the worst place, and how often a concern became
//! significant on fresh noise. `cargo run --release -p holdpoint-lab --example search -- MUTANTS SEEDS`
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a measurement ends where something fails"
)]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{HarmSettings, Profile, ProfileName};
use holdpoint_governance::worst_case_search::SearchFinding;
use holdpoint_lab::candidate_pool::Preset;
use holdpoint_lab::candidate_pool::generate::{PoolSpec, draw};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use holdpoint_store::{CacheSecret, ResultCache};
use holdpoint_trials::cell::Cell;
use holdpoint_trials::search::{Search, SearchStyle};
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedSource};
use holdpoint_trials::sequences::TrialTeam;
use holdpoint_trials::trial_lab::{TrialLab, TrialSubject};
use holdpoint_trials::undisturbed_run::UndisturbedCache;
use holdpoint_trials::worker_pool::WorkerPool;

/// Results of the searches of one style.
#[derive(Default)]
struct SearchTally {
    searches: u32,
    excess: f64,
    doubts: u32,
    worse_than_other: u32,
}

fn search(
    lab: &TrialLab<'_>,
    parties: [&TrialSubject; 2],
    style: SearchStyle,
    limits: &HarmSettings,
) -> SearchFinding {
    let mut search = Search::new(lab.seeds.search_state(), style, *limits);
    while !search.is_over() {
        let (first, points) = search.next_points(usize::MAX);
        search.add_results(&lab.places(parties[0], parties[1], first, &points).unwrap());
    }
    search.finding(&lab.cell.sandbox).unwrap()
}

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).map(|text| text.parse().unwrap()).collect();
    let [mutants, seeds] = numbers[..] else { panic!("give MUTANTS and SEEDS") };
    let cell = Cell::of(&SimCells, None).unwrap();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    let baselines = holdpoint_trials::embedded::baselines().unwrap();
    let sets = u32::try_from(mutants.div_ceil(3)).unwrap();
    let order = PoolSpec { seed: CALIBRATION_FROM_RUN + 7, sets, preset: Preset::Mutants };
    let pool = draw(order).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let cache = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh().unwrap());
    let (worker_pool, cancel) = (WorkerPool::new(2), AtomicBool::new(false));
    let shelf = Arc::new(UndisturbedCache::new());
    let (mut climbed, mut drawn) = (SearchTally::default(), SearchTally::default());
    for package in pool.packages {
        let version = Capability::load("mutant", package).unwrap();
        let active = baselines.iter().find(|one| one.id().family == version.id().family).unwrap();
        let party = |version: &Capability| TrialSubject {
            version: version.clone(),
            terms: terms.clone(),
            fallback: None,
        };
        let (candidate, active) = (party(&version), party(active));
        for seed in 0..seeds {
            let lab = TrialLab {
                seeds: SeedSource::OfRun(CALIBRATION_FROM_RUN + 10 + seed),
                worker_pool: &worker_pool,
                undisturbed: &shelf,
                part: usize::MAX,
                cancel: &cancel,
                cell: &cell,
                cache: &cache,
                team: TrialTeam::default(),
                anchor: None,
            };
            let by = |style| search(&lab, [&candidate, &active], style, &profile.harm);
            let (by_search, by_draws) = (by(SearchStyle::Evolution), by(SearchStyle::Random));
            for (found, one, other) in
                [(&mut climbed, &by_search, &by_draws), (&mut drawn, &by_draws, &by_search)]
            {
                found.searches += 1;
                found.excess += one.excess;
                found.doubts += u32::from(one.concern(&profile).is_some());
                found.worse_than_other += u32::from(one.excess > other.excess + 1e-9);
            }
        }
    }
    println!("style, searches, mean excess at the worst place, worse than the other, doubts established");
    for (name, found) in [("evolution", climbed), ("draws", drawn)] {
        let mean = found.excess / f64::from(found.searches.max(1));
        println!("{name}, {}, {mean:.3}, {}, {}", found.searches, found.worse_than_other, found.doubts);
    }
}
