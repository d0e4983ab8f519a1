//! What `--plan` prints: the studies, the stages that would run, and their sizes.
//!
//! Must not depend on a server.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use gleaner_core::{Device, Values, Words as _};
use serde_json::{Value, json};

use super::file::{Experiment, Study};
use super::scale::Sizes;
use super::stage::{Graph, Work};
use crate::words::counted;

/// The settings of a job that its time and memory depend on most.
const OF_JOBS: [&str; 4] = ["preset", "steps", "batch", "precision"];

/// One line: the name, and how much there is to do.
pub(super) fn planned(experiment: &Experiment, graph: &Graph) -> String {
    let cells: usize = experiment.studies.iter().map(|study| study.cells.len()).sum();
    let stages: Vec<String> = counts(graph).iter().map(|(kind, count)| format!("{count} {kind}")).collect();
    format!(
        "{}{}: {}, {}; {}: {}",
        experiment.name,
        if experiment.sizes == Sizes::Scaled { " with --scale" } else { "" },
        counted(experiment.studies.len(), "study", "studies"),
        counted(cells, "cell", "cells"),
        counted(graph.stages.len(), "stage", "stages"),
        stages.join(", ")
    )
}

/// That line, and the sizes under it.
pub(super) fn text(experiment: &Experiment, graph: &Graph, device: Device) -> String {
    let Plan { image, recorded_experts, experts, seeds, episodes, pretrain, train } = Plan::of(experiment, graph);
    let mut text = planned(experiment, graph);
    let mut line = |name: &str, value: String| {
        if !value.is_empty() {
            // Writing into a String can't fail.
            let _ = write!(text, "\n{name}: {value}");
        }
    };
    let list = |numbers: &[u64]| numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    line("device", device.as_str().to_owned());
    line("image", image.map(|pixels| pixels.to_string()).unwrap_or_default());
    let experts: Vec<String> =
        experts.iter().map(|most| if *most == 0 { "all".to_owned() } else { most.to_string() }).collect();
    let recorded = recorded_experts.map(|count| format!(" of {count}")).unwrap_or_default();
    line("experts", format!("{}{recorded}", experts.join(", ")));
    line("seeds", list(&seeds));
    line("pretrain", pretrain.iter().map(job).collect::<Vec<_>>().join("; "));
    line("train", train.iter().map(job).collect::<Vec<_>>().join("; "));
    line("episodes", list(&episodes));
    text
}

/// The same as a document.
pub(super) fn document(experiment: &Experiment, graph: &Graph, device: Device) -> Value {
    let study = |study: &Study| {
        json!({
            "name": study.name,
            "cells": study.cells.iter().map(|cell| cell.label.as_str()).collect::<Vec<_>>(),
        })
    };
    let Plan { image, recorded_experts, experts, seeds, episodes, pretrain, train } = Plan::of(experiment, graph);
    json!({
        "name": experiment.name,
        "scaled": experiment.sizes == Sizes::Scaled,
        "device": device.as_str(),
        "tasks": experiment.recordings.all().into_iter().map(|collection| collection.task.as_str()).collect::<Vec<_>>(),
        "studies": experiment.studies.iter().map(study).collect::<Vec<_>>(),
        "stages": counts(graph).into_iter().collect::<BTreeMap<_, _>>(),
        "sizes": {
            "image": image,
            "recorded_experts": recorded_experts,
            "experts": experts,
            "seeds": seeds,
            "episodes": episodes,
            "pretrain": pretrain,
            "train": train,
        },
    })
}

/// The sizes of the stages; of each that differs between cells, every value once.
#[derive(Debug, Default)]
struct Plan {
    /// Of the simulator's recordings, and so are their experts.
    image: Option<u32>,
    recorded_experts: Option<usize>,
    /// At most, of each snapshot; 0: all.
    experts: Vec<u64>,
    seeds: Vec<u64>,
    /// Of each seed's evaluation.
    episodes: Vec<u64>,
    pretrain: Vec<Values>,
    train: Vec<Values>,
}

impl Plan {
    fn of(experiment: &Experiment, graph: &Graph) -> Self {
        let set = experiment.recordings.source().simulated();
        let mut plan = Self {
            image: set.map(|set| set.config.image),
            recorded_experts: set.and_then(|set| set.cohorts.first()).map(|experts| experts.count),
            ..Self::default()
        };
        for chain in graph.chains.iter().flatten().flatten() {
            add(&mut plan.seeds, chain.seed);
        }
        for stage in &graph.stages {
            match &stage.work {
                Work::Snapshot { rule, .. } => add(&mut plan.experts, rule.experts.into()),
                Work::Pretrain { settings } => add(&mut plan.pretrain, sizes(settings)),
                Work::Train { settings } => add(&mut plan.train, sizes(settings)),
                Work::Evaluate { settings } => {
                    add(&mut plan.episodes, settings.get("episodes").and_then(Value::as_u64).unwrap_or_default());
                }
                Work::Attempts { episodes, .. } => add(&mut plan.episodes, (*episodes).into()),
                Work::Given { .. } | Work::Score { .. } | Work::Marks | Work::Dataset { .. } => {}
            }
        }
        plan
    }
}

fn add<T: PartialEq>(values: &mut Vec<T>, value: T) {
    if !values.contains(&value) {
        values.push(value);
    }
}

fn sizes(settings: &Values) -> Values {
    let present = OF_JOBS.iter().filter_map(|name| Some(((*name).to_owned(), settings.get(*name)?.clone())));
    present.collect()
}

/// Such as "base, 5000 × 128, f32"; a policy that begins from an encoder has no preset of its own.
fn job(settings: &Values) -> String {
    let word = |name: &str| settings.get(name).and_then(Value::as_str).map(str::to_owned);
    let number = |name: &str| settings.get(name).and_then(Value::as_u64).unwrap_or_default();
    let steps = format!("{} × {}", number("steps"), number("batch"));
    [word("preset"), Some(steps), word("precision")].into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn counts(graph: &Graph) -> Vec<(&'static str, usize)> {
    let mut counts: Vec<(&'static str, usize)> = Vec::new();
    for stage in &graph.stages {
        let kind = stage.work.kind();
        match counts.iter_mut().find(|count| count.0 == kind) {
            Some(count) => count.1 += 1,
            None => counts.push((kind, 1)),
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "name = \"x\"\ntask = \"pick_cube\"\n[data]\nexperts = 3\n\
        cohorts = [{ agent = \"noise:1\", count = 2 }]\n[base]\nseeds = [0]\nepisodes = 5\n\
        pretrain = { steps = 7, batch = 8 }\ntrain = { steps = 9, batch = 8 }\n\
        [scale]\ndevice = \"cuda\"\npreset = \"base\"\nprecision = \"bf16\"\nimage = 64\nseeds = [0, 1]\n\
        episodes = 200\npretrain = { steps = 70 }\ntrain = { batch = 90 }\nrule = { experts = 20 }\n\
        data = { experts = 60 }\n[[study]]\ntable = \"cells\"\n\
        cells = [{ label = \"a\" }, { label = \"b\", set = { method = \"bc\", train = { steps = 4 } } }]\n";

    fn shown(sizes: Sizes) -> (String, Value) {
        let experiment = Experiment::parse_with(FILE, sizes).unwrap();
        let graph = Graph::new(&experiment, experiment.device);
        let device = experiment.device;
        (text(&experiment, &graph, device), document(&experiment, &graph, device))
    }

    #[test]
    fn the_plan_has_the_sizes_that_would_run() {
        let (text, document) = shown(Sizes::Base);
        let expected = "x: 1 study, 2 cells; 8 stages: 1 snapshot, 1 pretrain, 1 score, 1 dataset, 2 train, \
            2 evaluate\ndevice: cpu\nimage: 32\nexperts: all of 3\nseeds: 0\npretrain: tiny, 7 × 8, f32\n\
            train: 9 × 8, f32; tiny, 4 × 8, f32\nepisodes: 5";
        assert_eq!(text, expected);
        assert_eq!((&document["scaled"], &document["device"]), (&json!(false), &json!("cpu")));

        let (text, document) = shown(Sizes::Scaled);
        let expected = "x with --scale: 1 study, 2 cells; 15 stages: 1 snapshot, 2 pretrain, 2 score, 2 dataset, \
            4 train, 4 evaluate\ndevice: cuda\nimage: 64\nexperts: 20 of 60\nseeds: 0, 1\n\
            pretrain: base, 70 × 8, bf16\ntrain: 9 × 90, bf16; base, 4 × 90, bf16\nepisodes: 200";
        assert_eq!(text, expected);
        assert_eq!((&document["scaled"], &document["device"]), (&json!(true), &json!("cuda")));
        let sizes = &document["sizes"];
        let pretrain = json!([{"preset": "base", "steps": 70, "batch": 8, "precision": "bf16"}]);
        assert_eq!((&sizes["pretrain"], &sizes["seeds"], &sizes["image"]), (&pretrain, &json!([0, 1]), &json!(64)));
        assert_eq!((&sizes["experts"], &sizes["recorded_experts"]), (&json!([20]), &json!(60)));
    }
}
