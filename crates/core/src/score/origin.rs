//! What made a score run: a score job of this server, or a scorer elsewhere.

use crate::{
    Error, NormaliserKind, Result, ScoreSpec, Values,
    id::{EncoderId, JobId, ScoreRunId},
};

/// The scorer of a run whose scores were made elsewhere. No score job has it.
pub const IMPORTED: &str = "imported";

/// What made a score run.
#[derive(Debug, Clone, PartialEq)]
pub enum Origin {
    /// A score job.
    Job {
        /// The job.
        job_id: JobId,
        /// The encoder whose features were compared.
        encoder_id: EncoderId,
        /// Scorer, normaliser, and their settings.
        spec: ScoreSpec,
    },
    /// A scorer elsewhere.
    Import {
        /// The encoder that policies trained on its datasets start from, if one was named.
        encoder_id: Option<EncoderId>,
        /// What made the scores, for people; may be empty.
        source: String,
    },
}

impl Origin {
    /// The job that made it; `None` for an import.
    pub fn job_id(&self) -> Option<&JobId> {
        match self {
            Self::Job { job_id, .. } => Some(job_id),
            Self::Import { .. } => None,
        }
    }

    /// The encoder that policies trained on its datasets start from.
    pub fn encoder_id(&self) -> Option<&EncoderId> {
        match self {
            Self::Job { encoder_id, .. } => Some(encoder_id),
            Self::Import { encoder_id, .. } => encoder_id.as_ref(),
        }
    }

    /// The name of the scorer.
    pub fn scorer(&self) -> &str {
        match self {
            Self::Job { spec, .. } => &spec.scorer.name,
            Self::Import { .. } => IMPORTED,
        }
    }

    /// The default threshold β on q. The q of an import is taken to be linear, as the paper's.
    #[must_use]
    pub fn default_beta(&self) -> f64 {
        let normaliser = match self {
            Self::Job { spec, .. } => spec.normaliser,
            Self::Import { .. } => NormaliserKind::MinMax,
        };
        normaliser.default_beta()
    }

    /// Every setting of the scoring with its value; of an import, the scorer and the source.
    #[must_use]
    pub fn values(&self) -> Values {
        match self {
            Self::Job { spec, .. } => spec.values(),
            Self::Import { source, .. } => [("scorer", IMPORTED), ("source", source)]
                .map(|(name, text)| (name.to_owned(), text.into()))
                .into_iter()
                .collect(),
        }
    }

    /// The job, the encoder and the settings of a run, for work that only a scorer of this server can do.
    ///
    /// # Errors
    /// Precondition for an import; `unable` completes "its scorer …".
    pub fn job(&self, run: &ScoreRunId, unable: &str) -> Result<(&JobId, &EncoderId, &ScoreSpec)> {
        match self {
            Self::Job { job_id, encoder_id, spec } => Ok((job_id, encoder_id, spec)),
            Self::Import { .. } => Err(Error::precondition(format!(
                "{run} was imported, and its scorer is not on this server: it {unable}; use a run of a score job"
            ))),
        }
    }
}
