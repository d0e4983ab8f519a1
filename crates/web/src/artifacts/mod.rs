//! Pages of results (snapshots, encoders, datasets and policies) and the lineage of every result from episodes to
//! robots.

mod card;
mod encoder;
mod evaluations;
mod lineage;
mod policy;
mod remote_policy;
mod snapshot;

pub(super) use self::{
    encoder::show as encoder,
    evaluations::rate,
    lineage::{episodes, of_dataset, of_job, of_run, of_snapshot},
    policy::show as policy,
    snapshot::show as snapshot,
};
