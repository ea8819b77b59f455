//! An honest cell keeps every promise, and each quirk breaks the promise that it should.

mod broken_limits;
mod broken_promises;
mod relay;

use std::sync::Arc;

use super::{Check, Verdict, check, measure};
use crate::client::Connect;
use crate::fake_cell::{FakeFactory, Quirk, connect_to};
use crate::server::{CellServer, ServerOptions};

fn connect(quirk: Quirk) -> Connect {
    let factory = Arc::new(FakeFactory::new(quirk));
    connect_to(&Arc::new(CellServer::new(factory, ServerOptions::default()).unwrap()))
}

/// The promises that are broken.
fn broken(verdicts: Vec<Verdict>) -> Vec<String> {
    let told = |verdict: Verdict| Some(format!("{}: {}", verdict.name, verdict.problem?));
    verdicts.into_iter().filter_map(told).collect()
}

#[test]
fn honest_cell_keeps_every_promise() {
    let verdicts = check(connect(Quirk::Honest));
    assert!(verdicts.len() >= 40, "{} verdicts", verdicts.len());
    let mut names: Vec<&str> = verdicts.iter().map(|verdict| verdict.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), verdicts.len(), "each promise once");
    assert_eq!(broken(verdicts), Vec::<String>::new());
}

#[test]
fn each_quirk_breaks_its_promise() {
    for (quirk, promise) in [
        (Quirk::TellsNaN, "units: every number is finite"),
        (Quirk::TellsThreeJoints, "units: every number is finite"),
        (Quirk::SkipsTicks, "ticks: an episode begins at 0"),
        (Quirk::ForgetsSeeds, "trials: one seed is one episode"),
        (Quirk::ExportsHalf, "states: an imported state continues"),
        (Quirk::TakesNaN, "commands: a joint that is no number"),
        (Quirk::IgnoresStop, "trials: a reset clears a stop"),
        (Quirk::MovesTool, "units: the tool is where the joints put it"),
    ] {
        let mut check = Check::new(connect(quirk));
        check.behavior();
        check.state();
        check.commands();
        let found = broken(check.verdicts);
        assert!(found.iter().any(|problem| problem.starts_with(promise)), "{quirk:?}: {found:#?}");
    }
}

#[test]
fn exchange_is_timed() {
    let times = measure(connect(Quirk::Honest)).unwrap();
    assert!(times.p50_us <= times.p99_us && times.p99_us <= times.max_us, "{times:?}");
    assert_eq!(times.ticks, 1000);
}
