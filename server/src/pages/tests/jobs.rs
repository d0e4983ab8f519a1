//! The pages of jobs as requested by browsers and programs.

use gleaner_core::PretrainSpec;
use http::{
    StatusCode,
    header::{CONTENT_TYPE, LOCATION},
};
use serde_json::Value;

use crate::{
    domain::{
        episode::Outcome,
        id::JobId,
        job::{Job, JobState},
        order::{JobOrder, Queueing},
        snapshot::RoleRule,
        task::Task,
        time::Millis,
        work::Progress,
    },
    pages::testing::{Client, FORM, JSON, Pages},
    store::testing::{self, results},
};

async fn task(pages: &Pages) -> Task {
    let task = testing::task(&pages.services.store).await;
    for outcome in [Outcome::Success, Outcome::Failure] {
        testing::episode(&pages.services.store, &task, outcome, "").await;
    }
    task
}

async fn pretrain(pages: &Pages, task: &Task) -> Job {
    let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec: PretrainSpec::default() };
    pages.services.jobs.submit(&task.id, order, Queueing::default()).await.unwrap()
}

async fn json(pages: &Pages, path: &str) -> Value {
    serde_json::from_slice(&pages.get(&Client::default(), path).await.body).unwrap()
}

#[tokio::test]
async fn the_list_filters_and_continues_where_it_ended() {
    let pages = Pages::open(false).await;
    let task = task(&pages).await;
    let mut made = Vec::new();
    for _ in 0..101 {
        made.insert(0, pretrain(&pages, &task).await.id);
    }
    let first = pages.get(&Client::default(), "/jobs").await.text();
    assert!(first.contains(made[0].as_str()) && !first.contains(made[100].as_str()));
    let older = format!("/jobs?before={}", made[99]);
    assert!(first.contains(&older) && first.contains("data-live"), "{first}");
    assert!(first.contains(&format!("<option value=\"{}\">", task.spec.name)), "names of tasks are suggested");
    let last = pages.get(&Client::default(), &older).await.text();
    assert!(last.contains(made[100].as_str()) && !last.contains("Older"));
    let overview = pages.get(&Client::default(), "/").await.text();
    assert!(
        overview.contains("href=\"/jobs\"") && !overview.contains("/jobs?format="),
        "a table of all jobs has pages"
    );

    assert!(last.contains("href=\"/jobs?format=json\""), "the table for programs has every job: {last}");

    let count = async |query: &str| json(&pages, &format!("/jobs?format=json&{query}")).await.as_array().unwrap().len();
    assert_eq!(count("kind=score").await, 0);
    assert_eq!(count(&format!("kind=pretrain&state=queued&task={}", task.spec.name)).await, 101);
    assert_eq!(count(&format!("before={}", made[99])).await, 1);
    let rows = json(&pages, "/jobs?format=json").await;
    let ids: Vec<&str> = rows.as_array().unwrap().iter().map(|row| row["job_id"].as_str().unwrap()).collect();
    assert_eq!(ids, made.iter().map(JobId::as_str).collect::<Vec<_>>(), "each job once, newest first");
    assert_eq!(pages.get(&Client::default(), "/jobs?format=csv").await.text().lines().count(), 1 + 101);
    for (query, message) in [("state=odd", "state: "), ("kind=odd", "kind: "), ("before=odd", "before: ")] {
        let refused = pages.get(&Client::default(), &format!("/jobs?{query}")).await;
        assert!(refused.status == StatusCode::BAD_REQUEST && refused.text().contains(message), "{query}");
    }
    assert_eq!(pages.get(&Client::default(), "/jobs?task=nothing").await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn a_running_job_shows_its_progress() {
    let pages = Pages::open(false).await;
    let task = task(&pages).await;
    let job = pretrain(&pages, &task).await;
    let store = &pages.services.store;
    store.claim_job("hash", "local").await.unwrap().unwrap();
    let attempt = crate::domain::attempt::Attempt { job_id: job.id.clone(), token_hash: "hash".into() };
    let metrics = (1..=5).map(|step| (step, "loss_mtp".to_owned(), 0.5)).collect();
    let progress = Progress { done: 5, total: 20, message: "pretraining".into(), metrics, peak_memory_bytes: 1 << 20 };
    store.report_progress(&attempt, &progress).await.unwrap();
    let course = pages.get(&Client::default(), &format!("/jobs/{}/course", job.id)).await.text();
    for there in ["data-state=\"running\"", "5 of 20", "25.0 %", "pretraining", "loss_mtp", "<path", "1.0 MiB"] {
        assert!(course.contains(there), "{there} is not in {course}");
    }
    let whole = pages.get(&Client::default(), &format!("/jobs/{}", job.id)).await.text();
    assert!(whole.contains("id=\"course\"") && whole.contains(job.result_id.as_str()) && !whole.contains("style="));
    store.cancel_job(&job.id).await.unwrap();
    for list in ["/", "/jobs"] {
        let shown = pages.get(&Client::default(), list).await.text();
        assert!(shown.contains(">cancelling<") && !shown.contains(">running</span>"), "{list}: {shown}");
    }
    assert_eq!(pages.get(&Client::default(), &format!("/jobs/{}", JobId::new())).await.status, StatusCode::NOT_FOUND);
    assert_eq!(pages.get(&Client::default(), "/jobs/run_1").await.status, StatusCode::BAD_REQUEST);
}

#[tokio::test]
async fn a_job_is_cancelled_once_and_retried() {
    let pages = Pages::open(false).await;
    let task = task(&pages).await;
    let job = pretrain(&pages, &task).await;
    let visitor = pages.visitor().await;
    let proof = format!("proof={}", visitor.proof.clone().unwrap());
    let shown = pages.get(&visitor, &format!("/jobs/{}", job.id)).await.text();
    let (before, form) = shown.split_once(&format!("action=\"/jobs/{}/cancel\"", job.id)).unwrap();
    assert!(
        before.contains("<summary class=\"button danger\">Cancel</summary>")
            && form.contains(">Cancel the job</button>"),
        "a click asks first"
    );
    let (cancel, retry) = (format!("/jobs/{}/cancel", job.id), format!("/jobs/{}/retry", job.id));
    let refused = pages.post(&visitor, &retry, (FORM, &proof)).await;
    assert_eq!(refused.status, StatusCode::CONFLICT);
    assert_eq!(pages.post(&visitor, &cancel, (FORM, &proof)).await.status, StatusCode::SEE_OTHER);
    assert_eq!(pages.services.store.job(&job.id).await.unwrap().state, JobState::Cancelled);
    assert_eq!(pages.post(&visitor, &cancel, (FORM, &proof)).await.status, StatusCode::CONFLICT);
    let shown = pages.get(&visitor, &format!("/jobs/{}", job.id)).await.text();
    assert!(shown.contains(">Retry<") && !shown.contains(">Cancel<"));
    let again = pages.post(&visitor, &retry, (FORM, &proof)).await;
    let page = again.headers[LOCATION].to_str().unwrap();
    assert!(page.starts_with("/jobs/job_") && page != format!("/jobs/{}", job.id));
    let content = pages.post(&visitor, &retry, (JSON, "{}")).await;
    assert_eq!(content.status, StatusCode::CONFLICT, "once is enough");
    let id = page.trim_start_matches("/jobs/");
    assert!(content.text().contains(id) && pages.services.store.job(&JobId::parse("id", id).unwrap()).await.is_ok());
    let log = pages.services.store.audit(Millis(0), 100).await.unwrap();
    let subject = format!("job_id={}", job.id);
    assert!(log.iter().any(|entry| entry.rpc == "pages/RetryJob" && entry.subjects == [subject.clone()]));
}

#[tokio::test]
async fn a_failed_job_shows_its_error_and_links_to_the_cause() {
    let pages = Pages::open(false).await;
    let task = task(&pages).await;
    let (job, cause) = (pretrain(&pages, &task).await, JobId::new());
    let error = format!("{cause}, which this job waits for, <failed>");
    results::set_state(&pages.services.store, &job.id, JobState::Failed, &error).await;
    let shown = pages.get(&Client::default(), &format!("/jobs/{}", job.id)).await.text();
    assert!(shown.contains(&format!("href=\"/jobs/{cause}\"")) && shown.contains("&lt;failed&gt;"), "{shown}");
}

#[tokio::test]
async fn an_episode_in_a_jobs_error_is_a_link_while_it_has_a_page() {
    let pages = Pages::open(false).await;
    let task = task(&pages).await;
    let (job, store) = (pretrain(&pages, &task).await, &pages.services.store);
    let episode = testing::episode(store, &task, Outcome::Failure, "").await.id;
    let error = format!("episode {episode}: the picture is damaged");
    results::set_state(store, &job.id, JobState::Failed, &error).await;
    let link = format!("href=\"/episodes/{episode}\"");
    let paths = ["/jobs".to_owned(), format!("/jobs/{}", job.id), format!("/jobs/{}/course", job.id)];
    let expect = async |is_link: bool| {
        for path in &paths {
            let shown = pages.get(&Client::default(), path).await.text();
            assert!(shown.contains(episode.as_str()), "{path}: {shown}");
            assert_eq!(shown.contains(&link), is_link, "{path}: {shown}");
        }
    };
    expect(true).await;
    store.delete_episodes(std::slice::from_ref(&episode), true).await.unwrap();
    expect(true).await;
    assert_eq!(store.sweep_trash(Millis(i64::MAX)).await.unwrap().removed, 1);
    expect(false).await;
}

#[tokio::test]
async fn workers_output_is_on_the_jobs_page_and_as_text() {
    let pages = Pages::open(false).await;
    let task = task(&pages).await;
    let job = pretrain(&pages, &task).await;
    let page = format!("/jobs/{}", job.id);
    assert!(pages.get(&Client::default(), &page).await.text().contains("The log is empty"));
    assert_eq!(pages.get(&Client::default(), &format!("{page}/log")).await.text(), "");

    let folder = gleaner_data_folder::logs(&pages.services.config.data_dir);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join(format!("{}.log", job.id)), "one\n<script>two\x07\n").unwrap();
    let course = pages.get(&Client::default(), &format!("{page}/course")).await.text();
    assert!(course.contains("one\n&lt;script&gt;two\\u{7}\n") && !course.contains("<script>"), "{course}");
    let whole = pages.get(&Client::default(), &format!("{page}/log")).await;
    assert_eq!(whole.text(), "one\n<script>two\\u{7}\n");
    assert_eq!(whole.headers[CONTENT_TYPE], "text/plain; charset=utf-8", "no browser takes it for a page");
    for (path, status) in [
        (format!("/jobs/{}/log", JobId::new()), StatusCode::NOT_FOUND),
        ("/jobs/..%2f/log".into(), StatusCode::BAD_REQUEST),
    ] {
        assert_eq!(pages.get(&Client::default(), &path).await.status, status, "{path}");
    }
}
