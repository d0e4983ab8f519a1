//! Surveys of recordings as text and as JSON.

use std::time::Duration;

use gleaner_client::Skipped;
use gleaner_recording::{FieldKind, Survey, SurveyedCamera, SurveyedField, SurveyedTopic, printable};
use serde_json::{Value, json};

use crate::inspector::Inspected;
use crate::intake::Intake;
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::words;

/// Most names that a table repeats.
const NAMES_SHOWN: usize = 16;

pub(super) fn document(intakes: &[Intake], surveys: &[Inspected<Survey>], skipped: &[Skipped]) -> Value {
    let datasets = intakes
        .iter()
        .map(|intake| json!({ "file": intake.path.display().to_string(), "description": intake.description }));
    let recordings = surveys.iter().map(|(path, survey)| {
        let file = path.display().to_string();
        match survey {
            Ok(survey) => json!({ "file": file, "survey": survey }),
            Err(error) => json!({ "file": file, "error": error }),
        }
    });
    let skipped =
        skipped.iter().map(|skipped| json!({ "file": skipped.path.display().to_string(), "reason": skipped.reason }));
    json!({
        "datasets": datasets.collect::<Vec<_>>(),
        "recordings": recordings.collect::<Vec<_>>(),
        "skipped": skipped.collect::<Vec<_>>(),
    })
}

pub(super) fn shown(surveys: &[Inspected<Survey>], skipped: &[Skipped]) -> String {
    let mut text = String::new();
    for (path, survey) in surveys {
        let path = printable::field(&path.display().to_string()).into_owned();
        match survey {
            Ok(survey) => text += &format!("{path}: {}\n", described(survey)),
            Err(error) => text += &format!("{path}: {}\n\n", printable::field(error)),
        }
    }
    for Skipped { path, reason } in skipped {
        text += &printable::field(&format!("skipped: {}: {reason}", path.display()));
        text.push('\n');
    }
    text
}

fn described(survey: &Survey) -> String {
    let duration = words::duration(Duration::from_nanos(u64::try_from(survey.duration_ns).unwrap_or_default()));
    let profile = match survey.profile.as_str() {
        "" => String::new(),
        profile => format!(", profile {}", printable::field(profile)),
    };
    let mut text = format!("{} messages in {duration}{profile}\n", survey.messages);
    for finding in &survey.findings {
        text += &format!("{}: {}\n", printable::field(&finding.subject), printable::field(&finding.detail));
    }
    let columns = [
        Left("TOPIC"),
        Left("SCHEMA"),
        Left("ENCODING"),
        Right("MESSAGES"),
        Right("RATE"),
        Left("TIME"),
        Left("GAPS"),
        Left("HOLDS"),
    ];
    text += &table(columns, survey.topics.iter().map(topic));
    text += "\n\n";
    let fields = survey.topics.iter().flat_map(|topic| topic.fields.iter().map(move |field| (topic, field)));
    // Headers and the descriptions of images are alike everywhere.
    let aside = |path: &str| ["header.", "timestamp."].iter().any(|begin| path.starts_with(begin));
    let fields = fields.filter(|(topic, field)| topic.camera.is_none() && !aside(&field.path));
    text += &table([Left("TOPIC"), Left("FIELD"), Left("HOLDS"), Left("VALUES")], fields.map(field));
    text + "\n\n"
}

fn topic(topic: &SurveyedTopic) -> [String; 8] {
    let rate = if topic.rate_hz > 0.0 { format!("{:.1} Hz", topic.rate_hz) } else { "-".to_owned() };
    let longest = Duration::from_nanos(u64::try_from(topic.longest_interval_ns).unwrap_or_default());
    let gaps = if topic.gaps == 0 {
        "-".to_owned()
    } else {
        format!("{}, up to {}", topic.gaps, words::milliseconds(longest))
    };
    [
        topic.topic.clone(),
        topic.schema.clone(),
        topic.encoding.clone(),
        topic.messages.to_string(),
        rate,
        if topic.stamped { "stamp" } else { "log" }.to_owned(),
        gaps,
        holds(topic),
    ]
}

/// The content of a topic in a few words.
fn holds(topic: &SurveyedTopic) -> String {
    if let Some(problem) = &topic.problem {
        return format!("{} of {} messages cannot be read: {problem}", topic.unreadable, topic.messages);
    }
    if let Some(camera) = &topic.camera {
        return images(camera);
    }
    let of = |field: &&SurveyedField| matches!(field.kind, FieldKind::Number | FieldKind::Numbers);
    let numbers: u64 = topic.fields.iter().filter(of).map(|field| field.longest).sum();
    let more = if topic.more { " and more" } else { "" };
    format!("{} fields, {numbers} numbers{more}", topic.fields.len())
}

fn images(camera: &SurveyedCamera) -> String {
    let SurveyedCamera { depth, encoding, height, width, other_sizes, problem, unreadable, picture } = camera;
    if *height == 0 {
        let problem = problem.as_deref().unwrap_or("no picture was found");
        return format!("images that cannot be read: {problem}");
    }
    let kind = if *depth { "depth" } else { "color" };
    let mut text = format!("{kind} {height}×{width} {encoding}");
    if *other_sizes > 0 {
        text += &format!(", {other_sizes} of another size");
    }
    if let (Some(problem), true) = (problem, *unreadable > 0) {
        text += &format!(", {unreadable} cannot be read: {problem}");
    }
    if let Some(picture) = picture {
        text += &format!(", {picture}");
    }
    text
}

fn field((topic, field): (&SurveyedTopic, &SurveyedField)) -> [String; 4] {
    let length = match (field.shortest, field.longest) {
        (shortest, longest) if shortest == longest => longest.to_string(),
        (shortest, longest) => format!("{shortest} to {longest}"),
    };
    let kind = match field.kind {
        FieldKind::Number => "number".to_owned(),
        FieldKind::Numbers => format!("{length} numbers"),
        FieldKind::Text => "text".to_owned(),
        FieldKind::Bytes => format!("{length} bytes"),
        FieldKind::Other => format!("list of {length}"),
    };
    [topic.topic.clone(), field.path.clone(), kind, values(field)]
}

/// The values of a field: all of them if they are few, else their range, and their names.
fn values(field: &SurveyedField) -> String {
    let mut text = match (field.values.as_slice(), field.ranges.split_first()) {
        ([one], _) => format!("always {}", number(*one)),
        ([one, other], _) => format!("{} or {}", number(*one), number(*other)),
        (_, Some((first, rest))) => {
            let all = rest.iter().fold(*first, |all, range| all.with(*range));
            format!("{} to {}", number(all.minimum), number(all.maximum))
        }
        (_, None) if field.kind == FieldKind::Text && !field.text.is_empty() => format!("“{}”", field.text),
        (_, None) => "-".to_owned(),
    };
    if field.not_finite > 0 {
        text += &format!(", {} not finite", field.not_finite);
    }
    if let Some(((first, rest), more)) = field.names.split_first().map(|names| (names, names.1.len() >= NAMES_SHOWN)) {
        let names = rest.iter().take(NAMES_SHOWN - 1).fold(first.clone(), |names, name| names + ", " + name);
        text += &format!("; names {names}{}", if more { ", …" } else { "" });
    }
    text
}

/// A number with at most four digits behind the point.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    if value != 0.0 && value.abs() < 1e-3 {
        return format!("{value:.2e}");
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_recording::ValueRange;

    fn survey() -> Survey {
        let joints = SurveyedField {
            path: "position".into(),
            kind: FieldKind::Numbers,
            messages: 10,
            shortest: 2,
            longest: 2,
            ranges: vec![ValueRange { minimum: -1.5, maximum: 0.0 }, ValueRange { minimum: 0.25, maximum: 2.0 }],
            names: vec!["a".into(), "b\u{1b}[2J".into()],
            ..SurveyedField::default()
        };
        let camera = SurveyedCamera { encoding: "jpeg".into(), height: 48, width: 64, ..SurveyedCamera::default() };
        let topic = |name: &str| SurveyedTopic {
            topic: name.into(),
            messages: 10,
            rate_hz: 20.0,
            stamped: true,
            ..SurveyedTopic::default()
        };
        Survey {
            messages: 20,
            duration_ns: 1_000_000_000,
            topics: vec![
                SurveyedTopic { camera: Some(camera), gaps: 1, longest_interval_ns: 300_000_000, ..topic("/front") },
                SurveyedTopic { fields: vec![joints], ..topic("/joints") },
            ],
            ..Survey::default()
        }
    }

    #[test]
    fn a_survey_shows_topics_cameras_ranges_and_names() {
        let text = shown(&[("a.mcap".into(), Ok(survey()))], &[]);
        for part in
            ["a.mcap: 20 messages in 1.0 s", "color 48×64 jpeg", "1, up to 300.0 ms", "-1.5 to 2; names a, b\\u{1b}"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        let document = document(&[], &[("a.mcap".into(), Ok(survey()))], &[]);
        assert_eq!(document["recordings"][0]["survey"]["topics"][1]["fields"][0]["ranges"][1]["maximum"], 2.0);
    }

    #[test]
    fn unreadable_recordings_have_their_reason() {
        let text = shown(&[("a.mcap".into(), Err("is empty".into()))], &[]);
        assert_eq!(text, "a.mcap: is empty\n\n");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.0, 1.0, -0.25, 1e-5, 123.456_78].map(number), ["0", "1", "-0.25", "1.00e-5", "123.4568"]);
    }
}
