//! Letters of five by seven dots.

/// Dots from one letter to the next.
pub const ADVANCE: usize = 6;
/// Height of a line, in dots.
pub const HEIGHT: usize = GLYPH_HEIGHT + DESCENT;
/// Height of a glyph, in dots.
const GLYPH_HEIGHT: usize = 7;
/// Number of dots by which some glyphs are lower than the others.
const DESCENT: usize = 2;
/// Glyphs with a tail below the line.
const WITH_TAIL: &str = "gpqy,";
/// Width of a letter, in dots.
const WIDTH: usize = 5;

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
pub fn dots(text: &str) -> impl Iterator<Item = (usize, usize)> {
    text.chars().enumerate().flat_map(|(place, letter)| {
        let letter = letter.to_ascii_lowercase();
        let rows = glyph(letter);
        let top = if WITH_TAIL.contains(letter) { DESCENT } else { 0 };
        let cells = (0..GLYPH_HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| (column, row)));
        cells
            .filter(move |&(column, row)| rows[row] >> (WIDTH - 1 - column) & 1 == 1)
            .map(move |(column, row)| (place * ADVANCE + column, top + row))
    })
}

fn glyph(letter: char) -> [u8; GLYPH_HEIGHT] {
    GLYPHS.iter().find(|(known, _)| *known == letter).map_or([0; GLYPH_HEIGHT], |(_, rows)| *rows)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn glyphs_differ_and_stay_in_their_box() {
        let distinct: HashSet<_> = GLYPHS.iter().map(|(_, rows)| rows).collect();
        assert_eq!(distinct.len(), GLYPHS.len());
        assert!(GLYPHS.iter().all(|(_, rows)| rows.iter().all(|row| *row < 1 << WIDTH)));
    }

    #[test]
    fn texts_are_rows_of_glyphs() {
        assert_eq!(dots("-").collect::<Vec<_>>(), [(0, 3), (1, 3), (2, 3), (3, 3), (4, 3)]);
        assert_eq!(dots(" -").next(), Some((ADVANCE, 3)));
        assert_eq!(dots("A").collect::<Vec<_>>(), dots("a").collect::<Vec<_>>());
        assert_eq!(dots("p").map(|(_, row)| row).max(), Some(HEIGHT - 1), "tails are under the line");
        assert_eq!(dots("é\u{1F600}").count(), 0);
    }
}
