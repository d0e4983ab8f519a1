//! Whether a score run waits for its episodes: its speed from the cache of decoded steps, beside the same episodes decoded
//! in memory, in turns. Two cameras of 480 × 640 in JPEG, learned from at 128 × 128. One thread for the tensor library, or
//! the number in the variable `THREADS`; reading has a thread of its own. Its argument is the number of episodes of 200
//! steps (20).
//!
//! With `SEGMENTS`, one run of that number of segments in place of the turns: the imperfect episodes are repeated, each
//! time under another name, beside the same experts. It is compared with the experts and as many imperfect episodes in
//! memory. `SCORER` runs one scorer alone.

#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

use std::{fs::File, ops::Range, path::Path, sync::Arc, time::Instant};

use gleaner_core::{ModelSpec, OptimSpec, Preset, PretrainSpec, ScoreSpec};
use gleaner_learn::{
    Forgetful, Numbers, ScoreInputs, Silent, SourceError, StepSource, StepWidths, TaskShape, Trajectory, pretrain,
    score,
};
use gleaner_recording::{
    CameraRef, EpisodeWriter, FrameCache, ImageRef, ImageThreads, Limits, ObservationRef, PixelFormat, TaskSpec,
    cache_episode, encode_jpeg,
};

const ROUNDS: usize = 3;
const STEPS: u32 = 200;
const HEIGHT: u32 = 480;
const WIDTH: u32 = 640;
/// Pictures that the cameras show in turn.
const PICTURES: u32 = 24;
/// One episode in this many is an expert.
const EXPERTS: usize = 4;

/// The steps of a cache, as a worker reads them.
struct Cached(FrameCache, TaskShape);

impl StepSource for Cached {
    fn steps(&self) -> usize {
        self.0.steps()
    }

    fn widths(&self) -> StepWidths {
        StepWidths::from(&self.1)
    }

    fn numbers(&self, steps: Range<usize>) -> Result<Numbers, SourceError> {
        let numbers = self.0.numbers(steps)?;
        Ok(Numbers { proprioception: numbers.proprioception, action: numbers.action })
    }

    fn frames(&self, steps: Range<usize>, frames: &mut [u8]) -> Result<(), SourceError> {
        Ok(self.0.read_frames(steps, frames)?)
    }
}

fn main() {
    let argument = |text: Option<String>, default| text.and_then(|text| text.parse().ok()).unwrap_or(default);
    let episodes: u32 = argument(std::env::args().find(|text| text.parse::<u32>().is_ok()), 20);
    let threads: u32 = argument(std::env::var("THREADS").ok(), 1);
    let spec = task();
    let shape = TaskShape::from(&spec);
    let folder = tempfile::tempdir().unwrap();
    let pictures: Vec<Vec<u8>> = (0..PICTURES).map(picture).collect();
    let caches: Vec<Arc<Cached>> =
        (0..episodes).map(|episode| Arc::new(recorded((&spec, &pictures), &shape, folder.path(), episode))).collect();
    let id = |episode: usize| format!("episode {episode:03}");
    let of =
        |(at, cache): (usize, &Arc<Cached>)| Trajectory::read_from(&shape, id(at), Arc::clone(cache) as _).unwrap();
    let cached: Vec<Trajectory> = caches.iter().enumerate().map(of).collect();
    let of = |(at, cache): (usize, &Arc<Cached>)| in_memory(&shape, id(at), cache);
    let whole = std::env::var("SEGMENTS").ok().and_then(|text| text.parse::<usize>().ok());
    let experts = caches.len() / EXPERTS;
    let in_turns = if whole.is_some() { 2 * experts } else { caches.len() };
    let decoded: Vec<Trajectory> = caches[..in_turns].iter().enumerate().map(of).collect();
    let optim = OptimSpec { steps: 1, batch: 1, ..OptimSpec::default() };
    let model = ModelSpec { preset: Preset::Small, ..ModelSpec::default() };
    let pretrained = PretrainSpec { model, optim, threads: Some(threads), ..PretrainSpec::default() };
    let encoder = pretrain(&shape, &decoded[..1], &pretrained, None, None, &mut Silent).unwrap();
    let chosen = std::env::var("SCORER").ok();
    for scorer in ["ssdf", "raw"].into_iter().filter(|scorer| chosen.as_ref().is_none_or(|name| name == scorer)) {
        let values = [("scorer".to_owned(), scorer.into())].into_iter().collect();
        let spec = ScoreSpec { threads: Some(threads), ..ScoreSpec::from_values(&values).unwrap() };
        let run = |episodes: &[Trajectory]| {
            let (experts, imperfect) = episodes.split_at(experts);
            let begun = Instant::now();
            let inputs = ScoreInputs { encoder: &encoder, experts, imperfect, kept: &Forgetful };
            let scores = score(inputs, &spec, &mut Silent).unwrap();
            (begun.elapsed().as_secs_f64(), scores)
        };
        if let Some(segments) = whole {
            let count = segments / STEPS as usize;
            let again = |at: usize| &caches[if at < experts { at } else { experts + at % (caches.len() - experts) }];
            let of = |at| Trajectory::read_from(&shape, id(at), Arc::clone(again(at)) as _).unwrap();
            let many: Vec<Trajectory> = (0..count).map(of).collect();
            let [limit, reached] = [&decoded, &many].map(|episodes| rate(episodes.len(), run(episodes).0));
            println!(
                "{scorer}, {threads} threads, {segments} segments: {limit:.0} segments/s in memory, {reached:.0} from the \
                 cache; ratio {:.2}",
                reached / limit
            );
            continue;
        }
        let rounds: Vec<[f64; 2]> = (0..ROUNDS)
            .map(|_| {
                let ((in_memory, expected), (from_cache, scores)) = (run(&decoded), run(&cached));
                assert_eq!(scores, expected, "the same steps give the same scores");
                [in_memory, from_cache]
            })
            .collect();
        let fastest = |which: usize| rounds.iter().map(|round| round[which]).fold(f64::INFINITY, f64::min);
        let [limit, reached] = [0, 1].map(|which| rate(caches.len(), fastest(which)));
        println!(
            "{scorer}, {threads} threads: {limit:.0} segments/s in memory, {reached:.0} from the cache; ratio {:.2}",
            reached / limit
        );
    }
}

/// Segments a second.
fn rate(episodes: usize, seconds: f64) -> f64 {
    episodes as f64 * f64::from(STEPS) / seconds
}

fn task() -> TaskSpec {
    let camera = |name: &str| {
        serde_json::json!({
            "name": name, "height": 128, "width": 128, "recorded": {"height": HEIGHT, "width": WIDTH},
        })
    };
    serde_json::from_value(serde_json::json!({
        "name": "bench", "rate_hz": 20, "mappings": [], "cameras": [camera("front"), camera("wrist")],
        "proprioception": [{"name": "joints", "size": 7}], "action": [{"name": "command", "size": 7}],
    }))
    .unwrap()
}

/// An episode of scenes with slopes, edges and noise, decoded into a cache.
fn recorded((spec, pictures): (&TaskSpec, &[Vec<u8>]), shape: &TaskShape, folder: &Path, episode: u32) -> Cached {
    let (recording, cache) = (folder.join("recording.mcap"), folder.join(format!("{episode}.frames")));
    let mut writer = EpisodeWriter::create(File::create(&recording).unwrap(), spec).unwrap();
    for step in 0..STEPS {
        let shown = |camera: u32| &pictures[((step + 5 * episode + 7 * camera) % PICTURES) as usize];
        let color = |data| CameraRef { color: ImageRef { format: PixelFormat::Jpeg, data }, depth: None };
        let cameras = [0, 1].map(|camera| color(shown(camera)));
        let values: Vec<f32> = (0..7u8).map(|at| (step as f32 / 9.0 + f32::from(at)).sin()).collect();
        let stamp = i64::from(step) * 50_000_000;
        writer.observe(stamp, ObservationRef { cameras: &cameras, proprioception: &values }).unwrap();
        writer.act(stamp, &values).unwrap();
    }
    writer.finish().unwrap();
    let threads = ImageThreads { count: 2, bytes: 64 << 20 };
    cache_episode(&recording, spec, (&Limits::ADMITTED, threads), &cache).unwrap();
    Cached(FrameCache::open(&cache, spec).unwrap(), shape.clone())
}

fn picture(at: u32) -> Vec<u8> {
    let mut state = at + 1;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 28
    };
    let mut rgb = Vec::new();
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let edge = if (column + at * 3) / 24 % 2 == row / 32 % 2 { 70 } else { 0 };
            let base = 40 + edge + row * 60 / HEIGHT + noise();
            rgb.extend([base, base + column * 50 / WIDTH, 200 - base / 2].map(|value| u8::try_from(value).unwrap()));
        }
    }
    encode_jpeg(&rgb, HEIGHT, WIDTH, 85).unwrap()
}

/// The same steps, decoded.
fn in_memory(shape: &TaskShape, id: String, cache: &Cached) -> Trajectory {
    let steps = 0..cache.steps();
    let mut frames = vec![0; steps.len() * shape.frame_bytes()];
    cache.frames(steps.clone(), &mut frames).unwrap();
    let Numbers { proprioception, action } = cache.numbers(steps).unwrap();
    Trajectory::new(shape, id, frames, proprioception, action).unwrap()
}
