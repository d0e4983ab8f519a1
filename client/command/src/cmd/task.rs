//! `task`: draft, check, create, list, show, update, delete.

pub(super) mod check;
mod draft;
mod pace;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use gleaner_client::ClientError;
use gleaner_core::action::ActionRange;
use gleaner_core::proto::task::{spec_from_proto, spec_to_proto};
use gleaner_proto::v1::{CreateTaskRequest, DeleteTaskRequest, GetTaskRequest, Task, UpdateTaskRequest};
use gleaner_recording::{FieldSpec, TaskSpec};
use gleaner_sim::SimConfig;

use crate::context::Context;
use crate::failure::{Failure, Result, present};
use crate::table::Column::{Left, Right};
use crate::table::{facts, table};
use crate::{json, words};

/// Every key of a task file, generated from the definition.
pub(crate) const KEYS: &str = include_str!("../../../../docs/task-file.md");

#[derive(Debug, Subcommand)]
pub(crate) enum TaskCommand {
    /// Write a task file that is guessed from recordings to standard output, with the reason of each guess. Needs no
    /// server.
    Draft(draft::DraftArgs),
    /// Check a task file, and recordings against it as the server would. Needs no server.
    Check(check::CheckArgs),
    /// Create a task from its specification.
    Create(CreateArgs),
    /// List every task.
    List,
    /// Show the specification of a task; `create` accepts the output of --json.
    Show {
        /// Name or id.
        task: String,
    },
    /// Replace the specification of a task: anything while the task has no episodes and results, afterwards the
    /// instruction, units, the keys of openpi's clients, and mappings by which no episode was read; new ones can be added.
    Update {
        /// Name or id.
        task: String,
        /// File with the whole new specification, TOML or JSON.
        spec: PathBuf,
    },
    /// Delete a task that has no episodes and results.
    Delete {
        /// Name or id.
        task: String,
    },
}

#[derive(Args, Debug)]
pub(crate) struct CreateArgs {
    /// File with the specification, TOML or JSON.
    #[arg(required_unless_present = "sim", conflicts_with = "sim")]
    spec: Option<PathBuf>,
    /// Instead of a file, use this task of the embedded simulator.
    #[arg(long, value_name = "TASK")]
    sim: Option<gleaner_sim::Task>,
    /// Camera height and width in pixels, with --sim. Default: 32.
    #[arg(long, requires = "sim", conflicts_with = "spec", value_name = "PIXELS")]
    image: Option<u32>,
}

impl TaskCommand {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        match self {
            Self::Draft(args) => args.run(context).await,
            Self::Check(args) => args.run(context).await,
            Self::Create(args) => args.run(context).await,
            Self::List => list(context).await,
            Self::Show { task } => show(context, task).await,
            Self::Update { task, spec } => update(context, task, &spec).await,
            Self::Delete { task } => delete(context, task).await,
        }
    }
}

impl CreateArgs {
    async fn run(self, context: &Context) -> Result<()> {
        let specification = match (self.spec, self.sim) {
            (Some(path), _) => read_spec(&path)?,
            (None, Some(task)) => {
                let config = sim_config(self.image)?;
                gleaner_sim::task_spec(task, &config)
            }
            (None, None) => return Err(Failure::message("a specification file or --sim is required")),
        };
        gleaner_recording::validate(&specification)?;
        let request = CreateTaskRequest { spec: Some(spec_to_proto(specification.clone())) };
        let created = context.client().await?.tasks().create_task(request).await?.into_inner();
        let task = present(created.task.as_ref(), "a task")?;
        context
            .output
            .result(|| json::value(&created), || format!("task {} created ({})", specification.name, task.id))?;
        context.output.next(format_args!(
            "gleaner push RECORDINGS --task {} (with the labels.csv in the folder, or a table by --labels)",
            specification.name
        ));
        Ok(())
    }
}

/// The simulator's settings with cameras of this size, or its own.
pub(crate) fn sim_config(image: Option<u32>) -> Result<SimConfig> {
    let mut config = SimConfig::default();
    config.image = image.unwrap_or(config.image);
    config.validate()?;
    Ok(config)
}

// JSON by its extension, else TOML.
pub(crate) fn read_spec(path: &Path) -> Result<TaskSpec> {
    let text = std::fs::read_to_string(path).map_err(ClientError::io(path))?;
    let is_json = path.extension().is_some_and(|extension| extension == "json");
    let parsed = if is_json {
        serde_json::from_str(&text).map_err(|error| error.to_string())
    } else {
        toml::from_str(&text).map_err(|error| error.to_string())
    };
    parsed.map_err(|problem| Failure::message(format!("{}: {problem}", path.display())))
}

async fn list(context: &Context) -> Result<()> {
    let reply = context.client().await?.every_task().await?;
    let columns = [Left("NAME"), Left("ID"), Right("SUCCESS"), Right("FAILURE"), Right("UNKNOWN"), Left("CREATED")];
    let row = |task: &Task| {
        [
            task.spec.as_ref().map(|spec| spec.name.clone()).unwrap_or_default(),
            task.id.clone(),
            task.success_count.to_string(),
            task.failure_count.to_string(),
            task.unknown_count.to_string(),
            words::moment(task.create_time.as_ref()),
        ]
    };
    context.output.result(|| json::value(&reply), || table(columns, reply.tasks.iter().map(row)))?;
    match reply.tasks.first().and_then(|task| task.spec.as_ref()) {
        Some(spec) => context.output.next(format_args!("gleaner episodes --task {}", spec.name)),
        None => context.output.next("gleaner task create SPEC.toml"),
    }
    Ok(())
}

async fn show(context: &Context, name: String) -> Result<()> {
    let reply = context.client().await?.tasks().get_task(GetTaskRequest { task: name }).await?.into_inner();
    let task = present(reply.task.as_ref(), "a task")?;
    let specification = spec_from_proto(present(task.spec.clone(), "a specification")?).map_err(|error| {
        Failure::message(format!("the task was created by a newer version of gleaner: {error}; update this program"))
    })?;
    let document = || serde_json::to_value(&specification).map_err(|error| Failure::message(error.to_string()));
    context.output.result(document, || describe(task, &specification))?;
    context.output.next(format_args!("gleaner episodes --task {}", specification.name));
    Ok(())
}

async fn update(context: &Context, task: String, path: &Path) -> Result<()> {
    let specification = read_spec(path)?;
    gleaner_recording::validate(&specification)?;
    let request = UpdateTaskRequest { task, spec: Some(spec_to_proto(specification.clone())) };
    let reply = context.client().await?.tasks().update_task(request).await?.into_inner();
    let task = present(reply.task.as_ref(), "a task")?;
    context.output.result(|| json::value(&reply), || describe(task, &specification))?;
    context.output.next(format_args!("gleaner push RECORDINGS --task {}", specification.name));
    Ok(())
}

async fn delete(context: &Context, task: String) -> Result<()> {
    let request = DeleteTaskRequest { task: task.clone() };
    let reply = context.client().await?.tasks().delete_task(request).await?.into_inner();
    context.output.result(|| json::value(&reply), || format!("task {task} deleted"))?;
    context.output.next("gleaner task list");
    Ok(())
}

fn describe(task: &Task, spec: &TaskSpec) -> String {
    let cameras = spec.cameras.iter().map(|camera| {
        let kind = if camera.depth { "RGBD" } else { "RGB" };
        let (height, width) = camera.sizes().recorded();
        let recorded = camera.recorded.map(|_| format!(" from {height}×{width}")).unwrap_or_default();
        format!("{} {}×{}{recorded} {kind}", camera.name, camera.height, camera.width)
    });
    let sizes = |fields: &[FieldSpec], range: &dyn Fn(&FieldSpec) -> String| {
        let each = fields.iter().map(|field| format!("{} {}{}{}", field.name, field.size, unit(field), range(field)));
        each.collect::<Vec<_>>().join(", ")
    };
    facts([
        ("name", spec.name.clone()),
        ("id", task.id.clone()),
        ("rate", format!("{} Hz", spec.rate_hz)),
        ("cameras", cameras.collect::<Vec<_>>().join(", ")),
        (
            "proprioception",
            format!("{} values: {}", spec.proprioception_size(), sizes(&spec.proprioception, &|_| String::new())),
        ),
        ("action", format!("{} values: {}", spec.action_size(), sizes(&spec.action, &range))),
        ("mappings", spec.mappings.iter().map(|mapping| mapping.name.as_str()).collect::<Vec<_>>().join(", ")),
        (
            "episodes",
            format!("{} success, {} failure, {} unknown", task.success_count, task.failure_count, task.unknown_count),
        ),
        ("created", words::moment(task.create_time.as_ref())),
    ])
}

/// What values are measured in, such as ` in rad`; empty if that is not known.
fn unit(field: &FieldSpec) -> String {
    if field.unit.is_empty() { String::new() } else { format!(" in {}", field.unit) }
}

/// The limits of each part of an action, such as `speed (-1 to 1), gripper (0 or 1)`.
pub(super) fn limits(action: &[FieldSpec]) -> String {
    action.iter().map(|field| format!("{}{}", field.name, range(field))).collect::<Vec<_>>().join(", ")
}

/// The values that the robot executes, such as ` (-1 to 1)`.
fn range(field: &FieldSpec) -> String {
    let shown = |range| match range {
        ActionRange::Free => "no limits".to_owned(),
        ActionRange::Within(minimum, maximum) => format!("{minimum} to {maximum}"),
        ActionRange::AtLeast(minimum) => format!("at least {minimum}"),
        ActionRange::AtMost(maximum) => format!("at most {maximum}"),
        ActionRange::Binary(low, high) => format!("{low} or {high}"),
    };
    let each: Vec<ActionRange> = ActionRange::of_values(field).collect();
    match each.as_slice() {
        [first, rest @ ..] if rest.iter().all(|range| range == first) => format!(" ({})", shown(*first)),
        each => format!(" ({})", each.iter().map(|range| shown(*range)).collect::<Vec<_>>().join("; ")),
    }
}

#[cfg(test)]
mod tests {
    use gleaner_recording::Bound;

    use super::*;

    #[test]
    fn a_range_is_shown_with_its_field() {
        let field = |minimum: Option<f32>, maximum: Option<f32>, binary| {
            let (minimum, maximum) = (minimum.map(Bound::All), maximum.map(Bound::All));
            FieldSpec { minimum, maximum, binary, ..FieldSpec::new("gripper", 1) }
        };
        assert_eq!(range(&field(Some(-1.0), Some(1.0), true)), " (-1 or 1)");
        assert_eq!(range(&field(Some(-1.0), Some(0.5), false)), " (-1 to 0.5)");
        assert_eq!(range(&field(Some(0.0), None, false)), " (at least 0)");
        assert_eq!(range(&field(None, Some(2.0), false)), " (at most 2)");
        assert_eq!(range(&field(None, None, false)), " (no limits)");
        let each = Some(Bound::Each(vec![0.0, -1.0]));
        let joints = FieldSpec { minimum: each, maximum: Some(Bound::All(2.0)), ..FieldSpec::new("joints", 2) };
        assert_eq!(range(&joints), " (0 to 2; -1 to 2)");
        let action = vec![field(None, None, false), field(Some(0.0), Some(1.0), true)];
        assert_eq!(limits(&action), "gripper (no limits), gripper (0 or 1)");
        assert_eq!(unit(&field(None, None, false)), "");
        assert_eq!(unit(&FieldSpec { unit: "rad".into(), ..FieldSpec::new("joints", 7) }), " in rad");
    }

    #[test]
    fn specs_are_parsed_as_toml_or_json_and_errors_name_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let toml = write("a.toml", "name = \"t\"\nrate_hz = 10.0\naction = [{ name = \"a\", size = 1 }]\n");
        let spec = read_spec(&toml).unwrap();
        let json = write("a.json", &serde_json::to_string(&spec).unwrap());
        assert_eq!(read_spec(&json).unwrap(), spec);

        let wrong = write("b.toml", "name = \"t\"\nrate = 10.0\n");
        let message = read_spec(&wrong).unwrap_err().to_string();
        assert!(message.contains("b.toml") && message.contains("line 2") && message.contains("rate_hz"), "{message}");
    }
}
