//! Ground removal (article, IV-B.1).

use super::neighbours::{Cell, Neighbours};
use super::surface_angles::SurfaceAngles;
use super::{GROUND, NO_RETURN, SegmentationConfig};
use crate::grid::Grid;

/// Marks the ground, growing it from the lowest return of each column along flat lines: what is flat but
/// out of reach, such as a roof, is none.
pub fn mark(
    angles: &SurfaceAngles,
    neighbours: &Neighbours,
    config: &SegmentationConfig,
    labels: &mut Grid<u32>,
) {
    let tangent = super::tangent(config.ground_angle);
    let cluster_tangent = super::tangent(config.cluster_angle);
    let mut open: Vec<Cell> = Vec::new();
    for column in 0..labels.columns() {
        let lowest = (0..labels.rows()).rev().map(|row| (row, column)).find(|c| neighbours.is_return(*c));
        let above = lowest.and_then(|cell| neighbours.above(cell));
        if let (Some(lowest), Some(above)) = (lowest, above)
            && angles.is_flat(lowest, above, tangent)
        {
            labels[lowest] = GROUND;
            open.push(lowest);
        }
    }
    // A wall is level from column to column: only the line up or down tells it from the ground.
    let flat = |a: Cell, b: Option<Cell>| b.is_some_and(|b| angles.is_flat(a, b, tangent));
    let lies = |cell: Cell| flat(cell, neighbours.below(cell)) || flat(cell, neighbours.above(cell));
    // Seen from the side, the edge of a roof is as good as level with the ground far behind it.
    let joined = |a: Cell, b: Cell| a.0 != b.0 || angles.is_one_surface(a, b, cluster_tangent);
    while let Some(cell) = open.pop() {
        for next in neighbours.around(cell) {
            let new = labels[next] == NO_RETURN;
            if new && angles.is_flat(cell, next, tangent) && joined(cell, next) && lies(next) {
                labels[next] = GROUND;
                open.push(next);
            }
        }
    }
}
