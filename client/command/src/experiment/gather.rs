//! Fetches the results of the stages and assigns them to the cells.

use std::collections::{BTreeMap, HashMap, HashSet};

use futures::{StreamExt as _, TryStreamExt as _};
use gleaner_client::Client;
use gleaner_core::id::EpisodeId;
use gleaner_core::job;
use gleaner_core::looks::{Look, looks};
use gleaner_core::proto::score::expert_ranking;
use gleaner_core::selection::{Candidate, ExpertRanking, places};
use gleaner_proto::v1::{
    CohortCounts, GetHistogramRequest, GetScoreRunRequest, JobState, ListMetricsRequest, Metric, Role,
};

use super::auroc::{self, AurocDifference, Scored};
use super::difference::differences;
use super::fetch::{PARALLEL, scores, success};
use super::file::{Experiment, Study};
use super::follow::seconds;
use super::pool::pool;
use super::rate::Rate;
use super::recordings::{Recordings, of_episode};
use super::report::{CellReport, SeedReport, StageReport, StudyReport};
use super::stage::{Chain, Graph};
use super::standing::{Gap, Standing, Submitted, stage_result, standing};
use super::study::Cell;
use crate::failure::{Failure, Result, present};
use crate::quality::{BINS, Lead, MarkedEpisode, Selected, Separation, histogram, lead, select, separations};

/// A score run's scores beside the marks.
struct Run {
    episodes: Vec<MarkedEpisode>,
    separation: Vec<Separation>,
    histogram: Vec<[u32; 2]>,
    experts: Vec<u64>,
    cohorts: BTreeMap<String, Vec<u64>>,
    ranking: ExpertRanking,
}

/// The counts of each cohort by its name.
pub(super) fn by_cohort(counts: Vec<CohortCounts>) -> BTreeMap<String, Vec<u64>> {
    counts.into_iter().map(|CohortCounts { cohort, counts }| (cohort, counts)).collect()
}

/// Fetches results; each is fetched once and measured once, however many cells share it and however often it is reported.
pub(crate) struct Gatherer<'a> {
    client: &'a Client,
    recordings: &'a Recordings,
    experiment: &'a Experiment,
    graph: &'a Graph,
    // By id.
    runs: HashMap<String, Run>,
    // By training or evaluation.
    looks: HashMap<String, Vec<Look>>,
    // By both runs.
    leads: HashMap<(String, String), Option<Lead>>,
    // By run and selection; each ranks every segment.
    selected: HashMap<(String, String), Selected>,
    // By evaluation.
    rates: HashMap<String, Rate>,
}

impl<'a> Gatherer<'a> {
    pub(crate) fn new(
        client: &'a Client,
        recordings: &'a Recordings,
        experiment: &'a Experiment,
        graph: &'a Graph,
    ) -> Self {
        Self {
            client,
            recordings,
            experiment,
            graph,
            runs: HashMap::new(),
            looks: HashMap::new(),
            leads: HashMap::new(),
            selected: HashMap::new(),
            rates: HashMap::new(),
        }
    }

    /// Every study, with gaps for missing results.
    pub(crate) async fn studies(&mut self, submitted: &Submitted) -> Result<Vec<StudyReport>> {
        let (experiment, graph) = (self.experiment, self.graph);
        let mut studies = Vec::with_capacity(experiment.studies.len());
        for (study, chains) in experiment.studies.iter().zip(&graph.chains) {
            studies.push(self.study(submitted, study, chains).await?);
        }
        Ok(studies)
    }

    async fn study(&mut self, submitted: &Submitted, study: &Study, chains: &[Vec<Chain>]) -> Result<StudyReport> {
        let mut cells = Vec::with_capacity(study.cells.len());
        for (cell, chains) in study.cells.iter().zip(chains) {
            let mut seeds = Vec::with_capacity(chains.len());
            for chain in chains {
                seeds.push(self.seed(submitted, cell, chain).await?);
            }
            let Cell { label, varied, settings } = cell.clone();
            cells.push(CellReport { label, varied, settings, pooled: pool(&seeds), seeds });
        }
        let stages: HashSet<usize> = chains.iter().flatten().flat_map(|chain| chain.stages.iter().copied()).collect();
        let took = |index: &usize| stage_result(submitted, *index).ok()?.job.as_ref().and_then(seconds);
        Ok(StudyReport {
            name: study.name.clone(),
            table: study.table,
            differences: differences(study.table, &cells),
            auroc_differences: self.auroc_differences(submitted, study, chains),
            cells,
            machine_seconds: stages.iter().filter_map(took).sum(),
            stages: stages.len(),
        })
    }

    /// Between runs that have been fetched.
    fn auroc_differences(
        &mut self,
        submitted: &Submitted,
        study: &Study,
        chains: &[Vec<Chain>],
    ) -> Vec<AurocDifference> {
        if !self.recordings.are_marked {
            return Vec::new();
        }
        let run = |chain: &Chain| {
            let index = self.graph.find(chain, "score")?;
            Some((chain.seed, stage_result(submitted, index).ok()?.id.clone()))
        };
        let scored = |(cell, chains): (&Cell, &Vec<Chain>)| Scored {
            label: cell.label.clone(),
            runs: chains.iter().filter_map(run).collect(),
        };
        let cells: Vec<Scored> = study.cells.iter().zip(chains).map(scored).collect();
        let (runs, leads) = (&self.runs, &mut self.leads);
        auroc::differences(study.table, &cells, |one, other| {
            let between = || lead(&runs.get(one)?.episodes, &runs.get(other)?.episodes);
            *leads.entry((one.to_owned(), other.to_owned())).or_insert_with(between)
        })
    }

    async fn seed(&mut self, submitted: &Submitted, cell: &Cell, chain: &Chain) -> Result<SeedReport> {
        let (problem, unfinished) = match standing(self.graph, submitted, chain) {
            Standing::Complete => (None, false),
            Standing::Unfinished => (None, true),
            Standing::Failed(problem) => (Some(problem), false),
        };
        let mut report = SeedReport {
            seed: chain.seed,
            problem,
            unfinished,
            success: None,
            selected: None,
            separation: Vec::new(),
            histogram: Vec::new(),
            experts: Vec::new(),
            cohorts: BTreeMap::new(),
            looks: Vec::new(),
        };
        if let Some(Ok(result)) = self.graph.find(chain, "evaluate").map(|index| stage_result(submitted, index)) {
            let rate = match self.rates.get(&result.id) {
                Some(rate) => *rate,
                None => success(self.client, &result.id).await?,
            };
            self.rates.insert(result.id.clone(), rate);
            report.success = Some(rate);
        }
        for (stage, place) in [("train", ""), ("evaluate", ", acting")] {
            if let Some(Ok(result)) = self.graph.find(chain, stage).map(|index| stage_result(submitted, index))
                && let Some(job) = result.job.as_ref().filter(|job| job.state() == JobState::Succeeded)
            {
                let looks = self.looks(&job.id).await?.into_iter();
                report.looks.extend(looks.map(|look| Look { input: look.input + place, ..look }));
            }
        }
        if let Some(Ok(result)) = self.graph.find(chain, "score").map(|index| stage_result(submitted, index)) {
            if !self.runs.contains_key(&result.id) {
                let run = self.run(&result.id).await?;
                self.runs.insert(result.id.clone(), run);
            }
            let run = present(self.runs.get(&result.id), "a score run")?;
            report.separation.clone_from(&run.separation);
            report.histogram.clone_from(&run.histogram);
            report.experts.clone_from(&run.experts);
            report.cohorts.clone_from(&run.cohorts);
            let selection = cell.settings.selection().map_err(|problem| Failure::message(problem.to_string()))?;
            let key = (result.id.clone(), format!("{selection:?}"));
            let selected = || select(&run.episodes, selection, &run.ranking);
            let selected = self.selected.entry(key).or_insert_with(selected).clone();
            let unmarked = |selected| Selected { precision: None, recall: None, ..selected };
            report.selected = Some(if self.recordings.are_marked { selected } else { unmarked(selected) });
        }
        Ok(report)
    }

    /// What the policy of a training or an evaluation looks at; cells may share it.
    async fn looks(&mut self, job_id: &str) -> Result<Vec<Look>> {
        if let Some(looks) = self.looks.get(job_id) {
            return Ok(looks.clone());
        }
        let request = ListMetricsRequest { job_id: job_id.to_owned() };
        let metrics = self.client.jobs().list_metrics(request).await?.into_inner().metrics;
        let metric = |Metric { step, name, value }| job::Metric { sequence: 0, step, name, value };
        let metrics: Vec<job::Metric> = metrics.into_iter().map(metric).collect();
        let looks = looks(&metrics, &self.experiment.recordings.source().spec().cameras);
        self.looks.insert(job_id.to_owned(), looks.clone());
        Ok(looks)
    }

    async fn run(&self, run_id: &str) -> Result<Run> {
        let mut episodes = self.episodes(run_id).await?;
        episodes.sort_by(|one, two| one.scores.cohort.cmp(&two.scores.cohort));
        let request = GetHistogramRequest {
            score_run_id: run_id.to_owned(),
            bins: u32::try_from(BINS).unwrap_or(0),
            ..GetHistogramRequest::default()
        };
        let counted = self.client.scores().get_histogram(request).await?.into_inner();
        let ranking = expert_ranking(&counted);
        let (experts, cohorts) = (counted.expert_counts, by_cohort(counted.cohort_counts));
        let (separation, histogram) = if self.recordings.are_marked {
            (separations(&episodes), histogram(&episodes))
        } else {
            (Vec::new(), Vec::new())
        };
        Ok(Run { separation, histogram, experts, cohorts, ranking, episodes })
    }

    /// The scores of every imperfect episode beside its mark, in the order of the recordings.
    pub(super) async fn episodes(&self, run_id: &str) -> Result<Vec<MarkedEpisode>> {
        let request = GetScoreRunRequest { score_run_id: run_id.to_owned() };
        let run = self.client.scores().get_score_run(request).await?.into_inner().score_run;
        let members = self.client.snapshot_episodes(&present(run, "a score run")?.snapshot_id).await?;
        let steps: HashMap<String, u64> =
            members.iter().map(|episode| (episode.episode_id.clone(), episode.steps)).collect();
        let imperfect = members.into_iter().filter(|episode| episode.role() == Role::Imperfect);
        let fetch = imperfect.map(|episode| self.episode(run_id, episode.episode_id, &steps));
        let mut episodes: Vec<MarkedEpisode> = futures::stream::iter(fetch).buffered(PARALLEL).try_collect().await?;
        let place = |id: &EpisodeId| self.recordings.by_episode.get(id.as_str()).map(|recording| recording.place);
        episodes.sort_by_key(|episode| place(&episode.scores.episode_id));
        Ok(episodes)
    }

    /// `steps` has the length of every episode of the snapshot.
    async fn episode(&self, run_id: &str, id: String, steps: &HashMap<String, u64>) -> Result<MarkedEpisode> {
        let recording = of_episode(self.recordings, &id)?;
        let scores = scores(self.client, run_id, &id).await?;
        let lengths: Option<Vec<u64>> = scores.expert_ids.iter().map(|expert| steps.get(expert).copied()).collect();
        let places = lengths.and_then(|lengths| places(&scores.match_episode, &scores.match_step, &lengths));
        let scores = Candidate {
            episode_id: EpisodeId::parse("episode_id", &id).map_err(|error| Failure::message(error.message()))?,
            cohort: recording.cohort.clone(),
            w: scores.w,
            q: scores.q,
            places: present(places, "the experts of all matches in the snapshot")?,
        };
        Ok(MarkedEpisode { scores, success: recording.success, mark: recording.mark })
    }

    /// Every stage as it is now.
    pub(crate) fn stages(&self, submitted: &Submitted) -> Vec<StageReport> {
        let report = |(index, stage): (usize, &super::stage::Stage)| {
            let submitted_stage = submitted[index].as_ref().ok();
            let job = submitted_stage.and_then(|result| result.job.as_ref());
            let gap = stage_result(submitted, index).err();
            StageReport {
                kind: stage.work.kind().to_owned(),
                key: stage.key.clone(),
                label: stage.label.clone(),
                id: submitted_stage.map(|result| result.id.clone()),
                job_id: job.map(|job| job.id.clone()),
                seconds: job.and_then(seconds),
                unfinished: gap == Some(Gap::NotYet),
                problem: gap.and_then(Gap::problem),
            }
        };
        self.graph.stages.iter().enumerate().map(report).collect()
    }
}
