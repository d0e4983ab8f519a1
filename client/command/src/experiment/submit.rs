//! Submits every stage at once, each naming the results that it works on. The stages of an earlier run are found again
//! and not submitted twice.

use std::collections::HashMap;

use gleaner_client::{Client, ScoredEpisode, has_ended};
use gleaner_core::proto::selection::selection_to_proto;
use gleaner_proto::v1::{
    CreateDatasetRequest, CreateSnapshotRequest, GetJobRequest, Job, JobSpec, Role, SubmitJobRequest,
};
use tonic::Code;

use super::attempts::Trial;
use super::cell::RuleSettings;
use super::file::Experiment;
use super::known::{known_run, known_snapshot};
use super::order::{self, Input};
use super::recordings::{Recordings, of_episode};
use super::site::Site;
use super::source::Source;
use super::stage::{Graph, Stage, Work};
use super::standing::{Gap, StageResult, Submitted, stage_result};
use super::state::State;
use crate::failure::{Failure, Result, present};
use gleaner_core::Device;

/// What made the scores of an oracle, as their run says.
const MARKS: &str = "the marks of the recordings";

/// What stages without jobs need: those that make snapshots, import marks, or evaluate by a command.
struct Made<'a> {
    state: &'a mut State,
    recordings: &'a Recordings,
    source: &'a Source,
    /// Where a command evaluates, if one does.
    site: Option<&'a mut Site>,
}

/// Submits the stages of a graph.
pub(crate) struct Submitter<'a> {
    client: &'a Client,
    /// The simulator's task.
    simulation: &'a str,
    device: Device,
    made: Option<Made<'a>>,
    /// Jobs that this run has submitted, by their keys.
    earlier: HashMap<String, Job>,
}

impl<'a> Submitter<'a> {
    /// For the stages of an experiment.
    pub(crate) fn new(
        client: &'a Client,
        state: &'a mut State,
        recordings: &'a Recordings,
        experiment: &'a Experiment,
        device: Device,
    ) -> Self {
        let made = Made { state, recordings, source: experiment.recordings.source(), site: None };
        let simulation = experiment.recordings.source().task_name();
        Self { client, simulation, device, made: Some(made), earlier: HashMap::new() }
    }

    /// After an earlier submission of the same run, whose jobs are not submitted again: the server would queue those that
    /// failed once more for each submission, and a run tries each once.
    pub(super) fn after(mut self, earlier: &Submitted) -> Self {
        self.earlier = jobs(earlier);
        self
    }

    /// With a place where commands evaluate.
    pub(super) fn with(mut self, site: &'a mut Site) -> Self {
        site.open();
        if let Some(made) = &mut self.made {
            made.site = Some(site);
        }
        self
    }

    /// For stages on results that exist.
    pub(super) fn on_results(client: &'a Client, simulation: &'a str, device: Device) -> Self {
        Self { client, simulation, device, made: None, earlier: HashMap::new() }
    }

    /// All stages, in their order; attempts by a command, which last, follow when every job is with the server. A stage
    /// whose input failed is left out, and so is one that is done at once before its input is there; a later submission
    /// has it.
    pub(crate) async fn submit(mut self, graph: &Graph) -> Result<Submitted> {
        let mut submitted: Submitted = graph.stages.iter().map(|_| Err(Gap::NotYet)).collect();
        let (last, first): (Vec<_>, Vec<_>) =
            (0..).zip(&graph.stages).partition(|(_, stage)| matches!(stage.work, Work::Attempts { .. }));
        for (place, stage) in first.into_iter().chain(last) {
            let input = stage.input.map(|index| {
                let submitted = if matches!(stage.work, Work::Marks | Work::Attempts { .. }) {
                    // They are done at once, so what they are done with has to be there.
                    stage_result(&submitted, index)
                } else {
                    submitted[index].as_ref().map_err(Clone::clone)
                };
                (index, submitted)
            });
            let kind = |index: usize| graph.stages[index].work.kind();
            let result = match input {
                Some((_, Err(Gap::NotYet))) => Err(Gap::NotYet),
                Some((index, Err(Gap::Failed(problem)))) => {
                    Err(Gap::Failed(format!("its {} failed: {problem}", kind(index))))
                }
                Some((index, Ok(result))) => {
                    let before = graph.stages[index].input.and_then(|before| submitted[before].as_ref().ok());
                    let before = before.map(|before| before.id.as_str());
                    self.stage(stage, Input { kind: kind(index), id: &result.id, before }).await?
                }
                None => self.stage(stage, Input { kind: "", id: "", before: None }).await?,
            };
            submitted[place] = result;
        }
        Ok(submitted)
    }

    async fn stage(&mut self, stage: &Stage, input: Input<'_>) -> Result<std::result::Result<StageResult, Gap>> {
        let result = match &stage.work {
            Work::Given { origin } => Ok(StageResult { id: origin.id().to_owned(), job: None }),
            Work::Snapshot { rule, .. } => self.snapshot(stage, rule).await,
            Work::Dataset { selection } => self.dataset(input.id, selection_to_proto(*selection)).await,
            Work::Marks => self.marks(&job_key(stage, input.id), input).await,
            Work::Attempts { attempts, episodes, seed, hide_history } => {
                let (policy_id, hide_history, seed, episodes) = (input.id, *hide_history, *seed, *episodes);
                let trial = Trial { attempts, policy_id, hide_history, seed, episodes };
                return self.attempts(stage, trial).await;
            }
            Work::Pretrain { .. } | Work::Score { .. } | Work::Train { .. } | Work::Evaluate { .. } => {
                self.job(stage, input).await
            }
        };
        match result {
            Ok(result) => Ok(Ok(result)),
            // Its input failed in an earlier run, or just now.
            Err(Failure::Client(error)) if error.code() == Some(Code::FailedPrecondition) => {
                Ok(Err(Gap::Failed(error.to_string())))
            }
            Err(failure) => Err(Failure::message(format!("{} ({}): {failure}", stage.work.kind(), stage.label))),
        }
    }

    async fn snapshot(&mut self, stage: &Stage, rule: &RuleSettings) -> Result<StageResult> {
        let Made { state, source, .. } = present(self.made.as_mut(), "a snapshot for these stages")?;
        if let Some(known) = known_snapshot(self.client, state, &stage.key).await? {
            return Ok(known);
        }
        let rule = order::rule(rule, source.experts(), &source.imperfect());
        let request = CreateSnapshotRequest { task: stage.task.clone(), rule: Some(rule) };
        let reply = self.client.snapshots().create_snapshot(request).await?.into_inner();
        let id = present(reply.snapshot, "a snapshot")?.id;
        state.remember(&stage.key, &id)?;
        Ok(StageResult { id, job: None })
    }

    /// The marks of a snapshot's imperfect episodes as scores; the input is the snapshot, or an encoder made of it.
    async fn marks(&mut self, key: &str, input: Input<'_>) -> Result<StageResult> {
        let Made { state, recordings, .. } = present(self.made.as_mut(), "recordings with marks")?;
        if let Some(known) = known_run(self.client, state, key).await? {
            return Ok(known);
        }
        let (snapshot, encoder) = input.before.map_or((input.id, ""), |snapshot| (snapshot, input.id));
        let episodes = self.client.snapshot_episodes(snapshot).await?;
        let imperfect = episodes.into_iter().filter(|episode| episode.role() == Role::Imperfect);
        let scored = imperfect.map(|episode| {
            let mark = of_episode(recordings, &episode.episode_id)?.mark;
            let steps = usize::try_from(episode.steps).unwrap_or_default();
            let q = (0..steps).map(|step| if mark.is_bad(step) { 0.0 } else { 1.0 });
            Ok(ScoredEpisode { q: q.collect(), episode: episode.episode_id })
        });
        let scored = scored.collect::<Result<_>>()?;
        let run = self.client.import_scores(snapshot, MARKS, encoder, scored).await?;
        state.remember_run(key, &run.id)?;
        Ok(StageResult { id: run.id, job: None })
    }

    async fn attempts(&mut self, stage: &Stage, trial: Trial<'_>) -> Result<std::result::Result<StageResult, Gap>> {
        let Made { state, site, .. } = present(self.made.as_mut(), "an evaluation of these stages")?;
        let site = present(site.as_mut(), "a place for attempts")?;
        site.evaluation(self.client, state, &job_key(stage, trial.policy_id), &stage.label, trial).await
    }

    async fn dataset(&self, run: &str, selection: gleaner_proto::v1::Selection) -> Result<StageResult> {
        let request = CreateDatasetRequest { score_run_id: run.to_owned(), selection: Some(selection) };
        let reply = self.client.datasets().create_dataset(request).await?.into_inner();
        Ok(StageResult { id: present(reply.dataset, "a dataset")?.id, job: None })
    }

    async fn job(&self, stage: &Stage, input: Input<'_>) -> Result<StageResult> {
        let key = job_key(stage, input.id);
        if let Some(job) = self.earlier.get(&key) {
            return Ok(StageResult { id: job.result_id.clone(), job: Some(self.as_it_is(job).await?) });
        }
        let spec = present(order::job(&stage.work, input, self.simulation, self.device), "a job for this stage")?;
        let request = SubmitJobRequest {
            task: stage.task.clone(),
            spec: Some(JobSpec { spec: Some(spec) }),
            key,
            ..SubmitJobRequest::default()
        };
        let job = self.client.submit_job(request).await?;
        Ok(StageResult { id: job.result_id.clone(), job: Some(job) })
    }

    /// A job as it is now.
    async fn as_it_is(&self, job: &Job) -> Result<Job> {
        if has_ended(job.state()) {
            return Ok(job.clone());
        }
        let reply = self.client.jobs().get_job(GetJobRequest { job_id: job.id.clone() }).await?.into_inner();
        present(reply.job, "a job")
    }
}

/// What a stage's job is called on the server. The input's id is beside the stage: when a failed input is made again,
/// what works on it is new as well.
pub(crate) fn job_key(stage: &Stage, input: &str) -> String {
    format!("experiment/{}/{input}", stage.key)
}

/// The jobs of a submission, by their keys.
fn jobs(submitted: &Submitted) -> HashMap<String, Job> {
    let jobs = submitted.iter().filter_map(|result| result.as_ref().ok()?.job.as_ref());
    jobs.map(|job| (job.key.clone(), job.clone())).collect()
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1::JobState;

    use super::*;

    #[test]
    fn a_run_submits_each_job_once() {
        let job = |key: &str, state: JobState| {
            let job = Job { key: key.into(), state: state.into(), ..Job::default() };
            Ok(StageResult { id: format!("x_{key}"), job: Some(job) })
        };
        let snapshot = Ok(StageResult { id: "snap_1".into(), job: None });
        let submitted = vec![
            snapshot,
            job("a", JobState::Succeeded),
            job("b", JobState::Failed),
            job("c", JobState::Running),
            Err(Gap::NotYet),
        ];
        let mut keys: Vec<String> = jobs(&submitted).into_keys().collect();
        keys.sort();
        assert_eq!(keys, ["a", "b", "c"]);
    }
}
