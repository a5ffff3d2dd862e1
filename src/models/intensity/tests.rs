use super::*;
use crate::entropy::{ArithmeticDecoder, ArithmeticEncoder};
use crate::ground::grid::Grid;
use crate::ground::random::Rng;
use crate::inter::Reference;

const ROWS: usize = 8;
const COLUMNS: usize = 160;

/// Bands of brightness, as measured by beams that use only every third level each, with some zeros.
fn frame(seed: u64, per_unit: u32, brightest: f64) -> Grid<f32> {
    let mut random = Rng::keyed(seed, &[]);
    let mut values = Grid::new(ROWS, COLUMNS);
    for row in 0..ROWS {
        for column in 0..COLUMNS {
            let band = if column / 40 % 2 == 0 { 0.3 } else { 0.8 };
            let level = (brightest * (band + 0.05 * random.normal()).clamp(0.0, 1.0)) as usize;
            let level = if random.chance(0.1) { 0 } else { level / 3 * 3 + row % 3 };
            values[(row, column)] = (level as f64 / f64::from(per_unit)) as f32;
        }
    }
    values
}

/// Codes frames, each with the one before as its reference.
fn code<C: BitCoder>(coder: &mut C, is_deep: bool, scale: &IntensityScale, frames: &mut [Grid<f32>]) {
    let mut model = IntensityModel::default();
    let mut reference: Option<Reference> = None;
    for values in frames {
        model.use_deep(is_deep);
        model.start_frame(scale, (ROWS, COLUMNS), values.cells().len());
        let mut levels: Grid<u16> = Grid::new(ROWS, COLUMNS);
        for row in 0..ROWS {
            model.start_row();
            for column in 0..COLUMNS {
                let cell = (row, column);
                let near = IntensityNeighbours {
                    left: [-1, -2, -3, -4].map(|right| levels.beside(cell, 0, right)),
                    above: [-2, -1, 0, 1, 2].map(|right| levels.beside(cell, -1, right)),
                    above2: [-1, 0, 1].map(|right| levels.beside(cell, -2, right)),
                    back: reference.as_ref().and_then(|reference| IntensityReference::at(reference, cell)),
                };
                values[cell] = model.code(coder, scale, &near, cell, values[cell]);
                levels[cell] = scale.context_level(values[cell]);
            }
        }
        let mut next = Reference::new(ROWS, COLUMNS);
        // Moved surfaces may be visible where the same cell has no return.
        next.moved.levels = levels.clone();
        (0..COLUMNS / 2).for_each(|column| levels[(0, column)] = 0);
        next.same.levels = levels;
        reference = Some(next);
    }
}

/// The number of bytes of the coded frames; checks that they are decoded correctly.
fn bytes_of(is_deep: bool, per_unit: u32, frames: &[Grid<f32>]) -> usize {
    let all: Vec<f32> = frames.iter().flat_map(|frame| frame.cells().to_vec()).collect();
    let scale = IntensityScale::of(&all, Some(per_unit));
    let mut encoder = ArithmeticEncoder::default();
    code(&mut encoder, is_deep, &scale, &mut frames.to_vec());
    let bytes = encoder.finish();
    let mut decoded = vec![Grid::new(ROWS, COLUMNS); frames.len()];
    code(&mut ArithmeticDecoder::new(&bytes), is_deep, &scale, &mut decoded);
    assert_eq!(decoded, frames, "deep: {is_deep}, {per_unit} levels a unit");
    bytes.len()
}

#[test]
fn levels_of_seven_to_nine_bits_come_back_light_and_deep() {
    for is_deep in [false, true] {
        for (per_unit, brightest) in [(100, 100.0), (256, 250.0), (1, 500.0)] {
            let mut frames = vec![frame(1, per_unit, brightest), frame(2, per_unit, brightest)];
            frames[0][(3, 7)] = 0.1234;
            frames[1][(0, 0)] = -0.0;
            bytes_of(is_deep, per_unit, &frames);
        }
    }
}

#[test]
fn going_deeper_pays_where_beams_differ() {
    let frames: Vec<Grid<f32>> = (0..4).map(|seed| frame(seed, 100, 100.0)).collect();
    let [light, deep] = [false, true].map(|is_deep| bytes_of(is_deep, 100, &frames));
    assert!(deep * 100 < light * 97, "{light}, {deep} bytes");
}

#[test]
fn any_bytes_decode_to_something() {
    let scale = IntensityScale::of(&[0.0, 0.5, 0.99], Some(100));
    for seed in 0..20 {
        let mut random = Rng::keyed(seed, &[1]);
        let bytes: Vec<u8> = (0..200).map(|_| random.below(256) as u8).collect();
        let mut values = vec![Grid::new(ROWS, COLUMNS); 2];
        for is_deep in [false, true] {
            code(&mut ArithmeticDecoder::new(&bytes), is_deep, &scale, &mut values);
            assert!(values.iter().flat_map(Grid::cells).all(|value| scale.level_of(*value).is_some()));
        }
    }
}
