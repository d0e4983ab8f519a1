//! Commands of Slurm that fail: each failure is a reason for waiting that names what to check, and no statement about a
//! job.

use super::*;

/// The job waits with the reason and runs once the command works; no attempt is counted meanwhile.
#[tokio::test]
async fn each_failure_of_sbatch_is_a_reason_for_waiting() {
    let refusal = "echo 'sbatch: error: invalid partition specified: nope' >&2; exit 1";
    let munge = "echo 'sbatch: error: Munge encode failed: Failed to access socket' >&2; exit 1";
    let away = "echo 'sbatch: error: Unable to contact slurm controller (connect failure)' >&2; exit 1";
    for (script, expected) in [
        ("", "sbatch is not installed here: install the commands of Slurm, or set --slurm-bin"),
        (refusal, "sbatch: invalid partition specified: nope; check --slurm-options and --slurm-pretrain-options"),
        (munge, "Munge encode failed: Failed to access socket; check that slurmctld runs and that munged does"),
        (away, "Unable to contact slurm controller (connect failure); check that slurmctld runs"),
        ("exec sleep 60", "sbatch did not end within 2 s and was stopped; check that slurmctld runs"),
        ("echo hello", "sbatch printed \"hello\" instead of the id of a job; check --slurm-bin"),
        ("exit 3", "exit status: 3; check --slurm-bin"),
    ] {
        let fake = Fake::new().await;
        fake.install("squeue", "true");
        if !script.is_empty() {
            fake.install("sbatch", script);
        }
        let mut execution = fake.start();
        let mut places = execution.placement();
        let submitted = async {
            let waits = place(&mut places, |place| !place.waiting.is_empty()).await;
            assert!(waits.waiting.contains(expected) && waits.engine_id.is_empty(), "{waits:?}");
            fake.install("sbatch", "echo 18");
            let submitted = place(&mut places, |place| !place.engine_id.is_empty()).await;
            assert_eq!(submitted.engine_id, "18");
        };
        before_its_end(&mut execution, submitted).await;
    }
}

#[tokio::test]
async fn a_lost_answer_of_sbatch_is_found_and_not_submitted_again() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 1 >> submissions; echo 'sbatch: error: Socket timed out' >&2; exit 1");
    fake.list("19|RUNNING|node1|None");
    let mut execution = fake.start();
    let mut places = execution.placement();
    let found = before_its_end(&mut execution, place(&mut places, |place| !place.node.is_empty())).await;
    assert_eq!(found.engine_id, "19");
    assert_eq!(std::fs::read_to_string(fake.path("submissions")).unwrap().lines().count(), 1);
}

#[tokio::test]
async fn a_failing_squeue_is_a_reason_for_waiting_that_names_what_to_check() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    fake.list("17|PENDING||Priority");
    let mut execution = fake.start();
    let mut places = execution.placement();
    let away = "echo 'slurm_load_jobs error: Unable to contact slurm controller (connect failure)' >&2; exit 1";
    let watched = async {
        place(&mut places, |place| place.waiting == "Priority").await;
        for (failure, expected) in [
            ("echo 'squeue: error: Invalid user' >&2; exit 1", "Invalid user; check that slurmctld runs"),
            (away, "(connect failure); check that slurmctld runs"),
            ("exec sleep 60", "squeue did not end within"),
            ("echo nonsense", "squeue printed \"nonsense\" instead of a job and its state; check --slurm-bin"),
            ("echo 'a|1|running|n|r'", "instead of a job and its state; check --slurm-bin"),
            ("exit 3", "exit status: 3; check --slurm-bin"),
        ] {
            fake.install("squeue", failure);
            place(&mut places, |place| place.waiting.contains(expected)).await;
        }
    };
    before_its_end(&mut execution, watched).await;
}

#[tokio::test]
async fn a_failing_squeue_is_no_statement_about_a_job() {
    for failure in ["echo 1 >> calls; exit 1", "echo 1 >> calls; exec sleep 60", "echo 1 >> calls; echo nonsense"] {
        let fake = Fake::new().await;
        fake.install("sbatch", "echo 17");
        fake.list("17|RUNNING|node1|None");
        let mut execution = fake.start();
        let mut places = execution.placement();
        let watched = async {
            place(&mut places, |place| place.node == "node1").await;
            fake.install("squeue", failure);
            fake.calls_more(4).await;
            fake.list("17|NODE_FAIL|node1|NodeDown");
            std::future::pending::<()>().await;
        };
        tokio::select! {
            end = execution.ended() => assert!(matches!(&end, End::Interrupted(why) if why.contains("NODE_FAIL")), "{end:?}"),
            () = watched => {}
        }
        assert!(fake.calls() >= 4, "{failure}: the failure was met");
    }
}

/// Another job of the user has a line break in its name, or a state that is not a word.
#[tokio::test]
async fn a_malformed_line_of_another_job_does_not_hide_this_one() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    let malformed = "echo 'grid|3|running|node9|None'; echo 'first line of a name'; ";
    fake.list_after(malformed, "17|RUNNING|node1|None");
    let mut execution = fake.start();
    let mut places = execution.placement();
    let watched = async {
        place(&mut places, |place| place.node == "node1").await;
        fake.list_after(malformed, "17|NODE_FAIL|node1|NodeDown");
        std::future::pending::<()>().await;
    };
    tokio::select! {
        end = execution.ended() => assert!(matches!(&end, End::Interrupted(why) if why.contains("NODE_FAIL")), "{end:?}"),
        () = watched => {}
    }
}

#[tokio::test]
async fn a_malformed_line_is_no_statement_about_its_own_job() {
    for hidden in ["echo \"$name|17|?\"", "echo 'squeue: error: the list is incomplete'"] {
        let fake = Fake::new().await;
        fake.install("sbatch", "echo 17");
        fake.list("17|PENDING||Priority");
        let mut execution = fake.start();
        let mut places = execution.placement();
        let watched = async {
            place(&mut places, |place| place.waiting == "Priority").await;
            fake.list_only_others(hidden);
            place(&mut places, |place| place.waiting.contains("instead of a job and its state; check --slurm-bin"))
                .await;
            // More answers than those after which a job that is not listed is gone.
            fake.calls_more(4).await;
            fake.list("17|RUNNING|node1|None");
            place(&mut places, |place| place.node == "node1").await;
        };
        before_its_end(&mut execution, watched).await;
    }
}
