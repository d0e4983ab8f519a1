//! Pages of any sizes cover the whole list once, and their cursors survive the wire.

use proptest::prelude::*;

use crate::{
    domain::{
        episode::{EpisodeFilter, Outcome},
        id::EpisodeId,
    },
    store::testing,
};

#[test]
fn pages_of_any_size_have_each_row_once() {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let (_dir, store) = runtime.block_on(testing::store());
    let (task, all) = runtime.block_on(async {
        let task = testing::task(&store).await;
        let mut all = Vec::new();
        for _ in 0..9 {
            all.push(testing::episode(&store, &task, Outcome::Success, "a").await.id);
        }
        (task, all)
    });
    let config = ProptestConfig { cases: 32, failure_persistence: None, ..ProptestConfig::default() };
    proptest!(config, |(sizes in proptest::collection::vec(1..12_u32, 1..4))| {
        let filter = EpisodeFilter { task_id: task.id.clone(), outcome: None, cohort: None, deleted: false };
        let mut seen = Vec::new();
        let mut after: Option<EpisodeId> = None;
        for size in sizes.into_iter().cycle() {
            let (page, next) = runtime.block_on(store.episodes(&filter, after.as_ref(), size)).unwrap();
            prop_assert!(page.len() <= usize::try_from(size).unwrap());
            prop_assert!(next.is_none() || !page.is_empty());
            seen.extend(page.into_iter().map(|episode| episode.id));
            // In the form in which a client returns it.
            after = next.map(|next| EpisodeId::parse("page_token", &String::from(next)).unwrap());
            if after.is_none() {
                break;
            }
        }
        prop_assert_eq!(&seen, &all);
    });
}
