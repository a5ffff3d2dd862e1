//! The radius outlier filter (article, III-A, equation 1; R. B. Rusu's RadiusOutlierRemoval).

#[cfg(feature = "article")]
mod search;

/// Removes points with few other points near them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RadiusOutlier {
    /// n: a point with fewer neighbours than this is an outlier.
    pub neighbours: usize,
    /// d: the greatest distance of a neighbour, in metres.
    pub radius_m: f64,
}

impl Default for RadiusOutlier {
    /// The article's 2 neighbours within 0.38 m, which is the distance between two columns at 120 m.
    fn default() -> Self {
        RadiusOutlier { neighbours: 2, radius_m: 0.38 }
    }
}
