//! The score run that an episode is shown with where none is named: the newest one of its task that holds it.

use futures::{StreamExt as _, stream};
use gleaner_client::Client;
use gleaner_proto::v1::{Episode, GetEpisodeScoresRequest, Outcome, ScoreRun};
use tonic::Code;

use crate::failure::Result;
use crate::words;

/// Score runs in which an episode is looked up at once.
const LOOKUPS: usize = 4;

/// A run that was chosen, and the note that names it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Newest {
    pub(super) id: String,
    pub(super) note: String,
}

/// Why an episode has no run.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Missing {
    /// Its task has none yet.
    NoRun,
    /// The runs of its task lack it, as this part of a sentence explains.
    Elsewhere(String),
}

/// The newest run of an episode's task that holds the episode.
pub(super) async fn of(client: &Client, episode: &Episode) -> Result<std::result::Result<Newest, Missing>> {
    let runs = client.every_score_run(&episode.task_id).await?.score_runs;
    let found = newest_with(client, &runs, &episode.id).await?;
    Ok(chosen(episode, &runs, found))
}

/// The place of the first run that holds an episode.
async fn newest_with(client: &Client, runs: &[ScoreRun], episode: &str) -> Result<Option<usize>> {
    let lookup = |run: &ScoreRun| {
        let request = GetEpisodeScoresRequest { score_run_id: run.id.clone(), episode_id: episode.to_owned() };
        async move { client.scores().get_episode_scores(request).await }
    };
    let mut lookups = stream::iter(runs.iter().map(lookup)).buffered(LOOKUPS).enumerate();
    while let Some((at, scores)) = lookups.next().await {
        match scores {
            Ok(_) => return Ok(Some(at)),
            Err(status) if status.code() == Code::NotFound => {}
            Err(status) => return Err(status.into()),
        }
    }
    Ok(None)
}

/// Which run of a task is chosen, or why none. The runs are the newest first.
fn chosen(episode: &Episode, runs: &[ScoreRun], found: Option<usize>) -> std::result::Result<Newest, Missing> {
    match (found.and_then(|at| Some((at, runs.get(at)?))), runs) {
        (Some((0, run)), _) => {
            Ok(Newest { id: run.id.clone(), note: format!("score run {} (the newest of the task)", run.id) })
        }
        (Some((newer, run)), _) => {
            let lack =
                if newer == 1 { "a newer one lacks it".to_owned() } else { format!("{newer} newer ones lack it") };
            let note = format!("score run {} (the newest of the task that holds the episode; {lack})", run.id);
            Ok(Newest { id: run.id.clone(), note })
        }
        (None, []) => Err(Missing::NoRun),
        (None, [newest, ..]) => {
            let lack = match runs.len() {
                1 => "the score run of the task lacks".to_owned(),
                many => format!("the {many} score runs of the task lack"),
            };
            let why = missing_because(episode, newest, runs.len() == 1);
            Err(Missing::Elsewhere(format!("{lack} the episode, because {why}")))
        }
    }
}

/// `only`: whether the task has one run.
fn missing_because(episode: &Episode, newest: &ScoreRun, only: bool) -> String {
    let [pushed, scored] = [&episode.create_time, &newest.create_time].map(|time| words::timestamp(time.as_ref()));
    if pushed.zip(scored).is_some_and(|(pushed, scored)| pushed > scored) {
        return "it was pushed later".to_owned();
    }
    if episode.outcome() == Outcome::Unknown {
        return "its outcome is unknown, and snapshots by outcome leave it out".to_owned();
    }
    let snapshots = if only { "the snapshot of the run leaves" } else { "the snapshots of the runs leave" };
    format!("{snapshots} it out, or it is an expert without scores (the only one of a snapshot, or of imported scores)")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn time(seconds: i64) -> Option<prost_types::Timestamp> {
        Some(prost_types::Timestamp { seconds, nanos: 0 })
    }

    #[test]
    fn the_note_names_the_run_or_why_there_is_none() {
        let run = |id: &str, seconds| ScoreRun { id: id.into(), create_time: time(seconds), ..ScoreRun::default() };
        let episode = |seconds, outcome: Outcome| Episode {
            create_time: time(seconds),
            outcome: outcome.into(),
            ..Episode::default()
        };
        let runs = [run("run_3", 30), run("run_2", 20), run("run_1", 10)];
        let failed = episode(5, Outcome::Failure);
        let newest = |id: &str, note: &str| Ok(Newest { id: id.into(), note: note.into() });
        let first = "score run run_3 (the newest of the task)";
        assert_eq!(chosen(&failed, &runs, Some(0)), newest("run_3", first));
        let second = "score run run_2 (the newest of the task that holds the episode; a newer one lacks it)";
        assert_eq!(chosen(&failed, &runs, Some(1)), newest("run_2", second));
        let third = chosen(&failed, &runs, Some(2)).unwrap().note;
        assert!(third.contains("run_1 (the newest of the task that holds the episode; 2 newer"), "{third}");
        assert_eq!(chosen(&failed, &[], None), Err(Missing::NoRun));
        let lacks = |episode: &Episode, runs: &[ScoreRun]| match chosen(episode, runs, None) {
            Err(Missing::Elsewhere(lack)) => lack,
            other => panic!("{other:?}"),
        };
        for (episode, why) in [
            (episode(40, Outcome::Failure), "because it was pushed later"),
            (episode(5, Outcome::Unknown), "because its outcome is unknown"),
            (episode(5, Outcome::Success), "it is an expert without scores"),
        ] {
            let lack = lacks(&episode, &runs);
            assert!(lack.starts_with("the 3 score runs of the task lack the episode") && lack.contains(why), "{lack}");
        }
        for (runs, begin) in [
            (
                &runs[..1],
                "the score run of the task lacks the episode, because the snapshot of the run leaves it out, or",
            ),
            (
                &runs[..2],
                "the 2 score runs of the task lack the episode, because the snapshots of the runs leave it out, or",
            ),
        ] {
            let lack = lacks(&failed, runs);
            assert!(lack.starts_with(begin), "{lack}");
        }
    }
}
