//! A job's result as a stream of messages: split by the worker, joined by the server.

use gleaner_proto::v1;

use crate::{
    dataset::ExportFile,
    error::{Error, Result},
    id::{BlobId, EpisodeId},
    proto::{evaluation, field, score, snapshot},
    score::EpisodeScores,
    work::Made,
};

/// Files of an export in one message, which has a greatest size.
const FILES: usize = 1_000;

/// A result that is still arriving.
#[derive(Debug, Default)]
pub struct Completion(Option<Made>);

impl Completion {
    /// Adds the next message: first a result, then, for a score run, episodes, or, for an export, more of its files.
    ///
    /// # Errors
    /// Invalid when the message is out of order or a field is wrong.
    pub fn push(&mut self, message: v1::CompleteJobRequest) -> Result<()> {
        let v1::CompleteJobRequest { message } = message;
        let message = field::required("message", message)?;
        if let v1::complete_job_request::Message::EpisodeScores(scores) = message {
            return match &mut self.0 {
                Some(Made::Scores { episodes, .. }) => {
                    episodes.push(scores_from(scores)?);
                    Ok(())
                }
                Some(Made::Encoder { .. } | Made::Policy { .. } | Made::Files(_) | Made::Trials(_)) | None => {
                    Err(Error::invalid("message.episode_scores", "must follow a score result"))
                }
            };
        }
        if let (Some(Made::Files(files)), v1::complete_job_request::Message::Export(more)) = (&mut self.0, &message) {
            files.extend(files_from(more.clone())?);
            return Ok(());
        }
        if self.0.is_some() {
            return Err(Error::invalid("message", "must be the only result"));
        }
        self.0 = Some(first(message)?);
        Ok(())
    }

    /// The whole result.
    ///
    /// # Errors
    /// Invalid when no message came.
    pub fn whole(self) -> Result<Made> {
        field::required("message", self.0)
    }
}

fn first(message: v1::complete_job_request::Message) -> Result<Made> {
    match message {
        v1::complete_job_request::Message::Encoder(v1::EncoderResult { blob }) => {
            Ok(Made::Encoder { checkpoint: BlobId::parse("message.encoder.blob", &blob)? })
        }
        v1::complete_job_request::Message::Policy(v1::PolicyResult { blob, kind }) => Ok(Made::Policy {
            checkpoint: BlobId::parse("message.policy.blob", &blob)?,
            kind: field::text("message.policy.kind", kind)?,
        }),
        v1::complete_job_request::Message::Export(result) => files_from(result).map(Made::Files),
        v1::complete_job_request::Message::Score(result) => {
            let v1::ScoreResult { lo, hi, expert_ids, quantiles } = result;
            if [lo, hi].iter().chain(&quantiles).any(|w| !w.is_finite()) || !quantiles.is_sorted() {
                return Err(Error::invalid("message.score", "lo, hi and quantiles must be finite, quantiles sorted"));
            }
            let expert = |id: &String| EpisodeId::parse("message.score.expert_ids", id);
            Ok(Made::Scores {
                lo,
                hi,
                quantiles,
                expert_ids: expert_ids.iter().map(expert).collect::<Result<_>>()?,
                episodes: Vec::new(),
            })
        }
        v1::complete_job_request::Message::Evaluation(v1::EvaluationResult { seeds }) => {
            evaluation::seeds_from_proto("message.evaluation.seeds", seeds).map(Made::Trials)
        }
        v1::complete_job_request::Message::EpisodeScores(_) => {
            Err(Error::invalid("message.episode_scores", "must follow a score result"))
        }
    }
}

fn files_from(v1::ExportResult { files }: v1::ExportResult) -> Result<Vec<ExportFile>> {
    files.into_iter().map(file_from).collect()
}

fn file_from(file: v1::ExportedFile) -> Result<ExportFile> {
    let v1::ExportedFile { name, blob, size_bytes } = file;
    let name = field::text("message.export.files.name", name)?;
    if name.split('/').any(|part| part.is_empty() || part.starts_with('.')) {
        return Err(Error::invalid(
            "message.export.files.name",
            "must be a plain file name, with plain folders before it",
        ));
    }
    Ok(ExportFile { name, blob: BlobId::parse("message.export.files.blob", &blob)?, size_bytes })
}

/// Reads one episode's scores.
pub(super) fn scores_from(scores: v1::EpisodeScores) -> Result<EpisodeScores> {
    let v1::EpisodeScores {
        episode_id,
        role,
        w,
        q,
        match_episode,
        match_step,
        distance_o,
        distance_m,
        distance_a,
        expert_ids: _,
    } = scores;
    if distance_m.len() != distance_o.len() || distance_a.len() != distance_o.len() {
        return Err(Error::invalid("message.episode_scores", "the three distances must have the same length"));
    }
    let distances = distance_o.into_iter().zip(distance_m).zip(distance_a).map(|((o, m), a)| [o, m, a]).collect();
    Ok(EpisodeScores {
        episode_id: EpisodeId::parse("message.episode_scores.episode_id", &episode_id)?,
        role: snapshot::role_from_proto("message.episode_scores.role", role)?,
        w,
        q,
        match_episode,
        match_step,
        distances,
    })
}

/// The messages that carry a result.
pub fn completion_messages(made: Made) -> Vec<v1::CompleteJobRequest> {
    use v1::complete_job_request::Message;
    let wrap = |message| v1::CompleteJobRequest { message: Some(message) };
    match made {
        Made::Encoder { checkpoint } => vec![wrap(Message::Encoder(v1::EncoderResult { blob: checkpoint.into() }))],
        Made::Policy { checkpoint, kind } => {
            vec![wrap(Message::Policy(v1::PolicyResult { blob: checkpoint.into(), kind }))]
        }
        Made::Files(files) => {
            let file = |ExportFile { name, blob, size_bytes }| v1::ExportedFile { name, blob: blob.into(), size_bytes };
            let files: Vec<v1::ExportedFile> = files.into_iter().map(file).collect();
            // An export without files is a result too.
            let parts = files.chunks(FILES).chain(files.is_empty().then_some(&[][..]));
            parts.map(|files| wrap(Message::Export(v1::ExportResult { files: files.to_vec() }))).collect()
        }
        Made::Trials(seeds) => {
            let seeds = seeds.into_iter().map(evaluation::seed_to_proto).collect();
            vec![wrap(Message::Evaluation(v1::EvaluationResult { seeds }))]
        }
        Made::Scores { lo, hi, quantiles, expert_ids, episodes } => {
            let expert_ids = expert_ids.into_iter().map(Into::into).collect();
            let result = v1::ScoreResult { lo, hi, expert_ids, quantiles };
            let episode = |scores| wrap(Message::EpisodeScores(score::episode_scores(scores, Vec::new())));
            std::iter::once(wrap(Message::Score(result))).chain(episodes.into_iter().map(episode)).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{evaluation::SeedResult, snapshot::Role};

    fn scores() -> Made {
        Made::Scores {
            lo: -3.0,
            hi: -0.5,
            quantiles: vec![-3.0, -0.5],
            expert_ids: vec![EpisodeId::new()],
            episodes: vec![EpisodeScores {
                episode_id: EpisodeId::new(),
                role: Role::Imperfect,
                w: vec![-1.0, -2.0],
                q: vec![0.8, 0.4],
                match_episode: vec![0, 0],
                match_step: vec![5, 6],
                distances: vec![[0.1, 0.2, 0.7], [1.0, 0.5, 0.5]],
            }],
        }
    }

    fn put_together(messages: Vec<v1::CompleteJobRequest>) -> Result<Made> {
        let mut completion = Completion::default();
        messages.into_iter().try_for_each(|message| completion.push(message))?;
        completion.whole()
    }

    #[test]
    fn every_result_survives_the_wire() {
        let blob = BlobId::from(blake3::hash(b"result"));
        for made in [
            scores(),
            Made::Encoder { checkpoint: blob.clone() },
            Made::Policy { checkpoint: blob.clone(), kind: "finetune".into() },
            Made::Files(vec![ExportFile { name: "manifest.jsonl".into(), blob, size_bytes: 3 }]),
            Made::Trials(vec![SeedResult { seed: 2, episodes: 10, successes: 7, mean_steps: 31.5 }]),
        ] {
            assert_eq!(put_together(completion_messages(made.clone())).unwrap(), made);
        }
    }

    #[test]
    fn messages_out_of_order_are_rejected() {
        let mut swapped = completion_messages(scores());
        swapped.reverse();
        assert!(put_together(swapped).is_err());
        let twice = [completion_messages(scores()), completion_messages(scores())].concat();
        assert!(put_together(twice).unwrap_err().message().contains("the only result"));
        let file = ExportFile { name: "a".into(), blob: BlobId::from(blake3::hash(b"a")), size_bytes: 1 };
        let other = Made::Encoder { checkpoint: file.blob.clone() };
        let mixed = [completion_messages(Made::Files(vec![file])), completion_messages(other)].concat();
        assert!(put_together(mixed).unwrap_err().message().contains("the only result"));
        assert_eq!(put_together(Vec::new()).unwrap_err().message(), "message: must be set");
    }

    #[test]
    fn an_export_of_many_files_is_several_messages() {
        let blob = BlobId::from(blake3::hash(b"result"));
        for (count, messages) in [(0, 1), (1, 1), (FILES, 1), (FILES + 1, 2), (3 * FILES, 3)] {
            let file = |number| ExportFile { name: format!("{number}.mcap"), blob: blob.clone(), size_bytes: 3 };
            let made = Made::Files((0..count).map(file).collect());
            let sent = completion_messages(made.clone());
            assert_eq!(sent.len(), messages, "{count}");
            assert_eq!(put_together(sent).unwrap(), made);
        }
    }

    #[test]
    fn an_exported_name_stays_in_its_folder() {
        let blob = BlobId::from(blake3::hash(b"result"));
        for name in ["../escape", "a/../../b", "/a", "a//b", "a/", ".hidden", "a/.hidden", ""] {
            let file = ExportFile { name: name.into(), blob: blob.clone(), size_bytes: 0 };
            assert!(put_together(completion_messages(Made::Files(vec![file]))).is_err(), "{name}");
        }
    }
}
