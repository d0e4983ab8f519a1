//! Clips of an episode, whose frames have their progress as targets: forward, or rewound at the end as in ReWiND (Zhang
//! et al. 2025). Independent of networks.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Frames of a clip that the network receives, evenly spaced.
pub(super) const FRAMES: usize = 8;
/// Steps of the shortest episode that clips are drawn from.
pub(super) const SHORTEST: usize = APART + 1;
/// Least number of steps from the start of a clip to its end.
const APART: usize = 3;
/// Chance that a clip is rewound.
const REWOUND: f64 = 0.8;

/// Frames and their targets, in the order of the clip.
#[derive(Debug, PartialEq)]
pub(super) struct Clip {
    /// Steps of the episode.
    pub(super) frames: [usize; FRAMES],
    /// Progress at each frame, in (0, 1].
    pub(super) targets: [f32; FRAMES],
}

impl Clip {
    /// Draws a clip of an episode of `steps` steps, at least [`SHORTEST`].
    pub(super) fn draw(rng: &mut ChaCha8Rng, steps: usize) -> Self {
        let (ends, rewound) = Self::draw_ends(rng, steps);
        Self::new(steps, ends, rewound)
    }

    /// The first and the last step of a clip, and by how many steps it is rewound. A rewound one starts in the first
    /// half of the episode and turns around in the second.
    fn draw_ends(rng: &mut ChaCha8Rng, steps: usize) -> ((usize, usize), usize) {
        let rewinds = rng.random_bool(REWOUND);
        let half = if rewinds { steps / 2 } else { steps };
        let start = rng.random_range(0..half.min(steps - APART));
        let first = if rewinds { half.max(start + APART) } else { start + APART };
        let end = rng.random_range(first..steps);
        let rewound = if rewinds { rng.random_range(1..=end - start) } else { 0 };
        ((start, end), rewound)
    }

    /// The steps `start` to `end` of an episode of `steps` steps, then the `rewound` steps before `end` in reverse. The
    /// target of a step is its share of the steps from `start` to the end of the episode.
    fn new(steps: usize, (start, end): (usize, usize), rewound: usize) -> Self {
        let forward = end - start + 1;
        let places = places(forward + rewound);
        let frames = places.map(|place| if place < forward { start + place } else { end - (place + 1 - forward) });
        #[expect(clippy::cast_precision_loss, reason = "an episode has far fewer steps than 2^24")]
        let targets = frames.map(|frame| (frame - start + 1) as f32 / (steps - start) as f32);
        Self { frames, targets }
    }
}

/// [`FRAMES`] evenly spaced places among `count`, the first and the last included, rounded to the nearest.
pub(super) fn places(count: usize) -> [usize; FRAMES] {
    let gaps = FRAMES - 1;
    std::array::from_fn(|place| (2 * place * (count - 1) + gaps) / (2 * gaps))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator};

    #[test]
    fn a_rewound_clip_has_falling_targets_after_the_turn() {
        let clip = Clip::new(10, (2, 6), 3);
        assert_eq!(clip.frames, [2, 3, 4, 5, 6, 5, 4, 3]);
        assert_eq!(clip.targets, [1.0, 2.0, 3.0, 4.0, 5.0, 4.0, 3.0, 2.0].map(|steps| steps / 8.0));
        // Eleven forward and ten back: every third of the 21 is kept.
        let long = Clip::new(20, (5, 15), 10);
        assert_eq!(long.frames, [5, 8, 11, 14, 14, 11, 8, 5]);
        assert_eq!(long.targets, [1.0, 4.0, 7.0, 10.0, 10.0, 7.0, 4.0, 1.0].map(|steps| steps / 15.0));
    }

    #[test]
    fn a_forward_clip_reaches_one_at_the_end_of_the_episode() {
        let clip = Clip::new(12, (4, 11), 0);
        assert_eq!(
            (clip.frames, clip.targets),
            ([4, 5, 6, 7, 8, 9, 10, 11], std::array::from_fn(|at| (at + 1) as f32 / 8.0))
        );
    }

    #[test]
    fn places_are_even_and_include_both_ends() {
        assert_eq!(places(8), [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(places(22), [0, 3, 6, 9, 12, 15, 18, 21]);
        assert_eq!(places(1), [0; 8]);
        assert_eq!(places(3), [0, 0, 1, 1, 1, 1, 2, 2]);
    }

    #[test]
    fn four_in_five_clips_are_rewound_and_all_stay_within_the_episode() {
        for steps in [SHORTEST, 5, 9, 40] {
            let mut rewinds = 0;
            for counter in 0..1000 {
                let mut rng = generator(2, Purpose::Batch, counter);
                let ((start, end), rewound) = Clip::draw_ends(&mut rng, steps);
                assert!(start + 3 <= end && end < steps && rewound <= end - start, "{steps}: {start} {end} {rewound}");
                if rewound > 0 {
                    rewinds += 1;
                    assert!(start < steps / 2 && end >= steps / 2, "{steps}: {start} {end}");
                }
                let Clip { frames, targets } = Clip::new(steps, (start, end), rewound);
                assert_eq!((frames[0], frames[FRAMES - 1]), (start, end - rewound));
                assert!(frames.iter().all(|frame| (start..=end).contains(frame)), "{frames:?}");
                assert!(targets.iter().all(|target| *target > 0.0 && *target <= 1.0), "{targets:?}");
            }
            // Of 1,000 draws with chance 0.8, the standard deviation is 13.
            assert!((740..860).contains(&rewinds), "{steps}: {rewinds}");
        }
    }
}
