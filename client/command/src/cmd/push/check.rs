//! `push --check`: what the server would do with each recording, before any byte is sent.

use std::path::PathBuf;
use std::time::Duration;

use futures::StreamExt as _;
use gleaner_client::{Checked, Client, ClientError, PushItem};
use gleaner_proto::v1::InspectionEstimate;
use gleaner_recording::printable;
use serde_json::{Value, json};

use crate::alike::Alike;
use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::table::{Column, table};
use crate::{json, words};

type Row = (PathBuf, std::result::Result<Checked, ClientError>);

/// Checks each recording and shows a line for it.
pub(super) async fn check(context: &Context, client: &Client, items: Vec<PushItem>, parallel: usize) -> Result<()> {
    let checks = items.into_iter().map(|item| async move {
        let checked = client.check(&item).await;
        (item.path, checked)
    });
    let rows: Vec<Row> = futures::stream::iter(checks).buffered(parallel.max(1)).collect().await;
    context.output.result(|| document(&rows), || shown(&rows))?;
    match rows.iter().filter(|(_, checked)| checked.is_err()).count() {
        0 => Ok(()),
        rejected => Err(Failure::message(format!("{rejected} of {} recordings would be rejected", rows.len()))),
    }
}

fn shown(rows: &[Row]) -> String {
    let unknown = || "-".to_owned();
    let lines = rows.iter().map(|(path, checked)| {
        let path = printable::field(&path.display().to_string()).into_owned();
        let Ok(Checked { size_bytes, summary, estimate, existing }) = checked else {
            return [path, unknown(), unknown(), unknown(), unknown(), "rejected".to_owned()];
        };
        let result = match existing {
            Some(episode) => format!("stored as {} ({})", episode.id, words::outcome(episode.outcome())),
            None => "accepted for upload".to_owned(),
        };
        let duration = summary.as_ref().map(|summary| words::duration(Duration::from_nanos(summary.duration_ns)));
        let estimate = estimate.filter(|estimate| estimate.steps > 0);
        [
            path,
            format!("{:.1} MB", words::megabytes(*size_bytes)),
            duration.unwrap_or_else(unknown),
            estimate.map_or_else(unknown, |estimate| estimate.steps.to_string()),
            estimate.map_or_else(unknown, |estimate| decoded(&estimate)),
            result,
        ]
    });
    let columns = [
        Column::Left("recording"),
        Column::Right("size"),
        Column::Right("duration"),
        Column::Right("steps"),
        Column::Right("decoded"),
        Column::Left("result"),
    ];
    let mut text = table(columns, lines);
    let mut rejected = Alike::default();
    for (path, error) in rows.iter().filter_map(|(path, checked)| Some((path, checked.as_ref().err()?))) {
        rejected.add(&error.to_string(), &path.display().to_string());
    }
    for line in rejected.lines("rejected") {
        text.push('\n');
        text += &printable::field(&line);
    }
    text
}

fn decoded(estimate: &InspectionEstimate) -> String {
    let [least, most] = [estimate.least_decoded_bytes, estimate.most_decoded_bytes].map(words::megabytes);
    format!("{least:.1} to {most:.1} MB")
}

fn document(rows: &[Row]) -> Result<Value> {
    let rows = rows.iter().map(|(path, checked)| {
        let file = path.display().to_string();
        Ok(match checked {
            Ok(Checked { size_bytes, summary, estimate, existing }) => json!({
                "file": file,
                "size_bytes": size_bytes,
                "duration_s": summary.as_ref().map(|summary| Duration::from_nanos(summary.duration_ns).as_secs_f64()),
                "estimate": estimate.as_ref().map(json::value).transpose()?,
                "existing": existing.as_ref().map(json::value).transpose()?,
                "error": Value::Null,
            }),
            Err(error) => json!({ "file": file, "error": error.to_string() }),
        })
    });
    Ok(json!({ "recordings": rows.collect::<Result<Vec<_>>>()? }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_proto::v1::{Episode, Outcome};
    use gleaner_recording::RecordingSummary;

    fn rows() -> Vec<Row> {
        let summary = RecordingSummary { duration_ns: 90_500_000_000, ..RecordingSummary::default() };
        let estimate = InspectionEstimate {
            steps: 905,
            least_decoded_bytes: 1_000_000,
            most_decoded_bytes: 8_000_000,
            ..Default::default()
        };
        let known = Checked { size_bytes: 3_000_000, summary: Some(summary), estimate: Some(estimate), existing: None };
        let outcome = Outcome::Failure.into();
        let episode = Episode { id: "ep_1".into(), outcome, ..Episode::default() };
        let unknown = Checked { size_bytes: 5, summary: None, estimate: None, existing: Some(episode) };
        let refused = ClientError::Invalid("summary.messages: too many\nof them".into());
        vec![("a.mcap".into(), Ok(known)), ("b.mcap".into(), Ok(unknown)), ("c.mcap".into(), Err(refused))]
    }

    #[test]
    fn each_recording_has_a_line_and_each_refusal_its_reason() {
        let text = shown(&rows());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 5, "{text}");
        for part in ["3.0 MB", "1 min 30 s", "905", "1.0 to 8.0 MB", "accepted for upload"] {
            assert!(lines[1].contains(part), "{part}: {text}");
        }
        assert!(lines[2].ends_with("  stored as ep_1 (failure)") && lines[3].ends_with("  rejected"), "{text}");
        assert_eq!(lines[4], "rejected: c.mcap: summary.messages: too many\\nof them");
    }

    #[test]
    fn the_document_has_estimates_and_errors() {
        let shown = document(&rows()).unwrap();
        assert_eq!(shown["recordings"][0]["estimate"]["steps"], 905);
        assert_eq!(shown["recordings"][0]["duration_s"], 90.5);
        assert_eq!(shown["recordings"][1]["existing"]["id"], "ep_1");
        assert!(shown["recordings"][2]["error"].as_str().unwrap().contains("too many"));
    }
}
