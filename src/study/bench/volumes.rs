//! Tables I to III: the sizes of frames, and the stages that reduce them.

use super::experiment::{Coded, CodedFrame};
use super::figure_15::length;
use super::published;
use super::report::{Origin, Row, Section, Table};
use super::rivals::{Rival, RivalFrame, Rivals, VOXELS_UM};
use super::sample::Sample;
use super::tables::{Method, Runs, column, columns_by_scene, rows_of_methods};
use crate::study::metrics;

/// Table I: compression rates.
pub fn rates(sample: &Sample, runs: &Runs, rivals: &Rivals) -> Section {
    let rate = |method: &Method<'_>, coded: &Coded| [coded.rate(method.frames(sample).into_iter())];
    let mut measured: Vec<_> = runs.methods().iter().map(|method| method.measured(rate)).collect();
    measured.extend(VOXELS_UM.iter().zip(&rivals.octrees).map(|(&voxel_um, octree)| {
        (format!("octree, {}\u{b3}", length(voxel_um)), [octree_rate(sample, octree)])
    }));
    let inter = runs.coders.iter().filter_map(|run| run.inter.as_ref());
    let p_frames = inter.map(|inter| inter.frames.iter().filter(|frame| frame.is_inter()).count()).max();
    let mut columns = columns_by_scene("%", [2, 2]);
    columns.push(column("average", "%", Some(2), Origin::Published));
    Section::Table(Table {
        number: "Table I".into(),
        title: "compression rate (equation 11)".into(),
        note: format!(
            "Coded bytes of the bytes of the files, everything included, the container too. On {}. Inter coding: \
             only the frames that have one before them, as P frames if it is found how the scanner has moved \
             ({} of {}). Any prediction: each frame from nothing, regions or the frame before, whichever is \
             smallest. These drop outliers and the points that have no cell of their own in the range image, and have no \
             intensities; exact mode gives the files back byte for byte. The octree keeps all points, but neither \
             their order nor intensities.",
            sample.describe(),
            p_frames.unwrap_or_default(),
            sample.compared().filter(|&frame| sample.has_reference(frame)).count(),
        ),
        label: "method".into(),
        columns,
        rows: rows_of_methods(measured, &published::COMPRESSION_RATES),
    })
}

/// Coded bytes as a percentage of the files' bytes; `None` if these are empty.
fn octree_rate(sample: &Sample, octree: &Rival) -> Option<f64> {
    let original: u64 = sample.inputs.iter().filter_map(|input| input.size().ok()).sum();
    let coded = octree.sum(0..octree.frames.len(), |frame| frame.bytes);
    metrics::ratio(original, coded).map(|ratio| 100.0 * ratio)
}

/// A table beside Table I: the sizes and errors of the octree coder.
pub fn octrees(sample: &Sample, rivals: &Rivals) -> Section {
    let row = |(&voxel_um, octree): (&u32, &Rival)| {
        let all = 0..octree.frames.len();
        let sum = |of: fn(&RivalFrame) -> u64| octree.sum(all.clone(), of);
        let points = sum(|frame| frame.points);
        let millimetres = |metres: f64| 1e3 * metres;
        let farthest = octree.frames.iter().map(|frame| frame.max_m).reduce(f64::max);
        let cells = vec![
            octree_rate(sample, octree),
            metrics::bits_per_point(sum(|frame| frame.bytes), points),
            octree.rmse(all.clone()).map(millimetres),
            farthest.map(millimetres),
            metrics::ratio(points, points - sum(|frame| frame.voxels)).map(|ratio| 100.0 * ratio),
        ];
        Row { name: length(voxel_um), cells }
    };
    let columns = [
        ("rate", "%", 2),
        ("bit rate", "bits a point", 2),
        ("RMSE", "mm", 3),
        ("largest", "mm", 3),
        ("in one voxel", "%", 2),
    ];
    let columns = columns.map(|(name, unit, decimals)| column(name, unit, Some(decimals), Origin::Measured));
    Section::Table(Table {
        number: "Table I, octree".into(),
        title: "what the octree takes and loses".into(),
        note: format!(
            "On {}, by the side of a voxel. Errors: from each original point to the nearest decoded one, in three \
             dimensions. Centres of voxels are multiples of their sides, so that files with coordinates on such a \
             grid lose nothing. In one voxel: points that share a voxel with one before them; they are counted, and \
             come back. Points that stand for no return are left out.",
            sample.describe(),
        ),
        label: "voxel".into(),
        columns: columns.into(),
        rows: VOXELS_UM.iter().zip(&rivals.octrees).map(row).collect(),
    })
}

/// Tables II and III: bytes of a frame after each stage, for intra and for inter coding.
pub fn volumes(sample: &Sample, runs: &Runs) -> Vec<Section> {
    let all: Vec<_> = (0..sample.inputs.len()).collect();
    let later: Vec<_> = sample.compared().collect();
    let intra = Volumes {
        number: "Table II",
        what: "intra",
        place: 0,
        frames: &all,
        coded: |runs, name| runs.of(name).map(|run| &run.intra),
    };
    let inter = Volumes {
        number: "Table III",
        what: "inter",
        place: 1,
        frames: &later,
        coded: |runs, name| runs.of(name).and_then(|run| run.inter.as_ref()),
    };
    vec![intra.table(sample, runs), inter.table(sample, runs)]
}

/// One of the two tables.
struct Volumes<'a> {
    number: &'a str,
    what: &'a str,
    /// Index into the published values: 0 intra, 1 inter.
    place: usize,
    frames: &'a [usize],
    coded: fn(&'a Runs, &str) -> Option<&'a Coded>,
}

impl<'a> Volumes<'a> {
    fn table(&self, sample: &Sample, runs: &'a Runs) -> Section {
        let first = published::CODERS.iter().find_map(|coder| (self.coded)(runs, coder.name));
        let mean = |coded: Option<&Coded>, of: fn(&CodedFrame) -> u64| {
            coded?.mean(self.frames.iter().copied(), |frame| of(frame) as f64 / 1e3)
        };
        let row = |name: String, value: Option<f64>, published: Option<[f64; 4]>| {
            let published = published.map_or([None; 4], |values| values.map(Some));
            Row { name, cells: [value].into_iter().chain(published).collect() }
        };
        let converted = (self.place == 0).then_some(published::CONVERTED_KB);
        let mut rows = vec![
            row(
                "original".into(),
                mean(first, |frame| frame.encoding.original),
                Some(published::ORIGINAL_KB),
            ),
            row("after conversion".into(), mean(first, |frame| frame.encoding.converted), converted),
            row(
                format!("after {} prediction", self.what),
                mean(first, |frame| frame.encoding.predicted),
                Some(published::PREDICTED_KB[self.place]),
            ),
        ];
        for coder in &published::CODERS {
            let coded = (self.coded)(runs, coder.name);
            let name = format!("after coding, {}", coder.name);
            let published = Some(coder.coded_kb[self.place]);
            rows.push(row(name, mean(coded, |frame| frame.encoding.coded()), published));
            if coded.is_some() {
                for (part, of) in PARTS {
                    rows.push(row(format!("  {part}"), mean(coded, of), None));
                }
            }
        }
        Section::Table(Table {
            number: self.number.into(),
            title: format!("volumes of a frame during {} coding", self.what),
            note: format!(
                "KB are 1000 bytes, the mean of {}, without the container. After conversion: four \
                 bytes a cell of the range image. After prediction: what goes into the coder of the ranges, \
                 packed.",
                sample.describe_some(self.frames.len()),
            ),
            label: "step".into(),
            columns: columns_by_scene("KB", [1, 0]),
            rows,
        })
    }
}

/// A part of a frame's bytes.
type Part = (&'static str, fn(&CodedFrame) -> u64);

/// The parts of coded frames.
const PARTS: [Part; 4] = [
    ("ranges", |frame| frame.encoding.ranges),
    ("contour map", |frame| frame.encoding.contour),
    ("parameters, models of regions", |frame| frame.encoding.side),
    ("which cells hold a return", |frame| frame.encoding.rest),
];
