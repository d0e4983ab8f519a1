//! Writes the settings of every kind of job as JSON to standard output (`make kinds`), for clients in other languages.
#![allow(clippy::print_stdout, reason = "its purpose")]

fn main() -> Result<(), serde_json::Error> {
    println!("{}", serde_json::to_string_pretty(&gleaner_core::jobs())?);
    Ok(())
}
