//! Which runs are in memory.

use std::sync::{
    Arc,
    atomic::{AtomicU32, Ordering},
};

use tokio::sync::Notify;

use super::super::{
    Ready,
    shelf::Shelf,
    testing::{Parrot, ready_on},
};
use crate::{
    domain::id::ScoreRunId,
    error::{Error, Kind, Result},
};

async fn get(shelf: &Arc<Shelf<Parrot>>, run: &ScoreRunId) -> Result<Arc<Ready<Parrot>>> {
    let of = Arc::downgrade(shelf);
    shelf.ready(run, || async { Ok(ready_on(of).await.0) }).await
}

fn loaded(shelf: &Shelf<Parrot>, runs: &[&ScoreRunId]) -> Vec<bool> {
    let loaded = shelf.loaded();
    runs.iter().map(|run| loaded.contains(run)).collect()
}

#[tokio::test]
async fn a_run_is_loaded_once_however_many_ask() {
    let (shelf, run, loads) = (Shelf::new(1), ScoreRunId::new(), Arc::new(AtomicU32::new(0)));
    let ask = || {
        let (of, loads) = (Arc::downgrade(&shelf), Arc::clone(&loads));
        shelf.ready(&run, || async move {
            loads.fetch_add(1, Ordering::SeqCst);
            tokio::task::yield_now().await;
            Ok(ready_on(of).await.0)
        })
    };
    let (one, two) = tokio::join!(ask(), ask());
    assert!(Arc::ptr_eq(&one.unwrap(), &two.unwrap()));
    assert!(Arc::ptr_eq(&ask().await.unwrap(), &ask().await.unwrap()));
    assert_eq!(loads.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_load_goes_on_without_who_asked_for_it_and_serves_the_next() {
    let (shelf, run, loads) = (Shelf::new(1), ScoreRunId::new(), Arc::new(AtomicU32::new(0)));
    let (begun, go_on) = (Arc::new(Notify::new()), Arc::new(Notify::new()));
    let ask = || {
        let (of, loads) = (Arc::downgrade(&shelf), Arc::clone(&loads));
        let (begun, go_on) = (Arc::clone(&begun), Arc::clone(&go_on));
        shelf.ready(&run, || async move {
            loads.fetch_add(1, Ordering::SeqCst);
            begun.notify_one();
            go_on.notified().await;
            Ok(ready_on(of).await.0)
        })
    };
    let mut impatient = Box::pin(ask());
    tokio::select! {
        _ = &mut impatient => panic!("it is not told to go on"),
        () = begun.notified() => {}
    }
    drop(impatient);
    go_on.notify_one();
    assert!(ask().await.is_ok());
    assert_eq!(loads.load(Ordering::SeqCst), 1);
}

#[tokio::test]
async fn a_load_that_failed_is_tried_again() {
    let (shelf, run) = (Shelf::<Parrot>::new(1), ScoreRunId::new());
    let failed = shelf.ready(&run, || async { Err(Error::precondition("not yet")) }).await;
    assert_eq!(failed.err().unwrap().kind(), Kind::Precondition);
    assert!(get(&shelf, &run).await.is_ok());
}

#[tokio::test]
async fn the_least_recently_used_that_nobody_holds_goes() {
    let (shelf, runs) = (Shelf::new(2), [ScoreRunId::new(), ScoreRunId::new(), ScoreRunId::new()]);
    let [a, b, c] = &runs;
    for run in [a, b, a] {
        get(&shelf, run).await.unwrap();
    }
    assert_eq!(loaded(&shelf, &[a, b, c]), [true, true, false]);
    get(&shelf, c).await.unwrap();
    assert_eq!(loaded(&shelf, &[a, b, c]), [true, false, true]);
}

#[tokio::test]
async fn a_run_stays_while_a_session_holds_it_and_goes_with_it() {
    let (shelf, runs) = (Shelf::new(0), [ScoreRunId::new(), ScoreRunId::new()]);
    let [a, b] = &runs;
    let (one, two) = (get(&shelf, a).await.unwrap().watch(), get(&shelf, a).await.unwrap().watch());
    let other = get(&shelf, b).await.unwrap().watch();
    assert_eq!(loaded(&shelf, &[a, b]), [true, true]);
    drop(other);
    assert_eq!(loaded(&shelf, &[a, b]), [true, false]);
    drop(one);
    assert_eq!(loaded(&shelf, &[a, b]), [true, false], "another session holds it");
    drop(two);
    assert_eq!(loaded(&shelf, &[a, b]), [false, false]);
}

#[tokio::test]
async fn nothing_is_loaded_after_the_stop() {
    let (shelf, run) = (Shelf::new(1), ScoreRunId::new());
    let held = get(&shelf, &run).await.unwrap();
    assert!(Arc::ptr_eq(&shelf.stop()[0], &held));
    assert_eq!(get(&shelf, &run).await.err().unwrap().kind(), Kind::Unavailable);
}
