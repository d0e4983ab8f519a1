//! Fetches the results of the stages and measures them.

use futures::{StreamExt as _, TryStreamExt as _};
use gleaner_client::{Client, ClientError};
use gleaner_core::Values;
use gleaner_core::id::EpisodeId;
use gleaner_core::selection::{Candidate, ExpertRanking, Selection};

use tonic::Code;

use super::super::fetch::{PARALLEL, scores, success};
use super::super::pool::pool;
use super::super::rate::Rate;
use super::super::report::SeedReport;
use super::super::stage::{Chain, Graph};
use super::super::standing::{Standing, Submitted, stage_result, standing};
use super::super::study::Cell;
use super::episodes::{Episodes, Known};
use super::measure::{self, Ranking, Run};
use super::report::{Agreement, ScorerReport, ScorerSeed, Separated, Success};
use crate::failure::{Failure, Result};
use crate::quality::{MarkedEpisode, mean, select_among};

/// What the score runs and policies give.
pub(super) struct Found {
    pub(super) segments: Option<usize>,
    pub(super) scorers: Vec<ScorerReport>,
    pub(super) length_alone: Option<Separated>,
    pub(super) step_alone: Option<Separated>,
    pub(super) agreement: Vec<Agreement>,
}

/// Collects the results of a comparison.
pub(super) struct Collector<'a> {
    pub(super) client: &'a Client,
    pub(super) episodes: &'a Episodes,
    pub(super) cells: &'a [Cell],
    /// The score run that each cell was given, if it was.
    pub(super) runs: &'a [Option<String>],
    pub(super) graph: &'a Graph,
    pub(super) top: f64,
}

/// A scorer's seeds, each with its place among the runs.
struct Seeds {
    seeds: Vec<ScorerSeed>,
    runs: Vec<Option<usize>>,
}

impl Collector<'_> {
    /// Every result there is; each score run is fetched once.
    pub(super) async fn found(&self, submitted: &Submitted) -> Result<Found> {
        let mut runs: Vec<Run> = Vec::new();
        let mut scorers = Vec::with_capacity(self.cells.len());
        for chains in self.graph.chains.iter().flatten() {
            scorers.push(self.seeds(submitted, chains, &mut runs).await?);
        }
        let rankings: Vec<Ranking> = runs.iter().map(|run| Ranking::new(run, self.top)).collect();
        let cells = self.cells.iter().zip(self.runs);
        let reports = cells.zip(&scorers).map(|(cell, seeds)| self.scorer(cell, seeds, &runs, &rankings));
        Ok(Found {
            segments: runs.first().map(|run| run.imperfect.iter().map(|episode| episode.scores.q.len()).sum()),
            scorers: reports.collect(),
            length_alone: runs.first().map(|run| measure::separated(self.episodes, &[&measure::by_length(run)])),
            step_alone: runs.first().map(|run| measure::separated(self.episodes, &[&measure::by_step(run)])),
            agreement: self.agreement(&scorers, &rankings),
        })
    }

    async fn seeds(&self, submitted: &Submitted, chains: &[Chain], runs: &mut Vec<Run>) -> Result<Seeds> {
        let mut found = Seeds { seeds: Vec::new(), runs: Vec::new() };
        for chain in chains {
            let problem = match standing(self.graph, submitted, chain) {
                Standing::Complete => None,
                Standing::Unfinished => Some("has not ended".to_owned()),
                Standing::Failed(problem) => Some(problem),
            };
            let id = |kind: &str| {
                let result = stage_result(submitted, self.graph.find(chain, kind)?).ok()?;
                Some(result.id.clone())
            };
            let (run, evaluation) = (id("score"), id("evaluate"));
            found.runs.push(match &run {
                Some(id) => Some(self.place(id, runs).await?),
                None => None,
            });
            let rate: Option<Rate> = match &evaluation {
                Some(id) => Some(success(self.client, id).await?),
                None => None,
            };
            found.seeds.push(ScorerSeed { seed: chain.seed, run, policy: id("train"), success: rate, problem });
        }
        Ok(found)
    }

    /// The place of a run, which is fetched if it is new.
    async fn place(&self, id: &str, runs: &mut Vec<Run>) -> Result<usize> {
        if let Some(known) = runs.iter().position(|run| run.id == id) {
            return Ok(known);
        }
        let fetch = |known: &Known| self.episode(id.to_owned(), known.clone());
        let imperfect = futures::stream::iter(self.episodes.imperfect.iter().map(fetch)).buffered(PARALLEL);
        let imperfect: Vec<MarkedEpisode> = imperfect.try_collect().await?;
        let fetch = |known: &Known| self.expert(id.to_owned(), known.id.clone());
        let experts = futures::stream::iter(self.episodes.experts.iter().map(fetch)).buffered(PARALLEL);
        runs.push(Run { id: id.to_owned(), imperfect, experts: experts.try_collect().await? });
        Ok(runs.len() - 1)
    }

    async fn episode(&self, run_id: String, known: Known) -> Result<MarkedEpisode> {
        let scores = scores(self.client, &run_id, &known.id).await?;
        let (success, mark) = (known.succeeded(), known.mark.unwrap_or_default());
        let episode_id =
            EpisodeId::parse("episode_id", &known.id).map_err(|error| Failure::message(error.message()))?;
        // The best part has no limit of phases, which alone reads places.
        let (w, q, places) = (scores.w, scores.q, Vec::new());
        Ok(MarkedEpisode { scores: Candidate { episode_id, cohort: known.cohort, w, q, places }, success, mark })
    }

    /// The mean q of an expert; an imported run may have none.
    async fn expert(&self, run_id: String, episode_id: String) -> Result<Option<f64>> {
        let scores = match scores(self.client, &run_id, &episode_id).await {
            Err(Failure::Client(ClientError::Rejected(status))) if status.code() == Code::NotFound => return Ok(None),
            scores => scores?,
        };
        Ok(mean(&scores.q.into_iter().map(f64::from).collect::<Vec<_>>()))
    }

    fn scorer(
        &self,
        (cell, given): (&Cell, &Option<String>),
        of_scorer: &Seeds,
        runs: &[Run],
        rankings: &[Ranking],
    ) -> ScorerReport {
        let mut places: Vec<usize> = of_scorer.runs.iter().flatten().copied().collect();
        places.sort_unstable();
        places.dedup();
        let own: Vec<&Run> = places.iter().map(|&place| &runs[place]).collect();
        let ranked: Vec<&Ranking> = places.iter().map(|&place| &rankings[place]).collect();
        let own_settings = || cell.settings.score_spec(0).map(|spec| spec.values()).unwrap_or_default();
        let mut settings = if given.is_some() { Values::new() } else { own_settings() };
        settings.retain(|name, _| !["seed", "device"].contains(&name.as_str()));
        ScorerReport {
            label: cell.label.clone(),
            settings,
            runs: own.len(),
            separated: measure::separated(self.episodes, &own),
            length: measure::length(self.episodes, &own),
            stability: measure::stability(&ranked),
            success: self.success(of_scorer, runs),
            seeds: of_scorer.seeds.clone(),
        }
    }

    fn success(&self, of_scorer: &Seeds, runs: &[Run]) -> Success {
        let seed = |(seed, run): (&ScorerSeed, &Option<usize>)| {
            let run = run.map(|place| &runs[place]).filter(|_| self.episodes.marked > 0);
            let (best, unread) = (Selection::top_fraction(self.top), ExpertRanking::default());
            let selected = run.map(|run| select_among(&run.imperfect, self.episodes.marked, best, &unread));
            SeedReport { seed: seed.seed, success: seed.success, selected, ..SeedReport::default() }
        };
        let pooled = pool(&of_scorer.seeds.iter().zip(&of_scorer.runs).map(seed).collect::<Vec<_>>());
        Success {
            pooled: pooled.success,
            mean_of_seeds: pooled.mean_of_seeds,
            interval_of_seeds: pooled.interval_of_seeds,
            precision: pooled.precision,
            recall: pooled.recall,
        }
    }

    fn agreement(&self, scorers: &[Seeds], rankings: &[Ranking]) -> Vec<Agreement> {
        let of = |seeds: &Seeds| -> Vec<Option<&Ranking>> {
            seeds.runs.iter().map(|place| place.map(|place| &rankings[place])).collect()
        };
        let labelled: Vec<(&str, Vec<Option<&Ranking>>)> =
            self.cells.iter().map(|cell| cell.label.as_str()).zip(scorers.iter().map(of)).collect();
        let mut found = Vec::new();
        for (at, (one, of_one)) in labelled.iter().enumerate() {
            for (other, of_other) in &labelled[at + 1..] {
                let (spearman, overlap) = measure::agreement(of_one, of_other);
                found.push(Agreement { one: (*one).to_owned(), other: (*other).to_owned(), spearman, overlap });
            }
        }
        found
    }
}
