//! Which runs are in memory.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use futures::StreamExt as _;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::super::{
    Output, Ready, Terms,
    loaded_runs::LoadedRuns,
    score_steps,
    testing::{Parrot, ready_in, seen},
};
use crate::{
    domain::id::ScoreRunId,
    error::{Error, Kind, Result},
};

async fn get(loaded: &Arc<LoadedRuns<Parrot>>, run: &ScoreRunId) -> Result<Arc<Ready<Parrot>>> {
    let of = Arc::downgrade(loaded);
    loaded.ready(run, || async { Ok(ready_in(of).await.0) }).await
}

fn in_memory(loaded: &LoadedRuns<Parrot>, runs: &[&ScoreRunId]) -> Vec<bool> {
    let loaded = loaded.loaded();
    runs.iter().map(|run| loaded.contains(run)).collect()
}

#[tokio::test]
async fn a_run_is_loaded_once_for_concurrent_callers() {
    let (loaded, run, loads) = (LoadedRuns::new(1), ScoreRunId::new(), Arc::new(AtomicU32::new(0)));
    let load = || {
        let (of, loads) = (Arc::downgrade(&loaded), Arc::clone(&loads));
        loaded.ready(&run, || async move {
            loads.fetch_add(1, Ordering::SeqCst);
            tokio::task::yield_now().await;
            Ok(ready_in(of).await.0)
        })
    };
    let (one, two) = tokio::join!(load(), load());
    assert!(Arc::ptr_eq(&one.unwrap(), &two.unwrap()));
    assert!(Arc::ptr_eq(&load().await.unwrap(), &load().await.unwrap()));
    assert_eq!(loads.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_load_continues_without_its_caller_and_serves_the_next() {
    let (loaded, run, loads) = (LoadedRuns::new(1), ScoreRunId::new(), Arc::new(AtomicU32::new(0)));
    let (begun, release) = (Arc::new(Notify::new()), Arc::new(Notify::new()));
    let load = || {
        let (of, loads) = (Arc::downgrade(&loaded), Arc::clone(&loads));
        let (begun, release) = (Arc::clone(&begun), Arc::clone(&release));
        loaded.ready(&run, || async move {
            loads.fetch_add(1, Ordering::SeqCst);
            begun.notify_one();
            release.notified().await;
            Ok(ready_in(of).await.0)
        })
    };
    let mut impatient = Box::pin(load());
    tokio::select! {
        _ = &mut impatient => panic!("it was not released"),
        () = begun.notified() => {}
    }
    drop(impatient);
    release.notify_one();
    assert!(load().await.is_ok());
    assert_eq!(loads.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_failed_load_is_retried() {
    let (loaded, run) = (LoadedRuns::<Parrot>::new(1), ScoreRunId::new());
    let failed = loaded.ready(&run, || async { Err(Error::precondition("not yet")) }).await;
    assert_eq!(failed.err().unwrap().kind(), Kind::Precondition);
    assert!(get(&loaded, &run).await.is_ok());
}

#[tokio::test]
async fn the_least_recently_used_idle_run_is_unloaded() {
    let (loaded, runs) = (LoadedRuns::new(2), [ScoreRunId::new(), ScoreRunId::new(), ScoreRunId::new()]);
    let [a, b, c] = &runs;
    for run in [a, b, a] {
        get(&loaded, run).await.unwrap();
    }
    assert_eq!(in_memory(&loaded, &[a, b, c]), [true, true, false]);
    get(&loaded, c).await.unwrap();
    assert_eq!(in_memory(&loaded, &[a, b, c]), [true, false, true]);
}

#[tokio::test]
async fn a_run_stays_loaded_while_a_session_holds_it() {
    let (loaded, runs) = (LoadedRuns::new(0), [ScoreRunId::new(), ScoreRunId::new()]);
    let [a, b] = &runs;
    let (one, two) = (get(&loaded, a).await.unwrap().watch(), get(&loaded, a).await.unwrap().watch());
    let other = get(&loaded, b).await.unwrap().watch();
    assert_eq!(in_memory(&loaded, &[a, b]), [true, true]);
    drop(other);
    assert_eq!(in_memory(&loaded, &[a, b]), [true, false]);
    drop(one);
    assert_eq!(in_memory(&loaded, &[a, b]), [true, false], "another session holds it");
    drop(two);
    assert_eq!(in_memory(&loaded, &[a, b]), [false, false]);
}

#[tokio::test]
async fn a_run_without_a_watch_is_unloaded_once_its_last_caller_is_done() {
    let (loaded, run) = (LoadedRuns::new(0), ScoreRunId::new());
    let one = get(&loaded, &run).await.unwrap().held();
    let other = get(&loaded, &run).await.unwrap().held();
    drop(one);
    assert_eq!(in_memory(&loaded, &[&run]), [true], "another caller uses it");
    drop(other);
    assert_eq!(in_memory(&loaded, &[&run]), [false]);
}

#[tokio::test]
async fn a_run_is_unloaded_once_the_steps_of_an_episode_are_scored() {
    let (loaded, run) = (LoadedRuns::new(0), ScoreRunId::new());
    let ready = get(&loaded, &run).await.unwrap();
    let terms =
        Terms { idle: Duration::from_secs(60), drain: Duration::from_secs(20), stopping: CancellationToken::new() };
    // As of the service, the steps hold the run until they end.
    let decodes = Arc::clone(&ready);
    let (client, sent) = futures::channel::mpsc::unbounded();
    let steps = sent.map(move |stamp| {
        let _shape = decodes.shape();
        Ok((seen(stamp, 0.0), vec![1.0]))
    });
    let mut answers = score_steps(move || async { Ok((ready, steps)) }, terms);
    for stamp in [1, 2] {
        client.unbounded_send(stamp).unwrap();
        assert!(matches!(answers.recv().await, Some(Ok(Output::Scored(_)))));
        assert_eq!(in_memory(&loaded, &[&run]), [true]);
    }
    drop(client);
    assert!(answers.recv().await.is_none(), "it ends with its steps");
    assert_eq!(in_memory(&loaded, &[&run]), [false]);
}

#[tokio::test]
async fn no_run_is_loaded_after_the_stop() {
    let (loaded, run) = (LoadedRuns::new(1), ScoreRunId::new());
    let held = get(&loaded, &run).await.unwrap();
    assert!(Arc::ptr_eq(&loaded.stop()[0], &held));
    assert_eq!(get(&loaded, &run).await.err().unwrap().kind(), Kind::Unavailable);
}
