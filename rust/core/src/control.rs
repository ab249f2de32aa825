//! Progress and cancellation of long computations.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use rayon::prelude::*;

use crate::{Error, Result};

/// Reports the progress of a computation, and cancels it. The computing thread and the observing thread share it.
#[derive(Debug, Default)]
pub struct Control {
    stop: Arc<AtomicBool>,
    stage: Mutex<(&'static str, u64)>,
    done: AtomicU64,
}

/// The progress of a computation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// The name of the current stage; empty before the first stage.
    pub stage: &'static str,
    /// The number of finished steps of the stage.
    pub done: u64,
    /// The number of steps of the stage.
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

    /// Returns the current progress.
    pub fn progress(&self) -> Progress {
        let (stage, total) = *self.stage.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        Progress { stage, done: self.done.load(Ordering::Relaxed).min(total), total }
    }

    /// Runs a stage that computes one value per item in parallel, in order. One step handles `chunk` items.
    pub(crate) fn each<T: Sync, U: Copy + Send>(
        &self, stage: &'static str, items: &[T], chunk: usize, value: impl Fn(&T) -> U + Sync,
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

    /// Returns a control for a part of the work, which is cancelled with this one, but reports no progress.
    pub fn part(&self) -> Self {
        Self { stop: Arc::clone(&self.stop), ..Self::default() }
    }

    /// Requests cancellation. The computation returns [`Error::Cancelled`] soon afterwards.
    pub fn cancel(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Returns [`Error::Cancelled`] if cancellation was requested. Computations call it every few milliseconds.
    ///
    /// # Errors
    /// [`Error::Cancelled`] after [`cancel`](Self::cancel).
    #[inline]
    pub fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }
}
