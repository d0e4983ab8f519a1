//! Names, holders and the memory budget, with models that need no memory.

use super::{
    super::testing::{Parrot, TestEngine, engine},
    *,
};
use crate::error::Kind;

/// Room for two policies of ten bytes.
fn two_policies() -> LoadedPolicies<Parrot> {
    LoadedPolicies::new(20)
}

async fn load(loaded: &mut LoadedPolicies<Parrot>, name: &str) -> Arc<TestEngine> {
    let (engine, control) = engine(1, 1).await;
    drop(control);
    loaded.make_room(10);
    loaded.put(&engine, 10);
    loaded.point(name, &engine);
    engine
}

#[tokio::test]
async fn the_least_recently_used_policy_is_unloaded_first() {
    let mut loaded = two_policies();
    for name in ["a", "b"] {
        load(&mut loaded, name).await;
    }
    assert!(loaded.named("a").is_some());
    load(&mut loaded, "c").await;
    assert!(loaded.named("b").is_none(), "used before a");
    assert!(loaded.named("a").is_some() && loaded.named("c").is_some());
}

#[tokio::test]
async fn policies_in_use_stay_loaded_beyond_the_budget() {
    let mut loaded = two_policies();
    let held = [load(&mut loaded, "a").await, load(&mut loaded, "b").await];
    load(&mut loaded, "c").await;
    assert!(["a", "b", "c"].iter().all(|name| loaded.named(name).is_some()));
    drop(held);
    loaded.make_room(0);
    assert!(loaded.named("a").is_none() && loaded.named("b").is_some() && loaded.named("c").is_some());
}

#[tokio::test]
async fn a_policy_without_a_name_is_unloaded_with_its_last_session() {
    let mut loaded = two_policies();
    let old = load(&mut loaded, "a").await;
    loaded.point("other", &old);
    load(&mut loaded, "a").await;
    let id = old.identity().policy_id.clone();
    drop(old);
    assert!(loaded.loaded(&(id.clone(), false)).unwrap().is_some(), "the other name still holds it");
    load(&mut loaded, "other").await;
    assert!(loaded.loaded(&(id.clone(), false)).unwrap().is_none());
}

#[tokio::test]
async fn a_policy_whose_names_are_forgotten_is_unloaded_with_its_last_session() {
    let mut loaded = two_policies();
    let held = load(&mut loaded, "a").await;
    loaded.point("other", &held);
    let key = held.identity().key();
    loaded.forget("a");
    assert!(loaded.named("a").is_none() && loaded.named("other").is_some());
    loaded.forget("other");
    assert!(loaded.loaded(&key).unwrap().is_some(), "a session holds it");
    drop(held);
    assert!(loaded.loaded(&key).unwrap().is_none());
    loaded.forget("other");
}

#[tokio::test]
async fn stop_removes_every_policy_and_refuses_later_requests() {
    let mut loaded = two_policies();
    let engine = load(&mut loaded, "a").await;
    assert_eq!(loaded.stop().len(), 1);
    assert!(loaded.named("a").is_none());
    let error = loaded.loaded(&engine.identity().key()).err().unwrap();
    assert_eq!(error.kind(), Kind::Unavailable);
}
