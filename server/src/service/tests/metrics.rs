//! Metrics of a job in one response.

use super::Server;
use crate::{domain::work::Progress, service::job::JobApi, store::testing};

#[tokio::test]
async fn metrics_beyond_the_room_of_a_message_are_thinned() {
    let server = Server::start().await;
    let store = &server.services.store;
    let attempt = testing::claimed(store, &testing::task(store).await.id, "local").await;
    let losses = (1..=95).map(|step| (step, "loss".to_owned(), if step == 42 { 9.0 } else { 0.5 }));
    let late = [(95, "share".to_owned(), 0.25)];
    let progress = Progress { metrics: losses.chain(late).collect(), ..Progress::default() };
    store.report_progress(&attempt, &progress).await.unwrap();
    let api = JobApi(server.services.clone());
    let steps = async |most: usize| {
        let metrics = api.metrics(&attempt.job_id, most).await.unwrap();
        metrics.into_iter().map(|metric| (metric.name, metric.step)).collect::<Vec<_>>()
    };
    assert_eq!(steps(96).await.len(), 96, "all of them have room");
    let some = steps(40).await;
    assert!(some.len() <= 40 && some.len() > 8, "{some:?}");
    assert!(some.contains(&("loss".to_owned(), 42)), "a peak is kept: {some:?}");
    let [first, .., newest, share] = some.as_slice() else { panic!("{some:?}") };
    assert_eq!((first, newest), (&("loss".to_owned(), 1), &("loss".to_owned(), 95)));
    assert_eq!(share, &("share".to_owned(), 95), "a name with few values keeps them");
    assert!(steps(1).await.len() <= 1);
}
