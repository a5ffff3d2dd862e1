//! Pictures of tables: one rectangle for each cell, black where there is no return.

use super::colour::{self, BLACK, ColourMap, GREY, PLAIN, Rgb, Scale};
use super::painting::{Picture, with_legend};
use crate::ground::grid::Grid;

/// The size in which a cell is drawn, in pixels; 0 counts as 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Zoom {
    /// Height of a cell.
    pub row: usize,
    /// Width of a cell.
    pub column: usize,
}

impl Zoom {
    /// The size for a table with `columns` columns: rows are four times as tall as columns are wide, since
    /// the beams of a scanner are farther apart than its firings, and the picture is about 1500 pixels wide,
    /// or wider if it has more columns.
    pub fn for_columns(columns: usize) -> Self {
        const WIDTH: usize = 1500;
        const WIDEST: usize = 16;
        let column = (WIDTH / columns.max(1)).clamp(1, WIDEST);
        Zoom { row: 4 * column, column }
    }
}

/// How a label is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LabelStyle {
    /// A region with a colour of its own.
    Object,
    /// Ground, which is brown.
    Ground,
    /// Returns that belong to no region, which are grey.
    Unassigned,
}

/// A range image, or a prediction of one: rows x columns, in steps of `step_m` metres, 0 = no return; nearer
/// is darker.
pub fn range(steps: &Grid<u32>, step_m: f64, scale: &Scale, zoom: Zoom) -> Picture {
    let map = ColourMap::sequential();
    let picture = paint(steps, zoom, |_, &steps| match steps {
        0 => BLACK,
        _ => map.at(scale.part(f64::from(steps) * step_m)),
    });
    with_legend(&picture, &map, scale, "m")
}

/// Which cells hold a return.
pub fn occupancy(occupancy: &Grid<bool>, zoom: Zoom) -> Picture {
    paint(occupancy, zoom, |_, &filled| if filled { PLAIN } else { BLACK })
}

/// The regions of a frame: label 0 means no return, and `style` defines how the others are drawn.
pub fn labels(labels: &Grid<u32>, style: impl Fn(u32) -> LabelStyle, zoom: Zoom) -> Picture {
    paint(labels, zoom, |_, &label| match label {
        0 => BLACK,
        _ => match style(label) {
            LabelStyle::Object => colour::of_label(label),
            LabelStyle::Ground => colour::of_ground(label),
            LabelStyle::Unassigned => GREY,
        },
    })
}

/// Residuals in steps of `step_m` metres, where `occupancy`, of the same shape, holds a return: red where the
/// return is farther away than predicted, blue where it is nearer.
pub fn residual(residuals: &Grid<i32>, occupancy: &Grid<bool>, step_m: f64, zoom: Zoom) -> Picture {
    let metres = |residual: i32| f64::from(residual) * step_m;
    let returns = residuals.cells().iter().zip(occupancy.cells()).filter(|(_, filled)| **filled);
    let scale = Scale::of_residuals(returns.map(|(&residual, _)| metres(residual)));
    let map = ColourMap::diverging();
    let picture = paint(residuals, zoom, |cell, &residual| match occupancy[cell] {
        true => map.at(scale.part(metres(residual))),
        false => BLACK,
    });
    with_legend(&picture, &map, &scale, "m")
}

/// Distances between decoded and original points, in millimetres; NaN = no return. Larger is lighter.
pub fn error(millimetres: &Grid<f32>, zoom: Zoom) -> Picture {
    let scale = Scale::of_errors(millimetres.cells().iter().map(|&error| f64::from(error)));
    let map = ColourMap::sequential();
    let picture = paint(millimetres, zoom, |_, error| match error.is_nan() {
        true => BLACK,
        false => map.at(scale.part(f64::from(*error))),
    });
    with_legend(&picture, &map, &scale, "mm")
}

/// Paints one rectangle for each cell.
fn paint<T: Clone + Default>(
    cells: &Grid<T>,
    zoom: Zoom,
    colour: impl Fn((usize, usize), &T) -> Rgb,
) -> Picture {
    let (height, width) = (zoom.row.max(1), zoom.column.max(1));
    let mut picture = Picture::new(cells.columns() * width, cells.rows() * height);
    for row in 0..cells.rows() {
        for (column, cell) in cells.row(row).iter().enumerate() {
            picture.fill([column * width, row * height], [width, height], colour((row, column), cell));
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZOOM: Zoom = Zoom { row: 3, column: 2 };
    const STEP: f64 = 0.01;

    fn grid<T: Clone + Default>(rows: usize, columns: usize, cells: &[((usize, usize), T)]) -> Grid<T> {
        let mut grid = Grid::new(rows, columns);
        cells.iter().for_each(|(cell, value)| grid[*cell] = value.clone());
        grid
    }

    /// The pixel in the middle of a cell.
    fn at(picture: &Picture, (row, column): (usize, usize)) -> Rgb {
        picture.pixel(column * ZOOM.column + 1, row * ZOOM.row + 1).unwrap()
    }

    fn luma(colour: Rgb) -> u32 {
        colour.iter().map(|&part| u32::from(part)).sum()
    }

    #[test]
    fn near_is_darker_than_far_and_nothing_is_black() {
        let steps = grid(4, 900, &[((0, 0), 500), ((3, 899), 5000)]);
        let scale = Scale::of_ranges([5.0, 50.0].into_iter());
        let picture = range(&steps, STEP, &scale, ZOOM);
        let (near, far) = (at(&picture, (0, 0)), at(&picture, (3, 899)));
        assert_eq!(at(&picture, (1, 1)), BLACK);
        assert!(luma(near) > 0 && luma(near) < luma(far));
        assert_eq!(picture.pixel(ZOOM.column - 1, ZOOM.row - 1), Some(near));
        assert_eq!(picture.pixel(ZOOM.column, ZOOM.row - 1), Some(BLACK));
        assert!(picture.height() > 4 * ZOOM.row, "the legend is under the picture");
    }

    #[test]
    fn occupancy_is_two_colours() {
        let picture = super::occupancy(&grid(2, 2, &[((1, 0), true)]), ZOOM);
        assert_eq!((at(&picture, (1, 0)), at(&picture, (0, 1))), (PLAIN, BLACK));
        assert_eq!((picture.width(), picture.height()), (4, 6));
    }

    #[test]
    fn labels_have_the_colour_of_their_style() {
        let cells = grid(1, 5, &[((0, 1), 1), ((0, 2), 2), ((0, 3), 3), ((0, 4), 4)]);
        let style = |label| match label {
            1 => LabelStyle::Ground,
            2 => LabelStyle::Unassigned,
            _ => LabelStyle::Object,
        };
        let picture = labels(&cells, style, ZOOM);
        let colours: Vec<Rgb> = (0..5).map(|column| at(&picture, (0, column))).collect();
        assert_eq!(colours[0], BLACK);
        assert_eq!(colours[1..3], [colour::of_ground(1), GREY]);
        assert_eq!(colours[3..], [colour::of_label(3), colour::of_label(4)]);
    }

    #[test]
    fn residuals_are_blue_white_and_red() {
        let residuals = grid(1, 4, &[((0, 0), -5), ((0, 2), 5)]);
        let filled = grid(1, 4, &[((0, 0), true), ((0, 1), true), ((0, 2), true)]);
        let picture = residual(&residuals, &filled, STEP, ZOOM);
        let [blue, white, red, nothing] = [0, 1, 2, 3].map(|column| at(&picture, (0, column)));
        assert!(blue[2] > blue[0] && red[0] > red[2] && white.iter().all(|&part| part > 230));
        assert_eq!(nothing, BLACK);
    }

    #[test]
    fn residuals_outside_the_returns_do_not_count() {
        let filled = grid(1, 2, &[((0, 0), true)]);
        let wild = residual(&grid(1, 2, &[((0, 0), 3), ((0, 1), i32::MIN)]), &filled, STEP, ZOOM);
        assert_eq!(wild, residual(&grid(1, 2, &[((0, 0), 3)]), &filled, STEP, ZOOM));
    }

    #[test]
    fn errors_get_lighter_and_nan_is_nothing() {
        let picture = error(&grid(1, 3, &[((0, 1), 0.5), ((0, 2), f32::NAN)]), ZOOM);
        assert!(luma(at(&picture, (0, 0))) < luma(at(&picture, (0, 1))));
        assert_eq!(at(&picture, (0, 2)), BLACK);
    }

    #[test]
    fn tables_without_cells_or_returns_are_pictures_too() {
        let scale = Scale::of_ranges(std::iter::empty());
        for (rows, columns) in [(0, 0), (64, 0), (0, 64), (1, 1), (3, 700)] {
            let zoom = Zoom::for_columns(columns);
            let pictures = [
                range(&Grid::new(rows, columns), STEP, &scale, zoom),
                super::occupancy(&Grid::new(rows, columns), zoom),
                labels(&Grid::new(rows, columns), |_| LabelStyle::Object, zoom),
                residual(&Grid::new(rows, columns), &Grid::new(rows, columns), STEP, zoom),
                error(&Grid::new(rows, columns), Zoom { row: 0, column: 0 }),
            ];
            for picture in pictures {
                let decoded = image::load_from_memory(&picture.to_png().unwrap()).unwrap();
                let size = (decoded.width() as usize, decoded.height() as usize);
                assert_eq!(size, (picture.width(), picture.height()));
            }
        }
    }

    #[test]
    fn cells_of_few_columns_are_large() {
        assert_eq!(Zoom::for_columns(2000), Zoom { row: 4, column: 1 });
        assert_eq!(Zoom::for_columns(500), Zoom { row: 12, column: 3 });
        assert_eq!(Zoom::for_columns(0), Zoom::for_columns(1));
    }
}
