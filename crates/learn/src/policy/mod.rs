//! Step three of SSDF: policies. One file for each policy, and its two lines here; training and serving do not depend
//! on the policy.

mod act;
mod bc;
mod chunk;
mod denoise;
mod diffusion;
mod finetune;
mod flow;
mod hiding;
mod kind;
mod looking;
mod observer;
mod perceptron;
mod serve;
mod session;
mod shares;
mod source;
mod switching;
mod tf_bc;
mod train;

pub use kind::Pretrained;
pub use serve::Policy;
pub use session::{Observed, PolicySession};
pub use train::{train_policy, train_policy_with};

use std::collections::BTreeMap;

use gleaner_core::kinds::{Family, Kind};
use tch::{Device, Tensor};

use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::family;
use crate::train::Learner;
use kind::{PolicyKind, PolicyModel};

/// Every policy; the first is the default.
const POLICIES: [&PolicyKind; 7] =
    [&bc::KIND, &finetune::KIND, &tf_bc::KIND, &act::KIND, &flow::KIND, &diffusion::KIND, &perceptron::KIND];

/// The policy of that name.
fn find(name: &str) -> Result<&'static PolicyKind, LearnError> {
    family::find(Family::Policy, &POLICIES, |kind| kind.name, name)
}

/// Every policy as data.
pub(crate) fn describe() -> Vec<Kind> {
    POLICIES.iter().map(|kind| kind.describe()).collect()
}

impl Learner for Box<dyn PolicyModel> {
    fn from_named(info: &CheckpointInfo, named: &BTreeMap<String, Tensor>, device: Device) -> Result<Self, LearnError> {
        (find(info.policy.as_deref().unwrap_or_default())?.load)(info, named, device)
    }

    fn parameters(&self) -> Vec<(String, Tensor)> {
        self.as_ref().parameters()
    }

    fn named(&self) -> Vec<(String, Tensor)> {
        let mut named = self.as_ref().parameters();
        named.extend(self.info().statistics.named());
        named.extend(self.constants());
        named
    }
}

#[cfg(test)]
mod tests;
