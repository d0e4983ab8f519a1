//! `push --episodes-from`: each recording is cut into episodes, which are sent and removed again.

use std::path::Path;
use std::time::Instant;

use gleaner_client::{
    Client, ClientError, PushItem, PushResult, Pushed, Skipped, UploadLabel, find_recordings, whole_recording,
};
use gleaner_proto::v1::Outcome;

use super::items::known_task;
use super::{PushArgs, push as push_all};
use crate::context::Context;
use crate::failure::Result;
use crate::inspector::Inspector;

/// Sends the episodes of every recording; returns the results, what was skipped, and the task.
pub(super) async fn push(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    topic: &str,
) -> Result<(Pushed, Vec<Skipped>, String)> {
    let task = known_task(client, context.task(client, args.task.as_deref()).await?, None).await?;
    let found = find_recordings(&args.paths)?;
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
        let episodes = match inspector.cut(&recording, topic, &out).await? {
            Ok(episodes) => episodes,
            Err(why) => {
                results.push(PushResult { path: path.clone(), result: Err(ClientError::Invalid(why)) });
                continue;
            }
        };
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut items = Vec::with_capacity(episodes.len());
        for episode in episodes {
            // The name of an episode's file is what people see of its origin.
            let named = out.join(format!("{name}_{}", episode.file_name));
            std::fs::rename(out.join(&episode.file_name), &named)?;
            items.push(item(args, context, &named, &task, episode.success));
        }
        let pushed = push_all(context, client, items, args.jobs).await;
        results.extend(pushed.results.into_iter().map(|pushed| {
            let episode = pushed.path.file_name().unwrap_or_default().to_owned();
            PushResult { path: path.join(episode), ..pushed }
        }));
    }
    Ok((Pushed { results, wall: started.elapsed() }, found.skipped, task))
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
