//! The overview with many tasks.

use gleaner_recording::TaskSpec;

use crate::{
    domain::episode::Outcome,
    pages::testing::{Client, Pages},
    store::testing,
};

/// Tasks on one page.
const PER_PAGE: usize = 48;

/// Pages over this many tasks, `fold_0000` and on; each tenth is called `pour_…`.
async fn with_tasks(count: usize) -> Pages {
    let pages = Pages::open(false).await;
    for number in 0..count {
        let kind = if number % 10 == 0 { "pour" } else { "fold" };
        let spec = TaskSpec { name: format!("{kind}_{number:04}"), ..testing::spec() };
        pages.services.store.insert_task(&spec).await.unwrap();
    }
    pages
}

async fn text(pages: &Pages, path: &str) -> String {
    pages.get(&Client::default(), path).await.text()
}

#[tokio::test]
async fn many_tasks_are_shown_in_pages_newest_first() {
    let count = 2 * PER_PAGE + 4;
    let pages = with_tasks(count).await;
    let cards = |page: &str| page.matches("section class=\"card\"").count();
    let first = text(&pages, "/").await;
    assert_eq!(cards(&first), PER_PAGE);
    assert!(first.contains(&format!("fold_{:04}", count - 1)) && !first.contains("pour_0000"));
    assert!(first.contains("Page 1 of 3") && first.contains("/?page=2"));
    let last = text(&pages, "/?page=3").await;
    assert_eq!(cards(&last), 4);
    assert!(last.contains("pour_0000") && last.contains("rel=\"prev\""));
    assert_eq!(cards(&text(&pages, "/?page=99").await), 4, "a page beyond the end is the last");
    let wrong = pages.get(&Client::default(), "/?page=x").await;
    assert_eq!(wrong.status.as_u16(), 400);

    let all = text(&pages, "/?format=json").await;
    assert_eq!(all.matches("\"task\":").count(), count, "programs get every task");
}

#[tokio::test]
async fn tasks_are_found_by_a_part_of_their_name() {
    let pages = with_tasks(PER_PAGE + 1).await;
    let found = text(&pages, "/?text=POUR").await;
    assert!(found.contains("pour_0040") && !found.contains("fold_0001") && found.contains("value=\"POUR\""), "{found}");
    assert!(!found.contains("Page 1 of"));
    assert_eq!(text(&pages, "/?text=pour&format=json").await.matches("\"task\":").count(), 5);
    assert!(text(&pages, "/?text=none%20such").await.contains("No tasks have this text"));
}

#[tokio::test]
async fn figures_sum_up_every_task_and_not_the_page() {
    let pages = with_tasks(PER_PAGE + 1).await;
    let oldest = pages.services.store.task("pour_0000").await.unwrap();
    testing::episode(&pages.services.store, &oldest, Outcome::Success, "").await;
    let first = text(&pages, "/").await;
    assert!(!first.contains("pour_0000"));
    assert!(first.contains("<dt>Tasks</dt><dd>49</dd>") && first.contains("<dt>Episodes</dt><dd>1</dd>"), "{first}");
}

#[tokio::test]
async fn one_page_of_tasks_has_no_search_and_no_links() {
    let few = text(&with_tasks(2).await, "/").await;
    assert!(few.contains("fold_0001") && !few.contains("type=\"search\"") && !few.contains("Page 1"));
    let none = text(&with_tasks(0).await, "/").await;
    assert!(none.contains("gleaner task create"));
}
