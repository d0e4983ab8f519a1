//! Where the program is that inspects recordings.

use std::path::PathBuf;

use crate::error::{Error, Result};

/// The program that inspects, which is installed beside this one: `gleaner-inspector` beside `gleaner-server`.
pub(super) fn program() -> Result<PathBuf> {
    let own = std::env::current_exe().map_err(|error| Error::internal("finding this program", error))?;
    let name = own.file_name().unwrap_or_default().to_string_lossy();
    Ok(own.with_file_name(match name.strip_prefix("gleaner-server") {
        Some(rest) => format!("gleaner-inspector{rest}"),
        None => "gleaner-inspector".to_owned(),
    }))
}

/// Whether recordings can be inspected here.
///
/// # Errors
/// Precondition when the program for it is not there.
pub fn can_inspect() -> Result<()> {
    let program = program()?;
    if program.is_file() {
        return Ok(());
    }
    let program = program.display();
    Err(Error::precondition(format!("{program} is missing: install gleaner-inspector beside gleaner-server")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_is_missing_is_named() {
        // Beside this test there is none.
        let missing = can_inspect().unwrap_err();
        assert!(missing.message().contains("/gleaner-inspector is missing"), "{missing}");
    }
}
