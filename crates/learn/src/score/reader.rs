//! The steps and kept features of episodes, read on threads of their own ahead of the episode's turn, so that encoding
//! does not wait for a disk or for decompression. Independent of what is computed from them.

use std::sync::{Mutex, OnceLock, PoisonError};

use gleaner_search::PointShape;
use tch::Device;

use super::features::kept::{self, Kept};
use super::features::{FeatureStore, chunk, chunks};
use crate::ahead::{Next, ahead};
use crate::batch::Batch;
use crate::error::LearnError;
use crate::shape::TaskShape;
use crate::trajectory::Trajectory;

/// Where episodes are read from, and how.
pub(super) struct Source<'a> {
    pub(super) shape: &'a TaskShape,
    /// That of the steps.
    pub(super) device: Device,
    /// The shape of kept features.
    pub(super) points: PointShape,
    /// Features of earlier runs; `None` where storing them does not pay off.
    pub(super) kept: Option<&'a dyn FeatureStore>,
    /// Number of threads that read.
    pub(super) threads: usize,
}

/// What was read of an episode's kept features, once for all of its pieces; its first piece takes them.
type Lookup = OnceLock<(bool, Mutex<Option<Kept>>)>;

/// A piece of an episode.
enum Piece {
    /// Its kept features, in place of the first chunk of its steps.
    Kept(Kept),
    /// A chunk of its steps.
    Steps(Batch),
    /// In place of the further chunks of an episode with kept features.
    Nothing,
}

/// What was read of an episode when its turn comes.
pub(super) enum Begun {
    /// Its kept features.
    Kept(Kept),
    /// The first chunk of its steps; [`Reader::chunk`] gives the others.
    Steps(Batch),
}

/// The pieces of episodes, in their order.
pub(super) struct Reader<'a>(Next<'a, Piece>);

impl Source<'_> {
    /// Runs `work` with a reader of `episodes`, which takes them in this order.
    pub(super) fn read_ahead<R>(
        &self,
        episodes: &[&Trajectory],
        work: impl FnOnce(&mut Reader<'_>) -> Result<R, LearnError>,
    ) -> Result<R, LearnError> {
        let of_episode = |(episode, of): (usize, &&Trajectory)| (0..chunks(of.steps())).map(move |at| (episode, at));
        let pieces: Vec<(usize, usize)> = episodes.iter().enumerate().flat_map(of_episode).collect();
        let numbers = 0..pieces.len() as u64;
        let lookups: Vec<Lookup> = episodes.iter().map(|_| Lookup::new()).collect();
        let read = |number: u64| {
            let (episode, at) =
                usize::try_from(number).ok().and_then(|number| pieces.get(number)).ok_or_else(beyond)?;
            let (lookup, episode) = (&lookups[*episode], episodes[*episode]);
            let (is_kept, kept) = lookup.get_or_init(|| {
                let kept = self.kept_features(episode);
                (kept.is_some(), Mutex::new(kept))
            });
            match (is_kept, at) {
                (true, 0) => {
                    let kept = kept.lock().unwrap_or_else(PoisonError::into_inner).take();
                    kept.map(Piece::Kept).ok_or_else(beyond)
                }
                (true, _) => Ok(Piece::Nothing),
                (false, at) => chunk(self.shape, episode, *at, self.device).map(Piece::Steps),
            }
        };
        // Each thread reads one chunk while another is encoded: with one thread, two are in memory at once.
        ahead((numbers, 0), vec![read; self.threads], |next| work(&mut Reader(next)))
    }

    fn kept_features(&self, episode: &Trajectory) -> Option<Kept> {
        kept::from_bytes(&self.kept?.get(&episode.id)?, episode.steps(), self.points)
    }
}

impl Reader<'_> {
    /// Begins `episode`, whose turn it is.
    pub(super) fn begin(&mut self, episode: &Trajectory) -> Result<Begun, LearnError> {
        match (self.0)()?.batch {
            Piece::Steps(chunk) => Ok(Begun::Steps(chunk)),
            Piece::Kept(kept) => {
                for _ in 1..chunks(episode.steps()) {
                    (self.0)()?;
                }
                Ok(Begun::Kept(kept))
            }
            Piece::Nothing => Err(beyond()),
        }
    }

    /// The next chunk of the episode that began with steps.
    pub(super) fn chunk(&mut self) -> Result<Batch, LearnError> {
        match (self.0)()?.batch {
            Piece::Steps(chunk) => Ok(chunk),
            Piece::Kept(_) | Piece::Nothing => Err(beyond()),
        }
    }
}

/// A defect of this program.
fn beyond() -> LearnError {
    LearnError::Torch("steps were requested out of their order".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::tests::Shared;
    use crate::toy;

    /// Of 300 steps each: three chunks.
    fn episodes() -> Vec<Trajectory> {
        toy::experts(3, 300)
    }

    fn features(steps: usize) -> crate::score::features::Features {
        let mut features = crate::score::features::Features::empty([1; 3]);
        features.extend([1.0, 2.0, 3.0].map(|value| vec![value; steps]));
        features
    }

    /// Reads the episodes, the second of which has kept features, with this number of threads.
    fn read_all(threads: usize) {
        let (shape, episodes, kept) = (toy::shape(), episodes(), Shared::default());
        kept.put(&episodes[1].id, &kept::exact_bytes(&features(300)).unwrap());
        let source = Source { shape: &shape, device: Device::Cpu, points: [1; 3].into(), kept: Some(&kept), threads };
        let all: Vec<&Trajectory> = episodes.iter().collect();
        let read = source.read_ahead(&all, |reader| {
            for (place, episode) in all.iter().enumerate() {
                match reader.begin(episode)? {
                    Begun::Kept(Kept::Exact(found)) => assert!(place == 1 && found.values(2)[299] == 3.0),
                    Begun::Kept(Kept::Rough(_)) => panic!("exact features were kept"),
                    Begun::Steps(first) => {
                        assert_ne!(place, 1);
                        let read = [first, reader.chunk()?, reader.chunk()?];
                        for (at, read) in read.iter().enumerate() {
                            let due = chunk(&shape, episode, at, Device::Cpu)?;
                            assert_eq!(read.proprioception, due.proprioception);
                            assert_eq!(read.images, due.images);
                        }
                    }
                }
            }
            assert!(reader.begin(all[0]).is_err() && reader.chunk().is_err(), "there are no more");
            Ok(())
        });
        read.unwrap();
    }

    #[test]
    fn episodes_come_with_their_steps_or_their_kept_features_by_any_number_of_threads() {
        [1, 2, 3, 10].into_iter().for_each(read_all);
    }

    #[test]
    fn an_error_of_reading_is_that_of_its_episode() {
        struct Unreadable;
        impl crate::StepSource for Unreadable {
            fn steps(&self) -> usize {
                5
            }
            fn widths(&self) -> crate::StepWidths {
                crate::StepWidths::from(&toy::shape())
            }
            fn numbers(&self, _: std::ops::Range<usize>) -> Result<crate::Numbers, crate::SourceError> {
                Err("the disk is gone".into())
            }
            fn frames(&self, _: std::ops::Range<usize>, _: &mut [u8]) -> Result<(), crate::SourceError> {
                Err("the disk is gone".into())
            }
        }
        let (shape, episodes) = (toy::shape(), episodes());
        let broken = Trajectory::read_from(&shape, "broken", std::sync::Arc::new(Unreadable)).unwrap();
        let source = Source { shape: &shape, device: Device::Cpu, points: [1; 3].into(), kept: None, threads: 2 };
        let error = source.read_ahead(&[&episodes[0], &broken, &episodes[1]], |reader| {
            assert!(matches!(reader.begin(&episodes[0])?, Begun::Steps(_)));
            reader.chunk()?;
            reader.chunk()?;
            Ok(reader.begin(&broken).map(drop).unwrap_err().to_string())
        });
        assert!(error.unwrap().contains("the disk is gone"));
    }
}
