//! Values that jobs report while they run. Must not know a job.

/// One value that a job reported.
#[derive(Debug, Clone, PartialEq)]
pub struct Metric {
    /// Order of arrival; `watch` resumes after it.
    pub sequence: i64,
    /// The job's step.
    pub step: u64,
    /// For example `loss_mtp`.
    pub name: String,
    /// Its value.
    pub value: f64,
}
