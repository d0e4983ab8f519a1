//! The curator: labels, deletes and restores episodes of the load, creates snapshots and datasets, imports scores, deploys
//! policies.

use std::sync::Arc;

use gleaner_proto::v1::*;
use rand::{Rng, RngExt as _, rngs::StdRng, seq::IndexedRandom as _};
use tokio_util::sync::CancellationToken;

use super::{
    lab::{COHORT, Lab, next_life, retry},
    ledger::State,
};
use crate::support::lab as common;

/// Makes one change after the other until it is cancelled.
pub async fn curate(lab: Arc<Lab>, stop: CancellationToken) {
    let mut random = lab.settings.random(1);
    let mut n = 0_u32;
    while !stop.is_cancelled() {
        n += 1;
        match n % 7 {
            0 => snapshot(&lab).await,
            1 => dataset(&lab, &mut random).await,
            2 => deploy(&lab, n, &mut random).await,
            3 => delete_or_restore(&lab, &mut random).await,
            4 => import(&lab, n).await,
            _ => label(&lab, n, &mut random).await,
        }
        next_life(&lab).await;
    }
}

/// A random episode of the load whose last state passes, with that state.
fn pick(lab: &Lab, random: &mut impl Rng, passes: impl Fn(&State) -> bool) -> Option<(String, State)> {
    let acknowledged = lab.ledger.read();
    let of_load = |kept: &super::ledger::Stored| kept.requested[0].cohort == COHORT;
    let fitting: Vec<_> = acknowledged
        .episodes
        .iter()
        .filter(|(_, kept)| of_load(kept) && passes(kept.requested.last().unwrap()))
        .map(|(id, kept)| (id.clone(), kept.requested.last().unwrap().clone()))
        .collect();
    fitting.choose(random).cloned()
}

async fn label(lab: &Lab, n: u32, random: &mut StdRng) {
    let Some((id, state)) = pick(lab, random, |state| !state.deleted) else { return };
    let outcome = *[Outcome::Success, Outcome::Failure, Outcome::Unknown].choose(random).unwrap();
    let cohort = format!("labelled {n}");
    lab.ledger.request_state(&id, State { outcome, cohort: cohort.clone(), ..state });
    let request = LabelEpisodesRequest {
        episode_ids: vec![id.clone()],
        outcome: outcome.into(),
        cohort: Some(cohort),
        author: "crash test".into(),
        ..LabelEpisodesRequest::default()
    };
    retry!(lab, episodes.label_episodes(request)).unwrap();
    lab.ledger.acknowledge_state(&id);
}

async fn delete_or_restore(lab: &Lab, random: &mut StdRng) {
    let deleted = random.random_bool(0.4);
    let Some((id, state)) = pick(lab, random, |state| state.deleted == deleted) else { return };
    lab.ledger.request_state(&id, State { deleted: !deleted, ..state });
    let episode_ids = vec![id.clone()];
    if deleted {
        let request = UndeleteEpisodesRequest { episode_ids };
        retry!(lab, episodes.undelete_episodes(request)).unwrap();
    } else {
        let request = DeleteEpisodesRequest { episode_ids, ..DeleteEpisodesRequest::default() };
        retry!(lab, episodes.delete_episodes(request)).unwrap();
    }
    lab.ledger.acknowledge_state(&id);
}

/// A snapshot of the core only, because episodes in a snapshot cannot be deleted.
async fn snapshot(lab: &Lab) {
    let rule = RoleRule {
        expert_cohorts: vec!["expert".into()],
        imperfect_cohorts: vec!["failed".into()],
        ..RoleRule::default()
    };
    let request = CreateSnapshotRequest { task: common::TASK.into(), rule: Some(rule) };
    let made = retry!(lab, snapshots.create_snapshot(request)).unwrap();
    lab.ledger.add_snapshot(made.into_inner().snapshot.unwrap().id);
}

async fn dataset(lab: &Lab, random: &mut StdRng) {
    let selection = common::above(random.random_range(0.0..1.0));
    let request = CreateDatasetRequest { score_run_id: lab.run.clone(), selection: Some(selection) };
    let made = retry!(lab, datasets.create_dataset(request)).unwrap();
    lab.ledger.add_dataset(made.into_inner().dataset.unwrap().id);
}

/// A new import each time: a repeated one stores nothing.
async fn import(lab: &Lab, n: u32) {
    let mut messages = lab.import.clone();
    if let Some(import_scores_request::Message::Open(open)) = &mut messages[0].message {
        open.source = format!("import {n}");
    }
    let requests = futures::stream::iter(messages);
    let made = retry!(lab, scores.import_scores(requests)).unwrap();
    lab.ledger.add_import(made.into_inner().score_run.unwrap().id);
}

async fn deploy(lab: &Lab, n: u32, random: &mut StdRng) {
    let name = format!("arm{}@crash", n % 3);
    let policy = lab.ledger.read().policies.choose(random).unwrap().clone();
    lab.ledger.request_deployment(&name, &policy);
    let request = DeployRequest { name: name.clone(), policy_id: policy, ..DeployRequest::default() };
    retry!(lab, policies.deploy(request)).unwrap();
    lab.ledger.acknowledge_deployment(&name);
}
