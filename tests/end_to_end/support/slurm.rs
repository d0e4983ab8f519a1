//! A private Slurm in one folder: its own key, ports, state and nodes. Each node is a process namespace on this machine, so
//! that killing its first process ends all that runs there, as a power cut would. Where Slurm is not installed, its tests
//! print SKIPPED and pass.

use std::{
    collections::BTreeMap,
    fs,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::Stdio,
    time::Duration,
};

use tempfile::TempDir;
use tokio::{
    net::TcpSocket,
    process::{Child, Command},
    task::JoinSet,
};

use super::{
    process::{Signal, try_signal},
    skipped::skipped,
    wait::until,
};

const COMMANDS: [&str; 5] = ["sbatch", "squeue", "scancel", "sinfo", "scontrol"];

/// A running cluster; every process ends on drop.
pub struct Cluster {
    folder: TempDir,
    _munge: Child,
    controller: Child,
    nodes: BTreeMap<String, Child>,
    /// The port for workers of the server that uses it.
    worker_port: u16,
    _ports: Vec<TcpSocket>,
    /// Returns drained nodes to service; ends on drop.
    _operator: JoinSet<()>,
}

/// A job as squeue lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listed {
    pub id: String,
    pub state: String,
}

impl Cluster {
    /// Starts a cluster of nodes with one processor each, named node1 and so on. `None`, with a line that the test is
    /// skipped, where that is not possible.
    pub async fn start(nodes: usize) -> Option<Self> {
        let installed = |name: &&str| Path::new("/usr/sbin").join(name).exists();
        if !["slurmctld", "slurmd", "munged"].iter().all(installed) {
            skipped("Slurm is not installed (Debian: slurm-wlm and munge)");
            return None;
        }
        if !rustix::process::getuid().is_root() {
            skipped("a private Slurm needs root");
            return None;
        }
        let folder = tempfile::Builder::new().prefix("slurm").tempdir().unwrap();
        let held = held_ports(nodes + 2);
        let ports: Vec<u16> = held.iter().map(|socket| socket.local_addr().unwrap().port()).collect();
        let names: Vec<String> = (1..=nodes).map(|number| format!("node{number}")).collect();
        configure(folder.path(), &names, &ports);
        let munge = munge(folder.path());
        let socket = folder.path().join("munge.socket");
        until("munge listens", async || socket.exists().then_some(())).await;
        let controller = spawn(folder.path(), &["slurmctld", "-D"]);
        let nodes = names.iter().map(|name| (name.clone(), node(folder.path(), name))).collect();
        let mut operator = JoinSet::new();
        operator.spawn(resume_drained(folder.path().join("bin"), names.clone()));
        let (worker_port, _ports) = (ports[0], held);
        let cluster = Self { folder, _munge: munge, controller, nodes, worker_port, _ports, _operator: operator };
        cluster.until_idle(&names).await;
        Some(cluster)
    }

    /// The flags of a server that runs its jobs here. On a busy machine a worker may be silent for a while.
    pub fn flags(&self) -> Vec<String> {
        self.flags_with_silence("60")
    }

    /// As [`Self::flags`], for tests that kill nodes and wait until the server notices.
    pub fn flags_for_lost_nodes(&self) -> Vec<String> {
        self.flags_with_silence("8")
    }

    fn flags_with_silence(&self, seconds: &str) -> Vec<String> {
        let listen = format!("127.0.0.1:{}", self.worker_port);
        let bin = self.bin().display().to_string();
        let flags = ["--engine", "slurm", "--worker-listen", &listen, "--slurm-bin", &bin, "--slurm-poll-seconds", "1"];
        let limits = ["--worker-silence-seconds", seconds, "--workers", "4"];
        flags.iter().chain(&limits).map(|&flag| flag.to_owned()).collect()
    }

    /// The folder of its commands.
    fn bin(&self) -> PathBuf {
        self.folder.path().join("bin")
    }

    /// Replaces a command by a script, in which `REAL` is the command itself.
    pub fn replace(&self, command: &str, script: &str) {
        let real = self.bin().join(format!("{command}.real"));
        let path = self.bin().join(command);
        if !real.exists() {
            fs::copy(&path, &real).unwrap();
        }
        program(&path, &script.replace("REAL", &real.display().to_string()));
    }

    /// Kills a node with all that runs there.
    pub async fn kill_node(&mut self, name: &str) {
        self.nodes.remove(name).unwrap().kill().await.unwrap();
    }

    /// Starts a node that was killed.
    pub fn revive(&mut self, name: &str) {
        self.nodes.insert(name.to_owned(), node(self.folder.path(), name));
    }

    /// The nodes that are up.
    pub fn up(&self) -> Vec<String> {
        self.nodes.keys().cloned().collect()
    }

    pub async fn kill_controller(&mut self) {
        self.controller.kill().await.unwrap();
    }

    /// Starts the controller that was killed, and waits until it answers.
    pub async fn start_controller(&mut self) {
        self.controller = spawn(self.folder.path(), &["slurmctld", "-D"]);
        until("the controller answers", async || self.run("squeue", &["--noheader"]).await).await;
    }

    /// Kills the workers on all nodes.
    pub fn kill_workers(&self) {
        let address = format!("http://127.0.0.1:{}", self.worker_port);
        let processes =
            fs::read_dir("/proc").unwrap().filter_map(|entry| entry.unwrap().file_name().to_str()?.parse().ok());
        for process in processes {
            let command = fs::read(format!("/proc/{process}/cmdline")).unwrap_or_default();
            let words: Vec<&[u8]> = command.split(|&byte| byte == 0).collect();
            if words[0].ends_with(b"gleaner-worker-under-test") && words.contains(&address.as_bytes()) {
                // A worker that has ended meanwhile is gone.
                let _ = try_signal(process, Signal::KILL);
            }
        }
    }

    /// Submits another user's job of one second, which takes a node from a job of the partition `low`.
    pub async fn preempt(&self) {
        self.run("sbatch", &["--partition=all", "--output=/dev/null", "--wrap=sleep 1"]).await.unwrap();
    }

    /// Waits until these nodes are idle.
    pub async fn until_idle(&self, names: &[String]) {
        let idle = async || {
            let nodes = self.run("sinfo", &["--noheader", "--Node", "--states=idle", "--format=%N"]).await?;
            names.iter().all(|name| nodes.lines().any(|node| node == name)).then_some(())
        };
        until("the nodes are idle", idle).await;
    }

    /// Every job, ended ones too.
    pub async fn jobs(&self) -> Vec<Listed> {
        let listed = self.run("squeue", &["--noheader", "--states=all", "--format=%i|%T"]).await.unwrap();
        let job = |line: &str| {
            let (id, state) = line.split_once('|').unwrap();
            Listed { id: id.to_owned(), state: state.to_owned() }
        };
        listed.lines().map(job).collect()
    }

    /// Waits until no job waits or runs.
    pub async fn until_empty(&self) {
        let alive = ["PENDING", "CONFIGURING", "RUNNING", "COMPLETING"];
        let empty = async || {
            let jobs = self.jobs().await;
            (!jobs.iter().any(|job| alive.contains(&job.state.as_str()))).then_some(())
        };
        until("no Slurm job is left", empty).await;
    }

    /// The output of a command, if it succeeds.
    async fn run(&self, command: &str, arguments: &[&str]) -> Option<String> {
        let output = Command::new(self.bin().join(command)).args(arguments).output().await.unwrap();
        output.status.success().then(|| String::from_utf8(output.stdout).unwrap())
    }
}

/// Returns drained nodes to service, as an operator does: a restarted controller may start a job again that it started just
/// before its end, and drains the node where that job runs.
async fn resume_drained(bin: PathBuf, names: Vec<String>) {
    let mut ticks = tokio::time::interval(Duration::from_secs(1));
    loop {
        ticks.tick().await;
        let drained = ["--noheader", "--Node", "--states=drain", "--format=%N"];
        let Ok(output) = Command::new(bin.join("sinfo")).args(drained).output().await else { return };
        let drained = String::from_utf8_lossy(&output.stdout).into_owned();
        for name in names.iter().filter(|name| drained.lines().any(|line| line == name.as_str())) {
            let resume = ["update", &format!("nodename={name}"), "state=resume"];
            // The controller may be away.
            let _ = Command::new(bin.join("scontrol")).args(resume).output().await;
        }
    }
}

/// Ports that the system gives to no other program while their sockets are open. A program that names one, and sets
/// SO_REUSEADDR as all of these do, listens on it: the sockets do not listen themselves.
fn held_ports(count: usize) -> Vec<TcpSocket> {
    let held = |_| {
        let socket = TcpSocket::new_v4().unwrap();
        socket.set_reuseaddr(true).unwrap();
        socket.bind(([127, 0, 0, 1], 0).into()).unwrap();
        socket
    };
    (0..count).map(held).collect()
}

/// Writes the configuration, the key and the commands. The first port is the server's, the second the controller's.
fn configure(folder: &Path, names: &[String], ports: &[u16]) {
    let dir = folder.display();
    for name in ["state", "bin"] {
        fs::create_dir(folder.join(name)).unwrap();
    }
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap();
    let host = host.trim().split('.').next().unwrap();
    let mut text = format!(
        "ClusterName=test\nSlurmctldHost={host}(127.0.0.1)\nSlurmctldPort={}\nSlurmUser=root\nSlurmdUser=root\n\
         AuthType=auth/munge\nAuthInfo=socket={dir}/munge.socket,cred_expire=5\nCredType=cred/munge\n\
         StateSaveLocation={dir}/state\nSlurmdSpoolDir={dir}/%n\nSlurmctldPidFile={dir}/slurmctld.pid\n\
         SlurmdPidFile={dir}/%n.pid\nSlurmctldLogFile={dir}/slurmctld.log\nSlurmdLogFile={dir}/%n.log\n\
         ProctrackType=proctrack/linuxproc\nTaskPlugin=task/none\nMpiDefault=none\n\
         JobAcctGatherType=jobacct_gather/none\nSelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\n\
         SchedulerParameters=batch_sched_delay=0,bf_interval=2\nSlurmdParameters=config_overrides\n\
         ReturnToService=2\nSlurmdTimeout=10\nKillWait=30\nPreemptType=preempt/partition_prio\nPreemptMode=CANCEL\n\
         PartitionName=all Nodes=ALL Default=YES PriorityTier=10 State=UP\n\
         PartitionName=low Nodes=ALL PriorityTier=1 State=UP\n",
        ports[1]
    );
    for (name, port) in names.iter().zip(&ports[2..]) {
        fs::create_dir(folder.join(name)).unwrap();
        text += &format!("NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=1 RealMemory=4096\n");
    }
    fs::write(folder.join("slurm.conf"), text).unwrap();
    fs::write(folder.join("munge.key"), rand::random::<[u8; 32]>().repeat(4)).unwrap();
    fs::set_permissions(folder.join("munge.key"), fs::Permissions::from_mode(0o400)).unwrap();
    for command in COMMANDS {
        program(
            &folder.join("bin").join(command),
            &format!("export SLURM_CONF={dir}/slurm.conf\nexec /usr/bin/{command} \"$@\""),
        );
    }
}

/// Writes a shell script that replaces an earlier one at once.
fn program(path: &Path, script: &str) {
    let new = path.with_extension("new");
    // Another process writes it: a file that this process has open for writing cannot run.
    let mut writer = std::process::Command::new("sh");
    writer.args(["-c", "printf '#!/bin/sh\\n%s\\n' \"$2\" > \"$1\" && chmod 755 \"$1\" && mv \"$1\" \"$0\""]);
    assert!(writer.arg(path).arg(&new).arg(script).status().unwrap().success());
}

fn munge(folder: &Path) -> Child {
    let file = |name: &str| folder.join(name).display().to_string();
    let mut command = Command::new("munged");
    command.args(["--foreground", "--force", "--key-file", &file("munge.key"), "--socket", &file("munge.socket")]);
    command.args([
        "--pid-file",
        &file("munge.pid"),
        "--log-file",
        &file("munge.log"),
        "--seed-file",
        &file("munge.seed"),
    ]);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).kill_on_drop(true).spawn().unwrap()
}

fn node(folder: &Path, name: &str) -> Child {
    let namespace = ["unshare", "--pid", "--fork", "--mount-proc", "--kill-child=KILL"];
    spawn(folder, &[&namespace[..], &["slurmd", "-D", "-N", name]].concat())
}

fn spawn(folder: &Path, words: &[&str]) -> Child {
    let mut command = Command::new(words[0]);
    command.args(&words[1..]).env("SLURM_CONF", folder.join("slurm.conf")).kill_on_drop(true);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}
