//! Full disks: a small file system in memory, where one can be mounted, and labels that fill the rest of the database.

use std::{
    fs::File,
    io::Write as _,
    path::{Path, PathBuf},
    process::Command,
};

use gleaner_proto::v1::{LabelEpisodesRequest, Outcome};
use tempfile::TempDir;

use super::{api::Api, skipped::skipped};

/// A small file system in memory; unmounted on drop.
pub struct SmallDisk(TempDir);

impl SmallDisk {
    /// Mounts one. `None`, with a line that the test is skipped, where no file system can be mounted.
    pub fn mount(mebibytes: u32) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let size = format!("size={mebibytes}m");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder.path()).output();
        match mount {
            Ok(done) if done.status.success() => Some(Self(folder)),
            failed => {
                skipped(&format!("no file system can be mounted here, so no disk was full: {failed:?}"));
                None
            }
        }
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// A data folder on it.
    pub fn data(&self) -> PathBuf {
        self.path().join("data")
    }

    /// Mounts it again as read-only or writable; false where that is not allowed.
    pub fn set_read_only(&self, read_only: bool) -> bool {
        let options = if read_only { "remount,ro" } else { "remount,rw" };
        Command::new("mount").args(["-o", options]).arg(self.path()).status().is_ok_and(|status| status.success())
    }

    /// Leaves this many bytes free by a file that is as large as needed.
    pub fn leave(&self, bytes: u64) {
        let path = self.path().join("ballast");
        // Without the file of an earlier call.
        std::fs::write(&path, []).unwrap();
        let disk = rustix::fs::statvfs(self.path()).unwrap();
        let size = (disk.f_bavail * disk.f_frsize).checked_sub(bytes).unwrap();
        std::fs::write(&path, vec![7; usize::try_from(size).unwrap()]).unwrap();
    }

    /// Fills it with a file, which the test removes to free the space; again, if something else has freed some.
    pub fn fill(&self) -> PathBuf {
        let path = self.path().join("ballast");
        let mut file = File::options().create(true).append(true).open(&path).unwrap();
        for block in [vec![7; 1 << 20], vec![7; 4096], vec![7; 1]] {
            while file.write_all(&block).is_ok() {}
        }
        path
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let unmounted = Command::new("umount").arg("-l").arg(self.path()).status();
        assert!(unmounted.is_ok_and(|status| status.success()), "the small disk stays at {:?}", self.path());
    }
}

/// Labels an episode with a long reason.
pub async fn label(api: &mut Api, id: &str) -> Result<(), tonic::Status> {
    let request = LabelEpisodesRequest {
        episode_ids: vec![id.to_owned()],
        outcome: Outcome::Unknown.into(),
        reason: "r".repeat(200),
        ..Default::default()
    };
    api.episodes.label_episodes(request).await.map(|_| ())
}

/// Labels an episode until a label is rejected, because the write-ahead log may have free space left.
pub async fn label_until_rejected(api: &mut Api, id: &str) -> tonic::Status {
    for _ in 0..5000 {
        if let Err(status) = label(api, id).await {
            return status;
        }
    }
    panic!("a full disk accepted 5000 labels");
}
