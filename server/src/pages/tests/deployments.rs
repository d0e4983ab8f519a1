//! The page of a deployment, as requested by browsers.

use http::StatusCode;

use crate::{
    domain::{episode::Outcome, policy::Assignment},
    pages::testing::{FORM, Pages},
    store::testing::{self, results},
};

#[tokio::test]
async fn a_second_click_does_not_roll_back_twice() {
    let pages = Pages::open(false).await;
    let store = &pages.services.store;
    let task = testing::task(store).await;
    testing::episode(store, &task, Outcome::Success, "").await;
    testing::episode(store, &task, Outcome::Failure, "").await;
    let encoder = results::encoder(store, &task).await;
    for _ in 0..3 {
        let policy = results::policy(store, &task, &encoder, blake3::hash(b"policy").into()).await;
        store.deploy("arm", &task.id, &Assignment::of(&policy.id)).await.unwrap();
    }
    let visitor = pages.visitor().await;
    let shown = pages.get(&visitor, "/deployments/arm").await.text();
    assert!(shown.contains("name=\"changes\" value=\"3\""), "{shown}");
    let proof = visitor.proof.clone().unwrap();
    let click =
        async || pages.post(&visitor, "/deployments/arm/roll-back", (FORM, &format!("proof={proof}&changes=3"))).await;
    // The form of the page that is shown passes the check; this policy has no model to load.
    let first = click().await;
    assert!(!first.text().contains("has changed"), "{}", first.text());
    store.roll_back("arm").await.unwrap();
    let before = store.deployment("arm").await.unwrap().history.len();
    let second = click().await;
    assert_eq!(second.status, StatusCode::CONFLICT, "{}", second.text());
    assert!(second.text().contains("has changed since its page was shown"), "{}", second.text());
    assert_eq!(store.deployment("arm").await.unwrap().history.len(), before);
    let odd = pages.post(&visitor, "/deployments/arm/roll-back", (FORM, &format!("proof={proof}&changes=x"))).await;
    assert_eq!(odd.status, StatusCode::BAD_REQUEST);
}
