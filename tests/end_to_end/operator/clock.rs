//! A clock that jumps, seen from the server: everything that is dated in its folder becomes so much older at once.

use std::{path::Path, process::Command};

use gleaner_proto::v1::*;

use super::{
    folder::{Folder, swept},
    ids,
};
use crate::api::Api;

/// Makes the folder as it would look to a server whose clock is forty days ahead. Without `jump` the database has seen
/// those days pass.
fn age(data: &Path, jump: bool) {
    let seen = if jump { "seen_at - 40 * 86400000" } else { "seen_at" };
    let script = "import sqlite3, sys\n\
                  database = sqlite3.connect(sys.argv[1])\n\
                  database.execute('update lab set seen_at = ' + sys.argv[2])\n\
                  database.execute('update episodes set deleted_at = deleted_at - 40 * 86400000')\n\
                  database.commit()\n\
                  database.close()";
    let database = data.join("gleaner.db");
    let aged = Command::new("python3").args(["-c", script]).arg(database).arg(seen).status().unwrap();
    assert!(aged.success());
}

#[tokio::test]
async fn forty_days_of_a_wrong_clock_empty_no_trash_and_forty_days_that_passed_do() {
    for jump in [true, false] {
        let lab = Folder::used().await;
        let mut server = swept(lab.path(), &["--workers", "0"]).await;
        let mut api = Api::connect(&server).await;
        let deleted = ids(&mut api).await.remove(0);
        let delete = DeleteEpisodesRequest { episode_ids: vec![deleted.clone()], force: false };
        api.episodes.delete_episodes(delete).await.unwrap();
        assert!(server.stop().await);
        age(lab.path(), jump);
        lab.backdate();
        let server = swept(lab.path(), &["--workers", "0"]).await;
        let mut api = Api::connect(&server).await;
        let undelete = UndeleteEpisodesRequest { episode_ids: vec![deleted] };
        let back = api.episodes.undelete_episodes(undelete).await;
        assert_eq!(back.is_ok(), jump, "{back:?}");
        if jump {
            assert_eq!(ids(&mut api).await, lab.ids());
            lab.nothing_is_lost();
        }
    }
}
