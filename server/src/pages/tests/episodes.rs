//! The table and its labels, as requested by browsers and programs.

use gleaner_recording::TaskSpec;
use http::{HeaderValue, Method, StatusCode, header::ACCEPT};
use serde_json::{Value, json};

use crate::{
    domain::{
        access::Role,
        episode::{Episode, Outcome},
        snapshot::Role as Part,
        task::Task,
        time::Millis,
    },
    pages::testing::{Client, JSON, Pages, Reply},
    store::testing::{self, results},
};

/// Episodes on one page.
const PER_PAGE: usize = 100;

struct Lab {
    pages: Pages,
    task: Task,
    visitor: Client,
}

async fn lab() -> Lab {
    let pages = Pages::open(false).await;
    let task = testing::task(&pages.services.store).await;
    let visitor = pages.visitor().await;
    Lab { pages, task, visitor }
}

impl Lab {
    async fn episode(&self, outcome: Outcome, cohort: &str) -> Episode {
        testing::episode(&self.pages.services.store, &self.task, outcome, cohort).await
    }

    async fn table(&self, query: &str) -> Reply {
        self.pages.get(&self.visitor, &format!("/tasks/{}/episodes{query}", self.task.spec.name)).await
    }

    /// The table as JSON.
    async fn rows(&self, query: &str) -> Vec<Value> {
        let reply = self.table(&format!("?format=json{query}")).await;
        assert_eq!(reply.status, StatusCode::OK, "{}", reply.text());
        serde_json::from_slice(&reply.body).unwrap()
    }

    async fn label(&self, client: &Client, body: &Value) -> (StatusCode, Value) {
        let path = format!("/tasks/{}/labels", self.task.spec.name);
        let mut request = client.request(Method::POST, &path, body.to_string());
        request.headers_mut().insert(ACCEPT, HeaderValue::from_static(JSON));
        let reply = self.pages.send(request).await;
        (reply.status, serde_json::from_slice(&reply.body).unwrap_or_default())
    }
}

#[tokio::test]
async fn the_table_filters_sorts_and_shows_q_of_the_newest_run() {
    let lab = lab().await;
    let (expert, weak) = (lab.episode(Outcome::Success, "expert").await, lab.episode(Outcome::Failure, "").await);
    let other = lab.episode(Outcome::Failure, "other").await;
    let encoder = results::encoder(&lab.pages.services.store, &lab.task).await;
    let scores = [
        results::scores(&expert.id, Part::Expert, &[1.0; 20]),
        results::scores(&weak.id, Part::Imperfect, &[0.25; 20]),
        results::scores(&other.id, Part::Imperfect, &[0.75; 20]),
    ];
    let run = results::run(&lab.pages.services.store, &lab.task, &encoder, &scores).await;
    results::set_state(
        &lab.pages.services.store,
        run.origin.job_id().unwrap(),
        crate::domain::job::JobState::Succeeded,
        "",
    )
    .await;

    let ids = |rows: &[Value]| rows.iter().map(|row| row["id"].as_str().unwrap().to_owned()).collect::<Vec<_>>();
    let of = |episodes: &[&Episode]| episodes.iter().map(|episode| episode.id.to_string()).collect::<Vec<_>>();
    assert_eq!(ids(&lab.rows("&outcome=failure&sort=-mean_q").await), of(&[&other, &weak]));
    assert_eq!(ids(&lab.rows("&q_to=0.5").await), of(&[&weak]));
    assert_eq!(ids(&lab.rows("&cohort=(none)").await), of(&[&weak]));
    assert_eq!(ids(&lab.rows(&format!("&text={}", &weak.id.as_str()[5..].to_lowercase())).await), of(&[&weak]));
    assert_eq!(ids(&lab.rows("&from=2020-01-01&to=2020-01-02").await), of(&[]));
    let page = lab.table("?sort=mean_q").await.text();
    assert!(page.contains("0.750") && page.contains("0.250") && page.contains("aria-sort=\"ascending\""));
    assert!(page.contains("href=\"/tasks/reach/episodes?sort=-mean_q\""), "a second click reverses the order");
}

#[tokio::test]
async fn a_label_is_stored_once_and_audited_with_its_episodes() {
    let lab = lab().await;
    let episode = lab.episode(Outcome::Unknown, "weak").await;
    let version = lab.rows("").await[0]["label_version"].clone();
    let ann = Client::with(&lab.pages.token(Role::Contributor).await);
    let body = json!({
        "episodes": [{ "id": episode.id, "version": version }], "outcome": "success", "reason": "held it",
    });
    let (status, answer) = lab.label(&ann, &body).await;
    assert_eq!(status, StatusCode::OK, "{answer}");
    let now = &answer["episodes"][0];
    assert_eq!((&now["outcome"], &now["cohort"]), (&json!("success"), &json!("weak")));
    assert!(now["version"].as_i64() > version.as_i64());

    // The same request again names an outdated version.
    let (status, answer) = lab.label(&lab.visitor, &body).await;
    assert_eq!(status, StatusCode::CONFLICT);
    let first = &answer["changed"][0];
    assert_eq!((&first["outcome"], &first["version"]), (&json!("success"), &now["version"]));
    assert_eq!(first["by"], now["by"]);
    let labels = lab.pages.services.store.labels(&episode.id).await.unwrap();
    assert_eq!((labels.len(), labels[1].reason.as_str()), (2, "held it"));
    let audit = lab.pages.services.store.audit(Millis(0), 10).await.unwrap();
    let named = ["task=reach".to_owned(), format!("episode_id={}", episode.id)];
    let mut outcomes: Vec<&str> =
        audit.iter().filter(|entry| entry.subjects == named).map(|entry| entry.outcome.as_str()).collect();
    outcomes.sort_unstable();
    assert_eq!(outcomes, ["Conflict", "ok"]);
}

#[tokio::test]
async fn an_invalid_label_changes_nothing() {
    let lab = lab().await;
    let episode = lab.episode(Outcome::Unknown, "").await;
    let version = lab.rows("").await[0]["label_version"].clone();
    let elsewhere = crate::domain::id::EpisodeId::new();
    let store = &lab.pages.services.store;
    let other = store.insert_task(&TaskSpec { name: "push".into(), ..testing::spec() }).await.unwrap();
    let foreign = testing::episode(store, &other, Outcome::Unknown, "").await;
    let foreign = json!({ "id": foreign.id, "version": store.label_version(&foreign.id).await.unwrap() });
    let seen = json!({ "id": episode.id, "version": version });
    let too_many: Vec<Value> =
        (0..=1000).map(|_| json!({ "id": crate::domain::id::EpisodeId::new(), "version": 1 })).collect();
    for (expected, message, body) in [
        (
            StatusCode::NOT_FOUND,
            "no episode",
            json!({ "episodes": [seen, { "id": elsewhere, "version": 1 }], "outcome": "success" }),
        ),
        (StatusCode::BAD_REQUEST, "is of another task", json!({ "episodes": [seen, foreign], "outcome": "success" })),
        (StatusCode::BAD_REQUEST, "1 to 1000", json!({ "episodes": too_many, "outcome": "success" })),
        (StatusCode::BAD_REQUEST, "outcome: ", json!({ "episodes": [seen], "outcome": "won" })),
        (StatusCode::BAD_REQUEST, "body: ", json!([])),
    ] {
        let (status, answer) = lab.label(&lab.visitor, &body).await;
        assert_eq!(status, expected, "{answer}");
        assert!(answer["error"].as_str().unwrap().contains(message), "{answer}");
    }
    let audit = store.audit(Millis(0), 10).await.unwrap();
    assert_eq!(audit.len(), 5, "the log has an entry for each");
    let about = |id: &str| audit.iter().filter(|entry| entry.subjects.contains(&format!("episode_id={id}"))).count();
    assert_eq!([elsewhere.as_str(), foreign["id"].as_str().unwrap(), episode.id.as_str()].map(about), [1, 1, 3]);
    assert!(audit.iter().all(|entry| entry.subjects[0] == "task=reach" && entry.subjects.len() <= 32), "{audit:?}");
    lab.pages.services.store.delete_episodes(std::slice::from_ref(&episode.id), false).await.unwrap();
    let (status, answer) = lab.label(&lab.visitor, &json!({ "episodes": [seen], "outcome": "success" })).await;
    assert_eq!((status, answer["changed"].is_array()), (StatusCode::CONFLICT, false));
    assert_eq!(lab.pages.services.store.labels(&episode.id).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_viewer_gets_no_label_buttons() {
    let lab = lab().await;
    lab.episode(Outcome::Unknown, "").await;
    assert!(lab.table("").await.text().contains("id=\"bar\""));
    let viewer = Client::with(&lab.pages.token(Role::Viewer).await);
    let page = lab.pages.get(&viewer, &format!("/tasks/{}/episodes", lab.task.spec.name)).await.text();
    assert!(page.contains("reach.mcap") && !page.contains("id=\"bar\"") && !page.contains("type=\"checkbox\""));
}

#[tokio::test]
async fn invalid_parameters_are_named() {
    let lab = lab().await;
    for (query, status, content) in [
        ("?outcome=won", StatusCode::BAD_REQUEST, "outcome: "),
        ("?q_from=2", StatusCode::BAD_REQUEST, "q_from: "),
        ("?run=run_01ARZ3NDEKTSV4RRFFQ69G5FAV", StatusCode::NOT_FOUND, "no finished score run"),
        ("?run=1", StatusCode::BAD_REQUEST, "run: "),
    ] {
        let reply = lab.table(query).await;
        assert_eq!(reply.status, status, "{query}");
        assert!(reply.text().contains(content), "{query} {}", reply.text());
    }
    let reply = lab.table("?page=9").await;
    assert!(reply.status == StatusCode::OK && reply.text().contains("No episodes match"));
}

#[tokio::test]
async fn a_long_table_has_pages() {
    let lab = lab().await;
    for _ in 0..PER_PAGE + 1 {
        lab.episode(Outcome::Unknown, "").await;
    }
    let first = lab.table("?outcome=unknown").await.text();
    assert_eq!(first.matches("data-id=").count(), PER_PAGE);
    assert!(first.contains("101 episodes") && first.contains("episodes?outcome=unknown&amp;page=2"));
    assert_eq!(lab.table("?page=2").await.text().matches("data-id=").count(), 1);
    assert_eq!(lab.table("?page=77").await.text().matches("data-id=").count(), 1, "beyond the end is the last");
    assert_eq!(lab.rows("").await.len(), PER_PAGE + 1, "programs get the whole");
}
