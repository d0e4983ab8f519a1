//! Deployments that hide a history from policies without one.

use gleaner_core::{Chosen, kinds::Family};

use super::*;

/// A policy that acts on the newest step alone, after one training step.
fn of_one_step() -> Vec<u8> {
    let steps = 8u16;
    let frames = vec![100; usize::from(steps) * shape().frame_bytes()];
    let rising = |count: u16| (0..count).map(|i| f32::from(i) / 10.0).collect::<Vec<_>>();
    let episode = Trajectory::new(&shape(), "ep", frames, rising(2 * steps), rising(steps)).unwrap();
    let optim = OptimSpec { steps: 1, batch: 2, stretch: 2, ..OptimSpec::default() };
    let policy = Chosen::new(Family::Policy, "perceptron").unwrap();
    let spec = TrainSpec { policy, optim, ..TrainSpec::default() };
    let scratch = Pretrained { encoder: None, image_weights: None };
    train_policy(&shape(), scratch, &[episode], &[], &spec, None, &mut Silent).unwrap()
}

#[tokio::test]
async fn a_history_is_hidden_from_policies_that_have_one() {
    let lab = Lab::new().await;
    let (without, with) = (lab.policy(&of_one_step()).await, lab.policy(&trained(1)).await);
    let policies = lab.policies();
    let hiding = |policy: &PolicyId| Assignment { hide_history: true, ..Assignment::of(policy) };
    let refused = policies.deploy("arm", hiding(&without)).await.unwrap_err();
    assert_eq!(refused.kind(), Kind::Invalid, "{refused}");
    assert!(refused.message().starts_with("hide_history: "), "{refused}");
    assert!(refused.message().contains("newest step alone"), "{refused}");
    assert_eq!(lab.store.deployment("arm").await.unwrap_err().kind(), Kind::NotFound);
    policies.deploy("arm", Assignment::of(&without)).await.unwrap();
    policies.deploy("arm", hiding(&with)).await.unwrap();
}

/// Versions before the check stored such deployments.
#[tokio::test]
async fn a_stored_deployment_that_hides_no_history_is_served() {
    let lab = Lab::new().await;
    let without = lab.policy(&of_one_step()).await;
    let hiding = Assignment { hide_history: true, ..Assignment::of(&without) };
    lab.store.deploy("old", &lab.task.id, &hiding).await.unwrap();
    let policies = lab.policies();
    assert_eq!(policies.act("old", vec![observation(1, &[])]).await.unwrap().policy_id, without);
    policies.deploy("old", Assignment::of(&without)).await.unwrap();
    assert!(policies.roll_back("old").await.unwrap().assignment().unwrap().hide_history);
}
