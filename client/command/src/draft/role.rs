//! Roles: which candidates of one topic are commands, by their own names and by those beside them, and which switches are.

use std::collections::BTreeSet;

use super::candidate::Candidate;
use super::measured::{Measured, is_sensed, measured};
use super::tokens::{self, Command};

/// Rates that differ by less than this share are the same: those of messages that one loop sends.
const SAME_RATE: f64 = 0.05;

/// Messages that robots receive rather than send.
const SENT: &[&str] = &[
    "AckermannDrive",
    "AckermannDriveStamped",
    "GripperCommand",
    "JointJog",
    "JointTrajectory",
    "JointTrajectoryPoint",
    "Twist",
    "TwistStamped",
];

/// Gives each candidate of a way its command, and marks those whose role is open.
pub(super) fn settle(candidates: &mut [Candidate]) {
    candidates.chunk_by_mut(|one, next| one.topic == next.topic).for_each(settle_topic);
}

/// Where no name is that of a command, a message that is sent to robots as a rule is one, unless its topic is named like a
/// measurement.
pub(super) fn settle_messages(candidates: &mut [Candidate]) {
    if candidates.iter().any(|candidate| candidate.command > Command::No) {
        return;
    }
    for candidate in candidates {
        let message = candidate.schema.rsplit(['/', '.']).next().unwrap_or_default();
        if SENT.contains(&message) && measured(&candidate.topic) == Measured::No {
            (candidate.command, candidate.sent) = (Command::Yes, true);
        }
    }
}

/// A switch on a topic of its own that comes as often as certain commands is one of them, because what a robot measures has
/// other rates as a rule; so is one in a namespace of commands in which nothing is measured. The role of others is open.
pub(super) fn settle_switches(candidates: &mut [Candidate]) {
    let commands: Vec<(String, f64)> = candidates
        .iter()
        .filter(|candidate| candidate.command == Command::Yes)
        .map(|candidate| (candidate.topic.clone(), candidate.rate_hz))
        .collect();
    let is_measured = |candidate: &&Candidate| {
        candidate.command == Command::No
            && [&candidate.path, &candidate.topic].iter().any(|name| measured(name) > Measured::No)
    };
    let with_states: BTreeSet<String> =
        candidates.iter().filter(is_measured).map(|candidate| namespace(&candidate.topic).to_owned()).collect();
    for of_topic in candidates.chunk_by_mut(|one, next| one.topic == next.topic) {
        let [candidate] = of_topic else { continue };
        let names = [&candidate.path, &candidate.topic];
        let is_open = candidate.command == Command::No && names.iter().all(|name| measured(name) == Measured::No);
        if is_open && is_switch(candidate) && !names.iter().any(|name| is_sensed(name)) {
            let alike = |rate: f64| (rate - candidate.rate_hz).abs() < SAME_RATE * rate;
            let own = namespace(&candidate.topic);
            let beside = |topic: &str| !own.is_empty() && namespace(topic) == own && !with_states.contains(own);
            let as_often = commands.iter().find(|(_, rate)| alike(*rate));
            candidate.alongside = if let Some((topic, _)) = as_often {
                Some(format!("comes as often as {topic}"))
            } else {
                let of_commands = commands.iter().find(|(topic, _)| beside(topic));
                of_commands.map(|(topic, _)| format!("shares {own} with {topic} and nothing that is measured"))
            };
            if candidate.alongside.is_some() {
                candidate.command = Command::Yes;
            } else {
                candidate.open = true;
            }
        }
    }
}

/// What a topic's name has before its last part; empty without such.
fn namespace(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(namespace, _)| namespace)
}

/// Whether it is one number that is 0 or 1, and was both.
fn is_switch(candidate: &Candidate) -> bool {
    candidate.orders.iter().all(|order| order.ranges.len() == 1)
        && matches!(candidate.values.as_slice(), [0.0, 1.0] | [1.0, 0.0])
}

fn settle_topic(candidates: &mut [Candidate]) {
    let Some(topic) = candidates.first().map(|candidate| candidate.topic.clone()) else { return };
    let own: Vec<Command> = candidates.iter().map(|candidate| tokens::command_word(&candidate.path)).collect();
    let states: Vec<Measured> = candidates.iter().map(|candidate| measured(&candidate.path)).collect();
    let of_topic = tokens::command_word(&topic);
    let by_path = own.iter().copied().max().unwrap_or(Command::No);
    // A topic that is named like commands holds some.
    let others = by_path > Command::No || states.iter().any(|state| *state < Measured::Yes);
    // Commands that are named so in their paths leave the rest of the topic to measurements.
    let named = by_path > Command::No && by_path >= of_topic;
    for ((candidate, own), state) in candidates.iter_mut().zip(&own).zip(&states) {
        candidate.command = match (own, state) {
            (Command::Yes | Command::Perhaps, _) => (*own).max(of_topic),
            (Command::No, Measured::Yes) if others => Command::No,
            (Command::No, Measured::Perhaps) if named => Command::No,
            (Command::No, _) => of_topic,
        };
    }
    let strongest = candidates.iter().map(|candidate| candidate.command).max().unwrap_or(Command::No);
    if strongest == Command::No {
        return;
    }
    let mixed = tokens::is_container(&topic);
    let of_states = measured(&topic) == Measured::Yes;
    for at in 0..candidates.len() {
        if candidates[at].command == strongest {
            continue;
        }
        let weak = strongest < Command::Yes && sibling(candidates, at, strongest);
        let beside = match (own[at], states[at]) {
            // A pose beside a target may be the pose that is wanted; beside an action it is measured.
            (Command::No, Measured::Perhaps) if weak => Beside::Both,
            (Command::No, Measured::Perhaps | Measured::Yes) => Beside::States,
            _ => beside(candidates, &states, at, strongest),
        };
        match beside {
            Beside::Commands { in_all: true, .. } if of_states => {}
            Beside::Commands { in_all: true, .. } if mixed => candidates[at].open = true,
            Beside::Commands { first, .. } => {
                candidates[at].command = strongest;
                candidates[at].beside = Some(first);
            }
            Beside::Both => candidates[at].open = true,
            Beside::States => {}
        }
    }
}

/// What the smallest part of a message around a candidate holds.
enum Beside {
    /// Commands alone; `in_all` if that part is the whole message.
    Commands {
        first: String,
        in_all: bool,
    },
    States,
    Both,
}

fn part(path: &str) -> &str {
    path.rsplit_once('.').map_or("", |(part, _)| part)
}

/// Whether a command has the same part of the message around it.
fn sibling(candidates: &[Candidate], at: usize, strongest: Command) -> bool {
    let around = part(&candidates[at].path);
    candidates.iter().any(|of| of.command == strongest && part(&of.path) == around)
}

fn beside(candidates: &[Candidate], states: &[Measured], at: usize, strongest: Command) -> Beside {
    let mut around = candidates[at].path.as_str();
    loop {
        around = part(around);
        let inside =
            |path: &str| around.is_empty() || path.strip_prefix(around).is_some_and(|rest| rest.starts_with('.'));
        let others =
            || candidates.iter().zip(states).enumerate().filter(|(other, (of, _))| *other != at && inside(&of.path));
        let first = others().find(|(_, (of, _))| of.command == strongest && of.beside.is_none());
        let measured = others().any(|(_, (of, state))| of.command == Command::No && *state > Measured::No);
        match (first, measured) {
            (Some((_, (of, _))), false) => {
                return Beside::Commands { first: of.path.clone(), in_all: around.is_empty() };
            }
            (Some(_), true) => return Beside::Both,
            (None, true) => return Beside::States,
            (None, false) if around.is_empty() => return Beside::States,
            (None, false) => {}
        }
    }
}
