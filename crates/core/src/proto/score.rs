//! Score runs, scores and histograms on the wire.

use gleaner_proto::v1;

use super::selection::beta;
use super::{field, page, snapshot};
use crate::{
    error::{Error, Result},
    id::{EpisodeId, ScoreRunId},
    page::Page,
    score::{EpisodeScores, Histogram, KeptCount, RunCounts, ScoreRun},
    selection::ExpertRanking,
};

const MAX_BINS: u32 = 1000;
/// The most cohorts of which a histogram has counts.
const MAX_COHORTS: usize = 50;
const MAX_BETAS: usize = 1000;

/// Reads the id of a score run.
///
/// # Errors
/// Invalid names the field.
pub fn score_run_id(text: &str) -> Result<ScoreRunId> {
    ScoreRunId::parse("score_run_id", text)
}

/// The task's name or id, and the page of its score runs.
///
/// # Errors
/// Invalid names the field.
pub fn list_request(request: v1::ListScoreRunsRequest) -> Result<(String, Page<ScoreRunId>)> {
    let v1::ListScoreRunsRequest { task, page_size, page_token } = request;
    Ok((task, page::page_by_id(page_size, &page_token)?))
}

/// Reads the run and the episode of the requested scores.
///
/// # Errors
/// Invalid names the field.
pub fn episode_scores_request(request: v1::GetEpisodeScoresRequest) -> Result<(ScoreRunId, EpisodeId)> {
    let v1::GetEpisodeScoresRequest { score_run_id: run, episode_id } = request;
    Ok((score_run_id(&run)?, EpisodeId::parse("episode_id", &episode_id)?))
}

/// The run, and the empty histogram to fill from it.
pub fn histogram_request(request: v1::GetHistogramRequest) -> Result<(ScoreRunId, Histogram)> {
    let v1::GetHistogramRequest { score_run_id: run, bins, betas } = request;
    let run = score_run_id(&run)?;
    let bins = match bins {
        0 => 20,
        1..=MAX_BINS => bins,
        _ => return Err(Error::invalid("bins", format!("is {bins}, must be at most {MAX_BINS}"))),
    };
    if betas.len() > MAX_BETAS {
        return Err(Error::invalid("betas", format!("are {}, must be at most {MAX_BETAS}", betas.len())));
    }
    for (index, &value) in betas.iter().enumerate() {
        beta(&format!("betas[{index}]"), value)?;
    }
    let bins = usize::try_from(bins).map_err(|error| Error::internal("reading bins", error))?;
    Ok((run, Histogram::new(bins, &betas)))
}

/// A filled histogram, and how often q ranks experts higher.
pub fn histogram_response(histogram: &Histogram, ranking: ExpertRanking) -> v1::GetHistogramResponse {
    let ExpertRanking { all, cohorts } = ranking;
    let cohorts = cohorts.into_iter().map(|(cohort, expert_auroc)| v1::CohortAuroc { cohort, expert_auroc });
    let kept = histogram.kept().into_iter().map(|KeptCount { beta, segments, episodes, expert_segments }| {
        v1::KeptCount { beta, segments, episodes, expert_segments }
    });
    let counts = histogram.cohorts(MAX_COHORTS).into_iter();
    let counts = counts.map(|(cohort, counts)| v1::CohortCounts { cohort: cohort.to_owned(), counts: counts.to_vec() });
    v1::GetHistogramResponse {
        cohort_counts: counts.collect(),
        counts: histogram.counts().to_vec(),
        segments: histogram.segments(),
        kept: kept.collect(),
        expert_counts: histogram.expert_counts().to_vec(),
        expert_auroc: all,
        cohorts: cohorts.collect(),
    }
}

/// How often q ranks experts higher, of a histogram.
pub fn expert_ranking(histogram: &v1::GetHistogramResponse) -> ExpertRanking {
    let cohorts = histogram.cohorts.iter().map(|of| (of.cohort.clone(), of.expert_auroc)).collect();
    ExpertRanking { all: histogram.expert_auroc, cohorts }
}

/// A score run with its counts.
pub fn score_run(run: ScoreRun, counts: RunCounts) -> v1::ScoreRun {
    let ScoreRun { id, task_id, origin, snapshot_id, lo, hi, quantiles: _, extends, expert_ids: _, created_at } = run;
    let RunCounts { imperfect_episodes, imperfect_segments, expert_segments } = counts;
    v1::ScoreRun {
        id: id.into(),
        task_id: task_id.into(),
        encoder_id: origin.encoder_id().map(ToString::to_string).unwrap_or_default(),
        snapshot_id: snapshot_id.into(),
        settings: Some(crate::proto::to_struct(&origin.values())),
        lo,
        hi,
        imperfect_episodes,
        imperfect_segments,
        expert_segments,
        create_time: Some(field::timestamp(created_at)),
        extends: extends.map(String::from).unwrap_or_default(),
        default_beta: origin.default_beta(),
    }
}

/// One episode's scores; `match_episode` are indices into `expert_ids`.
pub fn episode_scores(scores: EpisodeScores, expert_ids: Vec<EpisodeId>) -> v1::EpisodeScores {
    let EpisodeScores { episode_id, role, w, q, match_episode, match_step, distances } = scores;
    let distance = |modality: usize| distances.iter().map(|all| all[modality]).collect();
    v1::EpisodeScores {
        episode_id: episode_id.into(),
        role: snapshot::role_to_proto(role).into(),
        w,
        q,
        match_episode,
        match_step,
        distance_o: distance(0),
        distance_m: distance(1),
        distance_a: distance(2),
        expert_ids: expert_ids.into_iter().map(Into::into).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(bins: u32, betas: Vec<f64>) -> v1::GetHistogramRequest {
        v1::GetHistogramRequest { score_run_id: ScoreRunId::new().into(), bins, betas }
    }

    #[test]
    fn a_bad_threshold_is_named() {
        for bad in [-0.1, 1.1, f64::NAN, f64::INFINITY] {
            let error = histogram_request(request(0, vec![0.5, bad])).unwrap_err();
            assert!(error.message().starts_with("betas[1]: "), "{error}");
        }
        assert!(histogram_request(request(1001, vec![])).unwrap_err().message().starts_with("bins: "));
        assert_eq!(histogram_request(request(0, vec![])).unwrap().1.counts().len(), 20);
    }
}
