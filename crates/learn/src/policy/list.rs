//! The list of policies: a new one is a file and a line here.

use std::collections::BTreeMap;

use gleaner_core::kinds::{Family, Kind};
use tch::{Device, Tensor};

use super::kind::{PolicyKind, PolicyModel};
use super::{act, bc, finetune, tf_bc};
use crate::checkpoint::CheckpointInfo;
use crate::error::LearnError;
use crate::train::Learner;

/// Every policy; the first is the default.
const POLICIES: [&PolicyKind; 4] = [&finetune::KIND, &tf_bc::KIND, &bc::KIND, &act::KIND];

/// The policy of that name.
pub(super) fn find(name: &str) -> Result<&'static PolicyKind, LearnError> {
    let found = POLICIES.into_iter().find(|kind| kind.name == name);
    // The error names those there are.
    found.ok_or_else(|| Family::Policy.kind(name).err().map_or_else(|| unlisted(name), LearnError::from))
}

fn unlisted(name: &str) -> LearnError {
    LearnError::invalid("policy", format!("{name} is missing in the list of policies of this program"))
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
        named
    }
}
