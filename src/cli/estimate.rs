//! `lidarpc estimate`

use std::io::{self, Write};
use std::time::Instant;

use crate::files::sequence::find_frames;
use crate::ground::team::resolve_threads;
use crate::stream::{self, FrameInput, scanner_choice};
use crate::study::metrics;
use anyhow::Result;
use serde::Serialize;

use super::args::{EstimateArgs, encoder_config, wrong_usage};
use super::console::Console;
use super::errors::about;
use super::input::is_recording;
use super::output::print_json;
use super::{frames, readable};

/// Number of groups that are encoded, spread over the sequence.
const GROUPS: usize = 3;

/// The expected result of encoding.
#[derive(Serialize)]
struct Estimate {
    frames: usize,
    /// Number of encoded frames.
    sample: usize,
    file_bytes: u64,
    stream_bytes: u64,
    ratio: Option<f64>,
    seconds: f64,
    threads: usize,
}

pub fn run(args: &EstimateArgs, console: Console) -> Result<()> {
    if args.inputs.iter().any(|input| is_recording(input)) {
        wrong_usage("estimate", "estimates are for scans; `encode` a recording and see `stats`");
    }
    let mut config = encoder_config("estimate", &args.coding, args.threads.threads);
    let found = find_frames(&args.inputs)?.frames;
    let place = frames::name_of_inputs(&args.inputs);
    frames::settle_layout(&found, &mut config, &place, console)?;
    let all = FrameInput::from_files(found);
    let places = group_places(all.len(), config.gop);
    let sample: Vec<_> =
        places.into_iter().flat_map(|start| all[start..].iter().take(config.gop).cloned()).collect();
    let bar = console.bar(Some(sample.len() as u64), "encoding a sample");
    let start = Instant::now();
    let encoded = stream::encode(&sample, &config, io::sink(), &|| bar.inc(1));
    let seconds = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let encoded = encoded.map_err(|error| about(error, &place))?;
    let total = all.iter().map(FrameInput::size).sum::<crate::ground::error::Result<u64>>()?;
    let share = total as f64 / encoded.file_bytes().max(1) as f64;
    let estimate = Estimate {
        frames: all.len(),
        sample: sample.len(),
        file_bytes: total,
        stream_bytes: (encoded.stream_bytes as f64 * share).round() as u64,
        ratio: metrics::ratio(encoded.file_bytes(), encoded.stream_bytes),
        seconds: seconds * share,
        threads: resolve_threads(config.threads),
    };
    if args.json {
        return print_json(&estimate);
    }
    Ok(writeln!(
        io::stdout(),
        "{}: {} -> about {} ({}), in about {:.0} s on {}; by {} of them",
        readable::count(estimate.frames as u64, "frame"),
        readable::bytes(estimate.file_bytes),
        readable::bytes(estimate.stream_bytes),
        readable::percent(estimate.ratio),
        estimate.seconds.ceil(),
        readable::count(estimate.threads as u64, "thread"),
        estimate.sample,
    )?)
}

/// The first frames of the groups in the sample.
fn group_places(frames: usize, group: usize) -> Vec<usize> {
    if frames <= GROUPS * group {
        return (0..frames).step_by(group).collect();
    }
    scanner_choice::sample_places(frames - group + 1, GROUPS).collect()
}

#[cfg(test)]
mod tests {
    use super::group_places;

    #[test]
    fn the_sample_is_all_or_spread() {
        assert_eq!(group_places(0, 10), [0; 0]);
        assert_eq!(group_places(25, 10), [0, 10, 20]);
        assert_eq!(group_places(1000, 10), [0, 495, 990]);
    }
}
