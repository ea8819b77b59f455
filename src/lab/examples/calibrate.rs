//! Measures versions on calibration episodes (seeds from 1,000,000): the tool every parameter and
//! threshold was set with. With `--from` it measures frozen versions on other seeds; the versions
//! after the first are compared with it in pairs.
//!
//! `cargo run -p holdpoint-lab --example calibrate -- <conditions> <n> <folder> [<folder> …] [--from SEED] [--profile NAME]
//! [--pairs FILE]`,
//! conditions `canonical`, `sandbox`, `live`, or `drills` for the recovery drills.
//!
//! `--pairs` writes the pairs of the first two versions (the active version first) in the form that
//! `holdpoint-lab bench stats` reads from `src/lab/bench/data/`.
#![allow(clippy::print_stdout, reason = "a command-line tool")]

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::{Context as _, Result, bail};
use holdpoint::governance::evidence::{DrillKind, Pair};
use holdpoint::governance::harm::HarmKind;
use holdpoint::governance::policy::PolicyTable;
use holdpoint::governance::profile::{Profile, ProfileName};
use holdpoint::governance::recovery::rho;
use holdpoint::governance::stats::{PairedCounts, binary_pairs};
use holdpoint::runtime::capability::{self, Capability};
use holdpoint::runtime::guard::PolicyHit;
use holdpoint::runtime::task::TaskRecord;
use holdpoint::runtime::terms::SkillTerms;
use holdpoint::runtime::watcher::WatcherSignal;
use holdpoint::trials::cell::{Cell, Conditions};
use holdpoint::trials::drills::{DrillResult, DrillVersions, drill};
use holdpoint::trials::episodes::batch;
use holdpoint::trials::worker::Worker;
use holdpoint::trials::worker_pool::WorkerPool;
use holdpoint_lab::bench::stats::tables;
use holdpoint_sim::SimCells;
use holdpoint_sim::pool::run_ordered;

fn main() -> Result<()> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut from = 1_000_000;
    if let Some(at) = arguments.iter().position(|a| a == "--from") {
        from = arguments.get(at + 1).context("--from needs a seed")?.parse()?;
        arguments.drain(at..at + 2);
    }
    let mut pairs_file = None;
    if let Some(at) = arguments.iter().position(|a| a == "--pairs") {
        pairs_file = Some(arguments.get(at + 1).context("--pairs needs a file")?.clone());
        arguments.drain(at..at + 2);
    }
    let mut name = ProfileName::Sim;
    if let Some(at) = arguments.iter().position(|a| a == "--profile") {
        name = arguments.get(at + 1).context("--profile needs a name")?.parse()?;
        arguments.drain(at..at + 2);
    }
    let [conditions, n, folders @ ..] = arguments.as_slice() else { bail!("see the head of this file") };
    let conditions_name = conditions.clone();
    let conditions = match conditions.as_str() {
        "canonical" => Conditions::Canonical,
        "sandbox" => Conditions::Sandbox,
        "live" => Conditions::Live,
        "drills" => return drills(n.parse()?, from, folders),
        other => bail!("no conditions {other:?}"),
    };
    let n: u64 = n.parse()?;
    let cell = Cell::of(&SimCells, None)?;
    let profile = Profile::builtin(name)?;
    let table = Arc::new(PolicyTable::builtin(&profile)?);
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    let capabilities = folders
        .iter()
        .map(|folder| Ok(Capability::load(folder, capability::read(Path::new(folder))?)?))
        .collect::<Result<Vec<_>>>()?;
    let worker_pool = WorkerPool::new(2);
    let mut first: Option<Vec<TaskRecord>> = None;
    for (version, capability) in capabilities.iter().enumerate() {
        let declared = &capability.manifest.permissions;
        let terms = terms.clone().capped(declared.max_speed_m_s, declared.max_force_n);
        let start = std::time::Instant::now();
        let records = batch(
            &worker_pool,
            &AtomicBool::new(false),
            &cell,
            (capability, &terms),
            conditions,
            from..from + n,
        )?;
        println!("{} {}", capability.id(), summary(&records, start.elapsed().as_secs_f64()));
        match &first {
            None => first = Some(records),
            Some(first) if first.iter().zip(&records).all(|(a, b)| a.task == b.task) => {
                if version == 1
                    && let Some(file) = &pairs_file
                {
                    let head = format!(
                        "# {} against {}, conditions {conditions_name}, profile {name}, {n} seeds from {from}, holdpoint {}\n",
                        capability.id(),
                        capabilities[0].id(),
                        env!("CARGO_PKG_VERSION"),
                    );
                    std::fs::write(file, head + &tables::write(&pairs_of(first, &records)))?;
                }
                println!("{}", harm(&pairs_of(first, &records)));
                let pairs = first.iter().zip(&records).map(|(a, b)| (b.success, a.success));
                let bound = binary_pairs(PairedCounts::of(pairs), 0.05)?;
                println!(
                    "    success against the first, paired: {:+.3}, one-sided 95 % bounds {:+.3} and {:+.3}",
                    bound.mean, bound.lower, bound.upper
                );
            }
            Some(_) => {}
        }
    }
    Ok(())
}

/// Pass rates of the recovery drills, with rollback to the first version; `rho` with the weights of the profile.
fn drills(n: u64, from: u64, folders: &[String]) -> Result<()> {
    let cell = Cell::of(&SimCells, None)?;
    let profile = Profile::builtin(ProfileName::Sim)?;
    let table = Arc::new(PolicyTable::builtin(&profile)?);
    let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
    let load = |folder: &str| -> Result<Capability> {
        Ok(Capability::load(folder, capability::read(Path::new(folder))?)?)
    };
    let fallback = load("manifests/park/1.0.0")?;
    let versions = folders.iter().map(|folder| load(folder)).collect::<Result<Vec<_>>>()?;
    let predecessor = versions.first().context("name a folder")?;
    for version in &versions {
        let cast = DrillVersions { version, predecessor, fallback: Some(&fallback) };
        let mut rates = Vec::new();
        for kind in DrillKind::ALL {
            let mut passed = (0_u32, 0_u32);
            let result = |worker: &mut Worker, index| drill(worker, &cell, &terms, &cast, kind, from + index);
            run_ordered(
                2,
                n,
                &AtomicBool::new(false),
                || Ok(Worker::new()),
                result,
                |_, result| {
                    passed.0 += u32::from(result == DrillResult::Passed);
                    passed.1 += u32::from(result != DrillResult::Infeasible);
                    ControlFlow::Continue(())
                },
            )?;
            rates.push((kind, f64::from(passed.0) / f64::from(passed.1.max(1))));
        }
        let shown: Vec<String> =
            rates.iter().map(|(kind, rate)| format!("{} {rate:.3}", kind.name())).collect();
        let rho = rho(&rates, &profile.recovery).unwrap_or(f64::NAN);
        println!("{} drills n {n} {} rho {rho:.3}", version.id(), shown.join(" "));
    }
    Ok(())
}

/// The effects of both versions on their surroundings: means and the standard deviation of the difference where
/// both succeeded, and the values that one in twenty and one in a hundred of all episodes exceed.
fn harm(pairs: &[Pair]) -> String {
    let mut lines = Vec::new();
    for kind in HarmKind::ALL {
        let both = |pair: &Pair| Some((pair.active.harm?.of(kind), pair.candidate.harm?.of(kind)));
        let all: Vec<(f64, f64)> = pairs.iter().filter_map(both).collect();
        let done = pairs.iter().filter(|pair| pair.active.success && pair.candidate.success);
        let values: Vec<(f64, f64)> = done.filter_map(both).collect();
        let n = values.len().max(1) as f64;
        let mean = |read: &dyn Fn(&(f64, f64)) -> f64| values.iter().map(read).sum::<f64>() / n;
        let worse = mean(&|(old, new)| kind.worsening(*new, *old));
        let spread = mean(&|(old, new)| (kind.worsening(*new, *old) - worse).powi(2)).sqrt();
        let tail = |read: &dyn Fn(&(f64, f64)) -> f64, hundredths: usize| {
            let mut sorted: Vec<f64> = all.iter().map(read).collect();
            sorted.sort_by(|a, b| if kind.is_worse_when_lower() { b.total_cmp(a) } else { a.total_cmp(b) });
            sorted.get(sorted.len() * hundredths / 100).copied().unwrap_or(f64::NAN)
        };
        lines.push(format!(
            "    {:<17} first {:>9.4} this {:>9.4} worse {worse:>+9.4} spread {spread:.4} 95% {:.4} {:.4} 99% {:.4} {:.4}",
            kind.name(),
            mean(&|(old, _)| *old),
            mean(&|(_, new)| *new),
            tail(&|(old, _)| *old, 95),
            tail(&|(_, new)| *new, 95),
            tail(&|(old, _)| *old, 99),
            tail(&|(_, new)| *new, 99),
        ));
    }
    lines.join("\n")
}

/// The pairs with two executable episodes.
fn pairs_of(active: &[TaskRecord], candidate: &[TaskRecord]) -> Vec<Pair> {
    let both = active.iter().zip(candidate);
    both.filter_map(|(old, new)| {
        let (active, candidate) = (old.values()?, new.values()?);
        Some(Pair { seed: old.seed, active, candidate, live_like: false })
    })
    .collect()
}

fn summary(records: &[TaskRecord], wall: f64) -> String {
    let n = records.len() as f64;
    let share = |f: &dyn Fn(&TaskRecord) -> bool| records.iter().filter(|r| f(r)).count() as f64 / n;
    let mut hits: BTreeMap<String, u32> = BTreeMap::new();
    let mut ends: BTreeMap<String, u32> = BTreeMap::new();
    for record in records {
        for (_, hit) in &record.hits {
            *hits.entry(format!("{hit:?}")).or_default() += 1;
        }
        for raised in &record.signals {
            *hits.entry(format!("{:?}", raised.signal)).or_default() += 1;
        }
        let end = match (record.invalid, record.success, record.declared) {
            (true, _, _) => "invalid".to_owned(),
            (_, true, _) => "success".to_owned(),
            (_, _, Some(signal)) => format!("{signal:?}"),
            (_, _, None) if record.recovery => "recovery".to_owned(),
            _ => "not done".to_owned(),
        };
        *ends.entry(end).or_default() += 1;
    }
    // Values that would roll a provisional version back at once in the live cell.
    let trips = share(&|r| {
        r.signals.iter().any(|raised| raised.signal == WatcherSignal::UnexpectedContact)
            || r.hits
                .iter()
                .any(|(_, hit)| !matches!(hit, PolicyHit::OutsideWorkspace | PolicyHit::RetriesExceeded))
    });
    let time = records.iter().map(|r| r.time_secs).sum::<f64>() / n;
    format!(
        "n {n} success {:.3} violation {:.3} anomaly {:.3} recovery {:.3} trips {trips:.4} retries {:.2} time {time:.2}s wall {:.1} ms/episode\n    {ends:?}\n    {hits:?}",
        share(&|r| r.success),
        share(&|r| r.violation),
        share(&|r| r.anomaly),
        share(&|r| r.recovery),
        records.iter().map(|r| f64::from(r.retries)).sum::<f64>() / n,
        1000.0 * wall / n,
    )
}
