//! How far the models of the context coder go.

/// How much time models may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Depth {
    /// Hardly any: intensities are not mixed at all.
    Light,
    /// Little: what few contexts are sure of is not mixed.
    Quick,
    /// What streams of version 1 take.
    #[default]
    Mixed,
    /// As much as helps.
    Deep,
}
