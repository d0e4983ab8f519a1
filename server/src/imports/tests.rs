//! Imports over a fresh database: stored whole, or rejected with the episode and the step.

use tempfile::TempDir;

use super::*;
use crate::{
    domain::{
        episode::{Episode, Outcome},
        selection::Selection,
        snapshot::RoleRule,
        task::Task,
    },
    error::Kind,
    store::testing::{self, results},
};

/// Two experts and two imperfect episodes in a snapshot.
struct Lab {
    dir: TempDir,
    store: Store,
    task: Task,
    experts: [Episode; 2],
    imperfect: [Episode; 2],
    snapshot: SnapshotId,
}

impl Lab {
    async fn new() -> Self {
        let (dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        let experts = [
            testing::episode(&store, &task, Outcome::Success, "").await,
            testing::episode(&store, &task, Outcome::Success, "").await,
        ];
        let imperfect = [
            testing::episode(&store, &task, Outcome::Failure, "").await,
            testing::episode(&store, &task, Outcome::Failure, "").await,
        ];
        let snapshot = store.create_snapshot(&task.id, &RoleRule::default()).await.unwrap().id;
        Self { dir, store, task, experts, imperfect, snapshot }
    }

    fn opening(&self) -> Opening {
        Opening { snapshot_id: self.snapshot.clone(), source: "an oracle".into(), encoder_id: None }
    }

    async fn begin(&self, opening: Opening) -> Result<Import> {
        let blobs = Blobs::open(self.dir.path()).unwrap();
        Import::begin(&self.store, &blobs, opening).await
    }

    async fn import(&self, opening: Opening, episodes: &[Imported]) -> Result<ScoreRun> {
        let mut import = self.begin(opening).await?;
        episodes.iter().cloned().try_for_each(|episode| import.add(episode))?;
        import.finish(&self.store).await
    }
}

/// The same q for every step.
fn flat(episode: &Episode, q: f64) -> Imported {
    let steps = usize::try_from(episode.steps).unwrap();
    Imported { episode_id: episode.id.clone(), q: vec![q; steps] }
}

#[tokio::test]
async fn an_import_is_a_score_run() {
    let lab = Lab::new().await;
    let [one, other] = &lab.imperfect;
    // The order of arrival does not matter.
    let mut risen = flat(other, 0.25);
    risen.q[3] = 0.75;
    let run = lab.import(lab.opening(), &[risen.clone(), flat(one, 0.5)]).await.unwrap();
    let read = lab.store.score_run(&run.id).await.unwrap();
    let origin = Origin::Import { encoder_id: None, source: "an oracle".into() };
    assert_eq!((&read.origin, read.lo, read.hi), (&origin, 0.0, 1.0));
    assert_eq!(read.expert_ids.len(), 2);
    assert!(lab.experts.iter().all(|expert| read.expert_ids.contains(&expert.id)));
    let scores = lab.store.episode_scores(&run.id, &other.id).await.unwrap();
    assert_eq!(scores.w, risen.q);
    assert_eq!((scores.q[2], scores.q[3], scores.match_episode.len()), (0.25, 0.75, 0));
    assert_eq!(lab.store.score_runs(&lab.task.id).await.unwrap().len(), 1);
    let counts = lab.store.run_counts(&read).await.unwrap();
    assert_eq!((counts.imperfect_episodes, counts.imperfect_segments), (2, one.steps + other.steps));

    let dataset = lab.store.insert_dataset(&run.id, Selection::beta(0.6)).await.unwrap();
    let contents = lab.store.dataset_contents(&dataset.id).await.unwrap();
    assert_eq!((contents.kept.len(), contents.kept[0].segments[0].end_step), (1, 3));
    assert_eq!(lab.store.segment_length(contents.run.origin.encoder_id()).await.unwrap(), 0);
    let refused = lab.store.delete_episodes(std::slice::from_ref(&one.id), false).await.unwrap_err();
    assert!(refused.message().contains("used by 1 score runs, 1 datasets"), "{refused}");
    assert_eq!(lab.store.wrong_rows().await.unwrap(), []);
    assert_eq!(lab.store.integrity().await.unwrap(), []);
}

#[tokio::test]
async fn values_that_are_equal_once_rounded_keep_their_order() {
    let lab = Lab::new().await;
    let [one, other] = &lab.imperfect;
    let (mut low, high) = (flat(one, 0.5), flat(other, 0.25));
    low.q[7] = 0.5 + f64::EPSILON;
    let run = lab.import(lab.opening(), &[low, high]).await.unwrap();
    #[expect(clippy::cast_precision_loss, reason = "few steps")]
    let smallest = 1.0 / (one.steps + other.steps) as f64;
    let dataset = lab.store.insert_dataset(&run.id, Selection::top_fraction(smallest)).await.unwrap();
    let kept = lab.store.dataset_contents(&dataset.id).await.unwrap().kept;
    assert_eq!((kept.len(), kept[0].segments.len(), kept[0].segments[0].end_step), (1, 1, 7));
}

#[tokio::test]
async fn the_same_import_returns_the_same_run() {
    let lab = Lab::new().await;
    let all = lab.imperfect.each_ref().map(|episode| flat(episode, 0.5));
    let first = lab.import(lab.opening(), &all).await.unwrap();
    let mut turned = all.clone();
    turned.reverse();
    assert_eq!(lab.import(lab.opening(), &turned).await.unwrap().id, first.id);
    let named = Opening { source: "another".into(), ..lab.opening() };
    assert_ne!(lab.import(named, &all).await.unwrap().id, first.id);
    let mut changed = all;
    changed[0].q[0] = 0.75;
    assert_ne!(lab.import(lab.opening(), &changed).await.unwrap().id, first.id);
    assert_eq!(lab.store.score_runs(&lab.task.id).await.unwrap().len(), 3);
}

#[tokio::test]
async fn a_faulty_import_is_rejected_and_stores_nothing() {
    let lab = Lab::new().await;
    let ([one, other], [expert, second]) = (&lab.imperfect, &lab.experts);
    let whole = || vec![flat(one, 0.5), flat(other, 0.5)];
    let with = |more: Imported| [whole(), vec![more]].concat();
    let changed = |change: fn(&mut Vec<f64>)| {
        let mut all = whole();
        change(&mut all[1].q);
        all
    };
    let stranger = Imported { episode_id: EpisodeId::new(), q: vec![0.5] };
    let name = stranger.episode_id.to_string();
    let (one, other, second) = (one.id.to_string(), other.id.to_string(), second.id.to_string());
    for (episodes, words) in [
        (vec![flat(&lab.imperfect[1], 0.5)], [one.as_str(), "is missing"]),
        (Vec::new(), ["(imperfect, 20 steps)", "is missing"]),
        (changed(|q| q.truncate(19)), [other.as_str(), "values"]),
        (changed(|q| q.push(0.5)), [other.as_str(), "values"]),
        (changed(|q| q[4] = 1.000_001), [other.as_str(), "at step 4"]),
        (changed(|q| q[5] = -0.1), [other.as_str(), "at step 5"]),
        (changed(|q| q[6] = f64::NAN), [other.as_str(), "at step 6"]),
        (changed(|q| q[7] = f64::INFINITY), [other.as_str(), "at step 7"]),
        (with(stranger), [name.as_str(), "is not in"]),
        (with(flat(&lab.imperfect[0], 0.5)), [one.as_str(), "is duplicated"]),
        (with(flat(expert, 0.5)), [second.as_str(), "or none"]),
    ] {
        let error = lab.import(lab.opening(), &episodes).await.unwrap_err();
        assert_eq!(error.kind(), Kind::Invalid, "{error}");
        assert!(error.message().starts_with("batch.episodes"), "{error}");
        assert!(words.iter().all(|word| error.message().contains(word)), "{words:?} expected: {error}");
    }
    assert!(lab.store.score_runs(&lab.task.id).await.unwrap().is_empty());
    let experts = [whole(), lab.experts.iter().map(|expert| flat(expert, 1.0)).collect()].concat();
    let run = lab.import(lab.opening(), &experts).await.unwrap();
    assert_eq!(lab.store.expert_qualities(&run.id).await.unwrap(), vec![vec![1.0; 20]; 2]);
}

#[tokio::test]
async fn an_encoder_is_of_the_task_of_the_snapshot() {
    let lab = Lab::new().await;
    let all = lab.imperfect.each_ref().map(|episode| flat(episode, 0.5));
    let encoder = results::encoder(&lab.store, &lab.task).await.id;
    let named = Opening { encoder_id: Some(encoder.clone()), ..lab.opening() };
    let run = lab.import(named, &all).await.unwrap();
    assert_eq!(run.origin.encoder_id(), Some(&encoder));

    let mut spec = testing::spec();
    spec.name = "other".into();
    let task = lab.store.insert_task(&spec).await.unwrap();
    testing::episode(&lab.store, &task, Outcome::Success, "").await;
    testing::episode(&lab.store, &task, Outcome::Failure, "").await;
    let foreign = results::encoder(&lab.store, &task).await.id;
    for (encoder, kind) in [(foreign, Kind::Invalid), (EncoderId::new(), Kind::NotFound)] {
        let error = lab.begin(Opening { encoder_id: Some(encoder), ..lab.opening() }).await.unwrap_err();
        assert_eq!(error.kind(), kind, "{error}");
    }
    let absent = Opening { snapshot_id: SnapshotId::new(), ..lab.opening() };
    assert_eq!(lab.begin(absent).await.unwrap_err().kind(), Kind::NotFound);
}
