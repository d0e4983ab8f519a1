//! Names, holders and the memory budget, with models that cost nothing.

use super::{
    super::testing::{Parrot, TestEngine, engine},
    *,
};
use crate::error::Kind;

/// A shelf for two policies of ten bytes, and a way to load one more under a name.
fn shelf() -> Shelf<Parrot> {
    Shelf::new(20)
}

async fn load(shelf: &mut Shelf<Parrot>, name: &str) -> Arc<TestEngine> {
    let (engine, control) = engine(1, 1).await;
    drop(control);
    shelf.make_room(10);
    shelf.put(&engine, 10);
    shelf.point(name, &engine);
    engine
}

#[tokio::test]
async fn the_least_recently_used_goes_first() {
    let mut shelf = shelf();
    for name in ["a", "b"] {
        load(&mut shelf, name).await;
    }
    assert!(shelf.named("a").is_some());
    load(&mut shelf, "c").await;
    assert!(shelf.named("b").is_none(), "used before a");
    assert!(shelf.named("a").is_some() && shelf.named("c").is_some());
}

#[tokio::test]
async fn what_is_held_stays_whatever_the_budget_says() {
    let mut shelf = shelf();
    let held = [load(&mut shelf, "a").await, load(&mut shelf, "b").await];
    load(&mut shelf, "c").await;
    assert!(["a", "b", "c"].iter().all(|name| shelf.named(name).is_some()));
    drop(held);
    shelf.make_room(0);
    assert!(shelf.named("a").is_none() && shelf.named("b").is_some() && shelf.named("c").is_some());
}

#[tokio::test]
async fn a_policy_without_a_name_goes_with_its_last_session() {
    let mut shelf = shelf();
    let old = load(&mut shelf, "a").await;
    shelf.point("other", &old);
    load(&mut shelf, "a").await;
    let id = old.identity().policy_id.clone();
    drop(old);
    assert!(shelf.loaded(&id).unwrap().is_some(), "the other name still holds it");
    load(&mut shelf, "other").await;
    assert!(shelf.loaded(&id).unwrap().is_none());
}

#[tokio::test]
async fn a_stop_takes_everything() {
    let mut shelf = shelf();
    let engine = load(&mut shelf, "a").await;
    assert_eq!(shelf.stop().len(), 1);
    assert!(shelf.named("a").is_none());
    let error = shelf.loaded(&engine.identity().policy_id).err().unwrap();
    assert_eq!(error.kind(), Kind::Unavailable);
}
