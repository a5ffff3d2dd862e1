//! A cell for the deep model: predictions and contexts. FORMAT.md 8.6, "deep".

use super::fits::Fitted;
use super::{KINDS, MIXERS, OWN_LEVELS, PREDICTORS, ROWS, SETS, VIEWS};
use crate::models::quantise::signed_level;
use crate::models::range::back::{Back, Surroundings};
use crate::models::range::site::{Site, intensity_change, pair};
use crate::models::range::{CONTEXTS, ERROR_LEVELS, NODES};

/// The values of an earlier frame for a cell and around it.
pub struct Referred {
    pub back: Back,
    pub around: Surroundings,
}

/// A cell to be coded.
pub struct DeepSite<'a> {
    pub site: &'a Site,
    pub cell: (usize, usize),
    pub referred: Option<Referred>,
}

/// The contexts that select the weights of the mixers and the maps that refine their result.
#[derive(Clone, Copy)]
pub struct SetContexts {
    /// 0 without a reference, otherwise the class of its errors plus 1.
    pub kind: usize,
    pub error_level: usize,
    /// The row; those below the last row with its own contexts share that row's.
    pub row: usize,
    /// The difference of the intensity from that of the reference; 0 without a reference.
    pub recognition: usize,
}

impl SetContexts {
    /// The contexts of a cell.
    pub fn of(DeepSite { site, cell, referred }: &DeepSite) -> Self {
        let (kind, recognition) = referred.as_ref().map_or((0, 0), |Referred { back, around }| {
            let change = |level| intensity_change(site.intensities[0], level);
            (1 + back.level, 1 + change(around.same_level) * 8 + change(around.moved_level))
        });
        let row = cell.0.min(ROWS - 1);
        SetContexts { kind, error_level: site.error_level, row, recognition }
    }

    /// The weight set of each mixer at a node.
    #[inline]
    pub fn sets(&self, node: usize) -> [usize; MIXERS] {
        [
            (self.kind * NODES + node) * ERROR_LEVELS + self.error_level,
            self.row * NODES + node,
            self.recognition * NODES + node,
        ]
    }
}

impl DeepSite<'_> {
    /// The predictions that are mixed: the line through the two returns to the left, three fits, the left
    /// neighbour for surprises, and the moved layer here and in the neighbouring cells.
    pub fn predictions(&self, fitted: &Fitted) -> [f32; PREDICTORS] {
        let near = &self.site.near;
        let [recent, local, blend] = [fitted.recent, fitted.local, fitted.hinted].map(|fit| near.west + fit);
        let [moved, moved_west, moved_east] = match &self.referred {
            None => [near.west + fitted.wide; 3],
            Some(Referred { back, around }) => [back.moved, around.moved_west, around.moved_east],
        };
        [2.0 * near.west - near.west2, recent, local, blend, near.west, moved, moved_west, moved_east]
            .map(|value| value as f32)
    }

    /// The context of each of the mixture's sets of weights.
    pub fn mixture_contexts(&self, contexts: &SetContexts) -> [usize; SETS] {
        let SetContexts { kind, error_level, recognition, .. } = *contexts;
        [
            kind * CONTEXTS + self.site.context,
            (self.site.change * OWN_LEVELS + own_level(self.site)) * ERROR_LEVELS + error_level,
            (recognition * KINDS + kind) * ERROR_LEVELS + error_level,
        ]
    }

    /// The context of each view for this base.
    pub fn views(&self, contexts: &SetContexts, fitted: &Fitted, base: f64) -> [usize; VIEWS] {
        let SetContexts { kind, error_level, row, recognition, .. } = *contexts;
        let near = &self.site.near;
        let [_, errors, own, change] = self.site.views;
        let wide = near.west + fitted.wide;
        let [same, moved] = self
            .referred
            .as_ref()
            .map_or([wide; 2], |Referred { back, .. }| [back.same, back.moved])
            .map(|range| range - base);
        [
            pair(near.west - base, near.north - base),
            errors,
            own,
            change,
            signed_level(same as i32) * 32 + kind * 4 + error_level / 3,
            pair(same, moved),
            row * ERROR_LEVELS + error_level,
            recognition * ERROR_LEVELS + error_level,
        ]
    }
}

/// The class of the cell's own intensity.
fn own_level(site: &Site) -> usize {
    usize::from(site.intensities[0] / 8).min(OWN_LEVELS - 1)
}
