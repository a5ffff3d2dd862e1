//! What a signal that ends the program does: temporary files and folders do not remain, and of what arrives
//! on stdin, the frames so far are kept.

#[cfg(unix)]
use std::io::IsTerminal;
use std::io::{self, Cursor, Read};
use std::path::{Path, PathBuf};
#[cfg(unix)]
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Mutex, MutexGuard};
use std::thread;
use std::time::Duration;

use crate::ground::team::locked;

use super::console::to_stderr;

/// The paths to remove when a signal ends the program.
static TEMPORARY: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// The message to print when a signal ends the program.
static LAST_WORDS: Mutex<Option<String>> = Mutex::new(None);

/// While this exists, a signal that ends the program prints a message first.
#[derive(Debug)]
pub struct SayOnSignal;

impl SayOnSignal {
    pub fn new(words: String) -> Self {
        *locked(&LAST_WORDS) = Some(words);
        SayOnSignal
    }
}

impl Drop for SayOnSignal {
    fn drop(&mut self) {
        locked(&LAST_WORDS).take();
    }
}

fn temporary() -> MutexGuard<'static, Vec<PathBuf>> {
    locked(&TEMPORARY)
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

/// Whether there is an input that the first signal ends, in place of the program.
static LIVE_INPUT: Mutex<LiveInput> = Mutex::new(LiveInput::None);

#[derive(Clone, Copy)]
enum LiveInput {
    None,
    Open,
    /// A signal has ended it. Bytes that were read since then.
    Ended(usize),
}

fn live_input() -> MutexGuard<'static, LiveInput> {
    locked(&LIVE_INPUT)
}

/// Stdin, on which frames arrive from a scanner. The first signal ends it, since whoever stops a recording wants
/// to keep what was recorded; the next one ends the program.
pub struct LiveStdin {
    /// Read by a thread, whose wait for more is not ended by a signal.
    pieces: Receiver<io::Result<Vec<u8>>>,
    piece: Cursor<Vec<u8>>,
}

impl LiveStdin {
    const PIECE: usize = 1 << 16;

    /// More than pieces and pipe can hold of what arrived before the signal.
    const UNDER_WAY: usize = 8 * Self::PIECE;

    /// After a signal, the input ends if nothing arrives for this long.
    const PAUSE: Duration = Duration::from_secs(1);

    pub fn new() -> Self {
        *live_input() = LiveInput::Open;
        let (sender, pieces) = sync_channel(2);
        thread::spawn(move || {
            loop {
                let mut piece = vec![0; Self::PIECE];
                let read = io::stdin().read(&mut piece).map(|count| {
                    piece.truncate(count);
                    piece
                });
                let is_last = read.as_ref().map_or(true, Vec::is_empty);
                if sender.send(read).is_err() || is_last {
                    return;
                }
            }
        });
        LiveStdin { pieces, piece: Cursor::default() }
    }

    /// Whether a signal has ended the input.
    pub fn was_ended() -> bool {
        matches!(*live_input(), LiveInput::Ended(_))
    }

    /// Whether a signal has ended the input, and all that was under way has been read.
    pub fn is_over() -> bool {
        matches!(*live_input(), LiveInput::Ended(since) if since > Self::UNDER_WAY)
    }
}

impl Read for LiveStdin {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        while self.piece.position() == self.piece.get_ref().len() as u64 {
            match self.pieces.recv_timeout(Self::PAUSE) {
                Ok(piece) => self.piece = Cursor::new(piece?),
                Err(RecvTimeoutError::Timeout) if !Self::was_ended() => continue,
                Err(_) => return Ok(0),
            }
        }
        let count = self.piece.read(out)?;
        if let LiveInput::Ended(since) = &mut *live_input() {
            *since += count;
        }
        Ok(count)
    }
}

impl Drop for LiveStdin {
    fn drop(&mut self) {
        let mut input = live_input();
        if matches!(*input, LiveInput::Open) {
            *input = LiveInput::None;
        }
    }
}

/// From now on, SIGINT, SIGTERM and SIGHUP remove temporary paths before they end the program. While
/// [`LiveStdin`] is read, the first one ends that instead.
#[cfg(unix)]
pub fn on_signals() {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};

    // With a handler, of which nothing more is asked, a file beyond the limit of its size is an error.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
    // Without the handler the signals still end the program, only without cleaning up.
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM, SIGHUP]) else { return };
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let mut input = live_input();
            if matches!(*input, LiveInput::Open) {
                *input = LiveInput::Ended(0);
                continue;
            }
            drop(input);
            // The lock is kept, so that no further temporary paths are added.
            let temporary = temporary();
            temporary.iter().for_each(|path| remove(path));
            if let Some(words) = &*locked(&LAST_WORDS) {
                // On a new line after the progress bar.
                let start = if std::io::stderr().is_terminal() { "\n" } else { "" };
                to_stderr(format_args!("{start}lidarpc: {words}"));
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
