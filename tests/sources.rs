//! Consistency of documents and sources: folders use only those listed before them, files of the command line
//! do not use each other in circles, files that code or parse parts of a stream cite their sections of
//! FORMAT.md, and cited sections exist.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::in_package;

/// The folders and files of `src` in the order of ARCHITECTURE.md: each may use those before it. `lib.rs` and
/// `main.rs` use all.
const FOLDERS: [&str; 19] = [
    "ground",
    "container",
    "scan",
    "files",
    "entropy",
    "scanner",
    "backend",
    "inter",
    "models",
    "article",
    "frame",
    "stream",
    "edit",
    "study",
    "library",
    "recordings",
    "cli",
    "python",
    "wasm",
];

/// All files below a folder with this extension.
fn files_below(folder: &Path, extension: &str, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files_below(&path, extension, files);
        } else if path.extension().is_some_and(|found| found == extension) {
            files.push(path);
        }
    }
}

/// The source files with their paths below `src`, with `/` on every system.
fn sources() -> BTreeMap<String, String> {
    let src = in_package("src");
    let mut files = Vec::new();
    files_below(&src, "rs", &mut files);
    let named = |path: &PathBuf| {
        let name = path.strip_prefix(&src).unwrap().to_string_lossy().replace('\\', "/");
        (name, fs::read_to_string(path).unwrap())
    };
    files.iter().map(named).collect()
}

/// Lines of code without the unit tests, which may use anything: they are at the end of a file, or in a file
/// of their own.
fn code(name: &str, text: &str) -> Vec<String> {
    if name.ends_with("/tests.rs") || name.ends_with("/testing.rs") {
        return Vec::new();
    }
    let lines: Vec<&str> = text.lines().collect();
    let is_tests = |pair: &[&str]| {
        pair[0].starts_with("#[cfg(") && pair[0].contains("test") && pair[1].starts_with("mod tests {")
    };
    let end = lines.windows(2).position(is_tests).unwrap_or(lines.len());
    let is_code = |line: &&&str| !line.trim_start().starts_with("//");
    lines[..end].iter().filter(is_code).map(|line| (*line).to_owned()).collect()
}

/// The names that follow `crate::` in a line.
fn used(line: &str) -> impl Iterator<Item = &str> {
    line.split("crate::").skip(1).map(|rest| {
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        &rest[..end]
    })
}

#[test]
fn folders_use_those_above_them() {
    let place = |folder: &str| FOLDERS.iter().position(|known| *known == folder);
    let mut wrong = Vec::new();
    for (name, text) in sources() {
        let folder = name.split(['/', '.']).next().unwrap();
        if ["lib", "main"].contains(&folder) {
            continue;
        }
        let own = place(folder).unwrap_or_else(|| panic!("src/{name} is in no folder of the list"));
        for line in code(&name, &text) {
            // Names other than those of folders are re-exports of lib.rs.
            let below = used(&line).any(|found| place(found).is_some_and(|other| other > own));
            if below {
                wrong.push(format!("src/{name}: {}", line.trim()));
            }
        }
    }
    assert!(wrong.is_empty(), "folders use others that stand below them:\n{}", wrong.join("\n"));
}

/// The first names below a path such as `super::`, wherever code uses it, also in braces.
fn names_below<'t>(code: &'t str, path: &'t str) -> impl Iterator<Item = &'t str> {
    code.split(path).skip(1).flat_map(|rest| {
        let names = rest.strip_prefix('{').map_or(rest, |rest| rest.split('}').next().unwrap());
        let most = if rest.starts_with('{') { usize::MAX } else { 1 };
        let name = |text: &'t str| text.trim().split(|c: char| !c.is_alphanumeric() && c != '_').next();
        names.split(',').take(most).filter_map(name)
    })
}

/// A file and the folder of the same name count as one. `mod.rs` uses all files.
#[test]
fn files_of_the_command_line_do_not_use_each_other_in_circles() {
    let mut files = BTreeMap::<String, String>::new();
    for (name, text) in sources() {
        let Some(file) = name.strip_prefix("cli/").filter(|file| *file != "mod.rs") else { continue };
        let file = file.split(['/', '.']).next().unwrap().to_owned();
        files.entry(file).or_default().push_str(&code(&name, &text).join("\n"));
    }
    let uses = |(file, code): (&String, &String)| {
        let names = ["super::", "crate::cli::"].into_iter().flat_map(|path| names_below(code, path));
        let used = names.filter(|used| *used != file && files.contains_key(*used));
        (file.clone(), used.map(str::to_owned).collect::<BTreeSet<_>>())
    };
    let mut uses: BTreeMap<_, _> = files.iter().map(uses).collect();
    assert!(uses["dispatch"].contains("encode") && uses["stats"].contains("readable"));
    // A file that uses none of the others is in no circle, so it does not matter which files use it.
    while let Some(file) = uses.keys().find(|file| uses[*file].is_empty()).cloned() {
        uses.remove(&file);
        for used in uses.values_mut() {
            used.remove(&file);
        }
    }
    // Each file that is left uses another that is left, so this path comes back to where it has been.
    let mut path: Vec<_> = uses.keys().take(1).collect();
    while let Some(next) = path.last().and_then(|file| uses[*file].first()) {
        if let Some(start) = path.iter().position(|file| *file == next) {
            panic!("files of src/cli use each other in a circle: {:?}", &path[start..]);
        }
        path.push(next);
    }
}

#[test]
fn folders_are_listed_in_their_order() {
    let text = fs::read_to_string(in_package("ARCHITECTURE.md")).unwrap();
    let named = |line: &str| {
        let (name, _) = line.strip_prefix("- **`")?.split_once("`**")?;
        Some(name.trim_end_matches(".rs").to_owned())
    };
    assert_eq!(text.lines().filter_map(named).collect::<Vec<_>>(), FOLDERS);
}

/// Those of the standard library differ from system to system, so that streams, or their encoder's choices,
/// would as well.
#[test]
fn functions_of_angles_and_logarithms_come_from_libm() {
    const FUNCTIONS: [&str; 21] = [
        "sin", "cos", "tan", "sin_cos", "asin", "acos", "atan", "atan2", "hypot", "cbrt", "exp", "exp2",
        "exp_m1", "ln", "ln_1p", "log", "log2", "log10", "powf", "powi", "mul_add",
    ];
    let is_of_std = |line: &str| {
        FUNCTIONS.iter().any(|name| {
            let methods = [format!(".{name}("), format!("f32::{name}"), format!("f64::{name}")];
            methods.iter().any(|method| line.contains(method))
        })
    };
    let mut wrong = Vec::new();
    for (name, text) in sources() {
        let lines = code(&name, &text);
        let found = lines.iter().filter(|line| is_of_std(line) && !name.starts_with("study/"));
        wrong.extend(found.map(|line| format!("src/{name}: {}", line.trim())));
    }
    assert!(wrong.is_empty(), "use those of libm:\n{}", wrong.join("\n"));
    assert!(is_of_std("let range = x.hypot(y);") && !is_of_std("let range = libm::hypot(x, y);"));
}

/// A number such as `8` or `8.16` at the beginning of a text, and what follows it.
fn number_of_section(text: &str) -> Option<(&str, &str)> {
    let digits = |text: &str| text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let mut end = digits(text);
    if end == 0 {
        return None;
    }
    if let Some(rest) = text[end..].strip_prefix('.') {
        let more = digits(rest);
        end += if more > 0 { 1 + more } else { 0 };
    }
    Some(text.split_at(end))
}

/// The sections of FORMAT.md that a text cites, as `FORMAT 8.5, 8.6` or `FORMAT.md 6.1 to 6.3`.
fn cited(text: &str) -> Vec<&str> {
    let mut found = Vec::new();
    for behind in text.split("FORMAT").skip(1) {
        let behind = behind.strip_prefix(".md").unwrap_or(behind);
        let mut next = behind.strip_prefix(' ');
        while let Some((number, rest)) = next.and_then(number_of_section) {
            found.push(number);
            next = [", ", " and ", " to "].iter().find_map(|between| rest.strip_prefix(between));
        }
    }
    found
}

#[test]
fn sections_of_the_format_that_are_cited_exist() {
    let format = fs::read_to_string(in_package("FORMAT.md")).unwrap();
    let number = |line: &str| Some(line.strip_prefix("##")?.trim_start_matches('#').trim_start().to_owned());
    let headings: Vec<_> = format.lines().filter_map(number).collect();
    let known: BTreeSet<_> =
        headings.iter().filter_map(|heading| Some(number_of_section(heading)?.0)).collect();
    let (mut count, mut wrong) = (0, Vec::new());
    for (name, text) in sources() {
        for number in cited(&text) {
            count += 1;
            if !known.contains(number) {
                wrong.push(format!("src/{name}: FORMAT.md {number}"));
            }
        }
    }
    assert!(wrong.is_empty(), "no such section of FORMAT.md:\n{}", wrong.join("\n"));
    assert!(count > 90, "only {count} citations are found");
    assert_eq!(
        cited("// FORMAT 8.5, 8.16, equation 9, and FORMAT.md 6.1 to 6.3."),
        ["8.5", "8.16", "6.1", "6.3"]
    );
}

/// The description at the beginning of a file, in one line.
fn description(text: &str) -> String {
    text.lines().map_while(|line| line.strip_prefix("//!")).collect()
}

#[test]
fn files_that_code_or_parse_parts_of_a_stream_cite_the_format() {
    const SIGNS: [&str; 6] =
        ["BitCoder", "TokenCoder", "fn read_from", "fn from_payload", "fn from_bytes", "fn from_record"];
    // The formats of the compressors are described elsewhere, and what experiments code is in no stream.
    const EXCEPTIONS: [&str; 2] = ["backend/", "study/"];
    let (mut count, mut wrong) = (0, Vec::new());
    for (name, text) in sources() {
        let is_exception = EXCEPTIONS.iter().any(|folder| name.starts_with(folder));
        let has_sign = |line: &String| SIGNS.iter().any(|sign| line.contains(sign));
        if is_exception || !code(&name, &text).iter().any(has_sign) {
            continue;
        }
        count += 1;
        if cited(&description(&text)).is_empty() {
            wrong.push(format!("src/{name}"));
        }
    }
    assert!(wrong.is_empty(), "no section of FORMAT.md is cited at the beginning of:\n{}", wrong.join("\n"));
    assert!(count > 60, "only {count} files are found");
    assert_eq!(cited(&description("//! Points. FORMAT.md\n//! 8.4.\n\nuse std::fs;")), ["8.4"]);
}
