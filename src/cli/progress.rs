//! A progress bar on stderr, on a terminal only.

use std::borrow::Cow;

use std::fmt::Write;

use indicatif::{ProgressBar, ProgressState, ProgressStyle};

/// A progress bar over frames; invisible if `quiet`, or if stderr is not a terminal. Without a `total` it
/// only counts.
pub fn bar(total: Option<u64>, what: impl Into<Cow<'static, str>>, quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let (bar, template) = match total {
        Some(total) => (ProgressBar::new(total), "{msg} {wide_bar} {pos}/{len} frames, {speed}, {eta} left"),
        None => (ProgressBar::new_spinner(), "{msg} {pos} frames, {speed}"),
    };
    // If a template does not parse, only the appearance suffers.
    let bar = match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style.with_key("speed", |state: &ProgressState, out: &mut dyn Write| {
            let _ = out.write_str(&speed(state.per_sec()));
        })),
        Err(_) => bar,
    };
    bar.with_message(what)
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
