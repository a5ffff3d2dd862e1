//! Decides which regions are worth their bits (article, IV-C.1): partitions are compared by SSE + lambda *
//! bits (equation 5). Only the encoder needs this.

use std::collections::BTreeMap;

use super::ransac::least_squares_plane;
use super::surface::{Rays, SurfaceModel};
use crate::ground::floats::square;
use crate::ground::grid::Grid;

/// Cost of a border in bits for each cell along it, measured on real contour maps.
const BORDER_BITS: f64 = 2.0;
/// Further cost of a region in bits: that of its model and its number.
const MEAN_BITS: f64 = 20.0;
const PLANE_BITS: f64 = 60.0;
/// Regions with fewer returns are not split.
const SMALLEST_SPLIT: usize = 64;

/// Returns that share a model.
#[derive(Clone, Debug)]
pub struct Region {
    /// Row and column of each return.
    pub cells: Vec<(u32, u32)>,
    /// The model that predicts them.
    pub model: SurfaceModel,
    /// The sum of the squared prediction errors, in steps^2.
    pub squared_errors: f64,
}

/// Compares regions by equation 5.
pub struct Judge<'a> {
    /// Rows x columns, in steps.
    pub steps: &'a Grid<u32>,
    /// The rays of the image.
    pub rays: &'a Rays<'a>,
    /// Lambda: the squared steps that one bit is worth.
    pub lambda: f64,
}

impl Judge<'_> {
    /// A region of these cells with this model.
    pub fn region(&self, cells: Vec<(u32, u32)>, model: SurfaceModel) -> Region {
        let error = |&(row, column): &(u32, u32)| {
            let cell = (row as usize, column as usize);
            square(f64::from(self.steps[cell]) - f64::from(self.rays.range(&model, cell)))
        };
        let squared_errors = cells.iter().map(error).sum();
        Region { cells, model, squared_errors }
    }

    /// Equation 5 for one region, without its borders.
    fn cost(&self, region: &Region) -> f64 {
        let bits = match region.model {
            SurfaceModel::Mean(_) => MEAN_BITS,
            SurfaceModel::Plane(_) => PLANE_BITS,
        };
        region.squared_errors + self.lambda * bits
    }

    /// A region of these cells, modelled by their mean range.
    pub fn with_mean(&self, cells: Vec<(u32, u32)>) -> Region {
        let mean = self.mean(&cells);
        self.region(cells, SurfaceModel::Mean(mean))
    }

    /// A region of these cells, modelled by their mean or their plane, whichever is cheaper.
    pub fn with_best(&self, cells: Vec<(u32, u32)>) -> Region {
        let points = cells.iter().map(|&(row, column)| {
            let cell = (row as usize, column as usize);
            self.rays.point(cell, self.steps[cell])
        });
        let plane = least_squares_plane(points).map(|w| SurfaceModel::plane(w, self.mean(&cells)));
        let by_mean = self.with_mean(cells);
        let Some(plane @ SurfaceModel::Plane(_)) = plane else { return by_mean };
        let by_plane = self.region(by_mean.cells.clone(), plane);
        if self.cost(&by_plane) < self.cost(&by_mean) { by_plane } else { by_mean }
    }

    fn mean(&self, cells: &[(u32, u32)]) -> u32 {
        let sum: u64 =
            cells.iter().map(|&(row, column)| u64::from(self.steps[(row as usize, column as usize)])).sum();
        let count = cells.len().max(1) as u64;
        ((sum + count / 2) / count) as u32
    }

    /// Splits a region, and recursively its parts, where depth varies, as long as the cost decreases.
    pub fn split(&self, region: Region, parts: &mut Vec<Region>) {
        let mut open = vec![region];
        while let Some(region) = open.pop() {
            match self.best_split(&region) {
                Some(halves) => open.extend(halves),
                None => parts.push(region),
            }
        }
    }

    /// The better of a split between columns and a split between rows, if either decreases the cost.
    fn best_split(&self, region: &Region) -> Option<[Region; 2]> {
        if region.cells.len() < SMALLEST_SPLIT {
            return None;
        }
        let by_column = self.split_by(region, |cell| cell.1, |cell| cell.0);
        let by_row = self.split_by(region, |cell| cell.0, |cell| cell.1);
        let best = by_column.into_iter().chain(by_row).min_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 < self.cost(region)).then_some(best.1)
    }

    /// Splits at the position where two means explain most; returns the cost of the halves and of the border.
    fn split_by(
        &self,
        region: &Region,
        along: impl Fn(&(u32, u32)) -> u32,
        across: impl Fn(&(u32, u32)) -> u32,
    ) -> Option<(f64, [Region; 2])> {
        let first = region.cells.iter().map(&along).min()?;
        let last = region.cells.iter().map(&along).max()?;
        let mut sums = vec![(0.0, 0.0); (last - first) as usize + 1];
        for cell in &region.cells {
            let sum = &mut sums[(along(cell) - first) as usize];
            sum.0 += 1.0;
            sum.1 += f64::from(self.steps[(cell.0 as usize, cell.1 as usize)]);
        }
        let all = sums.iter().fold((0.0, 0.0), |all, sum| (all.0 + sum.0, all.1 + sum.1));
        let (mut best, mut below) = ((0.0, first), (0.0, 0.0));
        for (place, sum) in (first..last).zip(&sums) {
            below = (below.0 + sum.0, below.1 + sum.1);
            let above = (all.0 - below.0, all.1 - below.1);
            let explained = below.1 * below.1 / below.0 + above.1 * above.1 / above.0;
            if below.0 > 0.0 && above.0 > 0.0 && explained > best.0 {
                best = (explained, place + 1);
            }
        }
        let (low, high): (Vec<_>, Vec<_>) =
            region.cells.iter().copied().partition(|cell| along(cell) < best.1);
        let border = low.iter().filter(|cell| along(cell) + 1 == best.1).map(across).count();
        if low.is_empty() || high.is_empty() {
            return None;
        }
        let halves = [self.with_best(low), self.with_best(high)];
        let cost = self.cost(&halves[0]) + self.cost(&halves[1]) + self.lambda * BORDER_BITS * border as f64;
        Some((cost, halves))
    }

    /// Merges neighbouring regions that are predicted by their means, if the border costs more than it saves.
    pub fn merge(&self, regions: Vec<Region>) -> Vec<Region> {
        let mut labels: Grid<u32> = Grid::new(self.steps.rows(), self.steps.columns());
        for (label, region) in (1..).zip(&regions) {
            region.cells.iter().for_each(|&(row, column)| labels[(row as usize, column as usize)] = label);
        }
        let mut parts: Vec<Option<Region>> = regions.into_iter().map(Some).collect();
        // The region that each region was merged into.
        let mut merged_into: Vec<usize> = (0..parts.len()).collect();
        for ((a, b), border) in borders(&labels) {
            let (a, b) = (follow(&mut merged_into, a), follow(&mut merged_into, b));
            if a == b {
                continue;
            }
            let (Some(one), Some(other)) = (&parts[a], &parts[b]) else { continue };
            let both_means = [one, other].iter().all(|r| matches!(r.model, SurfaceModel::Mean(_)));
            if !both_means {
                continue;
            }
            let together = self.with_mean([&one.cells[..], &other.cells].concat());
            let apart = self.cost(one) + self.cost(other) + self.lambda * BORDER_BITS * f64::from(border);
            if self.cost(&together) < apart {
                parts[a] = Some(together);
                parts[b] = None;
                merged_into[b] = a;
            }
        }
        parts.into_iter().flatten().collect()
    }
}

/// The length of the border between each pair of neighbouring regions, which are numbered from 0.
fn borders(labels: &Grid<u32>) -> BTreeMap<(usize, usize), u32> {
    let mut borders = BTreeMap::new();
    let mut meet = |a: u32, b: u32| {
        if a != b && a > 0 && b > 0 {
            *borders.entry((a.min(b) as usize - 1, a.max(b) as usize - 1)).or_default() += 1;
        }
    };
    for row in 0..labels.rows() {
        labels.row(row).windows(2).for_each(|pair| meet(pair[0], pair[1]));
        if row > 0 {
            labels.row(row).iter().zip(labels.row(row - 1)).for_each(|(a, b)| meet(*a, *b));
        }
    }
    borders
}

fn follow(merged_into: &mut [usize], mut region: usize) -> usize {
    while merged_into[region] != region {
        merged_into[region] = merged_into[merged_into[region]];
        region = merged_into[region];
    }
    region
}
