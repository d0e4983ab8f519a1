//! `push --episodes-from` and `push --ranges`: each recording is cut into episodes, which are sent and removed again.

use std::path::Path;
use std::time::Instant;

use gleaner_client::{
    Client, ClientError, NamedRange, PushItem, PushResult, Pushed, Skipped, UploadLabel, find_recordings,
    whole_recording,
};
use gleaner_proto::v1::Outcome;
use gleaner_recording::{CutEpisode, Cuts, TimeRange};

use super::items::known_task;
use super::{PushArgs, push as push_all};
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;

/// What marks the episodes of a recording.
pub(super) enum Marks {
    /// The messages of this topic.
    Topic(String),
    /// These times, in their order.
    Ranges(Vec<NamedRange>),
}

/// Sends the episodes of every recording; returns the results, what was skipped, and the task.
pub(super) async fn push(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    marks: &Marks,
) -> Result<(Pushed, Vec<Skipped>, String)> {
    let task = known_task(client, context.task(client, args.task.as_deref()).await?, None).await?;
    let found = find_recordings(&args.paths)?;
    if let (Marks::Ranges(_), [_, second, ..]) = (marks, found.recordings.as_slice()) {
        let problem = "--ranges has the times of one recording, and there is a second one";
        return Err(Failure::message(format!("{problem}: {}; push them one after the other", second.display())));
    }
    let ranges: Vec<TimeRange> = match marks {
        Marks::Topic(_) => Vec::new(),
        Marks::Ranges(ranges) => ranges.iter().map(|named| named.range.clone()).collect(),
    };
    let cuts = match marks {
        Marks::Topic(topic) => Cuts::Topic(topic),
        Marks::Ranges(_) => Cuts::Ranges(&ranges),
    };
    let (inspector, started) = (Inspector::find()?, Instant::now());
    let mut results = Vec::new();
    for path in &found.recordings {
        let folder = tempfile::tempdir()?;
        let recording = match whole_recording(path, folder.path()).await {
            Ok(recording) => recording,
            Err(error) => {
                results.push(PushResult { path: path.clone(), result: Err(error) });
                continue;
            }
        };
        let out = folder.path().join("episodes");
        std::fs::create_dir(&out)?;
        let episodes = match inspector.cut(&recording, cuts, &out).await? {
            Ok(episodes) => episodes,
            Err(why) => {
                results.push(PushResult { path: path.clone(), result: Err(ClientError::Invalid(why)) });
                continue;
            }
        };
        let (whole, mut left_out) = named(path, marks, episodes);
        let mut items = Vec::with_capacity(whole.len());
        for (name, episode) in whole {
            let named = out.join(name);
            std::fs::rename(out.join(&episode.file_name), &named)?;
            items.push(item(args, context, &named, &task, episode.success));
        }
        let pushed = push_all(context, client, items, args.jobs).await;
        results.extend(pushed.results.into_iter().map(|pushed| {
            let episode = pushed.path.file_name().unwrap_or_default().to_owned();
            PushResult { path: path.join(episode), ..pushed }
        }));
        results.append(&mut left_out);
    }
    Ok((Pushed { results, wall: started.elapsed() }, found.skipped, task))
}

/// The episodes of a recording with the names of their files, which are what people see of their origin; and the results of
/// those that are left out.
fn named(path: &Path, marks: &Marks, episodes: Vec<CutEpisode>) -> (Vec<(String, CutEpisode)>, Vec<PushResult>) {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let (mut whole, mut left_out) = (Vec::with_capacity(episodes.len()), Vec::new());
    for (at, mut episode) in episodes.into_iter().enumerate() {
        let name = format!("{stem}_{}", marks.name(at).unwrap_or_else(|| episode.file_name.clone()));
        match episode.left_out.take() {
            Some(why) => left_out.push(PushResult { path: path.join(name), result: Err(ClientError::Invalid(why)) }),
            None => whole.push((name, episode)),
        }
    }
    (whole, left_out)
}

impl Marks {
    /// The file of an episode that has a name, by its place in the order of time.
    fn name(&self, at: usize) -> Option<String> {
        let Self::Ranges(ranges) = self else { return None };
        ranges.get(at).filter(|named| !named.name.is_empty()).map(|named| format!("{}.mcap", named.name))
    }
}

fn item(args: &PushArgs, context: &Context, path: &Path, task: &str, success: Option<bool>) -> PushItem {
    let stated = match success {
        Some(true) => Outcome::Success,
        Some(false) => Outcome::Failure,
        None => Outcome::Unknown,
    };
    let label = UploadLabel {
        outcome: args.outcome.unwrap_or(stated),
        cohort: args.cohort.clone().unwrap_or_default(),
        author: context.connection.author(),
    };
    PushItem { path: path.to_owned(), parts: Vec::new(), task: task.to_owned(), label }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_that_is_left_out_is_rejected_with_the_reason() {
        let episode = |at: usize, left_out: Option<&str>| CutEpisode {
            file_name: format!("episode_{at:06}.mcap"),
            success: None,
            left_out: left_out.map(str::to_owned),
        };
        let episodes = vec![episode(0, None), episode(1, Some("the recording ends in the middle of it"))];
        let (whole, left_out) = named(Path::new("day/long.mcap"), &Marks::Topic("/episode".into()), episodes);
        assert_eq!(whole, [("long_episode_000000.mcap".to_owned(), episode(0, None))]);
        let [PushResult { path, result }] = left_out.as_slice() else { panic!("{left_out:?}") };
        assert_eq!(path, Path::new("day/long.mcap/long_episode_000001.mcap"));
        assert!(result.as_ref().unwrap_err().to_string().contains("ends in the middle"));
    }
}
