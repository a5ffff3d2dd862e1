//! Numbers in human-readable form.

/// Bytes with a unit: 1 kB is 1000 bytes.
pub fn bytes(count: u64) -> String {
    let units = [(1e9, "GB"), (1e6, "MB"), (1e3, "kB")];
    let unit = units.into_iter().find(|(size, _)| count as f64 >= *size);
    unit.map_or_else(|| format!("{count} bytes"), |(size, name)| format!("{:.2} {name}", count as f64 / size))
}

/// A share as a percentage; `-` if there is none.
pub fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "-".to_owned(), |share| format!("{:.2} %", 100.0 * share))
}

/// A figure with three decimals; `-` if there is none.
pub fn decimals(figure: Option<f64>) -> String {
    figure.map_or_else(|| "-".to_owned(), |figure| format!("{figure:.3}"))
}

/// `1 frame`, `2 frames`.
pub fn count(count: u64, what: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {what}{plural}")
}

/// `3 frames`, `3 frames and 1 file beside the scans`.
pub fn frames_and_files(frames: u64, files: u64) -> String {
    let frames = count(frames, "frame");
    match files {
        0 => frames,
        _ => format!("{frames} and {} beside the scans", count(files, "file")),
    }
}

/// A number with thousands separators: `338,112`.
pub fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let groups = digits.as_bytes().rchunks(3).rev().map(String::from_utf8_lossy);
    groups.collect::<Vec<_>>().join(",")
}
