//! Failures of scancel: each one names what to check, and the cancellation is repeated.

use super::*;

/// Commands in place of scancel, of which the first is missing, and the words of each failure.
const FAILURES: [(&str, &str); 6] = [
    ("", "scancel is not installed here: install the commands of Slurm, or set --slurm-bin to their folder"),
    (
        "echo 'scancel: error: Kill job error on job id 17: Access/permission denied' >&2; exit 1",
        "scancel: Kill job error on job id 17: Access/permission denied; check that gleaner-server runs as the user of",
    ),
    (
        "echo 'scancel: error: Unable to contact slurm controller (connect failure)' >&2; exit 1",
        "Unable to contact slurm controller (connect failure); check that slurmctld runs",
    ),
    ("exec sleep 60", "scancel did not end within 2 s and was stopped; check that slurmctld runs"),
    ("echo hello", "scancel printed \"hello\", and Slurm's own prints no text; check --slurm-bin"),
    ("exit 3", "scancel: exit status: 3; check --slurm-bin"),
];

#[tokio::test]
async fn each_failure_of_scancel_names_what_to_check() {
    let fake = Fake::new().await;
    for (script, expected) in FAILURES {
        if !script.is_empty() {
            fake.install("scancel", script);
        }
        let problem = fake.slurm.commands.cancel("17").await.unwrap_err().to_string();
        assert!(problem.contains(expected), "{problem}");
    }
    fake.install("scancel", "true");
    assert_eq!(fake.slurm.commands.cancel("17").await, Ok(()));
}

/// Waits until a file of the commands has this line.
async fn has_line(fake: &Fake, file: &str, line: &str) {
    while !std::fs::read_to_string(fake.path(file)).unwrap_or_default().lines().any(|found| found == line) {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// The end of the attempt does not wait for scancel.
#[tokio::test]
async fn a_cancellation_is_repeated_after_every_failure_of_scancel() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    fake.list("17|RUNNING|node1|None");
    let mut execution = fake.start();
    let mut places = execution.placement();
    before_its_end(&mut execution, place(&mut places, |place| place.node == "node1")).await;
    assert_eq!(execution.kill("silent".to_owned()).await, End::Interrupted("silent".to_owned()));
    drop(execution);
    // Time in which the missing command fails: each further cancellation follows an answer of squeue.
    fake.calls_more(4).await;
    for (number, (script, _)) in FAILURES.iter().enumerate().skip(1) {
        fake.install("scancel", &format!("echo {number} >> failures; {script}"));
        has_line(&fake, "failures", &number.to_string()).await;
    }
    fake.install("scancel", "echo \"$@\" >> cancelled");
    has_line(&fake, "cancelled", "--quiet 17").await;
}
