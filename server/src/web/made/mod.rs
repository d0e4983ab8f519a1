//! What was made of what: datasets and policies, and every result's place on the way from episodes to robots.

mod card;
mod dataset;
mod evaluations;
mod lineage;
pub(super) mod link;
mod policy;

pub(super) use self::{
    dataset::show as dataset,
    evaluations::rate,
    lineage::{episodes, of_dataset, of_job},
    policy::show as policy,
};
