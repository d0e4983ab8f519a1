//! The results of a push, as text and as JSON.

use std::collections::BTreeMap;

use gleaner_client::{Pushed, Skipped};
use gleaner_proto::v1::Outcome;
use gleaner_recording::printable;
use serde_json::{Value, json};

use crate::alike::Alike;
use crate::failure::Result;
use crate::{json, words};

pub(super) fn summary(pushed: &Pushed, skipped: &[Skipped]) -> String {
    let [new, stored] = [false, true].map(|existed| counted(pushed, existed));
    let warnings: u32 = pushed.uploaded().map(|uploaded| uploaded.episode.warnings).sum();
    let mut lines = vec![format!(
        "{} recordings pushed{}, {} already stored{}, {} rejected; {:.1} MB in {} ({:.1} MB/s)",
        new.0,
        new.1,
        stored.0,
        stored.1,
        pushed.failures().count(),
        words::megabytes(pushed.sent_bytes()),
        words::duration(pushed.wall),
        words::rate(pushed.sent_bytes(), pushed.wall)
    )];
    if warnings > 0 {
        lines.push(format!(
            "{} about what was recorded, as in `gleaner task check`; gleaner episode ID shows them",
            words::counted(warnings, "warning", "warnings")
        ));
    }
    let unknown = pushed.uploaded().filter(|uploaded| uploaded.episode.outcome() == Outcome::Unknown).count();
    if unknown > 0 {
        lines.push(format!(
            "{} an unknown outcome, which no pretraining uses: `gleaner label --from labels.csv` labels stored episodes from \
             a file (columns file, outcome; others by --label-columns)",
            words::counted(unknown, "episode has", "episodes have")
        ));
    }
    // A name or a reason with a line break must not look like a line of ours.
    let mut rejected = Alike::default();
    for (item, error) in pushed.failures() {
        rejected.add(&error.to_string(), &item.path.display().to_string());
    }
    lines.extend(rejected.lines("rejected").iter().map(|line| printable::field(line).into_owned()));
    if !skipped.is_empty() {
        lines.push(format!("{} skipped", skipped.len()));
    }
    for Skipped { path, reason } in skipped {
        lines.push(printable::field(&format!("skipped: {}: {reason}", path.display())).into_owned());
    }
    lines.join("\n")
}

/// A hint on cohorts, where several failures are new and none has one.
pub(super) fn without_cohort(pushed: &Pushed) -> Option<String> {
    let failed = || pushed.uploaded().filter(|uploaded| uploaded.episode.outcome() == Outcome::Failure);
    let new = failed().filter(|uploaded| !uploaded.existed).count();
    let any_named = failed().any(|uploaded| !uploaded.episode.cohort.is_empty());
    (new > 1 && !any_named).then(|| {
        format!(
            "{new} failures have no cohort: name the kind of each in the column cohort of labels.csv (`gleaner label --from \
             labels.csv`), and `gleaner histogram` shows each kind"
        )
    })
}

/// How many recordings were stored before, or are new, and in parentheses how many of them have each outcome.
fn counted(pushed: &Pushed, existed: bool) -> (usize, String) {
    let mut counts: BTreeMap<i32, usize> = BTreeMap::new();
    for uploaded in pushed.uploaded().filter(|uploaded| uploaded.existed == existed) {
        *counts.entry(uploaded.episode.outcome).or_default() += 1;
    }
    let shown = counts.iter().filter_map(|(outcome, count)| {
        Some(format!("{count} as {}", words::outcome(Outcome::try_from(*outcome).ok()?)))
    });
    let shown: Vec<_> = shown.collect();
    let shown = if shown.is_empty() { String::new() } else { format!(" ({})", shown.join(", ")) };
    (counts.values().sum(), shown)
}

pub(super) fn document(pushed: &Pushed, skipped: &[Skipped]) -> Result<Value> {
    let episodes = pushed.results.iter().filter_map(|item| {
        let uploaded = item.result.as_ref().ok()?;
        Some(json::value(&uploaded.episode).map(|episode| {
            json!({ "file": item.path.display().to_string(), "existed": uploaded.existed, "episode": episode })
        }))
    });
    let failures = pushed
        .failures()
        .map(|(item, error)| json!({ "file": item.path.display().to_string(), "error": error.to_string() }));
    let skipped =
        skipped.iter().map(|Skipped { path, reason }| json!({ "file": path.display().to_string(), "reason": reason }));
    Ok(json!({
        "episodes": episodes.collect::<Result<Vec<_>>>()?,
        "failures": failures.collect::<Vec<_>>(),
        "skipped": skipped.collect::<Vec<_>>(),
        "sent_bytes": pushed.sent_bytes(),
        "seconds": pushed.wall.as_secs_f64(),
        "megabytes_per_second": words::rate(pushed.sent_bytes(), pushed.wall),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gleaner_client::{ClientError, PushResult, Uploaded};
    use gleaner_proto::v1::Episode;
    use std::time::Duration;

    fn pushed() -> Pushed {
        let uploaded = |id: &str, existed, outcome: Outcome| Uploaded {
            episode: Episode {
                id: id.into(),
                size_bytes: 3_000_000,
                warnings: 1,
                outcome: outcome.into(),
                ..Episode::default()
            },
            report: None,
            existed,
        };
        let result = |path: &str, result| PushResult { path: path.into(), result };
        Pushed {
            results: vec![
                result("a.mcap", Ok(uploaded("ep_1", false, Outcome::Success))),
                result("b.mcap", Ok(uploaded("ep_2", true, Outcome::Unknown))),
                result("c.mcap", Err(ClientError::Invalid("not an MCAP file".into()))),
            ],
            wall: Duration::from_millis(500),
        }
    }

    #[test]
    fn the_summary_counts_and_names_rejected_recordings() {
        assert_eq!(
            summary(&pushed(), &[]),
            "1 recordings pushed (1 as success), 1 already stored (1 as unknown), 1 rejected; 3.0 MB in 0.5 s (6.0 MB/s)\n2 warnings about \
             what was recorded, as in `gleaner task check`; gleaner episode ID shows them\n1 episode has an unknown outcome, which no pretraining uses: `gleaner label --from \
             labels.csv` labels stored episodes from a file (columns file, outcome; others by \
             --label-columns)\nrejected: c.mcap: not an MCAP file"
        );
    }

    #[test]
    fn several_new_failures_without_a_cohort_have_a_hint() {
        let with = |outcomes: &[(Outcome, &str, bool)]| {
            let mut pushed = pushed();
            let one = pushed.results.swap_remove(0);
            let Ok(one) = one.result else { panic!("it is stored") };
            let of = |&(outcome, cohort, existed): &(Outcome, &str, bool)| {
                let episode = Episode { outcome: outcome.into(), cohort: cohort.into(), ..one.episode.clone() };
                PushResult { path: "a.mcap".into(), result: Ok(Uploaded { episode, report: None, existed }) }
            };
            pushed.results = outcomes.iter().map(of).collect();
            without_cohort(&pushed)
        };
        let (failed, good) = ((Outcome::Failure, "", false), (Outcome::Success, "", false));
        let hint = with(&[failed, good, failed]).unwrap();
        assert!(hint.starts_with("2 failures have no cohort") && hint.contains("labels.csv"), "{hint}");
        assert!(!hint.contains('\n'), "one line: {hint}");
        for none in [&[failed, good][..], &[failed, failed, (Outcome::Failure, "dropped", false)], &[good, good]] {
            assert_eq!(with(none), None);
        }
        assert_eq!(with(&[(Outcome::Failure, "", true), (Outcome::Failure, "", true)]), None, "stored before");
    }

    fn skipped() -> Vec<Skipped> {
        vec![Skipped { path: "x\u{1b}[2J\n.mcap".into(), reason: "is a FIFO".into() }]
    }

    #[test]
    fn the_summary_names_skipped_files() {
        let shown = summary(&pushed(), &skipped());
        let last: Vec<&str> = shown.lines().rev().take(2).collect();
        assert_eq!(last[0], "skipped: x\\u{1b}[2J\\n.mcap: is a FIFO");
        assert!(last[1].starts_with("1 skipped"), "{shown}");
    }

    #[test]
    fn the_document_has_the_same_facts() {
        let shown = document(&pushed(), &skipped()).unwrap();
        assert_eq!(shown["skipped"], json!([{ "file": "x\u{1b}[2J\n.mcap", "reason": "is a FIFO" }]));
        assert_eq!(shown["episodes"][1]["episode"]["id"], "ep_2");
        assert_eq!(shown["episodes"][1]["existed"], true);
        assert_eq!(shown["failures"], json!([{ "file": "c.mcap", "error": "not an MCAP file" }]));
        assert_eq!((&shown["sent_bytes"], &shown["megabytes_per_second"]), (&json!(3_000_000), &json!(6.0)));
    }
}
