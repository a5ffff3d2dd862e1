//! Object clustering (article, IV-B.2): returns are of one object if a chain of neighbours on common
//! surfaces leads from one to the other.

use super::neighbours::{Cell, Neighbours};
use super::surface_angles::SurfaceAngles;
use super::{FIRST_OBJECT, NO_RETURN, SegmentationConfig, UNASSIGNED};
use crate::grid::Grid;

/// Labels all returns that have no label. Returns the end of the labels.
pub fn mark(
    angles: &SurfaceAngles,
    neighbours: &Neighbours,
    config: &SegmentationConfig,
    labels: &mut Grid<u32>,
) -> u32 {
    let tangent = super::tangent(config.cluster_angle);
    let mut end = FIRST_OBJECT;
    let mut cluster: Vec<Cell> = Vec::new();
    for row in 0..labels.rows() {
        for column in 0..labels.columns() {
            let seed = (row, column);
            if labels[seed] != NO_RETURN || !neighbours.is_return(seed) {
                continue;
            }
            cluster.clear();
            cluster.push(seed);
            labels[seed] = end;
            let mut next = 0;
            while let Some(&cell) = cluster.get(next) {
                next += 1;
                for other in neighbours.around(cell) {
                    if labels[other] == NO_RETURN && angles.is_one_surface(cell, other, tangent) {
                        labels[other] = end;
                        cluster.push(other);
                    }
                }
            }
            if cluster.len() < config.smallest_cluster {
                cluster.iter().for_each(|&cell| labels[cell] = UNASSIGNED);
            } else {
                end += 1;
            }
        }
    }
    end
}
