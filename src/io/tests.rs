use super::*;

/// Little-endian bytes of float32 values.
pub(super) fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Parses a file and checks the promise: the same bytes and the same name come back.
pub(super) fn comes_back(name: &str, bytes: Vec<u8>) -> ScanFile {
    let file = parse(name, bytes.clone());
    assert_eq!(file.name, name);
    assert!(file.to_bytes().unwrap() == bytes, "{name} comes back changed");
    file
}
