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
        Err(Error::not_found("deployment", "arm"))
    }));
    assert!(futures::poll!(&mut moving).is_pending());
    drop(moving);
    go_on.notify_one();
    assert!(tokio::time::timeout(Duration::from_secs(60), done.notified()).await.is_ok());
}
