//! The surfaces of the frame before, as seen from the scanner's current position. FORMAT.md 4.3.

use crate::ground::grid::Grid;
use crate::inter::Layer;
use crate::inter::registration::{RigidMotion, Surface, Surfel, columns_by_tick, dot};
use crate::scanner::hdl64::{Alignment, Hdl64, Sighting};

/// Of two surfels in a cell, the nearer one is visible if it is nearer by more than this share of the range;
/// otherwise the one closer to the centre of the cell.
const IN_FRONT: f64 = 0.05;
/// A surfel is not extended to a ray whose distance from it exceeds this share of its range.
const EXTENT: f64 = 0.2;

/// A surfel that is visible in a cell.
#[derive(Clone, Copy)]
struct Seen {
    /// The range at which the cell's ray intersects it, in metres.
    metres: f64,
    /// The distance of the surfel from the ray, in radians.
    off: f64,
    position: [f64; 3],
    normal: [f64; 3],
    level: u16,
}

/// Renders a moved surface into an image with these columns. `levels` are the intensities of the
/// surface's cells.
pub fn render(
    surface: &Surface,
    levels: &Grid<u16>,
    motion: &RigidMotion,
    scanner: &Hdl64,
    columns: &[u32],
) -> Layer {
    let rows = scanner.rows();
    let canvas = Canvas { scanner, columns, column_of_tick: columns_by_tick(columns, scanner.ticks) };
    let mut seen: Grid<Option<Seen>> = Grid::new(rows, columns.len());
    for surfel in &surface.surfels {
        let level = levels[(surfel.cell.0 as usize, surfel.cell.1 as usize)];
        let Some((cell, new)) = canvas.see(surfel, level, motion) else { continue };
        let old = &mut seen[cell];
        let is_better = old.is_none_or(|old| {
            let closer = new.metres - old.metres;
            closer < -IN_FRONT * new.metres || closer < IN_FRONT * new.metres && new.off < old.off
        });
        if is_better {
            *old = Some(new);
        }
    }
    let alignment = Alignment::of(scanner, columns.len());
    let mut layer = Layer { steps: Grid::new(rows, columns.len()), levels: Grid::new(rows, columns.len()) };
    for row in 0..rows {
        for column in 0..columns.len() {
            let found = seen[(row, column)].or_else(|| canvas.beside(&seen, &alignment, (row, column)));
            if let Some(found) = found {
                layer.steps[(row, column)] = scanner.nearest_steps(found.metres).max(1);
                layer.levels[(row, column)] = found.level;
            }
        }
    }
    layer
}

struct Canvas<'a> {
    scanner: &'a Hdl64,
    columns: &'a [u32],
    column_of_tick: Vec<Option<u32>>,
}

impl Canvas<'_> {
    /// The cell in which a surfel is visible after a motion.
    fn see(&self, surfel: &Surfel, level: u16, motion: &RigidMotion) -> Option<((usize, usize), Seen)> {
        let position = motion.apply(surfel.position);
        let Sighting { row, column_tick, metres, off } =
            self.scanner.locate(surfel.cell.0 as usize, position)?;
        let column = self.column_of_tick[column_tick as usize]? as usize;
        let normal = motion.turn(surfel.normal);
        let seen = Seen { metres, off, position, normal, level };
        Some(((row, column), self.extend(&seen, (row, column)).unwrap_or(seen)))
    }

    /// The intersection of the surfel's plane with a cell's ray, if it is near the surfel.
    fn extend(&self, seen: &Seen, (row, column): (usize, usize)) -> Option<Seen> {
        let tick = self.scanner.tick_of_column(row, self.columns[column]);
        let on_ray = self.scanner.point_at(row, tick, seen.metres);
        let away: [f64; 3] = std::array::from_fn(|i| seen.position[i] - on_ray[i]);
        let slope = dot(seen.normal, self.scanner.direction(row, tick));
        let further = dot(seen.normal, away) / slope;
        let is_near = further.abs() < EXTENT * seen.metres;
        is_near.then_some(Seen { metres: seen.metres + further, ..*seen })
    }

    /// For a cell without a visible surfel: that of a neighbouring cell, extended.
    fn beside(
        &self,
        seen: &Grid<Option<Seen>>,
        alignment: &Alignment,
        (row, column): (usize, usize),
    ) -> Option<Seen> {
        let width = self.columns.len();
        let at = |down: isize, right: isize| {
            let other = row.checked_add_signed(down).filter(|&other| other < seen.rows())?;
            let column = column + width - alignment.turn(row) + alignment.turn(other);
            seen[(other, column.checked_add_signed(right)? % width)]
        };
        let candidates = [at(0, -1), at(0, 1), at(-1, 0), at(1, 0)];
        let extended = candidates.into_iter().flatten().filter_map(|near| self.extend(&near, (row, column)));
        extended.min_by(|a, b| a.metres.total_cmp(&b.metres))
    }
}
