//! What the stages found, fetched from the server and put in the cells' places.

use std::collections::{HashMap, HashSet};

use futures::{StreamExt as _, TryStreamExt as _};
use gleaner_client::Client;
use gleaner_proto::v1::{
    CountKeptRequest, GetEpisodeScoresRequest, GetEvaluationRequest, GetScoreRunRequest, GetSnapshotRequest, JobState,
    Role,
};

use super::file::{Experiment, Study};
use super::follow::seconds;
use super::order;
use super::pool::pool;
use super::recordings::{Recordings, of_episode};
use super::report::{CellReport, Rate, SeedReport, StageReport, StudyReport};
use super::stage::{Chain, Graph, Selection};
use super::study::Cell;
use super::submit::{Made, Submitted};
use crate::failure::{Result, present};
use crate::quality::{MarkedEpisode, Selected, Separation, above, best, histogram, select, separations};
use crate::words;

// Requests under way at the same time.
const PARALLEL: usize = 8;

/// A score run's scores beside the marks.
struct Run {
    episodes: Vec<MarkedEpisode>,
    separation: Vec<Separation>,
    histogram: Vec<[u32; 2]>,
}

/// Fetches results; a score run that several cells share is fetched once.
pub(crate) struct Gatherer<'a> {
    client: &'a Client,
    recordings: &'a Recordings,
    graph: &'a Graph,
    submitted: &'a Submitted,
    runs: HashMap<usize, Run>,
}

impl<'a> Gatherer<'a> {
    pub(crate) fn new(
        client: &'a Client,
        recordings: &'a Recordings,
        graph: &'a Graph,
        submitted: &'a Submitted,
    ) -> Self {
        Self { client, recordings, graph, submitted, runs: HashMap::new() }
    }

    pub(crate) async fn studies(mut self, experiment: &Experiment) -> Result<Vec<StudyReport>> {
        let graph = self.graph;
        let mut studies = Vec::with_capacity(experiment.studies.len());
        for (study, chains) in experiment.studies.iter().zip(&graph.chains) {
            studies.push(self.study(study, chains).await?);
        }
        Ok(studies)
    }

    async fn study(&mut self, study: &Study, chains: &[Vec<Chain>]) -> Result<StudyReport> {
        let mut cells = Vec::with_capacity(study.cells.len());
        for (cell, chains) in study.cells.iter().zip(chains) {
            let mut seeds = Vec::with_capacity(chains.len());
            for chain in chains {
                seeds.push(self.seed(cell, chain).await?);
            }
            let Cell { label, varied, settings } = cell.clone();
            cells.push(CellReport { label, varied, settings, pooled: pool(&seeds), seeds });
        }
        let stages: HashSet<usize> = chains.iter().flatten().flat_map(|chain| chain.stages.iter().copied()).collect();
        let took = |index: &usize| self.made(*index).ok().and_then(|made| made.job.as_ref().and_then(seconds));
        Ok(StudyReport {
            name: study.name.clone(),
            table: study.table,
            cells,
            machine_seconds: stages.iter().filter_map(took).sum(),
            stages: stages.len(),
        })
    }

    async fn seed(&mut self, cell: &Cell, chain: &Chain) -> Result<SeedReport> {
        let problem = chain.stages.iter().find_map(|index| {
            let kind = self.graph.stages[*index].work.kind();
            self.made(*index).err().map(|problem| format!("{kind} failed: {problem}"))
        });
        let mut report = SeedReport {
            seed: chain.seed,
            problem,
            success: None,
            selected: None,
            separation: Vec::new(),
            histogram: Vec::new(),
        };
        if let Some(Ok(made)) = chain.evaluation.map(|index| self.made(index)) {
            report.success = Some(self.success(&made.id).await?);
        }
        if let Some(index) = chain.score
            && let Ok(made) = self.made(index)
        {
            let id = made.id.clone();
            if !self.runs.contains_key(&index) {
                let run = self.run(&id).await?;
                self.runs.insert(index, run);
            }
            let run = present(self.runs.get(&index), "a score run")?;
            report.separation.clone_from(&run.separation);
            report.histogram.clone_from(&run.histogram);
            report.selected = Some(self.selected(run, &id, cell).await?);
        }
        Ok(report)
    }

    async fn success(&self, evaluation_id: &str) -> Result<Rate> {
        let request = GetEvaluationRequest { evaluation_id: evaluation_id.to_owned() };
        let reply = self.client.policies().get_evaluation(request).await?.into_inner();
        let evaluation = present(reply.evaluation, "an evaluation")?;
        Ok(Rate::new(evaluation.successes, evaluation.episodes))
    }

    async fn run(&self, run_id: &str) -> Result<Run> {
        let request = GetScoreRunRequest { score_run_id: run_id.to_owned() };
        let run = self.client.scores().get_score_run(request).await?.into_inner().score_run;
        let request = GetSnapshotRequest { snapshot_id: present(run, "a score run")?.snapshot_id };
        let snapshot = self.client.snapshots().get_snapshot(request).await?.into_inner();
        let imperfect = snapshot.episodes.into_iter().filter(|episode| episode.role() == Role::Imperfect);
        let fetch = imperfect.map(|episode| self.episode(run_id, episode.episode_id));
        let mut episodes: Vec<MarkedEpisode> = futures::stream::iter(fetch).buffered(PARALLEL).try_collect().await?;
        episodes.sort_by(|one, two| (&one.cohort, &one.id).cmp(&(&two.cohort, &two.id)));
        Ok(Run { separation: separations(&episodes), histogram: histogram(&episodes), episodes })
    }

    async fn episode(&self, run_id: &str, episode_id: String) -> Result<MarkedEpisode> {
        let recording = of_episode(self.recordings, &episode_id)?;
        let request = GetEpisodeScoresRequest { score_run_id: run_id.to_owned(), episode_id: episode_id.clone() };
        let scores = self.client.scores().get_episode_scores(request).await?.into_inner().scores;
        let scores = present(scores, "scores")?;
        Ok(MarkedEpisode {
            id: episode_id,
            cohort: recording.cohort.clone(),
            mark: recording.mark.clone(),
            q: scores.q,
            w: scores.w,
        })
    }

    async fn selected(&self, run: &Run, run_id: &str, cell: &Cell) -> Result<Selected> {
        let Some(top) = cell.settings.top else {
            return Ok(select(&run.episodes, above(cell.settings.beta)));
        };
        let request = CountKeptRequest {
            score_run_id: run_id.to_owned(),
            selections: vec![order::selection(Selection::Top(top))],
            per_episode: false,
        };
        let counts = self.client.scores().count_kept(request).await?.into_inner().counts;
        let kept = present(counts.first().and_then(|count| count.total.as_ref()), "a count")?.segments;
        Ok(select(&run.episodes, best(&run.episodes, usize::try_from(kept).unwrap_or(usize::MAX))))
    }

    // What a stage made, or why it did not.
    fn made(&self, index: usize) -> std::result::Result<&'a Made, String> {
        let made = self.submitted[index].as_ref().map_err(Clone::clone)?;
        match &made.job {
            Some(job) if job.state() != JobState::Succeeded => {
                let why = if job.error.is_empty() { String::new() } else { format!(": {}", job.error) };
                Err(format!("job {} {}{why}", job.id, words::job_state(job.state())))
            }
            Some(_) | None => Ok(made),
        }
    }

    /// Every stage as it ended.
    pub(crate) fn stages(&self) -> Vec<StageReport> {
        let report = |(index, stage): (usize, &super::stage::Stage)| {
            let asked = self.submitted[index].as_ref().ok();
            let job = asked.and_then(|made| made.job.as_ref());
            StageReport {
                kind: stage.work.kind().to_owned(),
                key: stage.key.clone(),
                label: stage.label.clone(),
                id: asked.map(|made| made.id.clone()),
                job_id: job.map(|job| job.id.clone()),
                seconds: job.and_then(seconds),
                problem: self.made(index).err(),
            }
        };
        self.graph.stages.iter().enumerate().map(report).collect()
    }
}
