//! Groups of GPUs: sums by NCCL where there is one, and a clear error where a build with NCCL finds none. Skipped in a build
//! without NCCL (`make check-nccl` makes one with it).
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "tests")]

use std::{net::Ipv4Addr, time::Duration};

use gleaner_group::{Group, GroupError, Meeting, Place};
use tch::{Cuda, Device, Tensor};

/// A group of this process alone.
fn alone(gpu: bool) -> Result<Group, GroupError> {
    let place = Place { rank: 0, ranks: 1, address: Ipv4Addr::LOCALHOST.into(), gpu };
    Meeting::open(1, Duration::from_secs(60)).unwrap().join("alone", place)
}

#[test]
fn gpus_are_summed_by_nccl_and_a_missing_one_is_named() {
    let (group, device) = match (alone(true), Cuda::is_available()) {
        (Ok(group), true) => (group, Device::Cuda(0)),
        (Ok(_), false) => return println!("SKIPPED: this build has no NCCL"),
        (Err(error), available) => {
            assert!(!available && error.to_string().contains("no GPUs found"), "{error}");
            // The program computes on.
            (alone(false).unwrap(), Device::Cpu)
        }
    };
    let (mut group, mut tensor) = (group, Tensor::from_slice(&[1_f32, 2.0]).to_device(device));
    group.sum(&mut tensor).unwrap();
    assert_eq!(Vec::<f32>::try_from(tensor.to_device(Device::Cpu)).unwrap(), [1.0, 2.0]);
}
