//! The intensities of the returns, then of the strays and blanks. FORMAT.md 8.5 and 8.16.

use std::mem::take;

use byteorder::{ByteOrder, LittleEndian};

use super::returns::Part;
use crate::backend::Compressors;
use crate::container::SectionKind;
use crate::entropy::{BitCoder, TokenCoder, TokenTables};
use crate::frame::fidelity::IntensityFidelity;
use crate::frame::modelling::IntensityModelling;
use crate::frame::parts::FrameParts;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::ground::grid::Grid;
use crate::models::{
    ChannelsModel, INTENSITY_CONTEXTS, IntensityModel, IntensityNeighbours, IntensityReference,
    IntensityScale, IntensityTokens, PACKED_INTENSITY_CONTEXTS, PointTrail, RecordContext,
    code_packed_intensities,
};
use crate::scan::{Channel, Field, ScalarType};

/// The models of intensities.
#[derive(Clone, Default)]
pub struct IntensityModels {
    // Created when first needed, as it is large.
    adaptive: Option<IntensityModel>,
    tokens: TokenTables,
    packed: TokenTables,
    /// The models of intensities that are on no grid.
    rough: ChannelsModel,
}

impl IntensityModels {
    /// Codes the intensities, if the frame has any and keeps them. Returns the context levels of the returns,
    /// for the coding of the ranges.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        part: &Part,
        values: &mut Intensities,
    ) -> Result<Grid<u16>> {
        let parameters = &part.frame.parameters;
        if part.frame.layout.intensity.is_none() || parameters.intensity == IntensityFidelity::None {
            let (rows, columns) = (part.occupancy.rows(), part.occupancy.columns());
            values.of_cells = Grid::new(rows, columns);
            values.outside = vec![0.0; part.outside];
            return Ok(Grid::new(rows, columns));
        }
        let all = if S::ENCODES { values.all(part) } else { Vec::new() };
        let mut scale = match S::ENCODES {
            true => IntensityScale::of(&all, parameters.intensity.levels_per_unit()),
            false => IntensityScale::default(),
        };
        let is_deep = match parameters.modelling().parts().intensity {
            IntensityModelling::Light => false,
            IntensityModelling::Deep => true,
            IntensityModelling::Tokens => {
                let mut levels = Grid::new(part.occupancy.rows(), part.occupancy.columns());
                let code = |coder: &mut S::Tokens<'_>| code_tokens(coder, scale, part, values, &mut levels);
                return sections
                    .tokens(SectionKind::Intensity, INTENSITY_CONTEXTS, &mut self.tokens, code)
                    .map(|()| levels);
            }
            // Packed ranges have no contexts.
            IntensityModelling::Packed => {
                let code = |coder: &mut S::Tokens<'_>| pack(coder, scale, part, (all, values));
                return sections
                    .tokens(SectionKind::Intensity, PACKED_INTENSITY_CONTEXTS, &mut self.packed, code)
                    .map(|()| Grid::default());
            }
        };
        let compressors = sections.effort().compressors;
        sections.section(SectionKind::Intensity, true, |coder| {
            scale.code(|value, bits| coder.code_plain(u64::from(value), bits) as u32);
            if !scale.is_on_grid() {
                return self.code_rough(coder, part, values, compressors);
            }
            let model = self.adaptive.get_or_insert_default();
            model.use_deep(is_deep);
            Ok(code_adaptive(model, coder, part, values, scale))
        })
    }

    /// Intensities on a grid that the intensity models do not support, coded as a channel of the returns and
    /// strays. Returns no contexts for the ranges.
    fn code_rough<C: BitCoder>(
        &mut self,
        coder: &mut C,
        part: &Part,
        known: &mut Intensities,
        compressors: Compressors,
    ) -> Result<Grid<u16>> {
        let returns = part.cells.len();
        let width = part.occupancy.columns() as u32;
        let mut values = if C::ENCODES { known.of_cells.at(part.cells) } else { vec![0.0; returns] };
        values.append(&mut known.outside);
        values.resize(returns + part.outside, 0.0);
        // Strays that repeat another one mostly have its intensity, too.
        let sources: Vec<Option<usize>> = (0..part.outside)
            .map(|index| part.frame.strays.trails.get(index).and_then(PointTrail::source))
            .collect();
        let strays = || (returns..).zip(&sources);
        let are_shared = C::ENCODES
            && strays().all(|(index, source)| {
                source.is_none_or(|source| values[returns + source].to_bits() == values[index].to_bits())
            });
        let are_shared = coder.code_plain(are_shared.into(), 1) == 1;
        let is_coded = |source: &Option<usize>| source.is_none() || !are_shared;
        let coded: Vec<usize> = (0..returns)
            .chain(strays().filter(|(_, source)| is_coded(source)).map(|(index, _)| index))
            .collect();
        // Rows of an image and trails have nothing to do with each other.
        let row = |index: usize| match part.cells.get(index) {
            Some(cell) => cell / width + 1,
            None if returns > 0 => 0,
            None => part.frame.strays.trails.get(index).map_or(0, |trail| trail.row),
        };
        let context = RecordContext {
            rows: coded.iter().map(|&index| row(index)).collect(),
            columns: coded
                .iter()
                .map(|&index| part.cells.get(index).map_or(0, |cell| cell % width + 1))
                .collect(),
            ..RecordContext::default()
        };
        let bytes = coded.iter().flat_map(|&index| values[index].to_le_bytes()).collect();
        let mut channels = [Channel { field: Field::new("intensity", ScalarType::F32), bytes }];
        // One column, whose image is no larger than the range image.
        self.rough.code(coder, &mut channels, &context, compressors, u64::MAX)?;
        let [Channel { bytes, .. }] = channels;
        for (&index, value) in coded.iter().zip(bytes.chunks_exact(4).map(LittleEndian::read_f32)) {
            values[index] = value;
        }
        if are_shared {
            for (index, source) in strays() {
                if let Some(source) = source {
                    values[index] = values[returns + source];
                }
            }
        }
        known.outside = values.split_off(returns);
        known.of_cells.fill(part.cells, &values);
        let mut levels = Grid::new(part.occupancy.rows(), part.occupancy.columns());
        levels.cells_mut().fill(1);
        Ok(levels)
    }
}

/// The intensities of the returns, then of the strays. Returns the context levels of the returns, for the
/// coding of the ranges.
fn code_adaptive<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    part: &Part,
    values: &mut Intensities,
    scale: IntensityScale,
) -> Grid<u16> {
    let width = part.occupancy.columns();
    let mut levels = Grid::new(part.occupancy.rows(), width);
    model.start_frame(&scale, (levels.rows(), width), part.cells.len());
    for row in 0..levels.rows() {
        if coder.is_exhausted() {
            break;
        }
        model.start_row();
        let mut left = [0; 4];
        for column in (0..width).filter(|&column| part.occupancy[(row, column)]) {
            let mut near = neighbours(&levels, left, row, column);
            near.back = part.reference.and_then(|reference| IntensityReference::at(reference, (row, column)));
            let value = &mut values.of_cells[(row, column)];
            *value = model.code(coder, &scale, &near, (row, column), *value);
            levels[(row, column)] = scale.context_level(*value);
            left = [levels[(row, column)], left[0], left[1], left[2]];
        }
    }
    code_strays(model, coder, &scale, part, values);
    levels
}

fn code_strays<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    scale: &IntensityScale,
    part: &Part,
    values: &mut Intensities,
) {
    values.outside.resize(part.outside, 0.0);
    let trails = StrayTrails(&part.frame.strays.trails);
    let mut levels: Vec<u16> = Vec::with_capacity(part.outside);
    model.start_frame(scale, (trails.rows(), 1), part.outside);
    for index in 0..part.outside {
        if coder.is_exhausted() {
            return;
        }
        let at = |index: Option<usize>| index.and_then(|i| levels.get(i)).copied().unwrap_or(0);
        let before = |index: Option<usize>| index.and_then(|index| trails.before(index));
        let (own, above, above2) = (Some(index), index.checked_sub(1), index.checked_sub(2));
        let west = before(own);
        let left = [west, before(west), before(before(west)), before(before(before(west)))];
        let near = IntensityNeighbours {
            left: left.map(at),
            above: [before(before(above)), before(above), above, west.map(|west| west + 1), None].map(at),
            above2: [before(above2), above2, None].map(at),
            back: None,
        };
        let value = &mut values.outside[index];
        *value = model.code(coder, scale, &near, (trails.row(index), 0), *value);
        levels.push(scale.context_level(*value));
    }
}

/// The trails of the strays, and of the blanks behind them, which are in none.
struct StrayTrails<'a>(&'a [PointTrail]);

impl StrayTrails<'_> {
    /// The stray before this one in its trail, or the one that it repeats; the preceding one where nothing is
    /// known of trails.
    fn before(&self, index: usize) -> Option<usize> {
        match self.0.get(index) {
            Some(trail) => trail.before,
            None => index.checked_sub(1),
        }
    }

    /// The number of the trail, counted from 1; 0 for none.
    fn row(&self, index: usize) -> usize {
        self.0.get(index).map_or(0, |trail| trail.row as usize)
    }

    /// The number of rows.
    fn rows(&self) -> usize {
        self.0.iter().map(|trail| trail.row as usize + 1).max().unwrap_or(1)
    }
}

/// The intensity levels around a cell.
fn neighbours(levels: &Grid<u16>, left: [u16; 4], row: usize, column: usize) -> IntensityNeighbours {
    let at =
        |rows_up: usize, offset: isize| match (row.checked_sub(rows_up), column.checked_add_signed(offset)) {
            (Some(row), Some(column)) if column < levels.columns() => levels[(row, column)],
            _ => 0,
        };
    IntensityNeighbours {
        left,
        above: [-2, -1, 0, 1, 2].map(|offset| at(1, offset)),
        above2: [-1, 0, 1].map(|offset| at(2, offset)),
        back: None,
    }
}

/// The intensities of the returns, whose context levels are written to `levels`, then of the strays.
fn code_tokens<C: TokenCoder>(
    coder: &mut C,
    mut scale: IntensityScale,
    part: &Part,
    values: &mut Intensities,
    levels: &mut Grid<u16>,
) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let mut model = IntensityTokens::default();
    let (rows, width) = (part.occupancy.rows(), part.occupancy.columns());
    // The last intensity level in each column.
    let mut above = vec![0; width];
    for row in 0..rows {
        if coder.is_exhausted() {
            return;
        }
        let mut west = 0;
        let cells = part.occupancy.row(row).iter().zip(values.of_cells.row_mut(row)).zip(&mut above);
        for (((_, value), north), level) in
            cells.zip(levels.row_mut(row)).filter(|(((filled, _), _), _)| **filled)
        {
            west = model.code(coder, &scale, (west, *north), value);
            (*north, *level) = (west, west);
        }
    }
    values.outside.resize(part.outside, 0.0);
    let trails = StrayTrails(&part.frame.strays.trails);
    let mut levels: Vec<u16> = Vec::with_capacity(part.outside);
    for (index, value) in values.outside.iter_mut().enumerate() {
        if coder.is_exhausted() {
            return;
        }
        let at = |index: Option<usize>| index.and_then(|i| levels.get(i)).copied().unwrap_or(0);
        let near = (at(trails.before(index)), at(index.checked_sub(1)));
        levels.push(model.code(coder, &scale, near, value));
    }
}

/// The encoder passes the values of all returns and strays.
fn pack<C: TokenCoder>(
    coder: &mut C,
    mut scale: IntensityScale,
    part: &Part,
    (mut values, known): (Vec<f32>, &mut Intensities),
) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let returns = part.cells.len();
    values.resize(returns + part.outside, 0.0);
    code_packed_intensities(coder, &scale, &mut values);
    known.outside = values.split_off(returns);
    known.of_cells.fill(part.cells, &values);
}

impl FrameParts {
    /// Number of records that are not returns.
    pub fn outside(&self) -> usize {
        self.strays.count + self.blanks.len()
    }

    /// Moves the intensities out of the frame; those of the blanks follow those of the strays.
    pub fn take_intensities(&mut self) -> Intensities {
        let (of_cells, mut outside) = (take(&mut self.intensity), take(&mut self.strays.intensity));
        if !of_cells.cells().is_empty() {
            outside.extend(of_cells.at(&self.blanks));
        }
        Intensities { of_cells, outside }
    }

    /// Moves the intensities back into the frame.
    pub fn put_intensities(&mut self, Intensities { of_cells, mut outside }: Intensities) {
        outside.resize(self.outside(), 0.0);
        let of_blanks = outside.split_off(self.strays.count);
        (self.intensity, self.strays.intensity) = (of_cells, outside);
        self.intensity.fill(&self.blanks, &of_blanks);
    }
}

/// The intensities of a range image, or of half of one, while they are coded.
#[derive(Default)]
pub struct Intensities {
    /// The intensities of the returns.
    of_cells: Grid<f32>,
    /// The intensities of the strays, then of the blanks.
    outside: Vec<f32>,
}

impl Intensities {
    /// The intensities of the returns, then of all other records.
    fn all(&self, part: &Part) -> Vec<f32> {
        let mut values = self.of_cells.at(part.cells);
        values.extend(&self.outside);
        values
    }

    /// The intensities of the rows above `row`, and those of the remaining rows.
    pub fn split(self, row: usize) -> [Self; 2] {
        let [upper, lower] = self.of_cells.split(row);
        [
            Intensities { of_cells: upper, outside: Vec::new() },
            Intensities { of_cells: lower, outside: self.outside },
        ]
    }

    /// The intensities of both halves together.
    pub fn joined([upper, lower]: [Self; 2]) -> Self {
        Intensities { of_cells: Grid::joined([upper.of_cells, lower.of_cells]), outside: lower.outside }
    }
}
