//! Pages of every list: their sizes, and tokens of their own.

use gleaner_proto::v1;

use super::{dataset, episode, evaluation, job, page, policy, schedule, score, snapshot, task};
use crate::{
    error::Result,
    id::{DatasetId, EpisodeId, EvaluationId, ExportId, JobId, PolicyId, ScheduleId, ScoreRunId, SnapshotId, TaskId},
};

/// What the request of a page is read as: the key that its token has, and the size.
type Read = Result<(Option<String>, u32)>;

/// A call that lists: its name, the read of a page of this size with this token, the key of a row, and the token that the
/// call returns for it.
struct Listing {
    call: &'static str,
    read: fn(u32, String) -> Read,
    key: String,
    token: String,
}

fn listings() -> Vec<Listing> {
    let by_id = |call, read, id: String| Listing { call, read, token: id.clone(), key: id };
    vec![
        by_id("ListTasks", tasks, TaskId::new().into()),
        by_id("ListEpisodes", episodes, EpisodeId::new().into()),
        by_id("ListJobs", jobs, JobId::new().into()),
        by_id("ListSchedules", schedules, ScheduleId::new().into()),
        by_id("ListSnapshots", snapshots, SnapshotId::new().into()),
        by_id("ListScoreRuns", score_runs, ScoreRunId::new().into()),
        by_id("ListDatasets", datasets, DatasetId::new().into()),
        by_id("ListPolicies", policies, PolicyId::new().into()),
        by_id("ListEvaluations", evaluations, EvaluationId::new().into()),
        by_id("ListSnapshotEpisodes", snapshot_episodes, "17".into()),
        Listing {
            call: "ListDeployments",
            read: deployments,
            key: "pick_cube@prod".into(),
            token: policy::deployments_token(Some("pick_cube@prod".into())),
        },
        Listing { call: "ListLabels", read: labels, key: "17".into(), token: episode::labels_token(Some(17)) },
        Listing { call: "ListExportFiles", read: files, key: "17".into(), token: dataset::files_token(Some(17)) },
    ]
}

fn tasks(page_size: u32, page_token: String) -> Read {
    let page = task::list_request(v1::ListTasksRequest { page_size, page_token })?;
    Ok((page.after.map(Into::into), page.size))
}

fn episodes(page_size: u32, page_token: String) -> Read {
    let request = v1::ListEpisodesRequest { page_size, page_token, ..Default::default() };
    let listing = episode::list_request(request, TaskId::new())?;
    Ok((listing.after.map(Into::into), listing.size))
}

fn jobs(page_size: u32, page_token: String) -> Read {
    let listing = job::list_request(v1::ListJobsRequest { page_size, page_token, ..Default::default() })?;
    Ok((listing.before.map(Into::into), listing.size))
}

fn schedules(page_size: u32, page_token: String) -> Read {
    let listing = schedule::list_request(v1::ListSchedulesRequest { page_size, page_token, ..Default::default() })?;
    Ok((listing.after.map(Into::into), listing.size))
}

fn snapshots(page_size: u32, page_token: String) -> Read {
    let (_, page) = snapshot::list_request(v1::ListSnapshotsRequest { page_size, page_token, ..Default::default() })?;
    Ok((page.after.map(Into::into), page.size))
}

fn score_runs(page_size: u32, page_token: String) -> Read {
    let (_, page) = score::list_request(v1::ListScoreRunsRequest { page_size, page_token, ..Default::default() })?;
    Ok((page.after.map(Into::into), page.size))
}

fn datasets(page_size: u32, page_token: String) -> Read {
    let (_, page) = dataset::list_request(v1::ListDatasetsRequest { page_size, page_token, ..Default::default() })?;
    Ok((page.after.map(Into::into), page.size))
}

fn policies(page_size: u32, page_token: String) -> Read {
    let (_, page) = policy::list_request(v1::ListPoliciesRequest { page_size, page_token, ..Default::default() })?;
    Ok((page.after.map(Into::into), page.size))
}

fn evaluations(page_size: u32, page_token: String) -> Read {
    let policy_id = PolicyId::new().into();
    let (_, page) = evaluation::list_request(v1::ListEvaluationsRequest { policy_id, page_size, page_token })?;
    Ok((page.after.map(Into::into), page.size))
}

fn snapshot_episodes(page_size: u32, page_token: String) -> Read {
    let snapshot_id = SnapshotId::new().into();
    let request = v1::ListSnapshotEpisodesRequest { snapshot_id, page_size, page_token };
    let (_, behind, size) = snapshot::episodes_request(request)?;
    Ok((behind.map(|place| place.to_string()), size))
}

fn deployments(page_size: u32, page_token: String) -> Read {
    let request = v1::ListDeploymentsRequest { page_size, page_token, ..Default::default() };
    let (_, page) = policy::deployments_request(request)?;
    Ok((page.after, page.size))
}

fn labels(page_size: u32, page_token: String) -> Read {
    let episode_id = EpisodeId::new().into();
    let (_, page) = episode::labels_request(v1::ListLabelsRequest { episode_id, page_size, page_token })?;
    Ok((page.after.map(|number| number.to_string()), page.size))
}

fn files(page_size: u32, page_token: String) -> Read {
    let export_id = ExportId::new().into();
    let (_, page) = dataset::files_request(v1::ListExportFilesRequest { export_id, page_size, page_token })?;
    Ok((page.after.map(|place| place.to_string()), page.size))
}

#[test]
fn pages_have_at_most_1000_rows_and_100_by_default() {
    for Listing { call, read, key, token } in listings() {
        assert_eq!(read(0, String::new()).unwrap(), (None, 100), "{call}");
        assert_eq!(read(1000, token).unwrap(), (Some(key), 1000), "{call}");
        let refusal = read(1001, String::new()).unwrap_err();
        assert_eq!(refusal.message(), "page_size: must be at most 1000", "{call}");
    }
}

#[test]
fn a_token_of_another_call_is_rejected() {
    for Listing { call, read, .. } in listings() {
        for other in listings().into_iter().filter(|other| other.call != call) {
            let refusal = read(5, other.token).unwrap_err();
            assert!(
                refusal.message().starts_with("page_token: is not a page token"),
                "{call}, {}: {refusal}",
                other.call
            );
        }
    }
}

#[test]
fn a_damaged_token_is_rejected() {
    for Listing { call, read, token, .. } in listings() {
        let (cut, longer) = (token[1..].to_owned(), format!("{token} "));
        for damaged in
            [longer, format!(":{token}"), "deployment:".into(), "label:".into(), "file:-1".into(), "ü".into()]
        {
            let refusal = read(5, damaged.clone()).unwrap_err();
            assert!(refusal.message().starts_with("page_token: is not a page token"), "{call}, {damaged:?}: {refusal}");
        }
        // A place within a snapshot is a number, of which a part is one too.
        assert!(call == "ListSnapshotEpisodes" || read(5, cut).is_err(), "{call}");
    }
}

#[test]
fn the_last_page_has_an_empty_token() {
    assert_eq!(page::token(None::<TaskId>), "");
    assert_eq!(policy::deployments_token(None), "");
    assert_eq!(episode::labels_token(None), "");
    assert_eq!(dataset::files_token(None), "");
}
