//! Decodes a stream: `cargo run --example read_drive -- drive.lpc`

use std::env;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use lidarpc::{Decoder, Scan};

/// The height of the highest point, in metres.
fn highest(scan: &Scan) -> Option<f32> {
    scan.positions().iter().map(|[_, _, z]| *z).max_by(f32::total_cmp)
}

/// Prints the contents of a stream.
pub fn read(path: &Path, out: &mut impl Write) -> lidarpc::Result<()> {
    let mut decoder = Decoder::open(File::open(path)?)?.with_threads(2);
    writeln!(out, "{} frames", decoder.len())?;
    for frame in decoder.frames().take(3) {
        writeln!(out, "frame {}: {} bytes, at {:?} ns", frame.number, frame.coded_bytes, frame.time)?;
    }
    if !decoder.is_empty() {
        let last = decoder.scan(decoder.len() - 1)?;
        for channel in last.channels() {
            writeln!(out, "channel {}: {}", channel.name, channel.scalar.name())?;
        }
    }
    for scan in decoder.scans(..) {
        let scan = scan?;
        writeln!(out, "{} {} points, up to {:?} m", scan.name(), scan.len(), highest(&scan))?;
    }
    Ok(())
}

fn main() -> lidarpc::Result<()> {
    let path = env::args().nth(1).unwrap_or_else(|| "drive.lpc".to_owned());
    read(path.as_ref(), &mut io::stdout())
}
