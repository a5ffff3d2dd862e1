//! The intensities of the returns, then of the strays and blanks.

use byteorder::{ByteOrder, LittleEndian};

use crate::backend::Level;
use crate::entropy::{BitCoder, TokenCoder, TokenTables};
use crate::frame::fidelity::Intensity;
use crate::frame::frame::Frame;
use crate::frame::modelling::IntensityModelling;
use crate::frame::sections::SectionCoder;
use crate::ground::error::Result;
use crate::ground::grid::Grid;
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
    /// ranges.
    ///
    /// # Errors
    /// If the section is damaged.
    pub fn code<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        reference: Option<&Reference>,
        frame: &mut Frame,
    ) -> Result<Grid<u16>> {
        let coded = frame.layout.intensity.is_some() && frame.parameters.intensity != Intensity::None;
        if !coded {
            let (rows, columns) = (frame.occupancy.rows(), frame.occupancy.columns());
            frame.intensity = Grid::new(rows, columns);
            frame.stray_intensity = vec![0.0; frame.strays];
            return Ok(Grid::new(rows, columns));
        }
        if S::ENCODES {
            // The blanks follow the strays.
            let of_blanks = frame.intensity.at(&frame.blanks);
            frame.stray_intensity.extend(of_blanks);
        }
        let levels = self.code_values(sections, reference, frame)?;
        frame.stray_intensity.resize(frame.outside(), 0.0);
        let of_blanks = frame.stray_intensity.split_off(frame.strays);
        frame.intensity.fill(&frame.blanks, &of_blanks);
        Ok(levels)
    }

    /// The same, where the intensities of the blanks stand with those of the strays.
    fn code_values<S: SectionCoder>(
        &mut self,
        sections: &mut S,
        reference: Option<&Reference>,
        frame: &mut Frame,
    ) -> Result<Grid<u16>> {
        let mut scale = if S::ENCODES { frame.intensity_scale() } else { IntensityScale::default() };
        let is_deep = match frame.parameters.modelling().parts().intensity {
            IntensityModelling::Light => false,
            IntensityModelling::Deep => true,
            IntensityModelling::Tokens => {
                let mut levels = Grid::new(frame.occupancy.rows(), frame.occupancy.columns());
                let code = |coder: &mut S::Tokens<'_>| code_tokens(coder, scale, frame, &mut levels);
                return sections
                    .tokens(SectionKind::Intensity, INTENSITY_CONTEXTS, &mut self.tokens, code)
                    .map(|()| levels);
            }
            // Packed ranges have no contexts.
            IntensityModelling::Packed => {
                let code = |coder: &mut S::Tokens<'_>| pack(coder, scale, frame);
                return sections
                    .tokens(SectionKind::Intensity, PACKED_INTENSITY_CONTEXTS, &mut self.packed, code)
                    .map(|()| Grid::default());
            }
        };
        let level = sections.effort().level;
        sections.section(SectionKind::Intensity, true, |coder| {
            scale.code(|value, bits| coder.code_plain(u64::from(value), bits) as u32);
            if !scale.is_on_grid() {
                return self.code_rough(coder, frame, level);
            }
            let model = self.adaptive.get_or_insert_default();
            model.set_deep(is_deep);
            Ok(code_adaptive(model, coder, frame, scale, reference))
        })
    }

    /// Intensities on a grid that the models of intensities do not know, coded as a channel of the returns
    /// and strays. Returns no contexts for the ranges.
    fn code_rough<C: BitCoder>(
        &mut self,
        coder: &mut C,
        frame: &mut Frame,
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
        let mut values = if C::ENCODES { frame.intensity.at(&frame.cells) } else { vec![0.0; returns] };
        values.append(&mut frame.stray_intensity);
        values.resize(frame.records, 0.0);
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let mut channels = [Channel { field: Field::new("intensity", Scalar::F32), bytes }];
        self.rough.code(coder, &mut channels, &beside, level)?;
        let [Channel { bytes, .. }] = channels;
        let mut values: Vec<f32> = bytes.chunks_exact(4).map(LittleEndian::read_f32).collect();
        frame.stray_intensity = values.split_off(returns);
        frame.intensity.fill(&frame.cells, &values);
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
    frame: &mut Frame,
    scale: IntensityScale,
    reference: Option<&Reference>,
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
            let value = &mut frame.intensity[(row, column)];
            *value = model.code(coder, &scale, &near, (row, column), *value);
            levels[(row, column)] = scale.context_level(*value);
            left = [levels[(row, column)], left[0], left[1], left[2]];
        }
    }
    code_strays(model, coder, &scale, frame);
    levels
}

fn code_strays<C: BitCoder>(
    model: &mut IntensityModel,
    coder: &mut C,
    scale: &IntensityScale,
    frame: &mut Frame,
) {
    frame.stray_intensity.resize(frame.outside(), 0.0);
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
        let value = &mut frame.stray_intensity[index];
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
    frame: &mut Frame,
    levels: &mut Grid<u16>,
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
        let cells = frame.occupancy.row(row).iter().zip(frame.intensity.row_mut(row)).zip(&mut above);
        for (((_, value), north), level) in
            cells.zip(levels.row_mut(row)).filter(|(((filled, _), _), _)| **filled)
        {
            west = model.code(coder, &scale, (west, *north), value);
            (*north, *level) = (west, west);
        }
    }
    frame.stray_intensity.resize(frame.outside(), 0.0);
    let mut west = 0;
    for value in &mut frame.stray_intensity {
        if coder.is_exhausted() {
            return;
        }
        west = model.code(coder, &scale, (west, 0), value);
    }
}

fn pack<C: TokenCoder>(coder: &mut C, mut scale: IntensityScale, frame: &mut Frame) {
    scale.code(|value, count| coder.bits(value.into(), count) as u32);
    let returns = frame.cells.len();
    let mut values = if C::ENCODES { frame.intensity.at(&frame.cells) } else { vec![0.0; returns] };
    values.append(&mut frame.stray_intensity);
    values.resize(frame.records, 0.0);
    code_packed_intensities(coder, &scale, &mut values);
    frame.stray_intensity = values.split_off(returns);
    frame.intensity.fill(&frame.cells, &values);
}

impl Frame {
    /// Number of records that are no returns.
    fn outside(&self) -> usize {
        self.strays + self.blanks.len()
    }

    /// The grid on which the intensities of the returns and strays lie.
    pub(crate) fn intensity_scale(&self) -> IntensityScale {
        let mut values = self.intensity.at(&self.cells);
        values.extend(&self.stray_intensity);
        IntensityScale::of(&values, self.parameters.intensity.levels_per_unit())
    }
}
