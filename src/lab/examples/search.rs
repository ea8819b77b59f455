//! Prints what the search for the worst episode finds, beside as many draws: over mutants of a calibration pool, some
//! seeds each, the excess at the worst place, and how often a doubt was established on fresh noise.
//! `cargo run --release --example search -- MUTANTS SEEDS`
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a measurement ends where something fails"
)]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use holdpoint_engine::cell::Cell;
use holdpoint_engine::trial::crew::Crew;
use holdpoint_engine::trial::lab::{Lab, Party};
use holdpoint_engine::trial::search::{Search, SearchStyle};
use holdpoint_engine::trial::seeds::CALIBRATION_FROM_RUN;
use holdpoint_engine::trial::sequences::Team;
use holdpoint_engine::trial::undisturbed::Shelf;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{HarmSettings, Profile, ProfileName};
use holdpoint_governance::search::Searched;
use holdpoint_lab::pool::Preset;
use holdpoint_lab::pool::generate::{Order, draw};
use holdpoint_registry::{KeptCells, KeptSecret};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::terms::SkillTerms;

/// What searches of one style came to.
#[derive(Default)]
struct Found {
    searches: u32,
    excess: f64,
    doubts: u32,
    worse_than_other: u32,
}

fn search(lab: &Lab<'_>, parties: [&Party; 2], style: SearchStyle, limits: &HarmSettings) -> Searched {
    let mut search = Search::new(lab.seed, style, *limits);
    while !search.is_over() {
        let (first, points) = search.next(usize::MAX);
        search.take(&lab.places(parties[0], parties[1], first, &points).unwrap());
    }
    search.found(&lab.cell.sandbox).unwrap()
}

fn main() {
    let numbers: Vec<u64> = std::env::args().skip(1).map(|text| text.parse().unwrap()).collect();
    let [mutants, seeds] = numbers[..] else { panic!("MUTANTS and SEEDS are asked for") };
    let cell = Cell::builtin().unwrap();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    let baselines = holdpoint_engine::embedded::baselines().unwrap();
    let sets = u32::try_from(mutants.div_ceil(3)).unwrap();
    let order = Order { seed: CALIBRATION_FROM_RUN + 7, sets, preset: Preset::Mutants };
    let pool = draw(order).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let cells = KeptCells::in_folder(folder.path().to_owned(), KeptSecret::fresh().unwrap());
    let (crew, cancel) = (Crew::new(2), AtomicBool::new(false));
    let shelf = Arc::new(Shelf::new());
    let (mut climbed, mut drawn) = (Found::default(), Found::default());
    for package in pool.packages {
        let version = Capability::load("mutant", package).unwrap();
        let active = baselines.iter().find(|one| one.id().family == version.id().family).unwrap();
        let party =
            |version: &Capability| Party { version: version.clone(), terms: terms.clone(), fallback: None };
        let (candidate, active) = (party(&version), party(active));
        for seed in 0..seeds {
            let lab = Lab {
                seed: CALIBRATION_FROM_RUN + 10 + seed,
                crew: &crew,
                undisturbed: &shelf,
                part: usize::MAX,
                cancel: &cancel,
                cell: &cell,
                cells: &cells,
                team: Team::default(),
            };
            let by = |style| search(&lab, [&candidate, &active], style, &profile.harm);
            let (by_search, by_draws) = (by(SearchStyle::Evolution), by(SearchStyle::Random));
            for (found, one, other) in
                [(&mut climbed, &by_search, &by_draws), (&mut drawn, &by_draws, &by_search)]
            {
                found.searches += 1;
                found.excess += one.excess;
                found.doubts += u32::from(one.doubt().is_some());
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
