//! A training on a GPU whose gradients are summed over a group, of one rank because a test has one GPU.

use std::net::Ipv4Addr;
use std::time::Duration;

use gleaner_core::Device;
use gleaner_group::{Meeting, Place};

use super::*;
use crate::gpu::gpu;
use crate::peers::Peers;

#[test]
fn a_group_on_a_gpu_pretrains_as_one_process_does() {
    let Some(_gpu) = gpu() else { return };
    let mut spec = pretrain_spec();
    spec.run.device = Device::Cuda;
    let reports = |mut peers: Peers| {
        let mut monitor = Recorder::default();
        let participant = Participant { resume: None, peers: &mut peers, monitor: &mut monitor };
        pretrain_with(&toy::shape(), &toy::experts(4, 5), &spec, None, participant).unwrap();
        monitor
    };
    let place = Place { rank: 0, ranks: 1, address: Ipv4Addr::LOCALHOST.into(), gpu: true };
    let group = Meeting::open(1, Duration::from_secs(60)).unwrap().join("learn", place).unwrap();
    let (alone, shared) = (reports(Peers::alone()), reports(Peers::of(group)));
    assert_eq!(shared.checkpoints.len(), 2);
    assert_same_metrics(&alone, &shared, 1e-2);
}
