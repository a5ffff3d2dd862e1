//! Ground removal (article, IV-B.1).

use super::neighbours::{Cell, Neighbours};
use super::scene::Scene;
use super::{GROUND, NO_RETURN, SegmentationConfig};
use crate::ground::grid::Grid;

/// Number of returns above and below to which lines are drawn.
const HOPS: usize = 3;

/// Marks the ground, growing it from the lowest return of each column along flat lines. Returns that are flat
/// but not connected, such as a roof, are not ground.
pub fn mark(scene: &Scene, neighbours: &Neighbours, config: &SegmentationConfig, labels: &mut Grid<u32>) {
    let lines = Lines::new(scene, neighbours, config);
    let mut open = Vec::new();
    for column in 0..labels.columns() {
        let lowest = (0..labels.rows()).rev().map(|row| (row, column)).find(|&cell| scene.is_return(cell));
        open.extend(lowest.filter(|&cell| lines.lies(cell)));
    }
    open.iter().for_each(|&cell| labels[cell] = GROUND);
    while let Some(cell) = open.pop() {
        for next in lines.flat_in_column(cell) {
            if labels[next] == NO_RETURN {
                labels[next] = GROUND;
                open.push(next);
            }
        }
        for next in lines.flat_in_row(cell) {
            if labels[next] == NO_RETURN && lines.lies(next) {
                labels[next] = GROUND;
                open.push(next);
            }
        }
    }
}

/// Decides which lines between returns may be ground.
struct Lines<'a> {
    scene: &'a Scene,
    neighbours: &'a Neighbours,
    square_tangent: f32,
    most_rise: f32,
    square_reach: f32,
    surface_tangent: f32,
}

impl<'a> Lines<'a> {
    fn new(scene: &'a Scene, neighbours: &'a Neighbours, config: &SegmentationConfig) -> Self {
        let tangent = super::tangent(config.ground_angle);
        Lines {
            scene,
            neighbours,
            square_tangent: tangent * tangent,
            most_rise: config.ground_rise_m as f32,
            square_reach: (config.ground_reach_m * config.ground_reach_m) as f32,
            surface_tangent: super::tangent(config.cluster_angle),
        }
    }

    /// The returns above and below that a flat line connects. Beyond the next return the line must be short.
    fn flat_in_column(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        let above = self.neighbours.above(cell).take(HOPS).enumerate();
        let below = self.neighbours.below(cell).take(HOPS).enumerate();
        let is_flat = move |&(hop, other): &(usize, Cell)| {
            let (rise, square_run) = self.scene.rise_and_run(cell, other);
            self.is_flat(rise, square_run) && (hop == 0 || square_run < self.square_reach)
        };
        above.chain(below).filter(is_flat).map(|(_, other)| other)
    }

    /// The returns to the left and right that a flat line connects. Seen from the side, the edge of a roof is
    /// almost level with the ground far behind it, so both must also be on one surface.
    fn flat_in_row(&self, cell: Cell) -> impl Iterator<Item = Cell> {
        self.neighbours.beside(cell).filter(move |&other| {
            let (rise, square_run) = self.scene.rise_and_run(cell, other);
            self.is_flat(rise, square_run) && self.scene.is_one_surface(cell, other, self.surface_tangent)
        })
    }

    /// Whether a flat line leads up or down. A wall is level from column to column too; only this
    /// distinguishes it from the ground.
    fn lies(&self, cell: Cell) -> bool {
        self.flat_in_column(cell).next().is_some()
    }

    /// Equation 3.
    fn is_flat(&self, rise: f32, square_run: f32) -> bool {
        rise < self.most_rise && rise * rise < self.square_tangent * square_run
    }
}
