//! The kills: every second one at a random moment, every other one at a fail point, each point in its turn. After each
//! the server is started where it was, and what is acknowledged is looked for at once.

use std::{
    collections::BTreeMap,
    fmt,
    time::{Duration, Instant},
};

use gleaner_server::fail_point;
use rand::{RngExt as _, rngs::StdRng, seq::SliceRandom as _};

use super::{Settings, check, lab::Lab, load::Load};
use crate::server::TestServer;

/// How long a server may live that is to die at a fail point. One that nobody passes is killed then.
const PATIENCE: Duration = Duration::from_secs(20);

/// How many kills there were of each kind.
#[derive(Debug, Default)]
pub struct Tally {
    at_random: usize,
    at_points: BTreeMap<&'static str, usize>,
    not_passed: Vec<&'static str>,
    /// From the start of a process until it listens.
    restarts: Vec<Duration>,
}

enum Way {
    AtRandom,
    At(&'static str, u32),
}

/// Kills the server as often as the settings say.
pub async fn run(server: &mut TestServer, lab: &Lab, load: &mut Load) -> Tally {
    let Settings { kills, uploads, .. } = lab.settings;
    let (mut tally, mut random) = (Tally::default(), lab.settings.random(2));
    let mut points: Vec<&'static str> = Vec::new();
    // The first one is alive, so that it can't die at a point.
    let mut way = Way::AtRandom;
    for kill in 0..kills {
        lab.due.send_replace(uploads * (kill as u64 + 1) / kills as u64);
        let died_at = die(server, lab, &way, &mut random).await;
        match died_at {
            Some(point) => *tally.at_points.entry(point).or_default() += 1,
            None => tally.at_random += 1,
        }
        if let (Way::At(point, _), None) = (&way, died_at) {
            tally.not_passed.push(*point);
        }
        eprintln!("kill {}: {}", kill + 1, died_at.unwrap_or("at random"));
        way = next_way(kill, &mut points, &mut random);
        revive(server, lab, &mut way, &mut tally).await;
        load.expect_sound();
    }
    lab.due.send_replace(uploads);
    // Whatever it was to die at: from now on it lives.
    server.kill().await;
    assert!(server.start_where_it_was(None).await);
    tally
}

fn next_way(kill: usize, points: &mut Vec<&'static str>, random: &mut StdRng) -> Way {
    if kill % 2 == 1 {
        return Way::AtRandom;
    }
    if points.is_empty() {
        points.extend(fail_point::NAMES);
        points.shuffle(random);
    }
    // Some are passed often: not always the first time.
    points.pop().map_or(Way::AtRandom, |point| {
        let often = ["upload.", "blob.", "frames.", "episode."].iter().any(|room| point.starts_with(room));
        Way::At(point, if often && !point.ends_with("removed") { random.random_range(1..=4) } else { 1 })
    })
}

/// Waits until it has died, at the point that it was to die at, or kills it.
async fn die(server: &mut TestServer, lab: &Lab, way: &Way, random: &mut StdRng) -> Option<&'static str> {
    match way {
        Way::At(point, _) => {
            if tokio::time::timeout(PATIENCE, server.died()).await.is_ok() {
                return Some(*point);
            }
        }
        Way::AtRandom => {
            let mut acknowledged = lab.ledger.acknowledged();
            let enough = *acknowledged.borrow() + random.random_range(1..10);
            let moment = Duration::from_millis(random.random_range(0..400));
            // Less than that in this time: all the more is under way.
            let _ = tokio::time::timeout(PATIENCE / 4, acknowledged.wait_for(|count| *count >= enough)).await;
            let died = tokio::time::timeout(moment, server.died()).await;
            assert!(died.is_err(), "the server died by itself");
        }
    }
    server.kill().await;
    None
}

/// Starts it again. One that dies again before it listens, because what it is to die at is on that way, counts.
async fn revive(server: &mut TestServer, lab: &Lab, way: &mut Way, tally: &mut Tally) {
    let begun = Instant::now();
    let fail_point = match way {
        Way::AtRandom => None,
        Way::At(point, passing) => Some(format!("{point}={passing}")),
    };
    if !server.start_where_it_was(fail_point.as_deref()).await {
        let Way::At(point, _) = way else { panic!("the server ended before it listened") };
        *tally.at_points.entry(*point).or_default() += 1;
        *way = Way::AtRandom;
        assert!(server.start_where_it_was(None).await, "the server ended before it listened");
    }
    tally.restarts.push(begun.elapsed());
    lab.lives.send_modify(|lives| *lives += 1);
    // Cut off by the next death, it is done again after that one.
    let _ = check::sample(lab).await;
}

impl Tally {
    /// In the long form every point there is has its turn, and few are never passed.
    pub fn is_what_was_asked(&self, settings: &Settings) {
        let at_points: usize = self.at_points.values().sum();
        assert!(at_points + self.at_random >= settings.kills);
        if settings.kills >= 2 * fail_point::NAMES.len() {
            assert!(self.at_points.len() >= 40, "only {} fail points were died at", self.at_points.len());
        }
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let at_points: usize = self.at_points.values().sum();
        let longest = self.restarts.iter().max().copied().unwrap_or_default();
        let mean = self.restarts.iter().sum::<Duration>().checked_div(u32::try_from(self.restarts.len()).unwrap_or(1));
        write!(
            f,
            "{} kills: {} at random, {at_points} at {} of {} fail points; not passed in time: {:?}; back within {:.1} s \
             (on average {:.1} s)",
            at_points + self.at_random,
            self.at_random,
            self.at_points.len(),
            fail_point::NAMES.len(),
            self.not_passed,
            longest.as_secs_f64(),
            mean.unwrap_or_default().as_secs_f64(),
        )
    }
}
