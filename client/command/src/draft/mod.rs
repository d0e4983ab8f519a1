//! The draft of a task: cameras, fields, rate and mappings, guessed from surveys of its recordings, each with its reason.
//!
//! Pure code: it reads no recording and knows no server.

mod actions;
mod cameras;
mod candidate;
mod fields;
mod intake;
mod limits;
mod measured;
mod orders;
mod repeats;
mod role;
mod still;
#[cfg(test)]
mod tests;
mod tokens;
mod units;
mod way;
mod write;

use std::collections::BTreeSet;

use gleaner_recording::{Mapping, Survey, TaskSpec, rounded_rate};

use crate::words::{counted, some};

pub(crate) use intake::of_description;

use actions::Actions;
use cameras::Camera;
use candidate::{Candidate, LeftOut};
use fields::Field;
use way::{Way, WayTopic};

/// Commands faster than the slowest camera by more than this are sampled by its pictures; slower ones are steps of their own,
/// because a robot takes each.
const FASTER: f64 = 2.0;
/// The slowest camera is noted as slower than the commands from this on.
const NOTED: f64 = 1.2;

/// What the caller knows better than a guess.
#[derive(Debug, Default)]
pub(crate) struct Known {
    /// The task's name.
    pub(crate) name: String,
    /// Topics of the action; empty: those that look like commands.
    pub(crate) action: Vec<String>,
}

/// A drafted task with its reasons.
#[derive(Debug)]
pub(crate) struct Draft {
    pub(crate) spec: TaskSpec,
    /// What it was drafted from.
    origin: String,
    rate: String,
    cameras: Vec<Camera>,
    fields: Vec<Field>,
    left_out: Vec<LeftOut>,
}

/// Drafts a task from what its recordings hold.
///
/// # Errors
/// A sentence with the fix if no topic can be the action, or the named one is not there.
pub(crate) fn draft<'a>(surveys: impl IntoIterator<Item = &'a Survey>, known: &Known) -> Result<Draft, String> {
    let ways = way::ways(surveys);
    let mut left_out = Vec::new();
    let mut candidates: Vec<Vec<Candidate>> =
        ways.iter().map(|way| candidate::candidates(way, &mut left_out)).collect();
    for of_way in &mut candidates {
        role::settle(of_way);
        if known.action.is_empty() {
            role::settle_messages(of_way);
        }
    }
    // The caller knows the actions, and in several ways a switch may be one in a part of them only.
    if let ([of_way], []) = (candidates.as_mut_slice(), known.action.as_slice()) {
        role::settle_switches(of_way);
    }
    for topic in &known.action {
        if !candidates.iter().flatten().any(|candidate| candidate.topic == *topic) {
            return Err(format!("--action {topic}: no recording has numbers on this topic; {}", topics(&candidates)));
        }
    }
    let actions = Actions { named: &known.action, least: actions::certain(&candidates) };
    if !candidates.iter().all(|of_way| of_way.iter().any(|candidate| actions.has(candidate))) {
        let problem = "no topic of every recording looks like the commands of the robot";
        return Err(format!("{problem}; name them with --action TOPIC: {}", topics(&candidates)));
    }
    let cameras = cameras::cameras(&ways, &mut left_out);
    for (way, of_way) in ways.iter().zip(&mut candidates) {
        repeats::leave_out_commands(&way.name, of_way, &actions, &mut left_out);
    }
    let mut fields = fields::fields(&ways, candidates, &actions, &mut left_out);
    repeats::set_rates_aside(&mut fields);
    repeats::note_fingers(&mut fields);
    if !fields.iter().any(|field| field.action) {
        let problem = "the recordings have no commands in common: draft a task from recordings of one kind, and add the \
                       mapping of the other by hand";
        return Err(problem.to_owned());
    }
    let Pace { rate_hz, by_pictures, reason: rate } = pace(&ways, &cameras, &fields);
    let taken = || fields.iter().filter(|field| !field.is_aside);
    let of = |action: bool| taken().filter(move |field| field.action == action).map(|field| field.spec.clone());
    let mappings = ways.iter().enumerate().map(|(at, way)| Mapping {
        name: way.name.clone(),
        cameras: cameras.iter().filter_map(|camera| camera.sources.get(at).cloned()).collect(),
        fields: taken().filter_map(|field| field.sources.get(at).cloned()).collect(),
        clock: if by_pictures {
            slowest(way, &cameras, at).map(|(topic, _)| topic.to_owned())
        } else {
            commands(&fields, at)
        },
    });
    let spec = TaskSpec {
        name: known.name.clone(),
        instruction: String::new(),
        openpi: Vec::new(),
        rate_hz,
        cameras: cameras.iter().map(|camera| camera.spec.clone()).collect(),
        proprioception: of(false).collect(),
        action: of(true).collect(),
        alignment: gleaner_recording::Alignment::default(),
        tolerance: 0.25,
        mappings: mappings.collect(),
    };
    let origin =
        ways.iter().map(|way| format!("{} as `{}`", counted(way.recordings, "recording", "recordings"), way.name));
    let origin = origin.collect::<Vec<_>>().join(" and ");
    Ok(Draft { spec, origin, rate, cameras, fields, left_out })
}

impl Draft {
    /// What a reader has to look at, because recordings do not show it.
    fn decisions(&self) -> Vec<String> {
        let taken = self.fields.iter().filter(|field| !field.is_aside);
        let observed = taken.filter(|field| field.action && field.observed);
        let observed: Vec<String> = observed.map(|field| field.spec.name.clone()).collect();
        let limits = (!observed.is_empty()).then(|| format!("the limits of {}", some(&observed)));
        let scaled = self.cameras.iter().any(|camera| camera.spec.recorded.is_some());
        let sizes = scaled.then(|| "the size of pictures".to_owned());
        let decisions = [Some("the name".to_owned()), limits, sizes, Some("what a policy observes".to_owned())];
        decisions.into_iter().flatten().collect()
    }

    /// What a reader should not overlook, as sentences.
    pub(crate) fn doubts(&self) -> Vec<String> {
        let mut doubts = Vec::new();
        if self.cameras.is_empty() {
            doubts.push(
                "the task has no cameras: \"Left out\" at the end of the draft has the topics that might be".into(),
            );
        }
        let sources = |action: bool| {
            let fields = self.fields.iter().filter(move |field| field.action == action && !field.is_aside);
            fields.flat_map(|field| field.sources.iter().map(move |source| (field, source)))
        };
        for (field, source) in sources(false).filter(|(field, _)| field.open) {
            let (topic, own) = (&source.topic, &field.spec.name);
            let Some((command, _)) = sources(true).find(|(_, of_action)| of_action.topic == *topic) else {
                let topics: BTreeSet<&str> = sources(true).map(|(_, of_action)| of_action.topic.as_str()).collect();
                let named: Vec<String> =
                    topics.into_iter().chain([topic.as_str()]).map(|topic| format!("--action {topic}")).collect();
                doubts.push(format!(
                    "{own} of {topic} is on or off and an observation, so that no policy switches it: draft with {} if it is \
                     a command",
                    named.join(" ")
                ));
                continue;
            };
            let command = &command.spec.name;
            doubts.push(format!(
                "{own} is an observation although {command} of the same topic {topic} is an action: add --action {topic} if \
                 both are commands"
            ));
        }
        doubts
    }
}

/// The topics with numbers, for an error.
fn topics(candidates: &[Vec<Candidate>]) -> String {
    let mut topics: Vec<&str> = candidates.iter().flatten().map(|candidate| candidate.topic.as_str()).collect();
    topics.sort_unstable();
    topics.dedup();
    if topics.is_empty() {
        "no topic has numbers".to_owned()
    } else {
        format!("topics with numbers: {}", topics.join(", "))
    }
}

/// The topic of the commands: that of an action with stamps, of those the one with the most values.
fn commands(fields: &[Field], way: usize) -> Option<String> {
    let stamped = |field: &&Field| field.stamped.get(way).copied().unwrap_or_default();
    let actions = fields.iter().filter(|field| field.action);
    let best = actions.rev().max_by_key(|field| (stamped(field), field.spec.size))?;
    best.sources.get(way).map(|source| source.topic.clone())
}

/// One topic of each way, in words.
fn topics_of(ways: &[Way], of: impl Fn(usize, &Way) -> Option<String>) -> String {
    let mut topics: Vec<String> = ways.iter().enumerate().filter_map(|(at, way)| of(at, way)).collect();
    topics.dedup();
    topics.join(" or ")
}

fn rate_of(way: &Way, topic: &str) -> Option<f64> {
    let found = way.topics.iter().find(|known| known.found.topic == topic)?;
    let WayTopic { found, .. } = found;
    (found.rate_hz > 0.0).then_some(found.rate_hz)
}

/// The steps of a task.
struct Pace {
    rate_hz: f64,
    /// Whether a step begins with each picture of the slowest camera, and not with each command.
    by_pictures: bool,
    reason: String,
}

/// The slowest camera of a way: its topic and its rate.
fn slowest<'a>(way: &Way, cameras: &'a [Camera], at: usize) -> Option<(&'a str, f64)> {
    let rated = cameras.iter().filter_map(|camera| {
        let topic = camera.sources.get(at)?.color.as_str();
        Some((topic, rate_of(way, topic)?))
    });
    rated.min_by(|(_, one), (_, other)| one.total_cmp(other))
}

/// The pace of the steps: that of the commands, or of the slowest camera if that is slower.
fn pace(ways: &[Way], cameras: &[Camera], fields: &[Field]) -> Pace {
    let of_commands = |(at, way): (usize, &Way)| rate_of(way, &commands(fields, at)?);
    let commands = ways.iter().enumerate().filter_map(of_commands).reduce(f64::min);
    let of_cameras = |(at, way): (usize, &Way)| slowest(way, cameras, at).map(|(_, rate)| rate);
    let pictures = ways.iter().enumerate().filter_map(of_cameras).reduce(f64::min);
    let by_pictures = matches!((commands, pictures), (Some(commands), Some(pictures)) if commands > pictures * FASTER);
    let (rate_hz, reason) = match (commands, pictures) {
        (Some(commands), Some(pictures)) if by_pictures => (
            rounded_rate(pictures),
            format!(
                "Commands come at {commands:.1} Hz and the slowest camera at {pictures:.1} Hz: a step for each picture. For \
                 one for each command, take {:?} here and {} as `clock`; a picture then serves several steps.",
                rounded_rate(commands),
                topics_of(ways, |at, _| self::commands(fields, at)),
            ),
        ),
        (Some(commands), Some(pictures)) if commands > pictures * NOTED => (
            rounded_rate(commands),
            format!(
                "Commands come at {commands:.1} Hz: a step for each, so that a policy commands as often. The slowest camera \
                 has {pictures:.1} Hz, so a picture serves several steps. For a step for each picture, which trains faster \
                 and commands less often, take {:?} here and {} as `clock`.",
                rounded_rate(pictures),
                topics_of(ways, |at, way| slowest(way, cameras, at).map(|(topic, _)| topic.to_owned())),
            ),
        ),
        (Some(commands), _) => {
            (rounded_rate(commands), format!("Commands come at {commands:.1} Hz (median of the intervals)."))
        }
        (None, Some(pictures)) => (rounded_rate(pictures), format!("The slowest camera has {pictures:.1} Hz.")),
        (None, None) => (10.0, "No rate could be measured: correct it.".to_owned()),
    };
    Pace { rate_hz, by_pictures, reason }
}
