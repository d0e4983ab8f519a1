//! The first page: every task with its episodes, the latest jobs, what is left of the disk.

use axum::response::IntoResponse as _;
use maud::html;

use super::{
    refusal::Answer,
    shell::{self, Head, Tab},
    visit::Visit,
};

pub(super) async fn show(visit: Visit) -> Answer {
    let head = Head { title: "Overview", tab: Tab::Overview, task: None, script: None };
    Ok(shell::page(&visit, &head, &html! { h1 { "Overview" } }).into_response())
}
