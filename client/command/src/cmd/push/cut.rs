//! `push --episodes-from` and `push --ranges`: each recording is cut into episodes, which are sent and removed again.

use std::path::Path;
use std::time::Instant;

use gleaner_client::{
    Client, ClientError, NamedRange, PushItem, PushResult, Pushed, Skipped, UploadLabel, find_recordings,
    whole_recording,
};
use gleaner_proto::v1::Outcome;
use gleaner_recording::{Cuts, TimeRange};

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
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (mut items, mut left_out) = (Vec::with_capacity(episodes.len()), Vec::new());
        for (at, episode) in episodes.into_iter().enumerate() {
            // The name of an episode's file is what people see of its origin.
            let named = format!("{name}_{}", marks.name(at).unwrap_or(episode.file_name.clone()));
            if let Some(why) = episode.left_out {
                left_out.push(PushResult { path: path.join(named), result: Err(ClientError::Invalid(why)) });
                continue;
            }
            let named = out.join(named);
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
