//! Score runs and their datasets and policies, as requested by browsers and programs.

use http::{StatusCode, header::LOCATION};
use serde_json::Value;

use crate::{
    domain::{
        episode::Outcome,
        id::{DatasetId, PolicyId, ScoreRunId},
        job::JobState,
        score::ScoreRun,
        selection::Selection,
        snapshot::Role,
        task::Task,
        time::Millis,
    },
    pages::testing::{Client, FORM, JSON, Pages},
    store::{
        Store,
        testing::{self, results},
    },
};

/// A run of two imperfect episodes of 20 segments each: one of q 0.9, one of q 0.1 except for its last, of q 0.5.
async fn run(store: &Store) -> (Task, ScoreRun) {
    let task = testing::task(store).await;
    testing::episode(store, &task, Outcome::Success, "").await;
    let good = testing::episode(store, &task, Outcome::Failure, "ada").await;
    let bad = testing::episode(store, &task, Outcome::Failure, "bob").await;
    let encoder = results::encoder(store, &task).await;
    let mut low = [0.1; 20];
    low[19] = 0.5;
    let scores =
        [results::scores(&good.id, Role::Imperfect, &[0.9; 20]), results::scores(&bad.id, Role::Imperfect, &low)];
    (task.clone(), results::run(store, &task, &encoder, &scores).await)
}

async fn json(pages: &Pages, path: &str) -> Value {
    serde_json::from_slice(&pages.get(&Client::default(), path).await.body).unwrap()
}

#[tokio::test]
async fn counts_follow_the_threshold_on_the_page_and_for_programs() {
    let pages = Pages::open(false).await;
    let (_, run) = run(&pages.services.store).await;
    let visitor = pages.visitor().await;
    let shown = pages.get(&visitor, &format!("/runs/{}?beta=0.4", run.id)).await;
    assert_eq!(shown.status, StatusCode::OK);
    let text = shown.text();
    assert!(text.contains("<dd>21<small> of 40</small></dd>") && text.contains("value=\"0.4\""), "{text}");
    assert!(text.contains("Create dataset") && text.contains("ada") && !text.contains("style="));

    let content = json(&pages, &format!("/runs/{}/what-if?beta=0.5", run.id)).await;
    assert_eq!((&content["total"]["kept_segments"], &content["total"]["kept_episodes"]), (&20.into(), &1.into()));
    assert_eq!(content["cohorts"]["bob"]["kept_segments"], 0);
    let content = json(&pages, &format!("/runs/{}/what-if?top_fraction=0.51", run.id)).await;
    assert_eq!((&content["total"]["kept_segments"], &content["selection"]["top_fraction"]), (&21.into(), &0.51.into()));
    let part = pages.get(&visitor, &format!("/runs/{}/what-if?beta=0.95&format=html", run.id)).await.text();
    assert!(part.contains("id=\"by-episode\"") && part.contains("<dd>0<small> of 40</small></dd>"), "{part}");
    // The last segment of the bad episode is a run of one; the nine before it are its context.
    let content = json(&pages, &format!("/runs/{}/what-if?beta=0.4&context_before=9", run.id)).await;
    assert_eq!(
        (&content["total"]["kept_segments"], &content["selection"]["shape"]["context_before"]),
        (&30.into(), &9.into())
    );
    let shown = pages.get(&visitor, &format!("/runs/{}?beta=0.4&min_run=2", run.id)).await.text();
    assert!(
        shown.contains("<dd>20<small> of 40</small></dd>") && shown.contains("<details id=\"shape\" open>"),
        "{shown}"
    );
    assert!(
        shown.contains("<input type=\"hidden\" name=\"min_run\" value=\"2\">"),
        "the dataset has the shape: {shown}"
    );
    let table = pages.get(&visitor, &format!("/runs/{}?beta=0.4&sort=share&format=csv", run.id)).await.text();
    let kept: Vec<&str> = table.lines().skip(1).map(|line| line.split(',').nth(1).unwrap()).collect();
    assert_eq!(kept, ["1", "20"]);
}

#[tokio::test]
async fn an_invalid_threshold_or_run_is_refused_by_name() {
    let pages = Pages::open(false).await;
    let (task, run) = run(&pages.services.store).await;
    let encoder = pages.services.store.encoder(run.origin.encoder_id().unwrap()).await.unwrap();
    let (_, coming) = results::scoring(&pages.services.store, &task, &encoder).await;
    for (path, status, message) in [
        (format!("/runs/{}?beta=high", run.id), StatusCode::BAD_REQUEST, "beta: "),
        (format!("/runs/{}?beta=1.5", run.id), StatusCode::BAD_REQUEST, "beta: is 1.5"),
        (format!("/runs/{}/what-if?beta=", run.id), StatusCode::BAD_REQUEST, "beta: "),
        (format!("/runs/{}?beta=0.5&min_run=few", run.id), StatusCode::BAD_REQUEST, "min_run: "),
        (format!("/runs/{}/what-if?phases=0", run.id), StatusCode::BAD_REQUEST, "phases: is 0"),
        (format!("/runs/{}?sort=name", run.id), StatusCode::BAD_REQUEST, "sort: "),
        ("/runs/7".to_owned(), StatusCode::BAD_REQUEST, "id: "),
        (format!("/runs/{}", ScoreRunId::new()), StatusCode::NOT_FOUND, "score run"),
        (format!("/runs/{coming}"), StatusCode::CONFLICT, "is not finished"),
        (format!("/datasets/{}", DatasetId::new()), StatusCode::NOT_FOUND, "dataset"),
        (format!("/policies/{}", PolicyId::new()), StatusCode::NOT_FOUND, "policy"),
        ("/tasks/nothing/runs".to_owned(), StatusCode::NOT_FOUND, "nothing"),
    ] {
        let refused = pages.get(&Client::default(), &path).await;
        assert_eq!(refused.status, status, "{path}");
        assert!(refused.text().contains(message), "{path}: {}", refused.text());
    }
}

#[tokio::test]
async fn a_dataset_is_made_once_and_its_page_shows_its_counts() {
    let pages = Pages::open(false).await;
    let (task, run) = run(&pages.services.store).await;
    let visitor = pages.visitor().await;
    let path = format!("/runs/{}/datasets", run.id);
    let proof = visitor.proof.clone().unwrap();
    let made = pages.post(&visitor, &path, (FORM, &format!("proof={proof}&beta=0.4"))).await;
    assert_eq!(made.status, StatusCode::SEE_OTHER);
    let page = made.headers[LOCATION].to_str().unwrap().to_owned();
    let shown = pages.get(&visitor, &page).await.text();
    assert!(shown.contains("<dd>21<small> of 40</small></dd>") && shown.contains("q &gt; 0.4"), "{shown}");
    let again = pages.post(&visitor, &path, (JSON, "{\"beta\":0.4}")).await;
    let content: Value = serde_json::from_slice(&again.body).unwrap();
    assert_eq!(content["page"], page.as_str());
    for (body, message) in [("{\"beta\":7}", "beta: is 7"), ("{}", "beta: must be set"), ("[", "body: ")] {
        let refused = pages.post(&visitor, &path, (JSON, body)).await;
        assert!(refused.status == StatusCode::BAD_REQUEST && refused.text().contains(message), "{}", refused.text());
    }
    assert_eq!(pages.services.store.datasets(&task.id).await.unwrap().len(), 1);
    let shaped = pages.post(&visitor, &path, (JSON, "{\"beta\":0.4,\"min_run\":2}")).await;
    let content: Value = serde_json::from_slice(&shaped.body).unwrap();
    let shown = pages.get(&visitor, content["page"].as_str().unwrap()).await.text();
    assert!(shown.contains("<dd>20<small> of 40</small></dd>") && shown.contains("q &gt; 0.4, min_run 2"), "{shown}");

    let list = pages.get(&visitor, &format!("/tasks/{}/runs", task.spec.name)).await.text();
    assert!(list.contains(&page) && list.contains(run.id.as_str()), "{list}");
    let rows = json(&pages, &format!("/tasks/{}/runs?format=json", task.spec.name)).await;
    assert_eq!((&rows[0]["score_run_id"], &rows[0]["imperfect_episodes"]), (&run.id.as_str().into(), &2.into()));
}

#[tokio::test]
async fn a_permanently_deleted_episode_of_a_run_is_no_link() {
    let pages = Pages::open(false).await;
    let (_, run) = run(&pages.services.store).await;
    let store = &pages.services.store;
    let episode = pages.services.curation.summary(&run.id).await.unwrap().best(1).await.unwrap().remove(0).episode_id;
    let encoder = store.encoder(run.origin.encoder_id().unwrap()).await.unwrap();
    for job in [&encoder.job_id, run.origin.job_id().unwrap()] {
        results::set_state(store, job, JobState::Succeeded, "").await;
    }
    let links = format!("/episodes/{episode}");
    let shown = async |path: &str| pages.get(&Client::default(), &format!("/runs/{}{path}", run.id)).await.text();
    store.delete_episodes(std::slice::from_ref(&episode), true).await.unwrap();
    let page = shown("?beta=0.4").await;
    assert!(page.contains(&links) && page.contains("in the trash") && !page.contains("recording deleted"), "{page}");
    assert_eq!(store.sweep_trash(Millis(i64::MAX)).await.unwrap().purged, 1);
    for path in ["?beta=0.4", "/what-if?beta=0.4&format=html"] {
        let page = shown(path).await;
        assert!(!page.contains(&links) && page.contains(episode.as_str()), "{path}: {page}");
        assert!(page.contains("recording deleted") && page.contains("/episodes/ep_"), "{path}: {page}");
    }
}

#[tokio::test]
async fn an_imported_run_is_shown_with_its_source() {
    let pages = Pages::open(false).await;
    let store = &pages.services.store;
    let (task, scored) = run(store).await;
    let encoder = store.encoder(scored.origin.encoder_id().unwrap()).await.unwrap();
    let imported = results::import(store, &task, &encoder, None).await;
    let named = results::import(store, &task, &encoder, Some(encoder.id.clone())).await;
    let dataset = store.insert_dataset(&imported.id, Selection::beta(0.5)).await.unwrap().id;
    let shown = async |path: String| pages.get(&Client::default(), &path).await.text();
    let page = shown(format!("/runs/{}", imported.id)).await;
    let (of, made) = (format!("/snapshots/{}", imported.snapshot_id), format!("/datasets/{dataset}"));
    for part in ["imported over", "an oracle", of.as_str(), made.as_str()] {
        assert!(page.contains(part), "{part} is not in {page}");
    }
    let from = format!("/encoders/{}", encoder.id);
    assert!(!page.contains(&from) && !page.contains("Created by"), "{page}");
    assert!(shown(format!("/runs/{}", named.id)).await.contains(&from));
    let there = format!("/runs/{}", imported.id);
    for path in [made, of, format!("/tasks/{}/runs", task.spec.name)] {
        assert!(shown(path.clone()).await.contains(&there), "{path} does not show the run");
    }
    let rows = json(&pages, &format!("/tasks/{}/runs?format=json", task.spec.name)).await;
    let row = rows.as_array().unwrap().iter().find(|row| row["score_run_id"] == imported.id.as_str()).unwrap();
    assert_eq!((&row["scorer"], &row["job_id"], &row["encoder_id"]), (&"imported".into(), &Value::Null, &Value::Null));
    assert!(row["settings"].as_str().unwrap().contains("an oracle"), "{row}");
}

#[tokio::test]
async fn a_dataset_of_a_pending_run_reports_it() {
    let pages = Pages::open(false).await;
    let (task, run) = run(&pages.services.store).await;
    let store = &pages.services.store;
    let encoder = store.encoder(run.origin.encoder_id().unwrap()).await.unwrap();
    let (job, coming) = results::scoring(store, &task, &encoder).await;
    let dataset = store.insert_dataset(&coming, Selection::beta(0.5)).await.unwrap();
    let shown = pages.get(&Client::default(), &format!("/datasets/{}", dataset.id)).await;
    assert_eq!(shown.status, StatusCode::OK);
    assert!(shown.text().contains("is not finished") && shown.text().contains(job.as_str()));
    results::set_state(store, &job, JobState::Failed, "no room").await;
    let shown = pages.get(&Client::default(), &format!("/datasets/{}", dataset.id)).await.text();
    assert!(shown.contains("no room"), "{shown}");
}

#[tokio::test]
async fn a_viewer_gets_no_buttons() {
    let pages = Pages::open(true).await;
    let (_, run) = run(&pages.services.store).await;
    let path = format!("/runs/{}", run.id);
    for (role, offered) in [(crate::domain::access::Role::Viewer, false), (crate::domain::access::Role::Trainer, true)]
    {
        let client = Client::with(&pages.token(role).await);
        let shown = pages.get(&client, &path).await.text();
        assert_eq!(shown.contains("Create dataset"), offered, "{role:?}");
        let made = pages.post(&client, &format!("{path}/datasets"), (JSON, "{\"beta\":0.5}")).await;
        assert_eq!(made.status == StatusCode::FORBIDDEN, !offered);
    }
}

#[tokio::test]
async fn a_policy_shows_its_success_and_inputs() {
    use crate::domain::{
        evaluation::{Evaluation, SeedResult},
        id::EvaluationId,
    };
    let pages = Pages::open(false).await;
    let (task, run) = run(&pages.services.store).await;
    let store = &pages.services.store;
    let encoder = store.encoder(run.origin.encoder_id().unwrap()).await.unwrap();
    let policy = results::policy(store, &task, &encoder, blake3::hash(b"policy").into()).await;
    let evaluation = Evaluation {
        id: EvaluationId::new(),
        policy_id: policy.id.clone(),
        job_id: Some(encoder.job_id.clone()),
        simulation: "bench 3".into(),
        seeds: vec![SeedResult { seed: 0, episodes: 20, successes: 10, mean_steps: 1.0 }],
        created_at: Millis::now(),
    };
    store.insert_evaluation(&evaluation).await.unwrap();
    store.deploy("arm", &task.id, &crate::domain::policy::Assignment::of(&policy.id)).await.unwrap();
    let path = format!("/policies/{}", policy.id);
    let plain = pages.get(&Client::default(), &path).await.text();
    assert!(!plain.contains("What it looks at"), "no share is reported");
    results::metrics(store, policy.job_id().unwrap(), &[("share_images", 0.625), ("share_camera_0", 0.25)]).await;
    results::metrics(store, &encoder.job_id, &[("share_images", 0.125), ("share_proprioception", 0.875)]).await;
    let shown = pages.get(&Client::default(), &path).await.text();
    let (made_with, made_of) = (format!("/encoders/{}", encoder.id), format!("/snapshots/{}", encoder.snapshot_id));
    for there in [
        "What it looks at",
        "images</td><td class=\"number\">0.62</td><td class=\"number\">0.12</td>",
        "camera_0</td><td class=\"number\">0.25</td><td class=\"number\">-</td>",
        "proprioception</td><td class=\"number\">-</td><td class=\"number\">0.88</td>",
        "50.0 % (29.9 to 70.1)",
        "bench 3",
        "/deployments/arm",
        made_with.as_str(),
        made_of.as_str(),
    ] {
        assert!(shown.contains(there), "{there} is not in {shown}");
    }
    assert_eq!(json(&pages, &format!("{path}?format=json")).await[0]["successes"], 10);
}
