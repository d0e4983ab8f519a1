//! Features that score jobs compute, cached beside the decoded steps they come from: a run that extends another one, or
//! compares with other settings, encodes only new episodes. They can be computed again, so no error here fails a job.

use std::{
    collections::HashMap,
    io::Write as _,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

use gleaner_learn::FeatureStore;
use gleaner_recording::TaskSpec;

use gleaner_core::{
    error::{Error, Result},
    id::BlobId,
    work::{InputEpisode, Inputs},
};
use gleaner_data_folder::{FEATURES, blobs::Blobs, caches, frames_path};

/// Free bytes to leave beyond the limit of other writes, so that features never take the last space from data that
/// cannot be rebuilt.
const SPARE: u64 = 2 << 30;

/// The level of compression: values of features are used about equally often, which every level finds.
const LEVEL: i32 = 1;

/// The features of a job's episodes under one encoder.
pub(crate) struct KeptFeatures<'a> {
    blobs: &'a Blobs,
    /// Folder of files that are not complete yet.
    unfinished: PathBuf,
    /// Places by the episodes' ids.
    places: HashMap<&'a str, Place>,
    /// Set once a write failed; no features are stored after that.
    full: AtomicBool,
}

/// The file of one episode's features.
struct Place {
    path: PathBuf,
    /// A digest of all inputs of the features.
    key: blake3::Hash,
}

impl<'a> KeptFeatures<'a> {
    /// The features of `inputs` under their encoder; `kind` is the rest of their key.
    pub(crate) fn new(data_dir: &Path, blobs: &'a Blobs, inputs: &'a Inputs, kind: &str) -> Self {
        let place = |episode: &'a InputEpisode| {
            let place = place(data_dir, &inputs.task, episode, (inputs.encoder.as_ref()?, kind))?;
            Some((episode.id.as_str(), place))
        };
        let places = inputs.experts.iter().chain(&inputs.imperfect).filter_map(place).collect();
        Self { blobs, unfinished: data_dir.join("tmp"), places, full: AtomicBool::new(false) }
    }

    /// Writes a digest of the key and of the compressed bytes, then these; the file gets its name once it is complete.
    fn write(&self, place: &Place, bytes: &[u8]) -> Result<()> {
        let bytes =
            &*zstd::bulk::compress(bytes, LEVEL).map_err(|error| Error::internal("compressing features", error))?;
        self.blobs.expect_room(SPARE.saturating_add(bytes.len() as u64))?;
        self.blobs.caches().fit(bytes.len() as u64)?;
        let fault = |error: std::io::Error| Error::internal(format!("keeping {}", place.path.display()), error);
        let mut file = tempfile::Builder::new().prefix("features-").tempfile_in(&self.unfinished).map_err(fault)?;
        file.write_all(place.digest(bytes).as_bytes()).and_then(|()| file.write_all(bytes)).map_err(fault)?;
        file.persist(&place.path).map_err(|error| fault(error.error))?;
        Ok(())
    }
}

/// The place of features, whose inputs are the recording, the task's reading of it, the encoder and `made_by.1`.
fn place(data_dir: &Path, task: &TaskSpec, episode: &InputEpisode, made_by: (&BlobId, &str)) -> Option<Place> {
    let frames = frames_path(data_dir, &episode.recording, task);
    let (encoder, kind) = made_by;
    let key = blake3::hash(format!("{} {encoder} {kind}", frames.file_name()?.to_str()?).as_bytes());
    let name = format!("{}-{}.{FEATURES}", episode.recording, key.to_hex().get(..16)?);
    Some(Place { path: frames.with_file_name(name), key })
}

impl Place {
    /// The digest of these bytes at this place: a file under another name does not match either.
    fn digest(&self, bytes: &[u8]) -> blake3::Hash {
        blake3::keyed_hash(self.key.as_bytes(), bytes)
    }
}

impl FeatureStore for KeptFeatures<'_> {
    fn get(&self, episode: &str) -> Option<Vec<u8>> {
        let place = self.places.get(episode)?;
        // In most cases there is no file.
        let bytes = std::fs::read(&place.path).ok()?;
        caches::note_use(&place.path);
        let (digest, features) = bytes.split_first_chunk::<{ blake3::OUT_LEN }>()?;
        if place.digest(features) != *digest {
            tracing::warn!(episode.id = episode, "its kept features are damaged; computing them again");
            return None;
        }
        zstd::stream::decode_all(features).ok()
    }

    fn put(&self, episode: &str, bytes: &[u8]) {
        let Some(place) = self.places.get(episode) else { return };
        if self.full.load(Ordering::Relaxed) {
            return;
        }
        if let Err(error) = self.write(place, bytes) {
            tracing::warn!(%error, "features cannot be written; further ones are not kept");
            self.full.store(true, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use gleaner_core::{episode::Outcome, id::EpisodeId};

    fn inputs(task: &TaskSpec, encoder: &[u8]) -> Inputs {
        let episode = |content: &[u8]| InputEpisode {
            id: EpisodeId::new(),
            recording: blake3::hash(content).into(),
            steps: 3,
            file_name: String::new(),
            outcome: Outcome::Unknown,
            cohort: String::new(),
        };
        Inputs {
            task: task.clone(),
            experts: vec![episode(b"one")],
            imperfect: vec![episode(b"two")],
            kept: Vec::new(),
            encoder: Some(blake3::hash(encoder).into()),
            checkpoint: None,
            segment_length: 0,
            origin: BTreeMap::new(),
            policy: None,
            base: None,
        }
    }

    #[test]
    fn features_are_found_for_the_same_encoder_and_kind_only() {
        let dir = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(dir.path()).unwrap();
        std::fs::create_dir_all(dir.path().join("cache")).unwrap();
        let task = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &gleaner_sim::SimConfig::default());
        let inputs = inputs(&task, b"encoder");
        let (one, two) = (inputs.experts[0].id.as_str(), inputs.imperfect[0].id.as_str());
        let store = KeptFeatures::new(dir.path(), &blobs, &inputs, "last");
        store.put(one, b"features of one");
        store.put("another episode", b"features");
        assert_eq!(store.get(one).unwrap(), b"features of one");
        assert_eq!((store.get(two), store.get("another episode")), (None, None));
        assert_eq!(KeptFeatures::new(dir.path(), &blobs, &inputs, "segment").get(one), None);
        let other = Inputs { encoder: Some(blake3::hash(b"other").into()), ..inputs.clone() };
        assert_eq!(KeptFeatures::new(dir.path(), &blobs, &other, "last").get(one), None);
        assert_eq!(std::fs::read_dir(dir.path().join("tmp")).unwrap().count(), 0);

        let place = &store.places[one].path;
        let mut bytes = std::fs::read(place).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(place, &bytes).unwrap();
        assert_eq!(store.get(one), None, "rotten");
        std::fs::write(place, b"short").unwrap();
        assert_eq!(store.get(one), None);
        store.put(one, b"again");
        assert_eq!(store.get(one).unwrap(), b"again");
        std::fs::copy(place, &store.places[two].path).unwrap();
        assert_eq!(store.get(two), None, "another's");
    }

    #[test]
    fn a_full_disk_keeps_no_features_and_fails_no_job() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(dir.path().join("cache")).unwrap();
        // Enough for all other writes.
        let free = std::sync::Arc::new((SPARE / 2).into());
        let blobs = Blobs::open(dir.path()).unwrap().sparing(100).playing(&free);
        let task = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &gleaner_sim::SimConfig::default());
        let inputs = inputs(&task, b"encoder");
        let store = KeptFeatures::new(dir.path(), &blobs, &inputs, "last");
        let one = inputs.experts[0].id.as_str();
        store.put(one, b"features");
        assert_eq!(store.get(one), None);
        free.store(u64::MAX, std::sync::atomic::Ordering::Relaxed);
        store.put(one, b"features");
        assert_eq!(store.get(one), None, "this job tries no more");
        let next = KeptFeatures::new(dir.path(), &blobs, &inputs, "last");
        next.put(one, b"features");
        assert_eq!(next.get(one).unwrap(), b"features");
    }
}
