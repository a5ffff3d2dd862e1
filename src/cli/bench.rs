//! `lidarpc bench`

use std::io::{self, Write};

use anyhow::Result;
use lidarpc::backend::BACKENDS;
use lidarpc::bench::{Figure13, Figure13Bench, Sizes};
use lidarpc::codec::{EncoderConfig, FrameInput};
use lidarpc::io::parse_with;
use lidarpc::io::sequence::find_frames;
use lidarpc::metrics;
use serde::Serialize;

use super::args::BenchArgs;
use super::{coding, progress, table};

/// Frames that --quick measures.
const QUICK_FRAMES: usize = 3;

/// The figure's data; bytes are the mean of a frame.
#[derive(Serialize)]
struct Figure {
    frames: u64,
    original_bytes: f64,
    /// Part of the sizes of regions.
    side_bytes: f64,
    backends: Vec<Entry>,
}

#[derive(Serialize)]
struct Entry {
    name: &'static str,
    float_image_bytes: f64,
    float_region_residual_bytes: f64,
    range_bytes: f64,
    range_difference_bytes: f64,
    region_residual_bytes: f64,
    region_residual_difference_bytes: f64,
}

pub fn run(args: &BenchArgs, quiet: bool) -> Result<()> {
    let config = coding::paper_config(&args.coding, &args.threads);
    let figure = Figure::of(&measure(args, &config, quiet)?);
    let mut out = io::BufWriter::new(io::stdout().lock());
    if args.json {
        serde_json::to_writer_pretty(&mut out, &figure).map_err(io::Error::from)?;
        writeln!(out)?;
    } else {
        figure.print(&mut out)?;
    }
    out.flush()?;
    Ok(())
}

fn measure(args: &BenchArgs, config: &EncoderConfig, quiet: bool) -> Result<Figure13> {
    let mut frames = find_frames(std::slice::from_ref(&args.input))?.frames;
    if args.quick {
        frames.truncate(QUICK_FRAMES);
    }
    let bar = progress::bar(Some(frames.len() as u64), "measuring", quiet);
    let mut bench = Figure13Bench::new(config)?;
    for frame in frames.into_iter().map(FrameInput::File) {
        let bytes = frame.read()?;
        let size = bytes.len() as u64;
        bench.add(&parse_with(frame.name()?, bytes, config.headerless.as_ref()).cloud, size)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(bench.figure())
}

impl Figure {
    fn of(figure: &Figure13) -> Self {
        let mean = |bytes: u64| bytes as f64 / figure.frames.max(1) as f64;
        let entry = |(name, sizes): (&'static str, &Sizes)| Entry {
            name,
            float_image_bytes: mean(sizes.float_image),
            float_region_residual_bytes: mean(sizes.float_residual),
            range_bytes: mean(sizes.ranges),
            range_difference_bytes: mean(sizes.differences),
            region_residual_bytes: mean(sizes.residual),
            region_residual_difference_bytes: mean(sizes.residual_differences),
        };
        let names = BACKENDS.iter().map(|backend| backend.name());
        Figure {
            frames: figure.frames,
            original_bytes: mean(figure.original),
            side_bytes: mean(figure.side),
            backends: names.zip(&figure.sizes).map(entry).collect(),
        }
    }

    fn print(&self, out: &mut impl Write) -> io::Result<()> {
        let frames = table::count(self.frames, "frame");
        writeln!(out, "Figure 13: {frames}, KB a frame of {:.0} KB\n", self.original_bytes / 1e3)?;
        writeln!(out, "{:<10} {:^25}   {:^51}", "", "32-bit floats", "integers")?;
        writeln!(
            out,
            "{:<10} {:>12} {:>12}   {:>12} {:>12} {:>12} {:>12}",
            "back-end", "image", "regions", "ranges", "differences", "regions", "regions, d."
        )?;
        for entry in &self.backends {
            let Entry { name, float_image_bytes: image, float_region_residual_bytes: residual, .. } = entry;
            write!(out, "{name:<10} {} {}  ", self.cell(*image), self.cell(*residual))?;
            for bytes in [
                entry.range_bytes,
                entry.range_difference_bytes,
                entry.region_residual_bytes,
                entry.region_residual_difference_bytes,
            ] {
                write!(out, " {}", self.cell(bytes))?;
            }
            writeln!(out)?;
        }
        writeln!(
            out,
            "\nregions include {:.1} KB of contour map and models; d.: differences along the snake's path",
            self.side_bytes / 1e3
        )
    }

    /// KB and the ratio of equation 11.
    fn cell(&self, bytes: f64) -> String {
        let ratio = metrics::ratio(self.original_bytes as u64, bytes as u64);
        format!(
            "{:>5.1} {:>6}",
            bytes / 1e3,
            ratio.map_or("-".to_owned(), |ratio| format!("{:.2}%", 100.0 * ratio))
        )
    }
}
