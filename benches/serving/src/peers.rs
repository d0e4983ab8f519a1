//! The same network on the same weights behind other servers, in turns with ours: first that all give the same
//! actions, then what each costs.

use std::path::Path;

use gleaner_proto::v1::Observation;
use tokio::process::Command;

use crate::Result;
use crate::cli::Options;
use crate::door::{Address, Door};
use crate::load::Load;
use crate::prepare::Prepared;
use crate::process::Program;
use crate::report::{Asked, PeerRow, Report, say};
use crate::scene::{Images, observe};

const OURS: &str = "gleaner";
/// A peer's name and program.
const PEERS: [(&str, &str); 2] = [("grpc.aio", "serve_grpc.py"), ("WebSocket", "serve_websocket.py")];
/// What two actions may differ by.
const TOLERANCE: f32 = 1e-4;
/// Sessions at a time: one for latency, many for throughput.
const MANY: usize = 16;
/// A peer's median in ours with one session; our throughput in a peer's with many.
const FASTER: f64 = 3.0;
const MORE: f64 = 4.0;

/// One server with its sessions and what they took.
struct Contender {
    name: &'static str,
    doors: Vec<Door>,
    one: Load,
    many: Load,
}

/// Measures ours and each peer in turns, on raw images.
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
    say(&format!("every server gives the same actions within {worst:.0e}"));
    for _ in 0..options.rounds {
        for Contender { doors, one, many, .. } in &mut contenders {
            one.add(&mut doors[..1], &scene, options.slice()).await?;
            many.add(doors, &scene, options.slice()).await?;
        }
    }
    tell(&contenders, report);
    drop(contenders);
    for program in programs {
        program.stop().await?;
    }
    Ok(())
}

impl Contender {
    async fn open(name: &'static str, address: &Address) -> Result<Self> {
        let doors = Door::open_many(address, MANY).await?;
        Ok(Self { name, doors, one: Load::default(), many: Load::default() })
    }
}

/// Has all answer the same observations, each on top of those before; the largest difference of any value to ours.
async fn compare(contenders: &mut [Contender], scene: &[Observation]) -> Result<f32> {
    let mut worst = 0.0f32;
    for observation in scene {
        let mut ours: Option<Vec<f32>> = None;
        for Contender { name, doors, .. } in &mut *contenders {
            let action = doors.first_mut().ok_or("no session")?.act(observation).await?.action;
            let ours = ours.get_or_insert_with(|| action.clone());
            let differences = || ours.iter().zip(&action).map(|(a, b)| (a - b).abs());
            if action.len() != ours.len() || !differences().all(|difference| difference <= TOLERANCE) {
                return Err(format!("{name} serves another policy: it says {action:?}, ours {ours:?}").into());
            }
            worst = differences().fold(worst, f32::max);
        }
    }
    Ok(worst)
}

fn tell(contenders: &[Contender], report: &mut Report) {
    let rows: Vec<_> = contenders.iter().map(|each| (each.name, each.one.summary(), each.many.summary())).collect();
    if let Some(((_, one, many), peers)) = rows.split_first() {
        for (name, peer_one, peer_many) in peers {
            let asked = Asked::least(&format!("p50 of {name} / ours, 1 session"), FASTER);
            report.target(asked, peer_one.p50 / one.p50);
            let asked = Asked::least(&format!("our throughput / that of {name}, {MANY} sessions"), MORE);
            report.target(asked, many.actions_per_second / peer_many.actions_per_second);
        }
    }
    for (server, one, many) in rows {
        report.peers.push(PeerRow { server, sessions: 1, load: one });
        report.peers.push(PeerRow { server, sessions: MANY, load: many });
    }
}
