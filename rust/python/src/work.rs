//! Long computations that keep Python responsive: signals, progress, cancellation, errors.

use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::exceptions::{PyOSError, PyRuntimeError};
use pyo3::prelude::*;
use voxflat::{Control, Error, Result, control};

pyo3::import_exception!(voxflat.errors, VoxflatError);
pyo3::import_exception!(voxflat.errors, InputError);
pyo3::import_exception!(voxflat.errors, Cancelled);

/// How often the waiting thread checks for signals and reports progress.
const POLL: Duration = Duration::from_millis(20);

/// How long to wait for cancelled work. The factorisation of a large matrix cannot be interrupted: it ends on its own,
/// and its result is dropped, so that the user regains control at once.
const PATIENCE: Duration = Duration::from_millis(60);

/// The stage that is reported while the work has not begun one, so that the callback can cancel it.
const WAITING: &str = "preparing";

/// An optional callback that receives the stage, the number of finished steps and the total number of steps.
pub type Progress<'py> = Option<Bound<'py, PyAny>>;

/// The number of threads; None means one per core.
pub type Threads = Option<usize>;

/// Runs `work` on its own threads (`threads` of them, or one per core) without the GIL. The calling thread reports
/// progress to `progress(stage, done, total)`. If that returns False or raises, or on Ctrl-C, the work is cancelled.
pub fn run<T: Send + 'static>(
    py: Python<'_>, threads: Threads, progress: &Progress<'_>,
    work: impl FnOnce(&Control) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
    let pool = pool.map_err(|error| PyRuntimeError::new_err(format!("cannot start threads: {error}")))?;
    let progress = progress.as_ref().map(|callback| callback.clone().unbind());
    let control = Arc::new(Control::default());
    let (sender, receiver) = channel();
    let controlled = Arc::clone(&control);
    // the sender is dropped at the end, even after a panic, which ends the waiting
    let start = std::thread::Builder::new().spawn(move || sender.send(pool.install(|| work(&controlled))));
    start.map_err(|error| PyRuntimeError::new_err(format!("cannot start a thread: {error}")))?;
    py.detach(move || {
        loop {
            let ended = receiver.recv_timeout(POLL);
            let mut now = control.progress();
            if now.stage.is_empty() && ended.is_err() {
                now = control::Progress { stage: WAITING, done: 0, total: 1 };
            }
            // called even without progress, because it can cancel the work
            if let Err(reason) = Python::attach(|py| watch(py, progress.as_ref(), now)) {
                control.cancel();
                if ended.is_err() {
                    let _ = receiver.recv_timeout(PATIENCE);
                }
                return Err(reason);
            }
            match ended {
                Ok(result) => return result.map_err(to_python),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(PyRuntimeError::new_err(
                        "an internal error stopped the computation; please report it with the input that caused it",
                    ));
                }
            }
        }
    })
}

/// Runs `work` on a shared value, as [`run`] does.
pub fn run_on<I: Send + Sync + 'static, T: Send + 'static>(
    value: &Arc<I>, py: Python<'_>, threads: Threads, progress: &Progress<'_>,
    work: impl FnOnce(&I, &Control) -> Result<T> + Send + 'static,
) -> PyResult<T> {
    let value = Arc::clone(value);
    run(py, threads, progress, move |control| work(&value, control))
}

fn watch(py: Python<'_>, progress: Option<&Py<PyAny>>, now: control::Progress) -> PyResult<()> {
    py.check_signals()?;
    if let Some(callback) = progress
        && !now.stage.is_empty()
    {
        let answer = callback.bind(py).call1((now.stage, now.done, now.total))?;
        if answer.extract::<bool>().is_ok_and(|go_on| !go_on) && !answer.is_none() {
            return Err(Cancelled::new_err("cancelled"));
        }
    }
    Ok(())
}

/// Returns the Python exception of a core error.
pub fn to_python(error: Error) -> PyErr {
    let message = error.to_string();
    match error {
        Error::Cancelled => Cancelled::new_err(message),
        Error::EigenNotConverged { .. } | Error::RadialSingular { .. } => VoxflatError::new_err(message),
        Error::StoreFailed { path, code, .. } => os_error(code, "EIO", &message, path),
        Error::StoreInUse { path, .. } => os_error(None, "EAGAIN", &message, path),
        _ => InputError::new_err(message),
    }
}

/// Returns an OSError of the class that belongs to the system's code, or to a name in Python's `errno`. The exception
/// names the file.
fn os_error(code: Option<i32>, name: &str, message: &str, path: String) -> PyErr {
    let message = message.replacen(&format!(" {path}"), "", 1);
    Python::attach(|py| {
        let code = code.map_or_else(|| py.import("errno")?.getattr(name)?.extract(), Ok);
        code.map_or_else(|error: PyErr| error, |code: i32| PyOSError::new_err((code, message, path)))
    })
}
