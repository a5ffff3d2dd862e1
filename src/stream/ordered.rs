//! Parallel work with results in order and bounded memory.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread;

use rayon::ThreadPool;

use crate::ground::error::{Error, Result};
use crate::ground::team;

/// An event that the calling thread waits for.
enum Event<J, T> {
    /// The next job.
    Job(Result<J>),
    /// There are no more jobs.
    End,
    /// The job with this number has ended.
    Done(usize, Result<T>),
}

/// Calls `work` for each job on `threads` threads (0: one for each processor) and passes the results to
/// `sink` in the order of the jobs, each as soon as it and those before are available. Jobs are drawn on a
/// separate thread, which may wait for its input; results are passed on the calling thread. At most
/// `threads + 1` jobs are drawn, running or waiting at a time, so that memory does not grow with their
/// number. After an error, this returns only when the job that is being drawn has arrived.
///
/// # Errors
/// The first error of the jobs, the work or the sink, in the order of the jobs; which one does not depend on
/// timing.
pub(crate) fn run_ordered<J: Send, T: Send>(
    threads: usize,
    jobs: impl Iterator<Item = Result<J>> + Send,
    work: impl Fn(J) -> Result<T> + Sync,
    sink: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let threads = team::resolve_threads(threads);
    let pool = team::pool(threads)?;
    let stop = AtomicBool::new(false);
    let (stop, work) = (&stop, &work);
    let (events, inbox) = mpsc::channel();
    let (permits, permitted) = mpsc::channel::<()>();
    thread::scope(|drawer| {
        let drawn = events.clone();
        drawer.spawn(move || draw(jobs, &permitted, drawn));
        pool.in_place_scope_fifo(|scope| {
            let start = |place, job| {
                let ticket = Ticket { events: events.clone(), place, is_done: false };
                scope.spawn_fifo(move |_| {
                    if !stop.load(Ordering::Relaxed) {
                        ticket.done(team::job(|| work(job)));
                    }
                });
            };
            for _ in 0..=threads {
                // If the drawing thread is gone, its last event is yet to be received.
                let _ = permits.send(());
            }
            let result = pass(&inbox, &permits, start, sink);
            // After an error, do not start jobs whose results are not needed.
            stop.store(true, Ordering::Relaxed);
            drop(permits);
            result
        })
    })
}

/// Draws a job for each permit, up to the last or the first error.
fn draw<J, T>(
    mut jobs: impl Iterator<Item = Result<J>>,
    permitted: &mpsc::Receiver<()>,
    events: Sender<Event<J, T>>,
) {
    let events = Drawn(events);
    for () in permitted {
        let Some(job) = jobs.next() else { return };
        let is_last = job.is_err();
        if events.0.send(Event::Job(job)).is_err() || is_last {
            return;
        }
    }
}

/// Sends the end of the jobs, even if drawing one panics (the scope propagates the panic).
struct Drawn<J, T>(Sender<Event<J, T>>);

impl<J, T> Drop for Drawn<J, T> {
    fn drop(&mut self) {
        let _ = self.0.send(Event::End);
    }
}

/// Starts jobs as they arrive, and passes on results in order.
fn pass<J, T>(
    inbox: &mpsc::Receiver<Event<J, T>>,
    permits: &Sender<()>,
    start: impl Fn(usize, J),
    mut sink: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let mut results = InOrder::default();
    let mut ended = false;
    while !ended || !results.is_empty() {
        match inbox.recv() {
            Ok(Event::Job(Ok(job))) => start(results.expect(), job),
            Ok(Event::Job(Err(error))) => {
                ended = true;
                let place = results.expect();
                results.put(place, Err(error));
            }
            Ok(Event::Done(place, result)) => results.put(place, result),
            Ok(Event::End) | Err(_) => ended = true,
        }
        while let Some(result) = results.take() {
            sink(result?)?;
            let _ = permits.send(());
        }
    }
    Ok(())
}

/// The results of jobs, taken in the order of the jobs.
struct InOrder<T> {
    /// From the job with number `first` on; `None` until they arrive.
    results: VecDeque<Option<Result<T>>>,
    first: usize,
}

impl<T> Default for InOrder<T> {
    fn default() -> Self {
        InOrder { results: VecDeque::new(), first: 0 }
    }
}

impl<T> InOrder<T> {
    /// Number of results that have not been taken.
    fn len(&self) -> usize {
        self.results.len()
    }

    fn is_empty(&self) -> bool {
        self.results.is_empty()
    }

    /// Makes room for the result of the next job. Returns the number of the job.
    fn expect(&mut self) -> usize {
        self.results.push_back(None);
        self.first + self.results.len() - 1
    }

    fn put(&mut self, job: usize, result: Result<T>) {
        if let Some(place) = self.results.get_mut(job - self.first) {
            *place = Some(result);
        }
    }

    /// Whether the next result in order is expected, but has not arrived.
    fn waits(&self) -> bool {
        matches!(self.results.front(), Some(None))
    }

    /// The next result in order, if it has arrived.
    fn take(&mut self) -> Option<Result<T>> {
        if self.waits() {
            return None;
        }
        let result = self.results.pop_front()?;
        self.first += 1;
        result
    }
}

/// Sends the result of a job, even if its worker panics (the scope propagates the panic).
struct Ticket<J, T> {
    events: Sender<Event<J, T>>,
    place: usize,
    is_done: bool,
}

impl<J, T> Ticket<J, T> {
    fn done(mut self, result: Result<T>) {
        self.is_done = true;
        // The receiver is gone after an error elsewhere; the result is not needed then.
        let _ = self.events.send(Event::Done(self.place, result));
    }
}

impl<J, T> Drop for Ticket<J, T> {
    fn drop(&mut self) {
        if !self.is_done {
            let died = Error::Internal("a worker thread died".to_owned());
            let _ = self.events.send(Event::Done(self.place, Err(died)));
        }
    }
}

/// Threads that work ahead of a caller that polls from time to time: jobs in, results out in the order of the
/// jobs. The caller must limit the number of unfinished jobs.
pub(crate) struct Workers<T> {
    /// None: jobs are run on the caller's thread when they are started.
    pool: Option<ThreadPool>,
    events: Sender<Event<(), T>>,
    inbox: Receiver<Event<(), T>>,
    results: InOrder<T>,
    threads: usize,
    /// Set when results are no longer needed.
    stop: Arc<AtomicBool>,
}

impl<T: Send + 'static> Workers<T> {
    /// A pool of `threads` threads (0: one for each processor); with 1, jobs are run on the caller's thread
    /// instead.
    ///
    /// # Errors
    /// If they cannot be started.
    pub fn new(threads: usize) -> Result<Self> {
        // A panic of a worker is reported by its ticket.
        let threads = team::resolve_threads(threads);
        let pool = (threads > 1).then(|| team::pool_that_survives_panics(threads)).transpose()?;
        let (events, inbox) = mpsc::channel();
        Ok(Workers { pool, events, inbox, results: InOrder::default(), threads, stop: Arc::default() })
    }

    /// Whether enough jobs are running, or done with their results not taken.
    pub fn is_full(&self) -> bool {
        self.results.len() > self.threads
    }

    /// Starts a job.
    pub fn start(&mut self, job: impl FnOnce() -> Result<T> + Send + 'static) {
        let place = self.results.expect();
        let Some(pool) = &self.pool else {
            self.results.put(place, job());
            return;
        };
        let ticket = Ticket { events: self.events.clone(), place, is_done: false };
        let stop = Arc::clone(&self.stop);
        pool.spawn_fifo(move || {
            if !stop.load(Ordering::Relaxed) {
                ticket.done(team::job(job));
            }
        });
    }

    /// The result of the oldest job, once it is done; `None` if there is no job.
    pub fn wait(&mut self) -> Option<Result<T>> {
        while self.results.waits() {
            let Ok(event) = self.inbox.recv() else { break };
            self.accept(event);
        }
        self.results.take()
    }

    /// The result of the oldest job, if it is done.
    pub fn poll(&mut self) -> Option<Result<T>> {
        while let Ok(event) = self.inbox.try_recv() {
            self.accept(event);
        }
        self.results.take()
    }

    fn accept(&mut self, event: Event<(), T>) {
        if let Event::Done(place, result) = event {
            self.results.put(place, result);
        }
    }
}

impl<T> Drop for Workers<T> {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
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

    #[test]
    fn workers_give_results_in_the_order_of_the_jobs() {
        for threads in [1, 3] {
            let mut workers = Workers::new(threads).unwrap();
            let mut done = Vec::new();
            for job in 0..40usize {
                while workers.is_full() {
                    done.push(workers.wait().unwrap().unwrap());
                }
                workers.start(move || {
                    sleep(Duration::from_micros((job * 7 % 5) as u64 * 200));
                    Ok(job)
                });
                done.extend(std::iter::from_fn(|| workers.poll()).map(Result::unwrap));
            }
            done.extend(std::iter::from_fn(|| workers.wait()).map(Result::unwrap));
            assert_eq!(done, (0..40).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_worker_that_panics_is_an_error() {
        let mut workers = Workers::<()>::new(2).unwrap();
        workers.start(|| panic!("on purpose"));
        workers.start(|| Ok(()));
        assert!(workers.wait().unwrap().unwrap_err().to_string().contains("died"));
        assert!(workers.wait().unwrap().is_ok() && workers.wait().is_none());
    }

    #[test]
    fn a_result_does_not_wait_for_the_next_job() {
        let (sender, receiver) = mpsc::channel();
        let sender = std::cell::RefCell::new(Some(sender));
        sender.borrow().as_ref().unwrap().send(0).unwrap();
        let mut delivered = Vec::new();
        run_ordered(2, receiver.into_iter().map(Ok), Ok, |job: u32| {
            delivered.push(job);
            // Job 1 arrives only after the result of job 0, and the end only after that of job 1.
            let next = sender.take().filter(|_| job == 0);
            next.iter().for_each(|next| next.send(1).unwrap());
            *sender.borrow_mut() = next;
            Ok(())
        })
        .unwrap();
        assert_eq!(delivered, [0, 1]);
    }
}
