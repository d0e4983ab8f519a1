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

#[tokio::test]
async fn a_move_that_has_begun_is_done_even_if_who_asked_has_gone() {
    let (go_on, done) = (Arc::new(tokio::sync::Notify::new()), Arc::new(tokio::sync::Notify::new()));
    let (told, tell) = (Arc::clone(&go_on), Arc::clone(&done));
    let mut asked = Box::pin(whole(async move {
        told.notified().await;
        tell.notify_one();
        Err(Error::not_found("deployment", "arm"))
    }));
    assert!(futures::poll!(&mut asked).is_pending());
    drop(asked);
    go_on.notify_one();
    assert!(tokio::time::timeout(Duration::from_secs(60), done.notified()).await.is_ok());
}
