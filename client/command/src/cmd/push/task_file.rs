//! `push --task-file`: the task of the recordings, created once all of them have passed a check against it.

use std::path::Path;

use gleaner_client::Client;
use gleaner_core::proto::task::{spec_from_proto, spec_to_proto};
use gleaner_proto::v1::{CreateTaskRequest, Task};
use gleaner_recording::TaskSpec;

use super::{PushArgs, items};
use crate::cmd::task::check::{Checked, checked};
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::words;

/// The name of the task in `file`, which the server has once this returns.
///
/// # Errors
/// If a recording or a label would be rejected, or the server has another task of this name; nothing is created then.
pub(super) async fn task(args: &PushArgs, context: &Context, client: &Client, file: &Path) -> Result<String> {
    let checked = checked(context, file, &args.paths, args.rate, items::labels(args)).await?;
    for line in checked.findings().into_iter().chain(checked.labels.clone()) {
        context.output.note(line);
    }
    let Checked { spec, problems, correction, .. } = checked;
    let problems: Vec<String> = problems.into_iter().chain(correction).collect();
    if !problems.is_empty() {
        return Err(Failure::message(format!("{}; {}", problems.join("; "), remedy(file))));
    }
    let name = spec.name.clone();
    let tasks = client.every_task().await?.tasks;
    if is_there(&spec, &tasks, file)? {
        return Ok(name);
    }
    client.tasks().create_task(CreateTaskRequest { spec: Some(spec_to_proto(spec)) }).await?;
    context.output.note(format_args!("created task {name}"));
    Ok(name)
}

/// What to do about recordings or labels that do not fit.
fn remedy(file: &Path) -> String {
    let file = words::shell_word(&file.display().to_string());
    format!(
        "no task was created and no recording sent. Correct {file} or the labels and push again; or create the task with \
         `gleaner task create {file}` and push without --task-file, which leaves out what is rejected"
    )
}

/// Whether the server has this very task.
///
/// # Errors
/// If it has another one of this name.
fn is_there(spec: &TaskSpec, tasks: &[Task], file: &Path) -> Result<bool> {
    let mut specs = tasks.iter().filter_map(|task| task.spec.clone());
    let Some(known) = specs.find(|known| known.name == spec.name) else { return Ok(false) };
    if spec_from_proto(known).is_ok_and(|known| known == *spec) {
        return Ok(true);
    }
    let (name, file) = (&spec.name, words::shell_word(&file.display().to_string()));
    Err(Failure::message(format!(
        "the server has another task named {name}: `gleaner task update {name} {file}` changes it, give the new one another \
         name in {file}, or push with --task {name} in place of --task-file"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_task_of_this_name_must_be_the_same() {
        let spec = |rate: f64| -> TaskSpec {
            serde_json::from_value(serde_json::json!({ "name": "t", "rate_hz": rate, "action": [] })).unwrap()
        };
        let tasks = [Task { spec: Some(spec_to_proto(spec(10.0))), ..Task::default() }];
        let of = |spec: &TaskSpec, tasks: &[Task]| is_there(spec, tasks, Path::new("my task.toml"));
        assert!(!of(&spec(10.0), &[]).unwrap());
        assert!(of(&spec(10.0), &tasks).unwrap());
        let problem = of(&spec(20.0), &tasks).unwrap_err().to_string();
        assert!(problem.contains("`gleaner task update t 'my task.toml'` changes it"), "{problem}");
    }
}
