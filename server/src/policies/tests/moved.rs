//! What is stored of a deployment and what is served, should they ever come apart.

use super::*;

#[tokio::test]
async fn a_session_gets_what_is_stored_even_if_the_shelf_was_not_told() {
    let lab = Lab::new().await;
    let (old, new) = (lab.policy(&trained(1)).await, lab.policy(&trained(2)).await);
    let policies = lab.policies();
    policies.deploy("arm", &old, None).await.unwrap();
    lab.store.deploy("arm", &lab.task.id, &new, None).await.unwrap();
    let mut robot = Robot::new(&policies);
    robot.opens("arm");
    let heard = tokio::time::timeout(Duration::from_secs(60), robot.hears()).await.unwrap();
    assert!(matches!(heard, Ok(SessionOutput::Opened { policy_id, .. }) if policy_id == new));
    assert_eq!(policies.act("arm", vec![observation(1, &[])]).await.unwrap().policy_id, new);
}
