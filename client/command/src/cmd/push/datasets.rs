//! `push` of datasets of other programs: each episode is made a recording, sent, and removed again.

mod known;

use std::collections::HashMap;
use std::time::Instant;

use futures::StreamExt as _;
use gleaner_client::{Client, ClientError, PushItem, PushResult, Pushed, UploadLabel, Uploaded};
use gleaner_core::proto::task::spec_to_proto;
use gleaner_proto::v1::{CreateTaskRequest, Outcome};
use gleaner_recording::TaskSpec;

use self::known::{Known, agree, near, same_instruction, same_rate};
use super::PushArgs;
use super::items::known_task;
use crate::cmd::task;
use crate::context::Context;
use crate::draft::of_description;
use crate::failure::{Failure, Result};
use crate::inspector::Inspector;
use crate::intake::{Conversion, Episode, Intake};

/// Recordings of a dataset by which a task is found: one of them may be unusable for a reason of its own.
const TRIED: u64 = 3;

/// Sends every episode of these datasets; returns the results, and the task of the first.
pub(super) async fn push(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    intakes: &[Intake],
) -> Result<(Pushed, String)> {
    if args.task.is_none() || args.cohort.is_none() {
        distinct(intakes)?;
    }
    let tasks = client.every_task().await?.tasks;
    let mut known: Vec<Known> = tasks.into_iter().filter_map(Known::of).collect();
    // Every dataset is tried before the first task is created, and may fit that of an earlier one.
    let mut choices = Vec::with_capacity(intakes.len());
    for intake in intakes {
        let choice = choose(args, context, client, intake, &known).await?;
        if let Choice::New(spec, _) = &choice {
            known.push(Known { spec: spec.clone(), episodes: None });
        }
        choices.push(choice);
    }
    let mut tasks = Vec::with_capacity(intakes.len());
    for (intake, choice) in intakes.iter().zip(choices) {
        tasks.push(created(context, client, intake, choice).await?);
    }
    let started = Instant::now();
    let all = intakes.iter().zip(&tasks);
    let all = all.flat_map(|(intake, task)| intake.runs().map(move |run| (intake, run, task)));
    let total = intakes.iter().map(|intake| intake.description.episodes).sum();
    let bar = context.progress.count("push", total);
    let bar = &bar;
    let pushes = all.map(|(intake, run, task)| async move {
        let (mut walk, mut pushed) = (intake.walk(run), Vec::new());
        while let Some((number, made)) = walk.next().await? {
            let result = episode(args, context, client, (intake, made), task).await;
            pushed.push(PushResult { path: intake.place(number), result });
            bar.inc(1);
        }
        Ok(pushed)
    });
    let results: Vec<Result<Vec<PushResult>>> =
        futures::stream::iter(pushes).buffered(args.jobs.max(1)).collect().await;
    bar.finish_and_clear();
    let results = results.into_iter().collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    Ok((Pushed { results, wall: started.elapsed() }, tasks.into_iter().next().unwrap_or_default()))
}

async fn episode(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    (intake, made): (&Intake, Conversion),
    task: &str,
) -> std::result::Result<Uploaded, ClientError> {
    let made = made.map_err(ClientError::Invalid)?;
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
    result.unwrap_or_else(|| Err(ClientError::Invalid("it was not sent; push it again".to_owned())))
}

/// Refuses datasets of one name: they would become one task and one cohort.
fn distinct(intakes: &[Intake]) -> Result<()> {
    let mut by_name: HashMap<String, &Intake> = HashMap::new();
    for intake in intakes {
        if let Some(other) = by_name.insert(intake.name(), intake) {
            let (one, two, name) = (other.path.display(), intake.path.display(), intake.name());
            return Err(Failure::message(format!(
                "{one} and {two} are both named {name}; rename one, or push them one after the other with --task"
            )));
        }
    }
    Ok(())
}

/// The task of a dataset.
enum Choice {
    /// One that the server has.
    Known(String),
    /// One to be created from the features of the dataset; `true`: although there are others.
    New(TaskSpec, bool),
}

/// The task that was named, that of the dataset's environment or name, or the one that the dataset fits; if it fits none,
/// a new one.
///
/// # Errors
/// If no episode of the dataset can be used for a new one, or the task that was found has another rate or instruction.
async fn choose(
    args: &PushArgs,
    context: &Context,
    client: &Client,
    dataset: &Intake,
    tasks: &[Known],
) -> Result<Choice> {
    let path = dataset.path.display();
    if let Some(named) = &args.task {
        let known = known_task(client, named.clone(), None).await;
        let draft = |error| Failure::message(format!("{error}; `gleaner task draft {path} > task.toml` drafts it"));
        return known.map(Choice::Known).map_err(draft);
    }
    let find = |name: &str| tasks.iter().find(|known| known.spec.name == name);
    let mut spec = of_description(&dataset.description, dataset.task_name()).spec;
    let mut named = find(&spec.name);
    let own = dataset.name();
    if spec.name != own {
        // Files of one environment differ in their observations, and a task has those of the first.
        if let Some(known) = named
            && trial(dataset, std::slice::from_ref(known), &spec).await?.is_empty()
        {
            same_rate(dataset, &known.spec)?;
            spec.name.clone_from(&own);
            named = None;
        }
        named = named.or_else(|| find(&own));
    }
    if let Some(known) = named {
        same_rate(dataset, &known.spec)?;
        same_instruction(&dataset.path, &spec, &known.spec)?;
        let of_environment = dataset.description.environment.is_some() && known.spec.name == dataset.task_name();
        context.output.note(known.addition(&dataset.path, of_environment));
        return Ok(Choice::Known(known.spec.name.clone()));
    }
    let mut fitting = trial(dataset, tasks, &spec).await?;
    // Two tasks of one robot have equal features.
    fitting.retain(|known| agree(&spec, &known.spec));
    match fitting.as_slice() {
        [] => Ok(Choice::New(spec, !tasks.is_empty())),
        [one] => {
            let name = one.spec.name.clone();
            context
                .output
                .note(format_args!("{path} fits the task {name} and is added to it; with --task another one takes it"));
            Ok(Choice::Known(name))
        }
        several => {
            let mut names: Vec<&str> = several.iter().map(|known| known.spec.name.as_str()).collect();
            names.sort_unstable();
            let names = names.join(", ");
            Err(Failure::message(format!("{path} fits several tasks; add --task with one of: {names}")))
        }
    }
}

/// The name of the task, which exists once this returns.
async fn created(context: &Context, client: &Client, dataset: &Intake, choice: Choice) -> Result<String> {
    let (spec, others) = match choice {
        Choice::Known(name) => return Ok(name),
        Choice::New(spec, others) => (spec, others),
    };
    let (name, limits) = (spec.name.clone(), task::limits(&spec.action));
    client.tasks().create_task(CreateTaskRequest { spec: Some(spec_to_proto(spec)) }).await?;
    let why = if others { ", which fit no other task, or only tasks of another instruction" } else { "" };
    context.output.note(format_args!(
        "created task {name} from the features of {}{why}; its action: {limits}; `gleaner task show {name}` shows all of it",
        dataset.path.display()
    ));
    Ok(name)
}

/// The tasks of the dataset's rate that would accept one of its first episodes. An error if not even the task that was
/// drafted from it would.
async fn trial<'a>(dataset: &Intake, tasks: &'a [Known], drafted: &TaskSpec) -> Result<Vec<&'a Known>> {
    let mut open: Vec<&Known> = tasks.iter().filter(|known| near(drafted.rate_hz, known.spec.rate_hz)).collect();
    let inspector = Inspector::find()?;
    let (mut fitting, mut usable) = (Vec::new(), false);
    let mut problem = gleaner_recording::validate(drafted).err().map(|error| error.to_string());
    let valid = problem.is_none();
    let tried = dataset.description.episodes.min(TRIED);
    for number in 0..tried {
        let episode = match dataset.episode(number).await? {
            Ok(episode) => episode,
            Err(why) => {
                problem.get_or_insert(why);
                continue;
            }
        };
        if valid && !usable {
            match accepts(&inspector, &episode, drafted).await? {
                Ok(()) => usable = true,
                Err(why) => {
                    problem.get_or_insert(why);
                }
            }
        }
        let mut left = Vec::new();
        for known in open {
            match accepts(&inspector, &episode, &known.spec).await? {
                Ok(()) => fitting.push(known),
                Err(_) => left.push(known),
            }
        }
        open = left;
        if open.is_empty() && (usable || !valid) {
            break;
        }
    }
    match problem {
        Some(why) if !usable && fitting.is_empty() => Err(Failure::message(format!(
            "{}: none of its first {tried} episodes can be used, so that no task was created for it: {why}. Correct the \
             dataset, or name the task of its other episodes with --task",
            dataset.path.display()
        ))),
        _ => Ok(fitting),
    }
}

/// Whether the task would accept the episode, or why not.
async fn accepts(inspector: &Inspector, episode: &Episode, spec: &TaskSpec) -> Result<std::result::Result<(), String>> {
    let mut reports = inspector.check(std::slice::from_ref(&episode.recording), spec).await?;
    Ok(reports.pop().map_or(Ok(()), |(_, report)| report.map(|_| ())))
}
