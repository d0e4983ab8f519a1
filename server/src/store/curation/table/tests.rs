//! The table of episodes compared with stored rows, and its query plans.

use super::*;
use crate::{
    domain::{
        episode::{Episode, NewLabel, Outcome, Upload},
        task::Task,
        time::Millis,
    },
    store::testing,
};

/// An episode with its own name and warnings, visible since this number of milliseconds after 1970.
async fn episode(store: &Store, task: &Task, name: &str, (warnings, at): (u64, i64)) -> Episode {
    let upload = Upload { file_name: name.into(), cohort: "ada".into(), ..testing::upload(task, name.as_bytes()) };
    let mut inspected = testing::inspected(task, &upload);
    inspected.episode.warnings = warnings;
    inspected.episode.created_at = Millis(at);
    store.insert_upload(&upload, None).await.unwrap();
    store.finish_upload(&upload, &inspected).await.unwrap()
}

#[tokio::test]
async fn a_row_has_its_last_author_and_version() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let first = episode(&store, &task, "first.mcap", (0, 1)).await;
    let second = episode(&store, &task, "second.mcap", (0, 2)).await;
    let label = NewLabel { outcome: Some(Outcome::Failure), cohort: None, author: "bob".into(), reason: String::new() };
    store.label_episodes(std::slice::from_ref(&first.id), &label).await.unwrap();
    let rows = store.episode_table(&task.id, &TableFilter::default()).await.unwrap();
    assert_eq!(rows.iter().map(|row| &row.episode.id).collect::<Vec<_>>(), [&first.id, &second.id]);
    assert_eq!((rows[0].labelled_by.as_str(), rows[1].labelled_by.as_str()), ("bob", "tests"));
    assert_eq!((rows[0].episode.outcome, rows[1].episode.outcome), (Outcome::Failure, Outcome::Success));
    assert!(rows[0].label_version > rows[1].label_version && rows[1].label_version > 0);
    let newest = store.labels(&first.id).await.unwrap().pop().unwrap();
    assert_eq!(rows[0].labelled_at, newest.created_at);
}

#[tokio::test]
async fn every_filter_leaves_out_other_episodes() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    let other =
        store.insert_task(&gleaner_recording::TaskSpec { name: "other".into(), ..testing::spec() }).await.unwrap();
    episode(&store, &other, "elsewhere.mcap", (0, 1)).await;
    let mut ids = Vec::new();
    for (name, warnings, at) in [("Cup_100%.mcap", 0, 10), ("cup_1000.mcap", 2, 20), ("plate.mcap", 1, 30)] {
        ids.push(episode(&store, &task, name, (warnings, at)).await.id);
    }
    let gone = episode(&store, &task, "gone.mcap", (0, 40)).await;
    store.delete_episodes(&[gone.id], false).await.unwrap();
    let label = NewLabel {
        outcome: Some(Outcome::Failure),
        cohort: Some("bob".into()),
        author: "bob".into(),
        reason: String::new(),
    };
    store.label_episodes(&ids[2..], &label).await.unwrap();

    let all = TableFilter::default;
    let text = |text: &str| TableFilter { text: Some(text.into()), ..all() };
    for (filter, expected) in [
        (all(), vec![0, 1, 2]),
        (TableFilter { outcome: Some(Outcome::Success), ..all() }, vec![0, 1]),
        (TableFilter { outcome: Some(Outcome::Unknown), ..all() }, vec![]),
        (TableFilter { cohort: Some("bob".into()), ..all() }, vec![2]),
        (TableFilter { from: Some(Millis(20)), ..all() }, vec![1, 2]),
        (TableFilter { before: Some(Millis(20)), ..all() }, vec![0]),
        (TableFilter { warnings: Some(true), ..all() }, vec![1, 2]),
        (TableFilter { warnings: Some(false), ..all() }, vec![0]),
        (text("CUP"), vec![0, 1]),
        (text("100%"), vec![0]),
        (text("cup_1000' or 1"), vec![]),
        (text(&ids[1].as_str().to_lowercase()), vec![1]),
        (TableFilter { warnings: Some(true), cohort: Some("ada".into()), ..text("mcap") }, vec![1]),
    ] {
        let rows = store.episode_table(&task.id, &filter).await.unwrap();
        let found: Vec<_> = rows.iter().map(|row| ids.iter().position(|id| *id == row.episode.id).unwrap()).collect();
        assert_eq!(found, expected, "{filter:?}");
        assert_eq!(store.count_episodes(&task.id, &filter).await.unwrap(), expected.len() as u64, "{filter:?}");
        let mut matching = store.matching_episodes(&task.id, &filter).await.unwrap();
        matching.sort();
        assert_eq!(matching, rows.iter().map(|row| row.episode.id.clone()).collect::<Vec<_>>(), "{filter:?}");
    }
}

#[tokio::test]
async fn rows_are_read_in_the_order_of_their_ids_in_a_list() {
    let (_dir, store) = testing::sqlite().await;
    let task = testing::task(&store).await;
    let mut ids = Vec::new();
    for name in ["a.mcap", "b.mcap", "c.mcap"] {
        ids.push(episode(&store, &task, name, (0, 1)).await.id);
    }
    let listed = [ids[2].clone(), EpisodeId::new(), ids[0].clone()];
    let rows = store.episode_rows(&listed).await.unwrap();
    let names: Vec<_> = rows.iter().map(|row| row.episode.file_name.as_str()).collect();
    assert_eq!(names, ["c.mcap", "a.mcap"], "the unknown one is left out");
    assert!(store.episode_rows(&[]).await.unwrap().is_empty());
}

/// The database sorts and cuts as the list of all rows is sorted and cut.
#[tokio::test]
async fn a_page_is_a_part_of_the_sorted_table() {
    let (_dir, store) = testing::store().await;
    let task = testing::task(&store).await;
    for (name, warnings, at) in [("a.mcap", 1, 10), ("b.mcap", 0, 20), ("c.mcap", 1, 30), ("d.mcap", 2, 40)] {
        episode(&store, &task, name, (warnings, at)).await;
    }
    let all = TableFilter::default();
    for key in SortKey::ALL.into_iter().filter(|key| *key != SortKey::MeanQ) {
        for descending in [false, true] {
            let mut rows = store.episode_table(&task.id, &all).await.unwrap();
            crate::domain::curation::sort(&mut rows, key, descending, |_| None);
            let names = |rows: &[TableRow]| rows.iter().map(|row| row.episode.file_name.clone()).collect::<Vec<_>>();
            let page = store.episode_page(&task.id, &all, (key, descending), (1, 2)).await.unwrap();
            assert_eq!(names(&page), names(&rows[1..3]), "{key:?} {descending}");
        }
    }
    let few = TableFilter { warnings: Some(true), ..all };
    let page = store.episode_page(&task.id, &few, (SortKey::Date, true), (0, 9)).await.unwrap();
    assert_eq!(page.iter().map(|row| row.episode.warnings).collect::<Vec<_>>(), [2, 1, 1]);
    assert!(store.episode_page(&task.id, &few, (SortKey::Date, true), (3, 9)).await.unwrap().is_empty());
}

#[tokio::test]
async fn no_table_is_scanned_or_sorted() {
    let (_dir, store) = testing::sqlite().await;
    let task = testing::task(&store).await;
    let filter = TableFilter { text: Some("cup".into()), outcome: Some(Outcome::Success), ..TableFilter::default() };
    let plan = testing::plan(&store, query(&task.id, &filter).text()).await;
    assert!(plan.iter().any(|step| step.contains("episodes_by_task")), "{plan:?}");
    assert!(!plan.iter().any(|step| step.contains("SCAN") || step.contains("TEMP B-TREE")), "{plan:?}");
}

#[tokio::test]
async fn ids_and_counts_are_read_without_rows() {
    let (_dir, store) = testing::sqlite().await;
    let task = testing::task(&store).await;
    let some = TableFilter { outcome: Some(Outcome::Success), cohort: Some("ada".into()), ..TableFilter::default() };
    for filter in
        [TableFilter { from: Some(Millis(1)), warnings: Some(true), ..some.clone() }, some, TableFilter::default()]
    {
        let plan = testing::plan(&store, ids(&task.id, &filter).text()).await;
        assert!(plan.iter().all(|step| step.contains("COVERING INDEX")), "{filter:?}: {plan:?}");
    }
}
