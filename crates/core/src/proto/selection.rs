//! Selections and the counts of what they keep on the wire.

use gleaner_proto::v1;

use crate::{
    error::{Error, Result},
    id::ScoreRunId,
    selection::{Kept, Rule, Selection, SelectionShape, WhatIf},
};

const MAX_SELECTIONS: usize = 100;

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

/// A selection at the path `at` of the request.
///
/// # Errors
/// Invalid when its rule is missing, or the rule or the shape is out of range.
pub fn selection_from_proto(at: &str, selection: Option<v1::Selection>) -> Result<Selection> {
    let (rule, shape) = parts_from_proto(at, selection)?;
    let rule = rule.ok_or_else(|| Error::invalid(at, "must be set: a beta, or a top_fraction"))?;
    Ok(Selection { rule, shape })
}

/// The rule, if there is one, and the shape of a selection at the path `at` of the request.
///
/// # Errors
/// Invalid when the rule or the shape is out of range.
pub fn parts_from_proto(at: &str, selection: Option<v1::Selection>) -> Result<(Option<Rule>, SelectionShape)> {
    let v1::Selection { rule, shape } = selection.unwrap_or_default();
    let rule = match rule {
        Some(v1::selection::Rule::Beta(value)) => Some(Rule::Beta(beta(&format!("{at}.beta"), value)?)),
        Some(v1::selection::Rule::TopFraction(part)) => {
            Some(Rule::TopFraction(top_fraction(&format!("{at}.top_fraction"), part)?))
        }
        None => None,
    };
    Ok((rule, shape_from_proto(&format!("{at}.shape"), shape)?))
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
        min_expert_auroc,
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
        min_expert_auroc: min_expert_auroc.unwrap_or(default.min_expert_auroc),
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
    (!shape.is_off()).then(|| whole_shape(shape))
}

/// The shape of a selection with every setting.
pub fn whole_shape(shape: SelectionShape) -> v1::SelectionShape {
    let SelectionShape {
        min_expert_auroc,
        close_gaps,
        min_run,
        context_before,
        context_after,
        max_share_of_episode,
        phases,
        max_per_phase,
    } = shape;
    v1::SelectionShape {
        min_expert_auroc: Some(min_expert_auroc),
        close_gaps,
        min_run,
        context_before,
        context_after,
        max_share_of_episode: Some(max_share_of_episode),
        phases: Some(phases),
        max_per_phase,
    }
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
    Ok((ScoreRunId::parse("score_run_id", &run)?, selections, per_episode))
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

#[cfg(test)]
mod tests {
    use super::*;

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
            (v1::SelectionShape { min_expert_auroc: Some(-0.1), ..off }, "min_expert_auroc"),
            (v1::SelectionShape { min_expert_auroc: Some(1.5), ..off }, "min_expert_auroc"),
            (v1::SelectionShape { min_expert_auroc: Some(f64::NAN), ..off }, "min_expert_auroc"),
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
        let shape = SelectionShape {
            min_expert_auroc: 0.5,
            min_run: 5,
            max_share_of_episode: 0.5,
            phases: 4,
            max_per_phase: 3,
            ..SelectionShape::default()
        };
        let selection = Selection { rule: Rule::TopFraction(0.5), shape };
        assert_eq!(selection_from_proto("selection", Some(selection_to_proto(selection))).unwrap(), selection);
    }
}
