//! The encoder of a job that names none. A score run names one also for scorers that do not read it, for the statistics of
//! the steps; one of a single step serves them, and nothing else.

use gleaner_client::Client;
use gleaner_core::kinds::{Family, Kind};
use gleaner_core::proto::to_struct;
use gleaner_core::{InitialWeights, Values, Words as _};
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{GetDatasetRequest, GetScoreRunRequest, JobSpec, PretrainSpec, SubmitJobRequest};

use super::queueing::queued;
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::ids;

const INITIAL_WEIGHTS: &str = "initial_weights";
/// Settings that choose first weights, or a model that may not be the encoder's.
const CHOSEN_OTHERWISE: [&str; 5] = [INITIAL_WEIGHTS, "image_weights", "image_encoder", "preset", "history_steps"];

/// What an encoder of one step is made from, and the options of its job.
pub(super) struct From<'a> {
    /// `None`: a new snapshot of the task.
    pub(super) snapshot: Option<&'a str>,
    pub(super) priority: i32,
    /// The key of the score job; empty with `--key ""`.
    pub(super) key: &'a str,
    pub(super) engine_options: &'a str,
}

impl From<'_> {
    /// The job of an encoder of one step. Its key follows from that of the score job, so that the same key returns both jobs.
    fn request(&self, task: &str) -> SubmitJobRequest {
        let spec = PretrainSpec {
            snapshot_id: self.snapshot.unwrap_or_default().to_owned(),
            settings: Some(to_struct(&Values::from_iter([("steps".to_owned(), 1.into())]))),
            ..PretrainSpec::default()
        };
        // A digest, because a key has a greatest length.
        let key = || format!("encoder of {}", blake3::hash(self.key.as_bytes()).to_hex());
        SubmitJobRequest {
            task: task.to_owned(),
            spec: Some(JobSpec { spec: Some(Spec::Pretrain(spec)) }),
            priority: self.priority,
            key: if self.key.is_empty() { String::new() } else { key() },
            engine_options: self.engine_options.to_owned(),
            ..SubmitJobRequest::default()
        }
    }
}

/// The newest encoder of a task. In a task without one, a scorer that reads no encoder gets one of a single step.
pub(super) async fn newest(
    context: &Context,
    client: &Client,
    task: &str,
    settings: &Values,
    from: From<'_>,
) -> Result<String> {
    if Family::Scorer.chosen(settings).is_none_or(|scorer| scorer.needs.encoder) {
        return ids::newest(context, client, ids::Kind::Encoder, Some(task)).await;
    }
    if let Some(newest) = ids::newest_if_any(context, client, ids::Kind::Encoder, task).await? {
        return Ok(newest);
    }
    let encoder = queued(context, from.key, client.submit_job(from.request(task)).await)?.result_id;
    context.output.note(format_args!("encoder {encoder} (of one step, because the scorer does not read it)"));
    Ok(encoder)
}

/// Refuses a policy that begins with the encoder of a dataset if that encoder has one step, and notes a trained one that
/// the policy could begin with.
pub(super) async fn expect_trained(
    context: &Context,
    client: &Client,
    task: &str,
    dataset: &str,
    settings: &Values,
) -> Result<()> {
    let Some(policy) = Family::Policy.chosen(settings) else { return Ok(()) };
    let (begins, could) = (begins(policy, settings), could_begin(policy, settings));
    if !begins && !could {
        return Ok(());
    }
    let request = GetDatasetRequest { dataset_id: dataset.to_owned() };
    let found = present(client.datasets().get_dataset(request).await?.into_inner().dataset, "a dataset")?;
    let request = GetScoreRunRequest { score_run_id: found.score_run_id };
    let run = client.scores().get_score_run(request).await;
    // The run may be unfinished; its encoder is then not known here.
    let Some(run) = run.ok().and_then(|reply| reply.into_inner().score_run) else { return Ok(()) };
    let encoders = ids::encoders(client, Some(task)).await?;
    match encoders.iter().find(|encoder| encoder.id == run.encoder_id) {
        Some(encoder) if begins && !encoder.is_trained => Err(Failure::message(format!(
            "{dataset} was scored with an encoder of one step, with which the policy {} would begin; train one that begins \
             from scratch, such as bc with --initial-weights random, or run `gleaner pretrain --wait` and score with its encoder",
            policy.name
        ))),
        Some(encoder) if could && encoder.is_trained => {
            context.output.note(format_args!(
                "{dataset} has a pretrained encoder; with --initial-weights encoder the policy would begin with it"
            ));
            Ok(())
        }
        Some(_) | None => Ok(()),
    }
}

/// Whether a policy with these settings begins with an encoder.
fn begins(policy: &Kind, settings: &Values) -> bool {
    let given = settings.get(INITIAL_WEIGHTS).and_then(|word| word.as_str());
    policy.needs.encoder || given == Some(InitialWeights::Encoder.as_str())
}

/// Whether a policy could begin with an encoder, and these settings do not choose its first weights otherwise.
fn could_begin(policy: &Kind, settings: &Values) -> bool {
    let has = policy.settings.iter().any(|setting| setting.name == INITIAL_WEIGHTS);
    has && !CHOSEN_OTHERWISE.iter().any(|name| settings.contains_key(*name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_score_job_with_a_key_has_one_encoder_however_often_it_is_submitted() {
        let request = |key| From { snapshot: None, priority: 2, key, engine_options: "" }.request("lift");
        let long = "k".repeat(200);
        assert_eq!(request("nightly"), request("nightly"));
        assert_eq!(request("").key, "");
        let [one, other] = ["nightly", long.as_str()].map(|key| request(key).key);
        assert!(one != other && !one.is_empty() && one != "nightly" && other.len() <= 200, "{one} {other}");
        assert_eq!(request("nightly").priority, 2);
    }
}
