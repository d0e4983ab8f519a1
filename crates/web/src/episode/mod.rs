//! One episode: its cameras, its values and q over time, the matched expert, its labels and its report.

mod aside;
mod cameras;
mod data;
mod timeline;
mod uses;

use std::collections::BTreeSet;

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    Error, Result, ScoreSpec,
    curation::SnapshotUse,
    episode::{InspectedEpisode, Label},
    error::Kind,
    id::{EpisodeId, ScoreRunId},
    score::{EpisodeScores, ScoreRun},
    steps::Numbers,
    task::Task,
    time::seconds,
};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::json;

pub(super) use self::data::{recording, scored_recording, scores};
use super::{
    page_request::PageRequest,
    refusal::Answer,
    sheet::{Format, Sheet},
    shell::{self, Head, Tab},
    standing::Standings,
    text,
};
use crate::{Backend, page::Page};

#[derive(Default, Deserialize)]
#[serde(default)]
struct Parameters {
    step: String,
    run: String,
    beta: String,
    format: Format,
}

/// The data of the page.
struct View {
    request: PageRequest,
    task: Task,
    inspected: InspectedEpisode,
    labels: Vec<Label>,
    /// The version of the newest label.
    version: i64,
    /// The newest snapshots of the episode, and their number.
    uses: (Vec<SnapshotUse>, u64),
    /// The runs that scored it, newest first.
    runs: Vec<ScoreRun>,
    /// The scores of the selected run.
    scored: Option<Scored>,
    /// The standings of the experts that it matches in that run.
    experts: Standings,
    numbers: Result<Numbers>,
    step: u64,
    beta: f64,
}

/// The scores of an episode in one run.
struct Scored {
    run: ScoreRun,
    scores: EpisodeScores,
    /// l: a segment is the window of l + 1 steps that ends at its step.
    segment_length: u32,
}

impl Scored {
    /// The experts that its segments match, each once.
    fn matched_experts(&self) -> Vec<EpisodeId> {
        let places: BTreeSet<u32> = self.scores.match_episode.iter().copied().collect();
        let expert = |place| self.run.expert_ids.get(usize::try_from(place).ok()?).cloned();
        places.into_iter().filter_map(expert).collect()
    }
}

impl View {
    fn id(&self) -> &EpisodeId {
        &self.inspected.episode.id
    }

    /// Whether the caller may label this episode.
    fn labels(&self) -> bool {
        self.inspected.episode.deleted_at.is_none() && self.request.may(Page::LabelEpisodes)
    }

    /// Seconds from the first step to each; by the task's rate when the recording cannot be read.
    fn times(&self) -> Vec<f64> {
        if let Ok(numbers) = &self.numbers {
            let first = numbers.stamps_ns.first().copied().unwrap_or(0);
            return numbers.stamps_ns.iter().map(|stamp| seconds(stamp.saturating_sub(first))).collect();
        }
        #[expect(clippy::cast_precision_loss, reason = "far fewer than 2^52 steps")]
        let time = |step: u64| step as f64 / self.task.spec.rate_hz;
        (0..self.inspected.episode.steps).map(time).collect()
    }
}

pub(super) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let parameters: Parameters = request.parameters()?;
    let id = EpisodeId::parse("episode", &id)?;
    if parameters.format != Format::Html {
        return Ok(history(&id, request.backend().labels(&id).await?).answer(parameters.format)?);
    }
    let view = look(request, &id, &parameters).await?;
    let name = view.task.spec.name.clone();
    let head = Head {
        title: &view.inspected.episode.file_name,
        tab: Tab::Episodes,
        task: Some(&name),
        script: Some("episode.js"),
    };
    Ok(shell::page(&view.request, &head, &body(&view)).into_response())
}

async fn look(request: PageRequest, id: &EpisodeId, parameters: &Parameters) -> Result<View> {
    let backend = request.backend();
    let threshold = threshold(&parameters.beta)?;
    // Before the episode: a label stored in between then has a newer version than the shown one.
    let version = backend.label_version(id).await?;
    let inspected = backend.episode(id).await?;
    let step = step(&parameters.step, inspected.episode.steps)?;
    let task = backend.task_by_id(&inspected.episode.task_id).await?;
    let scoring = backend.runs_that_scored(&task.id, id).await?;
    let mut runs = backend.score_runs(&task.id).await?;
    runs.retain(|run| scoring.contains(&run.id));
    let labels = backend.labels(id).await?;
    let uses = backend.snapshots_with(id, uses::MOST).await?;
    let scored = match chosen(&parameters.run, &runs)? {
        Some(run) => Some(scored(backend, id, run.clone()).await?),
        None => None,
    };
    let experts = Standings::of(backend, &scored.as_ref().map(Scored::matched_experts).unwrap_or_default()).await?;
    let beta = threshold.or_else(|| scored.as_ref().map(|scored| scored.run.origin.default_beta()));
    let beta = beta.unwrap_or_else(|| ScoreSpec::default().normaliser.default_beta());
    let numbers = backend.numbers(id).await;
    if let Err(error) = &numbers
        && matches!(error.kind(), Kind::Damaged | Kind::Internal)
    {
        tracing::error!(%error, episode.id = %id, "an episode's steps cannot be read");
    }
    Ok(View { task, inspected, labels, version, uses, runs, scored, experts, numbers, step, beta, request })
}

/// The run in the query, or the newest that scored the episode.
fn chosen<'a>(id: &str, runs: &'a [ScoreRun]) -> Result<Option<&'a ScoreRun>> {
    if id.is_empty() {
        return Ok(runs.first());
    }
    let id = ScoreRunId::parse("run", id)?;
    let found = runs.iter().find(|run| run.id == id);
    found.map(Some).ok_or_else(|| Error::not_found("scores of this episode in a finished run", id))
}

async fn scored(backend: &dyn Backend, id: &EpisodeId, run: ScoreRun) -> Result<Scored> {
    let scores = backend.episode_scores(&run.id, id).await?;
    let segment_length = backend.segment_length(run.origin.encoder_id()).await?;
    Ok(Scored { run, scores, segment_length })
}

/// Parses a threshold, if there is a text.
fn threshold(text: &str) -> Result<Option<f64>> {
    if text.is_empty() {
        return Ok(None);
    }
    let read = text.parse::<f64>().ok().filter(|beta| (0.0..=1.0).contains(beta));
    read.map(Some)
        .ok_or_else(|| Error::invalid("beta", "must be a number from 0 to 1; segments with a higher q are kept"))
}

fn step(text: &str, steps: u64) -> Result<u64> {
    if text.is_empty() {
        return Ok(0);
    }
    let step = text.parse().map_err(|_| Error::invalid("step", "must be a whole number, counted from 0"))?;
    if step < steps {
        return Ok(step);
    }
    Err(Error::not_found("step", format!("{step}; the episode has {steps}, counted from 0")))
}

fn body(view: &View) -> Markup {
    let episode = &view.inspected.episode;
    let (task, outcome) = (&view.task.spec.name, episode.outcome.as_str());
    let times = view.times();
    html! {
        h1 { (episode.file_name) }
        p.lead.row {
            span #outcome class=(format!("tag {outcome}")) { (outcome) }
            @if episode.cohort.is_empty() { span { "no cohort" } } @else { span { "cohort " (episode.cohort) } }
            span { (text::counted(episode.steps, "step")) ", " (text::seconds(episode.duration_s)) }
            span { "arrived " (text::time(episode.created_at)) " UTC" }
            a href=(format!("/tasks/{task}/episodes")) { "All episodes" }
        }
        @if let Some(since) = episode.deleted_at {
            p.note.bad { "In the trash since " (text::time(since)) " UTC. It cannot be labelled until it is restored." }
        }
        div.episode {
            div.watch {
                div.stage {
                    (cameras::figures(view))
                    (cameras::scrubber(view, &times))
                }
                (timeline::timeline(view, &times))
            }
            (aside::aside(view))
        }
        (shell::data("episode", &json!({
            "id": episode.id, "task": task, "version": view.version, "outcome": outcome, "cohort": episode.cohort,
            "steps": episode.steps, "step": view.step, "labels": view.labels(), "times": times,
            "run": view.scored.as_ref().map(|scored| &scored.run.id), "beta": view.beta,
            "deleted": view.experts.deleted(),
        })))
    }
}

/// The history of the episode's labels.
fn history(id: &EpisodeId, labels: Vec<Label>) -> Sheet {
    let row = |Label { outcome, cohort, author, reason, created_at }: Label| {
        vec![json!(text::stamp(created_at)), json!(outcome.as_str()), json!(cohort), json!(author), json!(reason)]
    };
    Sheet {
        name: format!("labels-{id}"),
        columns: &["labelled_at", "outcome", "cohort", "labelled_by", "reason"],
        rows: labels.into_iter().map(row).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_threshold_is_a_number_between_0_and_1() {
        let read = ["0", "0.75", "1", ""].map(|text| threshold(text).unwrap());
        assert_eq!(read, [Some(0.0), Some(0.75), Some(1.0), None]);
        for wrong in ["high", "NaN", "1.01", "-0.1", "inf"] {
            assert!(threshold(wrong).unwrap_err().message().starts_with("beta: "), "{wrong}");
        }
    }

    #[test]
    fn a_step_must_exist() {
        assert_eq!([step("", 3).unwrap(), step("2", 3).unwrap()], [0, 2]);
        assert_eq!(step("3", 3).unwrap_err().kind(), Kind::NotFound);
        assert_eq!(step("-1", 3).unwrap_err().kind(), Kind::Invalid);
    }
}
