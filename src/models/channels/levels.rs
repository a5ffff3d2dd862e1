//! Values of which there are few, such as reflectivities, grey levels and labels: each is coded as an
//! intensity is, in contexts of its neighbours in the range image. FORMAT.md 8.9.

use std::collections::BTreeSet;

use crate::entropy::{BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::grid::Grid;
use crate::models::intensity::{IntensityModel, IntensityNeighbours, IntensityScale};

/// The largest number of values that are coded as levels.
pub const MOST_LEVELS: usize = 512;
/// The largest number of values of any palette.
pub const MOST_ENTRIES: usize = u16::MAX as usize;

/// The highest value and the lowest differ by less than this, so that their differences can be coded.
const WIDEST: i64 = 1 << 62;

/// The values of a frame, ascending: a level is an index of them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Palette(Vec<i64>);

/// One value, because a palette is never empty: that of a frame all of whose values are off the scale.
impl Default for Palette {
    fn default() -> Self {
        Palette(vec![0])
    }
}

impl Palette {
    /// The values of these integers; `None` if there are more than `most`, or if they lie too far apart.
    pub fn of(integers: impl Iterator<Item = i64>, most: usize) -> Option<Self> {
        let mut values = BTreeSet::new();
        let mut last = None;
        for integer in integers {
            if last != Some(integer) && values.insert(integer) && values.len() > most {
                return None;
            }
            last = Some(integer);
        }
        let values: Vec<i64> = values.into_iter().collect();
        let span = values.last()?.checked_sub(*values.first()?)?;
        (span < WIDEST).then_some(Palette(values))
    }

    /// Codes the values, of which there may be `most`; a decoder passes any palette.
    ///
    /// # Errors
    /// If a decoder reads too many values, or none.
    pub fn code<C: BitCoder>(&self, coder: &mut C, most: usize) -> Result<Self> {
        let count = coder.code_plain(self.0.len() as u64, 16) as usize;
        if count == 0 || count > most {
            return Err(Error::corrupt("channels: too many values of a palette"));
        }
        let first = coder.code_plain(self.0.first().copied().unwrap_or(0) as u64, 64) as i64;
        let mut steps = IntegerModel::default();
        let mut values = vec![first];
        for at in 1..count {
            if coder.is_exhausted() {
                break;
            }
            let step = self.0.get(at).map_or(0, |value| value.wrapping_sub(self.0[at - 1]) as u64);
            let last = values[at - 1];
            values.push(last.wrapping_add(steps.code(coder, step) as i64));
        }
        Ok(Palette(values))
    }

    /// The index of a value of the palette.
    pub fn index_of(&self, value: i64) -> usize {
        self.0.partition_point(|&other| other < value)
    }

    /// The value with this index, or the last one.
    pub fn value_of(&self, index: usize) -> i64 {
        self.0[index.min(self.0.len() - 1)]
    }
}

/// Adaptive models of levels.
#[derive(Clone, Default)]
pub struct LevelsModel {
    model: IntensityModel,
    scale: IntensityScale,
    /// The context levels of this frame so far, by row and column counted from 1; 0 for none.
    known: Grid<u16>,
    /// The last four context levels of each row, the latest first; those of records without a cell in row 0.
    of_row: Vec<[u16; 4]>,
}

impl LevelsModel {
    /// Starts a frame of `records` levels, in an image of this many rows and columns.
    pub fn start_frame(&mut self, palette: &Palette, (rows, columns): (usize, usize), records: usize) {
        self.scale = IntensityScale::of_levels(palette.0.len());
        self.known = Grid::new(rows + 1, columns + 1);
        self.of_row = vec![[0; 4]; rows + 1];
        self.model.start_frame(&self.scale, (rows + 1, columns + 1), records);
    }

    /// Codes the value of the next record, whose row and column are counted from 1; 0 if it has none.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        palette: &Palette,
        (row, column): (usize, usize),
        value: i64,
    ) -> i64 {
        let near = self.near((row, column));
        let level = palette.index_of(value) as f32;
        let level = self.model.code(coder, &self.scale, &near, (row, column), level);
        let context = self.scale.context_level(level);
        if row > 0 {
            self.known[(row, column)] = context;
        }
        let last = &mut self.of_row[row];
        *last = [context, last[0], last[1], last[2]];
        palette.value_of(level as usize)
    }

    /// The levels around a cell. The rows may come from top to bottom or the other way round.
    fn near(&self, (row, column): (usize, usize)) -> IntensityNeighbours {
        let at = |down: isize, right: isize| match (
            row.checked_add_signed(down),
            column.checked_add_signed(right),
        ) {
            (Some(row), Some(column)) if row < self.known.rows() && column < self.known.columns() => {
                self.known[(row, column)]
            }
            _ => 0,
        };
        let up = if at(-1, 0) > 0 || at(1, 0) == 0 { -1 } else { 1 };
        IntensityNeighbours {
            left: self.of_row[row],
            above: [-2, -1, 0, 1, 2].map(|right| at(up, right)),
            above2: [-1, 0, 1].map(|right| at(2 * up, right)),
            back: None,
        }
    }
}
