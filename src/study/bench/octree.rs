//! An octree coder of point clouds, for comparison: that of the article's references 9 and 21, as in Table I.
//!
//! Space is divided into voxels; the occupied ones are the leaves of a tree in which each inner node is a
//! cube of eight parts. Level by level, the byte of each node that says which of its eight parts contain
//! points is coded with adaptive binary probabilities in the context of the level (J. Elseberg et al. for the
//! tree, R. Mekuria et al. for the arithmetic coding of its bytes), then the number of points in each voxel.
//! Only positions are kept, and not their order. A point decodes to the centre of its voxel; centres are
//! multiples of the voxels' side, so that coordinates on that grid are preserved.

use super::sample::is_return;
use crate::entropy::{AdaptiveBit, ArithmeticDecoder, ArithmeticEncoder, BitCoder, IntegerModel};
use crate::ground::error::{Error, Result};
use crate::ground::varint::{read_signed, read_unsigned, write_signed, write_unsigned};

/// The largest number of levels below the root, such that the path to a leaf fits 128 bits.
const MOST_LEVELS: u32 = 42;
/// Voxels are numbered from the scanner; points farther than this along an axis are left out.
const FARTHEST: f64 = (1u64 << (MOST_LEVELS - 2)) as f64;
/// The largest number of points that a decoder accepts.
const MOST_POINTS: u64 = 1 << 28;

/// A coded cloud.
pub struct Encoded {
    /// The stream.
    pub bytes: Vec<u8>,
    /// Number of points in it: those that are returns.
    pub points: u64,
    /// Number of voxels that contain a point.
    pub voxels: u64,
}

/// The voxel of a return; `None` for a point that is not finite or too far away, or that is at the scanner
/// itself, as files store records without a return.
fn voxel_of(point: &[f32; 3], voxel_m: f64) -> Option<[i64; 3]> {
    let voxel = point.map(|metres| (f64::from(metres) / voxel_m).round());
    (is_return(point) && voxel.iter().all(|place| place.abs() < FARTHEST))
        .then(|| voxel.map(|place| place as i64))
}

/// Codes positions, in metres, in voxels with sides of `voxel_um` micrometres, which is not 0.
pub fn encode(positions: &[[f32; 3]], voxel_um: u32) -> Encoded {
    let voxel_m = f64::from(voxel_um) * 1e-6;
    let voxels: Vec<[i64; 3]> = positions.iter().filter_map(|point| voxel_of(point, voxel_m)).collect();
    let mut bytes = Vec::new();
    write_unsigned(&mut bytes, u64::from(voxel_um));
    write_unsigned(&mut bytes, voxels.len() as u64);
    let bound = |axis: usize| {
        let places = voxels.iter().map(|voxel| voxel[axis]);
        Some((places.clone().min()?, places.max()?))
    };
    let [Some(x), Some(y), Some(z)] = [0, 1, 2].map(bound) else {
        return Encoded { bytes, points: 0, voxels: 0 };
    };
    let origin = [x.0, y.0, z.0];
    let largest = [x, y, z].map(|(least, most)| most - least).into_iter().max().unwrap_or_default();
    let levels = u64::BITS - (largest as u64).leading_zeros();
    origin.iter().for_each(|place| write_signed(&mut bytes, *place));
    write_unsigned(&mut bytes, u64::from(levels));

    let path = |voxel: &[i64; 3]| path([0, 1, 2].map(|axis| (voxel[axis] - origin[axis]) as u64), levels);
    let mut paths: Vec<u128> = voxels.iter().map(path).collect();
    paths.sort_unstable();
    let (leaves, counts): (Vec<_>, Vec<_>) =
        paths.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u64)).unzip();
    let mut coder = ArithmeticEncoder::default();
    // The encoder has valid data, so no error is possible.
    let coded = code_leaves(&mut coder, &leaves, levels, leaves.len());
    debug_assert!(coded.is_ok_and(|coded| coded == leaves));
    code_counts(&mut coder, &counts, leaves.len());
    bytes.extend(coder.finish());
    Encoded { bytes, points: voxels.len() as u64, voxels: leaves.len() as u64 }
}

/// The inverse of [`encode`]: the centre of the voxel of each point, in metres, points of a voxel being
/// consecutive.
///
/// # Errors
/// If the bytes are not such a stream.
pub fn decode(mut bytes: &[u8]) -> Result<Vec<[f32; 3]>> {
    let input = &mut bytes;
    let voxel_m = read_unsigned(input, "side of a voxel")? as f64 * 1e-6;
    let points = read_unsigned(input, "number of points")?;
    if points == 0 {
        return Ok(Vec::new());
    }
    let mut origin = [0; 3];
    for place in &mut origin {
        *place = read_signed(input, "origin of the tree")?;
    }
    let levels = read_unsigned(input, "levels of the tree")?;
    let is_near = origin.iter().all(|place| (place.unsigned_abs() as f64) < FARTHEST);
    if levels > u64::from(MOST_LEVELS) || points > MOST_POINTS || !is_near {
        return Err(Error::corrupt(format!("a tree of {levels} levels and {points} points")));
    }
    let levels = levels as u32;
    let mut coder = ArithmeticDecoder::new(input);
    let leaves = code_leaves(&mut coder, &[], levels, points as usize)?;
    let counts = code_counts(&mut coder, &[], leaves.len());
    let sum = counts.iter().try_fold(0u64, |sum, &count| sum.checked_add(count));
    if sum != Some(points) {
        return Err(Error::corrupt("an octree whose voxels do not hold its points"));
    }
    let mut positions = Vec::with_capacity(points as usize);
    for (leaf, &count) in leaves.iter().zip(&counts) {
        let voxel = voxel_at(*leaf, levels);
        let centre: [f32; 3] =
            std::array::from_fn(|axis| ((origin[axis] + voxel[axis] as i64) as f64 * voxel_m) as f32);
        positions.extend(std::iter::repeat_n(centre, count as usize));
    }
    Ok(positions)
}

/// The path from the root to a voxel: for each level, from the top, which of the eight parts.
fn path(voxel: [u64; 3], levels: u32) -> u128 {
    let part = |level: u32| voxel.iter().fold(0, |part, place| part << 1 | u128::from(place >> level & 1));
    (0..levels).rev().fold(0, |path, level| path << 3 | part(level))
}

/// The inverse of [`path`].
fn voxel_at(path: u128, levels: u32) -> [u64; 3] {
    let place = |axis: u32| {
        (0..levels).fold(0, |place, level| place | ((path >> (3 * level + 2 - axis) & 1) as u64) << level)
    };
    [0, 1, 2].map(place)
}

/// Codes the paths to the leaves, in ascending order; a decoder passes none, and `most` limits their number.
fn code_leaves<C: BitCoder>(coder: &mut C, leaves: &[u128], levels: u32, most: usize) -> Result<Vec<u128>> {
    let mut nodes = vec![0];
    for level in (0..levels).rev() {
        let mut model = ByteModel::default();
        let mut rest = leaves;
        let mut below = Vec::with_capacity(nodes.len());
        for &node in &nodes {
            let inside = rest.iter().take_while(|leaf| **leaf >> (3 * (level + 1)) == node).count();
            let (of_node, others) = rest.split_at(inside);
            rest = others;
            let occupied = of_node.iter().fold(0, |parts, leaf| parts | 1u8 << (leaf >> (3 * level) & 7));
            let occupied = model.code(coder, occupied);
            below.extend((0..8).filter(|part| occupied >> part & 1 == 1).map(|part| node << 3 | part));
        }
        if below.len() > most || below.is_empty() || coder.is_exhausted() {
            return Err(Error::corrupt("an octree of more nodes than points"));
        }
        nodes = below;
    }
    Ok(nodes)
}

/// Codes the number of points in each voxel, at least one.
fn code_counts<C: BitCoder>(coder: &mut C, counts: &[u64], voxels: usize) -> Vec<u64> {
    let (mut is_shared, mut more) = (AdaptiveBit::default(), IntegerModel::default());
    let count = |voxel: usize| {
        let count = counts.get(voxel).copied().unwrap_or(1);
        match is_shared.code(coder, count > 1) {
            true => more.code(coder, count.saturating_sub(2)).saturating_add(2),
            false => 1,
        }
    };
    (0..voxels).map(count).collect()
}

/// The probabilities for the bytes of a level: of each bit in the context of those above it.
struct ByteModel {
    nodes: [AdaptiveBit; 256],
}

impl Default for ByteModel {
    fn default() -> Self {
        ByteModel { nodes: [AdaptiveBit::default(); 256] }
    }
}

impl ByteModel {
    fn code<C: BitCoder>(&mut self, coder: &mut C, byte: u8) -> u8 {
        let above = |node: usize, bit: u32| {
            node << 1 | usize::from(self.nodes[node].code(coder, byte >> bit & 1 == 1))
        };
        (0..8).rev().fold(1, above) as u8
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::random::Rng;

    /// Points on the ground and on a wall, on a grid of 1 mm, some of them twice.
    fn scene() -> Vec<[f32; 3]> {
        let mut random = Rng::keyed(7, &[]);
        let mut metres = |low: f64, high: f64| (random.between(low, high) * 1e3).round() / 1e3;
        let ground = (0..3000).map(|_| [metres(-20.0, 20.0), metres(-20.0, 20.0), -1.7]).collect::<Vec<_>>();
        let wall = (0..3000).map(|_| [12.0, metres(0.0, 10.0), metres(0.0, 3.0)]).collect::<Vec<_>>();
        let again = ground.iter().step_by(100).copied().collect::<Vec<_>>();
        [ground, wall, again].concat().into_iter().map(|point| point.map(|metres| metres as f32)).collect()
    }

    fn sorted(mut points: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
        points.sort_by(|a, b| a.partial_cmp(b).unwrap());
        points
    }

    #[test]
    fn points_on_the_grid_come_back_in_another_order() {
        let points = scene();
        let encoded = encode(&points, 1000);
        assert_eq!(encoded.points, points.len() as u64);
        assert!(encoded.voxels < encoded.points, "some are shared");
        assert!(sorted(decode(&encoded.bytes).unwrap()) == sorted(points));
    }

    #[test]
    fn points_move_to_the_centres_of_their_voxels() {
        let points = scene();
        let mut before = usize::MAX;
        for voxel_um in [5000, 50_000, 700_000] {
            let encoded = encode(&points, voxel_um);
            let voxel_m = f64::from(voxel_um) * 1e-6;
            let centre = |metres: f32| ((f64::from(metres) / voxel_m).round() * voxel_m) as f32;
            let centres = points.iter().map(|point| point.map(centre)).collect();
            assert!(sorted(decode(&encoded.bytes).unwrap()) == sorted(centres), "{voxel_um}");
            assert!(encoded.bytes.len() < before, "coarser is smaller");
            before = encoded.bytes.len();
        }
    }

    #[test]
    fn flat_scenes_cost_less_than_their_coordinates() {
        let points = scene();
        let bits = 8 * encode(&points, 1000).bytes.len() / points.len();
        assert!(bits < 3 * 16, "{bits}");
    }

    #[test]
    fn what_is_no_return_is_left_out() {
        let odd = [[f32::NAN, 0.0, 0.0], [0.0; 3], [-0.0; 3], [f32::INFINITY, 1.0, 1.0], [3e38, 0.0, 0.0]];
        let none = encode(&odd, 1000);
        assert_eq!((none.points, decode(&none.bytes).unwrap()), (0, vec![]));
        let far = [[1.0, 2.0, 3.0], [-9e5, 8e5, 7e5]];
        let encoded = encode(&[&odd[..], &far].concat(), 1000);
        assert_eq!((encoded.points, encoded.voxels), (2, 2));
        assert_eq!(sorted(decode(&encoded.bytes).unwrap()), [[-9e5, 8e5, 7e5], [1.0, 2.0, 3.0]]);
        let one = encode(&[[1.5, 0.25, -7.0]; 4], 1000);
        assert_eq!(decode(&one.bytes).unwrap(), [[1.5, 0.25, -7.0]; 4]);
    }

    #[test]
    fn damaged_streams_do_not_panic() {
        let bytes = encode(&scene(), 10_000).bytes;
        for length in 1..6 {
            assert!(decode(&bytes[..length]).is_err(), "cut within the header");
        }
        let mut other_count = bytes.clone();
        other_count[2] ^= 1;
        assert!(decode(&other_count).is_err(), "not so many points");
        let mut random = Rng::keyed(1, &[]);
        for _ in 0..200 {
            let mut bytes = bytes.clone();
            let place = random.below(bytes.len());
            bytes[place] ^= 1 << random.below(8);
            let _ = decode(&bytes);
        }
    }
}
