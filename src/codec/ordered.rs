//! Work in parallel, results in order, memory bounded.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;

use crate::error::{Error, Result};

/// Does `work` for each job on `threads` threads and hands the results to `sink` in the order of the
/// jobs. Jobs are drawn, and results handed over, on the calling thread; at most `threads + 1` are
/// under way or waiting, so memory does not grow with their number.
///
/// # Errors
/// The first error of the jobs, the work or the sink, in the order of the jobs; which one does not
/// depend on timing.
pub(super) fn run_ordered<J: Send, T: Send>(
    threads: usize,
    jobs: impl Iterator<Item = Result<J>>,
    work: impl Fn(J) -> Result<T> + Sync,
    mut sink: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::InvalidConfig(format!("cannot start {threads} threads: {e}")))?;
    let stop = AtomicBool::new(false);
    let (stop, work) = (&stop, &work);
    pool.in_place_scope_fifo(|scope| {
        let pass = || -> Result<()> {
            let mut waiting = VecDeque::new();
            for job in jobs {
                let job = job?;
                let (sender, receiver) = mpsc::sync_channel(1);
                scope.spawn_fifo(move |_| {
                    if !stop.load(Ordering::Relaxed) {
                        // The receiver is gone after an error elsewhere; nobody misses the result.
                        let _ = sender.send(work(job));
                    }
                });
                waiting.push_back(receiver);
                if waiting.len() > threads
                    && let Some(first) = waiting.pop_front()
                {
                    sink(receive(&first)?)?;
                }
            }
            waiting.iter().try_for_each(|receiver| sink(receive(receiver)?))
        };
        let result = pass();
        // After an error, do not begin what nobody waits for.
        stop.store(true, Ordering::Relaxed);
        result
    })
}

/// Waits for a result. Its sender is gone only if the worker panicked, which the scope passes on.
fn receive<T>(receiver: &mpsc::Receiver<Result<T>>) -> Result<T> {
    receiver.recv().unwrap_or_else(|_| Err(Error::InvalidConfig("a worker thread died".to_owned())))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;
    use std::thread::sleep;
    use std::time::Duration;

    use super::*;

    #[test]
    fn results_come_in_order_and_few_wait() {
        let (begun, mut done) = (AtomicUsize::new(0), Vec::new());
        let jobs = (0..40usize).map(|job| {
            begun.fetch_add(1, Ordering::Relaxed);
            Ok(job)
        });
        let work = |job: usize| {
            sleep(Duration::from_micros((job * 7 % 5) as u64 * 200));
            Ok(job * job)
        };
        run_ordered(4, jobs, work, |square| {
            done.push(square);
            assert!(begun.load(Ordering::Relaxed) <= done.len() + 4, "too many under way");
            Ok(())
        })
        .unwrap();
        assert_eq!(done, (0..40usize).map(|job| job * job).collect::<Vec<_>>());
    }

    #[test]
    fn the_first_error_wins() {
        let fail = |what: usize| Error::corrupt(what.to_string());
        let work = |job: usize| if job >= 5 { Err(fail(job)) } else { Ok(job) };
        let mut delivered = 0;
        let count = |_| {
            delivered += 1;
            Ok(())
        };
        let error = run_ordered(3, (0..20).map(Ok), work, count).unwrap_err();
        assert_eq!((error.to_string(), delivered), (fail(5).to_string(), 5));

        let error = run_ordered(3, (0..20).map(Ok), Ok, |job: usize| Err::<(), _>(fail(job))).unwrap_err();
        assert_eq!(error.to_string(), fail(0).to_string());
    }
}
