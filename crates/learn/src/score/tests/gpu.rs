//! Score runs on a GPU beside the processor: the same winners unless two are as near, w within a thousandth, and every
//! scorer.

use gleaner_core::Device;

use super::*;
use crate::gpu::{DEVICES, gpu};
use crate::history::History;
use crate::score::features::episode_features;
use crate::score::similarity::metric;

fn on(device: Device, spec: &ScoreSpec) -> ScoreSpec {
    ScoreSpec { device, ..spec.clone() }
}

fn episodes() -> (Vec<Trajectory>, Vec<Trajectory>) {
    (toy::experts(5, 12), vec![toy::episode("failure", 50, 14, false), toy::episode("success", 51, 9, true)])
}

fn near(expected: f64, found: f64) -> bool {
    (expected - found).abs() < 1e-3 * expected.abs().max(1.0)
}

/// The scores of each imperfect episode and of each expert.
fn all(scores: &Scores) -> impl Iterator<Item = &EpisodeScores> {
    scores.imperfect.iter().chain(&scores.experts)
}

#[test]
fn winners_and_w_on_a_gpu_are_those_of_the_processor() {
    let Some(_gpu) = gpu() else { return };
    let (experts, imperfect) = episodes();
    for spec in specs() {
        let [on_cpu, on_gpu] = DEVICES.map(|device| run(&experts, &imperfect, &on(device, &spec)));
        // The features on the processor, by which another winner must be as near as its own.
        let scorer = scorer::open(&spec.scorer).unwrap();
        let comparison = scorer.comparison().unwrap();
        let opened = Opened::read(&encoder(), &spec, scorer.feature_scale()).unwrap();
        let features = |episode: &Trajectory| {
            let _no_grad = no_grad_guard();
            episode_features(opened.encoder(), episode, comparison).unwrap()
        };
        let metric = metric(comparison.similarity, comparison.scale);
        let of_experts: Vec<_> = experts.iter().map(&features).collect();
        let mut others = 0;
        for (episode, (expected, found)) in imperfect.iter().chain(&experts).zip(all(&on_cpu).zip(all(&on_gpu))) {
            assert_eq!((&expected.episode_id, &found.episode_id), (&episode.id, &episode.id));
            assert_eq!((expected.w.len(), found.w.len()), (episode.steps(), episode.steps()));
            let own = features(episode);
            for step in 0..episode.steps() {
                let (w, w_found) = (expected.w[step], found.w[step]);
                assert!(near(w, w_found), "{spec:?} {} {step}: {w} {w_found}", episode.id);
                let winner = |scores: &EpisodeScores| (scores.match_episode[step], scores.match_step[step]);
                if winner(found) == winner(expected) {
                    continue;
                }
                others += 1;
                let (place, row) = winner(found);
                let parts = metric.parts((&own, step), (&of_experts[place as usize], row as usize));
                let w_of_winner = 0.0 - metric.distance(parts);
                assert!(near(w, w_of_winner), "{spec:?} {} {step}: {w} {w_of_winner}", episode.id);
            }
        }
        assert!(others < 20, "{spec:?}: {others} of 83 winners differ");
        let q = |scores: &Scores| all(scores).flat_map(|episode| episode.q.clone()).collect::<Vec<f32>>();
        let (expected, found) = (q(&on_cpu), q(&on_gpu));
        assert!(found.iter().all(|q| (0.0..=1.0).contains(q)));
        let mean = expected.iter().zip(&found).map(|(a, b)| (a - b).abs()).sum::<f32>() / found.len() as f32;
        assert!(mean < 0.05, "{spec:?}: {mean}");
    }
}

#[test]
fn a_live_scorer_on_a_gpu_scores_as_its_run() {
    let Some(_gpu) = gpu() else { return };
    let (experts, imperfect) = episodes();
    for spec in specs().into_iter().map(without_lookahead) {
        let spec = on(Device::Cuda, &spec);
        let Scores { imperfect: scores, normaliser, .. } = run(&experts, &imperfect, &spec);
        let live = LiveScorer::load(&encoder(), &experts, &spec, normaliser).unwrap();
        let (episode, stored) = (&imperfect[0], &scores[0]);
        let anew = live.score_episode(episode).unwrap();
        let mut history = History::new(live.segment_length());
        for step in 0..episode.steps() {
            let numbers = episode.numbers(step..step + 1).unwrap();
            let embedding = live.embed(&[&episode.frame(step)]).unwrap().remove(0);
            history.push(embedding, numbers.proprioception).unwrap();
            history.set_executed(numbers.action).unwrap();
            let now = live.score(&[&history]).unwrap()[0];
            let w = stored.w[step];
            assert!(near(w, anew.w[step]) && near(w, now.w), "{spec:?} {step}: {w} {} {}", anew.w[step], now.w);
        }
    }
}

#[test]
fn every_scorer_scores_on_a_gpu_as_on_the_processor() {
    let Some(_gpu) = gpu() else { return };
    let (experts, imperfect) = episodes();
    for kind in Family::Scorer.kinds() {
        let fewer = [("progress_steps", 8), ("neighbours", 16)];
        let has = |name: &str| kind.settings.iter().any(|setting| setting.name == name);
        let changed = fewer.into_iter().filter(|(name, _)| has(name)).map(|(name, value)| (name, value.into()));
        let spec = spec_of(&kind.name, &changed.collect::<Vec<_>>());
        let [expected, found] = DEVICES.map(|device| {
            let scores = run(&experts, &imperfect, &on(device, &spec));
            all(&scores).flat_map(|episode| episode.w.clone()).collect::<Vec<f64>>()
        });
        assert_eq!(found.len(), expected.len(), "{}", kind.name);
        assert!(found.iter().all(|w| w.is_finite()), "{}: {found:?}", kind.name);
        // What a training of some hundred steps rounds otherwise is small beside the range of w.
        let (low, high) = expected.iter().fold((f64::MAX, f64::MIN), |(low, high), w| (low.min(*w), high.max(*w)));
        let mean = expected.iter().zip(&found).map(|(a, b)| (a - b).abs()).sum::<f64>() / found.len() as f64;
        assert!(mean <= 0.1 * (high - low), "{}: {mean} of {low} … {high}", kind.name);
    }
}
