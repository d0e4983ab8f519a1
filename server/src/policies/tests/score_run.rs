//! Deployments that name a score run unable to score them.

use super::*;

#[tokio::test]
async fn a_run_that_cannot_score_leaves_the_deployment_unchanged() {
    let lab = Lab::new().await;
    let policy = lab.policy(&trained(1)).await;
    let policies = lab.policies();
    policies.deploy("arm", Assignment::of(&policy)).await.unwrap();
    let mut spec = testing::spec();
    spec.name = "other".into();
    let other = lab.store.insert_task(&spec).await.unwrap();
    testing::episode(&lab.store, &other, Outcome::Success, "").await;
    testing::episode(&lab.store, &other, Outcome::Failure, "").await;
    let foreign = results::encoder(&lab.store, &other).await;
    let foreign = results::run(&lab.store, &other, &foreign, &[]).await.id;
    let classifier = gleaner_core::ScoreSpec {
        scorer: gleaner_core::Chosen::new(gleaner_core::kinds::Family::Scorer, "classifier").unwrap(),
        ..Default::default()
    };
    let classifier = results::run_of(&lab.store, &lab.task, &lab.encoder, classifier, &[]).await.id;
    let imported = results::import(&lab.store, &lab.task, &lab.encoder, Some(lab.encoder.id.clone())).await.id;
    let (_, unfinished) = results::scoring(&lab.store, &lab.task, &lab.encoder).await;

    for (run, kind, words) in [
        (foreign, Kind::Invalid, ["score_run_id: ", "belongs to"]),
        (classifier, Kind::Precondition, ["classifier", "raw or ssdf"]),
        (imported, Kind::Precondition, ["was imported", "cannot score live"]),
        (unfinished, Kind::Precondition, ["job_", ""]),
        (ScoreRunId::new(), Kind::NotFound, ["score run", ""]),
    ] {
        let error = policies
            .deploy("arm", Assignment { score_run_id: Some(run), ..Assignment::of(&policy) })
            .await
            .unwrap_err();
        assert_eq!(error.kind(), kind, "{error}");
        assert!(words.iter().all(|word| error.message().contains(word)), "{error}");
    }
    assert_eq!(lab.store.deployment("arm").await.unwrap().history.len(), 1);
}
