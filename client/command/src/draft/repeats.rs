//! What a step should not repeat: commands among its observations, and velocities and torques of joints whose positions it
//! has.
//!
//! Works on candidates and fields alone. A policy that sees a command may copy it and never change it.

use gleaner_recording::ValueRange;

use super::actions::Actions;
use super::candidate::{Candidate, LeftOut};
use super::fields::Field;
use super::measured::{self, Measured};
use super::tokens::{self, Command};

/// Bounds this near to each other, as a part of their size, are of the same values: recordings have 32 or 64 bits.
const EQUAL: f64 = 1e-6;
/// Bounds that different numbers often have in common: of commands and states that are normalised or have two values.
const COMMON: [f64; 3] = [-1.0, 0.0, 1.0];

/// Takes out of the candidates of a way commands that are not among the actions, and copies of actions.
pub(super) fn leave_out_commands(
    way: &str,
    candidates: &mut Vec<Candidate>,
    actions: &Actions<'_>,
    left_out: &mut Vec<LeftOut>,
) {
    let commands: Vec<Candidate> = candidates.iter().filter(|candidate| actions.has(candidate)).cloned().collect();
    candidates.retain(|candidate| {
        let why = if actions.has(candidate) { None } else { why_left_out(candidate, &commands) };
        let Some(reason) = why else { return true };
        let what = format!("{} {} ({way})", candidate.topic, candidate.orders[0].paths.join(" "));
        left_out.push(LeftOut { what, reason });
        false
    });
}

fn why_left_out(candidate: &Candidate, commands: &[Candidate]) -> Option<String> {
    let risk = "a policy may copy it and never change it";
    if let Some(command) = commands.iter().find(|command| is_copy(candidate, command)) {
        return Some(format!(
            "it repeats the action {} ({}), with the same values: {risk}",
            command.name, command.topic
        ));
    }
    (candidate.command > Command::No).then(|| {
        format!(
            "it is named like a command and no part of the action, and {risk}; add --action {} if the robot executes it",
            candidate.topic
        )
    })
}

/// Whether numbers are those of a command. What is named like a measurement can have the values of a command that the robot
/// follows exactly; a goal can be the command itself.
fn is_copy(candidate: &Candidate, command: &Candidate) -> bool {
    let names = [&candidate.path, &candidate.topic];
    let is_measured = names.iter().any(|name| measured::measured(name) > Measured::No);
    if is_measured && !names.iter().any(|name| tokens::is_goal(name)) {
        return false;
    }
    let alike = tokens::likeness(&candidate.name, &command.name) > 0.0;
    let (own, its) = (&candidate.orders[0].ranges, &command.orders[0].ranges);
    let near = |one: f64, other: f64| (one - other).abs() <= EQUAL * one.abs().max(other.abs()).max(1.0);
    let equal =
        |(one, other): (&ValueRange, &ValueRange)| near(one.minimum, other.minimum) && near(one.maximum, other.maximum);
    let mut bounds = own.iter().flat_map(|range| [range.minimum, range.maximum]);
    let rare = bounds.any(|bound| !COMMON.iter().any(|common| near(bound, *common)));
    let moves = own.iter().any(|range| range.maximum > range.minimum);
    own.len() == its.len() && own.iter().zip(its).all(equal) && moves && (alike || rare)
}

/// Sets velocities and torques of joints aside where the positions of the same joints are an observation too: the draft has
/// them as comments. They follow the command of the moment before, and a policy that repeats it never begins or ends a
/// movement of its own.
pub(super) fn set_rates_aside(fields: &mut [Field]) {
    let seen = |field: &&Field| !field.action && field.meaning == Some(measured::JOINT_POSITIONS);
    let positions: Vec<(String, Joints)> =
        fields.iter().filter(seen).map(|field| (field.spec.name.clone(), Joints::of(field))).collect();
    let rates = [measured::JOINT_VELOCITIES, measured::JOINT_TORQUES];
    let is_rate = |field: &&mut Field| !field.action && field.meaning.is_some_and(|meaning| rates.contains(&meaning));
    for field in fields.iter_mut().filter(is_rate) {
        let joints = Joints::of(field);
        let Some((positions, _)) = positions.iter().find(|(_, of_positions)| joints.are_of(of_positions)) else {
            continue;
        };
        field.is_aside = true;
        // Its place alone; how to change it matters to those that take it.
        field.reasons.truncate(1);
        field.reasons.push(format!(
            "Commented out beside {positions}: velocities and torques follow the last command, which a policy may repeat \
             instead of looking at the images. To take them, delete the # here and in the mappings."
        ));
    }
}

/// The joints of a field: their names, or where those are not known their number.
struct Joints {
    names: Vec<String>,
    size: u32,
}

impl Joints {
    fn of(field: &Field) -> Self {
        let names = field.sources.first().map(|source| source.names.clone());
        Self { names: names.unwrap_or_default(), size: field.spec.size }
    }

    /// Whether all of them are among the others.
    fn are_of(&self, others: &Self) -> bool {
        if self.names.is_empty() || others.names.is_empty() {
            return self.size == others.size;
        }
        self.names.iter().all(|name| others.names.contains(name))
    }
}

/// Notes which joints may repeat the command of a gripper.
pub(super) fn note_fingers(fields: &mut [Field]) {
    let is_gripper = |field: &&Field| field.action && field.meaning == Some(measured::GRIPPER);
    let Some(gripper) = fields.iter().find(is_gripper).map(|field| field.spec.name.clone()) else { return };
    let is_position = |field: &&mut Field| !field.action && field.meaning == Some(measured::JOINT_POSITIONS);
    for field in fields.iter_mut().filter(is_position) {
        let names = field.sources.first().map(|source| &source.names[..]).unwrap_or_default();
        let fingers: Vec<&str> = names
            .iter()
            .filter(|name| measured::meaning(name) == Some(measured::GRIPPER))
            .map(String::as_str)
            .collect();
        if !fingers.is_empty() {
            let note = format!(
                "{} may repeat the action {gripper}: keep it at first, and only if a policy never changes the gripper try a \
                 task of another name without it.",
                fingers.join(", ")
            );
            field.reasons.push(note);
        }
    }
}
