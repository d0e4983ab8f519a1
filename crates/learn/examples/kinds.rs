//! Writes every policy, weighting, objective and scorer as JSON to standard output (`make kinds`).
#![allow(clippy::print_stdout, reason = "its purpose")]

fn main() -> Result<(), serde_json::Error> {
    println!("{}", serde_json::to_string_pretty(&gleaner_learn::kinds())?);
    Ok(())
}
