//! The values of a channel, by type.

use crate::scan;

/// The types that the values of a channel may have: integers of 8 to 64 bits, `f32` and `f64`.
pub trait Scalar: Copy + sealed::Value {
    /// The type as a value.
    const TYPE: scan::ScalarType;
}

/// Keeps other crates from implementing [`Scalar`].
mod sealed {
    use super::ChannelValues;

    /// A type of value in [`ChannelValues`].
    pub trait Value: Sized {
        fn into_values(values: Vec<Self>) -> ChannelValues;
        fn of_values(values: &ChannelValues) -> Option<&[Self]>;
    }
}

use sealed::Value;

macro_rules! scalars {
    ($($variant:ident $scalar:ident),*) => {
        /// The values of a channel, point after point, whatever their type.
        #[derive(Clone, Debug, PartialEq)]
        #[non_exhaustive]
        pub enum ChannelValues {
            $(
                #[doc = concat!("Values of type `", stringify!($scalar), "`.")]
                $variant(Vec<$scalar>),
            )*
        }

        impl ChannelValues {
            /// Values from their little-endian bytes; an incomplete value at the end is ignored.
            pub(crate) fn from_le_bytes(scalar: scan::ScalarType, bytes: &[u8]) -> Self {
                match scalar {
                    $(scan::ScalarType::$variant => ChannelValues::$variant(
                        bytes.as_chunks().0.iter().map(|value| $scalar::from_le_bytes(*value)).collect(),
                    ),)*
                }
            }

            /// The little-endian bytes of the values.
            pub(crate) fn to_le_bytes(&self) -> Vec<u8> {
                match self {
                    $(ChannelValues::$variant(values) => {
                        values.iter().flat_map(|value| value.to_le_bytes()).collect()
                    })*
                }
            }

            /// The values as `f64`; integers beyond 2^53 are rounded.
            pub fn to_f64(&self) -> Vec<f64> {
                match self {
                    $(ChannelValues::$variant(values) => values.iter().map(|&value| value as f64).collect(),)*
                }
            }

            /// The type of the values.
            pub fn scalar(&self) -> scan::ScalarType {
                match self {
                    $(ChannelValues::$variant(_) => scan::ScalarType::$variant,)*
                }
            }

            /// Number of values.
            pub fn len(&self) -> usize {
                match self {
                    $(ChannelValues::$variant(values) => values.len(),)*
                }
            }

            /// Whether there are no values.
            pub fn is_empty(&self) -> bool {
                self.len() == 0
            }
        }

        $(
            impl Value for $scalar {
                fn into_values(values: Vec<Self>) -> ChannelValues {
                    ChannelValues::$variant(values)
                }

                fn of_values(values: &ChannelValues) -> Option<&[Self]> {
                    match values {
                        ChannelValues::$variant(values) => Some(values),
                        _ => None,
                    }
                }
            }

            impl Scalar for $scalar {
                const TYPE: scan::ScalarType = scan::ScalarType::$variant;
            }
        )*
    };
}

scalars!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64);
