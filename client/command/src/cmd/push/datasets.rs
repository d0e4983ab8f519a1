//! `push` of datasets of other programs: each episode is made a recording, sent, and removed again.

use std::time::Instant;

use futures::StreamExt as _;
use gleaner_client::{Client, ClientError, PushItem, PushResult, Pushed, UploadLabel};
use gleaner_core::proto::task::{spec_from_proto, spec_to_proto};
use gleaner_proto::v1::{CreateTaskRequest, ListTasksRequest, Outcome};
use gleaner_recording::TaskSpec;

use super::PushArgs;
use super::items::known_task;
use crate::context::Context;
use crate::draft::of_description;
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;
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

/// The task that was named, or the one that the first dataset fits; if it fits none, one is created from its features.
async fn task(args: &PushArgs, context: &Context, client: &Client, intakes: &[Intake]) -> Result<String> {
    let Some(first) = intakes.first() else { return context.task(client, args.task.as_deref()).await };
    let path = first.path.display();
    if let Some(named) = &args.task {
        let known = known_task(client, named.clone(), None).await;
        return known
            .map_err(|error| Failure::message(format!("{error}; `gleaner task draft {path} > task.toml` drafts it")));
    }
    let specs = client.tasks().list_tasks(ListTasksRequest {}).await?.into_inner().tasks;
    let specs = specs.into_iter().filter_map(|task| spec_from_proto(task.spec?).ok()).collect::<Vec<_>>();
    let mut fitting = fitting(first, &specs).await?;
    match fitting.len() {
        1 => return Ok(fitting.remove(0)),
        0 => {}
        _ => {
            let names = fitting.join(", ");
            return Err(Failure::message(format!("{path} fits several tasks; add --task with one of: {names}")));
        }
    }
    let spec = of_description(&first.description, first.name()).spec;
    gleaner_recording::validate(&spec)?;
    let name = spec.name.clone();
    if specs.iter().any(|known| known.name == name) {
        return Err(Failure::message(format!(
            "{path} does not fit the server's task {name}; push with --task {name} to see why, or create another one: \
             `gleaner task draft {path} --name OTHER > task.toml`"
        )));
    }
    client.tasks().create_task(CreateTaskRequest { spec: Some(spec_to_proto(spec)) }).await?;
    context.output.note(format_args!(
        "created task {name} from the features of {path}, which fit no other task; `gleaner task show {name}` shows it"
    ));
    Ok(name)
}

/// The names of the tasks that would accept the dataset's first usable episode.
async fn fitting(dataset: &Intake, specs: &[TaskSpec]) -> Result<Vec<String>> {
    let mut names = Vec::new();
    if specs.is_empty() {
        return Ok(names);
    }
    let inspector = Inspector::find()?;
    for number in 0..dataset.description.episodes {
        let Ok(episode) = dataset.episode(number).await? else { continue };
        for spec in specs {
            let reports = inspector.check(std::slice::from_ref(&episode.recording), spec).await?;
            if reports.iter().all(|(_, report)| report.is_ok()) {
                names.push(spec.name.clone());
            }
        }
        break;
    }
    Ok(names)
}
