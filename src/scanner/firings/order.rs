//! The order in which lasers fire, and how the azimuth advances while they do, from points in file order.

use super::projection::{Column, Place, nearest};
use super::timing::{MOST_BLOCKS, WHOLE};
use super::{Firings, Timing};
use crate::ground::angle::shorter_way;

/// The elevations of Velodyne's VLP-16 in degrees, in the order in which its lasers fire.
pub(super) const VLP_16: [i32; 16] = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15];

/// Minimum share of equal steps from one laser to another, if all lasers of a firing have one azimuth.
pub(super) const STEADY: f64 = 0.93;

/// The order in which lasers fire.
pub(super) struct FiringOrder {
    pub rows_of_slots: Vec<u32>,
    /// Other slots of this order at which a firing may begin, if the azimuth advances while its lasers fire.
    pub other_starts: Vec<usize>,
    /// Another slot at which a firing may begin, if the azimuth always jumps there.
    pub half_start: Option<usize>,
    /// The whole ticks by which each row is ahead. If `timing` is not that of the scanner, they include the
    /// ticks that pass while its lasers fire, or are all 0.
    pub shifts: Vec<f64>,
    pub timing: Timing,
    /// Whether `timing` is that of the scanner.
    pub is_steady: bool,
}

impl FiringOrder {
    /// The order of lasers if the file holds row after row and so does not show in which order they fire:
    /// only how far they look ahead of one another.
    pub fn of_lines(sequence: &[(usize, u32)], rows: usize, ticks: u32) -> Self {
        FiringOrder {
            rows_of_slots: (0..rows as u32).collect(),
            other_starts: Vec::new(),
            half_start: None,
            shifts: shifts_of_lines(sequence, rows, ticks),
            timing: Timing::Together,
            is_steady: true,
        }
    }
}

/// The whole ticks by which each row is ahead of the one with the most returns: the shift for which most of
/// its ticks are also ticks of that row, as a scanner does not turn evenly. 0 if no other shift is clearly
/// better.
fn shifts_of_lines(sequence: &[(usize, u32)], rows: usize, ticks: u32) -> Vec<f64> {
    /// Largest difference between the directions of two lasers, in degrees.
    const FARTHEST: f64 = 15.0;
    /// A sufficient number of ticks of a row, and the factor by which more of them must agree than without a
    /// shift.
    const SAMPLE: usize = 400;
    const CLEARLY: f64 = 1.3;
    let mut of_rows: Vec<Vec<u32>> = vec![Vec::new(); rows];
    sequence.iter().for_each(|(row, tick)| of_rows[*row].push(*tick));
    for row in &mut of_rows {
        row.sort_unstable();
        row.dedup();
    }
    let Some(most) = of_rows.iter().max_by_key(|row| row.len()) else { return Vec::new() };
    let (turn, farthest) = (i64::from(ticks), (FARTHEST / 360.0 * f64::from(ticks)) as i64);
    let shift = |row: &Vec<u32>| {
        let mut counts = vec![0u32; 2 * farthest as usize + 1];
        for &tick in row.iter().step_by((row.len() / SAMPLE).max(1)) {
            // The neighbouring ticks of the other row, also across the end of the turn.
            let first = most.partition_point(|&other| i64::from(other) < i64::from(tick) - farthest);
            let before = most.iter().rev().map(|&other| i64::from(other) - turn);
            let before = before.take_while(|&other| other >= i64::from(tick) - farthest);
            let after = most.iter().map(|&other| i64::from(other) + turn);
            let others = most[first..].iter().map(|&other| i64::from(other));
            let near = others.chain(after).take_while(|&other| other <= i64::from(tick) + farthest);
            for other in before.chain(near) {
                counts[(i64::from(tick) - other + farthest) as usize] += 1;
            }
        }
        let without = f64::from(counts[farthest as usize]);
        let distance = |at: &usize| (*at as i64 - farthest).abs();
        let best = (0..counts.len()).min_by_key(|at| (std::cmp::Reverse(counts[*at]), distance(at)));
        let best = best.filter(|&at| f64::from(counts[at]) > CLEARLY * without);
        best.map_or(0.0, |at| (at as i64 - farthest) as f64)
    };
    of_rows.iter().map(shift).collect()
}

/// Determines the order of the lasers from rows and ticks in file order; each tick may be wrong by `slack`.
/// `None` if the file is not in the order of firings.
pub(super) fn order(sequence: &[(usize, u32)], rows: usize, ticks: u32, slack: u32) -> Option<FiringOrder> {
    /// Pairs of lasers with fewer steps are ignored.
    const FEWEST: usize = 8;
    const OTHER_STARTS: usize = 2;
    /// In ticks: smaller steps from one laser to the next are those of a firing.
    const LEAST_JUMP: i64 = 3;
    let mut order = cycle(sequence, rows)?;
    let mut slots = vec![0; rows];
    order.iter().enumerate().for_each(|(slot, &row)| slots[row] = slot);
    let turned = |from: u32, to: u32| shorter_way(i64::from(to) - i64::from(from), i64::from(ticks));
    // The steps from each laser to each that follows it in the file.
    let mut steps: Vec<Vec<i64>> = vec![Vec::new(); rows * rows];
    for pair in sequence.windows(2) {
        let [(from, before), (to, after)] = [pair[0], pair[1]];
        steps[slots[from] * rows + slots[to]].push(turned(before, after));
    }
    // The most frequent step, and how often it occurs.
    let mode = |steps: &mut Vec<i64>| {
        steps.sort_unstable();
        if slack > 0 {
            return densest(steps, 2 * i64::from(slack));
        }
        let most = steps.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
        most.map_or((0, 0), |same| (same[0], same.len()))
    };
    let modes: Vec<(i64, usize)> = steps.iter_mut().map(mode).collect();
    // The steps from each slot to the next one; the first slot follows the last.
    let next = |slot: usize| slot * rows + (slot + 1) % rows;
    let share = |slot: usize| modes[next(slot)].1 as f64 / steps[next(slot)].len().max(1) as f64;
    let known = (0..rows * rows).filter(|&pair| steps[pair].len() >= FEWEST);
    let (same, all) = known.fold((0, 0), |(same, all), pair| (same + modes[pair].1, all + steps[pair].len()));
    // The steps from the last laser of a firing to the first of the next may differ.
    let ends = sequence.len() / rows.max(1);
    let is_steady = same as f64 >= STEADY * all.saturating_sub(ends) as f64;
    let of_next: Vec<&[i64]> = (0..rows).map(|slot| &steps[next(slot)][..]).collect();
    let (last, has_shifts) = if is_steady {
        // One azimuth per firing. Its end is where the steps differ most or, if the scanner turns by the same
        // angle from firing to firing, where the order jumps from one end of the rows to the other.
        let seen = (0..rows).filter(|&slot| of_next[slot].len() >= FEWEST);
        let worst = seen.min_by(|&a, &b| share(a).total_cmp(&share(b))).unwrap_or(0);
        let jump = |slot: &usize| order[*slot].abs_diff(order[(*slot + 1) % rows]);
        let longest = (0..rows).rev().max_by_key(jump).unwrap_or(0);
        (if share(worst) < STEADY { worst } else { longest }, true)
    } else {
        last_of_firing(&of_next)?
    };
    let first = (last + 1) % rows;
    // If lasers of both halves of a firing fire at the same time, the azimuth jumps from half to half.
    let (varying, steady): (Vec<usize>, Vec<usize>) =
        (0..rows).filter(|&slot| slot != last).partition(|&slot| alike(of_next[slot]) < STEADY);
    let mut others = varying;
    others.sort_by(|&a, &b| alike(of_next[a]).total_cmp(&alike(of_next[b])));
    others.truncate(OTHER_STARTS);
    let jump = |slot: &usize| modes[next(*slot)].0.abs();
    let half = steady.into_iter().filter(|slot| jump(slot) >= LEAST_JUMP).max_by_key(jump);
    let start = |last: usize| (last + 1 + rows - first) % rows;
    let (other_starts, half_start) = (others.into_iter().map(start).collect(), half.map(start));
    order.rotate_left(first);
    let mut shifts = vec![0.0; rows];
    if has_shifts {
        let of_slots = shifts_of_slots(rows, |a, b| modes[(first + a) % rows * rows + (first + b) % rows]);
        order.iter().zip(of_slots).for_each(|(&row, shift)| shifts[row] = shift as f64);
    }
    let rows_of_slots = order.into_iter().map(|row| row as u32).collect();
    Some(FiringOrder { rows_of_slots, other_starts, half_start, shifts, timing: Timing::Together, is_steady })
}

/// The middle of the ascending steps that are densest within some ticks to either side, and their count.
fn densest(steps: &[i64], aside: i64) -> (i64, usize) {
    let mut best = (0, 0);
    let mut end = 0;
    for (start, first) in steps.iter().enumerate() {
        end += steps[end..].iter().take_while(|step| **step <= first + 2 * aside).count();
        if end - start > best.1 {
            best = (steps[(start + end) / 2], end - start);
        }
    }
    best
}

/// The rows in the order of a file that holds one row after another, each from one end to the other. `None`
/// if the file is not in such an order.
pub(super) fn lines(sequence: &[(usize, u32)], rows: usize, ticks: u32) -> Option<Vec<u32>> {
    /// At most one place in this number may be out of order.
    const RARE: usize = 50;
    let turn = i64::from(ticks);
    let steps = sequence.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    let steps = steps.map(|pair| shorter_way(i64::from(pair[1].1) - i64::from(pair[0].1), turn));
    let (mut on, mut back) = (0, 0);
    steps.for_each(|step| *(if step < 0 { &mut back } else { &mut on }) += 1);
    let out_of_order = sequence.len().saturating_sub(rows + usize::max(on, back));
    if out_of_order * RARE > sequence.len() {
        return None;
    }
    // Each row is placed by the median of its positions in the file.
    let mut of_rows: Vec<Vec<usize>> = vec![Vec::new(); rows];
    sequence.iter().enumerate().for_each(|(place, (row, _))| of_rows[*row].push(place));
    let mut lines: Vec<u32> = (0..rows as u32).collect();
    lines.sort_by_key(|&row| {
        let places = &of_rows[row as usize];
        places.get(places.len() / 2).copied().unwrap_or(usize::MAX)
    });
    Some(lines)
}

/// The share of steps, given in ascending order, that are equal except for the rounding of ticks.
fn alike(steps: &[i64]) -> f64 {
    let mut counts: Vec<(i64, usize)> =
        steps.chunk_by(|a, b| a == b).map(|same| (same[0], same.len())).collect();
    counts.push((i64::MAX, 0));
    let pairs = counts.windows(2).map(|pair| match pair[0].0 + 1 == pair[1].0 {
        true => pair[0].1 + pair[1].1,
        false => pair[0].1,
    });
    pairs.max().unwrap_or(0) as f64 / steps.len().max(1) as f64
}

/// The last slot of a firing whose azimuth advances while its lasers fire, given the steps from each slot to
/// the next, in ascending order; and whether the directions of its lasers differ by more than the azimuth
/// advances.
fn last_of_firing(steps: &[&[i64]]) -> Option<(usize, bool)> {
    let mean = |slot: &usize| steps[*slot].iter().sum::<i64>() as f64 / steps[*slot].len().max(1) as f64;
    let by_length = |a: &usize, b: &usize| mean(a).abs().total_cmp(&mean(b).abs());
    let longest = (0..steps.len()).max_by(by_length)?;
    // The longest step is the one to the next firing, unless lasers look back and forth: then it is the least
    // regular one.
    let (there, back): (Vec<f64>, Vec<f64>) =
        (0..steps.len()).map(|slot| mean(&slot)).partition(|mean| *mean > 0.0);
    let [there, back] = [there, back].map(|means| means.iter().sum::<f64>().abs());
    if there.min(back) < (there - back).abs() {
        return Some((longest, false));
    }
    let by_likeness = |a: &usize, b: &usize| alike(steps[*a]).total_cmp(&alike(steps[*b]));
    let last = (0..steps.len()).min_by(|a, b| by_likeness(a, b).then(by_length(b, a)));
    last.map(|last| (last, true))
}

/// The whole ticks by which each slot of a firing is ahead of the first. `step` returns the most frequent
/// step from a slot to a later one, and its count; the shifts follow the steps with the highest counts.
fn shifts_of_slots(rows: usize, step: impl Fn(usize, usize) -> (i64, usize)) -> Vec<i64> {
    let mut shifts = vec![0; rows];
    // For each slot: the count of the best step from a known slot, and the shift that results.
    let mut best: Vec<Option<(usize, i64)>> = vec![Some((0, 0)); rows];
    let mut slot = 0;
    for _ in 0..rows {
        shifts[slot] = best[slot].take().map_or(0, |(_, shift)| shift);
        for (other, best) in best.iter_mut().enumerate() {
            let Some(known) = best else { continue };
            let (ahead, count) = if slot < other { step(slot, other) } else { step(other, slot) };
            if count > known.0 {
                *known = (count, shifts[slot] + if slot < other { ahead } else { -ahead });
            }
        }
        let open = (0..rows).rev().filter_map(|other| Some((best[other]?.0, other)));
        slot = open.max_by_key(|(count, _)| *count).map_or(slot, |(_, other)| other);
    }
    shifts
}

/// The order of a VLP-16, if these are its elevations.
pub(super) fn vlp_16(elevations: &[f64]) -> Option<FiringOrder> {
    let row = |degrees: i32| {
        let row = nearest(elevations, f64::from(degrees).to_radians());
        ((elevations[row].to_degrees() - f64::from(degrees)).abs() < 0.1).then_some(row as u32)
    };
    let rows_of_slots: Option<Vec<u32>> = VLP_16.map(row).into_iter().collect();
    let is_all = elevations.len() == VLP_16.len();
    let order = |rows_of_slots| FiringOrder {
        rows_of_slots,
        other_starts: Vec::new(),
        half_start: None,
        shifts: vec![0.0; VLP_16.len()],
        timing: Timing::Vlp16,
        is_steady: true,
    };
    rows_of_slots.filter(|_| is_all).map(order)
}

/// The rows in the order in which they follow one another cyclically, starting anywhere. `None` if most
/// points are of the same row as the point before, or if no order explains them better than chance.
fn cycle(sequence: &[(usize, u32)], rows: usize) -> Option<Vec<usize>> {
    /// If firings have fewer points than this on average, the scan is sparse.
    const SPARSE: f64 = 10.0;
    /// Minimum number of points of a firing on average; by chance it would be two.
    const LEAST: f64 = 2.25;
    let sequence: Vec<usize> = sequence.iter().map(|(row, _)| *row).collect();
    let again = sequence.windows(2).filter(|pair| pair[0] == pair[1]).count();
    if again * 2 > sequence.len() {
        return None;
    }
    let points_of = |order: &[usize]| {
        let mut slots = vec![0; rows];
        order.iter().enumerate().for_each(|(slot, &row)| slots[row] = slot);
        let firings = sequence.chunk_by(|&row, &next| slots[row] < slots[next]).count();
        sequence.len() as f64 / firings.max(1) as f64
    };
    let order = by_rounds(&sequence, rows)?;
    let order = if points_of(&order) < SPARSE { of_sparse(&sequence, order) } else { order };
    (points_of(&order) >= LEAST).then_some(order)
}

/// The order of the rows by which of two is first in most rounds. A round ends before the row with the most
/// points.
fn by_rounds(sequence: &[usize], rows: usize) -> Option<Vec<usize>> {
    /// A sufficient number of rounds.
    const ROUNDS: usize = 500;
    let mut counts = vec![0u32; rows];
    sequence.iter().for_each(|&row| counts[row] += 1);
    let first = (0..rows).rev().max_by_key(|&row| counts[row])?;
    let rounds = sequence.chunk_by(|_, next| *next != first);
    let is_single = |round: &&[usize]| {
        let mut seen = vec![false; rows];
        round.len() > 1 && round.iter().all(|&row| !std::mem::replace(&mut seen[row], true))
    };
    let rounds: Vec<_> = rounds.filter(is_single).collect();
    let mut before = vec![0u32; rows * rows];
    for round in rounds.iter().step_by((rounds.len() / ROUNDS).max(1)) {
        for (place, row) in round.iter().enumerate() {
            round[place + 1..].iter().for_each(|later| before[row * rows + later] += 1);
        }
    }
    let precedes = |a: usize, b: usize| before[a * rows + b] > before[b * rows + a];
    let count = |is: &dyn Fn(usize) -> bool| (0..rows).filter(|&other| is(other)).count();
    let later: Vec<usize> = (0..rows).map(|row| count(&|other| precedes(row, other))).collect();
    let mut earlier: Vec<usize> = (0..rows).map(|row| count(&|other| precedes(other, row))).collect();
    // Next is the row with the fewest remaining rows before it and the most rows after it: lasers that take
    // turns are never seen together.
    let mut order = Vec::with_capacity(rows);
    let mut rest: Vec<usize> = (0..rows).collect();
    let mut next = first;
    while !rest.is_empty() {
        order.push(next);
        rest.retain(|&row| row != next);
        rest.iter().for_each(|&row| earlier[row] -= usize::from(precedes(next, row)));
        next = rest.iter().copied().min_by_key(|&row| (earlier[row], rows - later[row])).unwrap_or(next);
    }
    Some(order)
}

/// The order of the rows of a sparse scan, which has few rounds without a gap: `order`, after each row has
/// moved to where that leaves the fewest firings, until no move leaves fewer (a local search for the linear
/// ordering problem).
fn of_sparse(sequence: &[usize], mut order: Vec<usize>) -> Vec<usize> {
    /// Largest number of times that all rows are moved.
    const PASSES: usize = 20;
    let rows = order.len();
    let mut transitions = vec![0i64; rows * rows];
    sequence.windows(2).for_each(|pair| transitions[pair[0] * rows + pair[1]] += 1);
    // By how many firings there are fewer if the first of two rows is before the other.
    let saved = |row: usize, other: usize| transitions[row * rows + other] - transitions[other * rows + row];
    for _ in 0..PASSES {
        let mut has_moved = false;
        for row in order.clone() {
            let from = order.iter().position(|&other| other == row).unwrap_or(0);
            let (mut sum, mut best) = (0, (0, from));
            for to in (0..from).rev() {
                sum += saved(row, order[to]);
                best = if sum > best.0 { (sum, to) } else { best };
            }
            sum = 0;
            for to in from + 1..rows {
                sum += saved(order[to], row);
                best = if sum > best.0 { (sum, to) } else { best };
            }
            has_moved |= best.0 > 0;
            order.remove(from);
            order.insert(best.1, row);
        }
        if !has_moved {
            break;
        }
    }
    order
}

/// The same scanner with a timing of `firings` firings per block, with parts estimated from the points;
/// `None` if they are too few. If rows lag, `firings` must be 1, and the lags are estimated together with the
/// timing.
pub(super) fn timed(scanner: &Firings, places: &[Place], firings: usize) -> Option<Firings> {
    /// Largest number of rounds until neither parts nor lags change.
    const ROUNDS: usize = 8;
    /// Number of places that show parts and lags roughly.
    const FEW: usize = 16_000;
    let rows = scanner.rows();
    let mut scanner = scanner.clone();
    // Only ticks that are certain tell which part has passed.
    let mut places: Vec<Place> = places.iter().filter(|place| place.slack == 0).copied().collect();
    let mut parts = first_parts(&scanner, &places, firings)?;
    let with_parts = |scanner: Firings, parts: &[f64]| {
        let of_parts = parts.iter().map(|part| (part * f64::from(WHOLE)) as u32);
        scanner.with_timing(Timing::Parts(of_parts.collect()))
    };
    let is_by_firings = scanner.rows_of_lines.is_empty();
    let mut used = if is_by_firings { FEW.min(places.len()) } else { places.len() };
    for round in 0..ROUNDS {
        used = if 2 * round < ROUNDS { used } else { places.len() };
        scanner = with_parts(scanner, &parts);
        let columns = scanner.columns(&places[..used]);
        // For each slot of each firing: the ticks to the next block, and the ticks since this one began.
        let mut seen: Vec<Vec<(u32, i64)>> = vec![Vec::new(); parts.len()];
        for column in columns.iter().filter(|column| column.span.ticks > 0) {
            for place in &places[column.places.clone()] {
                let slot = column.span.firing as usize * rows + place.slot as usize;
                seen[slot].push((column.span.ticks, scanner.turned(column.tick, place.column_tick)));
            }
        }
        let last = (parts.clone(), scanner.lags.clone());
        if !scanner.lags.is_empty() {
            let still = without_span(&scanner, &columns, &places);
            scanner = relagged(scanner, &mut parts, seen, still);
            places.iter_mut().for_each(|place| {
                place.column_tick = scanner.within_turn(place.tick + scanner.lag(place.row as usize));
            });
        } else {
            for (part, seen) in parts.iter_mut().zip(seen) {
                *part = part_of(&counted(seen), 0, 1).map_or(*part, |(part, _)| part);
            }
        }
        if last.0 == parts && last.1 == scanner.lags {
            if used == places.len() {
                break;
            }
            used = places.len();
        }
    }
    Some(with_parts(scanner, &parts))
}

/// For each slot, the ticks since the first slot, in columns that no span explains: perhaps the program did
/// not interpolate azimuths there.
fn without_span(scanner: &Firings, columns: &[Column], places: &[Place]) -> Vec<Vec<i64>> {
    let mut still = vec![Vec::new(); scanner.rows()];
    for column in columns {
        let places = &places[column.places.clone()];
        let is_right =
            |place: &&Place| scanner.tick(place.row as usize, column.tick, column.span) == place.tick;
        let Some(first) = places.first().filter(|first| first.slot == 0) else { continue };
        if 4 * places.iter().filter(is_right).count() < 3 * places.len() {
            for place in places {
                still[place.slot as usize].push(scanner.turned(first.column_tick, place.column_tick));
            }
        }
    }
    still
}

/// The scanner with the lag of each row, near the present one, and the part of a block that explain the most
/// ticks: where blocks differ, a laser that looks back by some ticks can be distinguished from one that fires
/// later. `seen` has the ticks to the next block and those since this one began, for each slot; `still`,
/// those since this one began if there are none to the next.
fn relagged(
    scanner: Firings,
    parts: &mut [f64],
    seen: Vec<Vec<(u32, i64)>>,
    still: Vec<Vec<i64>>,
) -> Firings {
    /// Scanners turn by fewer ticks from block to block; and a sufficient number of columns.
    const WIDEST: i64 = 100;
    const COLUMNS: usize = 2000;
    let ticks = i64::from(scanner.build.ticks);
    let mut lags = scanner.lags.clone();
    for (slot, (seen, still)) in seen.into_iter().zip(still).enumerate() {
        let step = (seen.len() / COLUMNS).max(1);
        let seen = counted(seen.into_iter().step_by(step).collect());
        let still: Vec<i64> = still.into_iter().step_by(step).collect();
        let span = seen.iter().map(|((span, _), _)| i64::from(*span)).max().unwrap_or(0).min(WIDEST);
        let mut best: Option<(usize, f64, i64)> = None;
        let rising = (0..MOST_BLOCKS * span).flat_map(|later| [later, -later]);
        for later in rising {
            let Some((part, count)) = part_of(&seen, later, MOST_BLOCKS) else { continue };
            let count = count + still.iter().filter(|passed| **passed + later == 0).count();
            if best.is_none_or(|(most, ..)| count > most) {
                best = Some((count, part, later));
            }
        }
        if let Some((_, part, later)) = best {
            let lag = &mut lags[scanner.rows_of_slots[slot] as usize];
            (parts[slot], *lag) = (part, (i64::from(*lag) + later).rem_euclid(ticks) as u32);
        }
    }
    scanner.lagging(lags)
}

/// The ticks to the next block and those since this one began, with how many places have the same.
type Counted = ((u32, i64), i64);

/// The same ticks of places, counted.
fn counted(mut seen: Vec<(u32, i64)>) -> Vec<Counted> {
    seen.sort_unstable();
    seen.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as i64)).collect()
}

/// The part of a block, or of up to `most` blocks, that explains the most ticks, and how many, if this one
/// began so many ticks earlier.
fn part_of(seen: &[Counted], earlier: i64, most: i64) -> Option<(f64, usize)> {
    // Where the interval of possible parts begins and ends for each element, and its number of points.
    let mut ends: Vec<(f64, i64)> = Vec::new();
    for &((span, ticks), count) in seen {
        let ticks = ticks + earlier;
        if (0..most * i64::from(span)).contains(&ticks) {
            ends.push((ticks as f64 / f64::from(span), count));
            ends.push(((ticks + 1) as f64 / f64::from(span), -count));
        }
    }
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut inside, mut best) = (0, None);
    for pair in ends.windows(2) {
        inside += pair[0].1;
        if best.is_none_or(|(_, most)| inside > most) && pair[1].0 > pair[0].0 {
            best = Some((0.5 * (pair[0].0 + pair[1].0), inside));
        }
    }
    best.map(|(part, inside)| (part, inside as usize))
}

/// Approximately the part of a block that has passed at each slot of each of its firings, from averages.
fn first_parts(scanner: &Firings, places: &[Place], firings: usize) -> Option<Vec<f64>> {
    /// A firing takes less than one part in this number of a turn.
    const FAR: i64 = 300;
    let rows = scanner.rows();
    let far = i64::from(scanner.build.ticks) / FAR;
    // Average steps from slot to slot.
    let (mut sums, mut counts) = (vec![0i64; rows], vec![0i64; rows]);
    let (mut all, mut slots) = (0, 0);
    for pair in places.windows(2).filter(|pair| pair[1].slot > pair[0].slot) {
        let turned = scanner.turned(pair[0].column_tick, pair[1].column_tick);
        if turned.abs() < far {
            all += turned;
            slots += i64::from(pair[1].slot - pair[0].slot);
            if pair[1].slot == pair[0].slot + 1 {
                sums[pair[1].slot as usize] += turned;
                counts[pair[1].slot as usize] += 1;
            }
        }
    }
    let usual = all as f64 / slots.max(1) as f64;
    let advance = |slot: usize| match counts[slot] {
        0..4 => usual,
        count => sums[slot] as f64 / count as f64,
    };
    let mut offsets = vec![0.0; rows];
    (1..rows).for_each(|slot| offsets[slot] = offsets[slot - 1] + advance(slot));
    // Steps from firing to firing.
    let firsts = places.iter().zip(places.iter().skip(1)).filter(|(a, b)| b.slot <= a.slot).map(|(_, b)| b);
    let starts: Vec<f64> =
        firsts.map(|place| f64::from(place.column_tick) - offsets[place.slot as usize]).collect();
    let turn = f64::from(scanner.build.ticks);
    let mut steps: Vec<f64> = starts
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).rem_euclid(turn))
        .filter(|step| *step > 0.5 && *step < far as f64)
        .collect();
    steps.sort_by(f64::total_cmp);
    let middle = *steps.get(steps.len() / 2)?;
    let (first, block) = if firings == 1 {
        (0.0, middle)
    } else {
        // Short steps are inside a block, unless all steps are about the same.
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        let short = steps.partition_point(|step| *step < mean);
        let of = |steps: &[f64]| steps.get(steps.len() / 2).copied().unwrap_or(mean);
        let (short, long) = (of(&steps[..short]), of(&steps[short..]));
        if long > 1.5 * short { (short, short + long) } else { (mean, 2.0 * mean) }
    };
    let part = |firing: usize, slot: usize| {
        // Ticks are rounded down, so they are half a tick too low on average.
        let half = if firing + slot > 0 { 0.5 } else { 0.0 };
        ((offsets[slot] + firing as f64 * first + half) / block).clamp(0.0, 1.0)
    };
    Some((0..firings).flat_map(|firing| (0..rows).map(move |slot| part(firing, slot))).collect())
}
