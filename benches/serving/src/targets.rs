//! Figures that are asked for, and what was found.

use comfy_table::{Table, presets::ASCII_MARKDOWN};
use serde::Serialize;

/// A figure that is asked for.
#[derive(Debug, Serialize)]
pub struct Asked {
    what: String,
    bound: f64,
    at_least: bool,
}

#[derive(Debug, Serialize)]
struct Target {
    asked: Asked,
    found: f64,
    met: bool,
}

/// What was asked and what was found.
#[derive(Debug, Default, Serialize)]
pub struct Targets(Vec<Target>);

impl Asked {
    pub fn most(what: &str, bound: f64) -> Self {
        Self { what: what.to_owned(), bound, at_least: false }
    }

    pub fn least(what: &str, bound: f64) -> Self {
        Self { what: what.to_owned(), bound, at_least: true }
    }
}

impl Targets {
    /// Holds a figure against what is asked. What is no number misses.
    pub fn hold(&mut self, asked: Asked, found: f64) {
        let met = if asked.at_least { found >= asked.bound } else { found <= asked.bound };
        self.0.push(Target { asked, found, met });
    }

    /// Whether every one was met.
    pub fn met(&self) -> bool {
        self.0.iter().all(|target| target.met)
    }

    pub fn table(&self) -> Table {
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN).set_header(["target", "asked", "found", ""]);
        for Target { asked: Asked { what, bound, at_least }, found, met } in &self.0 {
            let asked = format!("{} {bound}", if *at_least { "at least" } else { "at most" });
            table.add_row([what.as_str(), &asked, &time(*found), if *met { "met" } else { "MISSED" }]);
        }
        table
    }
}

/// A figure as it is shown.
pub fn time(milliseconds: f64) -> String {
    format!("{milliseconds:.2}")
}
