//! Contents of a segment's features, and dependences that are forbidden.

use tch::no_grad_guard;

use super::*;
use crate::checkpoint::{self, CheckpointKind};
use crate::pretrain::pretrain;
use crate::score::comparison::{FeatureScale, NearestSpec, Similarity};
use crate::score::tests::encoder;
use crate::toy;
use crate::train::Silent;

const SOURCES: [Source; 2] = [Source::Features(FeatureScale::Plain), Source::Observations];

fn network() -> Network {
    read(&encoder())
}

fn read(encoder: &[u8]) -> Network {
    let (info, named) = checkpoint::read(encoder, CheckpointKind::Encoder).unwrap();
    Network::from_named(&info.shape, info.model, &named, tch::Device::Cpu).unwrap()
}

fn features(network: &Network, trajectory: &Trajectory, source: Source, similarity: Similarity) -> Features {
    let _no_grad = no_grad_guard();
    episode_features(
        Encoder { network, scale: None, view: View::WHOLE },
        trajectory,
        &Comparison::new(source, similarity, [0.0; 3], NearestSpec::default()),
    )
    .unwrap()
}

/// Steps `from..` of `trajectory`, at most `count`.
fn cut(trajectory: &Trajectory, from: usize, count: usize) -> Trajectory {
    fn part<T: Clone>(all: &[T], width: usize, (from, count): (usize, usize)) -> Vec<T> {
        all[from * width..(from + count) * width].to_vec()
    }
    let shape = toy::shape();
    let arrays = trajectory.arrays();
    let frames = part(&arrays.frames, shape.frame_bytes(), (from, count));
    let m = part(&arrays.proprioception, shape.proprioception, (from, count));
    let a = part(&arrays.action, shape.action, (from, count));
    Trajectory::new(&shape, "cut", frames, m, a).unwrap()
}

fn assert_close(a: &[f32], b: &[f32]) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
}

#[test]
fn features_do_not_depend_on_what_comes_after_or_is_in_the_same_pass() {
    let (network, long) = (network(), toy::episode("long", 5, 20, true));
    let short = cut(&long, 0, 11);
    for source in SOURCES {
        for similarity in [Similarity::LastL2, Similarity::SegmentL2] {
            let of = |trajectory| features(&network, trajectory, source, similarity);
            let (long, short) = (of(&long), of(&short));
            for modality in 0..3 {
                (0..11).for_each(|step| assert_close(long.row(modality, step), short.row(modality, step)));
            }
        }
    }
}

#[test]
fn features_do_not_depend_on_what_came_before_the_window() {
    let (network, long) = (network(), toy::episode("long", 5, 20, true));
    let (window, late) = (network.spec.window(), cut(&long, 6, 14));
    for source in SOURCES {
        for similarity in [Similarity::LastL2, Similarity::SegmentL2] {
            let of = |trajectory| features(&network, trajectory, source, similarity);
            let (long, late) = (of(&long), of(&late));
            for modality in 0..3 {
                for step in window - 1..14 {
                    assert_close(long.row(modality, step + 6), late.row(modality, step));
                }
            }
        }
    }
}

#[test]
fn a_segment_ends_with_the_last_step_and_its_padding_is_zero() {
    let (network, episode) = (network(), toy::episode("e", 5, 9, true));
    let window = network.spec.window();
    for source in SOURCES {
        let last = features(&network, &episode, source, Similarity::LastL2);
        let whole = features(&network, &episode, source, Similarity::SegmentL2);
        for modality in 0..3 {
            let width = last.widths()[modality];
            assert_eq!(whole.widths()[modality], window * width);
            for step in 0..9 {
                let row = whole.row(modality, step);
                assert_close(&row[(window - 1) * width..], last.row(modality, step));
                let padding = window.saturating_sub(step + 1) * width;
                assert!(row[..padding].iter().all(|value| *value == 0.0));
                assert!(row[padding..].iter().any(|value| *value != 0.0));
            }
        }
    }
}

#[test]
fn raw_features_are_the_standardised_values_and_weigh_alike() {
    let (network, episode) = (network(), toy::episode("e", 5, 9, true));
    let raw = features(&network, &episode, Source::Observations, Similarity::LastL2);
    let standard =
        network.statistics.action.apply(&crate::batch::rows(&episode.actions().unwrap(), 2, tch::Device::Cpu));
    let expected: Vec<f32> = values(&standard).iter().map(|value| value / 2f32.sqrt()).collect();
    assert_close(raw.values(2), &expected);
    assert_eq!((raw.widths(), raw.count()), ([4 * 8 * 8, 3, 2], 9));
}

#[test]
fn raw_features_of_a_larger_preset_are_as_small() {
    let mut spec = toy::pretrain_spec(1);
    spec.model.preset = gleaner_core::Preset::Small;
    let larger = pretrain(&toy::shape(), &toy::experts(3, 10), &spec, None, None, &mut Silent).unwrap();
    let (larger, network, episode) = (read(&larger), network(), toy::episode("e", 5, 9, true));
    let images = tch::Tensor::zeros([1, 4, 16, 16], tch::kind::FLOAT_CPU);
    assert_eq!(larger.statistics.cameras[0].small(&images).size(), [1, 4, 16, 16]);
    let of = |network| features(network, &episode, Source::Observations, Similarity::LastL2);
    let (small, large) = (of(&network), of(&larger));
    assert_eq!(large.widths(), small.widths());
    (1..3).for_each(|modality| assert_close(small.values(modality), large.values(modality)));
    // The same pixels in units of another deviation, one for each channel.
    for (small, large) in small.values(0).chunks(8 * 8).zip(large.values(0).chunks(8 * 8)).take(4) {
        let largest = (0..8 * 8).max_by(|a, b| small[*a].abs().total_cmp(&small[*b].abs())).unwrap();
        let factor = large[largest] / small[largest];
        assert!(factor > 0.1, "{factor}");
        assert_close(large, &small.iter().map(|value| value * factor).collect::<Vec<_>>());
    }
}
