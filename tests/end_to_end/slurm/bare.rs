//! The worker of the tarball on a node that has glibc, the runtime of GCC and libtorch, and no other file. `make
//! check-worker` makes the tarball and runs this.

use std::{
    fs,
    os::unix::fs::{PermissionsExt as _, symlink},
    path::{Path, PathBuf},
    process::Command,
};

use crate::support::{api::Api, lab, server::TestServer, skipped::skipped, slurm::Cluster};

/// The files of glibc, and of GCC's runtime, which libtorch needs too.
const LIBRARIES: [&str; 9] = [
    "libc.so.6",
    "libm.so.6",
    "librt.so.1",
    "libdl.so.2",
    "libpthread.so.0",
    "libutil.so.1",
    "ld-linux-x86-64.so.2",
    "libstdc++.so.6",
    "libgcc_s.so.1",
];

/// A root with these libraries and the tarball, extracted.
fn bare_root(folder: &Path, tarball: &str) {
    for name in ["lib", "proc", "dev", "tmp"] {
        fs::create_dir_all(folder.join(name)).unwrap();
    }
    // The loader is there, and looks in `lib`.
    symlink("lib", folder.join("lib64")).unwrap();
    let known = Command::new("/sbin/ldconfig").arg("-p").output().unwrap();
    let known = String::from_utf8(known.stdout).unwrap();
    for library in LIBRARIES {
        let line = known.lines().find(|line| line.trim_start().starts_with(library) && line.contains("x86-64"));
        let path = line.and_then(|line| line.rsplit(" => ").next()).unwrap();
        fs::copy(path, folder.join("lib").join(library)).unwrap();
    }
    assert!(Command::new("tar").arg("-C").arg(folder).args(["-xzf", tarball]).status().unwrap().success());
    fs::create_dir(folder.join("gleaner-worker/lib")).unwrap();
}

/// A program that runs the worker within the root, with libtorch and the lab's folder in their places there.
fn contained(root: &Path, data: &Path) -> PathBuf {
    let libtorch = fs::canonicalize(Path::new(env!("CARGO_MANIFEST_DIR")).join("../.libtorch/lib")).unwrap();
    let (root_shown, data, libtorch) = (root.display(), data.display(), libtorch.display());
    let script = format!(
        "#!/bin/sh\nexec unshare --mount sh -c '\nset -e\nmkdir -p {root_shown}{data}\n\
         mount --bind {libtorch} {root_shown}/gleaner-worker/lib\nmount --bind {data} {root_shown}{data}\n\
         mount -t proc proc {root_shown}/proc\nmount --bind /dev {root_shown}/dev\n\
         exec chroot {root_shown} /gleaner-worker/bin/gleaner-worker \"$@\"' worker \"$@\"\n"
    );
    let program = root.with_extension("sh");
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    program
}

#[tokio::test]
async fn packed_worker_runs_with_glibc_libtorch_and_the_runtime_of_gcc_alone() {
    let Ok(tarball) = std::env::var("GLEANER_WORKER_TARBALL") else {
        return skipped("needs the tarball of make worker; make check-worker runs it");
    };
    let Some(cluster) = Cluster::start(1).await else { return };
    let folder = tempfile::tempdir().unwrap();
    let (data, root) = (folder.path().join("lab"), folder.path().join("root"));
    fs::create_dir(&data).unwrap();
    bare_root(&root, &tarball);
    let flags = [cluster.flags(), vec!["--slurm-worker".to_owned(), contained(&root, &data).display().to_string()]];
    let flags = flags.concat();
    let server = TestServer::start_over(&data, &flags.iter().map(String::as_str).collect::<Vec<_>>()).await;
    let mut api = Api::connect(&server).await;
    lab::set_up(&mut api).await;
    let encoder = api.succeed(lab::TASK, lab::pretrain(4)).await;
    let run = api.succeed(lab::TASK, lab::score(&encoder.result_id)).await;
    let (_, policy_id) = api.train_policy(1).await;
    assert!(!policy_id.is_empty() && run.node == "node1", "{run:?}");
    cluster.until_empty().await;
}
