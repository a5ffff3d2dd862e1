//! Errors in one line: `lidarpc: PATH: what is wrong; what to do`.

use std::io::{self, ErrorKind};

use crate::ground::error::{Error, one_line};

use super::console::to_stderr;

/// Prints the error on stderr and returns the exit code. A closed pipe is not an error: the reader needs no
/// more.
pub fn report(error: &anyhow::Error) -> u8 {
    if is_closed_pipe(error) {
        return DONE;
    }
    say(error);
    if error.is::<NotWhole>() { NOT_WHOLE } else { FAILED }
}

/// The input is damaged or incomplete, but its intact parts were processed and the output exists. This has
/// its own exit code.
#[derive(Debug)]
pub struct NotWhole(pub String);

impl std::fmt::Display for NotWhole {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NotWhole {}

/// The exit codes; clap's for wrong usage is 2.
pub const DONE: u8 = 0;
const FAILED: u8 = 1;
/// The exit code of [`NotWhole`].
const NOT_WHOLE: u8 = 3;

/// Prints the error on stderr.
pub fn say(error: &anyhow::Error) {
    to_stderr(format_args!("lidarpc: {}", line(error)));
}

/// The error in one line: names in it may contain line breaks and control characters.
pub fn line(error: &anyhow::Error) -> String {
    one_line(message(error))
}

/// An error about the file or stream with this name, unless the error itself names a file.
pub fn about(error: Error, name: &str) -> anyhow::Error {
    match error {
        Error::At { .. } | Error::Input { .. } => error.into(),
        _ => error.at(name).into(),
    }
}

/// The contexts, which name the file, then what is wrong and what to do about it. Errors of files all have
/// one; those without are of stdout.
fn message(error: &anyhow::Error) -> String {
    let mut parts = Vec::new();
    if error.is::<io::Error>() && error.chain().count() == 1 {
        parts.push("stdout".to_owned());
    }
    for cause in error.chain() {
        if let Some(error) = cause.downcast_ref::<Error>() {
            parts.push(explain(error));
            break;
        } else if let Some(error) = cause.downcast_ref::<io::Error>() {
            parts.push(describe(error));
            break;
        }
        parts.push(cause.to_string());
    }
    parts.join(": ")
}

/// What is wrong, and what to do about it.
fn explain(error: &Error) -> String {
    match error {
        Error::At { path, source } => format!("{}: {}", path.display(), explain(source)),
        Error::Input { path, what } => format!("{}: {what}", path.display()),
        Error::Io(error) => describe(error),
        other => match advice(other) {
            Some(advice) => format!("{other}; {advice}"),
            None => other.to_string(),
        },
    }
}

/// What to do about an error of the library.
fn advice(error: &Error) -> Option<&'static str> {
    match error {
        Error::BadMagic(_) => Some("give a file that `lidarpc encode` wrote"),
        Error::UnsupportedVersion { .. } | Error::Unsupported { .. } => Some("use a newer lidarpc"),
        Error::Corrupt { .. } => {
            Some("fetch it again, or save what is intact by `lidarpc decode --keep-going`")
        }
        Error::NotBuilt { .. } => Some("use a lidarpc that was built with it"),
        Error::LimitExceeded { .. } => Some(
            "if that is right, allow more by --max-points, --max-file-bytes and so on, as `decode` has them",
        ),
        _ => None,
    }
}

/// The system's error, in words that say what to do.
fn describe(error: &io::Error) -> String {
    let known = match error.kind() {
        ErrorKind::NotFound => "does not exist; check the path",
        ErrorKind::PermissionDenied => "permission denied; check who owns it, or choose another",
        ErrorKind::AlreadyExists => "exists; use --force to overwrite it, or choose another output",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "no space left; free some, or write elsewhere",
        ErrorKind::FileTooLarge => "larger than the system allows; write elsewhere, or raise the limit",
        ErrorKind::IsADirectory => "is a folder; give a file",
        ErrorKind::NotADirectory => "is not a folder; give a folder",
        ErrorKind::ReadOnlyFilesystem => "cannot be written, the file system is read-only; write elsewhere",
        _ => return error.to_string(),
    };
    known.to_owned()
}

/// Whether the error is that the reader of the output has closed the pipe.
pub fn is_closed_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| match cause.downcast_ref() {
        Some(error) => is_closed_pipe_inside(error),
        None => cause.downcast_ref().is_some_and(|e: &io::Error| e.kind() == ErrorKind::BrokenPipe),
    })
}

fn is_closed_pipe_inside(error: &Error) -> bool {
    match error {
        Error::At { source, .. } => is_closed_pipe_inside(source),
        Error::Io(error) => error.kind() == ErrorKind::BrokenPipe,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;

    #[test]
    fn a_message_names_the_file_once_and_says_what_to_do() {
        let missing = || Error::from(io::Error::from(ErrorKind::NotFound)).at("seq/1.bin");
        assert_eq!(message(&missing().into()), "seq/1.bin: does not exist; check the path");
        let full = message(&io::Error::from(ErrorKind::StorageFull).into());
        assert_eq!(full, "stdout: no space left; free some, or write elsewhere");

        let inner: anyhow::Result<()> = Err(Error::corrupt("index").into());
        let error = inner.context("out.lpc").unwrap_err();
        let expected = "out.lpc: damaged stream: index; fetch it again, or save what is intact by \
                        `lidarpc decode --keep-going`";
        assert_eq!(message(&error), expected);
    }
}
