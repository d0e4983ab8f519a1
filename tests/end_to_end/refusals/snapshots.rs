//! SnapshotService.

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_errors},
    lab,
    shared::shared,
};

fn create(rule: RoleRule) -> CreateSnapshotRequest {
    CreateSnapshotRequest { task: lab::TASK.into(), rule: Some(rule) }
}

#[tokio::test]
async fn invalid_snapshots_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let both = RoleRule {
        expert_cohorts: vec!["expert".into()],
        imperfect_cohorts: vec!["failed".into(), "expert".into()],
        ..RoleRule::default()
    };
    let many = RoleRule { expert_cohorts: vec!["x".into(); 1001], ..RoleRule::default() };
    let strange = RoleRule { imperfect_cohorts: vec!["a\nb".into()], ..RoleRule::default() };
    let negative = RoleRule { imperfect_per_expert: -1.0, ..RoleRule::default() };
    let not_a_number = RoleRule { imperfect_per_expert: f64::NAN, ..RoleRule::default() };
    let no_experts = RoleRule { expert_cohorts: vec!["absent".into()], ..RoleRule::default() };
    let get = |id: &str| GetSnapshotRequest { snapshot_id: id.to_owned(), omit_episodes: true };
    let page = |id: &str, page_size, token: &str| ListSnapshotEpisodesRequest {
        snapshot_id: id.to_owned(),
        page_size,
        page_token: token.to_owned(),
    };
    expect_errors!(api.snapshots:
        create_snapshot(CreateSnapshotRequest { task: String::new(), rule: None }) => InvalidArgument ["task: "];
        create_snapshot(CreateSnapshotRequest { task: "absent".into(), rule: None }) => NotFound ["absent"];
        create_snapshot(create(both)) => InvalidArgument ["rule: ", "\"expert\""];
        create_snapshot(create(many)) => InvalidArgument ["rule.expert_cohorts: are 1001"];
        create_snapshot(create(strange)) => InvalidArgument ["rule.imperfect_cohorts[0]: "];
        create_snapshot(create(negative)) => InvalidArgument ["rule.imperfect_per_expert: "];
        create_snapshot(create(not_a_number)) => InvalidArgument ["rule.imperfect_per_expert: "];
        create_snapshot(create(no_experts)) => FailedPrecondition ["expert"];
        get_snapshot(get("snap_7")) => InvalidArgument ["snapshot_id: "];
        get_snapshot(get(&absent_id("snap"))) => NotFound [&absent_id("snap")];
        list_snapshot_episodes(page("snap_7", 0, "")) => InvalidArgument ["snapshot_id: "];
        list_snapshot_episodes(page(&absent_id("snap"), 0, "")) => NotFound [&absent_id("snap")];
        list_snapshot_episodes(page(&absent_id("snap"), 1001, "")) => InvalidArgument ["page_size: "];
        list_snapshot_episodes(page(&absent_id("snap"), 10, "seventeen")) => InvalidArgument ["page_token: "];
        list_snapshots(ListSnapshotsRequest { task: "absent".into(), ..Default::default() }) => NotFound ["absent"];
        list_snapshots(ListSnapshotsRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_snapshots(ListSnapshotsRequest { page_token: "17".into(), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
    );
    expect_alive(&mut api).await;
}
