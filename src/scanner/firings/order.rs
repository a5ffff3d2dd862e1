//! The order in which lasers fire, and how the azimuth goes on while they do, from points in the order of a file.

use super::projection::{Place, nearest};
use super::{Firings, Timing, WHOLE};

/// The elevations of Velodyne's VLP-16 in degrees, in the order in which its lasers fire.
pub(super) const VLP_16: [i32; 16] = [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15];

/// The part of the steps from one laser to another that are the same if all of a firing have one azimuth.
pub(super) const STEADY: f64 = 0.93;

/// The order in which lasers fire.
pub(super) struct Order {
    pub rows_of_slots: Vec<u32>,
    /// Whole ticks that each row is ahead.
    pub shifts: Vec<f64>,
    pub timing: Timing,
    /// Whether this timing is that of the scanner.
    pub is_steady: bool,
}

/// Finds the order of the lasers from rows and ticks in the order of a file. None if they are not in the order of
/// firings.
pub(super) fn order(sequence: &[(usize, u32)], rows: usize, ticks: u32) -> Option<Order> {
    /// Fewer steps than these say nothing.
    const FEWEST: usize = 8;
    let mut order = cycle(sequence, rows)?;
    let mut slots = vec![0; rows];
    order.iter().enumerate().for_each(|(slot, &row)| slots[row] = slot);
    let turned = |from: u32, to: u32| {
        let turn = i64::from(ticks);
        (i64::from(to) - i64::from(from) + turn / 2).rem_euclid(turn) - turn / 2
    };
    // The steps from each laser to each that follows it in the file.
    let mut steps: Vec<Vec<i64>> = vec![Vec::new(); rows * rows];
    for pair in sequence.windows(2) {
        let [(from, before), (to, after)] = [pair[0], pair[1]];
        steps[slots[from] * rows + slots[to]].push(turned(before, after));
    }
    // The most frequent step, and how many are the same.
    let mode = |steps: &mut Vec<i64>| {
        steps.sort_unstable();
        let most = steps.chunk_by(|a, b| a == b).max_by_key(|same| same.len());
        most.map_or((0, 0), |same| (same[0], same.len()))
    };
    let modes: Vec<(i64, usize)> = steps.iter_mut().map(mode).collect();
    // Those from each slot to the next one, the last followed by the first.
    let next = |slot: usize| slot * rows + (slot + 1) % rows;
    let share = |slot: usize| modes[next(slot)].1 as f64 / steps[next(slot)].len().max(1) as f64;
    let mean = |slot: usize| {
        let steps = &steps[next(slot)];
        steps.iter().sum::<i64>() as f64 / steps.len().max(1) as f64
    };
    let known = (0..rows * rows).filter(|&pair| steps[pair].len() >= FEWEST);
    let (same, all) = known.fold((0, 0), |(same, all), pair| (same + modes[pair].1, all + steps[pair].len()));
    // The steps from the last laser of a firing to the first of the next may differ.
    let ends = sequence.len() / rows.max(1);
    if same as f64 >= STEADY * all.saturating_sub(ends) as f64 {
        // One azimuth a firing: its end is where the steps differ most, or else, if the scanner turns by the same from
        // firing to firing, where it goes back from one end of the rows to the other.
        let seen = (0..rows).filter(|&slot| steps[next(slot)].len() >= FEWEST);
        let worst = seen.min_by(|&a, &b| share(a).total_cmp(&share(b))).unwrap_or(0);
        let jump = |slot: &usize| order[*slot].abs_diff(order[(*slot + 1) % rows]);
        let longest = (0..rows).rev().max_by_key(jump).unwrap_or(0);
        let start = (if share(worst) < STEADY { worst } else { longest } + 1) % rows;
        let (mut shifts, mut shift) = (vec![0.0; rows], 0);
        for slot in 0..rows {
            let place = (start + slot) % rows;
            shifts[order[place]] = shift as f64;
            shift += modes[next(place)].0;
        }
        order.rotate_left(start);
        let rows_of_slots = order.into_iter().map(|row| row as u32).collect();
        return Some(Order { rows_of_slots, shifts, timing: Timing::Together, is_steady: true });
    }
    // The longest step is the one to the next firing.
    let last = (0..rows).max_by(|&a, &b| mean(a).abs().total_cmp(&mean(b).abs()))?;
    order.rotate_left((last + 1) % rows);
    let rows_of_slots = order.into_iter().map(|row| row as u32).collect();
    Some(Order { rows_of_slots, shifts: vec![0.0; rows], timing: Timing::Together, is_steady: false })
}

/// The order of a VLP-16, if these are its elevations.
pub(super) fn vlp_16(elevations: &[f64]) -> Option<Order> {
    let row = |degrees: i32| {
        let row = nearest(elevations, f64::from(degrees).to_radians());
        ((elevations[row].to_degrees() - f64::from(degrees)).abs() < 0.1).then_some(row as u32)
    };
    let rows_of_slots: Option<Vec<u32>> = VLP_16.map(row).into_iter().collect();
    let is_all = elevations.len() == VLP_16.len();
    let order = |rows_of_slots| Order {
        rows_of_slots,
        shifts: vec![0.0; VLP_16.len()],
        timing: Timing::Vlp16,
        is_steady: true,
    };
    rows_of_slots.filter(|_| is_all).map(order)
}

/// The rows in the order in which they follow one another, round and round, beginning anywhere. None if they do not.
fn cycle(sequence: &[(usize, u32)], rows: usize) -> Option<Vec<usize>> {
    /// Rounds that tell enough.
    const ROUNDS: usize = 500;
    let mut counts = vec![0u32; rows];
    sequence.iter().for_each(|(row, _)| counts[*row] += 1);
    let again = sequence.windows(2).filter(|pair| pair[0].0 == pair[1].0).count();
    if again * 2 > sequence.len() {
        return None;
    }
    // Rounds begin with the row that is seen most.
    let first = (0..rows).rev().max_by_key(|&row| counts[row])?;
    let rounds = sequence.chunk_by(|_, next| next.0 != first);
    let is_single = |round: &&[(usize, u32)]| {
        let mut seen = vec![false; rows];
        round.len() > 1 && round.iter().all(|(row, _)| !std::mem::replace(&mut seen[*row], true))
    };
    let rounds: Vec<_> = rounds.filter(is_single).collect();
    let mut before = vec![0u32; rows * rows];
    for round in rounds.iter().step_by((rounds.len() / ROUNDS).max(1)) {
        for (place, (row, _)) in round.iter().enumerate() {
            round[place + 1..].iter().for_each(|(later, _)| before[row * rows + later] += 1);
        }
    }
    let precedes = |a: usize, b: usize| before[a * rows + b] > before[b * rows + a];
    let mut order: Vec<usize> = (0..rows).collect();
    order.sort_by_cached_key(|&row| {
        (row != first, rows - (0..rows).filter(|&other| precedes(row, other)).count())
    });
    Some(order)
}

/// The same scanner with a timing of so many firings a block, whose parts come out of the points; none if they tell none.
pub(super) fn timed(scanner: &Firings, places: &[Place], firings: usize) -> Option<Firings> {
    /// Rounds after which the parts do not change any more.
    const ROUNDS: usize = 6;
    let rows = scanner.rows();
    let mut parts = first_parts(scanner, places, firings)?;
    for _ in 0..ROUNDS {
        let of_parts: Vec<u32> = parts.iter().map(|part| (part * f64::from(WHOLE)) as u32).collect();
        let columns = scanner.clone().with_timing(Timing::Parts(of_parts)).columns(places);
        // For each slot of each firing: the ticks to the next block, and those from this one.
        let mut seen: Vec<Vec<(u32, i64)>> = vec![Vec::new(); parts.len()];
        for column in columns.iter().filter(|column| column.span.ticks > 0) {
            for place in &places[column.places.clone()] {
                let slot = column.span.firing as usize * rows + place.slot as usize;
                seen[slot].push((column.span.ticks, scanner.turned(column.tick, place.tick)));
            }
        }
        let last = parts.clone();
        for (part, seen) in parts.iter_mut().zip(seen) {
            *part = part_of(seen).unwrap_or(*part);
        }
        if last == parts {
            break;
        }
    }
    let of_parts = parts.iter().map(|part| (part * f64::from(WHOLE)) as u32).collect();
    Some(scanner.clone().with_timing(Timing::Parts(of_parts)))
}

/// The part of a block by which the most ticks come out, each as ticks to the next block and from this one.
fn part_of(mut seen: Vec<(u32, i64)>) -> Option<f64> {
    seen.retain(|(span, ticks)| (0..i64::from(*span)).contains(ticks));
    seen.sort_unstable();
    // Where intervals of parts begin and end, and how many points are in each.
    let mut ends: Vec<(f64, i64)> = Vec::new();
    for same in seen.chunk_by(|a, b| a == b) {
        let ((span, ticks), count) = (same[0], same.len() as i64);
        ends.push((ticks as f64 / f64::from(span), count));
        ends.push(((ticks + 1) as f64 / f64::from(span), -count));
    }
    ends.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut inside, mut best) = (0, (0, None));
    for pair in ends.windows(2) {
        inside += pair[0].1;
        if inside > best.0 && pair[1].0 > pair[0].0 {
            best = (inside, Some(0.5 * (pair[0].0 + pair[1].0)));
        }
    }
    best.1
}

/// About which part of a block has passed at each slot of each of its firings, from what passes on the average.
fn first_parts(scanner: &Firings, places: &[Place], firings: usize) -> Option<Vec<f64>> {
    /// The part of a turn that passes in no firing.
    const FAR: i64 = 300;
    let rows = scanner.rows();
    let far = i64::from(scanner.build.ticks) / FAR;
    // From slot to slot.
    let (mut sums, mut counts) = (vec![0i64; rows], vec![0i64; rows]);
    let (mut all, mut slots) = (0, 0);
    for pair in places.windows(2).filter(|pair| pair[1].slot > pair[0].slot) {
        let turned = scanner.turned(pair[0].tick, pair[1].tick);
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
    // From firing to firing.
    let firsts = places.iter().zip(places.iter().skip(1)).filter(|(a, b)| b.slot <= a.slot).map(|(_, b)| b);
    let starts: Vec<f64> = firsts.map(|place| f64::from(place.tick) - offsets[place.slot as usize]).collect();
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
        // The short steps are those inside a block, if they are not all the same.
        let mean = steps.iter().sum::<f64>() / steps.len() as f64;
        let short = steps.partition_point(|step| *step < mean);
        let of = |steps: &[f64]| steps.get(steps.len() / 2).copied().unwrap_or(mean);
        let (short, long) = (of(&steps[..short]), of(&steps[short..]));
        if long > 1.5 * short { (short, short + long) } else { (mean, 2.0 * mean) }
    };
    let part = |firing: usize, slot: usize| {
        // Rounded down, ticks are half a tick too few on the average.
        let half = if firing + slot > 0 { 0.5 } else { 0.0 };
        ((offsets[slot] + firing as f64 * first + half) / block).clamp(0.0, 1.0)
    };
    Some((0..firings).flat_map(|firing| (0..rows).map(move |slot| part(firing, slot))).collect())
}
