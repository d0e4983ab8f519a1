//! `gleaner experiment` against a real server: a grid from a file, its report, and a second run that does nothing.

use std::{path::Path, process::Stdio};

use gleaner_proto::v1::*;
use tokio::process::Command;

use crate::{api::Api, server::TestServer};

const FILE: &str = r#"
name = "smallest"
task = "pick_cube"

[data]
image = 16
max_steps = 30
experts = 3
cohorts = [{ agent = "freeze:1", count = 2 }, { agent = "wrong_goal:1", count = 2 }]

[base]
seeds = [0]
episodes = 2
segment_length = 2
pretrain = { steps = 3, batch = 8 }
train = { steps = 2, batch = 8 }

[[study]]
table = "methods"
axes = { method = ["ssdf_base", "ssdf"] }

[[study]]
table = "scoring"
axes = { scorer = ["ssdf", "raw"] }
"#;

async fn run(server: &TestServer, file: &Path, out: &Path) {
    let (ok, said) = experiment(server, file, out, &[]).await;
    assert!(ok, "{said}");
}

async fn experiment(server: &TestServer, file: &Path, out: &Path, flags: &[&str]) -> (bool, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_gleaner-under-test"))
        .args(["--server", server.url(), "experiment"])
        .arg(file)
        .arg("--out")
        .arg(out)
        .args(flags)
        .stdin(Stdio::null())
        .kill_on_drop(true)
        .output()
        .await
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.success(), format!("{}\n{}", text(&output.stdout), text(&output.stderr)))
}

async fn jobs(server: &TestServer) -> Vec<Job> {
    let mut api = Api::connect(server).await;
    api.jobs.list_jobs(ListJobsRequest::default()).await.unwrap().into_inner().jobs
}

#[tokio::test]
async fn an_experiment_shares_stages_reports_and_goes_on() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("smallest.toml"), dir.path().join("out"));
    std::fs::write(&file, FILE).unwrap();
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
    assert_eq!(jobs(&server).await.len(), made.len(), "what is done is not done twice");

    // A grid that has grown: the report of what is there asks for nothing, and says what is missing.
    std::fs::write(&file, FILE.replace("\"ssdf\", \"raw\"]", "\"ssdf\", \"raw\", \"classifier\"]")).unwrap();
    let (ok, said) = experiment(&server, &file, &out, &["--report"]).await;
    assert!(ok && said.contains("Unfinished: 4 of 5 cells") && said.contains("classifier (0 of 1 seeds)"), "{said}");
    assert!(std::fs::read_to_string(out.join("report.md")).unwrap().contains("Unfinished: 4 of 5 cells"));
    assert_eq!(jobs(&server).await.len(), made.len(), "a report makes no job");
    let (ok, said) = experiment(&server, &file, &dir.path().join("new"), &["--report"]).await;
    assert!(!ok && said.contains("without --report"), "{said}");
}

/// Who looks while it runs finds what is finished.
#[tokio::test]
async fn a_report_is_there_before_the_end() {
    let server = TestServer::start().await;
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("smallest.toml"), dir.path().join("out"));
    // The second cell's jobs can't be done: 10^9 steps.
    let cells = r#"cells = [{ label = "short" }, { label = "long", set = { train = { steps = 1000000000 } } }]"#;
    let study = "\n[[study]]\ntable = \"cells\"\n";
    let head = FILE.split("\n[[study]]").next().unwrap();
    std::fs::write(&file, format!("{head}{study}{cells}\n")).unwrap();
    let running = experiment(&server, &file, &out, &[]);
    let report = async {
        let mut look = tokio::time::interval(std::time::Duration::from_millis(50));
        loop {
            look.tick().await;
            if let Ok(report) = std::fs::read_to_string(out.join("report.md")) {
                return report;
            }
        }
    };
    tokio::select! {
        (_, said) = running => panic!("it can't be finished: {said}"),
        report = report => {
            assert!(report.contains("Unfinished: 1 of 2 cells") && report.contains("long (0 of 1 seeds)"), "{report}");
        }
    }
}
