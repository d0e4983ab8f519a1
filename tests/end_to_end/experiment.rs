//! `gleaner experiment` against a real server: a grid from a file, its report, and a second run without new jobs.

use std::path::{Path, PathBuf};

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    command::gleaner,
    experiments::{SETTINGS, experiment},
    server::TestServer,
    wait::until,
};

const STUDIES: &str = r#"
[[study]]
table = "methods"
axes = { method = ["ssdf_base", "ssdf"] }

[[study]]
table = "scoring"
axes = { scorer = ["ssdf", "raw"] }
"#;

fn smallest() -> String {
    [SETTINGS, STUDIES].concat()
}

async fn run(server: &TestServer, file: &Path, out: &Path) {
    let (success, text) = experiment(server.url(), file, out, &[]).await;
    assert!(success, "{text}");
}

async fn jobs(server: &TestServer) -> Vec<Job> {
    let mut api = Api::connect(server).await;
    api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs
}

const ORACLE: &str = r#"
[[study]]
table = "cells"
name = "Oracle"
cells = [
  { label = "bc", set = { method = "gleaned_bc", oracle = true } },
  { label = "ssdf", set = { method = "ssdf", oracle = true } },
]
"#;

#[tokio::test]
async fn an_oracle_keeps_what_the_marks_call_good() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("oracle.toml"), dir.path().join("out"));
    std::fs::write(&file, format!("{SETTINGS}{ORACLE}")).unwrap();
    run(&server, &file, &out).await;

    // One encoder, which the second policy begins from; the marks are imported twice, with it and without.
    let made = jobs(&server).await;
    let count = |kind| made.iter().filter(|job| job.kind() == kind).count();
    let counts = [JobKind::Pretrain, JobKind::Score, JobKind::Train, JobKind::Evaluate].map(count);
    assert_eq!(counts, [1, 0, 2, 2]);
    let numbers: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    for cell in numbers["studies"][0]["cells"].as_array().unwrap() {
        let seed = &cell["seeds"][0];
        assert_eq!(seed["separation"][0]["auroc"], 1.0, "{seed}");
        assert_eq!((&seed["selected"]["precision"], &seed["selected"]["recall"]), (&1.0.into(), &1.0.into()), "{seed}");
        assert!(seed["success"].is_object(), "{seed}");
    }

    run(&server, &file, &out).await;
    assert_eq!(jobs(&server).await.len(), made.len(), "nothing is repeated");
    let (success, text) = experiment(server.url(), &file, &out, &["--report"]).await;
    assert!(success && !text.contains("Unfinished"), "the imports are found again: {text}");
}

#[tokio::test]
async fn experiment_shares_stages_and_resumes() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("smallest.toml"), dir.path().join("out"));
    std::fs::write(&file, smallest()).unwrap();
    run(&server, &file, &out).await;

    let made = jobs(&server).await;
    let count = |kind| made.iter().filter(|job| job.kind() == kind).count();
    // One encoder and one snapshot for all cells; two scorers; two policies, each evaluated.
    let counts = [JobKind::Pretrain, JobKind::Score, JobKind::Train, JobKind::Evaluate].map(count);
    assert_eq!(counts, [1, 2, 2, 2]);
    assert!(made.iter().all(|job| job.state() == JobState::Succeeded && !job.key.is_empty()));
    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    assert!(report.contains("AUROC"), "{report}");
    let numbers: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    assert!(numbers.is_object());

    run(&server, &file, &out).await;
    assert_eq!(jobs(&server).await.len(), made.len(), "finished cells are not repeated");

    // A larger grid: the report covers the finished cells, lists the others, and needs no server.
    std::fs::write(&file, smallest().replace("\"ssdf\", \"raw\"]", "\"ssdf\", \"raw\", \"classifier\"]")).unwrap();
    let (success, text) = experiment(server.url(), &file, &out, &["--report"]).await;
    assert!(
        success && text.contains("Unfinished: 4 of 5 cells") && text.contains("classifier (0 of 1 seeds)"),
        "{text}"
    );
    assert!(std::fs::read_to_string(out.join("report.md")).unwrap().contains("Unfinished: 4 of 5 cells"));
    assert_eq!(jobs(&server).await.len(), made.len(), "a report submits no job");
    let (success, text) = experiment(server.url(), &file, &dir.path().join("new"), &["--report"]).await;
    assert!(!success && text.contains("without --report"), "{text}");
}

/// Two seeds with recordings of their own are two tasks on the server, and one report.
#[tokio::test]
async fn seeds_may_have_recordings_of_their_own() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("draws.toml"), dir.path().join("out"));
    let settings = SETTINGS.replace("seeds = [0]", "seeds = [1, 2]\nevaluate = false");
    let settings = settings.replace("experts = 3\n", "experts = 3\nseed_stride = 7\n");
    let scoring = "[[study]]\ntable = \"scoring\"\naxes = { scorer = [\"raw\"] }\n";
    std::fs::write(&file, format!("{settings}{scoring}")).unwrap();
    run(&server, &file, &out).await;

    let made = jobs(&server).await;
    let tasks: std::collections::HashSet<&str> = made.iter().map(|job| job.task_id.as_str()).collect();
    assert_eq!((made.len(), tasks.len()), (4, 2), "an encoder and a score run for each seed");
    let numbers: serde_json::Value = serde_json::from_slice(&std::fs::read(out.join("report.json")).unwrap()).unwrap();
    let experts = &numbers["recorded"][0];
    assert_eq!((&experts["cohort"], &experts["episodes"]), (&"expert".into(), &6.into()));
    assert!(
        numbers["studies"][0]["cells"][0]["seeds"].as_array().unwrap().iter().all(|seed| !seed["separation"].is_null())
    );

    run(&server, &file, &out).await;
    assert_eq!(jobs(&server).await.len(), made.len(), "nothing is repeated");
    let (success, text) = experiment(server.url(), &file, &out, &["--report"]).await;
    assert!(success && !text.contains("Unfinished"), "{text}");
}

/// Two cells, of which the jobs of the second never end: 10^9 steps.
const ENDLESS: &str = r#"
[[study]]
table = "cells"
cells = [{ label = "short" }, { label = "long", set = { train = { steps = 1000000000 } } }]
"#;

/// The report lists the finished cells while others run.
#[tokio::test]
async fn report_is_written_before_the_experiment_ends() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("smallest.toml"), dir.path().join("out"));
    std::fs::write(&file, format!("{SETTINGS}{ENDLESS}")).unwrap();
    let running = experiment(server.url(), &file, &out, &[]);
    let report = async {
        let mut ticks = tokio::time::interval(std::time::Duration::from_millis(50));
        loop {
            ticks.tick().await;
            if let Ok(report) = std::fs::read_to_string(out.join("report.md")) {
                return report;
            }
        }
    };
    tokio::select! {
        (_, text) = running => panic!("the experiment ended: {text}"),
        report = report => {
            assert!(report.contains("Unfinished: 1 of 2 cells") && report.contains("long (0 of 1 seeds)"), "{report}");
        }
    }
}

/// Recordings of the simulator in a folder, as if they were made elsewhere: with labels, marks and the task's spec.
async fn recordings(server: &TestServer, folder: &Path) {
    let out = folder.to_str().unwrap();
    let agents = ["--agent", "expert:3", "--agent", "freeze:1:2", "--agent", "wrong_goal:1:2"];
    let sizes = ["--task", "pick_cube", "--image", "16", "--out", out];
    let output = gleaner(server.url(), &[&["record"], &sizes[..], &agents[..]].concat()).await;
    assert!(output.success, "{}", output.text());
    let config = gleaner_sim::SimConfig { image: 16, ..gleaner_sim::SimConfig::default() };
    let spec = gleaner_sim::task_spec(gleaner_sim::Task::PickCube, &config);
    std::fs::write(folder.join("task.json"), serde_json::to_vec(&spec).unwrap()).unwrap();
}

const ELSEWHERE: &str = r#"
name = "elsewhere"
[data]
folder = "recordings"
[attempts]
simulation = "shell/nothing"
command = ["sh", "-c", """
echo "$0 $1 $2" >&2
for attempt in $(seq $3); do echo '{"success": true, "steps": 5}'; done
""", "{server}", "{deployment}", "{seed}", "{episodes}"]
"#;

/// The file of an experiment on such recordings, beside them, with these first tables.
async fn elsewhere(server: &TestServer, dir: &Path, tables: &str) -> PathBuf {
    recordings(server, &dir.join("recordings")).await;
    let file = dir.join("elsewhere.toml");
    let smallest = smallest();
    let rest = smallest.split_once("[base]").unwrap().1;
    std::fs::write(&file, format!("{tables}[base]{rest}")).unwrap();
    file
}

#[tokio::test]
async fn recordings_made_elsewhere_are_scored_and_a_command_evaluates() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (elsewhere(&server, dir.path(), ELSEWHERE).await, dir.path().join("out"));
    run(&server, &file, &out).await;

    // No job evaluates; the scores and the marks are those of the simulator's own experiment.
    let made = jobs(&server).await;
    assert!(made.iter().all(|job| job.kind() != JobKind::Evaluate));
    let numbers = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(dir.path().join(name).join("report.json")).unwrap()).unwrap()
    };
    let report = numbers("out");
    let cells = report["studies"][0]["cells"].as_array().unwrap();
    for cell in cells {
        let success = &cell["seeds"][0]["success"];
        assert_eq!((&success["successes"], &success["episodes"]), (&2.into(), &2.into()), "{cell}");
    }
    assert!(report["studies"][1]["cells"][0]["seeds"][0]["separation"][0]["auroc"].is_number());
    let mut api = Api::connect(&server).await;
    let log = std::fs::read_to_string(out.join("attempts.log")).unwrap();
    let request = ListPoliciesRequest { task: made[0].task_id.clone(), ..Default::default() };
    let policies = api.policies.list_policies(request).await.unwrap().into_inner().policies;
    for policy in &policies {
        let request = ListEvaluationsRequest { policy_id: policy.id.clone(), ..Default::default() };
        let evaluations = api.policies.list_evaluations(request).await.unwrap().into_inner().evaluations;
        assert_eq!(evaluations[0].simulation, "shell/nothing");
        let attempt = log.lines().find(|line| line.ends_with(&format!("@{} 0", policy.id)));
        assert!(attempt.is_some_and(|line| line.starts_with(&format!("{} experiment-", server.url()))), "{log}");
    }
    assert_eq!((cells.len(), policies.len(), log.lines().count()), (2, 2, 2));
    let left = api.policies.list_deployments(ListDeploymentsRequest::default()).await.unwrap().into_inner().deployments;
    assert!(left.is_empty(), "deployments remain after their attempts: {left:?}");

    // A second run finds every evaluation; a report needs no run.
    run(&server, &file, &out).await;
    let (success, text) = experiment(server.url(), &file, &out, &["--report"]).await;
    assert!(success && text.contains("100.0"), "{text}");
    assert_eq!(jobs(&server).await.len(), made.len());
    for study in 0..2 {
        assert_eq!(numbers("out")["studies"][study]["cells"], report["studies"][study]["cells"]);
    }
    assert_eq!(std::fs::read_to_string(out.join("attempts.log")).unwrap(), log);
}

#[tokio::test]
async fn a_command_evaluates_a_policy_while_the_next_is_trained() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (elsewhere(&server, dir.path(), ELSEWHERE).await, dir.path().join("out"));
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.contains(STUDIES));
    std::fs::write(&file, text.replace(STUDIES, ENDLESS)).unwrap();
    let log = out.join("attempts.log");
    tokio::select! {
        (_, text) = experiment(server.url(), &file, &out, &[]) => panic!("the experiment ended: {text}"),
        () = until("an attempt", async || log.exists().then_some(())) => {}
    }
    let states: Vec<_> =
        jobs(&server).await.iter().filter(|job| job.kind() == JobKind::Train).map(Job::state).collect();
    assert_eq!(states.len(), 2);
    assert!(states.iter().any(|state| *state != JobState::Succeeded), "{states:?}");
}

#[tokio::test]
async fn a_command_that_fails_leaves_its_cells_without_success() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let failing = ELSEWHERE.replace("echo \"$0", "exit 3; echo \"$0");
    let (file, out) = (elsewhere(&server, dir.path(), &failing).await, dir.path().join("out"));
    let (success, text) = experiment(server.url(), &file, &out, &[]).await;
    assert!(!success && text.contains("2 of 4 cells are not complete"), "{text}");
    let report = std::fs::read_to_string(out.join("report.md")).unwrap();
    assert!(report.contains("sh ended with exit status: 3"), "{report}");
}
