//! A clock that jumps ahead: every date in the data folder is suddenly older.

use std::{path::Path, process::Command};

use gleaner_proto::v1::*;

use crate::support::{
    api::Api,
    data_folder::{UsedFolder, swept},
};

/// Makes every date of the folder forty days older. Without `jump`, the database has recorded that the days passed.
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
async fn clock_jump_empties_no_trash() {
    for jump in [true, false] {
        let lab = UsedFolder::copy().await;
        let mut server = swept(lab.path(), &["--workers", "0"]).await;
        let mut api = Api::connect(&server).await;
        let deleted = api.episode_ids().await.remove(0);
        api.delete(&deleted).await;
        assert!(server.stop().await);
        age(lab.path(), jump);
        lab.backdate();
        let server = swept(lab.path(), &["--workers", "0"]).await;
        let mut api = Api::connect(&server).await;
        let undelete = UndeleteEpisodesRequest { episode_ids: vec![deleted] };
        let back = api.episodes.undelete_episodes(undelete).await;
        assert_eq!(back.is_ok(), jump, "{back:?}");
        if jump {
            assert_eq!(api.episode_ids().await, lab.ids());
            lab.expect_all_recordings();
        }
    }
}
