//! Temporary files and folders that must not remain after a signal.

#[cfg(unix)]
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::sync::Arc;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The paths to remove when a signal ends the program.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// The message to print when a signal ends the program.
static LAST_WORDS: Mutex<Option<String>> = Mutex::new(None);

/// While this exists, a signal that ends the program prints a message first.
#[derive(Debug)]
pub struct SayOnSignal;

impl SayOnSignal {
    pub fn new(words: String) -> Self {
        *LAST_WORDS.lock().unwrap_or_else(PoisonError::into_inner) = Some(words);
        SayOnSignal
    }
}

impl Drop for SayOnSignal {
    fn drop(&mut self) {
        LAST_WORDS.lock().unwrap_or_else(PoisonError::into_inner).take();
    }
}

fn temporary() -> MutexGuard<'static, Vec<PathBuf>> {
    TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// While this exists, its path is removed if a signal ends the program.
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

/// From now on, SIGINT, SIGTERM and SIGHUP remove temporary paths before they end the program.
#[cfg(unix)]
pub fn on_signals() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};

    // With a handler, of which nothing more is asked, a file beyond the limit of its size is an error.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
    // Without the handler the signals still end the program, only without cleaning up.
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP]) else { return };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            // The lock is kept, so that no further temporary paths are added.
            let temporary = temporary();
            temporary.iter().for_each(|path| remove(path));
            if let Some(words) = &*LAST_WORDS.lock().unwrap_or_else(PoisonError::into_inner) {
                // On a new line after the progress bar.
                let start = if std::io::stderr().is_terminal() { "\n" } else { "" };
                eprintln!("{start}lidarpc: {words}");
            }
            // Ends the program as the signal would have, so that a shell's loop ends too.
            let _ = signal_hook::low_level::emulate_default_handler(signal);
        }
    });
}

/// On other systems signals end the program as usual.
#[cfg(not(unix))]
pub fn on_signals() {}

/// Removes a file, or a folder with all its files, to which more may be added in the meantime.
#[cfg(unix)]
fn remove(path: &Path) {
    for _ in 0..100 {
        let removed = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
        if removed.is_ok() || !path.exists() {
            return;
        }
    }
}
