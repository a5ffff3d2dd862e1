//! The order of a range image's returns in the file. FORMAT.md 4.2.

use std::ops::Range;

use pulp::NullaryFnOnce;

use super::Hdl64;
use crate::ground::lanes::dispatch;
use crate::scanner::{RangeImage, Return};

impl RangeImage {
    /// The returns in the order of the file: row by row, in ascending order of the formula's azimuth; returns
    /// with equal azimuths in the order of columns.
    pub fn file_order(&self, scanner: &Hdl64) -> Vec<Return> {
        dispatch(FileOrder { image: self, scanner })
    }
}

/// The arguments of [`RangeImage::file_order`], for a function compiled for several vector units.
struct FileOrder<'a> {
    image: &'a RangeImage,
    scanner: &'a Hdl64,
}

impl NullaryFnOnce for FileOrder<'_> {
    type Output = Vec<Return>;

    #[inline(always)]
    fn call(self) -> Vec<Return> {
        let FileOrder { image, scanner } = self;
        let mut returns = Vec::with_capacity(image.returns());
        // The returns of a row, with room at either end.
        let mut of_row = vec![Return::default(); FEW + image.columns.len() + FEW];
        let mut azimuths = vec![0.0; of_row.len()];
        for row in 0..image.steps.rows() {
            let first = scanner.first_column_tick(row);
            let first = image.columns.partition_point(|&column_tick| column_tick < first);
            let tick = scanner.ticks_of_columns(row);
            let mut end = FEW;
            for columns in [first..image.columns.len(), 0..first] {
                let cells = image.steps.row(row)[columns.clone()].iter().zip(&image.columns[columns.clone()]);
                // Without branches: each cell is written to the next entry, which the following one
                // overwrites unless the cell holds a return.
                for ((&steps, &column_tick), column) in cells.zip(columns.start as u32..) {
                    of_row[end] = Return { row: row as u32, column, tick: tick(column_tick), steps, echo: 0 };
                    end += usize::from(steps > 0);
                }
            }
            scanner.fill_azimuths(row, &of_row[FEW..end], &mut azimuths[FEW..end]);
            let turned = turned_to_seam(&mut azimuths, &mut of_row, FEW..end);
            sort(&mut azimuths[turned.clone()], &mut of_row[turned.clone()]);
            returns.extend_from_slice(&of_row[turned]);
        }
        returns
    }
}

/// Sorts the returns of a row by azimuth, then column. They are nearly sorted already.
#[inline(always)]
fn sort(azimuths: &mut [f64], returns: &mut [Return]) {
    /// The mean number of moves per return up to which insertion is worthwhile.
    const MOVES: usize = 4;
    /// Number of returns that are examined together.
    const BLOCK: usize = 8;
    let mut moves = MOVES * returns.len();
    let mut next = 1;
    while next < returns.len() {
        if let (Some(before), Some(block)) =
            (azimuths[next - 1..].first_chunk::<BLOCK>(), azimuths[next..].first_chunk::<BLOCK>())
            && (0..BLOCK).fold(true, |all, i| all & (before[i] < block[i]))
        {
            next += BLOCK;
            continue;
        }
        let moved = (azimuths[next], returns[next]);
        let mut place = next;
        while place > 0 && compare((azimuths[place - 1], returns[place - 1]), moved).is_gt() {
            if moves == 0 {
                (azimuths[place], returns[place]) = moved;
                return sort_all(azimuths, returns);
            }
            (azimuths[place], returns[place]) = (azimuths[place - 1], returns[place - 1]);
            (place, moves) = (place - 1, moves - 1);
        }
        (azimuths[place], returns[place]) = moved;
        next += 1;
    }
}

/// The largest number of returns at the wrong end of a row.
const FEW: usize = 100;

/// Turns a row so that it begins where azimuths pass 0, and returns its new range. It nearly does already,
/// but points near the seam may be at either end; they are copied to the other one, for which there must be
/// room for [`FEW`].
fn turned_to_seam(azimuths: &mut [f64], returns: &mut [Return], row: Range<usize>) -> Range<usize> {
    /// In radians: more than the difference of any azimuths that are out of order.
    const SEAM: f64 = 3.0;
    let falls = |part: &[f64]| part.windows(2).rposition(|pair| pair[1] < pair[0] - SEAM);
    let tail = row.start.max(row.end.saturating_sub(FEW));
    let head = row.end.min(row.start + FEW);
    let (wrong, at, turned) = if let Some(last) = falls(&azimuths[tail..row.end]) {
        let moved = row.end - (tail + last + 1);
        (row.end - moved..row.end, row.start - moved, row.start - moved..row.end - moved)
    } else if let Some(last) = falls(&azimuths[row.start..head]) {
        let moved = last + 1;
        (row.start..row.start + moved, row.end, row.start + moved..row.end + moved)
    } else {
        return row;
    };
    azimuths.copy_within(wrong.clone(), at);
    returns.copy_within(wrong, at);
    turned
}

#[inline(always)]
fn compare(a: (f64, Return), b: (f64, Return)) -> std::cmp::Ordering {
    a.0.total_cmp(&b.0).then(a.1.column.cmp(&b.1.column))
}

#[cold]
fn sort_all(azimuths: &[f64], returns: &mut [Return]) {
    let mut sorted: Vec<(f64, Return)> = azimuths.iter().copied().zip(returns.iter().copied()).collect();
    sorted.sort_unstable_by(|a, b| compare(*a, *b));
    returns.iter_mut().zip(sorted).for_each(|(place, (_, found))| *place = found);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scanner::hdl64::testing::scanner;

    #[test]
    fn returns_come_by_their_azimuths_on_every_vector_unit() {
        let (scanner, image) = scanner();
        let returns = image.file_order(&scanner);
        assert_eq!(returns, FileOrder { image: &image, scanner: &scanner }.call());
        assert_eq!(returns.len(), image.returns());
        let mut out_of_columns = 0;
        for pair in returns.windows(2).filter(|pair| pair[0].row == pair[1].row) {
            let [before, after] = [pair[0], pair[1]].map(|found| {
                let mut azimuth = [0.0];
                scanner.fill_azimuths(found.row as usize, &[found], &mut azimuth);
                (azimuth[0], found)
            });
            assert!(compare(before, after).is_lt(), "{before:?} {after:?}");
            out_of_columns += usize::from(before.1.column > after.1.column);
        }
        assert!(out_of_columns > 100, "the image must have returns out of the columns' order");
    }

    #[test]
    fn a_row_begins_at_the_seam() {
        let found = |column: usize| Return { column: column as u32, ..Return::default() };
        for (length, at) in [(5, 0), (5, 2), (5, 4), (150, 3), (150, 60), (900, 99), (900, 801), (900, 899)] {
            // As many azimuths as `at` come before the seam.
            let azimuth = |place: usize| if place < at { 6.0 } else { 0.1 } + 1e-4 * place as f64;
            let mut azimuths = vec![0.0; FEW + length + FEW];
            let mut returns = vec![Return::default(); FEW + length + FEW];
            (0..length).for_each(|i| (azimuths[FEW + i], returns[FEW + i]) = (azimuth(i), found(i)));
            let row = turned_to_seam(&mut azimuths, &mut returns, FEW..FEW + length);
            let turned: Vec<usize> = (at..length).chain(0..at).collect();
            assert_eq!(azimuths[row.clone()], turned.iter().map(|i| azimuth(*i)).collect::<Vec<_>>());
            assert_eq!(returns[row], turned.iter().map(|i| found(*i)).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_order_of_returns_in_no_order_is_found_too() {
        let (scanner, image) = scanner();
        let mut returns = image.file_order(&scanner);
        returns.retain(|found| found.row == 0);
        // Azimuths that fall from one return to the next, but nowhere by as much as at the seam.
        let mut azimuths: Vec<f64> = (0..returns.len()).rev().map(|i| i as f64 * 1e-4).collect();
        let reversed: Vec<Return> = returns.iter().rev().copied().collect();
        sort(&mut azimuths, &mut returns);
        assert_eq!(returns, reversed);
    }
}
