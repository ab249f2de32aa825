//! Parallel work on many independent items that each take long.

use std::sync::{Mutex, PoisonError};
use std::thread::Builder;

use crate::Result;

/// Processes all items; each thread takes the next item as soon as it is free. `scratch` is created once per thread.
///
/// The number of threads is that of the caller's pool. If there are several, new threads are started, because the
/// threads of the pool sleep: on virtual processors, a thread that is woken can wait for 20 ms beside the thread that
/// woke it while another processor is idle (docs/decisions/0002). `work` must not be parallel itself, because it runs
/// outside the pool. Errors: The first error of `work`, after which no further item is started.
pub(crate) fn in_turn<I, T>(
    items: I, scratch: impl Fn() -> T + Sync, work: impl Fn(&mut T, I::Item) -> Result<()> + Sync,
) -> Result<()>
where
    I: ExactSizeIterator + Send,
{
    let threads = rayon::current_num_threads().min(items.len());
    let others = if threads > 1 { threads } else { 0 };
    let turns = Mutex::new((items, Ok(())));
    let held = || turns.lock().unwrap_or_else(PoisonError::into_inner);
    let take = || {
        let (items, outcome) = &mut *held();
        if outcome.is_ok() { items.next() } else { None }
    };
    let work_on = || {
        let mut scratch = scratch();
        while let Some(item) = take() {
            if let Err(error) = work(&mut scratch, item) {
                let outcome = &mut held().1;
                *outcome = outcome.clone().and(Err(error));
            }
        }
    };
    std::thread::scope(|scope| {
        let started = (0..others).filter(|_| Builder::new().spawn_scoped(scope, work_on).is_ok()).count();
        if started == 0 {
            work_on(); // alone, or where the system starts no more threads
        }
    });
    held().1.clone()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Error;
    use crate::tests::with_threads as on;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn every_item_is_worked_on_once_with_a_scratch_a_thread() {
        for (threads, count) in [(1, 100), (2, 100), (7, 100), (7, 3), (2, 0)] {
            let mut done = vec![0; count];
            let scratches = AtomicUsize::new(0);
            let scratch = || scratches.fetch_add(1, Ordering::Relaxed);
            on(threads, || {
                in_turn(done.iter_mut().enumerate(), scratch, |_, (n, done)| {
                    *done += n + 1;
                    Ok(())
                })
            })
            .unwrap();
            assert_eq!(done, (1..=count).collect::<Vec<_>>());
            assert!(scratches.into_inner() <= threads.min(count).max(1));
        }
    }

    #[test]
    fn an_error_ends_the_work() {
        for threads in [1, 3] {
            let begun = AtomicUsize::new(0);
            let result = on(threads, || {
                in_turn(
                    0..1_000_000,
                    || (),
                    |(), n| {
                        begun.fetch_add(1, Ordering::Relaxed);
                        if n == 20 { Err(Error::Cancelled) } else { Ok(()) }
                    },
                )
            });
            assert_eq!(result, Err(Error::Cancelled));
            assert!(begun.into_inner() < 1_000_000);
        }
    }

    #[test]
    #[should_panic(expected = "a scoped thread panicked")]
    fn a_panic_is_passed_on() {
        let work = |(): &mut (), n| if n == 3 { panic!("as some bug would") } else { Ok(()) };
        let _ = on(3, || in_turn(0..10, || (), work));
    }
}
