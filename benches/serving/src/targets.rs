//! Targets: figures, their bounds, and whether they are met.

use comfy_table::{Table, presets::ASCII_MARKDOWN};
use serde::Serialize;

/// The bound of a figure.
#[derive(Debug, Serialize)]
pub struct Bound {
    what: String,
    value: f64,
    at_least: bool,
}

#[derive(Debug, Serialize)]
struct Target {
    bound: Bound,
    found: f64,
    met: bool,
}

/// Targets in the order of their measurement.
#[derive(Debug, Default, Serialize)]
pub struct Targets(Vec<Target>);

impl Bound {
    pub fn at_most(what: &str, value: f64) -> Self {
        Self { what: what.to_owned(), value, at_least: false }
    }

    pub fn at_least(what: &str, value: f64) -> Self {
        Self { what: what.to_owned(), value, at_least: true }
    }
}

impl Targets {
    /// Compares a figure with its bound. NaN misses every target.
    pub fn hold(&mut self, bound: Bound, found: f64) {
        let met = if bound.at_least { found >= bound.value } else { found <= bound.value };
        self.0.push(Target { bound, found, met });
    }

    /// Whether every target is met.
    pub fn met(&self) -> bool {
        self.0.iter().all(|target| target.met)
    }

    pub fn table(&self) -> Table {
        let mut table = Table::new();
        table.load_style(ASCII_MARKDOWN).set_header(["quantity", "target", "found", ""]);
        for Target { bound: Bound { what, value, at_least }, found, met } in &self.0 {
            let target = format!("{} {value}", if *at_least { "at least" } else { "at most" });
            table.add_row([what.as_str(), &target, &time(*found), if *met { "met" } else { "MISSED" }]);
        }
        table
    }
}

/// A time or a ratio with two digits.
pub fn time(milliseconds: f64) -> String {
    format!("{milliseconds:.2}")
}
