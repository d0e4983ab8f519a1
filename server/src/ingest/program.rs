//! The path of the inspector program.

use std::path::PathBuf;

use crate::error::{Error, Result};

/// The inspector, installed beside this program: `gleaner-inspector` beside `gleaner-server`.
pub(super) fn program() -> Result<PathBuf> {
    let own = std::env::current_exe().map_err(|error| Error::internal("finding this program", error))?;
    let name = own.file_name().unwrap_or_default().to_string_lossy();
    Ok(own.with_file_name(match name.strip_prefix("gleaner-server") {
        Some(rest) => format!("gleaner-inspector{rest}"),
        None => "gleaner-inspector".to_owned(),
    }))
}

/// Checks that the inspector is installed.
///
/// # Errors
/// Precondition when it is missing.
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
    fn a_missing_program_is_named() {
        // Beside this test there is none.
        let missing = can_inspect().unwrap_err();
        assert!(missing.message().contains("/gleaner-inspector is missing"), "{missing}");
    }
}
