//! The colour bar under a picture.

use super::colour::{ColourMap, WHITE};
use super::painting::{GAP, LETTER_WIDTH, Picture, TEXT_HEIGHT};
use super::scale::Scale;

/// Height of the bar, in pixels.
const BAR_HEIGHT: usize = 12;
/// Width of the bar, in pixels.
const BAR_WIDTH: usize = 640;
/// Pixels on each side of the bar, enough for half a number.
const MARGIN: usize = 40;
/// Length of a tick, in pixels.
const TICK: usize = 5;

/// The picture with a legend below it, for numbers in this unit.
pub fn with_legend(picture: &Picture, map: &ColourMap, scale: &Scale, unit: &str) -> Picture {
    let unit_width = (1 + unit.len()) * LETTER_WIDTH;
    let width = picture.width().max(MARGIN + BAR_WIDTH + MARGIN + unit_width);
    let bar_top = picture.height() + GAP;
    let mut whole = Picture::new(width, bar_top + BAR_HEIGHT + TICK + GAP + TEXT_HEIGHT + GAP);
    whole.paste(picture, 0);
    for x in 0..BAR_WIDTH {
        let colour = map.at(x as f64 / (BAR_WIDTH - 1) as f64);
        whole.fill([MARGIN + x, bar_top], [1, BAR_HEIGHT], colour);
    }
    draw_ticks(&mut whole, bar_top + BAR_HEIGHT, scale);
    whole.write(unit, [MARGIN + BAR_WIDTH + MARGIN, bar_top], WHITE);
    whole
}

/// Ticks and their numbers; a number that would touch the one before it is left out.
fn draw_ticks(picture: &mut Picture, top: usize, scale: &Scale) {
    let mut free_from = 0;
    for (metres, text) in scale.ticks() {
        let x = MARGIN + (scale.part(metres).clamp(0.0, 1.0) * (BAR_WIDTH - 1) as f64) as usize;
        picture.fill([x, top], [1, TICK], WHITE);
        let width = text.len() * LETTER_WIDTH;
        let left = x.saturating_sub(width / 2);
        if left >= free_from {
            picture.write(&text, [left, top + TICK + GAP / 2], WHITE);
            free_from = left + width;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::colour::BLACK;
    use super::*;

    #[test]
    fn the_bar_goes_from_end_to_end_under_the_picture() {
        let mut picture = Picture::new(3, 50);
        picture.fill([0, 0], [3, 50], [1, 2, 3]);
        let map = ColourMap::sequential();
        let whole = with_legend(&picture, &map, &Scale::of_errors([0.02, 0.5].into_iter()), "m");
        assert_eq!((whole.pixel(2, 49), whole.pixel(3, 49)), (Some([1, 2, 3]), Some(BLACK)));
        let bar = |x| whole.pixel(x, 50 + GAP);
        assert_eq!((bar(MARGIN - 1), bar(MARGIN)), (Some(BLACK), Some(map.at(0.0))));
        assert_eq!(bar(MARGIN + BAR_WIDTH - 1), Some(map.at(1.0)));
        assert_eq!(whole.pixel(MARGIN, 50 + GAP + BAR_HEIGHT), Some(WHITE), "the tick of 0");
    }

    #[test]
    fn numbers_that_would_touch_are_left_out() {
        let wide = Scale::of_ranges([1e-1, 1e7].into_iter());
        let whole = with_legend(&Picture::new(1, 1), &ColourMap::sequential(), &wide, "m");
        let text_top = 1 + GAP + BAR_HEIGHT + TICK + GAP / 2;
        let written = (0..whole.width())
            .map(|x| (text_top..text_top + TEXT_HEIGHT).any(|y| whole.pixel(x, y) == Some(WHITE)));
        let columns: Vec<bool> = written.collect();
        // A letter is at most five dots of two pixels.
        let widest = columns.split(|written| !written).map(<[bool]>::len).max();
        assert!(widest.is_some_and(|widest| (2..=10).contains(&widest)), "{widest:?}");
    }
}
