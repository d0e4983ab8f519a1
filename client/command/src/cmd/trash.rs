//! `delete`, `restore`: episodes into the trash and back.

use clap::Args;
use gleaner_proto::v1::{DeleteEpisodesRequest, UndeleteEpisodesRequest};

use super::episodes;
use crate::context::Context;
use crate::failure::Result;
use crate::json;

#[derive(Args, Debug)]
pub(crate) struct DeleteArgs {
    /// Ids of the episodes; either all are deleted or none.
    #[arg(required = true)]
    ids: Vec<String>,
    /// Also delete episodes of snapshots. Results of these snapshots can then not be reproduced.
    #[arg(long)]
    force: bool,
}

impl DeleteArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = DeleteEpisodesRequest { episode_ids: self.ids.clone(), force: self.force };
        let reply = context.client().await?.episodes().delete_episodes(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || episodes::listing(&reply.episodes))?;
        context.output.next(format_args!("gleaner restore {} (until the server sweeps its trash)", self.ids.join(" ")));
        Ok(())
    }
}

#[derive(Args, Debug)]
pub(crate) struct RestoreArgs {
    /// Ids of the episodes, or the file names of their recordings; either all are restored or none.
    #[arg(required = true)]
    ids: Vec<String>,
}

impl RestoreArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = UndeleteEpisodesRequest { episode_ids: self.ids };
        let reply = context.client().await?.episodes().undelete_episodes(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || episodes::listing(&reply.episodes))?;
        context.output.next("gleaner episodes --deleted (lists the trash)");
        Ok(())
    }
}
