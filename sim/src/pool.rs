//! A pool of worker threads whose results are committed strictly in order.
//!
//! Items run in any order on any worker; the caller sees them by index, and a stop at item `k`
//! discards everything after `k`, finished or not. So one worker and many give the same log.

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use holdpoint_cell::CellError;

/// How a run of the pool ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoolEnd {
    /// Every item was committed.
    Completed,
    /// `commit` ended the run after a number of items.
    Stopped {
        /// Items committed, with the one that ended the run.
        committed: u64,
    },
    /// The cancel flag was raised after a number of items.
    Cancelled {
        /// Items committed.
        committed: u64,
    },
}

/// The most items, for each worker, that run ahead of the commit.
const AHEAD_PER_WORKER: u64 = 4;
/// The most worker threads.
const JOBS_MAX: usize = 64;

struct PoolShared<R> {
    next: u64,
    committed: u64,
    is_closed: bool,
    done: BTreeMap<u64, Result<R, String>>,
    /// Workers still running; without one, open items get no result.
    workers: usize,
    failed_worker: Option<CellError>,
}

/// Runs items `0..n` on `jobs` workers and commits results in index order on the calling thread.
///
/// Each worker owns a `W` from `make_worker` (a world, say). Workers check `cancel` between items.
///
/// # Errors
/// [`CellError::Worker`] naming the item whose `run` panicked (items before it are committed), or
/// the error of `make_worker`.
pub fn run_ordered<W, R: Send>(
    jobs: usize,
    n: u64,
    cancel: &AtomicBool,
    make_worker: impl Fn() -> Result<W, CellError> + Sync,
    run: impl Fn(&mut W, u64) -> R + Sync,
    mut commit: impl FnMut(u64, R) -> ControlFlow<()>,
) -> Result<PoolEnd, CellError> {
    let jobs = jobs.clamp(1, JOBS_MAX);
    let ahead = AHEAD_PER_WORKER * jobs as u64;
    let shared = Mutex::new(PoolShared {
        next: 0,
        committed: 0,
        is_closed: false,
        done: BTreeMap::new(),
        workers: jobs,
        failed_worker: None,
    });
    let changed = Condvar::new();
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                let result = catch_unwind(AssertUnwindSafe(|| {
                    run_items(n, ahead, cancel, &shared, &changed, &make_worker, &run)
                }));
                let mut state = lock(&shared);
                state.workers -= 1;
                match result {
                    Ok(Ok(())) => {}
                    Ok(Err(error)) => state.failed_worker = Some(error),
                    Err(panic) => {
                        let (item, message) = (state.committed, message(&*panic));
                        state.failed_worker = Some(CellError::Worker { item, message });
                    }
                }
                changed.notify_all();
            });
        }
        // Also if `commit` panics: the scope waits for the workers, and these wait for the commit.
        let _closing = Closing { shared: &shared, changed: &changed };
        collect(n, cancel, &shared, &changed, &mut commit)
    })
}

/// Ends the workers when dropped.
struct Closing<'a, R> {
    shared: &'a Mutex<PoolShared<R>>,
    changed: &'a Condvar,
}

impl<R> Drop for Closing<'_, R> {
    fn drop(&mut self) {
        lock(self.shared).is_closed = true;
        self.changed.notify_all();
    }
}

fn run_items<W, R>(
    n: u64,
    ahead: u64,
    cancel: &AtomicBool,
    shared: &Mutex<PoolShared<R>>,
    changed: &Condvar,
    make_worker: &impl Fn() -> Result<W, CellError>,
    run: &impl Fn(&mut W, u64) -> R,
) -> Result<(), CellError> {
    let mut worker = make_worker()?;
    loop {
        let item = {
            let mut state = lock(shared);
            loop {
                if state.is_closed || cancel.load(Ordering::Acquire) || state.next >= n {
                    return Ok(());
                }
                if state.next < state.committed + ahead {
                    break;
                }
                state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
            state.next += 1;
            state.next - 1
        };
        let result =
            catch_unwind(AssertUnwindSafe(|| run(&mut worker, item))).map_err(|panic| message(&*panic));
        let panicked = result.is_err();
        lock(shared).done.insert(item, result);
        changed.notify_all();
        if panicked {
            // The panic may have left the worker's state inconsistent.
            worker = make_worker()?;
        }
    }
}

fn collect<R>(
    n: u64,
    cancel: &AtomicBool,
    shared: &Mutex<PoolShared<R>>,
    changed: &Condvar,
    commit: &mut impl FnMut(u64, R) -> ControlFlow<()>,
) -> Result<PoolEnd, CellError> {
    let mut item = 0;
    while item < n {
        let result = {
            let mut state = lock(shared);
            loop {
                if cancel.load(Ordering::Acquire) {
                    return Ok(PoolEnd::Cancelled { committed: item });
                }
                if let Some(result) = state.done.remove(&item) {
                    break result;
                }
                if let Some(error) = state.failed_worker.take() {
                    return Err(error);
                }
                if state.workers == 0 {
                    let message = "every worker ended early".to_owned();
                    return Err(CellError::Worker { item, message });
                }
                state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        };
        let value = result.map_err(|message| CellError::Worker { item, message })?;
        let flow = commit(item, value);
        item += 1;
        lock(shared).committed = item;
        changed.notify_all();
        if flow.is_break() {
            return Ok(PoolEnd::Stopped { committed: item });
        }
    }
    Ok(PoolEnd::Completed)
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "panic without a message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[allow(clippy::unnecessary_wraps, reason = "stands for a maker of workers that can fail")]
    fn no_worker() -> Result<(), CellError> {
        Ok(())
    }

    #[test]
    fn pool_commits_in_order_for_any_number_of_workers() {
        for (n, stop_at) in [(0, None), (1, None), (100, None), (100, Some(0)), (100, Some(37))] {
            for jobs in [1, 2, 5] {
                let cancel = AtomicBool::new(false);
                let mut log = Vec::new();
                let end = run_ordered(
                    jobs,
                    n,
                    &cancel,
                    no_worker,
                    |(), item| item * item,
                    |item, value| {
                        log.push((item, value));
                        if stop_at == Some(item) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
                    },
                );
                let count = stop_at.map_or(n, |k| k + 1);
                let expected: Vec<_> = (0..count).map(|i| (i, i * i)).collect();
                assert_eq!(log, expected, "{jobs} workers");
                let expected_end =
                    stop_at.map_or(PoolEnd::Completed, |_| PoolEnd::Stopped { committed: count });
                assert_eq!(end, Ok(expected_end));
            }
        }
    }

    #[test]
    fn a_panic_names_its_item_and_earlier_items_are_committed() {
        for jobs in [1, 3] {
            let cancel = AtomicBool::new(false);
            let mut committed = 0;
            let end = run_ordered(
                jobs,
                20,
                &cancel,
                no_worker,
                |(), item| {
                    assert!(item != 7, "seven is broken");
                    item
                },
                |_, _| {
                    committed += 1;
                    ControlFlow::Continue(())
                },
            );
            assert_eq!(committed, 7);
            assert_eq!(end, Err(CellError::Worker { item: 7, message: "seven is broken".to_owned() }));
        }
    }

    #[test]
    fn a_panic_of_the_caller_ends_the_workers() {
        let cancel = AtomicBool::new(false);
        let ended = catch_unwind(AssertUnwindSafe(|| {
            run_ordered(
                2,
                1000,
                &cancel,
                no_worker,
                |(), item| item,
                |item, _| {
                    assert!(item != 7, "the caller is broken");
                    ControlFlow::Continue(())
                },
            )
        }));
        assert_eq!(message(&*ended.unwrap_err()), "the caller is broken");
    }

    #[test]
    fn a_raised_flag_ends_the_run_between_items() {
        let cancel = AtomicBool::new(false);
        let mut committed = 0;
        let end = run_ordered(
            2,
            1000,
            &cancel,
            no_worker,
            |(), item| item,
            |item, _| {
                committed += 1;
                if item == 10 {
                    cancel.store(true, Ordering::Release);
                }
                ControlFlow::Continue(())
            },
        );
        assert_eq!(end, Ok(PoolEnd::Cancelled { committed: 11 }));
        assert_eq!(committed, 11);
    }

    #[test]
    fn a_worker_that_cannot_be_made_is_an_error() {
        let cancel = AtomicBool::new(false);
        let fail = || Err::<(), _>(CellError::Snapshot("no".to_owned()));
        let end = run_ordered(2, 5, &cancel, fail, |(), item| item, |_, _| ControlFlow::Continue(()));
        assert_eq!(end, Err(CellError::Snapshot("no".to_owned())));
    }
}
