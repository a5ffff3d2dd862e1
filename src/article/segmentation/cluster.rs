//! Object clustering (article, IV-B.2): returns belong to one object if a chain of neighbours on common
//! surfaces connects them.

use super::neighbours::{Cell, Neighbours};
use super::scene::Scene;
use super::{FIRST_OBJECT, NO_RETURN, SegmentationConfig, UNASSIGNED};
use crate::ground::grid::Grid;

/// Returns in a column are compared only if they are at most this many rows apart.
const REACH: usize = 3;

/// Labels all unlabelled returns. Returns the end of the labels.
pub fn mark(
    scene: &Scene,
    neighbours: &Neighbours,
    config: &SegmentationConfig,
    labels: &mut Grid<u32>,
) -> u32 {
    let surfaces = Surfaces { scene, neighbours, tangent: super::tangent(config.cluster_angle) };
    let mut end = FIRST_OBJECT;
    let mut cluster = Vec::new();
    for row in 0..labels.rows() {
        for column in 0..labels.columns() {
            let seed = (row, column);
            if labels[seed] != NO_RETURN || !scene.is_return(seed) {
                continue;
            }
            surfaces.fill(seed, end, labels, &mut cluster);
            if cluster.len() < config.smallest_cluster {
                cluster.iter().for_each(|&cell| labels[cell] = UNASSIGNED);
            } else {
                end += 1;
            }
        }
    }
    end
}

/// Decides which neighbours are on a common surface.
struct Surfaces<'a> {
    scene: &'a Scene,
    neighbours: &'a Neighbours,
    tangent: f32,
}

impl Surfaces<'_> {
    /// Labels everything connected with a return, breadth first; `cluster` then holds the labelled returns.
    fn fill(&self, seed: Cell, label: u32, labels: &mut Grid<u32>, cluster: &mut Vec<Cell>) {
        labels[seed] = label;
        cluster.clear();
        cluster.push(seed);
        let mut next = 0;
        while let Some(&cell) = cluster.get(next) {
            next += 1;
            for other in self.around(cell) {
                if labels[other] == NO_RETURN && self.scene.is_one_surface(cell, other, self.tangent) {
                    labels[other] = label;
                    cluster.push(other);
                }
            }
        }
    }

    fn around(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let near = move |other: &Cell| other.0.abs_diff(cell.0) <= REACH;
        let above = self.neighbours.above(cell).next().filter(near);
        let below = self.neighbours.below(cell).next().filter(near);
        self.neighbours.beside(cell).chain(above).chain(below)
    }
}
