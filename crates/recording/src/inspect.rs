//! Findings in the data of a recording, one function for each kind.
//!
//! The functions read tracks, steps and values, and change the report only.

mod cameras;
mod limits;
pub(crate) mod pace;
mod video;

use crate::plan::Steps;
use crate::tracks::{Failure, Tracks};
use gleaner_core::{FieldSpec, TaskSpec};
use gleaner_core::{Finding, FindingCode, Report, Severity};

pub(crate) use cameras::frozen_cameras;
pub(crate) use limits::outside_limits;
pub(crate) use video::key_frames;

/// Periods without a message that make a gap.
const GAP_PERIODS: f64 = 2.5;
/// The subject of findings about the topic whose messages begin the steps.
const CLOCK: &str = "clock";
/// A stream of fewer messages than one in this many steps is meant to be as fast as that.
const SLOWEST: i64 = 4;
/// Fewest steps from which a joint or a camera can be called frozen.
const FROZEN_STEPS: usize = 20;
/// A value has moved when it spans more than this (radians or metres).
const MOVED: f32 = 1e-3;
/// Share by which the measured interval may differ from the task's period.
const RATE_SHARE: f64 = 0.2;

/// Schemas, messages and paths that could not be read, among those that the mapping uses.
pub(crate) fn failures(tracks: &Tracks, spec: &TaskSpec, mapping: usize, report: &mut Report) {
    let used = &spec.mappings[mapping];
    for topic in used.topics(spec) {
        let Some(track) = tracks.tracks.get(topic) else {
            continue;
        };
        if let Some(Failure { code, first, count }) = &track.failure {
            report.add(Severity::Error, *code, topic, None, format!("{first} ({count} messages alike)"));
        }
        for field in track.fields.iter().filter(|field| field.mapping == mapping) {
            let source = &used.fields[field.source];
            let place = match &source.transform {
                Some(transform) => format!("topic {topic}, frame {} in {}", transform.child, transform.parent),
                None => format!("topic {topic}, path {}", source.paths.join(" ")),
            };
            if let Some(Failure { code, first, count }) = &field.failure {
                let detail = format!("{place}: {first} ({count} messages alike); correct the mapping or the recording");
                report.add(Severity::Error, *code, &source.field, None, detail);
            } else if let (true, Some(absent)) = (field.messages.is_empty() && track.failure.is_none(), &field.absent) {
                let detail = format!("{place}: {absent}");
                report.add(Severity::Error, FindingCode::MissingField, &source.field, None, detail);
            } else if field.messages.is_empty() && track.failure.is_none() {
                let detail = format!("{place}: no message has this field; correct the mapping or the recording");
                report.add(Severity::Error, FindingCode::MissingField, &source.field, None, detail);
            }
        }
    }
}

/// Time: order, rate, gaps and length.
pub(crate) fn steps(steps: &Steps<'_>, spec: &TaskSpec, report: &mut Report) {
    let (stamps, period) = (&steps.stamps, steps.rule.period);
    report.steps = stamps.len() as u64;
    report.dropped_ticks = (steps.clock.stamps.len() - stamps.len()) as u64;
    if let [first, .., last] = stamps[..] {
        report.duration_ns = last.saturating_sub(first);
        report.rate_hz = (stamps.len() - 1) as f64 * 1e9 / report.duration_ns.max(1) as f64;
    }
    if stamps.len() < 2 {
        let detail = format!(
            "only {} of {} messages of the clock have a message of every other stream in time, at least 2 are needed; \
             record longer, or check that all streams run at the same time",
            stamps.len(),
            steps.clock.stamps.len()
        );
        report.add(Severity::Error, FindingCode::TooShort, "file", None, detail);
        return;
    }
    let streams = steps.streams.iter().map(|stream| (stream.topic.as_str(), &stream.timeline));
    for (subject, line) in streams.chain([(CLOCK, &steps.clock)]) {
        if let Some(at) = line.first_reversed {
            let detail = format!(
                "the stamp of message {at} is before that of its predecessor; messages were sorted by their stamps, which \
                 harms nothing where a network or a recorder changed their order"
            );
            report.add(Severity::Warning, FindingCode::TimeReversed, subject, None, detail);
        }
    }
    let interval = steps.clock.median_interval(&steps.ticks);
    if (interval as f64 / period as f64 - 1.0).abs() > RATE_SHARE {
        let detail = pace::rate_corrections(spec, report, 1e9 / interval.max(1) as f64);
        report.add(Severity::Warning, FindingCode::OffRate, CLOCK, None, detail);
    }
    late_start(steps, report);
    gaps(steps, spec, report);
}

/// What comes before the first step, because a stream has no message yet.
fn late_start(steps: &Steps<'_>, report: &mut Report) {
    let (Some(begin), Some(first)) = (steps.clock.stamps.first(), steps.stamps.first()) else { return };
    let lost = first.saturating_sub(*begin);
    let last = steps.streams.iter().max_by_key(|stream| stream.timeline.stamps.first());
    let Some(last) = last.filter(|_| lost as f64 > steps.rule.period as f64 * GAP_PERIODS) else { return };
    let explains = |finding: &Finding| finding.code == FindingCode::LateKeyFrame && finding.subject == last.topic;
    if report.findings.iter().any(explains) {
        return;
    }
    let detail = format!(
        "its first message is late: the first {:.2} s of the recording are no steps, which harms nothing unless the robot was \
         commanded by then. If it was, start the recording once every topic has messages",
        lost as f64 / 1e9
    );
    report.add(Severity::Warning, FindingCode::LateStart, &last.topic, Some(0), detail);
}

/// Steps that hold a message of more than 2.5 periods of its stream, which may be slower than the steps.
fn gaps(steps: &Steps<'_>, spec: &TaskSpec, report: &mut Report) {
    let mut note = |subject: &str, period: i64, distances: Vec<i64>| {
        let limit = period as f64 * GAP_PERIODS;
        let is_gap = |distance: &i64| *distance as f64 > limit;
        let Some(first) = distances.iter().position(is_gap) else {
            return;
        };
        let count = distances.iter().filter(|distance| is_gap(distance)).count();
        let longest = distances.iter().max().copied().unwrap_or_default();
        let (all, period, longest) = (steps.stamps.len(), period as f64 / 1e6, longest as f64 / 1e6);
        let gap = if subject == CLOCK {
            format!(
                "{count} of {all} steps come more than {GAP_PERIODS} periods of {period:.0} ms after the one before, at most \
                 {longest:.0} ms: the topic whose messages begin the steps lost some, or paused"
            )
        } else {
            format!(
                "at {count} of {all} steps the last message is more than {GAP_PERIODS} periods of {period:.0} ms old, at most \
                 {longest:.0} ms, and was held"
            )
        };
        let detail = format!(
            "{gap}. A few lost messages do little harm; look for a dropped connection if there are many, or leave these steps \
             out"
        );
        report.add(Severity::Warning, FindingCode::Gap, subject, Some(first as u64), detail);
    };
    let between = steps.stamps.windows(2).map(|pair| pair[1].saturating_sub(pair[0]));
    let period = steps.rule.period;
    note(CLOCK, period, std::iter::once(0).chain(between).collect());
    for (stream, picks) in steps.streams.iter().zip(&steps.picks) {
        let line = &stream.timeline;
        // A single message is meant to be held, such as a goal.
        if line.stamps.len() > 1 {
            let ages = steps.stamps.iter().zip(picks).map(|(stamp, &at)| stamp.saturating_sub(line.stamps[at]));
            let own = line.median_interval(&(0..line.stamps.len()).collect::<Vec<_>>());
            // A switch may be sent when it changes, and now and then.
            let is_switch = spec.action.iter().any(|field| field.binary && stream.is_field(&field.name));
            let slowest = if is_switch { i64::MAX } else { period.saturating_mul(SLOWEST) };
            note(&stream.topic, own.clamp(period, slowest), ages.collect());
        }
    }
}

/// Values that are NaN or infinite.
pub(crate) fn values(values: &[f32], fields: &[FieldSpec], report: &mut Report) {
    for (column, subject) in columns(fields) {
        let mut rows = values.chunks_exact(width(fields)).enumerate();
        let first = rows.find_map(|(step, row)| (!row[column].is_finite()).then_some((step, row[column])));
        if let Some((step, value)) = first {
            let detail = format!(
                "the value is {value} at step {step}; leave such messages out of the recording or fix their source"
            );
            report.add(Severity::Error, FindingCode::NotFinite, &subject, Some(step as u64), detail);
        }
    }
}

/// Joint positions that stay exactly the same while most others in the field move. Only fields of joint positions are
/// checked, because a base, a goal or a velocity can stay the same.
pub(crate) fn frozen_joints(values: &[f32], fields: &[FieldSpec], report: &mut Report) {
    let width = width(fields);
    if width == 0 || values.len() < FROZEN_STEPS * width {
        return;
    }
    let mut begin = 0;
    for field in fields {
        let columns = begin..begin + field.size as usize;
        begin = columns.end;
        if !is_joint_position(&field.name) {
            continue;
        }
        let span = |column: usize| {
            let column = values.iter().skip(column).step_by(width);
            let (low, high) =
                column.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)));
            high - low
        };
        let spans: Vec<f32> = columns.map(span).collect();
        let moving = spans.iter().filter(|&&span| span > MOVED).count();
        for (at, _) in spans.iter().enumerate().filter(|(_, span)| **span == 0.0 && moving * 2 > spans.len()) {
            let subject = format!("{}[{at}]", field.name);
            let detail = format!(
                "the value never changes while {moving} of {} in the field move; check the joint's encoder, or ignore this \
                 if the joint was meant to rest",
                spans.len()
            );
            report.add(Severity::Warning, FindingCode::FrozenJoint, &subject, None, detail);
        }
    }
}

fn is_joint_position(name: &str) -> bool {
    let name = name.to_lowercase();
    let rates = ["vel", "acc", "effort", "torque", "current", "force"];
    (name.contains("joint") || name.contains("qpos")) && !rates.iter().any(|rate| name.contains(rate))
}

fn width(fields: &[FieldSpec]) -> usize {
    fields.iter().map(|field| field.size as usize).sum::<usize>().max(1)
}

/// Each column's number and name, such as `joint_position[3]`.
fn columns(fields: &[FieldSpec]) -> impl Iterator<Item = (usize, String)> {
    let names = fields.iter().flat_map(|field| (0..field.size).map(move |at| format!("{}[{at}]", field.name)));
    names.enumerate()
}
