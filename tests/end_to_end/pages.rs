//! The pages in a real browser, with a picture of each for people. Access rules are tested beside the pages; these tests
//! cover scripts and layout.

mod signed_in;

use gleaner_proto::v1::*;
use serde_json::json;

use crate::support::{
    api::Api,
    browser::Browser,
    lab,
    robot::{Robot, observe, start_sim},
    server::TestServer,
    shared::{Shared, shared},
};

const EPISODES: &str = "/tasks/pick_cube/episodes";

/// The outcomes of the table's rows, from the top.
const OUTCOMES: &str =
    "return [...document.querySelectorAll('#episodes tbody tr')].map((row) => row.dataset.outcome).join(' ')";

/// A server of its own, because labels change.
async fn own_lab() -> (TestServer, Api) {
    let (server, api, _) = lab::with_episodes(&["--workers", "0", "--web-listen", "127.0.0.1:0"]).await;
    (server, api)
}

#[tokio::test]
async fn ten_episodes_are_labelled_by_keyboard_and_the_last_is_undone() {
    let Some(browser) = Browser::start().await else { return };
    let (server, mut api) = own_lab().await;
    browser.open(&format!("{}{EPISODES}", server.pages())).await;
    let before = browser.run(OUTCOMES).await;
    // Repeated events of a held key label nothing.
    let held = "document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'u', repeat: true, bubbles: true }))";
    for _ in 0..3 {
        browser.run(held).await;
    }
    browser.keys("ufufufufuf").await;
    let labelled = format!(
        "{OUTCOMES}.startsWith('unknown failure unknown failure unknown failure unknown failure unknown failure')"
    );
    browser.until("ten labels", &labelled).await;
    browser.keep("episodes").await;
    browser.keys("z").await;
    let tenth = "return document.querySelectorAll('#episodes tbody tr')[9].dataset.outcome";
    let was = before.as_str().unwrap().split(' ').nth(9).unwrap().to_owned();
    browser.until("the tenth is as before", &format!("{tenth} === '{was}'")).await;

    let listed = api.episodes().await;
    let count = |outcome: Outcome| listed.iter().filter(|episode| episode.outcome() == outcome).count();
    assert_eq!(count(Outcome::Unknown), 5, "the page shows the stored labels");
    let id = browser.run("return document.querySelector('#episodes tbody tr').dataset.id").await;
    let id = id.as_str().unwrap().to_owned();
    let labels = api
        .episodes
        .list_labels(ListLabelsRequest { episode_id: id, ..Default::default() })
        .await
        .unwrap()
        .into_inner()
        .labels;
    assert_eq!(labels.last().map(|label| label.author.as_str()), Some("anyone"));
    browser.close().await;
}

async fn label_as_ada(api: &mut Api, id: &str, outcome: Outcome) {
    let label = LabelEpisodesRequest {
        episode_ids: vec![id.to_owned()],
        outcome: outcome.into(),
        author: "ada".into(),
        ..Default::default()
    };
    api.episodes.label_episodes(label).await.unwrap();
}

#[tokio::test]
async fn conflicting_label_is_shown_before_it_is_overwritten() {
    let Some(browser) = Browser::start().await else { return };
    let (server, mut api) = own_lab().await;
    browser.open(&format!("{}{EPISODES}", server.pages())).await;
    let id = browser.run("return document.querySelector('#episodes tbody tr').dataset.id").await;
    let id = id.as_str().unwrap().to_owned();
    label_as_ada(&mut api, &id, Outcome::Success).await;
    browser.keys("u").await;
    let text = browser.text("#message .note.bad p").await;
    assert!(text.contains("ada") && text.contains("success") && text.contains("No label was changed"), "{text}");
    browser.keep("conflict").await;
    let newest = async |api: &mut Api| {
        let request = ListLabelsRequest { episode_id: id.clone(), ..Default::default() };
        let labels = api.episodes.list_labels(request).await.unwrap().into_inner().labels;
        labels.last().map(|label| (label.author.clone(), label.outcome())).unwrap()
    };
    assert_eq!(newest(&mut api).await, ("ada".to_owned(), Outcome::Success));
    browser.keys("a").await;
    browser.until("the label is overwritten", &format!("{OUTCOMES}.startsWith('unknown')")).await;
    assert_eq!(newest(&mut api).await, ("anyone".to_owned(), Outcome::Unknown));

    // The same on the episode's own page.
    browser.open(&format!("{}/episodes/{id}", server.pages())).await;
    browser.find("#labels").await;
    label_as_ada(&mut api, &id, Outcome::Failure).await;
    browser.keys("s").await;
    let text = browser.text("#message .note.bad p").await;
    assert!(text.contains("ada") && text.contains("failure") && text.contains("No label was changed"), "{text}");
    assert_eq!(newest(&mut api).await, ("ada".to_owned(), Outcome::Failure));
    browser.close().await;
}

#[tokio::test]
async fn counts_follow_beta_and_steps_link_to_their_match() {
    let Some(browser) = Browser::start().await else { return };
    let shared = shared().await;
    let Shared { server, run, episodes, .. } = &*shared;
    browser.open(&format!("{}/runs/{run}?beta=0.9", server.pages())).await;
    let mut api = Api::connect(server).await;
    for beta in [0.25, 0.75] {
        let request =
            CountKeptRequest { score_run_id: run.clone(), selections: vec![lab::above(beta)], per_episode: false };
        let counted = api.scores.count_kept(request).await.unwrap().into_inner().counts.remove(0).total.unwrap();
        let kept = format!("{}", counted.segments);
        browser
            .run(&format!(
                "const beta = document.getElementById('beta'); beta.value = '{beta}'; \
                 beta.dispatchEvent(new Event('input', {{ bubbles: true }}))"
            ))
            .await;
        let shown = format!("return document.querySelector('#counts dd').textContent.trim().startsWith('{kept} ')");
        browser.until(&format!("{kept} segments are kept above {beta}"), &shown).await;
        browser.until("the address follows", &format!("return location.search.includes('beta={beta}')")).await;
    }
    // A shape changes the counts, the address and the dataset that the button makes.
    let shape = SelectionShape { context_before: 2, max_per_phase: 7, ..SelectionShape::default() };
    let selection = Selection { shape: Some(shape), ..lab::above(0.75) };
    let request = CountKeptRequest { score_run_id: run.clone(), selections: vec![selection], per_episode: false };
    let counted = api.scores.count_kept(request).await.unwrap().into_inner().counts.remove(0).total.unwrap();
    browser
        .run(
            "document.getElementById('shape').open = true; \
             for (const [name, value] of [['context_before', 2], ['max_per_phase', 7]]) { \
               const field = document.querySelector(`#shape [name=${name}]`); field.value = value; \
               field.dispatchEvent(new Event('input', { bubbles: true })); }",
        )
        .await;
    let kept = counted.segments;
    let shown = format!("return document.querySelector('#counts dd').textContent.trim().startsWith('{kept} ')");
    browser.until(&format!("{kept} segments are kept in the shape"), &shown).await;
    browser.until("the address follows", "return location.search.includes('context_before=2&max_per_phase=7')").await;
    browser
        .until("the dataset follows", "return document.querySelector('#make [name=max_per_phase]').value === '7'")
        .await;
    browser.keep("run").await;

    let failed = &episodes.last().unwrap().id;
    browser.open(&format!("{}/episodes/{failed}?run={run}&step=3", server.pages())).await;
    browser
        .until("frames are there", "return [...document.images].every((image) => image.complete && image.naturalWidth)")
        .await;
    browser.keep("episode").await;
    browser.find("#match-link").await.click().await.unwrap();
    let there = browser
        .until("the expert", &format!("return !location.pathname.includes('{failed}') && location.pathname"))
        .await;
    let expert = there.as_str().unwrap().trim_start_matches("/episodes/").to_owned();
    let of = episodes.iter().find(|episode| episode.id == expert).expect("an episode of the lab");
    assert_eq!(of.outcome(), Outcome::Success);
    browser.close().await;
}

#[tokio::test]
async fn page_of_a_job_follows_it_to_its_end() {
    let Some(browser) = Browser::start().await else { return };
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let job = api.submit(lab::TASK, lab::pretrain(4)).await.unwrap();
    browser.open(&format!("{}/jobs/{}", shared.server.pages(), job.id)).await;
    browser.until("it has ended", "return document.querySelector('#course')?.dataset.state === 'succeeded'").await;
    assert!(!browser.all("svg.plot path.line").await.is_empty(), "the losses are drawn");
    let script = "const text = document.querySelector('#log').textContent; \
                const at = ['attempt 1 of', 'pretraining', 'handing the result over', 'is succeeded'].map((part) => text.indexOf(part)); \
                return at.every((place, i) => place > (at[i - 1] ?? -1))";
    browser.until("the log is there, in its order", script).await;
    browser.keep("job").await;
    browser.open(&format!("{}/jobs", shared.server.pages())).await;
    assert!(browser.text("main").await.contains("pretrain"));
    browser.keep("jobs").await;
    browser.close().await;
}

#[tokio::test]
async fn deployment_is_rolled_back_on_its_page() {
    let Some(browser) = Browser::start().await else { return };
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let name = "pick_cube@pages";
    for score_run_id in [String::new(), shared.run.clone()] {
        let request =
            DeployRequest { name: name.into(), policy_id: shared.policy.clone(), score_run_id, ..Default::default() };
        api.policies.deploy(request).await.unwrap();
    }
    browser.open(&format!("{}/deployments", shared.server.pages())).await;
    let scored = async || {
        let request = ListDeploymentsRequest::default();
        let all = Api::connect(&shared.server)
            .await
            .policies
            .list_deployments(request)
            .await
            .unwrap()
            .into_inner()
            .deployments;
        all.into_iter().find(|deployment| deployment.name == name).unwrap().score_run_id
    };
    assert_eq!(scored().await, shared.run);
    let link = format!("a[href='/deployments/{}']", "pick_cube%40pages");
    browser.find(&link).await.click().await.unwrap();
    browser.find("form button.danger").await.click().await.unwrap();
    browser.until("it is back", "return document.body.textContent.includes('deploy with a score run')").await;
    assert_eq!(scored().await, "");
    browser.keep("deployment").await;
    browser.close().await;
}

#[tokio::test]
async fn page_of_a_deployment_shows_live_images() {
    let Some(browser) = Browser::start().await else { return };
    let shared = shared().await;
    let mut api = Api::connect(&shared.server).await;
    let name = "pick_cube@watched";
    let deploy = DeployRequest {
        name: name.into(),
        policy_id: shared.policy.clone(),
        score_run_id: shared.run.clone(),
        ..Default::default()
    };
    api.policies.deploy(deploy).await.unwrap();
    browser.open(&format!("{}/deployments/{name}", shared.server.pages())).await;
    assert!(browser.text("#live").await.contains("No open sessions"));
    let mut robot = Robot::open(&mut api, name).await.unwrap();
    for _ in 0..3 {
        robot.act(observe(&start_sim())).await.unwrap();
    }
    let seen = "return document.querySelector('#live img')?.naturalWidth === 16 \
                && document.querySelector('#live').textContent.includes('Answers3')";
    browser.until("its pictures, and three answers", seen).await;
    browser.keep("live").await;
    drop(robot);
    browser
        .until("it is gone", "return document.querySelector('#live').textContent.includes('No open sessions')")
        .await;
    browser.close().await;
}

/// No page is wider than the window, and the console has no warning, such as about the security policy of a page.
#[tokio::test]
async fn every_page_fits_a_width_of_390_pixels() {
    let Some(browser) = Browser::start().await else { return };
    let shared = shared().await;
    let Shared { server, run, episodes, policy, snapshot, encoder, .. } = &*shared;
    let pages = [
        ("overview", "/".to_owned()),
        ("episodes", EPISODES.to_owned()),
        ("episode", format!("/episodes/{}?run={run}", episodes.last().unwrap().id)),
        ("runs", "/tasks/pick_cube/runs".to_owned()),
        ("run", format!("/runs/{run}")),
        ("snapshot", format!("/snapshots/{snapshot}")),
        ("encoder", format!("/encoders/{encoder}")),
        ("policy", format!("/policies/{policy}")),
        ("jobs", "/jobs".to_owned()),
        ("deployments", "/deployments".to_owned()),
        ("kinds", "/kinds".to_owned()),
    ];
    // Chromium has no window narrower than 500 pixels, and the security policy forbids frames, so a telephone is emulated.
    browser.narrow(390).await;
    for (name, path) in pages {
        browser.open(&format!("{}{path}", server.pages())).await;
        browser.find("main h1").await;
        let width = browser.run("return document.documentElement.scrollWidth").await;
        assert!(width.as_u64() <= json!(390).as_u64(), "{name} is {width} wide");
        browser.keep(&format!("{name}-390")).await;
    }
    assert_eq!(browser.console().await, Vec::<String>::new());
    browser.close().await;
}
