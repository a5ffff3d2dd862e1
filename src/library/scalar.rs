//! The values of a channel, by type.

use crate::scan;

/// The types that the values of a channel may have: integers of 8 to 64 bits, `f32` and `f64`.
pub trait Scalar: Copy + sealed::Value {
    /// The type as a value.
    const TYPE: scan::ScalarType;
}

/// Keeps other crates from implementing [`Scalar`].
mod sealed {
    use super::Values;

    /// A type of value in [`Values`].
    pub trait Value: Sized {
        fn into_values(values: Vec<Self>) -> Values;
        fn of_values(values: &Values) -> Option<&[Self]>;
    }
}

use sealed::Value;

macro_rules! scalars {
    ($($variant:ident $scalar:ident),*) => {
        /// The values of a channel, point after point.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Values {
            $($variant(Vec<$scalar>),)*
        }

        impl Values {
            /// Values from their little-endian bytes; an incomplete value at the end is ignored.
            pub fn from_bytes(scalar: scan::ScalarType, bytes: &[u8]) -> Self {
                match scalar {
                    $(scan::ScalarType::$variant => Values::$variant(
                        bytes.as_chunks().0.iter().map(|value| $scalar::from_le_bytes(*value)).collect(),
                    ),)*
                }
            }

            /// The little-endian bytes of the values.
            pub fn to_bytes(&self) -> Vec<u8> {
                match self {
                    $(Values::$variant(values) => {
                        values.iter().flat_map(|value| value.to_le_bytes()).collect()
                    })*
                }
            }

            /// The type of the values.
            pub fn scalar(&self) -> scan::ScalarType {
                match self {
                    $(Values::$variant(_) => scan::ScalarType::$variant,)*
                }
            }

            /// Number of values.
            pub fn len(&self) -> usize {
                match self {
                    $(Values::$variant(values) => values.len(),)*
                }
            }
        }

        $(
            impl Value for $scalar {
                fn into_values(values: Vec<Self>) -> Values {
                    Values::$variant(values)
                }

                fn of_values(values: &Values) -> Option<&[Self]> {
                    match values {
                        Values::$variant(values) => Some(values),
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
