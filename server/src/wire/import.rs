//! Imports of scores on the wire.

use gleaner_proto::v1::{self, import_scores_request};

use super::field;
use crate::{
    domain::id::{EncoderId, EpisodeId, SnapshotId},
    error::{Error, Result},
    imports::{Imported, Opening},
};

/// The first message of an import; `None` if the stream ended before it.
pub(crate) fn open(first: Option<v1::ImportScoresRequest>) -> Result<Opening> {
    let Some(import_scores_request::Message::Open(open)) = first.and_then(|first| first.message) else {
        return Err(Error::invalid("open", "must be the first message: it names the snapshot"));
    };
    let v1::ImportScoresOpen { snapshot_id, source, encoder_id } = open;
    let encoder = || EncoderId::parse("open.encoder_id", &encoder_id);
    Ok(Opening {
        snapshot_id: SnapshotId::parse("open.snapshot_id", &snapshot_id)?,
        source: field::tag("open.source", source)?,
        encoder_id: if encoder_id.is_empty() { None } else { Some(encoder()?) },
    })
}

/// The next episodes.
pub(crate) fn batch(request: v1::ImportScoresRequest) -> Result<Vec<Imported>> {
    let v1::ImportedEpisodes { episodes } = match field::required("message", request.message)? {
        import_scores_request::Message::Batch(batch) => batch,
        import_scores_request::Message::Open(_) => {
            return Err(Error::invalid("open", "the stream is open already; send one for each import"));
        }
    };
    if episodes.is_empty() {
        // A stream of empty messages would never end and never be idle.
        return Err(Error::invalid("batch.episodes", "must not be empty; send episodes, or end the stream"));
    }
    let episode = |v1::ImportedEpisode { episode_id, q }| {
        Ok(Imported { episode_id: EpisodeId::parse("batch.episodes.episode_id", &episode_id)?, q })
    };
    episodes.into_iter().map(episode).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_import_begins_with_its_snapshot() {
        let opened = |snapshot_id: &str, source: &str, encoder_id: &str| {
            let (snapshot_id, source) = (snapshot_id.to_owned(), source.to_owned());
            let message = v1::ImportScoresOpen { snapshot_id, source, encoder_id: encoder_id.to_owned() };
            open(Some(v1::ImportScoresRequest { message: Some(import_scores_request::Message::Open(message)) }))
        };
        let snapshot = SnapshotId::new();
        let read = opened(snapshot.as_str(), "an oracle", "").unwrap();
        assert_eq!((read.snapshot_id, read.source.as_str(), read.encoder_id), (snapshot.clone(), "an oracle", None));
        for (opened, field) in [
            (open(None), "open: "),
            (opened("snap_1", "", ""), "open.snapshot_id: "),
            (opened(snapshot.as_str(), "a\nb", ""), "open.source: "),
            (opened(snapshot.as_str(), &"x".repeat(256), ""), "open.source: "),
            (opened(snapshot.as_str(), "", "run_1"), "open.encoder_id: "),
        ] {
            let error = opened.unwrap_err();
            assert!(error.message().starts_with(field), "{field} expected: {error}");
        }
    }

    #[test]
    fn a_batch_without_episodes_is_rejected() {
        let request = |episodes| {
            let message = import_scores_request::Message::Batch(v1::ImportedEpisodes { episodes });
            batch(v1::ImportScoresRequest { message: Some(message) })
        };
        let episode = |id: &str| v1::ImportedEpisode { episode_id: id.to_owned(), q: vec![0.5] };
        assert_eq!(request(vec![episode(EpisodeId::new().as_str())]).unwrap()[0].q, [0.5]);
        assert!(request(Vec::new()).unwrap_err().message().starts_with("batch.episodes: "));
        assert!(request(vec![episode("x")]).unwrap_err().message().starts_with("batch.episodes.episode_id: "));
        let open = import_scores_request::Message::Open(v1::ImportScoresOpen::default());
        let again = batch(v1::ImportScoresRequest { message: Some(open) }).unwrap_err();
        assert!(again.message().starts_with("open: "), "{again}");
    }
}
