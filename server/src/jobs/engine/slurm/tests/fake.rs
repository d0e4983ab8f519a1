//! A cluster of scripts, and an attempt to run there.

use std::{
    io::Write as _,
    path::PathBuf,
    process::{Command, Stdio},
    sync::Arc,
    time::Duration,
};

use clap::Parser as _;

use super::super::*;
use crate::{
    config::{Cli, Command as Subcommand},
    domain::{
        job::Job,
        order::{JobOrder, Queueing},
        snapshot::RoleRule,
    },
    jobs::{
        lease::{Leases, Tie},
        testing::Bench,
        token::Issuer,
    },
};

/// Longest time of a command here, in which a script ends on a busy machine too.
const COMMAND: Duration = Duration::from_secs(2);
/// Longer than a call of such a script takes that is under way.
pub(super) const LIMIT: Duration = Duration::from_millis(300);
/// The options of the operator.
pub(super) const PARTITION: &str = "--partition=nope";

/// A cluster of scripts, and an attempt to run there.
pub(super) struct Fake {
    bench: Bench,
    pub(super) slurm: Slurm,
    pub(super) job: Job,
    pub(super) attempt: Attempt,
    pub(super) issuer: Issuer,
    pub(super) leases: Leases,
    pub(super) lease: Arc<Lease>,
}

impl Fake {
    /// Commands that are not installed.
    pub(super) async fn new() -> Self {
        let bench = Bench::new().await;
        let spec = gleaner_core::PretrainSpec::default();
        let order = JobOrder::Pretrain { snapshot_id: None, rule: RoleRule::default(), spec };
        bench.jobs.submit(&bench.task.id, order, Queueing::default()).await.unwrap();
        let issuer = Issuer::new();
        let job = bench.store.claim_job(&issuer.hash, Slurm::NAME).await.unwrap().unwrap();
        let attempt = issuer.attempt(&job.id);
        let folder = bench.dir.path().join("bin");
        std::fs::create_dir(&folder).unwrap();
        let data = bench.dir.path().to_str().unwrap();
        let arguments = ["gleaner-server", "serve", "--data-dir", data, "--engine", "slurm"];
        let address = ["--worker-listen", "127.0.0.1:7402", "--slurm-options", PARTITION];
        let of_commands = ["--slurm-bin", folder.to_str().unwrap(), "--slurm-setup", "module load cuda"];
        let cli = Cli::try_parse_from(arguments.iter().chain(&address).chain(&of_commands)).unwrap();
        let Subcommand::Serve(config) = cli.command else { panic!("not serve") };
        let slurm = Slurm::new(Arc::new(*config)).unwrap();
        let commands = slurm.commands.clone().within(COMMAND);
        let poller = Poller::start(commands.clone(), Duration::from_millis(10));
        let leases = Leases::new(tokio_util::sync::CancellationToken::new());
        let lease = leases.grant(&attempt, Tie::Remote);
        Self { bench, slurm: Slurm { commands, poller, ..slurm }, job, attempt, issuer, leases, lease }
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.bench.dir.path().join(name)
    }

    /// Installs a command, in place of an earlier one. Another process writes it: a file that is open for writing cannot
    /// run, and a command that starts meanwhile would hold it open.
    pub(super) fn install(&self, command: &str, script: &str) {
        let path = self.path("bin").join(command);
        let write = "cat > \"$0.new\" && chmod +x \"$0.new\" && mv \"$0.new\" \"$0\"";
        let mut writer = Command::new("sh").args(["-c", write]).arg(&path).stdin(Stdio::piped()).spawn().unwrap();
        let folder = self.bench.dir.path().display();
        let script = format!("#!/bin/sh\ncd {folder}\n{script}\n");
        writer.stdin.take().unwrap().write_all(script.as_bytes()).unwrap();
        assert!(writer.wait().unwrap().success());
    }

    /// Installs squeue with this answer for the attempt's job: `id|STATE|node|reason`. It counts its calls in a file. Another
    /// job of the user is listed too, with a bar in its name.
    pub(super) fn list(&self, answer: &str) {
        self.list_after("", answer);
    }

    /// The same after the output of these commands.
    pub(super) fn list_after(&self, commands: &str, answer: &str) {
        self.list_only_others(&format!("{commands}echo \"$name|{answer}\""));
    }

    /// Installs squeue with the other job and the output of these commands, for which `$name` is the name of the attempt's
    /// job.
    pub(super) fn list_only_others(&self, commands: &str) {
        let name = script::name(&self.attempt);
        let other = "echo 'lr=0.1|bs=32|3|RUNNING|node9|None'";
        self.install("squeue", &format!("echo 1 >> calls; name='{name}'; {other}; {commands}"));
    }

    pub(super) fn calls(&self) -> usize {
        std::fs::read_to_string(self.path("calls")).unwrap_or_default().lines().count()
    }

    /// Waits for further calls of squeue.
    pub(super) async fn calls_more(&self, more: usize) {
        let enough = self.calls() + more;
        while self.calls() < enough {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    pub(super) fn start(&self) -> Box<dyn Execution> {
        let token = self.issuer.token(&self.job.id);
        self.slurm.start(Launch { job: &self.job, attempt: &self.attempt, token, lease: &self.lease }).unwrap()
    }

    pub(super) fn resume(&self, id: &str) -> Box<dyn Execution> {
        let placement = Placement { engine: Slurm::NAME.into(), engine_id: id.into(), ..Placement::default() };
        self.slurm.resume(&self.attempt, &placement, &self.lease).unwrap()
    }
}
