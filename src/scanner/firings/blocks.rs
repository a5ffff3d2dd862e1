//! Finds the ticks of blocks, and the ticks from block to block, of scanners whose azimuth advances while
//! their lasers fire.

use super::projection::{Column, Place};
use super::timing::{Span, passed_ticks};
use super::{Firings, Timing};
use crate::ground::angle::shorter_way;
use crate::ground::floats::round_ties_even;

impl Firings {
    /// The average number of ticks from one block to the next.
    pub(super) fn usual_span(&self, places: &[Place]) -> f64 {
        /// A firing takes less than one part in this number of a turn.
        const FAR: i64 = 500;
        if !self.build.timing.is_interpolated() {
            return 0.0;
        }
        let (mut ticks, mut blocks) = (0, 0.0);
        for pair in places.windows(2).filter(|pair| pair[1].slot > pair[0].slot) {
            let passed = self.passed(0, pair[1].slot) - self.passed(0, pair[0].slot);
            let turned = self.turned(pair[0].column_tick, pair[1].column_tick);
            let far = i64::from(self.build.ticks) / FAR;
            // Ticks that are not certain err to both sides.
            let least = if pair[0].slack + pair[1].slack > 0 { -far } else { 0 };
            if passed > 0.0 && (least..far).contains(&turned) {
                ticks += turned;
                blocks += passed;
            }
        }
        if blocks > 0.0 { ticks as f64 / blocks } else { 0.0 }
    }

    /// The ticks between firings, given those between blocks.
    pub(super) fn firing(&self, span: f64) -> f64 {
        span / f64::from(self.build.timing.firings(self.rows()).max(1))
    }

    /// Whether a place with a later slot may belong to the same firing, given the ticks between blocks and
    /// firings.
    pub(super) fn goes_on(&self, last: &Place, place: &Place, (span, firing): (f64, f64)) -> bool {
        if !self.build.timing.is_interpolated() {
            let off = self.turned(last.column_tick, place.column_tick).unsigned_abs();
            return off <= u64::from(last.slack + place.slack);
        }
        // A place of the next firing is off by more than half of the ticks between firings. In some blocks no
        // ticks pass.
        let expected = (self.passed(0, place.slot) - self.passed(0, last.slot)) * span;
        let turned = self.turned(last.column_tick, place.column_tick);
        let slack = f64::from(last.slack + place.slack);
        (turned == 0 && !self.lags.is_empty()) || (turned as f64 - expected).abs() <= 0.5 * firing + slack
    }

    /// Finds the tick of each block and the ticks to the next one: those that explain the ticks of most of
    /// its places.
    pub(super) fn find_spans(&self, places: &[Place], columns: &mut [Column], usual: f64) {
        /// Number of unexplained blocks after which the search may be abandoned.
        const MOST_FAILURES: usize = 16;
        let firings = self.build.timing.firings(self.rows()) as usize;
        let usual = round_ties_even(usual).max(0.0) as u32;
        // `before` is the tick at which the block before ends.
        let (mut number, mut last, mut failures, mut before) = (0, usual, 0, None);
        while number < columns.len() {
            let all = number..(number + firings).min(columns.len());
            let one = number..number + 1;
            let size = |block: &std::ops::Range<usize>| {
                columns[block.clone()].iter().map(|column| column.places.len()).sum::<usize>()
            };
            // The firings of a block together, or one alone, which may be the second one.
            let mut tried = vec![(all, 0)];
            if firings > 1 {
                tried.extend([(one.clone(), 0), (one, 1)]);
            }
            let mut best: Option<(BlockFit, std::ops::Range<usize>, u32)> = None;
            for (block, first) in tried {
                let Some(found) = self.block(places, columns, block.clone(), first, (last, usual), before)
                else {
                    continue;
                };
                let is_whole = found.fitting == size(&block);
                let share = |found: &BlockFit, block| found.fitting as f64 / size(block).max(1) as f64;
                if is_whole
                    || best.as_ref().is_none_or(|(other, b, _)| share(other, b) < share(&found, &block))
                {
                    best = Some((found, block, first));
                }
                if is_whole {
                    break;
                }
            }
            let Some((found, block, first)) = best else {
                number += 1;
                continue;
            };
            failures += usize::from(2 * found.fitting < size(&block));
            number = block.end;
            let is_last = first as usize + block.len() == firings;
            before = is_last.then(|| self.within_turn(found.tick + found.span));
            for (firing, column) in (first..).zip(&mut columns[block]) {
                column.tick = found.tick;
                column.span = Span { ticks: found.span, firing };
            }
            last = if found.span > 0 { found.span } else { last };
            if failures > MOST_FAILURES && failures > number / 4 {
                return;
            }
        }
    }

    /// The tick of a block of these columns, the first of which is firing `first_firing` of the block, and
    /// the ticks to the next one: those that explain the most places. On ties, those nearest to what the next
    /// block implies, or to those of the block before, which ends at tick `before`.
    fn block(
        &self,
        places: &[Place],
        columns: &[Column],
        block: std::ops::Range<usize>,
        first_firing: u32,
        (last, usual): (u32, u32),
        before: Option<u32>,
    ) -> Option<BlockFit> {
        let of = |column: &Column| &places[column.places.clone()];
        let own = &columns[block.clone()];
        let (first, firing) = surest(own.iter().zip(first_firing..), of)?;
        let turn = i64::from(self.build.ticks);
        // The tick at which a block must begin, given a place of one of its firings.
        let start = |place: &Place, firing: u32| {
            let passed = self.passed(firing, place.slot) * f64::from(last);
            i64::from(place.column_tick) - round_ties_even(passed) as i64
        };
        // If the place may have another tick, the one that the block before implies.
        let tick = start(first, firing);
        let likely = before.map_or(0, |before| shorter_way(i64::from(before) - tick, turn));
        let from = tick + likely.clamp(-i64::from(first.slack), i64::from(first.slack));
        let next = columns.get(block.end).and_then(|column| surest(std::iter::once((column, 0)), of));
        let told = next.filter(|(next, _)| next.slack == 0).map(|(next, _)| start(next, 0));
        let size = own.iter().map(|column| column.places.len()).sum();
        let search = Block { scanner: self, places, columns: own, first_firing, size };
        let best = match search.best(from, told, (last, usual)) {
            Some(best) if best.fitting == size => return Some(best),
            best => best,
        };
        // Some programs do not interpolate azimuths in the last block of a packet.
        let still = search.fitting(first.column_tick, 0, best.map_or(0, |best| best.fitting));
        if still > 0 { Some(BlockFit { tick: first.column_tick, span: 0, fitting: still }) } else { best }
    }
}

/// In ticks: spans differ by no more than this from the usual one, if the scanner turns evenly.
const UNEVEN: u32 = 12;
/// In ticks: the largest distance of a block's start from where it is expected.
const OFF: i64 = 3;

/// Numbers of places that a span explains, for each distance of the block's start from where it is expected.
type Counts = [u32; 2 * OFF as usize + 1];

/// The firings of a block whose tick and span are searched for.
struct Block<'a> {
    scanner: &'a Firings,
    places: &'a [Place],
    columns: &'a [Column],
    /// The number in its block of the firing in the first column.
    first_firing: u32,
    /// The number of all places.
    size: usize,
}

impl Block<'_> {
    /// The tick within [`OFF`] of `from`, and the span, that explain the most places. On ties, those nearest
    /// to `from` and to the span at which the next block begins at `told`, or else to the `last` one.
    fn best(&self, from: i64, told: Option<i64>, (last, usual): (u32, u32)) -> Option<BlockFit> {
        let turn = i64::from(self.scanner.build.ticks);
        // With a table of parts, ticks advance from every base in the same way, so the places that a span
        // explains are counted for all bases at once.
        let parts = match &self.scanner.build.timing {
            Timing::Parts(parts) if turn > 2 * OFF => Some(parts),
            _ => None,
        };
        let mut counts: [Option<Counts>; 2 * UNEVEN as usize + 1] = [None; 2 * UNEVEN as usize + 1];
        let mut best: Option<BlockFit> = None;
        for off in (0..=2 * OFF).map(|i| if i % 2 == 0 { i / 2 } else { -(i + 1) / 2 }) {
            let tick = (from + off).rem_euclid(turn) as u32;
            let told = told.map(|told| (told - from - off).rem_euclid(turn) as u32);
            let near_told = told.into_iter().flat_map(|told| [told, told.saturating_sub(1), told + 1]);
            let near_told = near_told.filter(|told| told.abs_diff(usual) <= UNEVEN);
            let near_last = (0..=UNEVEN).flat_map(|off| [last.saturating_sub(off), last + off]);
            for span in near_told.chain(near_last).filter(|span| span.abs_diff(usual) <= UNEVEN) {
                let most = best.map_or(0, |best| best.fitting);
                let fitting = match parts {
                    Some(parts) => {
                        let counts = &mut counts[(span + UNEVEN - usual) as usize];
                        let counts = counts.get_or_insert_with(|| self.count(parts, span, from));
                        counts[(off + OFF) as usize] as usize
                    }
                    None => self.fitting(tick, span, most),
                };
                if fitting > most {
                    best = Some(BlockFit { tick, span, fitting });
                }
                if fitting == self.size {
                    return best;
                }
            }
        }
        best
    }

    /// The number of places that a tick and a span explain, or 0 if it does not exceed `atleast`.
    fn fitting(&self, tick: u32, span: u32, atleast: usize) -> usize {
        let mut missed = 0;
        for (firing, column) in (self.first_firing..).zip(self.columns) {
            for place in &self.places[column.places.clone()] {
                let own = self.scanner.tick(place.row as usize, tick, Span { ticks: span, firing });
                missed += usize::from(!self.scanner.is_at(own, place));
                if missed + atleast >= self.size {
                    return 0;
                }
            }
        }
        self.size - missed
    }

    /// The places that a span explains if the block starts within [`OFF`] of `from`, given the parts of a
    /// span that pass before each slot.
    fn count(&self, parts: &[u32], span: u32, from: i64) -> Counts {
        let turn = i64::from(self.scanner.build.ticks);
        let mut counts = Counts::default();
        for (firing, column) in (self.first_firing..).zip(self.columns) {
            for place in &self.places[column.places.clone()] {
                let slot = firing as usize * self.scanner.rows() + place.slot as usize;
                let passed = passed_ticks(span, parts.get(slot).copied().unwrap_or(0));
                let off = i64::from(place.column_tick) - i64::from(passed) - from + OFF;
                if place.slack > 0 {
                    let (off, slack) = (shorter_way(off, turn), i64::from(place.slack));
                    let all = (off - slack).max(0)..=(off + slack).min(2 * OFF);
                    all.for_each(|off| counts[off as usize] += 1);
                    continue;
                }
                // Divisions are slow, and adding one turn is usually enough.
                let less = if off < 0 { off + turn } else { off };
                let off = if (0..turn).contains(&less) { less } else { off.rem_euclid(turn) } as usize;
                counts.get_mut(off).into_iter().for_each(|count| *count += 1);
            }
        }
        counts
    }
}

/// The explanation of a block: its tick, the ticks to the next one, and the number of places for which they
/// are right.
#[derive(Clone, Copy)]
struct BlockFit {
    tick: u32,
    span: u32,
    fitting: usize,
}

/// The first place whose tick is certain, or that whose tick is surest, and the number that its column comes
/// with.
fn surest<'p, 'c>(
    columns: impl Iterator<Item = (&'c Column, u32)> + Clone,
    places: impl Fn(&Column) -> &'p [Place],
) -> Option<(&'p Place, u32)> {
    let all = columns.flat_map(|(column, number)| places(column).iter().map(move |place| (place, number)));
    let certain = all.clone().find(|(place, _)| place.slack == 0);
    certain.or_else(|| all.min_by_key(|(place, _)| place.slack))
}
