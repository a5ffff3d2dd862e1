//! The positions of the fields in a binary record whose header is wrong.
//!
//! PCL writes `COUNT 0` for padding, and some programs declare the gaps in their structures incorrectly. The
//! length of the body then shows how long a record is, and its bytes show where the fields are.

use super::field::Declared;
use crate::scan::{Field, MAX_STRIDE};

/// With fewer points than this, the length of a record is uncertain.
const FEWEST_POINTS: u64 = 100;
/// Largest number of records that are examined.
const MOST_SAMPLES: usize = 2000;

/// A field and its position in a record.
struct Placed<'f, 'a> {
    declared: &'f Declared<'a>,
    at: usize,
}

/// The fields of the records with which `body` begins, according to its bytes; `None` if there is no reason
/// to doubt the declaration.
pub(super) fn find(fields: &[Declared], body: &[u8], points: u64) -> Option<Vec<Field>> {
    let declared: u64 = fields.iter().map(|field| u64::from(field.width)).sum();
    let first_empty = fields.iter().position(|field| field.width == 0);
    let fits = points.checked_mul(declared).is_some_and(|bytes| bytes <= body.len() as u64);
    if (fits && first_empty.is_none()) || points < FEWEST_POINTS || points > body.len() as u64 {
        return None;
    }
    let is_whole = (body.len() as u64).is_multiple_of(points);
    let stride = if fits { declared } else { body.len() as u64 / points };
    if !(fits || is_whole) || !(1..=u64::from(MAX_STRIDE)).contains(&stride) {
        return None;
    }
    let stride = stride as usize;
    // As declared; as a structure without the padding after the first field of width 0; without any padding.
    let candidates = [
        declared_places(fields),
        aligned_places(fields, first_empty.unwrap_or(0)),
        aligned_places(fields, 0),
    ];
    let placed = candidates.into_iter().flatten().filter(|placed| ends_within(placed, stride));
    // The first one wins ties.
    let best =
        placed.rev().max_by(|a, b| steadiness(a, body, stride).total_cmp(&steadiness(b, body, stride)))?;
    Some(with_padding(&best, stride))
}

/// Places each field where the declaration says; `None` if the record is too long.
fn declared_places<'f, 'a>(fields: &'f [Declared<'a>]) -> Option<Vec<Placed<'f, 'a>>> {
    let mut at = 0;
    let mut placed = Vec::new();
    for declared in fields {
        if declared.width > 0 && !declared.is_padding() {
            placed.push(Placed { declared, at });
        }
        at = end(at, declared)?;
    }
    Some(placed)
}

/// Places each value at a multiple of its size, as compilers do; declared padding counts only before field
/// number `until`. `None` if the record is too long.
fn aligned_places<'f, 'a>(fields: &'f [Declared<'a>], until: usize) -> Option<Vec<Placed<'f, 'a>>> {
    let mut at = 0;
    let mut placed = Vec::new();
    for (number, declared) in fields.iter().enumerate() {
        if !declared.is_padding() && declared.width > 0 {
            let size = declared.scalar.map_or(1, |scalar| scalar.size() as usize);
            at = usize::next_multiple_of(at, size);
            placed.push(Placed { declared, at });
        }
        if !declared.is_padding() || number < until {
            at = end(at, declared)?;
        }
    }
    Some(placed)
}

/// Where a field at this position ends; `None` if the record is too long.
fn end(at: usize, declared: &Declared) -> Option<usize> {
    let end = at as u64 + u64::from(declared.width);
    (end <= MAX_STRIDE.into()).then_some(end as usize)
}

fn ends_within(placed: &[Placed], stride: usize) -> bool {
    placed.iter().all(|field| field.at + field.declared.width as usize <= stride)
}

/// How often the highest byte of a value equals that of the preceding record: numbers change little from
/// point to point, while their lower bytes change at random. Values that never change are no evidence, since
/// padding does not change either.
fn steadiness(placed: &[Placed], body: &[u8], stride: usize) -> f64 {
    let records = body.len() / stride;
    let step = (records / MOST_SAMPLES).max(1);
    let of_field = |field: &Placed| {
        let size = field.declared.scalar.map_or(1, |scalar| scalar.size() as usize);
        let sampled = (1..records).step_by(step);
        let pairs =
            sampled.map(|next| (&body[(next - 1) * stride..][..stride], &body[next * stride..][..stride]));
        let (mut same, mut changed, mut count) = (0u32, false, 0u32);
        for (a, b) in pairs {
            let (a, b) = (&a[field.at..field.at + size], &b[field.at..field.at + size]);
            same += u32::from(a[size - 1] == b[size - 1]);
            changed = changed || a != b;
            count += 1;
        }
        if changed { f64::from(same) / f64::from(count.max(1)) } else { 0.0 }
    };
    placed.iter().map(of_field).sum()
}

/// The fields with padding between them, filling the record.
fn with_padding(placed: &[Placed], stride: usize) -> Vec<Field> {
    let mut fields = Vec::new();
    let mut filled = 0;
    for Placed { declared, at } in placed {
        if filled < *at {
            fields.push(Field::padding((at - filled) as u32));
        }
        fields.extend(declared.field());
        filled = at + declared.width as usize;
    }
    if filled < stride {
        fields.push(Field::padding((stride - filled) as u32));
    }
    fields
}

#[cfg(test)]
mod tests {
    use crate::files::tests::{comes_back, pcd};
    use crate::scan::{ScalarType, ScanFile};

    /// 48-byte records: a structure of x, y, z, intensity, a time and a ring.
    fn body(points: u32) -> Vec<u8> {
        let mut body = Vec::new();
        for n in 0..points {
            let mut record = [0xa5u8; 48];
            let angle = f64::from(n) * 0.01;
            for (at, value) in [(0, 9.0 * angle.cos()), (4, 9.0 * angle.sin()), (8, 1.5), (16, 20.0)] {
                record[at..at + 4].copy_from_slice(&(value as f32 + (n % 7) as f32 * 0.01).to_le_bytes());
            }
            record[24..32].copy_from_slice(&(1.6e9 + f64::from(n) * 1e-5).to_le_bytes());
            record[32..34].copy_from_slice(&((n % 40) as u16).to_le_bytes());
            body.extend(record);
        }
        body
    }

    fn file(counts: &str, points: u32) -> ScanFile {
        let (names, sizes, types) =
            ("x y z _ intensity _ timestamp _ ring _", "4 4 4 1 4 1 8 1 2 1", "F F F U F U F U U U");
        let header = pcd(names, sizes, types, counts, points.into(), "binary");
        comes_back("a.pcd", [header, body(points)].concat())
    }

    fn is_understood(scan: &ScanFile) {
        assert_eq!((scan.layout.stride(), scan.layout.position_offsets()), (48, Some([0, 4, 8])));
        assert_eq!(scan.layout.intensity_offset(), Some((16, ScalarType::F32)));
        let places: Vec<_> = scan
            .layout
            .channels()
            .filter(|(_, f)| !f.name.is_empty())
            .map(|(at, f)| (at, &f.name[..]))
            .collect();
        assert_eq!(places, [(24, "timestamp"), (32, "ring")]);
    }

    #[test]
    fn places_that_are_declared_wrongly_are_found() {
        is_understood(&file("1 1 1 4 1 0 1 6 1 12", 500));
        // The length of the record is wrong, too.
        let scan = file("1 1 1 4 1 0 1 9 1 16", 500);
        assert_eq!((scan.records, scan.suffix.len()), (500, 0));
        is_understood(&scan);
    }

    #[test]
    fn fields_beyond_the_longest_records_are_not_looked_for() {
        // On 32-bit systems, the sum of these widths overflows to a small number.
        let header = pcd("_ a x y z t", "1 4 4 4 4 8", "U F F F F F", "4294967280 4 1 1 1 0", 500, "binary");
        comes_back("a.pcd", [header, body(500)].concat());
    }

    #[test]
    fn what_is_declared_rightly_stays() {
        is_understood(&file("1 1 1 4 1 4 1 0 1 14", 500));
        let scan = file("1 1 1 4 1 4 1 6 1 8", 500);
        assert!(
            scan.layout.channels().any(|(at, field)| at == 38 && field.name == "ring"),
            "no reason to doubt"
        );
        // Truncated; nothing suggests that records are shorter.
        let (points, cut) = (500, 48 * 500 - 7);
        let header = pcd("x y z _", "4 4 4 1", "F F F U", "1 1 1 36", points, "binary");
        let scan = comes_back("a.pcd", [&header, &body(500)[..cut]].concat());
        assert_eq!((scan.records, scan.suffix.len()), (499, 41));
    }
}
