//! Observations of the right form and of every wrong one, and their pixels against those of a frame cache.

use gleaner_recording::{
    CameraRef, EpisodeWriter, FrameCache, ImageRef, ImageThreads, Limits, ObservationRef, TaskSpec, cache_episode,
    encode_depth_png, encode_jpeg,
};

use super::*;
use crate::error::Kind;

fn shape() -> TaskShape {
    let camera = |name: &str, depth| CameraShape { name: name.into(), height: 8, width: 16, depth, recorded: None };
    TaskShape {
        cameras: vec![camera("top", true), camera("wrist", false)],
        proprioception: 2,
        action: 1,
        ranges: gleaner_core::action::ActionRanges::default(),
    }
}

fn raw(data: Vec<u8>) -> Option<Image> {
    Some(Image { format: ImageFormat::Raw, data: data.into() })
}

fn frame(camera: &str, color: Option<Image>, depth: Option<Image>) -> CameraFrame {
    CameraFrame { camera: camera.into(), color, depth }
}

/// A valid observation; its cameras are in another order than the task's.
fn right() -> Observation {
    Observation {
        stamp_ns: 1,
        cameras: vec![frame("wrist", raw(vec![3; 384]), None), frame("top", raw(vec![1; 384]), raw(vec![2; 256]))],
        proprioception: vec![0.5, -0.5],
        executed_action: Vec::new(),
        deadline: None,
        skipped_steps: 0,
    }
}

#[test]
fn pixels_are_in_the_order_of_the_task() {
    let step = step(&shape(), "observation", &right()).unwrap();
    assert_eq!(step.frame, [vec![1; 384], vec![2; 256], vec![3; 384]].concat());
    assert_eq!(step.proprioception, [0.5, -0.5]);
    assert_eq!(step.executed, None);
}

#[test]
fn jpeg_is_decoded_to_the_size_of_the_task() {
    let jpeg = gleaner_recording::encode_jpeg(&[200; 384], 8, 16, 90).unwrap();
    let mut observation = right();
    observation.cameras[0].color = Some(Image { format: ImageFormat::Any, data: jpeg.into() });
    let step = step(&shape(), "observation", &observation).unwrap();
    assert_eq!(step.frame.len(), shape().frame_bytes());
    assert!(step.frame[640..].iter().all(|&byte| byte.abs_diff(200) < 8));
}

/// Training reads `decode_color`, so equal bytes here mean that a model is served what it was trained on.
#[tokio::test]
async fn pictures_of_the_recorded_size_become_those_of_a_step() {
    let recorded = gleaner_recording::RecordedSize { height: 16, width: 40, crop: None };
    let mut shape = shape();
    shape.cameras[1].recorded = Some(recorded);
    let large: Vec<u8> = (0..16 * 40 * 3).map(|at| u8::try_from(at * 7 % 256).unwrap()).collect();
    let small = decode_color(&large, PixelFormat::Rgb8, &shape.cameras[1].sizes()).unwrap();
    for sent in [&large, &small] {
        let mut observation = right();
        observation.cameras[0].color = raw(sent.clone());
        assert!(!is_quick(&shape, &observation));
        let step = step_of(Arc::new(shape.clone()), "observation", observation).await.unwrap();
        assert_eq!(step.frame[640..], small);
    }
}

/// A camera with depth and a crop, and one without, both larger than a step.
fn larger() -> TaskSpec {
    serde_json::from_value(serde_json::json!({
        "name": "reach", "rate_hz": 10.0, "mappings": [],
        "cameras": [
            {
                "name": "top", "height": 20, "width": 36, "depth": true,
                "recorded": {
                    "height": 96, "width": 128, "crop": {"top": 3, "left": 20, "height": 90, "width": 96},
                },
            },
            {"name": "wrist", "height": 24, "width": 32, "depth": false, "recorded": {"height": 96, "width": 128}},
        ],
        "proprioception": [{"name": "joints", "size": 2}],
        "action": [{"name": "command", "size": 1}],
    }))
    .unwrap()
}

/// The bytes of a picture of 96 × 128 pixels with edges and gradients.
fn picture(seed: usize, pixel_bytes: usize) -> Vec<u8> {
    let bytes = 96 * 128 * pixel_bytes;
    (0..bytes).map(|at| u8::try_from((at * at / 7 + at / 384 * 31 + seed * 57) % 256).unwrap()).collect()
}

/// Trainings and scorings read the frame cache of a recording; a policy acts on the step of an observation.
#[test]
fn a_policy_sees_the_pixels_that_a_training_reads_from_the_cache() {
    const STEPS: usize = 4;
    let spec = larger();
    let folder = tempfile::tempdir().unwrap();
    let (path, cache) = (folder.path().join("a.mcap"), folder.path().join("a.frames"));
    let color: Vec<Vec<u8>> = (0..2 * STEPS).map(|seed| encode_jpeg(&picture(seed, 3), 96, 128, 90).unwrap()).collect();
    let depth: Vec<Vec<u8>> = (0..STEPS).map(|seed| picture(seed, 2)).collect();
    let mut writer = EpisodeWriter::create(std::fs::File::create(&path).unwrap(), &spec).unwrap();
    for step in 0..STEPS {
        let stamp = i64::try_from(step).unwrap() * 100_000_000;
        let value = f32::from(u8::try_from(step).unwrap());
        let top = CameraRef {
            color: ImageRef { format: PixelFormat::Jpeg, data: &color[step] },
            depth: Some(ImageRef { format: PixelFormat::Depth16, data: &depth[step] }),
        };
        let wrist =
            CameraRef { color: ImageRef { format: PixelFormat::Jpeg, data: &color[STEPS + step] }, depth: None };
        writer.observe(stamp, ObservationRef { cameras: &[top, wrist], proprioception: &[value, -value] }).unwrap();
        writer.act(stamp, &[value]).unwrap();
    }
    writer.finish().unwrap();
    let report = cache_episode(&path, &spec, (&Limits::default(), ImageThreads::NONE), &cache).unwrap();
    assert_eq!((report.steps, report.findings.len()), (4, 0), "{:?}", report.findings);
    let cached = FrameCache::open(&cache, &spec).unwrap();
    assert!(cached.frames(0..1).unwrap() != cached.frames(1..2).unwrap());

    let shape = TaskShape::from(&spec);
    for at in 0..STEPS {
        let png = encode_depth_png(&depth[at], 96, 128).unwrap();
        for (format, depth_format, depth) in [
            (ImageFormat::Jpeg, ImageFormat::Raw, &depth[at]),
            (ImageFormat::Any, ImageFormat::Png, &png),
            (ImageFormat::Any, ImageFormat::Any, &depth[at]),
        ] {
            let image = |format, data: &Vec<u8>| Some(Image { format, data: data.clone().into() });
            let mut observation = right();
            observation.cameras = vec![
                frame("wrist", image(format, &color[STEPS + at]), None),
                frame("top", image(format, &color[at]), image(depth_format, depth)),
            ];
            let served = step(&shape, "observation", &observation).unwrap();
            assert!(served.frame == cached.frames(at..at + 1).unwrap(), "step {at}, {format:?}, {depth_format:?}");
        }
    }
}

#[tokio::test]
async fn a_few_raw_images_are_decoded_at_once_and_others_off_the_runtime() {
    let of = |shape: TaskShape, observation| step_of(Arc::new(shape), "observation", observation);
    assert!(is_quick(&shape(), &right()));
    let at_once = of(shape(), right()).await.unwrap();
    assert_eq!(at_once.frame, step(&shape(), "observation", &right()).unwrap().frame);

    let jpeg = gleaner_recording::encode_jpeg(&[200; 384], 8, 16, 90).unwrap();
    let mut compressed = right();
    compressed.cameras[0].color = Some(Image { format: ImageFormat::Jpeg, data: jpeg.into() });
    assert!(!is_quick(&shape(), &compressed));
    assert_eq!(of(shape(), compressed).await.unwrap().frame.len(), shape().frame_bytes());

    let large = TaskShape {
        cameras: vec![CameraShape { name: "top".into(), height: 512, width: 512, depth: false, recorded: None }],
        ..shape()
    };
    let mut observation = right();
    observation.cameras = vec![frame("top", raw(vec![0; 512 * 512 * 3]), None)];
    assert!(!is_quick(&large, &observation));
    assert_eq!(of(large, observation).await.unwrap().frame.len(), 512 * 512 * 3);
}

#[test]
fn every_bad_observation_is_named_by_its_field() {
    type Spoil = fn(&mut Observation);
    let jpeg = |data: Vec<u8>| Some(Image { format: ImageFormat::Jpeg, data: data.into() });
    let wrong_size = gleaner_recording::encode_jpeg(&[0; 192], 8, 8, 90).unwrap();
    let mut small = right();
    small.cameras[0].color = jpeg(wrong_size);
    let error = step(&shape(), "observation", &small).unwrap_err();
    assert!(error.message().starts_with("observation.cameras[0].color: "), "{error}");
    assert!(error.message().contains("8×8"), "{error}");

    let cases: [(&str, Spoil); 15] = [
        ("observation.cameras: camera top", |o| o.cameras.truncate(1)),
        ("observation.cameras[0].camera", |o| o.cameras[0].camera = "left".into()),
        ("observation.cameras[1].camera", |o| o.cameras[1].camera = "wrist".into()),
        ("observation.cameras[0].color", |o| o.cameras[0].color = None),
        ("observation.cameras[0].color", |o| o.cameras[0].color = raw(vec![0; 383])),
        ("observation.cameras[0].color", |o| o.cameras[0].color = raw(Vec::new())),
        ("observation.cameras[1].color", |o| {
            let broken = vec![0xFF, 0xD8, 0xFF, 0xE0, 1, 2, 3];
            o.cameras[1].color = Some(Image { format: ImageFormat::Jpeg, data: broken.into() });
        }),
        ("observation.cameras[1].depth", |o| o.cameras[1].depth = None),
        ("observation.cameras[1].depth", |o| o.cameras[1].depth = raw(vec![0; 255])),
        ("observation.cameras[1].depth", |o| {
            o.cameras[1].depth = Some(Image { format: ImageFormat::Jpeg, data: vec![0; 256].into() });
        }),
        ("observation.cameras[0].depth", |o| o.cameras[0].depth = raw(vec![0; 256])),
        ("observation.proprioception: ", |o| o.proprioception.truncate(1)),
        ("observation.proprioception[1]: ", |o| o.proprioception[1] = f32::INFINITY),
        ("observation.executed_action: ", |o| o.executed_action = vec![0.0; 2]),
        ("observation.executed_action[0]: ", |o| o.executed_action = vec![f32::NAN]),
    ];
    for (field, spoil) in cases {
        let mut observation = right();
        spoil(&mut observation);
        let error = step(&shape(), "observation", &observation).unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid);
        assert!(error.message().starts_with(field), "{field} expected: {error}");
    }
}
