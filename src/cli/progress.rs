//! A progress bar on stderr, on a terminal only.

use std::borrow::Cow;

use indicatif::{ProgressBar, ProgressStyle};

/// A bar over frames; invisible if `quiet`, or if stderr is not a terminal. Without a `total` it
/// only counts.
pub fn bar(total: Option<u64>, what: impl Into<Cow<'static, str>>, quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let (bar, template) = match total {
        Some(total) => {
            (ProgressBar::new(total), "{msg} {wide_bar} {pos}/{len} frames, {per_sec}, {eta} left")
        }
        None => (ProgressBar::new_spinner(), "{msg} {pos} frames, {per_sec}"),
    };
    // A template that does not parse would cost the looks, not the work.
    let bar = match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    };
    bar.with_message(what)
}
