//! The same network with the same weights on other servers, alternately with gleaner: first a check that all return the
//! same actions, then the cost of each.

use std::path::Path;

use gleaner_proto::v1::Observation;
use tokio::process::Command;

use crate::Result;
use crate::cli::{Kind, Options};
use crate::connection::{Address, Connection};
use crate::load::Load;
use crate::prepare::Prepared;
use crate::process::Program;
use crate::report::{Bound, PeerRow, Report, progress};
use crate::scene::{Images, observe};

const OURS: &str = "gleaner";
/// A peer's name and program.
const PEERS: [(&str, &str); 2] = [("grpc.aio", "serve_grpc.py"), ("WebSocket", "serve_websocket.py")];
/// The largest difference of two actions.
const TOLERANCE: f32 = 1e-4;
/// Sessions at a time: one for latency, many for throughput.
const MANY: usize = 16;
/// The smallest ratio of a peer's median to gleaner's with one session, and of the throughputs with many.
const FASTER: f64 = 3.0;
const MORE: f64 = 4.0;

/// A server with its sessions and their times.
struct Contender {
    name: &'static str,
    connections: Vec<Connection>,
    one: Load,
    many: Load,
}

/// Measures gleaner and each peer alternately, with raw images.
pub async fn beside_peers(options: &Options, prepared: &Prepared, folder: &Path, report: &mut Report) -> Result<()> {
    let checkpoint = folder.join("policy.safetensors");
    std::fs::write(&checkpoint, &prepared.checkpoint)?;
    let mut programs = Vec::new();
    let mut contenders = vec![Contender::open(OURS, &prepared.address).await?];
    for (name, program) in PEERS {
        let mut command = Command::new(&options.python);
        command.arg("-B").arg(options.peers.join(program)).arg("--checkpoint").arg(&checkpoint);
        command.env("PYTHONPATH", &options.peers_generated);
        let peer = Program::start(command, &folder.join(format!("{program}.log"))).await?;
        let url = peer.url().to_owned();
        let address = if url.starts_with("ws:") {
            Address::WebSocket { url }
        } else {
            Address::Session { url, deployment: String::new() }
        };
        contenders.push(Contender::open(name, &address).await?);
        programs.push(peer);
    }
    let scene =
        prepared.steps.iter().map(|step| observe(&prepared.spec, step, Images::Raw)).collect::<Result<Vec<_>>>()?;
    let worst = compare(&mut contenders, &scene).await?;
    progress(&format!("every server gives the same actions within {worst:.0e}"));
    for _ in 0..options.rounds {
        for Contender { connections, one, many, .. } in &mut contenders {
            one.add(&mut connections[..1], &scene, options.slice()).await?;
            many.add(connections, &scene, options.slice()).await?;
        }
    }
    add_rows(&contenders, options.policy, report);
    drop(contenders);
    for program in programs {
        program.stop().await?;
    }
    Ok(())
}

impl Contender {
    async fn open(name: &'static str, address: &Address) -> Result<Self> {
        let connections = Connection::open_many(address, MANY).await?;
        Ok(Self { name, connections, one: Load::default(), many: Load::default() })
    }
}

/// Sends the same sequence of observations to every server; returns the largest difference of any value to gleaner's.
async fn compare(contenders: &mut [Contender], scene: &[Observation]) -> Result<f32> {
    let mut worst = 0.0f32;
    for observation in scene {
        let mut ours: Option<Vec<f32>> = None;
        for Contender { name, connections, .. } in &mut *contenders {
            let action = connections.first_mut().ok_or("no session")?.act(observation).await?.action;
            let ours = ours.get_or_insert_with(|| action.clone());
            let differences = || ours.iter().zip(&action).map(|(a, b)| (a - b).abs());
            if action.len() != ours.len() || !differences().all(|difference| difference <= TOLERANCE) {
                return Err(format!("{name} returns another action: {action:?}, gleaner {ours:?}").into());
            }
            worst = differences().fold(worst, f32::max);
        }
    }
    Ok(worst)
}

/// A policy that draws chunks answers most observations from the chunk it has, so the median of one session does not depend on
/// its model and has no target.
fn add_rows(contenders: &[Contender], policy: Kind, report: &mut Report) {
    let rows: Vec<_> = contenders.iter().map(|each| (each.name, each.one.summary(), each.many.summary())).collect();
    if let Some(((_, one, many), peers)) = rows.split_first() {
        for (name, peer_one, peer_many) in peers {
            if policy == Kind::Finetune {
                let bound = Bound::at_least(&format!("p50 of {name} / gleaner, 1 session"), FASTER);
                report.target(bound, peer_one.p50 / one.p50);
            }
            let bound = Bound::at_least(&format!("throughput of gleaner / {name}, {MANY} sessions"), MORE);
            report.target(bound, many.actions_per_second / peer_many.actions_per_second);
        }
    }
    for (server, one, many) in rows {
        report.peers.push(PeerRow { server, sessions: 1, load: one });
        report.peers.push(PeerRow { server, sessions: MANY, load: many });
    }
}
