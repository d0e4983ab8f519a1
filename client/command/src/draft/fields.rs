//! Fields: which candidates of several ways are the same numbers, in which order, with which range.
//!
//! Works on candidates alone.

use gleaner_recording::{Bound, FieldSource, FieldSpec, ValueRange};

use super::actions::Actions;
use super::candidate::{Candidate, LeftOut, Order};
use super::limits::{self, short};
use super::orders;
use super::still;
use super::tokens;
use super::units;
use super::way::Way;

/// Likeness of names and ranges together, from 0 to 2, from which two candidates are the same numbers.
const SAME: f64 = 0.75;
/// Likeness of ranges, from 0 to 1, from which they fit.
const FITS: f64 = 0.3;
/// The greatest value of a command that is normalised to one, as far as it is reached.
const ONE: f64 = 1.0001;
const REACHED: f64 = 0.9;
/// Most values whose paths a comment names one by one.
const MOST_NAMED: usize = 8;

/// A field of the draft.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) spec: FieldSpec,
    pub(super) action: bool,
    /// Whether an observation may as well be a command.
    pub(super) open: bool,
    /// What its name means, in words.
    pub(super) meaning: Option<&'static str>,
    /// Whether the draft has it as a comment, so that it is no part of the task.
    pub(super) is_aside: bool,
    /// Whether the limits of an action are those of the recordings, because its values have no usual range.
    pub(super) observed: bool,
    pub(super) stamped: Vec<bool>,
    /// Its place in each way.
    pub(super) sources: Vec<FieldSource>,
    /// How it was found.
    pub(super) reasons: Vec<String>,
}

/// The like of a candidate in another way.
struct Like {
    candidate: Candidate,
    /// Whether both are alike only in that nothing else has their size.
    by_size: bool,
}

/// The fields that all ways have: those of the first way, each with its like in the others.
pub(super) fn fields(
    ways: &[Way],
    mut candidates: Vec<Vec<Candidate>>,
    actions: &Actions<'_>,
    left_out: &mut Vec<LeftOut>,
) -> Vec<Field> {
    let Some(first) = candidates.first_mut().map(std::mem::take) else { return Vec::new() };
    // The likest pair of all comes first, so that a field does not lose its like to one before it.
    let mut matched: Vec<Vec<Option<Like>>> = Vec::new();
    for others in candidates.iter_mut().skip(1) {
        matched.push(pairs(&first, others, actions));
    }
    let mut fields: Vec<Field> = Vec::new();
    for (at, candidate) in first.iter().enumerate() {
        let alike: Vec<_> = matched.iter_mut().filter_map(|of_way| of_way.get_mut(at)?.take()).collect();
        if alike.len() < matched.len() {
            let what = format!("{} {} ({})", candidate.topic, candidate.orders[0].paths.join(" "), ways[0].name);
            left_out.push(LeftOut { what, reason: "the other ways of recording have no such numbers".to_owned() });
            continue;
        }
        let name = unique(candidate, &fields);
        fields.push(field(name, candidate, &alike, actions, ways));
    }
    for (way, rest) in ways.iter().zip(&candidates).skip(1) {
        left_out.extend(rest.iter().map(|candidate| LeftOut {
            what: format!("{} {} ({})", candidate.topic, candidate.orders[0].paths.join(" "), way.name),
            reason: "the other ways of recording have no such numbers".to_owned(),
        }));
    }
    fields
}

/// For each candidate the like of another way, taken from there.
fn pairs(first: &[Candidate], others: &mut Vec<Candidate>, actions: &Actions<'_>) -> Vec<Option<Like>> {
    let mut scored = Vec::new();
    for (at, one) in first.iter().enumerate() {
        for (number, other) in others.iter().enumerate().filter(|(_, other)| actions.has(one) == actions.has(other)) {
            if let Some(fit) = orders::best(one, other) {
                let names = tokens::likeness(&one.name, &other.name).max(tokens::likeness(&one.topic, &other.topic));
                scored.push((names + fit, at, number));
            }
        }
    }
    scored.sort_by(|one, other| other.0.total_cmp(&one.0));
    let mut chosen: Vec<Option<(usize, bool)>> = vec![None; first.len()];
    let mut used = vec![false; others.len()];
    for &(score, at, number) in &scored {
        if score >= SAME && chosen[at].is_none() && !used[number] {
            used[number] = true;
            chosen[at] = Some((number, false));
        }
    }
    // What is left on both sides is the same if nothing else has its size.
    let left: Vec<_> = scored.iter().filter(|(_, at, number)| chosen[*at].is_none() && !used[*number]).collect();
    for &&(_, at, number) in &left {
        if left.iter().filter(|(_, one, other)| *one == at || *other == number).count() == 1 {
            chosen[at] = Some((number, true));
        }
    }
    let mut left: Vec<Option<Candidate>> = others.drain(..).map(Some).collect();
    let mut take = |(number, by_size): (usize, bool)| Some(Like { candidate: left[number].take()?, by_size });
    let pairs = chosen.into_iter().map(|chosen| chosen.and_then(&mut take)).collect();
    others.extend(left.into_iter().flatten());
    pairs
}

/// A name that no other field has.
fn unique(candidate: &Candidate, fields: &[Field]) -> String {
    let taken = |name: &str| fields.iter().any(|field| field.spec.name == name);
    let own = candidate.name.clone();
    let with_path = (!candidate.path.is_empty()).then(|| tokens::identifier(&candidate.path));
    let with_topic = tokens::identifier(&format!("{}_{own}", candidate.topic));
    let numbered = (2..).map(|number| format!("{own}_{number}"));
    [Some(own.clone()), with_path, Some(with_topic)]
        .into_iter()
        .flatten()
        .chain(numbered)
        .find(|name| !taken(name))
        .unwrap_or(own)
}

fn field(name: String, first: &Candidate, alike: &[Like], actions: &Actions<'_>, ways: &[Way]) -> Field {
    let action = actions.has(first);
    let others: Vec<&Candidate> = alike.iter().map(|like| &like.candidate).collect();
    let (own, theirs) = orders::agreed(first, &others);
    let order = &first.orders[own];
    let mut reasons = Vec::new();
    let mut ranges = order.ranges.clone();
    let mut values = first.values.clone();
    let source = |candidate: &Candidate, order: &Order| FieldSource {
        field: name.clone(),
        topic: candidate.topic.clone(),
        paths: order.paths.clone(),
        names: order.names.clone(),
        transform: None,
    };
    let mut sources = vec![source(first, order)];
    reasons.push(format!("{} {}{}.", first.topic, shown_paths(order), shown_order(first, own)));
    reasons.push(actions.reason(first));
    for ((Like { candidate, by_size }, (its, fit)), way) in alike.iter().zip(theirs).zip(ways.iter().skip(1)) {
        let fits = fit >= FITS && !by_size;
        let reason = if fits { "its ranges fit" } else { "but its ranges do not fit, so compare their meaning" };
        let theirs = &candidate.orders[its];
        reasons.push(format!(
            "In {} it is {} {}{}: {reason}.",
            way.name,
            candidate.topic,
            shown_paths(theirs),
            shown_order(candidate, its)
        ));
        sources.push(source(candidate, theirs));
        for (range, other) in ranges.iter_mut().zip(&theirs.ranges) {
            *range = range.with(*other);
        }
        let new: Vec<f64> = candidate.values.iter().copied().filter(|value| !values.contains(value)).collect();
        values.extend(new);
    }
    let known = !first.values.is_empty() && alike.iter().all(|like| !like.candidate.values.is_empty());
    let values = if known && values.len() <= 2 { values } else { Vec::new() };
    let mut spec = FieldSpec::new(name.clone(), u32::try_from(ranges.len()).unwrap_or(u32::MAX));
    let place = reasons.len();
    let mut observed = false;
    if action {
        reasons.extend(still::leave_out_zeros(&mut sources, &mut ranges));
        spec.size = u32::try_from(ranges.len()).unwrap_or(u32::MAX);
        observed = bound(&mut spec, &ranges, &values, &mut reasons);
        let paths = &sources[0].paths;
        if (2..=MOST_NAMED).contains(&paths.len()) && matches!(spec.minimum, Some(Bound::Each(_))) {
            reasons.push(format!("They are in the order {}.", paths.join(", ")));
        }
        reasons.extend(still::unchanged(paths, &ranges));
    } else if !order.names.is_empty() {
        reasons.push("To leave out a joint, delete its name in the mappings, and lower `size` by 1.".to_owned());
    } else if let [value] = values.as_slice() {
        reasons.push(format!("It is always {value} in these recordings; remove it if it never changes."));
    }
    // A command that was found to be normalised has no unit.
    if (observed || spec.minimum.is_none())
        && let Some(unit) = units::of_paths(&first.schema, &sources[0].paths)
    {
        spec.unit = unit;
        reasons.insert(place, "Its unit is by the conventions of ROS.".to_owned());
    }
    let stamped = std::iter::once(first.stamped).chain(alike.iter().map(|like| like.candidate.stamped));
    Field {
        spec,
        action,
        open: !action && first.open,
        meaning: first.meaning(),
        is_aside: false,
        observed,
        stamped: stamped.collect(),
        sources,
        reasons,
    }
}

/// Guesses the limits of an action whose values have these ranges, or one together. Returns whether they are those of the
/// recordings, for want of a better guess.
pub(super) fn bound(spec: &mut FieldSpec, ranges: &[ValueRange], values: &[f64], reasons: &mut Vec<String>) -> bool {
    let all = ranges.iter().copied().reduce(ValueRange::with).unwrap_or(ValueRange::of(0.0));
    let ValueRange { minimum, maximum } = all;
    let observed = format!("Its values are {} to {}", short(minimum), short(maximum));
    let within = |low: f64, high: f64| minimum >= low && maximum <= high;
    let mut set = |bounds: [Bound; 2]| [spec.minimum, spec.maximum] = bounds.map(Some);
    let all = |minimum: f64, maximum: f64| [minimum, maximum].map(|bound| Bound::All(limits::single(bound)));
    if let ([_, _], true) = (values, minimum < maximum) {
        set(all(minimum, maximum));
        spec.binary = true;
        reasons.push(format!("It has the two values {} and {} and none between.", short(minimum), short(maximum)));
    } else if within(-ONE, ONE) && minimum < 0.0 && (minimum < -REACHED || maximum > REACHED) {
        set(all(-1.0, 1.0));
        reasons.push(format!("{observed}, as of a command between -1 and 1."));
    } else if within(0.0, ONE) && maximum > REACHED && minimum < 1.0 - REACHED {
        set(all(0.0, 1.0));
        reasons.push(format!("{observed}, as of a command between 0 and 1."));
    } else if let Some(bounds) = limits::bounds(ranges) {
        set(bounds);
        reasons.push(
            "Its limits are those of the recordings: write wider ones where the robot may do more, or delete both lines."
                .to_owned(),
        );
        return true;
    } else {
        reasons.push(format!("{observed}, so that it has no limits."));
    }
    false
}

fn shown_paths(order: &Order) -> String {
    match order.paths.as_slice() {
        [one] => one.clone(),
        [first, .., last] => format!("{first} to {last}"),
        [] => String::new(),
    }
}

/// The order of the values, where there was a choice.
fn shown_order(candidate: &Candidate, at: usize) -> String {
    if candidate.orders.len() < 2 { String::new() } else { format!(" ({})", candidate.orders[at].reason) }
}
