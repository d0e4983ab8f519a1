//! The engine with commands that are missing, refuse, hang or print nonsense: scripts in a folder of the test.

mod cancelling;
mod failures;
mod fake;

use std::time::Duration;

use self::fake::{Fake, LIMIT, PARTITION};
use super::*;

/// Waits for a place that fits.
async fn place(places: &mut watch::Receiver<Placement>, fits: impl FnMut(&Placement) -> bool) -> Placement {
    places.wait_for(fits).await.unwrap().clone()
}

/// The result of work during which the attempt does not end.
async fn before_its_end<T>(execution: &mut Box<dyn Execution>, work: impl Future<Output = T>) -> T {
    tokio::select! {
        end = execution.ended() => panic!("{end:?}"),
        done = work => done,
    }
}

#[tokio::test]
async fn the_token_is_in_the_environment_and_the_options_of_the_operator_are_in_the_script() {
    let fake = Fake::new().await;
    fake.install(
        "sbatch",
        "for word; do echo \"$word\"; done > arguments; cat > script; env > environment; echo '17;main'",
    );
    fake.list("17|FAILED|node1|NonZeroExitCode");
    let mut execution = fake.start();
    let end = execution.ended().await;
    assert!(matches!(&end, End::Broken(why) if why.contains("Slurm job 17 on node1 failed")), "{end:?}");
    let read = |name: &str| std::fs::read_to_string(fake.path(name)).unwrap();
    let (arguments, script, environment) = (read("arguments"), read("script"), read("environment"));
    let token = fake.issuer.token(&fake.job.id);
    assert!(environment.contains(&format!("GLEANER_JOB_TOKEN={}", token.reveal())));
    assert!(!arguments.contains(token.reveal()) && !script.contains(token.reveal()));
    let name = format!("--job-name=gleaner-{}-", fake.job.id);
    for argument in ["--parsable", "--no-requeue", "--export=ALL", "--open-mode=append", &name] {
        assert!(arguments.lines().any(|line| line.starts_with(argument)), "{argument} in {arguments}");
    }
    let lines: Vec<&str> = script.lines().collect();
    assert_eq!(lines[..3], ["#!/bin/sh", &format!("#SBATCH {PARTITION}"), "module load cuda"]);
    assert!(lines[3].starts_with("exec '/") && lines[3].contains("'--server' 'http://127.0.0.1:7402'"), "{script}");
    assert!(!environment.lines().any(|line| line.starts_with("TMPDIR=")), "{environment}");
}

#[tokio::test]
async fn the_options_of_a_job_come_after_those_of_the_server() {
    let mut fake = Fake::new().await;
    fake.job.engine_options = "--partition=gpu --gres=gpu:1".to_owned();
    fake.install("sbatch", "cat > script; echo 'sbatch: error: Invalid generic resource' >&2; exit 1");
    fake.install("squeue", "true");
    let mut execution = fake.start();
    let mut places = execution.placement();
    let waits = before_its_end(&mut execution, place(&mut places, |place| !place.waiting.is_empty())).await;
    let sources = "check --slurm-options and --slurm-pretrain-options, and the job's own options";
    assert!(waits.waiting.contains(sources), "{waits:?}");
    let script = std::fs::read_to_string(fake.path("script")).unwrap();
    let lines: Vec<&str> = script.lines().filter(|line| line.starts_with("#SBATCH")).collect();
    assert_eq!(lines, [format!("#SBATCH {PARTITION}").as_str(), "#SBATCH --partition=gpu --gres=gpu:1"]);
}

#[tokio::test]
async fn a_job_that_slurm_forgets_counts_unless_it_was_only_seen_to_wait() {
    for resumed in [false, true] {
        for (listed, node) in [("17|PENDING||Resources", ""), ("17|RUNNING|node1|None", "node1")] {
            let fake = Fake::new().await;
            fake.install("sbatch", "echo 17");
            fake.list(listed);
            let mut execution = if resumed { fake.resume("17") } else { fake.start() };
            let mut places = execution.placement();
            let forgotten = async {
                place(&mut places, |place| place.node == node && (place.waiting == "Resources") == node.is_empty())
                    .await;
                fake.install("squeue", "true");
                std::future::pending::<()>().await;
            };
            tokio::select! {
                end = execution.ended() => match &end {
                    End::Interrupted(why) => assert!(node.is_empty() && why.contains("forgot job 17"), "{end:?}"),
                    End::Broken(why) => assert!(!node.is_empty() && why.contains("no record"), "{end:?}"),
                    End::Stopped(_) => panic!("{end:?}"),
                },
                () = forgotten => {}
            }
        }
    }
    // A job that is never listed, as of another cluster, does not repeat without an end.
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    fake.install("squeue", "true");
    let end = fake.start().ended().await;
    assert!(matches!(&end, End::Broken(why) if why.contains("no record")), "{end:?}");
}

#[tokio::test]
async fn squeue_runs_only_while_an_attempt_is_open() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    fake.list("17|PENDING||Resources");
    let mut execution = fake.start();
    let mut places = execution.placement();
    let waits = before_its_end(&mut execution, place(&mut places, |place| place.waiting == "Resources")).await;
    assert_eq!(waits.node, "");
    drop(execution);
    // A call may be under way.
    tokio::time::sleep(LIMIT).await;
    let calls = fake.calls();
    tokio::time::sleep(LIMIT).await;
    assert_eq!(fake.calls(), calls);
}

#[tokio::test]
async fn an_attempt_of_an_earlier_server_is_watched_again_or_was_interrupted() {
    let fake = Fake::new().await;
    fake.list("17|RUNNING|node1|None");
    let mut execution = fake.resume("17");
    let mut places = execution.placement();
    let watched = async {
        place(&mut places, |place| place.node == "node1").await;
        fake.list("17|FAILED|node1|NonZeroExitCode");
        std::future::pending::<()>().await;
    };
    tokio::select! {
        end = execution.ended() => assert!(matches!(&end, End::Broken(_)), "it failed under this server: {end:?}"),
        () = watched => {}
    }
    let end = fake.resume("17").ended().await;
    assert!(matches!(&end, End::Interrupted(why) if why.contains("while the server was down")), "{end:?}");
    fake.install("squeue", "true");
    for id in ["17", ""] {
        let end = fake.resume(id).ended().await;
        assert!(matches!(&end, End::Interrupted(_)), "{end:?}");
    }
    let other = Placement { engine: "local".into(), ..Placement::default() };
    assert!(fake.slurm.resume(&fake.attempt, &other, &fake.lease).is_none());
}

/// Slurm started the job twice, and the second process has ended.
#[tokio::test]
async fn a_contested_attempt_ends_by_its_own_worker() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    fake.list("17|FAILED|node2|NonZeroExitCode");
    fake.leases.contest(&fake.attempt);
    let mut execution = fake.start();
    let delivered = async {
        fake.calls_more(4).await;
        fake.leases.deliver(&fake.attempt);
        std::future::pending::<()>().await;
    };
    tokio::select! {
        end = execution.ended() => assert!(fake.lease.delivered.is_cancelled(), "{end:?}"),
        () = delivered => {}
    }
}

#[tokio::test]
async fn a_killed_attempt_is_cancelled_until_slurm_lists_it_no_more() {
    let fake = Fake::new().await;
    fake.install("sbatch", "echo 17");
    fake.list("17|RUNNING|node1|None");
    fake.install("scancel", "echo \"$@\" >> cancelled; [ $(wc -l < cancelled) -gt 1 ] || exit 1");
    let mut execution = fake.start();
    let mut places = execution.placement();
    before_its_end(&mut execution, place(&mut places, |place| place.node == "node1")).await;
    assert_eq!(execution.kill("silent".to_owned()).await, End::Interrupted("silent".to_owned()));
    drop(execution);
    let cancelled = || std::fs::read_to_string(fake.path("cancelled")).unwrap_or_default().lines().count();
    while cancelled() < 3 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    fake.list("17|CANCELLED|node1|None");
    // The calls end with the last open view.
    let mut calls = (0, 0);
    while calls != (cancelled(), fake.calls()) {
        calls = (cancelled(), fake.calls());
        tokio::time::sleep(LIMIT).await;
    }
    assert!(std::fs::read_to_string(fake.path("cancelled")).unwrap().lines().all(|line| line == "--quiet 17"));
}

#[tokio::test]
async fn the_output_of_a_worker_is_read_once_across_servers() {
    let fake = Fake::new().await;
    let name = script::name(&fake.attempt);
    let path = fake.slurm.template.output(&name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, "one\n").unwrap();
    let (following, mut source) = Following::start(path.clone());
    let mut line = [0; 4];
    tokio::io::AsyncReadExt::read_exact(&mut source, &mut line).await.unwrap();
    assert_eq!(&line, b"one\n");
    while std::fs::read_to_string(path.with_extension("read")).unwrap_or_default() != "4" {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    drop((following, source));
    std::fs::write(&path, "one\ntwo\n").unwrap();
    let (following, mut source) = Following::start(path.clone());
    following.end();
    let mut rest = String::new();
    tokio::io::AsyncReadExt::read_to_string(&mut source, &mut rest).await.unwrap();
    assert_eq!(rest, "two\n");
    while path.exists() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}
