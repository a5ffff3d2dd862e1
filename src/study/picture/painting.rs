//! A picture in memory, operations to paint on it, letters of five by seven dots, and the colour bar under a
//! picture.

use std::io;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::colour::{BLACK, ColourMap, Rgb, Scale, WHITE};
use crate::ground::error::{Error, Result};

/// Size of a dot of a letter, in pixels.
const DOT: usize = 2;
/// Height of a text, in pixels.
pub const TEXT_HEIGHT: usize = LINE_HEIGHT * DOT;
/// Distance from one letter to the next, in pixels.
const LETTER_WIDTH: usize = GLYPH_ADVANCE * DOT;
/// Distance between elements, in pixels.
pub const GAP: usize = 6;

/// A picture of at least one pixel; row 0 is at the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<Rgb>,
}

impl Picture {
    /// A black picture, `width` x `height` pixels, at least one in each direction.
    pub fn new(width: usize, height: usize) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        Picture { width, height, pixels: vec![BLACK; width * height] }
    }

    /// Number of pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The pixel `x` to the right of and `y` below the upper left one; `None` if that is outside.
    #[cfg(test)]
    pub fn pixel(&self, x: usize, y: usize) -> Option<Rgb> {
        (x < self.width && y < self.height).then(|| self.pixels[y * self.width + x])
    }

    /// The picture as a PNG file.
    ///
    /// # Errors
    /// If a side is longer than PNG allows.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        let sides = (u32::try_from(self.width), u32::try_from(self.height));
        let (Ok(width), Ok(height)) = sides else {
            return Err(Error::Usage("the picture is too large for PNG".to_owned()));
        };
        let mut file = Vec::new();
        PngEncoder::new(&mut file)
            .write_image(self.pixels.as_flattened(), width, height, ExtendedColorType::Rgb8)
            .map_err(io::Error::other)?;
        Ok(file)
    }

    /// Paints a rectangle; the part outside the picture is left out.
    pub(super) fn fill(&mut self, [left, top]: [usize; 2], [width, height]: [usize; 2], colour: Rgb) {
        let (left, right) = (left.min(self.width), left.saturating_add(width).min(self.width));
        for y in top.min(self.height)..top.saturating_add(height).min(self.height) {
            self.pixels[y * self.width..][left..right].fill(colour);
        }
    }

    /// Writes a line of text with its upper left corner at (`left`, `top`).
    pub(super) fn write(&mut self, text: &str, [left, top]: [usize; 2], colour: Rgb) {
        for (column, row) in dots(text) {
            self.fill([left + column * DOT, top + row * DOT], [DOT, DOT], colour);
        }
    }

    /// Copies a picture with its upper left corner at row `top` of this one.
    fn paste(&mut self, other: &Picture, top: usize) {
        let width = other.width.min(self.width);
        for y in 0..other.height.min(self.height.saturating_sub(top)) {
            let from = &other.pixels[y * other.width..][..width];
            self.pixels[(top + y) * self.width..][..width].copy_from_slice(from);
        }
    }
}

/// Pictures one below the other, each under its title.
pub fn stack(titled: &[(&str, Picture)]) -> Picture {
    const TITLE: usize = GAP + TEXT_HEIGHT + GAP;
    let width = titled.iter().map(|(_, picture)| picture.width).max().unwrap_or(0);
    let height = titled.iter().map(|(_, picture)| TITLE + picture.height).sum();
    let mut all = Picture::new(width, height);
    let mut top = 0;
    for (title, picture) in titled {
        all.write(title, [GAP, top + GAP], WHITE);
        all.paste(picture, top + TITLE);
        top += TITLE + picture.height;
    }
    all
}

/// Dots from one letter to the next.
const GLYPH_ADVANCE: usize = 6;
/// Height of a line, in dots.
const LINE_HEIGHT: usize = GLYPH_HEIGHT + DESCENT;
/// Height of a glyph, in dots.
const GLYPH_HEIGHT: usize = 7;
/// Number of dots by which some glyphs are lower than the others.
const DESCENT: usize = 2;
/// Glyphs with a tail below the line.
const WITH_TAIL: &str = "gpqy,";
/// Width of a letter, in dots.
const GLYPH_WIDTH: usize = 5;

/// Rows from the top; the leftmost dot is the highest of five bits.
const GLYPHS: [(char, [u8; GLYPH_HEIGHT]); 42] = [
    ('0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    ('3', [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100]),
    ('a', [0b00000, 0b00000, 0b01110, 0b00001, 0b01111, 0b10001, 0b01111]),
    ('b', [0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b10001, 0b11110]),
    ('c', [0b00000, 0b00000, 0b01110, 0b10001, 0b10000, 0b10001, 0b01110]),
    ('d', [0b00001, 0b00001, 0b01111, 0b10001, 0b10001, 0b10001, 0b01111]),
    ('e', [0b00000, 0b00000, 0b01110, 0b10001, 0b11111, 0b10000, 0b01110]),
    ('f', [0b00110, 0b01000, 0b11110, 0b01000, 0b01000, 0b01000, 0b01000]),
    ('g', [0b01111, 0b10001, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    ('h', [0b10000, 0b10000, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001]),
    ('i', [0b00100, 0b00000, 0b01100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('j', [0b00010, 0b00000, 0b00110, 0b00010, 0b00010, 0b10010, 0b01100]),
    ('k', [0b10000, 0b10000, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010]),
    ('l', [0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('m', [0b00000, 0b00000, 0b11010, 0b10101, 0b10101, 0b10101, 0b10101]),
    ('n', [0b00000, 0b00000, 0b11110, 0b10001, 0b10001, 0b10001, 0b10001]),
    ('o', [0b00000, 0b00000, 0b01110, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('p', [0b11110, 0b10001, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000]),
    ('q', [0b01111, 0b10001, 0b10001, 0b10001, 0b01111, 0b00001, 0b00001]),
    ('r', [0b00000, 0b00000, 0b10110, 0b11001, 0b10000, 0b10000, 0b10000]),
    ('s', [0b00000, 0b00000, 0b01111, 0b10000, 0b01110, 0b00001, 0b11110]),
    ('t', [0b01000, 0b01000, 0b11110, 0b01000, 0b01000, 0b01001, 0b00110]),
    ('u', [0b00000, 0b00000, 0b10001, 0b10001, 0b10001, 0b10001, 0b01111]),
    ('v', [0b00000, 0b00000, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100]),
    ('w', [0b00000, 0b00000, 0b10001, 0b10101, 0b10101, 0b10101, 0b01010]),
    ('x', [0b00000, 0b00000, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001]),
    ('y', [0b10001, 0b10001, 0b10001, 0b10001, 0b01111, 0b00001, 0b01110]),
    ('z', [0b00000, 0b00000, 0b11111, 0b00010, 0b00100, 0b01000, 0b11111]),
    ('.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b01100]),
    (',', [0b00000, 0b00000, 0b00000, 0b01100, 0b01100, 0b00100, 0b01000]),
    ('-', [0b00000, 0b00000, 0b00000, 0b11111, 0b00000, 0b00000, 0b00000]),
    (':', [0b00000, 0b01100, 0b01100, 0b00000, 0b01100, 0b01100, 0b00000]),
    ('\'', [0b00100, 0b00100, 0b01000, 0b00000, 0b00000, 0b00000, 0b00000]),
    ('%', [0b11001, 0b11010, 0b00010, 0b00100, 0b01000, 0b01011, 0b10011]),
];

/// The dots of a text, as (column, row) from its upper left corner. Capitals look like small letters;
/// characters without a glyph leave a gap.
fn dots(text: &str) -> impl Iterator<Item = (usize, usize)> {
    text.chars().enumerate().flat_map(|(place, letter)| {
        let letter = letter.to_ascii_lowercase();
        let rows = glyph(letter);
        let top = if WITH_TAIL.contains(letter) { DESCENT } else { 0 };
        let cells = (0..GLYPH_HEIGHT).flat_map(|row| (0..GLYPH_WIDTH).map(move |column| (column, row)));
        cells
            .filter(move |&(column, row)| rows[row] >> (GLYPH_WIDTH - 1 - column) & 1 == 1)
            .map(move |(column, row)| (place * GLYPH_ADVANCE + column, top + row))
    })
}

fn glyph(letter: char) -> [u8; GLYPH_HEIGHT] {
    GLYPHS.iter().find(|(known, _)| *known == letter).map_or([0; GLYPH_HEIGHT], |(_, rows)| *rows)
}

/// Height of the bar, in pixels.
const BAR_HEIGHT: usize = 12;
/// Width of the bar, in pixels.
const BAR_WIDTH: usize = 640;
/// Pixels on each side of the bar, enough for half a number.
const BAR_MARGIN: usize = 40;
/// Length of a tick, in pixels.
const TICK_LENGTH: usize = 5;

/// The picture with a legend below it, for numbers in this unit.
pub fn with_legend(picture: &Picture, map: &ColourMap, scale: &Scale, unit: &str) -> Picture {
    let unit_width = (1 + unit.len()) * LETTER_WIDTH;
    let width = picture.width().max(BAR_MARGIN + BAR_WIDTH + BAR_MARGIN + unit_width);
    let bar_top = picture.height() + GAP;
    let mut whole = Picture::new(width, bar_top + BAR_HEIGHT + TICK_LENGTH + GAP + TEXT_HEIGHT + GAP);
    whole.paste(picture, 0);
    for x in 0..BAR_WIDTH {
        let colour = map.at(x as f64 / (BAR_WIDTH - 1) as f64);
        whole.fill([BAR_MARGIN + x, bar_top], [1, BAR_HEIGHT], colour);
    }
    draw_ticks(&mut whole, bar_top + BAR_HEIGHT, scale);
    whole.write(unit, [BAR_MARGIN + BAR_WIDTH + BAR_MARGIN, bar_top], WHITE);
    whole
}

/// Ticks and their numbers; a number that would touch the one before it is left out.
fn draw_ticks(picture: &mut Picture, top: usize, scale: &Scale) {
    let mut free_from = 0;
    for (metres, text) in scale.ticks() {
        let x = BAR_MARGIN + (scale.part(metres).clamp(0.0, 1.0) * (BAR_WIDTH - 1) as f64) as usize;
        picture.fill([x, top], [1, TICK_LENGTH], WHITE);
        let width = text.len() * LETTER_WIDTH;
        let left = x.saturating_sub(width / 2);
        if left >= free_from {
            picture.write(&text, [left, top + TICK_LENGTH + GAP / 2], WHITE);
            free_from = left + width;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::super::colour::BLACK;
    use super::*;

    #[test]
    fn png_gives_the_pixels_back() {
        let mut picture = Picture::new(5, 3);
        picture.fill([1, 1], [2, 9], [1, 2, 3]);
        picture.fill([4, 0], [usize::MAX, 1], WHITE);
        let decoded = image::load_from_memory(&picture.to_png().unwrap()).unwrap().into_rgb8();
        assert_eq!(decoded.dimensions(), (5, 3));
        for (x, y, pixel) in decoded.enumerate_pixels() {
            assert_eq!(Some(pixel.0), picture.pixel(x as usize, y as usize));
        }
        assert_eq!(picture.pixel(2, 2), Some([1, 2, 3]));
        assert_eq!((picture.pixel(3, 1), picture.pixel(5, 0)), (Some(BLACK), None));
    }

    #[test]
    fn a_picture_without_pixels_has_one() {
        assert!(Picture::new(0, 0).to_png().is_ok());
        assert!(stack(&[]).to_png().is_ok());
    }

    #[test]
    fn stacked_pictures_keep_their_pixels() {
        let (mut upper, mut lower) = (Picture::new(50, 10), Picture::new(80, 20));
        upper.fill([0, 0], [50, 10], [9, 0, 0]);
        lower.fill([0, 0], [80, 20], [0, 9, 0]);
        let all = stack(&[("one", upper), ("two", lower)]);
        let title = all.height() - 30;
        assert_eq!((all.width(), title % 2), (80, 0));
        assert_eq!(all.pixel(49, title / 2), Some([9, 0, 0]));
        assert_eq!(all.pixel(50, title / 2), Some(BLACK));
        assert_eq!(all.pixel(79, all.height() - 1), Some([0, 9, 0]));
        assert!(
            (0..title / 2).any(|y| all.pixel(GAP, y) == Some(WHITE) || all.pixel(GAP + 2, y) == Some(WHITE))
        );
    }

    #[test]
    fn glyphs_differ_and_stay_in_their_box() {
        let distinct: HashSet<_> = GLYPHS.iter().map(|(_, rows)| rows).collect();
        assert_eq!(distinct.len(), GLYPHS.len());
        assert!(GLYPHS.iter().all(|(_, rows)| rows.iter().all(|row| *row < 1 << GLYPH_WIDTH)));
    }

    #[test]
    fn texts_are_rows_of_glyphs() {
        assert_eq!(dots("-").collect::<Vec<_>>(), [(0, 3), (1, 3), (2, 3), (3, 3), (4, 3)]);
        assert_eq!(dots(" -").next(), Some((GLYPH_ADVANCE, 3)));
        assert_eq!(dots("A").collect::<Vec<_>>(), dots("a").collect::<Vec<_>>());
        assert_eq!(dots("p").map(|(_, row)| row).max(), Some(LINE_HEIGHT - 1), "tails are under the line");
        assert_eq!(dots("é\u{1F600}").count(), 0);
    }

    #[test]
    fn the_bar_goes_from_end_to_end_under_the_picture() {
        let mut picture = Picture::new(3, 50);
        picture.fill([0, 0], [3, 50], [1, 2, 3]);
        let map = ColourMap::sequential();
        let whole = with_legend(&picture, &map, &Scale::of_errors([0.02, 0.5].into_iter()), "m");
        assert_eq!((whole.pixel(2, 49), whole.pixel(3, 49)), (Some([1, 2, 3]), Some(BLACK)));
        let bar = |x| whole.pixel(x, 50 + GAP);
        assert_eq!((bar(BAR_MARGIN - 1), bar(BAR_MARGIN)), (Some(BLACK), Some(map.at(0.0))));
        assert_eq!(bar(BAR_MARGIN + BAR_WIDTH - 1), Some(map.at(1.0)));
        assert_eq!(whole.pixel(BAR_MARGIN, 50 + GAP + BAR_HEIGHT), Some(WHITE), "the tick of 0");
    }

    #[test]
    fn numbers_that_would_touch_are_left_out() {
        let wide = Scale::of_ranges([1e-1, 1e7].into_iter());
        let whole = with_legend(&Picture::new(1, 1), &ColourMap::sequential(), &wide, "m");
        let text_top = 1 + GAP + BAR_HEIGHT + TICK_LENGTH + GAP / 2;
        let written = (0..whole.width())
            .map(|x| (text_top..text_top + TEXT_HEIGHT).any(|y| whole.pixel(x, y) == Some(WHITE)));
        let columns: Vec<bool> = written.collect();
        // A letter is at most five dots of two pixels.
        let widest = columns.split(|written| !written).map(<[bool]>::len).max();
        assert!(widest.is_some_and(|widest| (2..=10).contains(&widest)), "{widest:?}");
    }
}
