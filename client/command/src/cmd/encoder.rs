//! Notes on the encoder of a job that names none: which one the server chose, and whether a policy could begin with it.

use gleaner_client::Client;
use gleaner_core::Values;
use gleaner_core::kinds::{Family, Kind};
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{GetDatasetRequest, GetScoreRunRequest, Job};

use crate::context::Context;
use crate::failure::{Result, present};
use crate::ids;

const INITIAL_WEIGHTS: &str = "initial_weights";
/// Settings that choose first weights, or a model that may not be the encoder's.
const CHOSEN_OTHERWISE: [&str; 5] = [INITIAL_WEIGHTS, "image_weights", "image_encoder", "preset", "history_steps"];

/// Notes the encoder that the server chose for a score job.
pub(super) async fn note_chosen(context: &Context, client: &Client, job: &Job) -> Result<()> {
    let Some(Spec::Score(score)) = job.spec.as_ref().and_then(|spec| spec.spec.as_ref()) else { return Ok(()) };
    let id = &score.encoder_id;
    let encoders = ids::encoders(client, Some(&job.task_id)).await?;
    let trained = encoders.iter().any(|encoder| encoder.id == *id && encoder.is_trained);
    let why = if trained { "the newest" } else { "of one step, because the scorer does not read it" };
    context.output.note(format_args!("encoder {id} ({why})"));
    Ok(())
}

/// Notes a trained encoder of a dataset with which the policy could begin and does not.
pub(super) async fn note_unused(
    context: &Context,
    client: &Client,
    task: &str,
    dataset: &str,
    settings: &Values,
) -> Result<()> {
    if !Family::Policy.chosen(settings).is_some_and(|policy| could_begin(policy, settings)) {
        return Ok(());
    }
    let request = GetDatasetRequest { dataset_id: dataset.to_owned() };
    let found = present(client.datasets().get_dataset(request).await?.into_inner().dataset, "a dataset")?;
    let request = GetScoreRunRequest { score_run_id: found.score_run_id };
    let run = client.scores().get_score_run(request).await;
    // The run may be unfinished; its encoder is then not known here.
    let Some(run) = run.ok().and_then(|reply| reply.into_inner().score_run) else { return Ok(()) };
    let encoders = ids::encoders(client, Some(task)).await?;
    if encoders.iter().any(|encoder| encoder.id == run.encoder_id && encoder.is_trained) {
        context.output.note(format_args!(
            "{dataset} has a pretrained encoder; with --initial-weights encoder the policy would begin with it"
        ));
    }
    Ok(())
}

/// Whether a policy could begin with an encoder, and these settings do not choose its first weights otherwise.
fn could_begin(policy: &Kind, settings: &Values) -> bool {
    let has = policy.settings.iter().any(|setting| setting.name == INITIAL_WEIGHTS);
    has && !policy.needs.encoder && !CHOSEN_OTHERWISE.iter().any(|name| settings.contains_key(*name))
}
