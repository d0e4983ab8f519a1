//! Score runs, scores and histograms on the wire.

use gleaner_proto::v1;

use super::{field, snapshot};
use crate::{
    error::{Error, Result},
    id::{EpisodeId, ScoreRunId},
    score::{EpisodeScores, Histogram, KeptCount, RunCounts, ScoreRun},
    selection::{Kept, Rule, Selection, SelectionShape, WhatIf},
};

const MAX_BINS: u32 = 1000;
const MAX_BETAS: usize = 1000;
const MAX_SELECTIONS: usize = 100;

/// Reads the id of a score run.
///
/// # Errors
/// Invalid names the field.
pub fn score_run_id(text: &str) -> Result<ScoreRunId> {
    ScoreRunId::parse("score_run_id", text)
}

/// A threshold in the request's `field`.
pub fn beta(field: &str, beta: f64) -> Result<f64> {
    if (0.0..=1.0).contains(&beta) {
        return Ok(beta);
    }
    Err(Error::invalid(field, format!("is {beta}, must be between 0 and 1")))
}

/// A part of all segments in the request's `field`.
pub fn top_fraction(field: &str, part: f64) -> Result<f64> {
    if part > 0.0 && part <= 1.0 {
        return Ok(part);
    }
    Err(Error::invalid(field, format!("is {part}, must be above 0 and at most 1")))
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

/// A filled histogram, and the AUROC of experts.
pub fn histogram_response(histogram: &Histogram, expert_auroc: Option<f64>) -> v1::GetHistogramResponse {
    let kept = histogram.kept().into_iter().map(|KeptCount { beta, segments, episodes }| v1::KeptCount {
        beta,
        segments,
        episodes,
    });
    v1::GetHistogramResponse {
        counts: histogram.counts().to_vec(),
        segments: histogram.segments(),
        kept: kept.collect(),
        expert_counts: histogram.expert_counts().to_vec(),
        expert_auroc,
    }
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
    }
}

/// A selection at the path `at` of the request.
///
/// # Errors
/// Invalid when its rule is missing, or the rule or the shape is out of range.
pub fn selection_from_proto(at: &str, selection: Option<v1::Selection>) -> Result<Selection> {
    let v1::Selection { rule, shape } = selection.unwrap_or_default();
    let rule = match rule {
        Some(v1::selection::Rule::Beta(value)) => beta(&format!("{at}.beta"), value).map(Rule::Beta),
        Some(v1::selection::Rule::TopFraction(part)) => {
            top_fraction(&format!("{at}.top_fraction"), part).map(Rule::TopFraction)
        }
        None => Err(Error::invalid(at, "must be set: a beta, or a top_fraction")),
    }?;
    Ok(Selection { rule, shape: shape_from_proto(&format!("{at}.shape"), shape)? })
}

/// A selection.
pub fn selection_to_proto(selection: Selection) -> v1::Selection {
    let Selection { rule, shape } = selection;
    let rule = match rule {
        Rule::Beta(beta) => v1::selection::Rule::Beta(beta),
        Rule::TopFraction(part) => v1::selection::Rule::TopFraction(part),
    };
    v1::Selection { rule: Some(rule), shape: shape_to_proto(shape) }
}

/// The shape of a selection at the path `at` of the request; off when it is left out.
///
/// # Errors
/// Invalid names the field that is out of range.
pub fn shape_from_proto(at: &str, shape: Option<v1::SelectionShape>) -> Result<SelectionShape> {
    let v1::SelectionShape {
        close_gaps,
        min_run,
        context_before,
        context_after,
        max_share_of_episode,
        phases,
        max_per_phase,
    } = shape.unwrap_or_default();
    let default = SelectionShape::default();
    let shape = SelectionShape {
        close_gaps,
        min_run,
        context_before,
        context_after,
        max_share_of_episode: max_share_of_episode.unwrap_or(default.max_share_of_episode),
        phases: phases.unwrap_or(default.phases),
        max_per_phase,
    };
    shape.checked().map_err(|problem| Error::invalid(&format!("{at}.{}", problem.field), problem.message))
}

/// The shape of a selection; left out when it is off.
pub fn shape_to_proto(shape: SelectionShape) -> Option<v1::SelectionShape> {
    let SelectionShape {
        close_gaps,
        min_run,
        context_before,
        context_after,
        max_share_of_episode,
        phases,
        max_per_phase,
    } = shape;
    (!shape.is_off()).then_some(v1::SelectionShape {
        close_gaps,
        min_run,
        context_before,
        context_after,
        max_share_of_episode: Some(max_share_of_episode),
        phases: Some(phases),
        max_per_phase,
    })
}

/// The run, the selections to count, and whether each episode is listed.
///
/// # Errors
/// Invalid when there is no selection, too many, or one that is out of range.
pub fn count_request(request: v1::CountKeptRequest) -> Result<(ScoreRunId, Vec<Selection>, bool)> {
    let v1::CountKeptRequest { score_run_id: run, selections, per_episode } = request;
    if selections.is_empty() || selections.len() > MAX_SELECTIONS {
        let count = selections.len();
        return Err(Error::invalid("selections", format!("are {count}, must be between 1 and {MAX_SELECTIONS}")));
    }
    let read = |(place, selection)| selection_from_proto(&format!("selections[{place}]"), Some(selection));
    let selections = selections.into_iter().enumerate().map(read).collect::<Result<_>>()?;
    Ok((score_run_id(&run)?, selections, per_episode))
}

/// The segments that one selection would keep.
pub fn what_if(counted: WhatIf, per_episode: bool) -> v1::KeptBySelection {
    let WhatIf { selection, threshold, total, cohorts, episodes } = counted;
    let cohorts = cohorts.into_iter().map(|(cohort, of)| v1::KeptOfCohort { cohort, kept: Some(kept(of)) });
    let episodes = episodes.into_iter().filter(|_| per_episode);
    let episodes =
        episodes.map(|(id, segments, of_segments)| v1::KeptOfEpisode { episode_id: id.into(), segments, of_segments });
    v1::KeptBySelection {
        selection: Some(selection_to_proto(selection)),
        threshold: threshold.unwrap_or(0.0),
        total: Some(kept(total)),
        cohorts: cohorts.collect(),
        episodes: episodes.collect(),
    }
}

fn kept(kept: Kept) -> v1::Kept {
    let Kept { segments, of_segments, episodes, of_episodes } = kept;
    v1::Kept { segments, of_segments, episodes, of_episodes }
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
    fn a_bad_selection_is_named() {
        let parse = |rules: Vec<Option<v1::selection::Rule>>| {
            let selections = rules.into_iter().map(|rule| v1::Selection { rule, shape: None }).collect();
            let request =
                v1::CountKeptRequest { score_run_id: ScoreRunId::new().into(), selections, per_episode: false };
            count_request(request).map(|(_, selections, _)| selections)
        };
        let beta = |value| Some(v1::selection::Rule::Beta(value));
        let top = |value| Some(v1::selection::Rule::TopFraction(value));
        assert_eq!(parse(vec![beta(0.5), top(1.0)]).unwrap(), [Selection::beta(0.5), Selection::top_fraction(1.0)]);
        for (rules, field) in [
            (vec![], "selections: "),
            (vec![beta(0.5); 101], "selections: "),
            (vec![beta(0.5), None], "selections[1]: "),
            (vec![beta(f64::NAN)], "selections[0].beta: "),
            (vec![top(0.0)], "selections[0].top_fraction: "),
            (vec![top(f64::NAN)], "selections[0].top_fraction: "),
        ] {
            let error = parse(rules).unwrap_err();
            assert!(error.message().starts_with(field), "{field} expected: {error}");
        }
    }

    #[test]
    fn a_bad_shape_is_named_and_a_good_one_survives_the_wire() {
        let beta = Some(v1::selection::Rule::Beta(0.5));
        let parse = |shape: v1::SelectionShape| {
            selection_from_proto("selection", Some(v1::Selection { rule: beta, shape: Some(shape) }))
        };
        let off = v1::SelectionShape::default();
        assert_eq!(parse(off).unwrap(), Selection::beta(0.5), "fields that are left out are off");
        assert_eq!(selection_to_proto(Selection::beta(0.5)).shape, None);
        let most = u32::MAX;
        for (shape, field) in [
            (v1::SelectionShape { close_gaps: most, ..off }, "close_gaps"),
            (v1::SelectionShape { min_run: most, ..off }, "min_run"),
            (v1::SelectionShape { context_before: most, ..off }, "context_before"),
            (v1::SelectionShape { context_after: most, ..off }, "context_after"),
            (v1::SelectionShape { max_share_of_episode: Some(0.0), ..off }, "max_share_of_episode"),
            (v1::SelectionShape { max_share_of_episode: Some(f64::NAN), ..off }, "max_share_of_episode"),
            (v1::SelectionShape { phases: Some(0), ..off }, "phases"),
            (v1::SelectionShape { phases: Some(1001), ..off }, "phases"),
            (v1::SelectionShape { max_per_phase: most, ..off }, "max_per_phase"),
        ] {
            let error = parse(shape).unwrap_err();
            assert!(error.message().starts_with(&format!("selection.shape.{field}: ")), "{field} expected: {error}");
        }
        let shape = SelectionShape { min_run: 5, max_share_of_episode: 0.5, phases: 4, ..SelectionShape::default() };
        let selection = Selection { rule: Rule::TopFraction(0.5), shape };
        assert_eq!(selection_from_proto("selection", Some(selection_to_proto(selection))).unwrap(), selection);
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
