//! EpisodeService.

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_errors},
    lab::{self, RECORDINGS},
    shared::shared,
};

fn start(change: fn(&mut StartUploadRequest)) -> StartUploadRequest {
    let mut request = StartUploadRequest {
        task: lab::TASK.into(),
        file_name: "x.mcap".into(),
        size_bytes: 4,
        blake3: "ab".repeat(32),
        outcome: Outcome::Unknown.into(),
        cohort: "c".into(),
        author: "tests".into(),
        ..StartUploadRequest::default()
    };
    change(&mut request);
    request
}

#[tokio::test]
async fn invalid_uploads_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let known = || blake3::hash(&RECORDINGS[0].bytes).to_hex().to_string();
    let mut relabelled = start(|r| r.outcome = Outcome::Failure.into());
    (relabelled.blake3, relabelled.size_bytes) = (known(), RECORDINGS[0].bytes.len() as u64);
    expect_errors!(api.episodes:
        start_upload(start(|r| r.task.clear())) => NotFound ["task"];
        start_upload(start(|r| r.task = "absent".into())) => NotFound ["absent"];
        start_upload(start(|r| r.file_name.clear())) => InvalidArgument ["file_name: "];
        start_upload(start(|r| r.file_name = "a\nb".into())) => InvalidArgument ["file_name: "];
        start_upload(start(|r| r.file_name = "x".repeat(256))) => InvalidArgument ["file_name: "];
        start_upload(start(|r| r.size_bytes = 0)) => InvalidArgument ["size_bytes: "];
        start_upload(start(|r| r.size_bytes = u64::MAX)) => ResourceExhausted ["limit"];
        start_upload(start(|r| r.blake3 = "../../etc/passwd".into())) => InvalidArgument ["blake3: "];
        start_upload(start(|r| r.outcome = 0)) => InvalidArgument ["outcome: "];
        start_upload(start(|r| r.outcome = 77)) => InvalidArgument ["outcome: "];
        start_upload(start(|r| r.cohort = "x".repeat(256))) => InvalidArgument ["cohort: "];
        start_upload(start(|r| r.author = "\u{1b}[2J".into())) => InvalidArgument ["author: "];
        start_upload(relabelled) => AlreadyExists ["success"];
    );
    expect_alive(&mut api).await;
}

fn chunk(upload_id: &str, offset: u64, bytes: usize) -> WriteUploadRequest {
    WriteUploadRequest { upload_id: upload_id.to_owned(), offset, data: vec![7; bytes].into() }
}

#[tokio::test]
async fn chunks_that_do_not_fit_their_upload_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let first = api.episodes.start_upload(start(|r| r.blake3 = "0a".repeat(32))).await.unwrap().into_inner().upload_id;
    let other = api.episodes.start_upload(start(|r| r.blake3 = "0b".repeat(32))).await.unwrap().into_inner().upload_id;
    let send = |chunks: &[WriteUploadRequest]| tokio_stream::iter(chunks.to_vec());
    expect_errors!(api.episodes:
        write_upload(send(&[])) => InvalidArgument ["upload_id: "];
        write_upload(send(&[chunk("", 0, 1)])) => InvalidArgument ["upload_id: "];
        write_upload(send(&[chunk("up_../x", 0, 1)])) => InvalidArgument ["upload_id: "];
        write_upload(send(&[chunk(&absent_id("up"), 0, 1)])) => NotFound [&absent_id("up"), "start again"];
        write_upload(send(&[chunk(&first, 3, 1)])) => InvalidArgument ["offset: "];
        write_upload(send(&[chunk(&first, 0, 1), chunk(&first, 0, 1)])) => InvalidArgument ["offset: "];
        write_upload(send(&[chunk(&first, 1, 1), chunk(&other, 2, 1)])) => InvalidArgument ["upload_id: "];
        write_upload(send(&[chunk(&other, 0, 5)])) => InvalidArgument ["declared size of 4 bytes"];
        write_upload(send(&[chunk(&other, 0, (2 << 20) + 1)])) => InvalidArgument ["data: "];
        get_upload(GetUploadRequest { upload_id: "x".into() }) => InvalidArgument ["upload_id: "];
        get_upload(GetUploadRequest { upload_id: absent_id("up") }) => NotFound [&absent_id("up"), "start again"];
        finish_upload(FinishUploadRequest { upload_id: "x".into() }) => InvalidArgument ["upload_id: "];
        finish_upload(FinishUploadRequest { upload_id: absent_id("up") }) => NotFound [&absent_id("up")];
        finish_upload(FinishUploadRequest { upload_id: other.clone() }) => FailedPrecondition ["of 4 bytes"];
    );
    expect_alive(&mut api).await;
}

fn list(change: fn(&mut ListEpisodesRequest)) -> ListEpisodesRequest {
    let mut request = ListEpisodesRequest { task: lab::TASK.into(), ..ListEpisodesRequest::default() };
    change(&mut request);
    request
}

#[tokio::test]
async fn invalid_episode_requests_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let known = shared.episodes[0].id.clone();
    let label = |ids: &[&str], outcome: i32| LabelEpisodesRequest {
        episode_ids: ids.iter().map(|&id| id.to_owned()).collect(),
        outcome,
        ..LabelEpisodesRequest::default()
    };
    let label_as = |cohort: &str, author: &str, reason: &str| LabelEpisodesRequest {
        cohort: Some(cohort.to_owned()),
        author: author.to_owned(),
        reason: reason.to_owned(),
        ..label(&[&known], 1)
    };
    let unknown = absent_id("ep");
    let labels = |page_size, token: &str| ListLabelsRequest {
        episode_id: known.clone(),
        page_size,
        page_token: token.to_owned(),
    };
    expect_errors!(api.episodes:
        get_episode(GetEpisodeRequest { episode_id: "ep_../../x".into() }) => InvalidArgument ["episode_id: "];
        get_episode(GetEpisodeRequest { episode_id: unknown.clone() }) => NotFound [&unknown];
        list_episodes(list(|r| r.task = "absent".into())) => NotFound ["absent"];
        list_episodes(list(|r| r.outcome = 77)) => InvalidArgument ["outcome: "];
        list_episodes(list(|r| r.page_size = 1001)) => InvalidArgument ["page_size: "];
        list_episodes(list(|r| r.page_token = "1".into())) => InvalidArgument ["page_token: "];
        label_episodes(label(&[], 1)) => InvalidArgument ["episode_ids: "];
        label_episodes(label(&[known.as_str(); 10_001], 1)) => InvalidArgument ["episode_ids: "];
        label_episodes(label(&[&known, "x"], 1)) => InvalidArgument ["episode_ids[1]: "];
        label_episodes(label(&[&known, &unknown], 1)) => NotFound [&unknown];
        label_episodes(label(&[&known], 0)) => InvalidArgument ["outcome: "];
        label_episodes(label(&[&known], -1)) => InvalidArgument ["outcome: "];
        label_episodes(label_as(&"x".repeat(256), "", "")) => InvalidArgument ["cohort: "];
        label_episodes(label_as("", "\0", "")) => InvalidArgument ["author: "];
        label_episodes(label_as("", "", &"x".repeat(256))) => InvalidArgument ["reason: "];
        list_labels(ListLabelsRequest { episode_id: "x".into(), ..Default::default() }) => InvalidArgument ["episode_id: "];
        list_labels(ListLabelsRequest { episode_id: unknown.clone(), ..Default::default() }) => NotFound [&unknown];
        list_labels(labels(1001, "")) => InvalidArgument ["page_size: "];
        list_labels(labels(5, "17")) => InvalidArgument ["page_token: is not a page token"];
        download_episode(DownloadEpisodeRequest { episode_id: "x".into(), accept_url: true }) => InvalidArgument ["episode_id: "];
        download_episode(DownloadEpisodeRequest { episode_id: unknown.clone(), accept_url: true }) => NotFound [&unknown];
    );
    let labels = api
        .episodes
        .list_labels(ListLabelsRequest { episode_id: known, ..Default::default() })
        .await
        .unwrap()
        .into_inner()
        .labels;
    assert_eq!(labels.len(), 1, "a rejected request changed the labels");
}

#[tokio::test]
async fn invalid_deletions_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let (held, unknown) = (shared.episodes[0].id.clone(), absent_id("ep"));
    let delete = |ids: &[&str]| DeleteEpisodesRequest {
        episode_ids: ids.iter().map(|&id| id.to_owned()).collect(),
        force: false,
    };
    let undelete =
        |ids: &[&str]| UndeleteEpisodesRequest { episode_ids: ids.iter().map(|&id| id.to_owned()).collect() };
    expect_errors!(api.episodes:
        delete_episodes(delete(&[])) => InvalidArgument ["episode_ids: "];
        delete_episodes(delete(&["../x"])) => InvalidArgument ["episode_ids[0]: "];
        delete_episodes(delete(&[&unknown])) => NotFound [&unknown];
        delete_episodes(delete(&[&held])) => FailedPrecondition [&held];
        undelete_episodes(undelete(&[])) => InvalidArgument ["episode_ids: "];
        undelete_episodes(undelete(&[&held, "x"])) => InvalidArgument ["episode_ids[1]: "];
        undelete_episodes(undelete(&[&unknown])) => NotFound [&unknown];
    );
    let episode = api.episodes.get_episode(GetEpisodeRequest { episode_id: held }).await.unwrap().into_inner().episode;
    assert_eq!(episode.unwrap().delete_time, None);
}
