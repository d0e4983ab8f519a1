//! The work of each kind of job: inputs opened, the learning crate called, results kept as blobs.

use std::path::PathBuf;

use gleaner_core::{EvaluateSpec, PretrainSpec, ScoreSpec, TrainSpec};
use gleaner_learn::{Normaliser, ScoreBase, ScoreInputs};

use super::{episodes::Episodes, evaluate, export, failure::Failure, features::KeptFeatures, monitor::Watcher};
use gleaner_core::{
    id::{BlobId, EpisodeId},
    order::{JobOrder, needs_encoder},
    score::EpisodeScores,
    snapshot::Role,
    work::{FrozenRun, Inputs, Made},
};
use gleaner_data_folder::blobs::Blobs;

/// A job's work, ready to begin on a thread of its own.
pub(crate) struct Work {
    /// The server's data directory.
    pub(crate) data_dir: PathBuf,
    /// Threads of the tensor library.
    pub(crate) threads: u32,
    /// Where results go.
    pub(crate) blobs: Blobs,
    /// What to work on.
    pub(crate) inputs: Inputs,
    /// The run that a score job goes on from.
    pub(crate) base: Option<Base>,
    /// Who watches.
    pub(crate) monitor: Watcher,
}

/// A score run to go on from.
pub(crate) struct Base {
    /// What it has frozen.
    pub(crate) frozen: FrozenRun,
    /// Its scores, without q.
    pub(crate) scores: Vec<EpisodeScores>,
}

impl Work {
    /// Does it.
    pub(crate) fn perform(mut self, order: JobOrder) -> Result<Made, Failure> {
        self.monitor.phase("reading episodes");
        match order {
            JobOrder::Pretrain { snapshot_id: _, rule: _, spec } => self.pretrain(spec),
            JobOrder::Score { encoder_id: _, snapshot_id: _, extends: _, spec } => self.score(spec),
            JobOrder::Train { data: _, spec } => self.train(spec),
            JobOrder::Export { dataset_id: _ } => self.export(),
            JobOrder::Evaluate { subject: _, spec } => self.evaluate(&spec),
        }
    }

    fn episodes(&self) -> Episodes<'_> {
        Episodes { data_dir: &self.data_dir, blobs: &self.blobs, task: &self.inputs.task }
    }

    /// What an earlier attempt left, if any.
    fn resume(&self) -> Result<Option<Vec<u8>>, Failure> {
        Ok(self.inputs.checkpoint.as_ref().map(|blob| self.blobs.get(blob)).transpose()?)
    }

    fn encoder(&self) -> Result<Vec<u8>, Failure> {
        match &self.inputs.encoder {
            Some(blob) => Ok(self.blobs.get(blob)?),
            None => Err(Failure::Broken("the server named no encoder".to_owned())),
        }
    }

    fn keep(&self, bytes: &[u8]) -> Result<BlobId, Failure> {
        let blob = self.monitor.once_there_is_room(|blobs| blobs.put(bytes))?;
        gleaner_data_folder::fail_point::pass("result.blob_kept");
        Ok(blob)
    }

    /// L = L_MTP + L_TR + L_AA over D_u = D_e ∪ D_i.
    fn pretrain(&mut self, spec: PretrainSpec) -> Result<Made, Failure> {
        let spec = PretrainSpec { threads: Some(self.threads), ..spec };
        let (shape, resume) = (self.episodes().shape(), self.resume()?);
        let all = [self.inputs.experts.as_slice(), self.inputs.imperfect.as_slice()].concat();
        let data = self.episodes().trajectories(&all)?;
        self.monitor.phase("pretraining");
        let bytes = gleaner_learn::pretrain(&shape, &data, &spec, resume.as_deref(), &mut self.monitor)?;
        Ok(Made::Encoder { checkpoint: self.keep(&bytes)? })
    }

    /// w and q of every segment of D_i, and of D_e each against the others.
    fn score(&mut self, spec: ScoreSpec) -> Result<Made, Failure> {
        let spec = ScoreSpec { threads: Some(self.threads), ..spec };
        let encoder = self.encoder()?;
        let experts = self.episodes().trajectories(&self.inputs.experts)?;
        let imperfect = self.episodes().trajectories(&self.inputs.imperfect)?;
        self.monitor.phase("scoring");
        let kind = gleaner_learn::features_kind(&spec)?.unwrap_or_default();
        let kept = KeptFeatures::new(&self.data_dir, &self.blobs, &self.inputs, &kind);
        let inputs = ScoreInputs { encoder: &encoder, experts: &experts, imperfect: &imperfect, kept: &kept };
        let scores = match self.base.take() {
            None => gleaner_learn::score(inputs, &spec, &mut self.monitor)?,
            Some(base) => gleaner_learn::extend_scores(inputs, &base_of(base, &spec), &spec, &mut self.monitor)?,
        };
        let of_role = |episodes: Vec<gleaner_learn::EpisodeScores>, role| {
            episodes.into_iter().map(move |scores| episode_scores(scores, role))
        };
        let episodes = of_role(scores.imperfect, Role::Imperfect).chain(of_role(scores.experts, Role::Expert));
        Ok(Made::Scores {
            lo: scores.normaliser.lo,
            hi: scores.normaliser.hi,
            quantiles: scores.normaliser.quantiles,
            expert_ids: self.inputs.experts.iter().map(|expert| expert.id.clone()).collect(),
            episodes: episodes.collect::<Result<_, _>>()?,
        })
    }

    /// L = E_{D_e}[loss] + λ · E_{D_i}[q · loss].
    fn train(&mut self, spec: TrainSpec) -> Result<Made, Failure> {
        let spec = TrainSpec { threads: Some(self.threads), ..spec };
        let (shape, resume) = (self.episodes().shape(), self.resume()?);
        let encoder = if needs_encoder(&spec) { Some(self.encoder()?) } else { None };
        let experts = self.episodes().trajectories(&self.inputs.experts)?;
        let kept = self.episodes().weighted(&self.inputs.kept)?;
        self.monitor.phase("training");
        let (resume, monitor) = (resume.as_deref(), &mut self.monitor);
        let bytes = gleaner_learn::train_policy(&shape, encoder.as_deref(), &experts, &kept, &spec, resume, monitor)?;
        Ok(Made::Policy { checkpoint: self.keep(&bytes)?, kind: spec.policy.name.clone() })
    }

    fn evaluate(&mut self, spec: &EvaluateSpec) -> Result<Made, Failure> {
        let blob = self.inputs.policy.as_ref();
        let blob = blob.ok_or_else(|| Failure::Broken("the server named no policy".to_owned()))?;
        gleaner_learn::set_threads(self.threads);
        let policy = gleaner_learn::Policy::load_on(&self.blobs.get(blob)?, spec.device)?;
        self.monitor.phase("evaluating");
        evaluate::evaluate(&self.inputs.task, &policy, spec, &mut self.monitor).map(Made::Trials)
    }

    fn export(&mut self) -> Result<Made, Failure> {
        self.monitor.phase("exporting");
        export::export(&self.data_dir, &self.blobs, &self.inputs, &mut self.monitor).map(Made::Files)
    }
}

fn episode_scores(scores: gleaner_learn::EpisodeScores, role: Role) -> Result<EpisodeScores, Failure> {
    let gleaner_learn::EpisodeScores { id, w, q, match_episode, match_step, distances } = scores;
    let episode_id = EpisodeId::parse("episode_id", &id)?;
    Ok(EpisodeScores { episode_id, role, w, q, match_episode, match_step, distances })
}

fn base_of(base: Base, spec: &ScoreSpec) -> ScoreBase {
    let Base { frozen: FrozenRun { lo, hi, quantiles, expert_ids }, scores } = base;
    let scores = scores.into_iter().map(|scores| {
        let EpisodeScores { episode_id, role: _, w, q, match_episode, match_step, distances } = scores;
        gleaner_learn::EpisodeScores { id: episode_id.into(), w, q, match_episode, match_step, distances }
    });
    ScoreBase {
        normaliser: Normaliser { kind: spec.normaliser, lo, hi, quantiles },
        experts: expert_ids.into_iter().map(Into::into).collect(),
        scores: scores.collect(),
    }
}
