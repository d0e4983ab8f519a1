//! TaskService.

use gleaner_proto::v1::*;
use tonic::Code;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_error, expect_errors},
    lab,
    shared::shared,
};

/// The beginning of an error, and the change of a valid spec that causes it.
type Case = (&'static str, fn(&mut TaskSpec));

const CASES: &[Case] = &[
    ("spec.name: ", |s| s.name.clear()),
    ("spec.name: ", |s| s.name = "../etc/passwd".into()),
    ("spec.name: ", |s| s.name = "x".repeat(129)),
    ("spec.instruction: ", |s| s.instruction = "x".repeat(1001)),
    ("spec.instruction: ", |s| s.instruction = "pick\nplace".into()),
    ("spec.action[0].unit: ", |s| s.action[0].unit = "x".repeat(101)),
    ("spec.proprioception[0].unit: ", |s| s.proprioception[0].unit = "rad\n".into()),
    ("spec.openpi[0].name: ", |s| s.openpi = vec![openpi("no_such_camera", "observation/image")]),
    ("spec.openpi[1].name: ", |s| s.openpi = ["a", "b"].map(|key| openpi(&s.cameras[0].name, key)).into()),
    ("spec.openpi[0].key: ", |s| s.openpi = vec![openpi(&s.cameras[0].name, "")]),
    ("spec.openpi[0].key: ", |s| s.openpi = vec![openpi(&s.cameras[0].name, &"x".repeat(129))]),
    ("spec.openpi[0].key: ", |s| {
        s.openpi = vec![openpi(&s.cameras[0].name, "same"), openpi(&s.cameras[1].name, "observation/same")];
    }),
    ("spec.openpi[0].key: ", |s| s.openpi = vec![openpi(&s.cameras[0].name, &format!("images/{}", s.cameras[1].name))]),
    ("spec.rate_hz: ", |s| s.rate_hz = f64::NAN),
    ("spec.rate_hz: ", |s| s.rate_hz = 10_001.0),
    ("spec.cameras: has 17", |s| s.cameras = vec![s.cameras[0].clone(); 17]),
    ("spec.cameras[0].name: ", |s| s.cameras[0].name = "a b".into()),
    ("spec.cameras[1].name: ", |s| s.cameras[1].name = s.cameras[0].name.clone()),
    ("spec.cameras[0].height: ", |s| s.cameras[0].height = 0),
    ("spec.cameras[1].width: ", |s| s.cameras[1].width = u32::MAX),
    ("spec.cameras: all images", |s| {
        s.cameras.iter_mut().for_each(|camera| (camera.height, camera.width) = (8192, 8192));
        s.cameras = s.cameras.iter().cycle().take(16).cloned().collect();
        s.cameras.iter_mut().enumerate().for_each(|(at, camera)| camera.name = at.to_string());
    }),
    ("spec.cameras[0].recorded.height: ", |s| s.cameras[0].recorded = recorded(0, 640, None)),
    ("spec.cameras[1].recorded.width: ", |s| s.cameras[1].recorded = recorded(480, 8193, None)),
    ("spec.cameras[0].recorded: ", |s| {
        s.cameras[0].recorded = recorded(s.cameras[0].height * 2, s.cameras[0].width / 2, None);
    }),
    ("spec.cameras[0].recorded.crop.height: ", |s| s.cameras[0].recorded = recorded(480, 640, Some([0, 0, 0, 640]))),
    ("spec.cameras[0].recorded.crop.height: ", |s| {
        s.cameras[0].recorded = recorded(480, 640, Some([u32::MAX, 0, 480, 640]));
    }),
    ("spec.cameras[0].recorded.crop.width: ", |s| s.cameras[0].recorded = recorded(480, 640, Some([0, 1, 480, 640]))),
    ("spec.cameras[0].recorded.crop: ", |s| {
        let (height, width) = (s.cameras[0].height, s.cameras[0].width);
        s.cameras[0].recorded = recorded(height, width, Some([0, 0, height - 1, width]));
    }),
    ("spec.proprioception: has 257", |s| s.proprioception = vec![s.proprioception[0].clone(); 257]),
    ("spec.proprioception[0].name: ", |s| s.proprioception[0].name = "timestamp".into()),
    ("spec.proprioception[0].size: ", |s| s.proprioception[0].size = 0),
    ("spec.action: ", |s| s.action.clear()),
    ("spec.action[0].name: ", |s| s.action[0].name = s.proprioception[0].name.clone()),
    ("spec.action[0].size: ", |s| s.action[0].size = 65_537),
    ("spec.action[0].minimum: ", |s| s.action[0].minimum = Some(f32::NEG_INFINITY)),
    ("spec.action[0].maximum: ", |s| s.action[0].maximum = s.action[0].minimum),
    ("spec.action[0].minimum: ", |s| s.action[0].minimum_each = vec![-1.0; 2]),
    ("spec.action[0].maximum: has 1 numbers", |s| {
        (s.action[0].maximum, s.action[0].maximum_each) = (None, vec![1.0]);
    }),
    ("spec.action[2].binary: ", |s| s.action[2].maximum = None),
    ("spec.proprioception[0].minimum: ", |s| s.proprioception[0].binary = true),
    ("spec.alignment: ", |s| s.alignment = 9),
    ("spec.tolerance: ", |s| s.tolerance = Some(0.51)),
    ("spec.tolerance: ", |s| s.tolerance = Some(f64::NAN)),
    ("spec.mappings: ", |s| s.mappings.clear()),
    ("spec.mappings: has 33", |s| s.mappings = vec![s.mappings[0].clone(); 33]),
    ("spec.mappings[0].name: ", |s| s.mappings[0].name = "/".into()),
    ("spec.mappings[0].clock: ", |s| s.mappings[0].clock = "\u{7}".into()),
    ("spec.mappings[0].cameras: ", |s| s.mappings[0].cameras.truncate(1)),
    ("spec.mappings[0].cameras[0].camera: ", |s| s.mappings[0].cameras[0].camera = "ceiling".into()),
    ("spec.mappings[0].cameras[0].color: ", |s| s.mappings[0].cameras[0].color.clear()),
    ("spec.mappings[0].cameras[0].depth: ", |s| s.mappings[0].cameras[0].depth.clear()),
    ("spec.mappings[0].fields: ", |s| s.mappings[0].fields.truncate(1)),
    ("spec.mappings[0].fields[0].field: ", |s| s.mappings[0].fields[0].field = "elbow".into()),
    ("spec.mappings[0].fields[0].topic: ", |s| s.mappings[0].fields[0].topic = "x".repeat(1025)),
    ("spec.mappings[0].fields[0].paths: ", |s| s.mappings[0].fields[0].paths.clear()),
    ("spec.mappings[0].fields[0].paths[0]: ", |s| s.mappings[0].fields[0].paths[0] = "a..b[".into()),
    ("spec.mappings[0].fields[0].names: ", |s| {
        s.mappings[0].fields[0].names = vec!["a".into(); s.proprioception[0].size as usize + 1];
    }),
    ("spec.mappings[0].fields[0].paths: a field with a `transform`", |s| {
        posed(s, "base", "tool", "");
        s.mappings[0].fields[0].paths.push("x".into());
    }),
    ("spec.mappings[0].fields[0].transform: a pose has 7", |s| {
        posed(s, "base", "tool", "");
        s.proprioception[0].size = 6;
    }),
    ("spec.mappings[0].fields[0].transform.parent: ", |s| posed(s, "", "tool", "")),
    ("spec.mappings[0].fields[0].transform.child: ", |s| posed(s, "base", "base", "")),
    ("spec.mappings[0].fields[0].transform.static_topic: ", |s| posed(s, "base", "tool", "\u{7}")),
];

/// Makes the first field the pose of a frame.
fn posed(spec: &mut TaskSpec, parent: &str, child: &str, static_topic: &str) {
    spec.proprioception[0].size = 7;
    let source = &mut spec.mappings[0].fields[0];
    (source.paths, source.names) = (Vec::new(), Vec::new());
    let [parent, child, static_topic] = [parent, child, static_topic].map(Into::into);
    source.transform = Some(Transform { parent, child, static_topic: Some(static_topic) });
}

fn openpi(name: &str, key: &str) -> OpenpiKey {
    OpenpiKey { name: name.into(), key: key.into() }
}

/// A recorded size; the crop is top, left, height and width.
fn recorded(height: u32, width: u32, crop: Option<[u32; 4]>) -> Option<RecordedSize> {
    let crop = crop.map(|[top, left, height, width]| Crop { top, left, height, width });
    Some(RecordedSize { height, width, crop })
}

#[tokio::test]
async fn every_invalid_field_of_a_task_is_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let good = TaskSpec { name: "never_created".into(), ..lab::spec_message() };
    for (words, change) in CASES {
        let mut spec = good.clone();
        change(&mut spec);
        let error = api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap_err();
        expect_error(&error, Code::InvalidArgument, &[]);
        assert!(error.message().starts_with(words), "{words} was expected: {error}");
    }
    expect_errors!(api.tasks:
        create_task(CreateTaskRequest { spec: None }) => InvalidArgument ["spec: "];
        create_task(CreateTaskRequest { spec: Some(TaskSpec { name: lab::TASK.into(), ..good }) }) => AlreadyExists [lab::TASK];
    );
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn unknown_tasks_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let get = |task: &str| GetTaskRequest { task: task.to_owned() };
    expect_errors!(api.tasks:
        get_task(get("")) => NotFound ["task"];
        get_task(get("absent")) => NotFound ["absent"];
        delete_task(DeleteTaskRequest { task: "absent".into() }) => NotFound ["absent"];
        delete_task(DeleteTaskRequest::default()) => NotFound ["task"];
        update_task(UpdateTaskRequest { task: "absent".into(), spec: Some(lab::spec_message()) }) => NotFound ["absent"];
        list_tasks(ListTasksRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_tasks(ListTasksRequest { page_token: absent_id("ep"), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
        get_task(get("task_01ARZ3NDEKTSV4RRFFQ69G5FAV")) => NotFound ["task_01ARZ3NDEKTSV4RRFFQ69G5FAV"];
        get_task(get("../../etc/passwd\0")) => NotFound ["etc"];
        // The error repeats only the beginning of a long name.
        get_task(get(&"ü".repeat(1 << 20))) => NotFound ["(and more)"];
    );
    expect_alive(&mut api).await;
}

#[tokio::test]
async fn used_tasks_keep_what_their_episodes_rest_on() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let update = |spec| UpdateTaskRequest { task: lab::TASK.into(), spec };
    let faster = TaskSpec { rate_hz: 77.0, ..lab::spec_message() };
    expect_errors!(api.tasks:
        update_task(update(None)) => InvalidArgument ["spec: "];
        update_task(update(Some(TaskSpec { rate_hz: 0.0, ..faster.clone() }))) => InvalidArgument ["spec.rate_hz"];
        update_task(update(Some(faster.clone()))) => FailedPrecondition ["spec.rate_hz", "episodes", "create another task"];
        delete_task(DeleteTaskRequest { task: lab::TASK.into() }) => FailedPrecondition ["episodes", "policies"];
    );
    // A task without episodes changes in every way, and can be deleted.
    let spec = TaskSpec { name: "for_a_moment".into(), ..lab::spec_message() };
    api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
    let spec = TaskSpec { name: "changed".into(), ..faster };
    let request = UpdateTaskRequest { task: "for_a_moment".into(), spec: Some(spec.clone()) };
    assert_eq!(api.tasks.update_task(request).await.unwrap().into_inner().task.unwrap().spec, Some(spec));
    api.tasks.delete_task(DeleteTaskRequest { task: "changed".into() }).await.unwrap();
    let gone = api.tasks.get_task(GetTaskRequest { task: "changed".into() }).await.unwrap_err();
    expect_error(&gone, Code::NotFound, &["changed"]);
}
