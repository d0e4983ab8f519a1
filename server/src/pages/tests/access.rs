//! The middleware: access to every page, requests from other sites, and headers of every response.

use bytes::Bytes;
use gleaner_web::Page;
use http::{
    Method, StatusCode,
    header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, LOCATION, SET_COOKIE, X_CONTENT_TYPE_OPTIONS},
};
use http_body::Frame;
use http_body_util::StreamBody;

use crate::{
    domain::{access::Role, time::Millis},
    pages::testing::{Client, FORM, JSON, Pages},
};

/// A page's address with a value in every brace.
fn address(page: Page) -> String {
    page.path().replace("{id}", "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV").replace(['{', '}'], "")
}

async fn status(pages: &Pages, client: &Client, page: Page) -> StatusCode {
    let request = client.request(page.method(), &address(page), String::new());
    pages.send(request).await.status
}

#[tokio::test]
async fn every_page_is_permitted_as_its_row_states() {
    let pages = Pages::open(true).await;
    let mut known = Vec::new();
    for role in Role::ALL {
        known.push((role, Client::with(&pages.token(role).await)));
    }
    let expired = Client::with(&pages.token_until(Role::Admin, Some(Millis(1))).await);
    let revoked = Client::with(&pages.revoked().await);
    for &page in Page::ALL {
        let refused = |status: StatusCode| matches!(status, StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN);
        for stranger in [Client::default(), Client::with("no token of ours"), expired.clone(), revoked.clone()] {
            let answered = status(&pages, &stranger, page).await;
            let sent_to_sign_in = answered == StatusCode::SEE_OTHER && page.method() == Method::GET;
            let let_in = !refused(answered) && !sent_to_sign_in;
            // Signing in and out is public, but requires a request from our own page.
            if page.method() == Method::GET || !page.is_open() {
                assert_eq!(let_in, page.is_open(), "{page:?} {answered}");
            }
        }
        for (role, client) in &known {
            let least = match (page.changes(), pages_of_contributors(page)) {
                (true, true) => Role::Contributor,
                (true, false) => Role::Trainer,
                (false, _) => Role::Viewer,
            };
            let may = page.is_open() || role.reaches(least);
            let answered = status(&pages, client, page).await;
            assert_eq!(may, !refused(answered), "{page:?} as {role:?}: {answered}");
            assert_ne!(answered, StatusCode::INTERNAL_SERVER_ERROR, "{page:?} as {role:?}");
        }
    }
}

/// Changes for contributors.
fn pages_of_contributors(page: Page) -> bool {
    format!("{page:?}").starts_with("Label")
}

#[tokio::test]
async fn changes_are_posted_and_other_requests_are_not() {
    for &page in Page::ALL {
        let signing = matches!(page, Page::SigningIn | Page::SigningOut);
        assert_eq!(page.method() == Method::POST, page.changes() || signing, "{page:?}");
    }
}

#[tokio::test]
async fn every_recording_ends_with_the_token_of_its_reader() {
    for &page in Page::ALL {
        assert_eq!(page.is_download(), page.path().ends_with(".mcap"), "{page:?}");
    }
}

#[tokio::test]
async fn another_site_cannot_make_a_browser_change_data() {
    let pages = Pages::open(false).await;
    let visitor = pages.visitor().await;
    let path = address(Page::RollBack);
    for (cookie, proof) in
        [(None, None), (visitor.cookie.clone(), None), (visitor.cookie.clone(), Some("0".repeat(32)))]
    {
        let client = Client { cookie, proof, token: None };
        for (kind, body) in [(FORM, "proof=1"), (JSON, "{}")] {
            let reply = pages.post(&client, &path, (kind, body)).await;
            assert_eq!(reply.status, StatusCode::FORBIDDEN);
            assert!(reply.text().contains("reload the page"));
        }
    }
    // With the proof of its own page it reaches the deployment, which does not exist.
    assert_eq!(pages.post(&visitor, &path, (FORM, "")).await.status, StatusCode::NOT_FOUND);
    let form = format!("proof={}", visitor.proof.clone().unwrap());
    let by_form = Client { proof: None, ..visitor };
    assert_eq!(pages.post(&by_form, &path, (FORM, &form)).await.status, StatusCode::NOT_FOUND);
    let log = pages.services.store.audit(Millis(0), 10).await.unwrap();
    assert!(log.iter().any(|entry| entry.rpc == "pages/RollBack" && entry.outcome == "Not Found"), "{log:?}");
}

#[tokio::test]
async fn a_foreign_host_name_reads_no_page() {
    let pages = Pages::open(false).await;
    for (host, status) in [
        ("127.0.0.1:7401", StatusCode::OK),
        ("localhost:7401", StatusCode::OK),
        ("localhost", StatusCode::OK),
        ("[::1]:7401", StatusCode::OK),
        ("evil.example:7401", StatusCode::FORBIDDEN),
        ("localhost.evil.example", StatusCode::FORBIDDEN),
        ("", StatusCode::FORBIDDEN),
    ] {
        let mut request = Client::default().request(Method::GET, "/", String::new());
        request.headers_mut().insert(HOST, host.parse().unwrap());
        assert_eq!(pages.send(request).await.status, status, "{host}");
    }
}

#[tokio::test]
async fn a_browser_signs_in_and_out() {
    let pages = Pages::open(true).await;
    let token = pages.token(Role::Viewer).await;
    let away = pages.get(&Client::default(), "/deployments?x=1").await;
    assert_eq!(away.status, StatusCode::SEE_OTHER);
    let form = away.headers[LOCATION].to_str().unwrap().to_owned();
    assert_eq!(form, "/sign-in?next=%2Fdeployments%3Fx%3D1");
    let come = pages.get(&Client::default(), &form).await;
    let text = come.text();
    let proof = text.split("name=\"proof\" value=\"").nth(1).unwrap().split('"').next().unwrap().to_owned();
    assert!(text.contains("value=\"/deployments?x=1\""), "{text}");
    let browser = Client { cookie: come.cookie(), proof: None, token: None };

    let robot = pages.token(Role::Robot).await.replace(' ', "+");
    for (token, status) in [("nonsense", StatusCode::UNAUTHORIZED), (robot.as_str(), StatusCode::FORBIDDEN)] {
        let body = format!("token={token}&next=%2Fdeployments%3Fx%3D1&proof={proof}");
        let wrong = pages.post(&browser, "/sign-in", (FORM, &body)).await;
        assert_eq!((wrong.status, wrong.headers.contains_key(SET_COOKIE)), (status, false));
        let text = wrong.text();
        assert!(
            text.contains("role=\"alert\"") && text.contains("id=\"token\"") && !text.contains("nonsense"),
            "{text}"
        );
        assert!(text.contains("value=\"/deployments?x=1\"") && text.contains(&format!("value=\"{proof}\"")), "{text}");
    }
    let foreign = format!("token=nonsense&next=%2F%2Fevil.example&proof={proof}");
    let text = pages.post(&browser, "/sign-in", (FORM, &foreign)).await.text();
    assert!(text.contains("name=\"next\" value=\"/\"") && !text.contains("evil"), "{text}");
    let program = pages.post(&browser, "/sign-in?format=json", (FORM, &foreign)).await;
    assert!(
        program.status == StatusCode::UNAUTHORIZED && program.text().starts_with("{\"error\":"),
        "{}",
        program.text()
    );
    let body = format!("token={}&next=%2Fdeployments%3Fx%3D1&proof={proof}", token.replace(' ', "+"));
    let right = pages.post(&browser, "/sign-in", (FORM, &body)).await;
    assert_eq!(right.status, StatusCode::SEE_OTHER);
    assert_eq!(right.headers[LOCATION], "/deployments?x=1");
    let signed_in = Client { cookie: right.cookie(), proof: None, token: None };
    assert!(signed_in.cookie != browser.cookie, "a planted name is worthless");
    assert!(!right.cookie().unwrap().contains("token"));

    let overview = pages.get(&signed_in, "/").await;
    assert_eq!(overview.status, StatusCode::OK);
    assert!(overview.text().contains("viewer") && !overview.text().contains(&token));
    assert_eq!(pages.get(&browser, "/").await.status, StatusCode::SEE_OTHER, "the cookie from before");
    let out = Client { proof: overview.proof(), ..signed_in.clone() };
    assert_eq!(pages.post(&out, "/sign-out", (FORM, "")).await.status, StatusCode::SEE_OTHER);
    assert_eq!(pages.get(&signed_in, "/").await.status, StatusCode::SEE_OTHER);
}

#[tokio::test]
async fn an_ended_token_is_treated_like_a_missing_token() {
    let pages = Pages::open(false).await;
    let browser = pages.visitor().await;
    let soon = Millis::now().after(std::time::Duration::from_secs(3));
    let body = format!("token={}", pages.token_until(Role::Viewer, Some(soon)).await.replace(' ', "+"));
    let signed_in = pages.post(&browser, "/sign-in", (FORM, &body)).await;
    let viewer = Client { cookie: signed_in.cookie(), ..Client::default() };
    assert!(pages.get(&viewer, "/").await.text().contains("Sign out"));
    while Millis::now() <= soon {
        tokio::task::yield_now().await;
    }
    let after = pages.get(&viewer, "/").await;
    assert_eq!(after.status, StatusCode::OK, "no token is required here");
    assert!(!after.text().contains("Sign out"));
    let robot = format!("token={}", pages.token(Role::Robot).await.replace(' ', "+"));
    assert_eq!(pages.post(&browser, "/sign-in", (FORM, &robot)).await.status, StatusCode::FORBIDDEN);
}

#[tokio::test]
async fn bodies_have_a_size_limit() {
    let pages = Pages::open(false).await;
    let visitor = pages.visitor().await;
    let rollback = address(Page::RollBack);
    for (path, most) in [("/sign-in", 64 << 10), (rollback.as_str(), 1 << 20)] {
        let fits = pages.post(&visitor, path, (JSON, &" ".repeat(most))).await;
        assert!(!fits.text().contains("is incomplete or larger"), "{path}: {}", fits.text());
        for client in [&visitor, &Client::with("no token of ours")] {
            let reply = pages.post(client, path, (JSON, &" ".repeat(most + 1))).await;
            assert!(reply.status.is_client_error(), "{path}");
            if client.token.is_none() || path == "/sign-in" {
                assert!(reply.text().contains(&format!("larger than {most} bytes")), "{path}: {}", reply.text());
            }
        }
    }
}

#[tokio::test]
async fn a_flood_of_refusals_does_not_fill_the_audit_log() {
    let pages = Pages::open(true).await;
    let viewer = Client::with(&pages.token(Role::Viewer).await);
    for _ in 0..50 {
        assert_eq!(status(&pages, &viewer, Page::RollBack).await, StatusCode::FORBIDDEN);
    }
    let written = pages.services.store.audit(Millis(0), 100).await.unwrap().len();
    assert!((10..15).contains(&written), "{written}");
}

#[tokio::test]
async fn every_response_has_its_security_headers() {
    let pages = Pages::open(false).await;
    let visitor = pages.visitor().await;
    for path in ["/", "/deployments", "/healthz", "/nothing/here", "/deployments/none", "/assets/../../etc/passwd"] {
        let reply = pages.get(&visitor, path).await;
        assert!(reply.headers[CONTENT_SECURITY_POLICY].to_str().unwrap().contains("default-src 'none'"), "{path}");
        assert_eq!(reply.headers[X_CONTENT_TYPE_OPTIONS], "nosniff", "{path}");
        assert_eq!(reply.headers[CACHE_CONTROL], "no-store", "{path}");
        assert!(!reply.headers.contains_key(SET_COOKIE), "{path}: it has one");
        let text = reply.text();
        assert!(!text.contains("<style") && !text.contains(" style=") && !text.contains("onclick"), "{path}");
    }
    assert_eq!(pages.get(&visitor, "/nothing/here").await.status, StatusCode::NOT_FOUND);
    assert_eq!(pages.send(visitor.request(Method::DELETE, "/", String::new())).await.status, StatusCode::NOT_FOUND);
}

#[tokio::test]
async fn programs_get_data_and_people_get_pages() {
    let pages = Pages::open(false).await;
    let visitor = pages.visitor().await;
    let missing = pages.get(&visitor, "/deployments/none?format=json").await;
    let message: serde_json::Value = serde_json::from_slice(&missing.body).unwrap();
    assert_eq!((missing.status, &message["error"]), (StatusCode::NOT_FOUND, &serde_json::json!("no deployment none")));
    assert!(pages.get(&visitor, "/deployments/none").await.text().contains("no deployment none"));
    assert_eq!(pages.get(&visitor, "/?format=json").await.text(), "[]");
    let csv = pages.get(&visitor, "/?format=csv").await.text();
    assert_eq!(csv, "task,task_id,success,failure,unknown,hours,bytes,cohorts\n");
    let wrong = pages.get(&visitor, "/?format=xml").await;
    assert_eq!(wrong.status, StatusCode::BAD_REQUEST);
}

#[tokio::test]
async fn an_incomplete_form_times_out() {
    let pages = Pages::open(false).await;
    let visitor = pages.visitor().await;
    // This runtime is otherwise idle, so that paused time advances at once.
    tokio::time::pause();
    let begun = tokio::time::Instant::now();
    let endless = StreamBody::new(futures::stream::pending::<std::io::Result<Frame<Bytes>>>());
    let reply = pages.send(visitor.request(Method::POST, "/sign-in", endless)).await;
    assert_eq!(reply.status, StatusCode::GATEWAY_TIMEOUT);
    assert!(reply.text().contains("timed out"), "{}", reply.text());
    assert!((29..60).contains(&begun.elapsed().as_secs()), "{:?}", begun.elapsed());
}
