//! Pools of threads that count their jobs. A job is split between threads only while some threads have no
//! job: a thread that waits for a part of its job would otherwise start another job, and hold the memory of
//! both.

use std::cell::OnceCell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use rayon::{ThreadPool, ThreadPoolBuilder};

use super::error::{Error, Result};

thread_local! {
    /// The number of running jobs in the pool that this thread belongs to.
    static JOBS: OnceCell<Arc<AtomicUsize>> = const { OnceCell::new() };
}

/// The number of threads to use: one for each processor if `threads` is 0.
pub(crate) fn resolve_threads(threads: usize) -> usize {
    match threads {
        0 => thread::available_parallelism().map_or(1, Into::into),
        _ => threads,
    }
}

/// A pool of `threads` threads (0: one for each processor).
///
/// # Errors
/// If they cannot be started.
pub(crate) fn pool(threads: usize) -> Result<ThreadPool> {
    let threads = resolve_threads(threads);
    started(threads, builder(threads))
}

/// A pool of `threads` threads in which the panic of a job ends only that job.
///
/// # Errors
/// If they cannot be started.
pub(crate) fn pool_that_survives_panics(threads: usize) -> Result<ThreadPool> {
    started(threads, builder(threads).panic_handler(drop))
}

/// A pool for parallel work within a frame; none if `threads` is 1.
///
/// # Errors
/// If its threads cannot be started.
pub(crate) fn pool_for_frames(threads: usize) -> Result<Option<ThreadPool>> {
    /// The largest number of parallel tasks: two halves.
    const MOST: usize = 2;
    let threads = resolve_threads(threads).min(MOST);
    (threads > 1).then(|| pool(threads)).transpose()
}

fn builder(threads: usize) -> ThreadPoolBuilder {
    let jobs = Arc::new(AtomicUsize::new(0));
    let join_pool = move |_| drop(JOBS.with(|of_thread| of_thread.set(Arc::clone(&jobs))));
    ThreadPoolBuilder::new().num_threads(threads).start_handler(join_pool)
}

fn started(threads: usize, builder: ThreadPoolBuilder) -> Result<ThreadPool> {
    builder.build().map_err(|error| Error::Internal(format!("cannot start {threads} threads: {error}")))
}

/// Runs a function on a thread of a pool, or on this thread if there is no pool.
pub(crate) fn on<T: Send>(pool: Option<&ThreadPool>, work: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(work),
        None => work(),
    }
}

/// Runs a job, which is counted until it ends.
pub(crate) fn job<T>(work: impl FnOnce() -> T) -> T {
    let _count = JOBS.with(|jobs| jobs.get().map(Count::new));
    work()
}

/// Runs two functions, in parallel if this is a thread of a [`pool`] with fewer jobs than threads.
pub(crate) fn both<A: Send, B: Send>(
    first: impl FnOnce() -> A + Send,
    second: impl FnOnce() -> B + Send,
) -> (A, B) {
    let jobs = JOBS.with(|jobs| jobs.get().map(|jobs| jobs.load(Ordering::Relaxed)));
    match jobs {
        Some(jobs) if jobs < rayon::current_num_threads() => rayon::join(first, second),
        _ => (first(), second()),
    }
}

/// A running job; the count is decremented when this is dropped.
struct Count(Arc<AtomicUsize>);

impl Count {
    fn new(jobs: &Arc<AtomicUsize>) -> Self {
        jobs.fetch_add(1, Ordering::Relaxed);
        Count(Arc::clone(jobs))
    }
}

impl Drop for Count {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Locks a mutex even if a thread panicked while it held it: the panic itself is reported elsewhere.
pub fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;
    use std::thread::current;

    use super::*;

    #[test]
    fn a_job_is_split_only_while_a_thread_has_none() {
        let pool = pool(2).unwrap();
        // Each half waits for the other, so they must run on two threads.
        let barrier = Barrier::new(2);
        let half = || (barrier.wait(), current().id()).1;
        let (first, second) = pool.install(|| job(|| both(half, half)));
        assert_ne!(first, second);
        // Two jobs, whose threads meet before and after: neither is split.
        let own = || {
            let own = current().id();
            job(|| {
                barrier.wait();
                let (first, second) = both(|| current().id(), || current().id());
                assert_eq!([first, second], [own; 2]);
                barrier.wait();
            });
        };
        pool.install(|| rayon::join(own, own));
        // The count is decremented even if a job panics.
        let panics = || pool.install(|| job(|| panic!("on purpose")));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(panics)).is_err());
        let (first, second) = pool.install(|| job(|| both(half, half)));
        assert_ne!(first, second);
        // Outside a pool both run on the same thread.
        assert_eq!(both(|| current().id(), || current().id()), (current().id(), current().id()));
    }
}
