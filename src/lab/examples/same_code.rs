//! Prints whether each baseline asks for the same commands, bit for bit, compiled in and as a component, and what a tick of
//! each costs: `cargo run --release -p holdpoint-lab --example same_code -- EPISODES`
#![allow(clippy::unwrap_used, clippy::panic, reason = "a measurement ends where something fails")]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

use std::sync::Arc;

use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_lab::same_code::{CONTROLLERS, compare, with_code};
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_sim::SimCells;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::{CALIBRATION_FROM_RUN, SeedPurpose, episode_seed};

/// The value below which this share of a sample lies.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in a sample")]
    let place = (share * (sorted.len() - 1) as f64).round() as usize;
    sorted[place]
}

fn main() {
    let episodes: u64 = std::env::args().nth(1).map_or(300, |text| text.parse().unwrap());
    let cell = Cell::of(&SimCells, None).unwrap();
    let profile = Profile::builtin(ProfileName::Sim).unwrap();
    let table = Arc::new(PolicyTable::builtin(&profile).unwrap());
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    for version in holdpoint_trials::embedded::baselines().unwrap() {
        if version.id().family.as_str() == "park" {
            continue;
        }
        let component = with_code(&version, CONTROLLERS).unwrap();
        let seeds =
            (0..episodes).map(|place| episode_seed(CALIBRATION_FROM_RUN, SeedPurpose::Perturbation, place));
        let mut found = compare((&cell, &terms), &version, &component, seeds).unwrap();
        println!(
            "{}: {} of {} ticks in {} episodes differ; at most {} fuel a tick, {} KiB; fault {:?}",
            version.id(),
            found.differing,
            found.ticks,
            found.episodes,
            found.confined.fuel_tick_max,
            found.confined.memory_bytes / 1024,
            found.confined.fault,
        );
        for (name, sample) in [("native", &mut found.native_us), ("component", &mut found.component_us)] {
            sample.sort_by(f64::total_cmp);
            println!(
                "  {name:9} p50 {:.3} us, p99 {:.3} us, mean {:.3} us a tick",
                quantile(sample, 0.5),
                quantile(sample, 0.99),
                sample.iter().sum::<f64>() / sample.len() as f64,
            );
        }
    }
}
