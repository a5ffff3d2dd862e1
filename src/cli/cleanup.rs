//! Temporary files and folders that a signal must not leave behind.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What to remove when the program is told to stop.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

fn temporary() -> MutexGuard<'static, Vec<PathBuf>> {
    TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// While this lives, its path is removed if a signal ends the program.
#[derive(Debug)]
pub struct RemoveOnSignal(PathBuf);

impl RemoveOnSignal {
    pub fn new(path: &Path) -> Self {
        temporary().push(path.to_path_buf());
        RemoveOnSignal(path.to_path_buf())
    }
}

impl Drop for RemoveOnSignal {
    fn drop(&mut self) {
        temporary().retain(|path| *path != self.0);
    }
}

/// From now on, SIGINT, SIGTERM and SIGHUP remove what is temporary before they end the program.
#[cfg(unix)]
pub fn on_signals() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

    // Without the handler the signals still end the program, only less tidily.
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP]) else { return };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            // The lock is kept: nothing new becomes temporary any more.
            let temporary = temporary();
            temporary.iter().for_each(|path| remove(path));
            // Ends the program as the signal would have, so that a shell's loop ends as well.
            let _ = signal_hook::low_level::emulate_default_handler(signal);
        }
    });
}

/// Elsewhere signals end the program as they always do.
#[cfg(not(unix))]
pub fn on_signals() {}

/// Removes a file, or a folder with all files in it, of which more may be appearing meanwhile.
#[cfg(unix)]
fn remove(path: &Path) {
    for _ in 0..100 {
        let removed = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
        if removed.is_ok() || !path.exists() {
            return;
        }
    }
}
