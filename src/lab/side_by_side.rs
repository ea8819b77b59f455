//! Items that run in parallel, each worker with its own world.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use holdpoint_trials::worker::Worker;

use crate::pipeline_experiments::{ExperimentError, ProgressFn};
use crate::wording::progress;

/// Runs items in parallel; the results come back in order. `tell` gets a line for each finished item: `line` of its place
/// and result, with the estimated remaining time.
pub(crate) fn side_by_side<T: Send>(
    jobs: usize,
    items: usize,
    work: impl Fn(&mut Worker, usize) -> Result<T, ExperimentError> + Sync,
    line: impl Fn(usize, &T) -> String + Sync,
    tell: &ProgressFn<'_>,
) -> Result<Vec<T>, ExperimentError> {
    let (next, done, began) = (AtomicUsize::new(0), AtomicUsize::new(0), Instant::now());
    let results: Mutex<Vec<(usize, Result<T, ExperimentError>)>> = Mutex::new(Vec::new());
    let turn = || {
        let mut worker = Worker::new();
        loop {
            let at = next.fetch_add(1, Ordering::Relaxed);
            if at >= items {
                return;
            }
            let result = work(&mut worker, at);
            match &result {
                Ok(one) => {
                    let finished = done.fetch_add(1, Ordering::Relaxed) + 1;
                    tell(&progress::step(&line(at, one), finished, items, began));
                }
                // No worker begins another item.
                Err(_) => next.store(items, Ordering::Relaxed),
            }
            if let Ok(mut results) = results.lock() {
                results.push((at, result));
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, items.max(1)) {
            scope.spawn(turn);
        }
    });
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|(at, _)| *at);
    let found: Vec<T> = results.into_iter().map(|(_, result)| result).collect::<Result<_, _>>()?;
    if found.len() == items {
        Ok(found)
    } else {
        Err(ExperimentError::Unexpected("a worker ended without a result".to_owned()))
    }
}
