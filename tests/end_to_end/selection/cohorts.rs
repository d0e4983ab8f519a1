//! Datasets that leave out cohorts for their rank beside experts.

use super::*;

/// A dataset whose every cohort is left out is its experts: it counts, streams and exports no other segment, and trains the
/// policy of a dataset whose rule keeps none.
#[tokio::test]
async fn a_dataset_without_its_cohorts_trains_on_experts_alone() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let request = GetHistogramRequest { score_run_id: shared.run.clone(), bins: 2, betas: Vec::new() };
    let ranking = api.scores.get_histogram(request).await.unwrap().into_inner().cohorts;
    let highest = ranking.iter().map(|of| of.expert_auroc).fold(0.0, f64::max);
    assert!(!ranking.is_empty() && highest < 1.0, "{ranking:?}");
    let least =
        |min_expert_auroc| Choice { shape: Shape { min_expert_auroc, ..Shape::default() }, ..Choice::beta(0.0) };
    let (whole, none) = (api.dataset(&shared.run, least(0.0)).await, api.dataset(&shared.run, least(1.0)).await);
    assert!(whole.kept_segments.is_some_and(|kept| kept > 0), "{whole:?}");
    assert_eq!((none.kept_segments, none.kept_episodes), (Some(0), Some(0)));
    assert!(streamed(&mut api, &none.id).await.is_empty() && exported(&mut api, &none.id).await.is_empty());
    let mut losses = Vec::new();
    for dataset in [none.id, api.dataset(&shared.run, Choice::beta(1.0)).await.id] {
        let job = api.succeed(lab::TASK, lab::train(train_spec::Data::DatasetId(dataset), 2)).await;
        losses.push(api.metric(&job.id, "loss").await);
    }
    assert_eq!(losses[0], losses[1], "the same experts");
}
