//! All tests of the library and the program, except those that need the fuzz targets (`fuzz.rs`): one
//! program, which is compiled and linked once. `cargo test --test all exact::` runs those of `exact.rs`.

mod common;
#[path = "common/program.rs"]
mod program;

mod bounded;
mod cli;
mod compensation;
mod cut;
mod damage;
mod exact;
mod examples;
mod firings;
mod golden;
mod hostile;
mod inputs;
mod inter;
mod kill;
mod live;
mod mounting;
mod orientation;
mod paper;
mod recordings;
mod registration;
mod resume;
mod scanner_fit;
mod second_decoder;
mod sizes;
mod sources;
mod trees;
mod vectors;

/// A file that is not listed above would silently not be run.
#[test]
fn every_file_of_tests_is_run() {
    let files = std::fs::read_dir(common::in_package("tests")).unwrap();
    let names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    for module in names.filter_map(|name| name.strip_suffix(".rs").map(str::to_owned)) {
        let line = format!("\nmod {module};\n");
        assert!(
            ["all", "fuzz"].contains(&module.as_str()) || include_str!("all.rs").contains(&line),
            "{module}.rs"
        );
    }
}
