//! Differences between the stored and the served policy of a deployment.

use super::*;

#[tokio::test]
async fn a_session_uses_the_stored_policy_even_if_memory_is_behind() {
    let lab = Lab::new().await;
    let (old, new) = (lab.policy(&trained(1)).await, lab.policy(&trained(2)).await);
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&old)).await.unwrap();
    lab.store.deploy("arm", &lab.task.id, &Assignment::of(&new)).await.unwrap();
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    let output = tokio::time::timeout(Duration::from_secs(60), robot.receives()).await.unwrap();
    assert!(matches!(output, Ok(SessionOutput::Opened { policy_id, .. }) if policy_id == new));
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap().policy_id, new);
}

#[tokio::test]
async fn a_move_completes_even_if_its_caller_disconnects() {
    let (go_on, done) = (Arc::new(tokio::sync::Notify::new()), Arc::new(tokio::sync::Notify::new()));
    let (go_on_here, done_here) = (Arc::clone(&go_on), Arc::clone(&done));
    let mut moving = Box::pin(move_to_end(async move {
        go_on_here.notified().await;
        done_here.notify_one();
        Err::<Deployment, _>(Error::not_found("deployment", "arm"))
    }));
    assert!(futures::poll!(&mut moving).is_pending());
    drop(moving);
    go_on.notify_one();
    assert!(tokio::time::timeout(Duration::from_secs(60), done.notified()).await.is_ok());
}

#[tokio::test]
async fn a_deleted_deployment_keeps_its_running_sessions_only() {
    let lab = Lab::new().await;
    let policy = lab.policy(&trained(1)).await;
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&policy)).await.unwrap();
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    robot.receives().await.unwrap();

    policies.delete("arm").await.unwrap();
    assert_eq!(robot.acts(observation(1, &[])).await.policy_id, policy, "a running session keeps its policy");
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap_err().kind(), Kind::NotFound);
    let mut later = Robot::new(&policies);
    later.opens("arm");
    assert_eq!(later.receives().await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(policies.delete("arm").await.unwrap_err().kind(), Kind::NotFound);
    drop(robot);
    policies.deploy("arm", Assignment::of(&policy)).await.unwrap();
    assert_eq!(
        policies.act("arm", vec![observation(1, &[])]).await.unwrap().policy_id,
        policy,
        "the name is free again"
    );
    assert_eq!(policies.roll_back("arm").await.unwrap_err().kind(), Kind::Precondition, "without its former history");
}

/// As when two servers share a database.
#[tokio::test]
async fn a_deployment_that_another_server_deleted_is_forgotten() {
    let lab = Lab::new().await;
    let policy = lab.policy(&trained(1)).await;
    let policies = lab.policies();
    for name in ["arm", "leg"] {
        policies.deploy(name, Assignment::of(&policy)).await.unwrap();
    }
    lab.store.delete_deployment("arm").await.unwrap();
    policies.follow_deployments().await;
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap_err().kind(), Kind::NotFound);
    assert_eq!(policies.act("leg", vec![observation(1, &[])]).await.unwrap().policy_id, policy);
}
