//! ScoreService. Invalid recordings and steps of live scoring are in `scoring`.

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    errors::{absent_id, expect_alive, expect_errors},
    lab,
    shared::shared,
};

#[tokio::test]
async fn invalid_score_requests_are_rejected() {
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let (run, unknown) = (shared.run.as_str(), absent_id("run"));
    let of = |run: &str, episode: &str| GetEpisodeScoresRequest {
        score_run_id: run.to_owned(),
        episode_id: episode.to_owned(),
    };
    let histogram = |run: &str, bins, betas| GetHistogramRequest { score_run_id: run.to_owned(), bins, betas };
    let count =
        |run: &str, selections| CountKeptRequest { score_run_id: run.to_owned(), selections, per_episode: false };
    let phases = |count| {
        let shape = Some(SelectionShape { phases: Some(count), ..SelectionShape::default() });
        Selection { shape, ..lab::above(0.5) }
    };
    expect_errors!(api.scores:
        get_score_run(GetScoreRunRequest { score_run_id: "x".into() }) => InvalidArgument ["score_run_id: "];
        get_score_run(GetScoreRunRequest { score_run_id: unknown.clone() }) => NotFound [&unknown];
        list_score_runs(ListScoreRunsRequest { task: "absent".into(), ..Default::default() }) => NotFound ["absent"];
        list_score_runs(ListScoreRunsRequest { page_size: 1001, ..Default::default() }) => InvalidArgument ["page_size: "];
        list_score_runs(ListScoreRunsRequest { page_token: absent_id("ds"), ..Default::default() }) => InvalidArgument ["page_token: is not a page token"];
        get_episode_scores(of("x", &absent_id("ep"))) => InvalidArgument ["score_run_id: "];
        get_episode_scores(of(run, "x")) => InvalidArgument ["episode_id: "];
        get_episode_scores(of(&unknown, &absent_id("ep"))) => NotFound [&unknown];
        get_episode_scores(of(run, &absent_id("ep"))) => NotFound [&absent_id("ep")];
        get_histogram(histogram("x", 0, vec![])) => InvalidArgument ["score_run_id: "];
        get_histogram(histogram(&unknown, 0, vec![])) => NotFound [&unknown];
        get_histogram(histogram(run, 1001, vec![])) => InvalidArgument ["bins: "];
        get_histogram(histogram(run, 10, vec![0.5; 1001])) => InvalidArgument ["betas: "];
        get_histogram(histogram(run, 10, vec![0.5, f64::NAN])) => InvalidArgument ["betas[1]: "];
        count_kept(count("x", vec![lab::above(0.5)])) => InvalidArgument ["score_run_id: "];
        count_kept(count(&unknown, vec![lab::above(0.5)])) => NotFound [&unknown];
        count_kept(count(run, vec![])) => InvalidArgument ["selections: "];
        count_kept(count(run, vec![lab::above(0.5); 101])) => InvalidArgument ["selections: "];
        count_kept(count(run, vec![lab::above(0.5), Selection::default()])) => InvalidArgument ["selections[1]: "];
        count_kept(count(run, vec![lab::top(2.0)])) => InvalidArgument ["selections[0].top_fraction: "];
        count_kept(count(run, vec![phases(0)])) => InvalidArgument ["selections[0].shape.phases: "];
    );
    expect_alive(&mut api).await;
}
