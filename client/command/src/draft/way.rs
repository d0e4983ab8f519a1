//! Ways of recording: recordings with the same topics, merged to one description.
//!
//! Works on surveys alone.

use std::collections::BTreeSet;

use gleaner_recording::{Survey, SurveyedCamera, SurveyedField, SurveyedTopic};

/// Recordings of one way share at least this part of their topics.
const SHARED: f64 = 0.5;

/// Recordings with the same topics in the same encodings.
#[derive(Debug)]
pub(super) struct Way {
    /// Name of its mapping, such as `ros2`.
    pub(super) name: String,
    pub(super) recordings: usize,
    pub(super) topics: Vec<WayTopic>,
    keys: BTreeSet<String>,
}

/// One topic of all recordings of a way.
#[derive(Debug)]
pub(super) struct WayTopic {
    /// All recordings together; the rate is the median.
    pub(super) found: SurveyedTopic,
    /// Number of recordings that have messages of it.
    pub(super) recordings: usize,
    /// Rates and picture sizes of the recordings.
    rates: Vec<f64>,
    pub(super) sizes: Vec<(u32, u32)>,
}

/// Groups recordings into ways, the one with the most recordings first; of equal ones, one whose numbers are arrays of a
/// fixed order first.
pub(super) fn ways<'a>(surveys: impl IntoIterator<Item = &'a Survey>) -> Vec<Way> {
    let mut ways: Vec<Way> = Vec::new();
    for survey in surveys {
        let keys: BTreeSet<String> =
            survey.topics.iter().map(|topic| format!("{}\n{}", topic.topic, topic.encoding)).collect();
        let at = ways.iter().position(|way| shared(&way.keys, &keys) >= SHARED);
        let at = at.unwrap_or_else(|| {
            ways.push(Way { name: name(survey).to_owned(), recordings: 0, topics: Vec::new(), keys: keys.clone() });
            ways.len() - 1
        });
        if let Some(way) = ways.get_mut(at) {
            way.keys.extend(keys);
            way.add(survey);
        }
    }
    ways.iter_mut().flat_map(|way| &mut way.topics).for_each(WayTopic::settle);
    ways.sort_by_key(|way| (std::cmp::Reverse(way.recordings), way.name == "ros2"));
    let mut taken = BTreeSet::new();
    for way in &mut ways {
        let name = way.name.clone();
        let mut number = 1;
        while !taken.insert(way.name.clone()) {
            number += 1;
            way.name = format!("{name}_{number}");
        }
    }
    ways
}

#[expect(clippy::cast_precision_loss, reason = "a share of topics")]
fn shared(one: &BTreeSet<String>, other: &BTreeSet<String>) -> f64 {
    let all = one.union(other).count();
    if all == 0 { 1.0 } else { one.intersection(other).count() as f64 / all as f64 }
}

/// The name of a mapping, by the encoding of most topics.
fn name(survey: &Survey) -> &'static str {
    let count = |encoding: &str| survey.topics.iter().filter(|topic| topic.encoding == encoding).count();
    let foxglove = survey.topics.iter().any(|topic| topic.schema.starts_with("foxglove."));
    let names = [("ros2", count("cdr")), ("json", count("json")), ("protobuf", count("protobuf"))];
    match names.into_iter().max_by_key(|(_, count)| *count) {
        Some(("protobuf", _)) if foxglove => "foxglove",
        Some((name, _)) => name,
        None => "recorded",
    }
}

impl Way {
    fn add(&mut self, survey: &Survey) {
        self.recordings += 1;
        for topic in survey.topics.iter().filter(|topic| topic.messages > 0) {
            match self.topics.iter_mut().find(|known| known.found.topic == topic.topic) {
                Some(known) => known.add(topic),
                None => self.topics.push(WayTopic::new(topic)),
            }
        }
    }
}

impl WayTopic {
    fn new(topic: &SurveyedTopic) -> Self {
        let mut new = Self { found: topic.clone(), recordings: 1, rates: vec![topic.rate_hz], sizes: Vec::new() };
        new.size(topic);
        new
    }

    fn size(&mut self, topic: &SurveyedTopic) {
        self.sizes.extend(topic.camera.iter().map(|camera| (camera.height, camera.width)));
    }

    fn add(&mut self, topic: &SurveyedTopic) {
        self.recordings += 1;
        self.rates.push(topic.rate_hz);
        self.size(topic);
        let found = &mut self.found;
        found.messages += topic.messages;
        found.stamped &= topic.stamped;
        found.gaps += topic.gaps;
        found.unreadable += topic.unreadable;
        found.more |= topic.more;
        if found.problem.is_none() {
            found.problem.clone_from(&topic.problem);
        }
        match (&mut found.camera, &topic.camera) {
            (Some(camera), Some(other)) => add_camera(camera, other),
            (camera @ None, other) => camera.clone_from(other),
            (Some(_), None) => {}
        }
        for field in &topic.fields {
            match found.fields.iter_mut().find(|known| known.path == field.path) {
                Some(known) => add_field(known, field),
                None => found.fields.push(field.clone()),
            }
        }
    }

    /// The median rate, and the most frequent size.
    fn settle(&mut self) {
        self.rates.sort_by(f64::total_cmp);
        self.found.rate_hz = self.rates.get(self.rates.len() / 2).copied().unwrap_or_default();
        let count = |size: &(u32, u32)| self.sizes.iter().filter(|other| *other == size).count();
        if let (Some(camera), Some(size)) = (&mut self.found.camera, self.sizes.iter().max_by_key(|size| count(size))) {
            (camera.height, camera.width) = *size;
        }
    }
}

fn add_camera(camera: &mut SurveyedCamera, other: &SurveyedCamera) {
    camera.other_sizes += other.other_sizes;
    camera.unreadable += other.unreadable;
    if camera.problem.is_none() {
        camera.problem.clone_from(&other.problem);
    }
    if camera.height == 0 {
        (camera.height, camera.width, camera.depth) = (other.height, other.width, other.depth);
        camera.encoding.clone_from(&other.encoding);
    }
}

fn add_field(field: &mut SurveyedField, other: &SurveyedField) {
    field.messages += other.messages;
    field.shortest = field.shortest.min(other.shortest);
    field.longest = field.longest.max(other.longest);
    field.not_finite += other.not_finite;
    // An empty list stands for more than two values, if the field has any.
    let many = |field: &SurveyedField| field.values.is_empty() && field.longest > 0;
    if many(field) || many(other) {
        field.values.clear();
    } else {
        let new: Vec<f64> = other.values.iter().copied().filter(|value| !field.values.contains(value)).collect();
        field.values.extend(new);
        if field.values.len() > 2 {
            field.values.clear();
        }
    }
    if field.names.is_empty() && other.names.is_empty() {
        let same = field.ranges.len() == other.ranges.len();
        let ranges = field.ranges.iter().zip(&other.ranges).map(|(one, other)| one.with(*other));
        field.ranges = if same { ranges.collect() } else { Vec::new() };
        return;
    }
    for (name, range) in other.names.iter().zip(&other.ranges) {
        let at = field.names.iter().position(|known| known == name);
        match at.and_then(|at| field.ranges.get_mut(at)) {
            Some(known) => *known = known.with(*range),
            None => {
                field.names.push(name.clone());
                field.ranges.push(*range);
            }
        }
    }
}
