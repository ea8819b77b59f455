//! Prints what the store costs: committing, and listing 10,000 versions. `cargo run --example store_cost`
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test says what it expects by failing"
)]
#![allow(clippy::print_stdout, reason = "its output is its purpose")]

#[path = "../tests/store/support.rs"]
#[allow(dead_code, reason = "the tests use the rest")]
mod store;

use std::time::{Duration, Instant};

use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::VersionGroup;
use holdpoint_registry::{Store, check_invariants, verify};
use holdpoint_store::{StoreError, VersionFilter};
use store::{commit, new_version};

const VERSIONS: usize = 10_000;
const FAMILIES: usize = 10;

/// Median and largest of some runs.
fn timed<T>(mut run: impl FnMut() -> Result<T, StoreError>) -> Result<(Duration, Duration), StoreError> {
    let mut times = Vec::new();
    for _ in 0..21 {
        let start = Instant::now();
        run()?;
        times.push(start.elapsed());
    }
    times.sort();
    Ok((times[10], times[20]))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let store = Store::open(folder.path())?;
    let mut commits = Vec::new();
    for first in (0..VERSIONS).step_by(100) {
        let name = |n: usize| format!("family{}@1.{}.0", n % FAMILIES, n / FAMILIES);
        let changes = (first..first + 100).map(|n| new_version(&name(n), false)).collect();
        let start = Instant::now();
        commit(&store, &format!("batch {first}"), changes)?;
        commits.push(start.elapsed() / 100);
    }
    commits.sort();
    println!("register, 100 per transaction: median {:?} per version", commits[commits.len() / 2]);
    let mut one = 0;
    let (median, most) = timed(|| {
        one += 1;
        commit(&store, &format!("one {one}"), vec![new_version(&format!("other@1.{one}.0"), false)])
    })?;
    println!("register, one per transaction: median {median:?}, largest {most:?}");

    let views = store.views()?;
    let page = |filter: VersionFilter| VersionFilter { limit: 100, ..filter };
    for (name, filter) in [
        ("first page of 100", page(VersionFilter::default())),
        ("last page of 100", page(VersionFilter { offset: 9_900, ..Default::default() })),
        ("one family", page(VersionFilter { family: Some("family3".into()), ..Default::default() })),
        ("text", page(VersionFilter { text: Some("1.77".into()), ..Default::default() })),
        ("candidates", page(VersionFilter { group: VersionGroup::Candidate, ..Default::default() })),
        ("active only", page(VersionFilter { state: Some(State::Active), ..Default::default() })),
        ("all 10,000 at once", VersionFilter::default()),
    ] {
        let (median, most) = timed(|| views.versions(&filter))?;
        println!("list, {name}: median {median:?}, largest {most:?}");
    }
    let (median, most) = timed(|| views.version(&store::id("family3@1.77.0")))?;
    println!("one version in full: median {median:?}, largest {most:?}");
    let (median, most) = timed(|| store.views())?;
    println!("open a view: median {median:?}, largest {most:?}");
    let start = Instant::now();
    let report = verify(&store.layout().database(), Some(store.public_key()))?;
    println!("verify {} records: {:?}", report.records, start.elapsed());
    let start = Instant::now();
    check_invariants(views.connection())?;
    println!("check all invariants: {:?}", start.elapsed());
    drop(views);
    drop(store);
    let start = Instant::now();
    Store::open(folder.path())?;
    println!("open the store again: {:?}", start.elapsed());
    Ok(())
}
