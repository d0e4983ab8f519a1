//! The one place that prints: results to standard output, everything else to standard error.
//!
//! Results are either for people (text) or for programs (`--json`: one document, or one line for each item of
//! a stream). Hints and notes are for people alone.
//!
//! Names, labels and messages come from recordings and servers: unprintable characters leave here only as escapes.

use std::fmt::Display;
use std::io::{self, IsTerminal as _, Write as _};

use gleaner_recording::printable::{self, Escape};
use serde_json::Value;

use crate::failure::{Failure, Result};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Output {
    json: bool,
}

impl Output {
    pub(crate) fn new(json: bool) -> Self {
        Self { json }
    }

    pub(crate) fn json(self) -> bool {
        self.json
    }

    /// Whether progress bars may be drawn.
    pub(crate) fn interactive(self) -> bool {
        !self.json && io::stderr().is_terminal()
    }

    /// The command's result: as text, or with `--json` as a document. A reader that has closed the pipe hides neither
    /// what the command still does nor its failure.
    pub(crate) fn result(self, document: impl FnOnce() -> Result<Value>, text: impl FnOnce() -> String) -> Result<()> {
        let printed = if self.json {
            write(&mut io::stdout().lock(), Escape::Json, &format!("{:#}", document()?))
        } else {
            write(&mut io::stdout().lock(), Escape::Lines, text().trim_end())
        };
        unless_closed(printed)
    }

    /// One line of a stream of JSON values, with `--json` or without it. A pipe that was closed is an error like any
    /// other; `main` does not report it.
    pub(crate) fn json_line(self, value: &Value) -> Result<()> {
        write(&mut io::stdout().lock(), Escape::Json, &value.to_string())
    }

    /// The sensible next command.
    pub(crate) fn next(self, hint: impl Display) {
        self.note(format_args!("next: {hint}"));
    }

    /// A note for people beside the result.
    pub(crate) fn note(self, text: impl Display) {
        if !self.json {
            // A failure to write to a closed terminal has no other place to be reported.
            let _ = writeln!(io::stderr().lock(), "{}", Escape::Lines.apply(&text.to_string()));
        }
    }

    pub(crate) fn error(self, failure: &Failure) {
        // One line, whatever the server wrote.
        let text = failure.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        let _ = writeln!(io::stderr().lock(), "error: {}", printable::field(&text));
    }

    /// Arguments that cannot be used, in the parser's own words, which repeat them.
    pub(crate) fn usage(problem: &clap::Error) {
        let text = problem.render().to_string();
        let _ = write!(io::stderr().lock(), "{}", Escape::Lines.apply(&text));
    }
}

/// What was printed, if a reader has not closed the pipe before.
pub(crate) fn unless_closed(printed: Result<()>) -> Result<()> {
    match printed {
        Err(failure) if failure.is_broken_pipe() => Ok(()),
        printed => printed,
    }
}

fn write(out: &mut impl io::Write, escape: Escape, text: &str) -> Result<()> {
    Ok(writeln!(out, "{}", escape.apply(text))?)
}

/// Columns of the terminal, 80 when there is none.
pub(crate) fn terminal_width() -> usize {
    comfy_table::Table::new().width().map_or(80, usize::from)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pipe whose reader has ended.
    struct Closed(io::ErrorKind);

    impl io::Write for Closed {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_closed_pipe_does_not_end_a_command_before_its_failure() {
        let printed = |kind| write(&mut Closed(kind), Escape::Lines, "1 rejected");
        assert!(printed(io::ErrorKind::BrokenPipe).unwrap_err().is_broken_pipe());
        assert!(unless_closed(printed(io::ErrorKind::BrokenPipe)).is_ok());
        assert!(unless_closed(printed(io::ErrorKind::StorageFull)).is_err());
    }

    #[test]
    fn a_line_of_json_is_json_whatever_is_in_it() {
        let value = serde_json::json!({ "key": "a\u{200b}b\u{202e}\u{7f}" });
        let mut out = Vec::new();
        write(&mut out, Escape::Json, &value.to_string()).unwrap();
        assert!(out.is_ascii());
        assert_eq!(serde_json::from_slice::<Value>(&out).unwrap(), value);
    }
}
