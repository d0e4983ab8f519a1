//! The programs that the server starts, which are installed beside it.

use std::path::PathBuf;

use crate::error::{Error, Result};

/// A program that the server starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Program {
    /// Reads one recording, which may be hostile.
    Inspector,
    /// Runs one job.
    Worker,
}

impl Program {
    fn name(self) -> &'static str {
        match self {
            Self::Inspector => "gleaner-inspector",
            Self::Worker => "gleaner-worker",
        }
    }

    /// Its path beside this program: `gleaner-worker` beside `gleaner-server`, with the same suffix.
    ///
    /// # Errors
    /// Internal when the system does not return this program's own path.
    pub(crate) fn path(self) -> Result<PathBuf> {
        let own = std::env::current_exe().map_err(|error| Error::internal("finding this program", error))?;
        let name = own.file_name().unwrap_or_default().to_string_lossy();
        let ending = name.strip_prefix("gleaner-server").unwrap_or_default();
        Ok(own.with_file_name(format!("{}{ending}", self.name())))
    }
}

/// Checks that every program that the server starts is installed.
///
/// # Errors
/// Precondition when one is missing.
pub fn all_installed() -> Result<()> {
    for program in [Program::Inspector, Program::Worker] {
        let path = program.path()?;
        if !path.is_file() {
            let (path, name) = (path.display(), program.name());
            return Err(Error::precondition(format!("{path} is missing: install {name} beside gleaner-server")));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_program_is_named() {
        // The folder of this test has no such program.
        let missing = all_installed().unwrap_err();
        assert!(missing.message().contains("/gleaner-inspector is missing"), "{missing}");
        assert!(Program::Worker.path().unwrap().ends_with("gleaner-worker"));
    }
}
