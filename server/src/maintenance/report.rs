//! The report of `check`, as text and as JSON.

use std::{io::Write, path::PathBuf};

use gleaner_recording::printable;
use serde::Serialize;

/// The severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Severity {
    /// Data is missing or damaged.
    Problem,
    /// For information; no data is lost.
    Note,
}

/// A finding.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Finding {
    pub(super) severity: Severity,
    /// An id, a blob, or a file.
    pub(super) subject: String,
    pub(super) detail: String,
}

/// The extent of a check and its findings.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) data_dir: PathBuf,
    /// The newest migration of the database.
    pub(super) schema: i64,
    /// Whether the content of blobs was read.
    pub(super) digests: bool,
    /// The number of blobs named by rows, and their bytes.
    pub(super) blobs: u64,
    pub(super) bytes: u64,
    /// Whether no finding is a problem.
    pub(super) sound: bool,
    pub(super) findings: Vec<Finding>,
}

impl Report {
    pub(super) fn new(data_dir: PathBuf, schema: i64, digests: bool) -> Self {
        Self { data_dir, schema, digests, blobs: 0, bytes: 0, sound: true, findings: Vec::new() }
    }

    pub(super) fn problem(&mut self, subject: impl Into<String>, detail: impl Into<String>) {
        self.sound = false;
        self.add(Severity::Problem, subject.into(), detail.into());
    }

    pub(super) fn note(&mut self, subject: impl Into<String>, detail: impl Into<String>) {
        self.add(Severity::Note, subject.into(), detail.into());
    }

    fn add(&mut self, severity: Severity, subject: String, detail: String) {
        self.findings.push(Finding { severity, subject, detail });
    }

    /// Writes it as lines of text.
    pub(super) fn write_text(&self, out: &mut impl Write) -> std::io::Result<()> {
        for Finding { severity, subject, detail } in &self.findings {
            let severity = match severity {
                Severity::Problem => "problem",
                Severity::Note => "note",
            };
            writeln!(out, "{severity}: {}: {}", printable::field(subject), printable::field(detail))?;
        }
        let problems = self.findings.iter().filter(|finding| finding.severity == Severity::Problem).count();
        let how = if self.digests { "read" } else { "checked by size only (--fast)" };
        writeln!(out, "schema {}; {} blobs of {} bytes {how}", self.schema, self.blobs, self.bytes)?;
        match problems {
            0 => writeln!(out, "{} is sound", self.data_dir.display()),
            problems => writeln!(out, "{} has {problems} problems", self.data_dir.display()),
        }
    }
}
