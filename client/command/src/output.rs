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

    /// The command's result: as text, or with `--json` as a document.
    pub(crate) fn result(self, document: impl FnOnce() -> Result<Value>, text: impl FnOnce() -> String) -> Result<()> {
        if self.json { self.line(format_args!("{:#}", document()?)) } else { self.line(text().trim_end()) }
    }

    /// One line of a stream of results. A pipe that was closed is an error like any other; `main` does not
    /// report it.
    pub(crate) fn line(self, line: impl Display) -> Result<()> {
        let escape = if self.json { Escape::Json } else { Escape::Lines };
        Ok(writeln!(io::stdout().lock(), "{}", escape.apply(&line.to_string()))?)
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

/// Columns of the terminal, 80 when there is none.
pub(crate) fn terminal_width() -> usize {
    comfy_table::Table::new().width().map_or(80, usize::from)
}
