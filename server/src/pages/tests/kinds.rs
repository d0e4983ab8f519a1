//! The kinds as requested by browsers and programs.

use http::StatusCode;
use serde_json::{Value, json};

use crate::{
    domain::access::Role,
    pages::testing::{Client, Pages},
};

#[tokio::test]
async fn kinds_are_a_page_and_a_table_for_viewers() {
    let pages = Pages::open(true).await;
    let viewer = Client::with(&pages.token(Role::Viewer).await);
    let page = pages.get(&viewer, "/kinds").await;
    assert_eq!(page.status, StatusCode::OK);
    let text = page.text();
    assert!(text.contains("id=\"policy-finetune\"") && text.contains("href=\"#scorer-ssdf\""), "{text}");
    assert!(text.contains("href=\"/kinds\" aria-current=\"page\"") && !text.contains("style="), "{text}");
    let rows: Vec<Value> = serde_json::from_slice(&pages.get(&viewer, "/kinds?format=json").await.body).unwrap();
    let found = |kind: &str, setting: Value| rows.iter().find(|row| row["kind"] == kind && row["setting"] == setting);
    assert_eq!(found("finetune", json!("history_dropout")).unwrap()["default"], json!(0.9));
    assert!(found("mtp", Value::Null).is_some() && found("pretrain", json!("steps")).is_some());
    let csv = pages.get(&viewer, "/kinds?format=csv").await.text();
    assert!(csv.starts_with("family,kind,setting,values,default,about\n") && csv.contains("\njob,pretrain,"), "{csv}");
}
