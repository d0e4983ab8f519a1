//! `push` of datasets of other programs: each episode is made a recording, sent, and removed again.

use std::time::Instant;

use futures::StreamExt as _;
use gleaner_client::{Client, ClientError, PushItem, PushResult, Pushed, UploadLabel};
use gleaner_core::proto::task::spec_to_proto;
use gleaner_proto::v1::{CreateTaskRequest, ListTasksRequest, Outcome};

use super::PushArgs;
use super::items::known_task;
use crate::context::Context;
use crate::draft::of_description;
use crate::failure::{Failure, Result};
use crate::intake::Intake;

/// Sends every episode of these datasets; returns the results, and the task.
pub(super) async fn push(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    intakes: &[Intake],
) -> Result<(Pushed, String)> {
    let task = task(args, context, client, intakes).await?;
    let started = Instant::now();
    let all = intakes.iter().flat_map(|intake| (0..intake.description.episodes).map(move |number| (intake, number)));
    let total = intakes.iter().map(|intake| intake.description.episodes).sum();
    let bar = context.progress.count("push", total);
    let (bar, task_name) = (&bar, task.as_str());
    let pushes = all.map(|(intake, number)| async move {
        let pushed = episode(args, context, client, (intake, number), task_name).await;
        bar.inc(1);
        pushed
    });
    let results: Vec<Result<PushResult>> = futures::stream::iter(pushes).buffered(args.jobs.max(1)).collect().await;
    bar.finish_and_clear();
    let results = results.into_iter().collect::<Result<Vec<_>>>()?;
    Ok((Pushed { results, wall: started.elapsed() }, task))
}

async fn episode(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    (intake, number): (&Intake, u64),
    task: &str,
) -> Result<PushResult> {
    let path = intake.place(number);
    let made = match intake.episode(number).await? {
        Ok(made) => made,
        Err(why) => return Ok(PushResult { path, result: Err(ClientError::Invalid(why)) }),
    };
    let stated = match made.converted.success {
        Some(true) => Outcome::Success,
        Some(false) => Outcome::Failure,
        None => Outcome::Unknown,
    };
    let label = UploadLabel {
        outcome: args.outcome.unwrap_or(stated),
        cohort: args.cohort.clone().unwrap_or_else(|| intake.name()),
        author: context.connection.author(),
    };
    let item = PushItem { path: made.recording.clone(), parts: Vec::new(), task: task.to_owned(), label };
    let pushed = client.push(vec![item], 1, |_| ()).await;
    let result = pushed.results.into_iter().next().map(|pushed| pushed.result);
    let result = result.unwrap_or_else(|| Err(ClientError::Invalid("it was not sent; push it again".to_owned())));
    Ok(PushResult { path, result })
}

/// The task that was named, or the only one of the server; a server without tasks gets the one that the first dataset
/// describes.
async fn task(args: &PushArgs, context: &Context, client: &Client, intakes: &[Intake]) -> Result<String> {
    let tasks = client.tasks().list_tasks(ListTasksRequest {}).await?.into_inner().tasks;
    let Some(first) = intakes.first().filter(|_| args.task.is_none() && tasks.is_empty()) else {
        let task = context.task(client, args.task.as_deref()).await?;
        let known = known_task(client, task, None).await;
        return known.map_err(|error| {
            let path = intakes.first().map(|intake| intake.path.display().to_string()).unwrap_or_default();
            Failure::message(format!("{error}; `gleaner task draft {path} > task.toml` drafts it"))
        });
    };
    let spec = of_description(&first.description, first.name()).spec;
    gleaner_recording::validate(&spec)?;
    let name = spec.name.clone();
    client.tasks().create_task(CreateTaskRequest { spec: Some(spec_to_proto(spec)) }).await?;
    context.output.note(format_args!(
        "created task {name} from the features of {}; `gleaner task show {name}` shows it",
        first.path.display()
    ));
    Ok(name)
}
