//! The values that the article states, for comparison. They were measured on other scenes, of 100 frames
//! each, and on another machine (Intel i5-6300HQ, 2.3 GHz, 4 GB; section VI-A).

/// A remark that is shown with these values.
pub const REMARK: &str = "published, other scenes and another machine";

/// The article's scenes (VI-A).
pub const SCENES: [&str; 4] = ["campus", "city", "road", "residential"];

/// Table I: the compression rate (equation 11) in %, for the scenes and on average. The octree coder is that
/// of the article's reference 21.
pub const COMPRESSION_RATES: [(&str, [f64; 5]); 5] = [
    ("intra coding, LZMA", [3.35, 3.16, 3.84, 4.16, 3.63]),
    ("inter coding, LZMA", [2.47, 3.27, 2.54, 3.68, 2.99]),
    ("octree, 1 mm\u{b3}", [20.73, 20.14, 19.69, 20.35, 20.23]),
    ("octree, 5 mm\u{b3}", [12.95, 12.70, 12.01, 12.57, 12.56]),
    ("octree, 1 cm\u{b3}", [10.53, 10.28, 9.60, 10.15, 10.14]),
];

/// Tables II and III, by scene: KB of the original.
pub const ORIGINAL_KB: [f64; 4] = [3208.0, 3149.0, 3331.0, 3222.0];
/// Table II, by scene: KB after conversion.
pub const CONVERTED_KB: [f64; 4] = [835.0, 837.0, 822.0, 823.0];

/// A coder of the residuals, and the article's values for it.
pub struct PublishedCoder {
    /// Its name.
    pub name: &'static str,
    /// Tables II and III, by scene: KB after intra and after inter coding.
    pub coded_kb: [[f64; 4]; 2],
    /// Tables IV and V: seconds of coding, and in total, for intra and for inter coding.
    pub seconds: [[f64; 2]; 2],
}

/// The coders of Tables II to V.
pub const CODERS: [PublishedCoder; 2] = [
    PublishedCoder {
        name: "LZMA",
        coded_kb: [[105.0, 98.0, 125.0, 132.0], [78.0, 101.0, 83.0, 116.0]],
        seconds: [[0.33, 0.57], [0.33, 27.12]],
    },
    PublishedCoder {
        name: "JPEG 2000",
        coded_kb: [[201.0, 178.0, 240.0, 212.0], [84.0, 159.0, 87.0, 179.0]],
        seconds: [[0.14, 0.38], [0.15, 26.84]],
    },
];

/// Tables II and III, by scene: KB after intra and after inter prediction.
pub const PREDICTED_KB: [[f64; 4]; 2] = [[449.0, 413.0, 513.0, 537.0], [276.0, 376.0, 279.0, 362.0]];

/// Table IV: seconds of clustering and of intra prediction.
pub const INTRA_SECONDS: [f64; 2] = [0.17, 0.07];
/// Table V: seconds of registration and of inter prediction.
pub const INTER_SECONDS: [f64; 2] = [26.47, 0.22];

/// Table VI: seconds of encoding and decoding. Tu-MPEG and Tu-SLAM are the article's references 10 and 12.
/// The first two use LZMA, as their totals in Tables IV and V show.
pub const CODING_SECONDS: [(&str, [f64; 2]); 5] = [
    ("intra coding, LZMA", [0.57, 0.02]),
    ("inter coding, LZMA", [27.12, 0.04]),
    ("octree", [0.024, 0.009]),
    ("Tu-MPEG", [0.50, 0.02]),
    ("Tu-SLAM", [0.10, 0.03]),
];

/// Section VI-B.1, about Figure 13: the best and the worst compression rate in % over all scenes and
/// back-ends, with the back-end, for intra and for inter coding. The rest of the figure is a plot without
/// values.
pub const FIGURE_13: [[(&str, f64); 2]; 2] =
    [[("lzma", 3.16), ("lizard", 10.56)], [("ppmd", 2.41), ("lizard", 8.84)]];
