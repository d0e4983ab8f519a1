//! A lab is the same after a round trip. Run where `GLEANER_TEST_DATABASE` selects PostgreSQL.

use super::*;
use crate::{
    domain::{
        episode::{NewLabel, Outcome},
        policy::Assignment,
        selection::Selection,
        snapshot::Role,
        time::Millis,
    },
    error::Kind,
    store::testing::{self, results},
};

/// Rows in most tables.
async fn fill(store: &Store) {
    let task = testing::task(store).await;
    let mut episodes = Vec::new();
    for number in 0..250 {
        let outcome = if number % 2 == 0 { Outcome::Success } else { Outcome::Failure };
        episodes.push(testing::episode(store, &task, outcome, "ä \u{1F916}").await);
    }
    let encoder = results::encoder(store, &task).await;
    let scores: Vec<_> =
        episodes.iter().skip(1).step_by(2).map(|one| results::scores(&one.id, Role::Imperfect, &[0.5; 20])).collect();
    let run = results::run(store, &task, &encoder, &scores).await;
    results::import(store, &task, &encoder, None).await;
    store.insert_dataset(&run.id, Selection::beta(0.3)).await.unwrap();
    results::metrics(store, &encoder.job_id, &[("loss", 0.1), ("loss", -1e300)]).await;
    let policy = results::policy(store, &task, &encoder, blake3::hash(b"policy").into()).await;
    for hide_history in [false, true, false] {
        let assignment = Assignment { hide_history, ..Assignment::of(&policy.id) };
        store.deploy("arm", &task.id, &assignment).await.unwrap();
    }
    store.delete_episodes(&[episodes[0].id.clone()], true).await.unwrap();
    store.insert_upload(&testing::upload(&task, b"open"), None).await.unwrap();
    store.note_time(Millis(1_000_000_000_000), None).await.unwrap();
    store.note_time(Millis(1_900_000_000_000), None).await.unwrap();
}

#[tokio::test]
async fn lab_is_the_same_after_a_round_trip() {
    if !testing::postgres_selected() {
        return;
    }
    let (_dir, source) = testing::sqlite().await;
    fill(&source).await;
    let middle = Store::serve_postgres(&testing::postgres().await).await.unwrap();
    let there = source.transfer(&middle).await.unwrap();
    assert_eq!(there.len(), TABLES.len());
    let filled = there.iter().filter(|(_, rows)| *rows > 0).count();
    assert!(filled >= 17, "{there:?}");

    // Numbers go on behind the copied ones.
    let task = middle.tasks().await.unwrap().remove(0).0;
    let episode = testing::episode(&middle, &task, Outcome::Unknown, "").await.id;
    let (_other, back) = testing::sqlite().await;
    middle.transfer(&back).await.unwrap();
    // The fixtures break rules, each in the same rows of both databases, which list them in orders of their own.
    let wrong = async |store: &Store| std::collections::BTreeSet::from_iter(store.wrong_rows().await.unwrap());
    assert_eq!(wrong(&back).await, wrong(&middle).await);
    assert_eq!(back.integrity().await.unwrap(), []);
    let history = async |store: &Store| format!("{:?}", store.deployment("arm").await.unwrap());
    assert_eq!(history(&back).await, history(&source).await);
    let label = NewLabel { outcome: Some(Outcome::Success), cohort: None, author: "ada".into(), reason: String::new() };
    for store in [&middle, &back] {
        let before = store.newest_label().await.unwrap();
        store.label_episodes(std::slice::from_ref(&episode), &label).await.unwrap();
        assert_eq!(store.newest_label().await.unwrap(), before + 1);
    }

    let error = source.transfer(&middle).await.unwrap_err();
    assert!(error.kind() == Kind::Precondition && error.message().contains("is not empty"), "{error}");
}

/// A copy to a target that alters the reason of label 201 is refused, and succeeds once the trigger there is dropped.
async fn expect_refused_until(repair: &str, source: &Store, target: &Store) {
    let error = source.transfer(target).await.unwrap_err();
    assert_eq!(error.kind(), Kind::Internal, "{error}");
    assert!(error.to_string().contains("row 201 of labels differs"), "{error}");
    target.expect_empty().await.unwrap();
    testing::run(target, repair).await;
    let copied = source.transfer(target).await.unwrap();
    assert!(copied.contains(&("labels", 250)), "{copied:?}");
}

/// One column of one row, in the second batch, is another in the target than it was in the source.
#[tokio::test]
async fn a_copy_that_differs_is_refused_and_leaves_the_target_empty() {
    if !testing::postgres_selected() {
        return;
    }
    let (_dir, sqlite) = testing::sqlite().await;
    fill(&sqlite).await;
    let postgres = Store::serve_postgres(&testing::postgres().await).await.unwrap();
    testing::run(
        &postgres,
        "create function alter_reason() returns trigger language plpgsql as $$ begin \
         new.reason := 'altered'; return new; end $$; \
         create trigger altered before insert on labels for each row when (new.id = 201) \
         execute function alter_reason()",
    )
    .await;
    expect_refused_until("drop trigger altered on labels", &sqlite, &postgres).await;

    let (_other, back) = testing::sqlite().await;
    testing::run(
        &back,
        "create trigger altered after insert on labels when new.id = 201 begin \
         update labels set reason = 'altered' where id = new.id; end",
    )
    .await;
    expect_refused_until("drop trigger altered", &postgres, &back).await;
}

/// A column or a table of one database alone would be lost.
#[tokio::test]
async fn both_databases_have_the_same_tables_and_columns() {
    if !testing::postgres_selected() {
        return;
    }
    let (_dir, sqlite) = testing::sqlite().await;
    let postgres = Store::serve_postgres(&testing::postgres().await).await.unwrap();
    let tables: Vec<String> = row::query_as(
        "select name from sqlite_master where type = 'table' and name not like 'sqlite_%' and name <> '_sqlx_migrations'",
    )
    .fetch_all(sqlite.read())
    .await
    .unwrap();
    let mut known: Vec<String> = TABLES.iter().map(|(table, _)| (*table).to_owned()).collect();
    let mut found = tables.clone();
    known.sort();
    found.sort();
    assert_eq!(found, known);
    for table in tables {
        let mut there: Vec<String> =
            columns(postgres.read(), &table).await.unwrap().into_iter().map(|column| column.name).collect();
        let mut here: Vec<String> = row::query_as("select name from pragma_table_info($1)")
            .bind(table.as_str())
            .fetch_all(sqlite.read())
            .await
            .unwrap();
        there.sort();
        here.sort();
        assert_eq!(here, there, "{table}");
    }
}
