//! Lists by pages, over the wire: joined they are the whole list, in order.

use gleaner_proto::v1::*;

use crate::support::lab;

#[tokio::test]
async fn pages_joined_are_the_whole_list() {
    let (_server, mut api, episodes) = lab::with_episodes(&["--workers", "0"]).await;
    for name in ["a", "b", "c", "d"] {
        let spec = TaskSpec { name: name.into(), ..lab::spec_message() };
        api.tasks.create_task(CreateTaskRequest { spec: Some(spec) }).await.unwrap();
    }
    let mut request = ListTasksRequest { page_size: 2, page_token: String::new() };
    let mut names = Vec::new();
    loop {
        let page = api.tasks.list_tasks(request.clone()).await.unwrap().into_inner();
        assert!(page.tasks.len() <= 2);
        names.extend(page.tasks.into_iter().map(|task| task.spec.unwrap().name));
        match page.next_page_token.as_str() {
            "" => break,
            token => request.page_token = token.to_owned(),
        }
        if names.len() == 2 {
            api.tasks.delete_task(DeleteTaskRequest { task: "a".into() }).await.unwrap();
            api.tasks.delete_task(DeleteTaskRequest { task: "c".into() }).await.unwrap();
        }
    }
    assert_eq!(names, [lab::TASK, "a", "b", "d"], "a task deleted on the page before ends no later page");

    let episode = &episodes[0].id;
    for reason in ["1", "2"] {
        let request = LabelEpisodesRequest {
            episode_ids: vec![episode.clone()],
            outcome: Outcome::Failure.into(),
            reason: reason.into(),
            ..LabelEpisodesRequest::default()
        };
        api.episodes.label_episodes(request).await.unwrap();
    }
    let mut request = ListLabelsRequest { episode_id: episode.clone(), page_size: 2, page_token: String::new() };
    let first = api.episodes.list_labels(request.clone()).await.unwrap().into_inner();
    request.page_token = first.next_page_token;
    let last = api.episodes.list_labels(request).await.unwrap().into_inner();
    let reasons: Vec<_> = first.labels.into_iter().chain(last.labels).map(|label| label.reason).collect();
    assert_eq!((reasons, last.next_page_token.as_str()), (vec!["".to_owned(), "1".into(), "2".into()], ""));
    // A client that names no size gets every row of a short list, as before there were pages.
    let request = ListLabelsRequest { episode_id: episode.clone(), ..ListLabelsRequest::default() };
    assert_eq!(api.episodes.list_labels(request).await.unwrap().into_inner().labels.len(), 3);

    let mut made = Vec::new();
    for _ in 0..3 {
        let request = CreateSnapshotRequest { task: lab::TASK.into(), rule: None };
        made.insert(0, api.snapshots.create_snapshot(request).await.unwrap().into_inner().snapshot.unwrap());
    }
    let mut request = ListSnapshotsRequest { task: lab::TASK.into(), page_size: 2, page_token: String::new() };
    let first = api.snapshots.list_snapshots(request.clone()).await.unwrap().into_inner();
    let later = CreateSnapshotRequest { task: lab::TASK.into(), rule: None };
    api.snapshots.create_snapshot(later).await.unwrap();
    request.page_token = first.next_page_token;
    let last = api.snapshots.list_snapshots(request).await.unwrap().into_inner();
    let joined: Vec<_> = first.snapshots.into_iter().chain(last.snapshots).collect();
    assert_eq!(joined, made, "a snapshot made after the first page is before it");
}
