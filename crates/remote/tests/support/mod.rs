//! A task, a policy and a step for the tests of both protocols.

#![allow(dead_code, missing_docs, reason = "each test uses a part")]

pub(crate) mod openpi;
pub(crate) mod scripted;

use std::{sync::Arc, time::Duration};

use gleaner_core::{
    Alignment, CameraSpec, FieldSpec, Result, TaskSpec,
    remote::{Protocol, RemotePolicy},
};
use gleaner_remote::{Episode, Hosts, Outgoing, Remote, Step};

/// One camera of 1 × 2, two values of proprioception, two of an action.
pub(crate) fn task() -> TaskSpec {
    TaskSpec {
        name: "t".into(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz: 10.0,
        cameras: vec![CameraSpec { name: "top".into(), height: 1, width: 2, depth: false, recorded: None }],
        proprioception: vec![FieldSpec::new("joints", 2)],
        action: vec![FieldSpec::new("move", 2)],
        alignment: Alignment::default(),
        tolerance: 0.25,
        mappings: Vec::new(),
    }
}

/// Far more than an answer takes on a busy machine.
pub(crate) fn policy(protocol: Protocol, address: &str) -> RemotePolicy {
    let policy = RemotePolicy {
        protocol,
        address: address.into(),
        model: if protocol == Protocol::OpenInference { "arm".into() } else { String::new() },
        model_version: String::new(),
        inputs: Vec::new(),
        output: String::new(),
        chunk_length: 4,
        execute_length: 1,
        sequences: false,
        answer_within_ms: 60_000,
        source: String::new(),
    };
    policy.checked(&task()).unwrap()
}

/// This machine may be called.
pub(crate) fn outgoing() -> Outgoing {
    Outgoing { hosts: Hosts::parse(&["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap(), ..Outgoing::default() }
}

pub(crate) fn remote(policy: RemotePolicy, outgoing: Outgoing) -> Arc<Remote> {
    Arc::new(Remote::new(policy, &task(), outgoing).unwrap())
}

/// As [`act`], again until the server answers in time.
pub(crate) async fn acts(episode: &mut Episode, value: f32) -> Vec<Vec<f32>> {
    let mut attempts = tokio::time::interval(Duration::from_millis(20));
    loop {
        attempts.tick().await;
        if let Ok(actions) = act(episode, value).await {
            return actions;
        }
    }
}

/// The actions for a step whose first value of proprioception is `value`.
pub(crate) async fn act(episode: &mut Episode, value: f32) -> Result<Vec<Vec<f32>>> {
    let proprioception = [value, 0.5];
    episode.infer(&Step { frame: &[1, 2, 3, 4, 5, 6], proprioception: &proprioception, executed: None }).await
}
