//! An honest cell keeps every promise, and each quirk breaks the promise that it should.

mod broken_limits;
mod broken_promises;
mod relay;

use std::sync::Arc;

use super::{CellPromise, Check, Verdict, check, measure};
use crate::client::Connect;
use crate::fake_cell::{FakeFactory, Quirk, connect_to};
use crate::server::{CellServer, ServerOptions};

fn connect(quirk: Quirk) -> Connect {
    let factory = Arc::new(FakeFactory::new(quirk));
    connect_to(&Arc::new(CellServer::new(factory, ServerOptions::default()).unwrap()))
}

/// The promises that are broken, each with its problem.
fn broken(verdicts: Vec<Verdict>) -> Vec<(CellPromise, String)> {
    verdicts.into_iter().filter_map(|verdict| Some((verdict.promise, verdict.problem?))).collect()
}

#[test]
fn honest_cell_keeps_every_promise() {
    let verdicts = check(connect(Quirk::Honest));
    assert!(verdicts.len() >= 40, "{} verdicts", verdicts.len());
    let mut promises: Vec<CellPromise> = verdicts.iter().map(|verdict| verdict.promise).collect();
    promises.sort_unstable();
    promises.dedup();
    assert_eq!(promises.len(), verdicts.len(), "each promise once");
    let broken = broken(verdicts);
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn each_quirk_breaks_its_promise() {
    for (quirk, promise) in [
        (Quirk::TellsNaN, CellPromise::FiniteNumbers),
        (Quirk::TellsThreeJoints, CellPromise::FiniteNumbers),
        (Quirk::SkipsTicks, CellPromise::StepIsTick),
        (Quirk::ForgetsSeeds, CellPromise::SeedRepeats),
        (Quirk::ExportsHalf, CellPromise::ImportContinues),
        (Quirk::TakesNaN, CellPromise::JointNoNumberRefused),
        (Quirk::IgnoresStop, CellPromise::ResetClearsStop),
        (Quirk::MovesTool, CellPromise::ToolPlace),
        (Quirk::NamesOthers, CellPromise::ObservationDeclared),
    ] {
        let mut check = Check::new(connect(quirk));
        check.behavior();
        check.state();
        check.commands();
        let found = broken(check.verdicts);
        assert!(found.iter().any(|(broken, _)| *broken == promise), "{quirk:?}: {found:#?}");
    }
}

#[test]
fn exchange_is_timed() {
    let times = measure(connect(Quirk::Honest)).unwrap();
    assert!(times.p50_us <= times.p99_us && times.p99_us <= times.max_us, "{times:?}");
    assert_eq!(times.ticks, 1000);
}
