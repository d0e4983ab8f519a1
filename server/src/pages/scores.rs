//! Score runs of the pages, handed to the store and to the scores in memory. Must not contain a rule of its own.

use std::sync::Arc;

use async_trait::async_trait;
use gleaner_web::{RunSummary, Scores};

use super::PageBackend;
use crate::{
    curation::Summary,
    domain::{
        curation::SegmentRef,
        id::{EncoderId, EpisodeId, ScoreRunId, TaskId},
        score::{EpisodeScores, Histogram, ScoreRun},
        selection::{ExpertRanking, Selection, WhatIf},
    },
    error::Result,
};

#[async_trait]
impl Scores for PageBackend {
    async fn score_run(&self, id: &ScoreRunId) -> Result<ScoreRun> {
        self.services.store.score_run(id).await
    }

    async fn score_runs(&self, task: &TaskId) -> Result<Vec<ScoreRun>> {
        self.services.store.score_runs(task).await
    }

    async fn runs_that_scored(&self, task: &TaskId, episode: &EpisodeId) -> Result<Vec<ScoreRunId>> {
        self.services.store.runs_that_scored(task, episode).await
    }

    async fn episode_scores(&self, run: &ScoreRunId, episode: &EpisodeId) -> Result<EpisodeScores> {
        self.services.store.episode_scores(run, episode).await
    }

    async fn segment_length(&self, encoder: Option<&EncoderId>) -> Result<u32> {
        self.services.store.segment_length(encoder).await
    }

    async fn expert_segments(&self, run: &ScoreRun) -> Result<u64> {
        Ok(self.services.store.run_counts(run).await?.expert_segments)
    }

    async fn summary(&self, run: &ScoreRunId) -> Result<Arc<dyn RunSummary>> {
        Ok(Arc::new(Scored(self.services.curation.summary(run).await?)))
    }
}

/// A run's summary behind the trait of the pages.
struct Scored(Arc<Summary>);

#[async_trait]
impl RunSummary for Scored {
    fn run(&self) -> &ScoreRun {
        self.0.run()
    }

    fn mean_q(&self, episode: &EpisodeId) -> Option<f64> {
        self.0.mean_q(episode)
    }

    async fn what_if(&self, selection: Selection) -> Result<WhatIf> {
        self.0.what_if(selection).await
    }

    async fn histogram(&self, bins: usize) -> Result<Histogram> {
        self.0.histogram(bins).await
    }

    async fn expert_ranking(&self) -> Result<ExpertRanking> {
        self.0.expert_ranking().await
    }

    async fn best(&self, most: usize) -> Result<Vec<SegmentRef>> {
        self.0.best(most).await
    }

    async fn worst(&self, most: usize) -> Result<Vec<SegmentRef>> {
        self.0.worst(most).await
    }
}
