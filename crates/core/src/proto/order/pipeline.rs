//! Pipelines on the wire: stages in order, each of which needs the one before it.

use gleaner_proto::v1;

use super::{evaluate, pretrain, score, train};
use crate::{
    error::{Error, Result},
    proto::{
        field,
        selection::{beta, shape_from_proto, top_fraction, whole_shape},
    },
    schedule::PipelineSpec,
};

/// Reads a pipeline.
///
/// # Errors
/// Invalid names the field, such as `pipeline.train.lambda`, and the remedy.
pub fn pipeline(pipeline: Option<v1::PipelineSpec>) -> Result<PipelineSpec> {
    let v1::PipelineSpec {
        pretrain: first,
        score: scores,
        beta: threshold,
        top_fraction: part,
        shape,
        train: policy,
        scoring,
        evaluate: trials,
    } = field::required("pipeline", pipeline)?;
    let (snapshot_id, rule, first) =
        pretrain::from_proto("pipeline.pretrain", field::required("pipeline.pretrain", first)?)?;
    let policy = policy.map(|spec| train::without_repeats(spec, &first));
    let beta = threshold.map(|threshold| beta("pipeline.beta", threshold)).transpose()?;
    let top_fraction = part.map(|part| top_fraction("pipeline.top_fraction", part)).transpose()?;
    if beta.is_some() && top_fraction.is_some() {
        return Err(Error::invalid("pipeline.top_fraction", "a dataset has one rule; leave beta or top_fraction out"));
    }
    let dataset = beta.is_some() || top_fraction.is_some();
    for (stage, there, before, needed) in [
        ("scoring", scoring.is_some(), scores, "scores; set pipeline.score"),
        ("beta", beta.is_some(), scores, "scores; set pipeline.score"),
        ("top_fraction", top_fraction.is_some(), scores, "scores; set pipeline.score"),
        ("shape", shape.is_some(), dataset, "a dataset; set pipeline.beta or pipeline.top_fraction"),
        ("train", policy.is_some(), dataset, "a dataset; set pipeline.beta or pipeline.top_fraction"),
        ("evaluate", trials.is_some(), policy.is_some(), "a policy; set pipeline.train"),
    ] {
        if there && !before {
            return Err(Error::invalid(&format!("pipeline.{stage}"), format!("needs {needed}, or leave {stage} out")));
        }
    }
    let shape = dataset.then(|| {
        let mut given = shape.unwrap_or_default();
        given.min_expert_auroc.get_or_insert(PipelineSpec::MIN_EXPERT_AUROC);
        given
    });
    Ok(PipelineSpec {
        snapshot_id,
        rule,
        pretrain: first,
        score: scores,
        scoring: scoring.map(|spec| score::of_pipeline("pipeline.scoring", spec)).transpose()?,
        beta,
        top_fraction,
        shape: shape_from_proto("pipeline.shape", shape)?,
        train: policy.map(|spec| filled("train.data", train::from_proto("pipeline.train", spec)?)).transpose()?,
        evaluate: trials
            .map(|spec| filled("evaluate.subject", evaluate::from_proto("pipeline.evaluate", spec)?))
            .transpose()?,
    })
}

/// A stage whose input the pipeline fills in.
fn filled<I, S>(name: &str, (input, spec): (Option<I>, S)) -> Result<S> {
    match input {
        None => Ok(spec),
        Some(_) => Err(Error::invalid(&format!("pipeline.{name}"), "must be left out: the pipeline fills it in")),
    }
}

/// A pipeline, with defaults filled in.
pub fn pipeline_to_proto(pipeline: PipelineSpec) -> v1::PipelineSpec {
    let PipelineSpec {
        snapshot_id,
        rule,
        pretrain: first,
        score: scores,
        scoring,
        beta,
        top_fraction,
        shape,
        train: policy,
        evaluate: trials,
    } = pipeline;
    let snapshot_id = snapshot_id.map(String::from).unwrap_or_default();
    let dataset = beta.is_some() || top_fraction.is_some();
    v1::PipelineSpec {
        pretrain: Some(pretrain::to_proto(&first, snapshot_id, Some(rule))),
        score: scores,
        beta,
        top_fraction,
        shape: dataset.then(|| whole_shape(shape)),
        train: policy.map(|spec| train::to_proto(&spec, None)),
        scoring: scoring.as_ref().map(score::to_proto),
        evaluate: trials.map(|spec| evaluate::to_proto(&spec, None)),
    }
}
