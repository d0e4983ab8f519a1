//! `pipeline`: pretrain, score, filter, train, evaluate as one chain of jobs. Its options are the schedules' too.

use clap::{Arg, Args, ValueEnum};
use gleaner_client::Client;
use gleaner_core::arguments::{Given, Pipeline, TRAIN};
use gleaner_core::kinds::{Family, Kind};
use gleaner_core::proto::{selection::whole_shape, to_struct};
use gleaner_core::selection::Rule;
use gleaner_core::{Group as _, InitialWeights, NormaliserKind, OptimSpec, PretrainSpec, Words as _};
use gleaner_proto::v1::{
    EvaluateSpec, GetDatasetRequest, GetScoreRunRequest, Job, JobKind, PipelineSpec, ScoreSpec, SubmitPipelineRequest,
    TrainSpec,
};
use prost_types::Struct;

use super::plan::SnapshotArgs;
use super::queueing::{EngineArgs, SubmitArgs, own_key, queued};
use super::selection::SelectionArgs;
use super::submit::{after, outcome};
use super::training_warnings::longer;
use super::{follow, histogram, jobs};
use crate::context::Context;
use crate::failure::{Result, present};
use crate::json;

/// How far a pipeline goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
enum Until {
    Pretrain,
    Score,
    Dataset,
    Train,
    Evaluate,
}

/// What a pipeline does.
#[derive(Args, Clone, Debug)]
#[command(mut_arg("min_expert_auroc", of_pipeline))]
pub(crate) struct PipelineArgs {
    #[command(flatten)]
    snapshot: SnapshotArgs,
    /// Last stage of the chain. Where neither the scorer nor the policy reads the encoder, as by default, pretraining has
    /// one step, unless --steps is given. With `--initial-weights encoder` the policy begins with it.
    #[arg(long, value_enum, default_value = "train")]
    until: Until,
    /// Train for a first look, in minutes: 800 steps of 32 segments for the policy, where --train-steps and --train-batch
    /// are not given, and 300 of 32 for the encoder, where --steps and --batch are not given. The policy is rarely good.
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    selection: SelectionArgs,
    #[command(flatten)]
    settings: Given<Pipeline>,
}

/// The settings of --quick.
const QUICK: [(&str, u64); 4] = [("steps", 300), ("batch", 32), ("train_steps", 800), ("train_batch", 32)];
/// The settings of a pretraining whose encoder has no use but its name and its sizes.
const UNREAD: [(&str, u64); 2] = [("steps", PretrainSpec::UNTRAINED_STEPS), ("batch", 32)];

impl PipelineArgs {
    pub(crate) fn spec(&self) -> PipelineSpec {
        let mut settings = self.settings.clone();
        let unread = if self.is_unread() { &UNREAD[..] } else { &[] };
        let quick = if self.quick { &QUICK[..] } else { &[] };
        for (name, value) in unread.iter().chain(quick) {
            settings.values.entry(*name).or_insert_with(|| (*value).into());
        }
        Self { settings, ..self.clone() }.completed()
    }

    /// Whether the encoder is trained for its name and its sizes alone.
    fn is_unread(&self) -> bool {
        !self.reads_encoder() && !self.settings.values.contains_key("steps")
    }

    /// The pipeline of these settings.
    fn completed(&self) -> PipelineSpec {
        let (scored, selected) = (self.until >= Until::Score, self.until >= Until::Dataset);
        let rule = self.selection.rule().unwrap_or_else(|| Rule::Beta(self.normaliser().default_beta()));
        let (beta, top_fraction) = match rule {
            Rule::Beta(beta) => (Some(beta).filter(|_| selected), None),
            Rule::TopFraction(fraction) => (None, Some(fraction).filter(|_| selected)),
        };
        PipelineSpec {
            score: scored,
            scoring: scored.then(|| ScoreSpec { settings: self.stage("score"), ..ScoreSpec::default() }),
            beta,
            top_fraction,
            shape: selected.then(|| whole_shape(self.selection.shape())),
            train: (self.until >= Until::Train).then(|| TrainSpec { data: None, settings: self.training() }),
            evaluate: (self.until >= Until::Evaluate)
                .then(|| EvaluateSpec { subject: None, settings: self.stage("evaluate") }),
            pretrain: Some(self.snapshot.pretrain(&self.settings.of_job("pretrain"))),
        }
    }

    /// Whether the encoder has another use than its name and its sizes.
    fn reads_encoder(&self) -> bool {
        let (scoring, training) = (self.settings.of_job("score"), self.settings.of_job("train"));
        let reads = |family: Family, settings| family.chosen(settings).is_none_or(|kind| kind.needs.encoder);
        let (scorer, policy) = (reads(Family::Scorer, &scoring), reads(Family::Policy, &training));
        let scratch = InitialWeights::Random.as_str();
        let mut values = self.settings.values.iter();
        let weights = values.any(|(name, word)| name.ends_with("initial_weights") && word.as_str() != Some(scratch));
        self.until < Until::Score || scorer || weights || (policy && self.until >= Until::Train)
    }

    /// The normaliser of the scores.
    fn normaliser(&self) -> NormaliserKind {
        let settings = self.settings.of_job("score");
        let given = settings.get("normaliser").and_then(|word| word.as_str());
        let found = NormaliserKind::ALL.iter().find(|word| Some(word.value.as_str()) == given);
        found.map_or(gleaner_core::ScoreSpec::default().normaliser, |word| word.value)
    }

    /// The settings of a stage. A shared one that the chosen scorer does not have is not for this stage.
    fn stage(&self, job: &str) -> Option<Struct> {
        let mut settings = self.settings.of_job(job);
        if job == "score" {
            let scorer = Family::Scorer.chosen(&settings);
            settings.retain(|name, _| name != "seed" || scorer.is_some_and(|kind| has(kind, name)));
        }
        Some(to_struct(&settings))
    }

    /// The settings of the training: an optimiser of its own, and the size of the encoder for policies that have a size.
    fn training(&self) -> Option<Struct> {
        let mut settings = self.settings.of_job("train");
        let policy = Family::Policy.chosen(&settings);
        let optimiser = |name: &str| OptimSpec::schema().iter().any(|setting| setting.name == name);
        let of_encoder = ["preset", "segment_length"];
        settings.retain(|name, _| {
            let foreign = of_encoder.contains(&name.as_str()) && policy.is_some_and(|kind| !has(kind, name));
            !optimiser(name) && !foreign
        });
        for (name, value) in &self.settings.values {
            if let Some(own) = name.strip_prefix(TRAIN) {
                settings.insert(own.to_owned(), value.clone());
            }
        }
        Some(to_struct(&settings))
    }
}

/// --min-expert-auroc with the default of a pipeline.
fn of_pipeline(option: Arg) -> Arg {
    let default = gleaner_core::schedule::PipelineSpec::MIN_EXPERT_AUROC.to_string();
    let help = option.get_help().map(ToString::to_string).unwrap_or_default();
    let help = help.replace("[default: 0.0]", &format!("[default: {default}]"));
    option.help(help).default_value(default).hide_default_value(true)
}

fn has(kind: &Kind, name: &str) -> bool {
    kind.settings.iter().any(|setting| setting.name == name)
}

#[derive(Args, Debug)]
pub(crate) struct PipelineCommand {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    submit: SubmitArgs,
    /// Key that prevents duplicate chains, chosen by the caller. A chain with the same key none of whose jobs failed or was
    /// cancelled is returned instead of a new one. Default: a key of this call, for its retries over a broken connection.
    #[arg(long, default_value_t = own_key(), hide_default_value = true)]
    key: String,
    #[command(flatten)]
    engine: EngineArgs,
}

impl PipelineCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let request = SubmitPipelineRequest {
            task: context.task(&client, self.task.as_deref()).await?,
            pipeline: Some(self.pipeline.spec()),
            priority: self.submit.priority,
            engine_options: self.engine.options,
            key: self.key.clone(),
        };
        let mut reply = queued(context, &self.key, client.submit_pipeline(request).await)?;
        if self.pipeline.is_unread() {
            context.output.note("neither the scorer nor the policy reads an encoder, so its training has one step");
        }
        if self.submit.wait {
            for job in &mut reply.jobs {
                *job = follow::to_success(context, &client, &job.id).await?;
                context.output.note(outcome(job));
                if job.kind() == JobKind::Score {
                    note_kept(context, &client, &reply.dataset_id, &job.result_id).await;
                }
            }
        }
        let text = || {
            let mut text = jobs::listing(&reply.jobs);
            if !reply.dataset_id.is_empty() {
                text.push_str(&format!("\ndataset {}", reply.dataset_id));
            }
            text
        };
        context.output.result(|| json::value(&reply), text)?;
        context.output.next(next(&reply.jobs, self.submit.wait, self.pipeline.quick));
        Ok(())
    }
}

/// Notes what to look at of a finished score run, and what the chain's dataset, if it makes one, keeps of it. The training is
/// queued already, so an error here is a note too.
async fn note_kept(context: &Context, client: &Client, dataset_id: &str, score_run_id: &str) {
    let (kept, left_out_below) = match gleaned(client, dataset_id, score_run_id).await {
        Ok(found) => found,
        Err(error) => (Some(format!("{dataset_id} was not counted: {error}")), 0.0),
    };
    histogram::warn(context, client, score_run_id, left_out_below).await;
    if let Some(kept) = kept {
        context.output.note(kept);
    }
}

/// What a dataset keeps of a finished score run, and the share below which it leaves out cohorts; nothing without a dataset.
async fn gleaned(client: &Client, dataset_id: &str, score_run_id: &str) -> Result<(Option<String>, f64)> {
    if dataset_id.is_empty() {
        return Ok((None, 0.0));
    }
    let of_dataset = GetDatasetRequest { dataset_id: dataset_id.to_owned() };
    let dataset = present(client.datasets().get_dataset(of_dataset).await?.into_inner().dataset, "a dataset")?;
    let of_run = GetScoreRunRequest { score_run_id: score_run_id.to_owned() };
    let run = present(client.scores().get_score_run(of_run).await?.into_inner().score_run, "a score run")?;
    let kept = format!(
        "the dataset has {} steps of experts and keeps {} of {} steps of the imperfect episodes, from {} of {} episodes",
        dataset.expert_segments(),
        dataset.kept_segments(),
        run.imperfect_segments,
        dataset.kept_episodes(),
        run.imperfect_episodes
    );
    let shape = dataset.selection.and_then(|selection| selection.shape).unwrap_or_default();
    Ok((Some(kept), shape.min_expert_auroc()))
}

fn next(submitted: &[Job], waited: bool, quick: bool) -> String {
    match submitted.last() {
        Some(last) if waited && quick && last.kind() == JobKind::Train => {
            let train = longer(last.total);
            format!("{train} for a better policy from the same dataset; then, or now for a first look, {}", after(last))
        }
        Some(last) if waited => after(last),
        Some(last) => format!("gleaner watch {} (the last job of the chain)", last.id),
        None => "gleaner jobs".into(),
    }
}

#[cfg(test)]
mod tests;
