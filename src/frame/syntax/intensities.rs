//! The intensities of the returns, then of the strays and blanks.

use std::mem::take;

use byteorder::{ByteOrder, LittleEndian};

use crate::backend::Level;
use crate::entropy::{BitCoder, TokenCoder, TokenTables};
use crate::frame::fidelity::Intensity;
use crate::frame::frame::Frame;
use crate::frame::modelling::IntensityModelling;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::ground::grid::Grid;
use crate::ground::growing::RowWriter;
use crate::inter::Reference;
use crate::models::{
    Beside, ChannelsModel, INTENSITY_CONTEXTS, IntensityModel, IntensityNeighbours, IntensityReference,
    IntensityScale, IntensityTokens, PACKED_INTENSITY_CONTEXTS, code_packed_intensities, neighbours_above,
};
use crate::scan::{Channel, Field, Scalar};
use crate::stream::container::SectionKind;

/// What a group's intensities have taught so far.
#[derive(Clone, Default)]
pub struct IntensityModels {
    // Made when it is first wanted: it is large.
    adaptive: Option<IntensityModel>,
    tokens: TokenTables,
    packed: TokenTables,
    /// Of those on no grid.
    rough: ChannelsModel,
}

impl IntensityModels {
    /// Codes the intensities, if the frame has any and keeps them. Returns those of the returns as contexts for the
    /// ranges, whose rows are also given out as they come.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        reference: Option<&Reference>,
        frame: &Frame,
        values: &mut Intensities,
        rows: RowWriter<'_, u16>,
    ) -> Result<Grid<u16>> {
        let coded = frame.layout.intensity.is_some() && frame.parameters.intensity != Intensity::None;
        if !coded {
            let (rows, columns) = (frame.occupancy.rows(), frame.occupancy.columns());
            values.of_cells = Grid::new(rows, columns);
            values.outside = vec![0.0; frame.strays];
            return Ok(Grid::new(rows, columns));
        }
        if S::ENCODES {
            // The blanks follow the strays.
            let of_blanks = values.of_cells.at(&frame.blanks);
            values.outside.extend(of_blanks);
        }
        let levels = self.code_values(sections, reference, frame, values, rows)?;
        values.outside.resize(frame.outside(), 0.0);
        let of_blanks = values.outside.split_off(frame.strays);
        values.of_cells.fill(&frame.blanks, &of_blanks);
        Ok(levels)
    }

    /// The same, where the intensities of the blanks stand with those of the strays.
    fn code_values<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        reference: Option<&Reference>,
        frame: &Frame,
        values: &mut Intensities,
        mut rows: RowWriter<'_, u16>,
    ) -> Result<Grid<u16>> {
        let all = if S::ENCODES { values.all(frame) } else { Vec::new() };
        let mut scale = match S::ENCODES {
            true => IntensityScale::of(&all, frame.parameters.intensity.levels_per_unit()),
            false => IntensityScale::default(),
        };
        let is_deep = match frame.parameters.modelling().parts().intensity {
            IntensityModelling::Light => false,
            IntensityModelling::Deep => true,
            IntensityModelling::Tokens => {
                let mut levels = Grid::new(frame.occupancy.rows(), frame.occupancy.columns());
                let code = |coder: &mut S::Tokens<'_>| {
                    code_tokens(coder, scale, frame, values, &mut levels, &mut rows)
                };
                return sections
                    .tokens(SectionKind::Intensity, INTENSITY_CONTEXTS, &mut self.tokens, code)
                    .map(|()| levels);
            }
            // Packed ranges have no contexts.
            IntensityModelling::Packed => {
                let code = |coder: &mut S::Tokens<'_>| pack(coder, scale, frame, (all, values));
                return sections
                    .tokens(SectionKind::Intensity, PACKED_INTENSITY_CONTEXTS, &mut self.packed, code)
                    .map(|()| Grid::default());
            }
        };
        let level = sections.effort().level;
        sections.section(SectionKind::Intensity, true, |coder| {
            scale.code(|value, bits| coder.code_plain(u64::from(value), bits) as u32);
            if !scale.is_on_grid() {
                let levels = self.code_rough(coder, frame, values, level)?;
                (0..levels.rows()).for_each(|row| rows.push(levels.row(row)));
                return Ok(levels);
            }
            let model = self.adaptive.get_or_insert_default();
            model.set_deep(is_deep);
            Ok(code_adaptive(model, coder, frame, values, (scale, reference), &mut rows))
        })
    }

    /// Intensities on a grid that the models of intensities do not know, coded as a channel of the returns
    /// and strays. Returns no contexts for the ranges.
    fn code_rough<C: BitCoder>(
        &mut self,
        coder: &mut C,
        frame: &Frame,
        known: &mut Intensities,
        level: Level,
    ) -> Result<Grid<u16>> {
        let returns = frame.cells.len();
        let width = frame.occupancy.columns() as u32;
        let strays = || std::iter::repeat_n(0, frame.outside());
        let beside = Beside {
            rows: frame.cells.iter().map(|cell| cell / width + 1).chain(strays()).collect(),
            columns: frame.cells.iter().map(|cell| cell % width + 1).chain(strays()).collect(),
            ..Beside::default()
        };
        let mut values = if C::ENCODES { known.of_cells.at(&frame.cells) } else { vec![0.0; returns] };
        values.append(&mut known.outside);
        values.resize(frame.records, 0.0);
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let mut channels = [Channel { field: Field::new("intensity", Scalar::F32), bytes }];
        self.rough.code(coder, &mut channels, &beside, level)?;
        let [Channel { bytes, .. }] = channels;
        let mut values: Vec<f32> = bytes.chunks_exact(4).map(LittleEndian::read_f32).collect();
        known.outside = values.split_off(returns);
        known.of_cells.fill(&frame.cells, &values);
        let mut levels = Grid::new(frame.occupancy.rows(), frame.occupancy.columns());
        levels.cells_mut().fill(1);
        Ok(levels)
    }
}

/// The intensities of the returns, then of the strays. Returns those of the returns as contexts for the
/// ranges.
fn code_adaptive<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    frame: &Frame,
    values: &mut Intensities,
    (scale, reference): (IntensityScale, Option<&Reference>),
    rows: &mut RowWriter<'_, u16>,
) -> Grid<u16> {
    let width = frame.occupancy.columns();
    let mut levels = Grid::new(frame.occupancy.rows(), width);
    model.start_frame(&scale, width, frame.cells.len());
    for row in 0..levels.rows() {
        if coder.is_exhausted() {
            break;
        }
        model.start_row();
        let mut left = [0; 4];
        for column in (0..width).filter(|&column| frame.occupancy[(row, column)]) {
            let mut near = neighbours(&levels, left, row, column);
            near.back = reference.and_then(|reference| IntensityReference::at(reference, (row, column)));
            let value = &mut values.of_cells[(row, column)];
            *value = model.code(coder, &scale, &near, (row, column), *value);
            levels[(row, column)] = scale.context_level(*value);
            left = [levels[(row, column)], left[0], left[1], left[2]];
        }
        rows.push(levels.row(row));
    }
    code_strays(model, coder, &scale, frame, values);
    levels
}

fn code_strays<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    scale: &IntensityScale,
    frame: &Frame,
    values: &mut Intensities,
) {
    values.outside.resize(frame.outside(), 0.0);
    let north = neighbours_above(&frame.stray_positions);
    let mut levels: Vec<u16> = Vec::with_capacity(frame.outside());
    model.start_frame(scale, 1, frame.outside());
    for index in 0..frame.outside() {
        if coder.is_exhausted() {
            return;
        }
        let at = |index: Option<usize>| index.and_then(|i| levels.get(i)).copied().unwrap_or(0);
        let above = |offset: isize| {
            at(north.get(index).copied().flatten().and_then(|i| i.checked_add_signed(offset)))
        };
        let near = IntensityNeighbours {
            left: [1, 2, 3, 4].map(|distance| at(index.checked_sub(distance))),
            above: [-2, -1, 0, 1, 2].map(above),
            above2: [0; 3],
            back: None,
        };
        let value = &mut values.outside[index];
        *value = model.code(coder, scale, &near, (0, 0), *value);
        levels.push(scale.context_level(*value));
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

/// The intensities of the returns, whose context levels are written into `levels`, then of the strays.
fn code_tokens<C: TokenCoder>(
    coder: &mut C,
    mut scale: IntensityScale,
    frame: &Frame,
    values: &mut Intensities,
    levels: &mut Grid<u16>,
    out: &mut RowWriter<'_, u16>,
) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let mut model = IntensityTokens::default();
    let (rows, width) = (frame.occupancy.rows(), frame.occupancy.columns());
    // The last intensity level in each column.
    let mut above = vec![0; width];
    for row in 0..rows {
        if coder.is_exhausted() {
            return;
        }
        let mut west = 0;
        let cells = frame.occupancy.row(row).iter().zip(values.of_cells.row_mut(row)).zip(&mut above);
        for (((_, value), north), level) in
            cells.zip(levels.row_mut(row)).filter(|(((filled, _), _), _)| **filled)
        {
            west = model.code(coder, &scale, (west, *north), value);
            (*north, *level) = (west, west);
        }
        out.push(levels.row(row));
    }
    values.outside.resize(frame.outside(), 0.0);
    let mut west = 0;
    for value in &mut values.outside {
        if coder.is_exhausted() {
            return;
        }
        west = model.code(coder, &scale, (west, 0), value);
    }
}

/// The encoder knows the values of all returns and strays.
fn pack<C: TokenCoder>(
    coder: &mut C,
    mut scale: IntensityScale,
    frame: &Frame,
    (mut values, known): (Vec<f32>, &mut Intensities),
) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let returns = frame.cells.len();
    values.resize(frame.records, 0.0);
    code_packed_intensities(coder, &scale, &mut values);
    known.outside = values.split_off(returns);
    known.of_cells.fill(&frame.cells, &values);
}

impl Frame {
    /// Number of records that are no returns.
    fn outside(&self) -> usize {
        self.strays + self.blanks.len()
    }

    /// Takes the intensities out of the frame.
    pub fn take_intensities(&mut self) -> Intensities {
        Intensities { of_cells: take(&mut self.intensity), outside: take(&mut self.stray_intensity) }
    }

    /// Puts them back.
    pub fn put_intensities(&mut self, Intensities { of_cells, outside }: Intensities) {
        (self.intensity, self.stray_intensity) = (of_cells, outside);
    }
}

/// The intensities of a frame while they are coded.
pub struct Intensities {
    /// Of the returns, and of the blanks.
    of_cells: Grid<f32>,
    /// Of the strays, and while they are coded of the blanks.
    outside: Vec<f32>,
}

impl Intensities {
    /// Those of the returns, then of the strays.
    fn all(&self, frame: &Frame) -> Vec<f32> {
        let mut values = Vec::with_capacity(frame.cells.len() + self.outside.len());
        values.extend(frame.cells.iter().map(|&cell| self.of_cells.cells()[cell as usize]));
        values.extend(&self.outside);
        values
    }
}
