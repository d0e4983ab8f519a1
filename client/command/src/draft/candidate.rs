//! Candidates: the numbers of a way that can be fields of a task, and the reasons why others cannot.
//!
//! Works on one way at a time.

use gleaner_recording::{FieldKind, SurveyedField, ValueRange};

use super::measured::meaning;
use super::tokens::{self, Command};
use super::way::{Way, WayTopic};

/// Most numbers of a field that is drafted.
const MAX_SIZE: usize = 256;
/// Last parts of paths to the parts of a vector, a rotation or a pose.
const AXES: &[&str] = &["x", "y", "z", "w", "rx", "ry", "rz", "qx", "qy", "qz", "qw", "roll", "pitch", "yaw"];
const VECTORS: &[&str] =
    &["position", "orientation", "linear", "angular", "translation", "rotation", "force", "torque"];
const ROTATIONS: &[&str] = &["orientation", "rotation"];

/// What becomes of a topic of transforms.
const POSES: &str = "it has the poses of frames: a field of size 7 takes one with `transform = { parent = \"base_link\", child = \"tool0\" }` in place of \
                    `paths`, in the names of your frames";

/// Numbers that can be a field.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) name: String,
    pub(super) topic: String,
    /// The name of the topic's schema.
    pub(super) schema: String,
    /// The path of its numbers, or the part that theirs have in common.
    pub(super) path: String,
    pub(super) stamped: bool,
    pub(super) command: Command,
    /// Messages per second of its topic.
    pub(super) rate_hz: f64,
    /// The path of a command of its topic by which it is one too.
    pub(super) beside: Option<String>,
    /// What a switch has in common with commands, by which it is one too, in words.
    pub(super) alongside: Option<String>,
    /// Whether its message is sent to robots as a rule, by which it is a command.
    pub(super) sent: bool,
    /// Whether it may as well be a command.
    pub(super) open: bool,
    /// Possible orders of its values, the likeliest first.
    pub(super) orders: Vec<Order>,
    /// All its different values, if there are at most two.
    pub(super) values: Vec<f64>,
}

impl Candidate {
    /// What its name means, in words.
    pub(super) fn meaning(&self) -> Option<&'static str> {
        [&self.path, &self.name, &self.topic].into_iter().find_map(|name| meaning(name))
    }
}

/// One order of a candidate's values.
#[derive(Clone, Debug)]
pub(super) struct Order {
    pub(super) paths: Vec<String>,
    pub(super) names: Vec<String>,
    pub(super) ranges: Vec<ValueRange>,
    /// What the order is.
    pub(super) reason: &'static str,
}

/// A value that cannot be a field, and the reason.
#[derive(Clone, Debug)]
pub(super) struct LeftOut {
    pub(super) what: String,
    pub(super) reason: String,
}

/// The candidates of a way, in the order of its topics.
pub(super) fn candidates(way: &Way, left_out: &mut Vec<LeftOut>) -> Vec<Candidate> {
    let mut found = Vec::new();
    for topic in &way.topics {
        let name = &topic.found.topic;
        let mut leave = |what: &str, reason: String| {
            let what = if what.is_empty() {
                format!("{name} ({})", way.name)
            } else {
                format!("{name} {what} ({})", way.name)
            };
            left_out.push(LeftOut { what, reason });
        };
        if let Some(camera) = &topic.found.camera {
            if camera.height == 0 {
                let problem = camera.problem.clone().unwrap_or_else(|| "no picture was found".to_owned());
                leave("", format!("its images cannot be read: {problem}"));
            }
        } else if let Some(problem) = &topic.found.problem {
            leave("", format!("{} messages cannot be read: {problem}", topic.found.unreadable));
        } else if tokens::has_transforms(&topic.found.schema) {
            leave("", POSES.to_owned());
        } else if tokens::is_foreign(&topic.found.schema) || name.starts_with("/gleaner/") {
            leave("", "it describes neither what the robot measures nor what it does".to_owned());
        } else if topic.recordings < way.recordings {
            leave("", format!("only {} of {} recordings have it", topic.recordings, way.recordings));
        } else {
            of_topic(topic, &mut found, &mut leave);
        }
    }
    found
}

fn of_topic(topic: &WayTopic, found: &mut Vec<Candidate>, leave: &mut dyn FnMut(&str, String)) {
    let mut groups: Vec<(String, Vec<&SurveyedField>)> = Vec::new();
    for field in &topic.found.fields {
        let numeric = matches!(field.kind, FieldKind::Number | FieldKind::Numbers) && field.longest > 0;
        if !numeric || tokens::is_aside(&field.path) {
            continue;
        }
        if let Some(reason) = unusable(topic, field) {
            leave(&field.path, reason);
            continue;
        }
        let group = if field.kind == FieldKind::Number { group(&field.path) } else { field.path.clone() };
        match groups.iter_mut().find(|(known, fields)| *known == group && fields[0].kind == FieldKind::Number) {
            Some((_, fields)) if field.kind == FieldKind::Number => fields.push(field),
            Some(_) | None => groups.push((group, vec![field])),
        }
    }
    for (group, fields) in groups {
        let candidate = candidate(topic, &group, &fields);
        if candidate.orders.iter().any(|order| order.ranges.len() > MAX_SIZE) {
            leave(&group, format!("it has more than {MAX_SIZE} values"));
        } else {
            found.push(candidate);
        }
    }
}

/// Why the numbers of a field cannot be those of a step.
fn unusable(topic: &WayTopic, field: &SurveyedField) -> Option<String> {
    let one = field.longest == 1;
    if one && tokens::is_outcome(&topic.found.topic, &field.path) {
        return Some("it is an outcome, which a policy must not see; labels.csv has its place".to_owned());
    }
    if one && tokens::is_counter(&field.path) {
        return Some("it counts or is a time".to_owned());
    }
    if !field.is_fixed() {
        return Some(format!("its length varies from {} to {}", field.shortest, field.longest));
    }
    if field.names.is_empty() && field.messages < topic.found.messages {
        return Some(format!("only {} of {} messages have it", field.messages, topic.found.messages));
    }
    (field.not_finite > 0).then(|| format!("{} values are NaN or infinite", field.not_finite))
}

/// The path without the axis and the vector at its end: the numbers of one pose or twist belong together.
fn group(path: &str) -> String {
    let mut parts: Vec<&str> = path.split('.').collect();
    if !parts.last().is_some_and(|last| AXES.contains(last)) {
        return path.to_owned();
    }
    parts.pop();
    if parts.last().is_some_and(|last| VECTORS.contains(last)) {
        parts.pop();
    }
    parts.join(".")
}

fn candidate(topic: &WayTopic, group: &str, fields: &[&SurveyedField]) -> Candidate {
    let named = fields.iter().find(|field| !field.names.is_empty());
    let own = group.rsplit('.').next().unwrap_or_default();
    let name = match named {
        Some(_) if ["position", "velocity", "effort", "torque", "acceleration"].contains(&own) => {
            format!("joint_{own}")
        }
        Some(_) | None => tokens::field_name(&topic.found.topic, group),
    };
    let many = fields.iter().any(|field| field.values.is_empty());
    let mut values: Vec<f64> = Vec::new();
    for value in fields.iter().flat_map(|field| &field.values) {
        if !values.contains(value) {
            values.push(*value);
        }
    }
    if many || values.len() > 2 {
        values.clear();
    }
    let orders = match named {
        Some(field) => by_name(field),
        None => by_path(fields),
    };
    let found = &topic.found;
    Candidate {
        name,
        topic: found.topic.clone(),
        schema: found.schema.clone(),
        path: group.to_owned(),
        stamped: found.stamped,
        command: Command::No,
        rate_hz: found.rate_hz,
        beside: None,
        alongside: None,
        sent: false,
        open: false,
        orders,
        values,
    }
}

fn by_name(field: &SurveyedField) -> Vec<Order> {
    let order = |names: Vec<String>, reason| {
        let range = |name: &String| {
            let at = field.names.iter().position(|known| known == name);
            at.and_then(|at| field.ranges.get(at)).copied().unwrap_or(ValueRange::of(0.0))
        };
        Order { paths: vec![field.path.clone()], ranges: names.iter().map(range).collect(), names, reason }
    };
    let mut sorted = field.names.clone();
    sorted.sort();
    let natural = order(tokens::natural(&field.names), "by name and number, the largest group of joints first");
    let first = order(field.names.clone(), "as in the first message");
    let sorted = order(sorted, "by name");
    // Names without numbers, such as shoulder and elbow, have an order of their own.
    if field.names.iter().any(|name| name.ends_with(|c: char| c.is_ascii_digit())) {
        vec![natural, sorted, first]
    } else {
        vec![first, natural, sorted]
    }
}

fn by_path(fields: &[&SurveyedField]) -> Vec<Order> {
    let order = |fields: &[&SurveyedField], reason| Order {
        paths: fields.iter().map(|field| field.path.clone()).collect(),
        names: Vec::new(),
        ranges: fields.iter().flat_map(|field| field.ranges.iter().copied()).collect(),
        reason,
    };
    let first = order(fields, "as in the message");
    // The parts of a rotation are written in either order.
    let parts = |field: &SurveyedField| -> Vec<String> { field.path.split('.').map(str::to_owned).collect() };
    let is = |field: &SurveyedField, axis: &str| {
        let parts = parts(field);
        let mut ends = parts.iter().rev().map(String::as_str);
        let (last, before) = (ends.next(), ends.next());
        last == Some(axis) && before.is_some_and(|before| ROTATIONS.contains(&before))
    };
    let at = |axis: &str| fields.iter().position(|field| is(field, axis));
    match (at("x"), at("w")) {
        (Some(x), Some(w)) if w == x + 3 => {
            let mut turned = fields.to_vec();
            turned[x..=w].rotate_right(1);
            vec![first, order(&turned, "rotations as w, x, y, z")]
        }
        _ => vec![first],
    }
}
