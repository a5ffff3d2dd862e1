//! A straightforward implementation of the format's specification, compared with the library, which must
//! return the same samples with and without its vector instructions.

use super::header::{AC_LENGTHS, AC_VALUES, DC_LENGTHS, DC_VALUES, quantisation, zigzag};
use super::*;
use crate::ground::random::Rng;

/// The bits of a scan.
struct Bits<'s>(std::slice::Iter<'s, u8>, u8, u32);

impl Bits<'_> {
    fn bit(&mut self) -> i32 {
        if self.2 == 0 {
            (self.1, self.2) = (*self.0.next().unwrap(), 8);
            assert!(self.1 != 255 || *self.0.next().unwrap() == 0, "a marker");
        }
        self.2 -= 1;
        i32::from(self.1 >> self.2 & 1)
    }

    /// A number of this many bits; its first bit is 0 if it is negative.
    fn number(&mut self, size: u8) -> i32 {
        let value = (0..size).fold(0, |value, _| value << 1 | self.bit());
        if size > 0 && value >> (size - 1) == 0 { value - (1 << size) + 1 } else { value }
    }

    fn symbol(&mut self, lengths: &[u8; 16], values: &[u8]) -> u8 {
        let (mut code, mut first, mut before) = (0, 0, 0);
        for &count in lengths {
            code = code << 1 | self.bit();
            if code < first + i32::from(count) {
                return values[before + (code - first) as usize];
            }
            (first, before) = ((first + i32::from(count)) << 1, before + usize::from(count));
        }
        panic!("no such code")
    }
}

fn inverse(c: [i32; 8], bias: i32, shift: u32) -> [i32; 8] {
    let e = (c[2] + c[6]) * 2217;
    let (e2, e3) = (e - c[6] * 7567, e + c[2] * 3135);
    let (d0, d1) = ((c[0] + c[4]) << 12, (c[0] - c[4]) << 12);
    let x = [d0 + e3 + bias, d1 + e2 + bias, d1 - e2 + bias, d0 - e3 + bias];
    let o = (c[7] + c[3] + c[5] + c[1]) * 4816;
    let (a, b) = (o - (c[7] + c[1]) * 3685, o - (c[5] + c[3]) * 10497);
    let (f, g) = ((c[7] + c[3]) * 8034, (c[5] + c[1]) * 1597);
    let o = [c[1] * 6149 + a - g, c[3] * 12586 + b - f, c[5] * 8410 + b - g, c[7] * 1223 + a - f];
    std::array::from_fn(|i| if i < 4 { x[i] + o[i] } else { x[7 - i] - o[7 - i] } >> shift)
}

/// The samples of an image, as FORMAT.md describes it.
fn plainly(image: &[u8], rows: usize, columns: usize) -> Grid<i32> {
    let (quality, scan) = image.split_first().unwrap();
    let (table, zigzag) = (quantisation(*quality), zigzag());
    let mut bits = Bits(scan.iter(), 0, 0);
    let mut samples = Grid::new(rows, columns);
    let mut last = 0;
    for top in (0..rows).step_by(8) {
        for left in (0..columns).step_by(8) {
            let mut block = [0; 64];
            let size = bits.symbol(&DC_LENGTHS, &DC_VALUES);
            last += bits.number(size);
            block[0] = last * i32::from(table[0]);
            let mut place = 1;
            while place < 64 {
                let symbol = bits.symbol(&AC_LENGTHS, &AC_VALUES);
                match symbol {
                    0 => break,
                    0xf0 => place += 16,
                    _ => {
                        place += usize::from(symbol >> 4);
                        block[zigzag[place]] = bits.number(symbol & 15) * i32::from(table[place]);
                        place += 1;
                    }
                }
            }
            for column in 0..8 {
                let values = inverse(std::array::from_fn(|row| block[row * 8 + column]), 512, 10);
                (0..8).for_each(|row| block[row * 8 + column] = values[row]);
            }
            for row in 0..8.min(rows - top) {
                let values =
                    inverse(std::array::from_fn(|column| block[row * 8 + column]), 66048 + (128 << 17), 17);
                for column in 0..8.min(columns - left) {
                    samples[(top + row, left + column)] = values[column].clamp(0, 255) - CENTRE;
                }
            }
        }
    }
    samples
}

#[test]
fn the_library_does_what_the_format_says() {
    let mut random = Rng::keyed(5, &[]);
    for (rows, columns) in [(8, 8), (21, 90), (64, 33)] {
        for kind in 0..4 {
            let mut samples: Grid<u8> = Grid::new(rows, columns);
            for row in 0..rows {
                for (column, sample) in samples.row_mut(row).iter_mut().enumerate() {
                    *sample = match kind {
                        0 => 128,
                        1 => (row * 3 + column * 2 % 180) as u8,
                        2 => random.below(256) as u8,
                        // The largest possible coefficients.
                        _ => 255 * u8::from(random.chance(0.5)),
                    };
                }
            }
            for quality in [1, 5, 25, 50, 75, 90, 100] {
                let image = encode_samples(&samples, quality).unwrap();
                let decoded = decode(&image, rows, columns).unwrap();
                assert!(decoded == plainly(&image, rows, columns), "{rows} x {columns}, {kind}, {quality}");
            }
        }
    }
}
