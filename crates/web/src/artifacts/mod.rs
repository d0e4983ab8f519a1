//! Pages of results (snapshots, encoders, datasets and policies) and the lineage of every result from episodes to
//! robots.

mod card;
mod dataset;
mod encoder;
mod evaluations;
mod lineage;
pub(super) mod link;
mod policy;
mod snapshot;

pub(super) use self::{
    dataset::show as dataset,
    encoder::show as encoder,
    evaluations::rate,
    lineage::{episodes, of_dataset, of_job, of_snapshot},
    policy::show as policy,
    snapshot::show as snapshot,
};
