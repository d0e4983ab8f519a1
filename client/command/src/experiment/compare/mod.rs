//! `compare-scorers`: scorers on one snapshot: how they agree, separate good from bad, follow length and change with the
//! seed, and how well policies do that are trained on each one's best part.
//!
//! `cells` has the settings, `subject`, `marks` and `episodes` what is scored; the stages are an experiment's. `collect`
//! fetches their results, `measure` computes; `report` is the result, `markdown`, `summary`, `text` and `sheet`
//! show it.

mod cells;
mod collect;
mod episodes;
mod markdown;
mod marks;
mod measure;
mod report;
mod sheet;
mod subject;
mod summary;
mod text;

use std::path::{Path, PathBuf};

use clap::Args;
use gleaner_client::{Client, ClientError};
use gleaner_core::{Device, EvaluateSpec, Words as _};
use serde_json::Value;

use super::follow;
use super::stage::{Graph, Origin};
use super::standing::{Submitted, stage_result};
use super::state::replace;
use super::study::Cell;
use super::submit::Submitter;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::words;
use cells::Choice;
use collect::{Collector, Found};
use episodes::Episodes;
use report::Comparison;
use subject::Subject;

#[derive(Args, Debug)]
pub(crate) struct CompareArgs {
    /// Ids of encoders of one snapshot, one for each seed; or the id of a snapshot, on which an encoder is pretrained for
    /// each seed.
    #[arg(required = true, value_name = "ENCODER|SNAPSHOT")]
    on: Vec<String>,
    /// Scorer, with settings of its own after it, such as `raw` or `"raw local_scale=false"`; can be repeated. Default:
    /// every scorer of the server that can run on the task.
    #[arg(long = "scorer", value_name = "NAME [KEY=VALUE ...]")]
    scorers: Vec<String>,
    /// Id of a score run of the snapshot that exists, such as one of scores made elsewhere (`gleaner import-scores`), as a
    /// further scorer; can be repeated.
    #[arg(long = "run", value_name = "RUN")]
    run: Vec<String>,
    /// Number of seeds, 0 and up, of scorers with random numbers, of policies and of pretrained encoders. More seeds
    /// measure stability better and take longer. Default: 3, or one for each of several encoders.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    seeds: Option<u32>,
    /// Fraction of the segments that is a scorer's best part, above 0 and at most 1.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.2)]
    top_fraction: f64,
    /// Policy to train on the experts and the best part of each scorer. Default: none.
    #[arg(long, value_name = "POLICY")]
    train: Option<String>,
    /// Attempts of each trained policy in the simulator. More attempts narrow the interval of its success and take longer.
    #[arg(long, value_name = "N", default_value_t = EvaluateSpec::default().episodes, requires = "train", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    evaluations: u32,
    /// Name of the simulator's task. Default: the name of the task; policies of a task that is not simulated are trained
    /// and not evaluated.
    #[arg(long, value_name = "TASK", requires = "train")]
    simulation: Option<String>,
    /// Setting of the jobs, as in the table `base` of an experiment's file, such as `similarity=segment_l2` or
    /// `train.steps=500`; can be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    settings: Vec<String>,
    /// Path of marks (CSV with the columns `went_wrong`, and `file` or `episode`), as `gleaner record` writes them: the
    /// first wrong step of each imperfect episode. Without marks, no AUROC of segments.
    #[arg(long, value_name = "FILE")]
    marks: Option<PathBuf>,
    /// Number of strata of about equally many episodes in which lengths count as equal. More strata are stricter and
    /// leave fewer pairs.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    length_bins: u32,
    /// Folder for the result: `report.md`, `report.json` and `scorers.csv`. Default: no files.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Device of the jobs.
    #[arg(long, default_value = "cpu")]
    device: Device,
}

impl CompareArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let subject = Subject::of(context, &client, &self.on).await?;
        let origins = subject.origins(self.seeds)?;
        let mut labels = Vec::with_capacity(self.run.len());
        for run in &self.run {
            labels.push(subject.label_of_run(run).await?);
        }
        let cells = self.cells(&subject, (&subject.scorers(context).await?, &labels), origins.len() as u64)?;
        let given = self.run.iter().cloned().map(Some);
        let runs: Vec<Option<String>> =
            std::iter::repeat_n(None, cells.len().saturating_sub(labels.len())).chain(given).collect();
        let simulated = match self.train {
            Some(_) => subject.simulated(self.simulation.as_deref())?,
            None => None,
        };
        let bins = usize::try_from(self.length_bins).unwrap_or(usize::MAX);
        let episodes = subject.episodes(self.marks.as_deref(), bins).await?;
        if let Some(out) = &self.out {
            std::fs::create_dir_all(out).map_err(ClientError::io(out))?;
        }
        let graph = Graph::on_results(
            &subject.task_id,
            (&cells, &runs),
            &origins,
            simulated.map(|(_, config)| config.max_steps),
            self.device,
        );
        let simulation = simulated.map_or("", |(task, _)| task.name());
        let submitted = self.jobs(context, &client, simulation, &graph).await?;
        let collector = Collector {
            client: &client,
            episodes: &episodes,
            cells: &cells,
            runs: &runs,
            graph: &graph,
            top: self.top_fraction,
        };
        let found = collector.found(&submitted).await?;
        let simulation = (!simulation.is_empty()).then(|| simulation.to_owned());
        let encoders = encoders(&graph, &submitted, &origins);
        self.shown(context, self.comparison(&subject, &episodes, found, encoders, simulation))
    }

    fn cells(&self, subject: &Subject<'_>, (offered, runs): (&[String], &[String]), seeds: u64) -> Result<Vec<Cell>> {
        let choice = Choice {
            scorers: &self.scorers,
            runs,
            offered,
            settings: &self.settings,
            policy: self.train.as_deref(),
            pretrains: subject.pretrains(),
            top: self.top_fraction,
            attempts: self.evaluations,
            seeds,
        };
        choice.cells().map_err(Failure::message)
    }

    /// Every job to its end. Jobs of an earlier comparison are found by their keys.
    async fn jobs(&self, context: &Context, client: &Client, simulation: &str, graph: &Graph) -> Result<Submitted> {
        let submitter = Submitter::on_results(client, simulation, self.device);
        let mut submitted = submitter.submit(graph).await?;
        context.output.note("the same command resumes after an interruption; the jobs continue on the server");
        follow::to_the_end(context, client, graph, &mut submitted).await?;
        Ok(submitted)
    }

    fn comparison(
        &self,
        subject: &Subject<'_>,
        episodes: &Episodes,
        found: Found,
        encoders: Vec<Option<String>>,
        simulation: Option<String>,
    ) -> Comparison {
        Comparison {
            command: self.command(),
            task: subject.spec.name.clone(),
            snapshot: subject.snapshot_id.clone(),
            encoders,
            experts: episodes.experts.len(),
            imperfect: episodes.imperfect.len(),
            outcomes: episodes.outcomes(),
            segments: found.segments,
            marked: episodes.marked,
            top_fraction: self.top_fraction,
            length_bins: episodes.length_bins(),
            policy: self.train.clone(),
            simulation,
            scorers: found.scorers,
            length_alone: found.length_alone,
            step_alone: found.step_alone,
            agreement: found.agreement,
        }
    }

    /// The command without its connection and folder.
    fn command(&self) -> String {
        let mut command = format!("gleaner compare-scorers {}", self.on.join(" "));
        let mut add = |name: &str, value: &str| {
            command.push_str(&format!(" --{name} {}", words::shell_word(value)));
        };
        self.scorers.iter().for_each(|scorer| add("scorer", scorer));
        self.run.iter().for_each(|run| add("run", run));
        self.seeds.iter().for_each(|seeds| add("seeds", &seeds.to_string()));
        add("top-fraction", &self.top_fraction.to_string());
        if let Some(policy) = &self.train {
            add("train", policy);
            add("evaluations", &self.evaluations.to_string());
        }
        self.simulation.iter().for_each(|task| add("simulation", task));
        self.settings.iter().for_each(|setting| add("set", setting));
        self.marks.iter().for_each(|path| add("marks", &path.display().to_string()));
        add("length-bins", &self.length_bins.to_string());
        if self.device != Device::default() {
            add("device", self.device.as_str());
        }
        command
    }

    fn shown(&self, context: &Context, found: Comparison) -> Result<()> {
        let text = markdown::markdown(&found);
        if let Some(out) = &self.out {
            write(out, &found, &text)?;
        }
        context.output.result(|| document(&found), || text)?;
        if let Some(out) = &self.out {
            context.output.next(format_args!("open {}", out.join("report.md").display()));
        }
        let problems = found.problems().len();
        if problems == 0 {
            return Ok(());
        }
        Err(Failure::message(format!(
            "{} incomplete, as listed under Problems; the same command retries",
            words::counted(problems, "seed of a scorer is", "seeds of scorers are")
        )))
    }
}

/// The encoder of each seed, unless its pretraining failed.
fn encoders(graph: &Graph, submitted: &Submitted, origins: &[Origin]) -> Vec<Option<String>> {
    let chains = graph.chains.iter().flatten().next();
    let of = |chain| Some(stage_result(submitted, graph.find(chain, "pretrain")?).ok()?.id.clone());
    chains.map_or_else(|| vec![None; origins.len()], |chains| chains.iter().map(of).collect())
}

fn document(found: &Comparison) -> Result<Value> {
    serde_json::to_value(found).map_err(|error| Failure::message(error.to_string()))
}

fn write(out: &Path, found: &Comparison, text: &str) -> Result<()> {
    for (name, content) in [
        ("scorers.csv", sheet::csv(found)?),
        ("report.json", format!("{:#}\n", document(found)?)),
        ("report.md", text.to_owned()),
    ] {
        let path = out.join(name);
        replace(&path, content.as_bytes()).map_err(ClientError::io(path))?;
    }
    Ok(())
}
