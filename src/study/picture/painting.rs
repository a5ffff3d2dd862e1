//! A picture in memory, and operations to paint on it.

use std::io;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::colour::{BLACK, Rgb, WHITE};
use super::font;
use crate::ground::error::{Error, Result};

/// Size of a dot of a letter, in pixels.
const DOT: usize = 2;
/// Height of a text, in pixels.
pub const TEXT_HEIGHT: usize = font::HEIGHT * DOT;
/// Distance from one letter to the next, in pixels.
pub const LETTER_WIDTH: usize = font::ADVANCE * DOT;
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
        for (column, row) in font::dots(text) {
            self.fill([left + column * DOT, top + row * DOT], [DOT, DOT], colour);
        }
    }

    /// Copies a picture with its upper left corner at row `top` of this one.
    pub(super) fn paste(&mut self, other: &Picture, top: usize) {
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

#[cfg(test)]
mod tests {
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
}
