//! Workers that are never idle while there is something to work: what is asked for first, then what will be asked next.
//!
//! What they work is a function of its key, so a result that was worked ahead is the result, and one that nobody asks
//! for is dropped. Whoever asks works along: so many are at work at a time as there are jobs, and with one job nothing
//! is ever worked ahead. Knows nothing of versions and judges nothing.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use holdpoint_governance::ids::Digest;
use holdpoint_sim::SimError;

use super::worker::Worker;
use crate::fault::Fault;

/// The most threads.
const JOBS_MAX: usize = 64;

/// The most results that wait for somebody to ask for them, for each job.
const AHEAD_PER_JOB: usize = 12;

/// Work for whichever worker takes it.
pub type Chore<R> = Box<dyn FnOnce(&mut Worker) -> R + Send>;

/// Something to work, and what it is known by: equal keys, equal results.
pub struct Errand<R> {
    pub key: Digest,
    pub work: Chore<R>,
}

/// What was worked, or how its worker panicked.
type ErrandResult<R> = Result<R, String>;

struct Books<R> {
    /// Asked for, in order.
    wanted: VecDeque<Errand<R>>,
    /// Likely to be asked for, in order.
    ahead: VecDeque<Errand<R>>,
    running: BTreeSet<Digest>,
    done: BTreeMap<Digest, ErrandResult<R>>,
    /// What of the running and done nobody has asked for yet.
    unasked: BTreeSet<Digest>,
    closed: bool,
}

struct CrewShared<R> {
    books: Mutex<Books<R>>,
    changed: Condvar,
}

/// See the module's head.
pub struct Crew<R> {
    jobs: usize,
    shared: Arc<CrewShared<R>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    own: Mutex<Worker>,
}

impl<R: Send + 'static> Crew<R> {
    /// So many at work at a time, whoever asks included. Threads start with the first work ahead.
    #[must_use]
    pub fn new(jobs: usize) -> Self {
        let books = Books {
            wanted: VecDeque::new(),
            ahead: VecDeque::new(),
            running: BTreeSet::new(),
            done: BTreeMap::new(),
            unasked: BTreeSet::new(),
            closed: false,
        };
        Self {
            jobs: jobs.clamp(1, JOBS_MAX),
            shared: Arc::new(CrewShared { books: Mutex::new(books), changed: Condvar::new() }),
            threads: Mutex::new(Vec::new()),
            own: Mutex::new(Worker::new()),
        }
    }

    /// How many work at a time.
    #[must_use]
    pub const fn jobs(&self) -> usize {
        self.jobs
    }

    /// Says what will probably be asked for next, in this order; what was said before and not begun is forgotten.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn expect(&self, errands: Vec<Errand<R>>) -> Result<(), Fault> {
        if self.jobs == 1 {
            return Ok(());
        }
        self.start()?;
        let mut books = self.shared.lock();
        books.ahead.clear();
        // What was worked ahead and is expected no longer would never be asked for.
        let expected: BTreeSet<Digest> = errands.iter().map(|errand| errand.key).collect();
        let Books { unasked, done, running, ahead, .. } = &mut *books;
        unasked.retain(|key| {
            let stays = expected.contains(key) || running.contains(key);
            if !stays {
                done.remove(key);
            }
            stays
        });
        let known = |key: &Digest| running.contains(key) || done.contains_key(key);
        ahead.extend(errands.into_iter().filter(|errand| !known(&errand.key)));
        drop(books);
        self.shared.changed.notify_all();
        Ok(())
    }

    /// Works what is asked for, each thing once, and hands it over in that order. Meanwhile, and after, the others go on with what is
    /// expected.
    ///
    /// # Errors
    /// If a worker panicked, naming the errand, if `cancel` was raised, or if two errands are the same: nothing is
    /// handed over then.
    pub fn work(&self, errands: Vec<Errand<R>>, cancel: &AtomicBool) -> Result<Vec<R>, Fault> {
        if self.jobs > 1 {
            self.start()?;
        }
        let keys: Vec<Digest> = errands.iter().map(|errand| errand.key).collect();
        let mut books = self.shared.lock();
        for errand in errands {
            let Books { wanted, ahead, running, done, unasked, .. } = &mut *books;
            ahead.retain(|other| other.key != errand.key);
            unasked.remove(&errand.key);
            if !running.contains(&errand.key) && !done.contains_key(&errand.key) {
                wanted.push_back(errand);
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
                return Err(Fault::Impossible("the evaluation was interrupted".to_owned()));
            }
            if keys.iter().all(|key| books.done.contains_key(key)) {
                return hand_over(&mut books, &keys);
            }
            match books.next(self.jobs) {
                Some(errand) => {
                    drop(books);
                    self.shared.run(errand, &mut own);
                }
                None => {
                    // Another worker has what is missing.
                    drop(self.shared.changed.wait(books).unwrap_or_else(PoisonError::into_inner));
                }
            }
        }
    }

    fn start(&self) -> Result<(), Fault> {
        let mut threads = self.threads.lock().unwrap_or_else(PoisonError::into_inner);
        while threads.len() + 1 < self.jobs {
            let (shared, jobs) = (Arc::clone(&self.shared), self.jobs);
            let thread =
                std::thread::Builder::new().name("trial".to_owned()).spawn(move || shared.serve(jobs));
            let failed = |error| Fault::Impossible(format!("a worker's thread does not start: {error}"));
            threads.push(thread.map_err(failed)?);
        }
        Ok(())
    }
}

impl<R> Drop for Crew<R> {
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

impl<R> Books<R> {
    /// The next to be worked; nothing is worked ahead beyond what is kept for those who ask.
    fn next(&mut self, jobs: usize) -> Option<Errand<R>> {
        let errand = self.wanted.pop_front().or_else(|| {
            let room = self.unasked.len() < AHEAD_PER_JOB * jobs;
            let errand = if room { self.ahead.pop_front() } else { None };
            self.unasked.extend(errand.as_ref().map(|errand| errand.key));
            errand
        })?;
        self.running.insert(errand.key);
        Some(errand)
    }
}

impl<R> CrewShared<R> {
    fn lock(&self) -> MutexGuard<'_, Books<R>> {
        self.books.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, errand: Errand<R>, worker: &mut Worker) {
        let Errand { key, work } = errand;
        let worked = catch_unwind(AssertUnwindSafe(|| work(worker))).map_err(|panic| {
            // Its world may be half changed.
            *worker = Worker::new();
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            text.or_else(|| panic.downcast_ref::<String>().cloned())
                .unwrap_or_else(|| "panic without a message".to_owned())
        });
        let mut books = self.lock();
        books.running.remove(&key);
        books.done.insert(key, worked);
        drop(books);
        self.changed.notify_all();
    }

    fn serve(&self, jobs: usize) {
        let mut worker = Worker::new();
        loop {
            let mut books = self.lock();
            let errand = loop {
                if books.closed {
                    return;
                }
                match books.next(jobs) {
                    Some(errand) => break errand,
                    None => books = self.changed.wait(books).unwrap_or_else(PoisonError::into_inner),
                }
            };
            drop(books);
            self.run(errand, &mut worker);
        }
    }
}

/// Takes the results out, in order. A panic of any of them fails them all.
fn hand_over<R>(books: &mut Books<R>, keys: &[Digest]) -> Result<Vec<R>, Fault> {
    let mut results = Vec::with_capacity(keys.len());
    let mut failed = None;
    for (item, key) in (0_u64..).zip(keys) {
        match books.done.remove(key) {
            Some(Ok(result)) => results.push(result),
            Some(Err(message)) => failed = failed.or(Some(SimError::Worker { item, message })),
            None if failed.is_none() => {
                return Err(Fault::Impossible("one errand was asked for twice at a time".to_owned()));
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
    use std::sync::atomic::AtomicU64;

    fn errand(number: u64, run: &Arc<AtomicU64>) -> Errand<u64> {
        let run = Arc::clone(run);
        let work = move |_: &mut Worker| {
            run.fetch_add(1, Ordering::Relaxed);
            assert!(number != 7, "seven is broken");
            number * number
        };
        Errand { key: Digest::of_parts("test", &[&number.to_le_bytes()]), work: Box::new(work) }
    }

    #[test]
    fn hands_over_in_order_for_any_number_of_jobs_and_whatever_was_expected() {
        for jobs in [1, 2, 5] {
            let (crew, run) = (Crew::new(jobs), Arc::new(AtomicU64::new(0)));
            let list = |range: std::ops::Range<u64>| range.map(|number| errand(number, &run)).collect();
            crew.expect(list(20..60)).unwrap();
            assert_eq!(crew.work(list(10..30), &AtomicBool::new(false)).unwrap(), squares(10..30));
            crew.expect(list(30..33)).unwrap();
            assert_eq!(crew.work(list(30..50), &AtomicBool::new(false)).unwrap(), squares(30..50));
            // Twice in a row: what was handed over is worked again.
            assert_eq!(crew.work(list(30..50), &AtomicBool::new(false)).unwrap(), squares(30..50));
            drop(crew);
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
    fn what_waits_for_nobody_is_bounded() {
        let (crew, run) = (Crew::new(2), Arc::new(AtomicU64::new(0)));
        crew.expect((100..1100).map(|number| errand(number, &run)).collect()).unwrap();
        let begun = std::time::Instant::now();
        while run.load(Ordering::Relaxed) < 2 * AHEAD_PER_JOB as u64 && begun.elapsed().as_secs() < 20 {
            std::thread::yield_now();
        }
        assert_eq!(crew.work(vec![errand(1, &run)], &AtomicBool::new(false)).unwrap(), [1]);
        drop(crew);
        assert_eq!(run.load(Ordering::Relaxed), 2 * AHEAD_PER_JOB as u64 + 1);
    }

    #[test]
    fn a_panic_fails_what_was_asked_for_and_nothing_else() {
        for jobs in [1, 3] {
            let (crew, run) = (Crew::new(jobs), Arc::new(AtomicU64::new(0)));
            let list = |range: std::ops::Range<u64>| range.map(|number| errand(number, &run)).collect();
            let failed = crew.work(list(5..9), &AtomicBool::new(false)).unwrap_err().to_string();
            assert!(failed.contains("seven is broken") && failed.contains('2'), "{failed}");
            assert_eq!(crew.work(list(8..12), &AtomicBool::new(false)).unwrap(), squares(8..12));
        }
    }

    #[test]
    fn a_raised_flag_interrupts() {
        let (crew, run) = (Crew::new(2), Arc::new(AtomicU64::new(0)));
        let cancelled = AtomicBool::new(true);
        assert!(crew.work(vec![errand(1, &run)], &cancelled).is_err());
        assert_eq!(crew.work(vec![errand(2, &run)], &AtomicBool::new(false)).unwrap(), [4]);
    }
}
