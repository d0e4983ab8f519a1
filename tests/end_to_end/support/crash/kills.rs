//! The kills: alternately at a random moment and at a fail point, each point in its turn. After each kill the server starts
//! on the same address, and every acknowledged change is checked at once.

use std::{
    collections::BTreeMap,
    fmt,
    time::{Duration, Instant},
};

use gleaner_server::fail_point;
use rand::{RngExt as _, rngs::StdRng, seq::SliceRandom as _};

use super::{Settings, check, lab::Lab, load::Load};
use crate::support::server::TestServer;

/// The longest life of a server with a fail point; it is killed then.
const LONGEST_LIFE: Duration = Duration::from_secs(20);

/// The number of kills of each kind.
#[derive(Debug, Default)]
pub struct Report {
    at_random: usize,
    at_points: BTreeMap<&'static str, usize>,
    not_reached: Vec<&'static str>,
    /// From the start of a process until it listens.
    restarts: Vec<Duration>,
}

enum Kill {
    AtRandom,
    At(&'static str, u32),
}

/// Kills the server as often as the settings require.
pub async fn run(server: &mut TestServer, lab: &Lab, load: &mut Load) -> Report {
    let Settings { kills, uploads, .. } = lab.settings;
    let (mut report, mut random) = (Report::default(), lab.settings.random(2));
    let mut points: Vec<&'static str> = Vec::new();
    // The first server is running, so it has no fail point.
    let mut kill = Kill::AtRandom;
    for number in 0..kills {
        lab.due.send_replace(uploads * (number as u64 + 1) / kills as u64);
        let died_at = die(server, lab, &kill, &mut random).await;
        match died_at {
            Some(point) => *report.at_points.entry(point).or_default() += 1,
            None => report.at_random += 1,
        }
        if let (Kill::At(point, _), None) = (&kill, died_at) {
            report.not_reached.push(*point);
        }
        eprintln!("kill {}: {}", number + 1, died_at.unwrap_or("at random"));
        kill = next_kill(number, &mut points, &mut random);
        revive(server, lab, &mut kill, &mut report).await;
        load.expect_running();
    }
    lab.due.send_replace(uploads);
    // The last server has no fail point.
    server.kill().await;
    assert!(server.start_where_it_was(None).await);
    report
}

fn next_kill(number: usize, points: &mut Vec<&'static str>, random: &mut StdRng) -> Kill {
    if number % 2 == 1 {
        return Kill::AtRandom;
    }
    if points.is_empty() {
        points.extend(fail_point::NAMES);
        points.shuffle(random);
    }
    // Some points are reached often, so that the kill is not always at the first time.
    points.pop().map_or(Kill::AtRandom, |point| {
        let often = ["upload.", "blob.", "frames.", "episode."].iter().any(|room| point.starts_with(room));
        Kill::At(point, if often && !point.ends_with("removed") { random.random_range(1..=4) } else { 1 })
    })
}

/// Waits for its death at the fail point, or kills it.
async fn die(server: &mut TestServer, lab: &Lab, kill: &Kill, random: &mut StdRng) -> Option<&'static str> {
    match kill {
        Kill::At(point, _) => {
            if tokio::time::timeout(LONGEST_LIFE, server.ended()).await.is_ok() {
                return Some(*point);
            }
        }
        Kill::AtRandom => {
            let mut acknowledged = lab.ledger.count();
            let enough = *acknowledged.borrow() + random.random_range(1..10);
            let moment = Duration::from_millis(random.random_range(0..400));
            // On a slow machine there are fewer acknowledgements, and more calls in flight.
            let _ = tokio::time::timeout(LONGEST_LIFE / 4, acknowledged.wait_for(|count| *count >= enough)).await;
            let died = tokio::time::timeout(moment, server.ended()).await;
            assert!(died.is_err(), "the server ended without a kill");
        }
    }
    server.kill().await;
    None
}

/// Starts it again. A death before it listens, because the fail point is in the start, counts too.
async fn revive(server: &mut TestServer, lab: &Lab, kill: &mut Kill, report: &mut Report) {
    let begun = Instant::now();
    let fail_point = match kill {
        Kill::AtRandom => None,
        Kill::At(point, passing) => Some(format!("{point}={passing}")),
    };
    if !server.start_where_it_was(fail_point.as_deref()).await {
        let Kill::At(point, _) = kill else { panic!("the server ended before it listened") };
        *report.at_points.entry(*point).or_default() += 1;
        *kill = Kill::AtRandom;
        assert!(server.start_where_it_was(None).await, "the server ended before it listened");
    }
    report.restarts.push(begun.elapsed());
    lab.lives.send_modify(|lives| *lives += 1);
    // A check that the next death interrupts is repeated after it.
    let _ = check::sample(lab).await;
}

impl Report {
    /// Checks the number of kills; in the long form, also that most fail points were reached.
    pub fn expect_complete(&self, settings: &Settings) {
        let at_points: usize = self.at_points.values().sum();
        assert!(at_points + self.at_random >= settings.kills);
        if settings.kills >= 2 * fail_point::NAMES.len() {
            assert!(self.at_points.len() >= 40, "only {} fail points were reached", self.at_points.len());
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at_points: usize = self.at_points.values().sum();
        let longest = self.restarts.iter().max().copied().unwrap_or_default();
        let mean = self.restarts.iter().sum::<Duration>().checked_div(u32::try_from(self.restarts.len()).unwrap_or(1));
        write!(
            f,
            "{} kills: {} at random, {at_points} at {} of {} fail points; not reached in time: {:?}; back within {:.1} s \
             (on average {:.1} s)",
            at_points + self.at_random,
            self.at_random,
            self.at_points.len(),
            fail_point::NAMES.len(),
            self.not_reached,
            longest.as_secs_f64(),
            mean.unwrap_or_default().as_secs_f64(),
        )
    }
}
