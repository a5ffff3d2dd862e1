#![no_main]

#[path = "../targets.rs"]
mod targets;
#[path = "../../tests/common/mod.rs"]
mod common;

libfuzzer_sys::fuzz_target!(|data: &[u8]| targets::journal(data));
