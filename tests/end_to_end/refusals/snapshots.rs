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
    expect_errors!(api.snapshots:
        create_snapshot(CreateSnapshotRequest { task: String::new(), rule: None }) => InvalidArgument ["task: "];
        create_snapshot(CreateSnapshotRequest { task: "absent".into(), rule: None }) => NotFound ["absent"];
        create_snapshot(create(both)) => InvalidArgument ["rule: ", "\"expert\""];
        create_snapshot(create(many)) => InvalidArgument ["rule.expert_cohorts: are 1001"];
        create_snapshot(create(strange)) => InvalidArgument ["rule.imperfect_cohorts[0]: "];
        create_snapshot(create(negative)) => InvalidArgument ["rule.imperfect_per_expert: "];
        create_snapshot(create(not_a_number)) => InvalidArgument ["rule.imperfect_per_expert: "];
        create_snapshot(create(no_experts)) => FailedPrecondition ["expert"];
        get_snapshot(GetSnapshotRequest { snapshot_id: "snap_7".into() }) => InvalidArgument ["snapshot_id: "];
        get_snapshot(GetSnapshotRequest { snapshot_id: absent_id("snap") }) => NotFound [&absent_id("snap")];
        list_snapshots(ListSnapshotsRequest { task: "absent".into() }) => NotFound ["absent"];
    );
    expect_alive(&mut api).await;
}
