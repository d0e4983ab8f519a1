//! SnapshotService.

use gleaner_proto::v1::*;

use super::{alive, nobody, refuse};
use crate::{api::Api, lab, shared::shared};

fn create(rule: RoleRule) -> CreateSnapshotRequest {
    CreateSnapshotRequest { task: lab::TASK.into(), rule: Some(rule) }
}

#[tokio::test]
async fn snapshots_that_cannot_be() {
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
    let nobodys = RoleRule { expert_cohorts: vec!["nobody".into()], ..RoleRule::default() };
    refuse!(api.snapshots:
        create_snapshot(CreateSnapshotRequest { task: String::new(), rule: None }) => InvalidArgument ["task: "];
        create_snapshot(CreateSnapshotRequest { task: "nobody".into(), rule: None }) => NotFound ["nobody"];
        create_snapshot(create(both)) => InvalidArgument ["rule: ", "\"expert\""];
        create_snapshot(create(many)) => InvalidArgument ["rule.expert_cohorts: are 1001"];
        create_snapshot(create(strange)) => InvalidArgument ["rule.imperfect_cohorts[0]: "];
        create_snapshot(create(negative)) => InvalidArgument ["rule.imperfect_per_expert: "];
        create_snapshot(create(not_a_number)) => InvalidArgument ["rule.imperfect_per_expert: "];
        create_snapshot(create(nobodys)) => FailedPrecondition ["expert"];
        get_snapshot(GetSnapshotRequest { snapshot_id: "snap_7".into() }) => InvalidArgument ["snapshot_id: "];
        get_snapshot(GetSnapshotRequest { snapshot_id: nobody("snap") }) => NotFound [&nobody("snap")];
        list_snapshots(ListSnapshotsRequest { task: "nobody".into() }) => NotFound ["nobody"];
    );
    alive(&mut api).await;
}
