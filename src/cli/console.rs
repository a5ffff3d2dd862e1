//! What commands tell on stderr, apart from errors.

use std::borrow::Cow;
use std::fmt::{self, Display};
use std::io::{self, Write};

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

/// Prints a line on stderr. If nobody reads it, that is no error.
pub fn to_stderr(line: impl Display) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Progress and remarks on stderr, unless `--quiet` forbids them.
#[derive(Clone, Copy)]
pub struct Console {
    pub is_quiet: bool,
}

impl Console {
    /// Tells nothing: what is done is a part of something else.
    pub const SILENT: Console = Console { is_quiet: true };

    /// Tells a line.
    pub fn say(self, line: impl Display) {
        if !self.is_quiet {
            to_stderr(line);
        }
    }

    /// A progress bar over frames, on a terminal only. Without a `total` it only counts.
    pub fn bar(self, total: Option<u64>, what: impl Into<Cow<'static, str>>) -> ProgressBar {
        if self.is_quiet { ProgressBar::hidden() } else { visible(total).with_message(what) }
    }
}

fn visible(total: Option<u64>) -> ProgressBar {
    let (bar, template) = match total {
        Some(total) => (ProgressBar::new(total), "{msg} {wide_bar} {pos}/{len} frames, {speed}, {eta} left"),
        None => (ProgressBar::new_spinner(), "{msg} {pos} frames, {speed}"),
    };
    // If a template does not parse, only the appearance suffers.
    match ProgressStyle::with_template(template) {
        Ok(style) => {
            bar.with_style(style.with_key("speed", |state: &ProgressState, out: &mut dyn fmt::Write| {
                let _ = out.write_str(&speed(state.per_sec()));
            }))
        }
        Err(_) => bar,
    }
}

/// Frames a second, with as many digits as are meaningful.
fn speed(per_second: f64) -> String {
    let decimals = match per_second {
        100.0.. => 0,
        10.0.. => 1,
        _ => 2,
    };
    format!("{per_second:.decimals$} a second")
}

#[cfg(test)]
mod tests {
    use super::speed;

    #[test]
    fn speeds_have_three_digits() {
        let speeds = [0.0512, 6.6958, 21.34, 178.9].map(speed);
        assert_eq!(speeds, ["0.05 a second", "6.70 a second", "21.3 a second", "179 a second"]);
    }
}
