//! Single stages: scanner fit, projection, and the coding of each part of a frame that has a coder of its
//! own.

#![allow(missing_docs)]

mod common;

use std::hint::black_box;
use std::time::Duration;

use common::{Drive, drives, points};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidarpc::internals::entropy::ArithmeticEncoder;
use lidarpc::internals::ground::grid::Grid;
use lidarpc::internals::models::{
    CorrectionModel, OccupancyModel, OrderExceptions, OrderModel, PointModel, RangeContext, RangeModel,
    RangeScale,
};
use lidarpc::internals::scanner::hdl64::{Hdl64, Hdl64ColumnModel, fit, project};
use lidarpc::internals::scanner::{CoordinateGrid, LEAST_RANGE_BITS, Projection, REACH};

fn stages(c: &mut Criterion) {
    for (name, scans) in drives() {
        let mut group = c.benchmark_group(format!("fit/{name}"));
        group.sample_size(10).throughput(Throughput::Elements(points(&scans)));
        group.bench_function("scanner", |b| b.iter(|| fit(black_box(&scans))));
        group.finish();
        if let Some(scanner) = fit(&scans) {
            frame_stages(c, &(name, scans), &scanner);
        }
    }
}

/// The stages of coding one frame, in order. Models start afresh each time.
fn frame_stages(c: &mut Criterion, (name, scans): &Drive, scanner: &Hdl64) {
    let cloud = &scans[0].cloud;
    let Projection { image, point_of_cell, .. } = project(scanner, cloud, REACH);
    let occupancy = filled(&image.steps);
    let no_intensity = Grid::<u16>::new(occupancy.rows(), occupancy.columns());
    let returns = image.file_order(scanner);
    let order: Vec<u32> = (0..returns.len() as u32).collect();
    let exceptions = OrderExceptions::of_places(&order, returns.len());
    let positions: Vec<[f32; 3]> = returns
        .iter()
        .map(|r| cloud.positions[point_of_cell[(r.row as usize, r.column as usize)] as usize])
        .collect();

    let mut group = c.benchmark_group(format!("stages/{name}"));
    group.sample_size(10).measurement_time(Duration::from_secs(2));
    group.throughput(Throughput::Elements(cloud.positions.len() as u64));
    group.bench_function("project", |b| b.iter(|| project(scanner, black_box(cloud), REACH)));
    group.bench_function("file_order", |b| b.iter(|| black_box(&image).file_order(scanner)));
    group.bench_function("columns", |b| {
        b.iter(|| {
            Hdl64ColumnModel::default().code(&mut encoder(), scanner.ticks, &mut image.columns.clone());
        });
    });
    group.bench_function("occupancy", |b| {
        b.iter(|| OccupancyModel::default().code(&mut encoder(), None, &mut occupancy.clone()));
    });
    group.bench_function("range", |b| {
        b.iter(|| {
            let mut model = RangeModel::default();
            let steps = &mut image.steps.clone();
            let known = RangeContext {
                occupancy: &occupancy,
                intensity: &no_intensity,
                reference: None,
                scale: RangeScale { bits: LEAST_RANGE_BITS, bin: 1 },
            };
            model.code(&mut encoder(), &known, steps);
        });
    });
    group.bench_function("correction", |b| {
        b.iter(|| {
            let (mut coder, mut model) = (encoder(), CorrectionModel::default());
            for (found, position) in returns.iter().zip(&positions) {
                let formula = scanner.point(found.row as usize, found.tick, found.steps);
                let (grid, mut position) = (scanner.coordinates, *position);
                if grid == CoordinateGrid::Millimetre {
                    model.correct(&mut coder, grid, formula, &mut position);
                    continue;
                }
                let near = formula.map(|metres| grid.nearest(metres));
                model.code(&mut coder, grid, || formula, (near, None), &mut position);
            }
        });
    });
    group.bench_function("order", |b| {
        b.iter(|| OrderModel::default().code(&mut encoder(), &mut exceptions.clone(), returns.len(), 0));
    });
    group.bench_function("points", |b| {
        b.iter(|| {
            let mut model = PointModel::default();
            let analysis = model.analyse(None, &cloud.positions, &[]);
            model.code(&mut encoder(), None, &mut cloud.positions.clone(), &analysis)
        });
    });
    group.finish();
}

fn filled(steps: &Grid<u32>) -> Grid<bool> {
    let mut occupancy = Grid::new(steps.rows(), steps.columns());
    for row in 0..steps.rows() {
        let filled = steps.row(row).iter().map(|&steps| steps > 0);
        occupancy.row_mut(row).iter_mut().zip(filled).for_each(|(cell, filled)| *cell = filled);
    }
    occupancy
}

fn encoder() -> ArithmeticEncoder {
    ArithmeticEncoder::default()
}

criterion_group!(benches, stages);
criterion_main!(benches);
