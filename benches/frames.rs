//! Whole frames, on one thread: the scanner is already fitted, and each frame is coded as the next of a
//! group. In points a second.

#![allow(missing_docs)]

mod common;

use std::hint::black_box;
use std::time::Duration;

use common::{drives, points};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidarpc::internals::container::FrameHeader;
use lidarpc::internals::frame::StageReport;
use lidarpc::internals::frame::decoder::GroupDecoder;
use lidarpc::internals::frame::encoder::GroupEncoder;
use lidarpc::internals::frame::settings::EncoderConfig;
use lidarpc::internals::ground::error::Limits;
use lidarpc::internals::scan::ScanFile;
use lidarpc::internals::scanner::Scanner;

fn frames(c: &mut Criterion) {
    for (name, scans) in drives() {
        let scanner = Scanner::fit(&scans);
        let mut group = c.benchmark_group(format!("frames/{name}"));
        group.sample_size(10).measurement_time(Duration::from_secs(4));
        group.throughput(Throughput::Elements(points(&scans)));
        measure(&mut group, "fitted", scanner.as_ref(), &scans);
        measure(&mut group, "unfitted", None, &scans);
        group.finish();
    }
}

fn measure(
    group: &mut criterion::BenchmarkGroup<'_, criterion::measurement::WallTime>,
    kind: &str,
    scanner: Option<&Scanner>,
    scans: &[ScanFile],
) {
    let config = EncoderConfig::default();
    let encode = || {
        let mut encoder = GroupEncoder::new(&[scanner], &config);
        let mut encode = |scan: &ScanFile| {
            let header = FrameHeader { point_count: scan.records as u64, ..FrameHeader::default() };
            encoder.encode_frame(scan.clone(), header).unwrap()
        };
        scans.iter().map(&mut encode).collect::<Vec<_>>()
    };
    let coded = encode();
    group.bench_function(format!("encode/{kind}"), |b| b.iter(encode));
    group.bench_function(format!("decode/{kind}"), |b| {
        b.iter(|| {
            let mut decoder = GroupDecoder::new([scanner], &Limits::default());
            let mut stages = StageReport::default();
            for frame in &coded {
                black_box(decoder.decode_frame(&frame.header, &frame.sections, &mut stages).unwrap());
            }
        });
    });
}

criterion_group!(benches, frames);
criterion_main!(benches);
