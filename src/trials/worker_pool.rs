//! Workers that are never idle while there is something to work: what is asked for first, then what will be asked next.
//!
//! A job's result is a function of its key, so a result computed ahead is the result, and an unrequested one is
//! dropped. The calling thread works too: `jobs` threads work at a time, and with one job nothing runs ahead. Knows
//! nothing of versions and judges nothing.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use holdpoint_cell::CellError;
use holdpoint_governance::ids::Digest;

use super::worker::Worker;
use crate::fault::TrialFault;

/// The most threads.
const JOBS_MAX: usize = 64;

/// The most unrequested results that wait, for each job.
const AHEAD_PER_JOB: usize = 12;

/// Work for whichever worker takes it.
pub type JobFn<R> = Box<dyn FnOnce(&mut Worker) -> R + Send>;

/// Something to work, and what it is known by: equal keys, equal results.
pub struct PoolJob<R> {
    pub key: Digest,
    pub work: JobFn<R>,
}

/// Why a job gave no result.
enum JobFault {
    /// Its worker panicked, with this message.
    Panic(String),
    /// The cell of its worker was lost.
    Lost(CellError),
}

type JobResult<R> = Result<R, JobFault>;

struct QueueState<R> {
    /// Asked for, in order.
    wanted: VecDeque<PoolJob<R>>,
    /// Likely to be asked for, in order.
    ahead: VecDeque<PoolJob<R>>,
    running: BTreeSet<Digest>,
    done: BTreeMap<Digest, JobResult<R>>,
    /// Running and finished jobs that no caller has requested yet.
    unasked: BTreeSet<Digest>,
    closed: bool,
}

struct WorkerPoolShared<R> {
    queue: Mutex<QueueState<R>>,
    changed: Condvar,
}

/// See the module's head.
pub struct WorkerPool<R> {
    jobs: usize,
    shared: Arc<WorkerPoolShared<R>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    own: Mutex<Worker>,
}

impl<R: Send + 'static> WorkerPool<R> {
    /// A pool of `jobs` threads, the caller included. Threads start with the first job ahead.
    #[must_use]
    pub fn new(jobs: usize) -> Self {
        let books = QueueState {
            wanted: VecDeque::new(),
            ahead: VecDeque::new(),
            running: BTreeSet::new(),
            done: BTreeMap::new(),
            unasked: BTreeSet::new(),
            closed: false,
        };
        Self {
            jobs: jobs.clamp(1, JOBS_MAX),
            shared: Arc::new(WorkerPoolShared { queue: Mutex::new(books), changed: Condvar::new() }),
            threads: Mutex::new(Vec::new()),
            own: Mutex::new(Worker::new()),
        }
    }

    /// How many work at a time.
    #[must_use]
    pub const fn jobs(&self) -> usize {
        self.jobs
    }

    /// Announces likely next requests, in this order; drops earlier announcements that have not begun.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn expect(&self, jobs: Vec<PoolJob<R>>) -> Result<(), TrialFault> {
        if self.jobs == 1 {
            return Ok(());
        }
        self.start()?;
        let mut books = self.shared.lock();
        books.ahead.clear();
        // Results that are no longer expected would never be requested.
        let expected: BTreeSet<Digest> = jobs.iter().map(|job| job.key).collect();
        let QueueState { unasked, done, running, ahead, .. } = &mut *books;
        unasked.retain(|key| {
            let stays = expected.contains(key) || running.contains(key);
            if !stays {
                done.remove(key);
            }
            stays
        });
        let known = |key: &Digest| running.contains(key) || done.contains_key(key);
        ahead.extend(jobs.into_iter().filter(|job| !known(&job.key)));
        drop(books);
        self.shared.changed.notify_all();
        Ok(())
    }

    /// Works what is asked for, each thing once, and hands it over in that order. Meanwhile, and after, the others go on with what is
    /// expected.
    ///
    /// # Errors
    /// If a worker panicked, naming the job, if the cell of a worker was lost, if `cancel` was raised, or if two jobs are
    /// the same: nothing is handed over then.
    pub fn run_jobs(&self, jobs: Vec<PoolJob<R>>, cancel: &AtomicBool) -> Result<Vec<R>, TrialFault> {
        if self.jobs > 1 {
            self.start()?;
        }
        let keys: Vec<Digest> = jobs.iter().map(|job| job.key).collect();
        let mut books = self.shared.lock();
        for job in jobs {
            let QueueState { wanted, ahead, running, done, unasked, .. } = &mut *books;
            ahead.retain(|other| other.key != job.key);
            unasked.remove(&job.key);
            if !running.contains(&job.key) && !done.contains_key(&job.key) {
                wanted.push_back(job);
            }
        }
        drop(books);
        self.shared.changed.notify_all();
        let mut own = self.own.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let mut books = self.shared.lock();
            if cancel.load(Ordering::Acquire) {
                books.wanted.clear();
                books.ahead.clear();
                return Err(TrialFault::Impossible("the evaluation was interrupted".to_owned()));
            }
            if keys.iter().all(|key| books.done.contains_key(key)) {
                return hand_over(&mut books, &keys);
            }
            match books.next(self.jobs) {
                Some(job) => {
                    drop(books);
                    self.shared.run(job, &mut own);
                }
                None => {
                    // Another worker has what is missing.
                    drop(self.shared.changed.wait(books).unwrap_or_else(PoisonError::into_inner));
                }
            }
        }
    }

    fn start(&self) -> Result<(), TrialFault> {
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        while threads.len() + 1 < self.jobs {
            let (shared, jobs) = (Arc::clone(&self.shared), self.jobs);
            let thread =
                std::thread::Builder::new().name("trial".to_owned()).spawn(move || shared.serve(jobs));
            let failed = |error| TrialFault::Impossible(format!("a worker's thread does not start: {error}"));
            threads.push(thread.map_err(failed)?);
        }
        Ok(())
    }
}

impl<R> Drop for WorkerPool<R> {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_all();
        let threads = self.threads.get_mut().unwrap_or_else(PoisonError::into_inner);
        for thread in threads.drain(..) {
            // A thread catches what its work panics with; it has nothing else to tell.
            let _ = thread.join();
        }
    }
}

impl<R> QueueState<R> {
    /// The next to be worked; nothing is worked ahead beyond what is kept for those who ask.
    fn next(&mut self, jobs: usize) -> Option<PoolJob<R>> {
        let job = self.wanted.pop_front().or_else(|| {
            let room = self.unasked.len() < AHEAD_PER_JOB * jobs;
            let job = if room { self.ahead.pop_front() } else { None };
            self.unasked.extend(job.as_ref().map(|job| job.key));
            job
        })?;
        self.running.insert(job.key);
        Some(job)
    }
}

impl<R> WorkerPoolShared<R> {
    fn lock(&self) -> MutexGuard<'_, QueueState<R>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, job: PoolJob<R>, worker: &mut Worker) {
        let PoolJob { key, work } = job;
        let worked = catch_unwind(AssertUnwindSafe(|| work(worker))).map_err(|panic| {
            // Its world may be half changed.
            *worker = Worker::new();
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
            JobFault::Panic(text.unwrap_or_else(|| "panic without a message".to_owned()))
        });
        let worked = match worker.take_lost() {
            Some(error) => Err(JobFault::Lost(error)),
            None => worked,
        };
        let mut books = self.lock();
        books.running.remove(&key);
        // A later request runs the job again: the cell may have been restarted.
        let is_forgotten = matches!(worked, Err(JobFault::Lost(_))) && books.unasked.remove(&key);
        if !is_forgotten {
            books.done.insert(key, worked);
        }
        drop(books);
        self.changed.notify_all();
    }

    fn serve(&self, jobs: usize) {
        let mut worker = Worker::new();
        loop {
            let mut books = self.lock();
            let job = loop {
                if books.closed {
                    return;
                }
                match books.next(jobs) {
                    Some(job) => break job,
                    None => books = self.changed.wait(books).unwrap_or_else(PoisonError::into_inner),
                }
            };
            drop(books);
            self.run(job, &mut worker);
        }
    }
}

/// Takes the results out, in order. A fault of any of them fails them all.
fn hand_over<R>(books: &mut QueueState<R>, keys: &[Digest]) -> Result<Vec<R>, TrialFault> {
    let mut results = Vec::with_capacity(keys.len());
    let mut failed = None;
    for (item, key) in (0_u64..).zip(keys) {
        match books.done.remove(key) {
            Some(Ok(result)) => results.push(result),
            Some(Err(JobFault::Panic(message))) => {
                failed = failed.or(Some(CellError::Worker { item, message }));
            }
            Some(Err(JobFault::Lost(error))) => failed = failed.or(Some(error)),
            None if failed.is_none() => {
                return Err(TrialFault::Impossible("one job was asked for twice at a time".to_owned()));
            }
            None => {}
        }
    }
    match failed {
        None => Ok(results),
        Some(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::BodyError;
    use std::sync::atomic::AtomicU64;

    fn job(number: u64, run: &Arc<AtomicU64>) -> PoolJob<u64> {
        let run = Arc::clone(run);
        let work = move |_: &mut Worker| {
            run.fetch_add(1, Ordering::Relaxed);
            assert!(number != 7, "seven is broken");
            number * number
        };
        PoolJob { key: Digest::of_parts("test", &[&number.to_le_bytes()]), work: Box::new(work) }
    }

    #[test]
    fn results_come_in_order_for_any_number_of_workers() {
        for jobs in [1, 2, 5] {
            let (worker_pool, run) = (WorkerPool::new(jobs), Arc::new(AtomicU64::new(0)));
            let list = |range: std::ops::Range<u64>| range.map(|number| job(number, &run)).collect();
            worker_pool.expect(list(20..60)).unwrap();
            assert_eq!(worker_pool.run_jobs(list(10..30), &AtomicBool::new(false)).unwrap(), squares(10..30));
            worker_pool.expect(list(30..33)).unwrap();
            assert_eq!(worker_pool.run_jobs(list(30..50), &AtomicBool::new(false)).unwrap(), squares(30..50));
            // Twice in a row: handed-over jobs are run again.
            assert_eq!(worker_pool.run_jobs(list(30..50), &AtomicBool::new(false)).unwrap(), squares(30..50));
            drop(worker_pool);
            let times = run.load(Ordering::Relaxed);
            if jobs == 1 {
                assert_eq!(times, 60, "one job works nothing ahead");
            } else {
                assert!((60..60 + 40).contains(&times), "{times}");
            }
        }
    }

    fn squares(range: std::ops::Range<u64>) -> Vec<u64> {
        range.map(|number| number * number).collect()
    }

    #[test]
    fn speculative_jobs_are_bounded() {
        let (worker_pool, run) = (WorkerPool::new(2), Arc::new(AtomicU64::new(0)));
        worker_pool.expect((100..1100).map(|number| job(number, &run)).collect()).unwrap();
        let begun = std::time::Instant::now();
        while run.load(Ordering::Relaxed) < 2 * AHEAD_PER_JOB as u64 && begun.elapsed().as_secs() < 20 {
            std::thread::yield_now();
        }
        assert_eq!(worker_pool.run_jobs(vec![job(1, &run)], &AtomicBool::new(false)).unwrap(), [1]);
        drop(worker_pool);
        assert_eq!(run.load(Ordering::Relaxed), 2 * AHEAD_PER_JOB as u64 + 1);
    }

    #[test]
    fn a_panic_fails_only_the_requested_jobs() {
        for jobs in [1, 3] {
            let (worker_pool, run) = (WorkerPool::new(jobs), Arc::new(AtomicU64::new(0)));
            let list = |range: std::ops::Range<u64>| range.map(|number| job(number, &run)).collect();
            let failed = worker_pool.run_jobs(list(5..9), &AtomicBool::new(false)).unwrap_err().to_string();
            assert!(failed.contains("seven is broken") && failed.contains('2'), "{failed}");
            assert_eq!(worker_pool.run_jobs(list(8..12), &AtomicBool::new(false)).unwrap(), squares(8..12));
        }
    }

    #[test]
    fn a_lost_cell_fails_the_requested_jobs_and_none_that_was_ahead() {
        let lost = || CellError::Body(BodyError::Lost("gone".to_owned()));
        for jobs in [1, 3] {
            let (worker_pool, run) = (WorkerPool::new(jobs), Arc::new(AtomicU64::new(0)));
            let losing = |number: u64| {
                let PoolJob { key, work } = job(number, &run);
                let work = move |worker: &mut Worker| {
                    worker.note_failure(lost());
                    work(worker)
                };
                PoolJob { key, work: Box::new(work) }
            };
            worker_pool.expect((20..24).map(losing).collect()).unwrap();
            let asked = vec![job(1, &run), losing(2), job(3, &run)];
            let failed = worker_pool.run_jobs(asked, &AtomicBool::new(false)).unwrap_err();
            assert!(matches!(&failed, TrialFault::Cell(error) if *error == lost()), "{failed}");
            let again = (20..24).map(|number| job(number, &run)).collect();
            worker_pool.expect(Vec::new()).unwrap();
            let mut books = worker_pool.shared.lock();
            while !books.running.is_empty() {
                books = worker_pool.shared.changed.wait(books).unwrap();
            }
            drop(books);
            assert_eq!(worker_pool.run_jobs(again, &AtomicBool::new(false)).unwrap(), squares(20..24));
        }
    }

    #[test]
    fn a_raised_flag_interrupts() {
        let (worker_pool, run) = (WorkerPool::new(2), Arc::new(AtomicU64::new(0)));
        let cancelled = AtomicBool::new(true);
        assert!(worker_pool.run_jobs(vec![job(1, &run)], &cancelled).is_err());
        assert_eq!(worker_pool.run_jobs(vec![job(2, &run)], &AtomicBool::new(false)).unwrap(), [4]);
    }
}
