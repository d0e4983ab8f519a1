//! The audit entry of every page that changes something: each is requested once. An audited page fails here without a row,
//! and without subjects, which only the page's own change adds.

use std::collections::HashSet;

use gleaner_web::Page;
use http::StatusCode;

use crate::{
    domain::{access::Role, time::Millis},
    pages::testing::{Client, JSON, Pages},
};

const ID: &str = "01ARZ3NDEKTSV4RRFFQ69G5FAV";

#[tokio::test]
async fn every_page_that_changes_something_is_in_the_audit_log_with_its_subjects() {
    let pages = Pages::open(true).await;
    let (trainer, viewer) =
        (Client::with(&pages.token(Role::Trainer).await), Client::with(&pages.token(Role::Viewer).await));
    let label = format!(r#"{{"episodes": [{{"id": "ep_{ID}", "version": 1}}], "outcome": "success"}}"#);
    let rows = [
        (
            Page::LabelEpisodes,
            "/tasks/reach/labels".to_owned(),
            label.as_str(),
            vec!["task=reach".to_owned(), format!("episode_id=ep_{ID}")],
        ),
        (Page::RollBack, "/deployments/arm/roll-back".to_owned(), "{}", vec!["name=arm".to_owned()]),
        (
            Page::MakeDataset,
            format!("/runs/run_{ID}/datasets"),
            r#"{"beta": 0.5}"#,
            vec![format!("score_run_id=run_{ID}")],
        ),
        (Page::CancelJob, format!("/jobs/job_{ID}/cancel"), "{}", vec![format!("job_id=job_{ID}")]),
        (Page::RetryJob, format!("/jobs/job_{ID}/retry"), "{}", vec![format!("job_id=job_{ID}")]),
    ];
    let entries = async || pages.services.store.audit(Millis(0), 1000).await.unwrap();
    let (mut seen, mut requests) = (HashSet::new(), 0);
    for (page, path, body, subjects) in rows {
        assert!(!subjects.is_empty(), "{page:?}");
        // A path that is not UTF-8 is rejected before the page receives the request.
        let malformed = page.path().replace("{task}", "%FF").replace("{name}", "%FF").replace("{id}", "%FF");
        for (client, path, role, status, outcome) in [
            (&trainer, &path, Role::Trainer, StatusCode::NOT_FOUND, "Not Found"),
            (&trainer, &malformed, Role::Trainer, StatusCode::BAD_REQUEST, "Bad Request"),
            (&viewer, &path, Role::Viewer, StatusCode::FORBIDDEN, "Forbidden"),
        ] {
            assert_eq!(pages.post(client, path, (JSON, body)).await.status, status, "{page:?}");
            requests += 1;
            let mut log = entries().await;
            assert_eq!(log.len(), requests, "{page:?} writes one entry");
            let entry = log.pop().unwrap();
            assert_eq!((entry.rpc, entry.outcome.as_str()), (format!("pages/{page:?}"), outcome));
            assert_eq!((entry.caller.as_str(), entry.peer.as_str()), (role.as_str(), "127.0.0.1:4000"));
            assert!(entry.token_id.is_some());
            let received = status == StatusCode::NOT_FOUND;
            assert_eq!(entry.subjects, if received { subjects.clone() } else { Vec::new() }, "{page:?}");
        }
        seen.insert(page);
    }
    let audited: HashSet<Page> = Page::ALL.iter().copied().filter(|&page| page.changes()).collect();
    assert_eq!(seen, audited, "each audited page has a row here, and no other page");
}
