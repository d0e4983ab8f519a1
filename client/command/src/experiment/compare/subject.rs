//! The subject of a comparison: a snapshot, the encoders of it, its episodes with their marks, and the scorers and the
//! simulator's task that fit.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use gleaner_client::Client;
use gleaner_core::TaskSpec;
use gleaner_core::id::{EncoderId, SnapshotId};
use gleaner_core::kinds::Family;
use gleaner_core::proto::task::spec_from_proto;
use gleaner_proto::v1::job_spec::Spec;
use gleaner_proto::v1::{
    Episode, GetScoreRunRequest, GetTaskRequest, Kind, ListEpisodesRequest, ListKindsRequest, Role, SnapshotEpisode,
};
use gleaner_sim::{SimConfig, Task};

use super::super::stage::Origin;
use super::episodes::{Episodes, Known};
use super::marks::Marks;
use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::words;

/// Seeds of a single encoder, or of a snapshot.
const SEEDS: u32 = 3;

/// What scorers are compared on.
pub(super) struct Subject<'a> {
    client: &'a Client,
    pub(super) task_id: String,
    pub(super) spec: TaskSpec,
    pub(super) snapshot_id: String,
    episodes: Vec<SnapshotEpisode>,
    /// The snapshot, or the encoders as they were given.
    given: Vec<Origin>,
}

impl<'a> Subject<'a> {
    /// The snapshot or the encoders of these ids.
    pub(super) async fn of(context: &Context, client: &'a Client, ids: &[String]) -> Result<Self> {
        let (given, snapshot_id) = match ids {
            [id] if SnapshotId::parse("", id).is_ok() => (vec![Origin::Snapshot(id.clone())], id.clone()),
            _ => encoders(context, client, ids).await?,
        };
        let task_id = client.snapshot(&snapshot_id).await?.task_id;
        let episodes = client.snapshot_episodes(&snapshot_id).await?;
        let request = GetTaskRequest { task: task_id.clone() };
        let task = client.tasks().get_task(request).await?.into_inner().task;
        let spec = spec_from_proto(present(task.and_then(|task| task.spec), "a task")?);
        let spec = spec.map_err(|error| Failure::message(error.to_string()))?;
        Ok(Self { client, task_id, spec, snapshot_id, episodes, given })
    }

    /// Whether encoders are pretrained.
    pub(super) fn pretrains(&self) -> bool {
        matches!(self.given[..], [Origin::Snapshot(_)])
    }

    /// The origin of each seed.
    ///
    /// # Errors
    /// A number of seeds that is not that of several encoders.
    pub(super) fn origins(&self, seeds: Option<u32>) -> Result<Vec<Origin>> {
        origins(&self.given, seeds).map_err(Failure::message)
    }

    /// The server's scorers that can run on the task, by name. Scorers that this program lacks are left out with a note.
    pub(super) async fn scorers(&self, context: &Context) -> Result<Vec<String>> {
        let kinds = self.client.jobs().list_kinds(ListKindsRequest {}).await?.into_inner().scorers;
        let (known, unknown): (Vec<Kind>, Vec<Kind>) =
            kinds.into_iter().partition(|kind| Family::Scorer.find(&kind.name).is_some());
        for kind in unknown {
            context.output.note(format_args!("{} is left out: this program is older than the server", kind.name));
        }
        let fits = |kind: &Kind| !kind.needs_images || !self.spec.cameras.is_empty();
        Ok(known.into_iter().filter(fits).map(|kind| kind.name).collect())
    }

    /// What the score run of this id is called: its scorer, or the source that it was imported from.
    ///
    /// # Errors
    /// A run of another snapshot.
    pub(super) async fn label_of_run(&self, id: &str) -> Result<String> {
        let request = GetScoreRunRequest { score_run_id: id.to_owned() };
        let run = present(self.client.scores().get_score_run(request).await?.into_inner().score_run, "a score run")?;
        if run.snapshot_id != self.snapshot_id {
            return Err(Failure::message(format!(
                "--run {id}: is of the snapshot {}, and the comparison of {}; give a run of that snapshot",
                run.snapshot_id, self.snapshot_id
            )));
        }
        let settings = run.settings.unwrap_or_default();
        let word = |name: &str| {
            let Some(prost_types::value::Kind::StringValue(word)) = &settings.fields.get(name)?.kind else {
                return None;
            };
            (!word.is_empty()).then_some(word.as_str())
        };
        Ok(format!("{} {id}", word("source").or_else(|| word("scorer")).unwrap_or("run")))
    }

    /// The simulator's task of that name, or of the task's own; `None` if none was named and the task is not simulated.
    ///
    /// # Errors
    /// The named task does not fit.
    pub(super) fn simulated(&self, named: Option<&str>) -> Result<Option<(Task, SimConfig)>> {
        match (gleaner_sim::simulated(&self.spec, named.unwrap_or_default()), named) {
            (Ok(found), _) => Ok(Some(found)),
            (Err(_), None) => Ok(None),
            (Err(error), Some(_)) => Err(Failure::message(format!("--simulation: {error}"))),
        }
    }

    /// The episodes, with the marks of a file, in up to `bins` strata of length.
    pub(super) async fn episodes(&self, marks: Option<&Path>, bins: usize) -> Result<Episodes> {
        let marks = match marks {
            Some(path) => Marks::read(path)?.of_episodes(&self.files().await?),
            None => Ok(HashMap::new()),
        };
        let marks = marks.map_err(|problem| Failure::message(format!("--marks: {problem}")))?;
        let known = |episode: &SnapshotEpisode| Known {
            id: episode.episode_id.clone(),
            cohort: episode.cohort.clone(),
            outcome: words::outcome(episode.outcome()),
            steps: episode.steps,
            mark: marks.get(&episode.episode_id).copied(),
        };
        let of = |role| self.episodes.iter().filter(move |episode| episode.role() == role).map(known);
        Ok(Episodes::new(of(Role::Imperfect).collect(), of(Role::Expert).collect(), bins))
    }

    /// The file name of each imperfect episode.
    async fn files(&self) -> Result<Vec<(String, String)>> {
        let imperfect = self.episodes.iter().filter(|episode| episode.role() == Role::Imperfect);
        let wanted: HashSet<&str> = imperfect.map(|episode| episode.episode_id.as_str()).collect();
        let mut files = Vec::new();
        // Deleted episodes stay in their snapshots.
        for deleted in [false, true] {
            let mut request =
                ListEpisodesRequest { task: self.task_id.clone(), page_size: 1000, deleted, ..Default::default() };
            loop {
                let page = self.client.episodes().list_episodes(request.clone()).await?.into_inner();
                let of_page = page.episodes.into_iter().map(|Episode { id, file_name, .. }| (id, file_name));
                files.extend(of_page.filter(|(id, _)| wanted.contains(id.as_str())));
                if page.next_page_token.is_empty() {
                    break;
                }
                request.page_token = page.next_page_token;
            }
        }
        Ok(files)
    }
}

/// Encoders of one snapshot, and the snapshot.
async fn encoders(context: &Context, client: &Client, ids: &[String]) -> Result<(Vec<Origin>, String)> {
    let mut of_first: Option<(&str, String)> = None;
    for (place, id) in ids.iter().enumerate() {
        if EncoderId::parse("", id).is_err() {
            return Err(Failure::message(format!(
                "{id}: give the ids of encoders (enc_…), or the id of one snapshot (snap_…)"
            )));
        }
        if ids[..place].contains(id) {
            return Err(Failure::message(format!("{id}: is duplicated; give each encoder once")));
        }
        let job = context.job_of_result(client, id).await?;
        let Some(Spec::Pretrain(spec)) = job.spec.and_then(|spec| spec.spec) else {
            return Err(Failure::message(format!("{id}: is not the result of a pretraining")));
        };
        match &of_first {
            Some((first, snapshot)) if *snapshot != spec.snapshot_id => {
                return Err(Failure::message(format!(
                    "{id}: is of the snapshot {}, and {first} of {snapshot}; give encoders of one snapshot",
                    spec.snapshot_id
                )));
            }
            Some(_) => {}
            None => of_first = Some((id, spec.snapshot_id)),
        }
    }
    let (_, snapshot) = present(of_first, "an encoder")?;
    Ok((ids.iter().cloned().map(Origin::Encoder).collect(), snapshot))
}

/// The origin of each seed.
fn origins(given: &[Origin], seeds: Option<u32>) -> std::result::Result<Vec<Origin>, String> {
    let several = u32::try_from(given.len()).ok().filter(|count| *count > 1);
    match (given, several) {
        ([origin], _) => Ok((0..seeds.unwrap_or(SEEDS)).map(|_| origin.clone()).collect()),
        (_, Some(count)) if seeds.is_none_or(|seeds| seeds == count) => Ok(given.to_vec()),
        (_, _) => Err(format!(
            "--seeds: {} encoders are that many seeds; leave the option out, or give one encoder",
            given.len()
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_encoders_are_a_seed_each() {
        let encoder = |id: &str| Origin::Encoder(id.into());
        let two = [encoder("enc_1"), encoder("enc_2")];
        assert_eq!(origins(&two, None).unwrap(), two);
        assert_eq!(origins(&two, Some(2)).unwrap(), two);
        assert!(origins(&two, Some(3)).unwrap_err().contains("--seeds: 2 encoders"));
        assert_eq!(origins(&two[..1], None).unwrap().len(), 3);
        assert_eq!(origins(&two[..1], Some(1)).unwrap(), two[..1]);
    }
}
