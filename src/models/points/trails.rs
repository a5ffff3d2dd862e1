//! The trails of a frame: the points of one laser, one after the other, as far as the points themselves tell.
//! FORMAT.md 8.4.
//!
//! Trails form a ring in the order in which their lasers fire. From a point's trail, the next point's is
//! found by asking trail after trail whether it goes on.

use crate::entropy::{AdaptiveBit, BitCoder};
use crate::models::LeastSquares;

/// Largest number of trails at a time; a new one then replaces the one that follows it.
const MOST: usize = 256;
/// A trail that did not go on so many times in a row has ended.
const PATIENCE: u8 = 100;

/// A trail.
#[derive(Clone)]
pub struct Trail {
    /// Its number, which was that of trails that have ended.
    pub number: u8,
    /// The index of its last point, and of the one before, which is the same at first.
    pub last: [usize; 2],
    /// How its height changes with its position, in 0.1 mm.
    pub cone: LeastSquares<4>,
    /// For each coordinate, the recent size of residuals.
    pub errors: [f32; 3],
    /// Whether it went on the last times that it was asked, the latest in the lowest bit.
    history: u32,
    /// The number of times in a row that it did not.
    missed: u8,
}

impl Trail {
    fn new(number: u8, index: usize) -> Self {
        Trail {
            number,
            last: [index; 2],
            cone: LeastSquares::new(0.9).solved_every(1),
            errors: [super::FIRST_ERROR; 3],
            history: 1,
            missed: 0,
        }
    }

    /// The context of its next answer: its own last answers, and the last two of other trails.
    fn context(&self, answers: usize) -> usize {
        let long_ago = (self.history >> 6 & 0xff).count_ones() as usize / 2;
        (self.history & 0x3f) as usize | answers << 6 | long_ago.min(3) << 8
    }
}

/// The adaptive models of trails.
#[derive(Clone)]
pub struct TrailModel {
    begins: [AdaptiveBit; 2],
    goes_on: Vec<AdaptiveBit>,
}

impl Default for TrailModel {
    fn default() -> Self {
        TrailModel { begins: Default::default(), goes_on: vec![AdaptiveBit::default(); 1 << 10] }
    }
}

/// The trails of a frame so far, in the order of the ring.
#[derive(Default)]
pub struct Trails {
    ring: Vec<Trail>,
    /// The place of the last point's trail.
    at: usize,
    /// Whether the last point began a trail.
    began: bool,
    /// The last two answers.
    answers: usize,
}

impl Trails {
    /// Codes which trail a point continues, and moves to it; an encoder passes the index of the point before
    /// it in its trail. Returns false if the point begins a trail.
    pub fn code<C: BitCoder>(
        &mut self,
        coder: &mut C,
        model: &mut TrailModel,
        index: usize,
        before: Option<usize>,
    ) -> bool {
        let next = |steps: usize| (self.at + steps) % self.ring.len();
        let mut steps = 1..=self.ring.len();
        let wanted = before.and_then(|before| steps.find(|steps| self.ring[next(*steps)].last[0] == before));
        self.began =
            model.begins[usize::from(self.began)].code(coder, wanted.is_none()) || self.ring.is_empty();
        if self.began {
            self.begin(index);
            return false;
        }
        let trails = self.ring.len();
        let (mut steps, mut has_ended) = (0, false);
        loop {
            steps += 1;
            let place = (self.at + steps) % trails;
            let trail = &mut self.ring[place];
            let goes_on = model.goes_on[trail.context(self.answers)].code(coder, wanted == Some(steps));
            self.answers = (self.answers << 1 | usize::from(goes_on)) & 3;
            trail.history = trail.history << 1 | u32::from(goes_on);
            trail.missed = trail.missed.saturating_add(1);
            // In a damaged stream no trail may go on.
            if goes_on || steps > trails {
                trail.missed = 0;
                self.at = place;
                break;
            }
            has_ended |= trail.missed > PATIENCE;
        }
        if has_ended {
            self.end_some();
        }
        true
    }

    /// The trail of the last point.
    pub fn current(&mut self) -> Option<&mut Trail> {
        self.ring.get_mut(self.at)
    }

    /// Adds a trail after the last point's.
    fn begin(&mut self, index: usize) {
        let place = if self.ring.is_empty() { 0 } else { self.at + 1 };
        if self.ring.len() == MOST {
            let place = place % MOST;
            self.ring[place] = Trail::new(self.ring[place].number, index);
            self.at = place;
            return;
        }
        let mut is_used = [false; MOST];
        self.ring.iter().for_each(|trail| is_used[usize::from(trail.number)] = true);
        let number = is_used.iter().position(|is_used| !is_used).unwrap_or(0);
        self.ring.insert(place, Trail::new(number as u8, index));
        self.at = place;
    }

    /// Removes the trails that have ended.
    fn end_some(&mut self) {
        let ended_before = self.ring[..self.at].iter().filter(|trail| trail.missed > PATIENCE).count();
        self.ring.retain(|trail| trail.missed <= PATIENCE);
        self.at -= ended_before;
    }
}
