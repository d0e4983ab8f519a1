//! Checks that everything acknowledged exists and that no partial change is visible.

use std::{collections::BTreeMap, path::Path};

use gleaner_proto::v1::*;
use tonic::Status;

use super::{
    lab::Lab,
    ledger::{Acknowledged, state},
    sessions,
};
use crate::support::{command, lab as common};

/// Every row of a list, page by page.
macro_rules! every_row {
    ($service:expr, $list:ident, $request:expr, $rows:ident) => {{
        let mut request = $request;
        let mut rows = Vec::new();
        loop {
            let page = $service.$list(request.clone()).await?.into_inner();
            rows.extend(page.$rows);
            if page.next_page_token.is_empty() {
                break rows;
            }
            request.page_token = page.next_page_token;
        }
    }};
}

/// Checks every row, and the content of a few episodes. An error means that the server was gone.
pub async fn sample(lab: &Lab) -> Result<(), Status> {
    let before = lab.ledger.read();
    let listed = episodes(lab).await?;
    let after = lab.ledger.read();
    expect_episodes(&before, &after, &listed);
    expect_rows(lab, &before).await?;
    let some = listed.values().rev().step_by(listed.len() / 4 + 1).chain(listed.values().next_back());
    for episode in some {
        expect_content(lab, episode).await?;
    }
    Ok(())
}

/// Checks every invariant on a server after the last kill.
pub async fn everything(lab: &Lab) {
    sample(lab).await.unwrap();
    for episode in episodes(lab).await.unwrap().values() {
        expect_content(lab, episode).await.unwrap();
    }
    let unfinished: Vec<_> = lab.ledger.read().jobs.into_iter().filter(|(_, ended)| ended.is_none()).collect();
    assert!(unfinished.is_empty(), "{unfinished:?}");
}

async fn episodes(lab: &Lab) -> Result<BTreeMap<String, Episode>, Status> {
    let (mut listed, mut page_token) = (BTreeMap::new(), String::new());
    loop {
        let request =
            ListEpisodesRequest { task: common::TASK.into(), page_size: 500, page_token, ..Default::default() };
        let page = lab.api.clone().episodes.list_episodes(request).await?.into_inner();
        listed.extend(page.episodes.into_iter().map(|episode| (episode.id.clone(), episode)));
        if page.next_page_token.is_empty() {
            return Ok(listed);
        }
        page_token = page.next_page_token;
    }
}

/// Every episode acknowledged before the list was requested is in it, in one of the states requested until it arrived.
fn expect_episodes(before: &Acknowledged, after: &Acknowledged, listed: &BTreeMap<String, Episode>) {
    for (id, kept) in &before.episodes {
        let may_be = &after.episodes[id].requested[kept.acknowledged..];
        match listed.get(id) {
            Some(episode) => {
                assert_eq!(episode.blake3, kept.blake3, "{id}");
                assert!(may_be.contains(&state(episode)), "{episode:?} has none of the states {may_be:?}");
            }
            None => assert!(may_be.iter().any(|state| state.deleted), "{id} is gone: {kept:?}"),
        }
    }
    for id in &before.rollouts {
        assert!(listed.contains_key(id), "{id} of a closed session is gone");
    }
    let mut contents = BTreeMap::new();
    for episode in listed.values() {
        let known = after.attempted.contains(&episode.blake3) || episode.cohort == sessions::COHORT;
        assert!(known && !after.garbage.contains(&episode.blake3), "no client pushed {episode:?}");
        assert!(episode.steps >= 2 && episode.size_bytes > 0, "{episode:?}");
        let twin = contents.insert(&episode.blake3, &episode.id);
        assert_eq!(twin, None, "one content is two episodes");
    }
}

async fn expect_rows(lab: &Lab, before: &Acknowledged) -> Result<(), Status> {
    let mut api = lab.api.clone();
    for (id, ended) in &before.jobs {
        let job = api.jobs.get_job(GetJobRequest { job_id: id.clone() }).await?.into_inner().job.unwrap();
        assert!(ended.is_none_or(|ended| ended == job.state()), "{job:?} had ended as {ended:?}");
    }
    let request = ListDatasetsRequest { task: common::TASK.into(), ..Default::default() };
    let datasets = every_row!(api.datasets, list_datasets, request, datasets);
    for id in &before.datasets {
        assert!(datasets.iter().any(|dataset| dataset.id == *id), "{id} is gone");
    }
    let request = ListScoreRunsRequest { task: common::TASK.into(), ..Default::default() };
    let runs = every_row!(api.scores, list_score_runs, request, score_runs);
    for id in &before.imports {
        assert!(runs.iter().any(|run| run.id == *id), "{id} is gone");
    }
    for id in before.snapshots.iter().rev().take(3) {
        let request = GetSnapshotRequest { snapshot_id: id.clone(), omit_episodes: false };
        api.snapshots.get_snapshot(request).await?;
    }
    let request = ListDeploymentsRequest { task: common::TASK.into(), ..Default::default() };
    let deployments = every_row!(api.policies, list_deployments, request, deployments);
    // Read again, because another policy may have been requested since.
    let after = lab.ledger.read().deployments;
    for (name, (_, acknowledged)) in before.deployments.iter().filter(|(_, (_, acknowledged))| *acknowledged > 0) {
        let found = deployments.iter().find(|found| found.name == *name).unwrap_or_else(|| panic!("{name} is gone"));
        let may_be = &after[name].0[acknowledged - 1..];
        assert!(may_be.contains(&found.policy_id), "{found:?} has none of the policies {may_be:?}");
    }
    Ok(())
}

async fn expect_content(lab: &Lab, episode: &Episode) -> Result<(), Status> {
    let request = DownloadEpisodeRequest { episode_id: episode.id.clone(), accept_url: false };
    let mut chunks = match lab.api.clone().episodes.download_episode(request).await {
        // The curator has deleted it meanwhile.
        Err(status) if matches!(status.code(), tonic::Code::FailedPrecondition | tonic::Code::NotFound) => {
            let kept = lab.ledger.read().episodes.remove(&episode.id);
            let deleted =
                kept.is_some_and(|kept| kept.requested[kept.acknowledged..].iter().any(|state| state.deleted));
            assert!(deleted, "{}: {status}", episode.id);
            return Ok(());
        }
        response => response?.into_inner(),
    };
    let mut hasher = blake3::Hasher::new();
    while let Some(chunk) = chunks.message().await? {
        hasher.update(&chunk.data);
    }
    assert_eq!(hasher.finalize().to_hex().to_string(), episode.blake3, "{}", episode.id);
    Ok(())
}

/// Checks that no partial upload and no temporary file is left once the server has stopped.
pub fn expect_clear_folders(data_dir: &Path) {
    for folder in ["uploads", "tmp"] {
        let left: Vec<_> = data_dir.join(folder).read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
        assert!(left.is_empty(), "{left:?}");
    }
}

/// `gleaner-server check` finds nothing wrong; returns its text.
pub async fn expect_sound(data: &Path) -> String {
    let text = command::expect_sound(data).await;
    eprintln!("{text}");
    text
}
