//! Encodes points in memory: `cargo run --example encode_points -- drive.lpc`

use std::env;
use std::fs::File;
use std::path::Path;

use lidarpc::{Encoder, Scan, Settings, Summary};

/// The laser of each point, and the time since the first point, in seconds.
struct Turn {
    points: Vec<[f32; 4]>,
    lasers: Vec<u8>,
    times: Vec<f32>,
}

/// A turn of a scanner with 16 lasers in the middle of a round room, 8 m wide.
fn turn(number: u32) -> Turn {
    let mut turn = Turn { points: Vec::new(), lasers: Vec::new(), times: Vec::new() };
    for firing in 0..360u16 {
        for laser in 0..16u8 {
            let (azimuth, elevation) =
                (f32::from(firing).to_radians(), (f32::from(laser) * 2.0 - 15.0).to_radians());
            let (x, y, z) = (4.0 * azimuth.cos(), 4.0 * azimuth.sin(), 4.0 * elevation.tan());
            turn.points.push([x, y, z, f32::from(laser) + number as f32]);
            turn.lasers.push(laser);
            turn.times.push(f32::from(firing) / 3600.0);
        }
    }
    turn
}

/// Encodes ten turns, a tenth of a second apart.
pub fn encode(path: &Path) -> lidarpc::Result<Summary> {
    let mut encoder = Encoder::new(File::create(path)?, Settings::exact())?;
    for number in 0..10 {
        let Turn { points, lasers, times } = turn(number);
        let scan = Scan::from_xyzi(&points)
            .with_channel("ring", &lasers)?
            .with_channel("time", &times)?
            .with_time(i64::from(number) * 100_000_000);
        encoder.push(scan)?;
    }
    encoder.finish()
}

fn main() -> lidarpc::Result<()> {
    let path = env::args().nth(1).unwrap_or_else(|| "drive.lpc".to_owned());
    let summary = encode(path.as_ref())?;
    println!("{} scans, {} points, {} bytes in {path}", summary.scans, summary.points, summary.stream_bytes);
    Ok(())
}
