//! Progress and cancelling of long work.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use rayon::prelude::*;

use crate::error::{Error, Result};

/// What long work reports and obeys. Share it between the thread that works and the one that watches.
#[derive(Debug, Default)]
pub struct Control {
    stop: Arc<AtomicBool>,
    stage: Mutex<(&'static str, u64)>,
    done: AtomicU64,
}

/// Where long work stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The stage's name; empty before the first.
    pub stage: &'static str,
    /// Steps of the stage that are done.
    pub done: u64,
    /// Steps that the stage has.
    pub total: u64,
}

impl Control {
    /// Begins a stage of `total` steps.
    pub fn begin(&self, stage: &'static str, total: u64) {
        let mut now = self.stage.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        self.done.store(0, Ordering::Relaxed);
        *now = (stage, total);
    }

    /// Counts one step of the stage as done.
    pub fn advance(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }

    /// Where the work stands.
    pub fn progress(&self) -> Progress {
        let (stage, total) = *self.stage.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        Progress { stage, done: self.done.load(Ordering::Relaxed).min(total), total }
    }

    /// A stage that takes one value an item, in parallel, in the order of the items; its steps are `chunk` of them.
    pub(crate) fn each<T: Sync, U: Copy + Send>(
        &self,
        stage: &'static str,
        items: &[T],
        chunk: usize,
        value: impl Fn(&T) -> U + Sync,
    ) -> Result<Vec<U>> {
        self.begin(stage, items.len().div_ceil(chunk) as u64);
        let of_chunk = |items: &[T]| {
            self.check()?;
            let values = items.iter().map(&value).collect();
            self.advance();
            Ok(values)
        };
        Ok(items.par_chunks(chunk).map(of_chunk).collect::<Result<Vec<Vec<U>>>>()?.concat())
    }

    /// For a part of the work: cancelled with it, its own progress untold.
    pub fn part(&self) -> Self {
        Self { stop: Arc::clone(&self.stop), ..Self::default() }
    }

    /// Asks the work to end; it returns [`Error::Cancelled`] soon after.
    pub fn cancel(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Called by the work at least every few milliseconds.
    #[inline]
    pub fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }
}
