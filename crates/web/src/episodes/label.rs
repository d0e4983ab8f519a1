//! Labelling: the request of a page, and the answer when another person was first.

use axum::{
    body::Bytes,
    extract::Path,
    http::StatusCode,
    response::{IntoResponse as _, Response},
};
use gleaner_core::{
    Error, Result,
    curation::{Labelled, Overtaken},
    episode::{Episode, NewLabel},
    id::{EpisodeId, TaskId},
    tag::tag,
    time::Millis,
};
use maud::{Markup, html};
use serde::Deserialize;
use serde_json::{Value, json};

use super::query::outcome;
use crate::{
    Backend,
    change::change,
    page_request::{PageRequest, read},
    refusal::Answer,
    text,
};

/// The most episodes in one request.
const MANY: usize = 1000;
/// The most episodes named in one entry of the audit log.
const NAMED: usize = 31;

/// A label for some episodes, each with the label's version shown on the page.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sent {
    episodes: Vec<LabelledVersion>,
    outcome: String,
    /// If omitted, each keeps its own.
    cohort: Option<String>,
    #[serde(default)]
    reason: String,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LabelledVersion {
    id: String,
    version: i64,
}

impl Sent {
    fn read(self, author: &str) -> Result<(Vec<(EpisodeId, i64)>, NewLabel)> {
        if self.episodes.is_empty() || self.episodes.len() > MANY {
            return Err(Error::invalid("episodes", format!("name 1 to {MANY} of them")));
        }
        let id = |(at, labelled): (usize, LabelledVersion)| {
            Ok((EpisodeId::parse(&format!("episodes[{at}].id"), &labelled.id)?, labelled.version))
        };
        let label = NewLabel {
            outcome: Some(outcome("outcome", &self.outcome)?),
            cohort: self.cohort.map(|cohort| tag("cohort", cohort)).transpose()?,
            author: author.to_owned(),
            reason: tag("reason", self.reason)?,
        };
        Ok((self.episodes.into_iter().enumerate().map(id).collect::<Result<_>>()?, label))
    }
}

pub(crate) async fn label(request: PageRequest, Path(task): Path<String>, body: Bytes) -> Response {
    let labelled = async {
        let sent = read::<Sent>(&body)?;
        sent.episodes.iter().take(NAMED).for_each(|labelled| request.audit.about("episode_id", &labelled.id));
        given(&request, &task, sent).await
    };
    change(&request, [("task", task.as_str())], labelled).await
}

async fn given(request: &PageRequest, task: &str, sent: Sent) -> Answer {
    let (labelled, label) = sent.read(request.caller.name())?;
    let backend = request.backend();
    let task = backend.task(task).await?;
    belong(backend, &task.id, &labelled).await?;
    Ok(match backend.label_episodes(&labelled, &label).await? {
        Labelled::Done(episodes) => done(&episodes, &label.author),
        Labelled::Changed(changed) => overtaken(&changed),
    })
}

/// Rejects episodes of another task.
async fn belong(backend: &dyn Backend, task: &TaskId, labelled: &[(EpisodeId, i64)]) -> Result<()> {
    for (id, _) in labelled {
        if backend.task_of_episode(id).await? != *task {
            return Err(Error::invalid("episodes", format!("{id} is of another task; no episode was labelled")));
        }
    }
    Ok(())
}

fn done(episodes: &[(Episode, i64)], author: &str) -> Response {
    let now = text::time(Millis::now());
    let row = |(episode, version): &(Episode, i64)| -> Value {
        json!({
            "id": episode.id, "version": version, "outcome": episode.outcome.as_str(), "cohort": episode.cohort,
            "by": author, "at": now,
        })
    };
    axum::Json(json!({ "episodes": episodes.iter().map(row).collect::<Vec<_>>() })).into_response()
}

fn overtaken(changed: &[Overtaken]) -> Response {
    let row = |one: &Overtaken| -> Value {
        json!({
            "id": one.episode_id, "version": one.label_version, "outcome": one.label.outcome.as_str(),
            "cohort": one.label.cohort, "by": one.label.author, "at": text::time(one.label.created_at),
        })
    };
    let answer = json!({
        "error": "another person labelled some of these episodes in the meantime; no label was changed",
        "changed": changed.iter().map(row).collect::<Vec<_>>(),
    });
    (StatusCode::CONFLICT, axum::Json(answer)).into_response()
}

/// The bar above the table: the focused episode, and label buttons for it or the selected ones.
pub(super) fn bar(cohorts: &[String]) -> Markup {
    html! {
        section #bar.panel aria-label="Label" {
            div.row {
                strong #focused { "Press j or click a row to begin." }
                (buttons("focused"))
                button #undo type="button" disabled { "Undo " kbd { "z" } }
                button #help type="button" { "Keys " kbd { "?" } }
            }
            div #strip {}
            div #selected.row hidden {
                strong #count {}
                label { "Cohort " input #cohort list="cohorts" maxlength="255" placeholder="keep"; }
                label { "Reason " input #reason maxlength="255"; }
                (buttons("selected"))
                button #none type="button" { "Select none" }
                datalist #cohorts { @for cohort in cohorts.iter().filter(|cohort| !cohort.is_empty()) { option value=(cohort) {} } }
            }
            (live())
        }
        dialog #keys aria-label="Keys" {
            h2 { "Keys" }
            dl.facts {
                @for (keys, does) in KEYS {
                    dt { @for key in *keys { kbd { (key) } " " } }
                    dd { (does) }
                }
            }
            form method="dialog" { button { "Close" } }
        }
    }
}

const KEYS: &[(&[&str], &str)] = &[
    (&["j", "↓"], "Next episode"),
    (&["k", "↑"], "Previous episode"),
    (&["s"], "Label success and move to the next episode"),
    (&["f"], "Label failure and move to the next episode"),
    (&["u"], "Label unknown and move to the next episode"),
    (&["z"], "Undo the last labelling"),
    (&["a"], "Label anyway, after another person labelled the episode"),
    (&["Esc"], "Cancel, or dismiss the message"),
    (&["x"], "Select; Shift and a click select a range"),
    (&["o", "Enter"], "Open the episode"),
    (&["n", "p"], "Next page, previous page"),
    (&["?"], "Show these keys"),
];

/// The place of a script's messages.
pub(crate) fn live() -> Markup {
    html! { div #message role="status" aria-live="polite" {} }
}

/// A button for each outcome; `whom`: the focused or the selected episodes.
pub(crate) fn buttons(whom: &str) -> Markup {
    html! {
        span.outcomes role="group" aria-label=(format!("Label the {whom}")) {
            @for (outcome, text, key) in [("success", "Success", "s"), ("failure", "Failure", "f"), ("unknown", "Unknown", "u")] {
                button type="button" class=(outcome) data-label=(outcome) data-whom=(whom) {
                    (text) @if whom == "focused" { " " kbd { (key) } }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use axum::body::to_bytes;
    use gleaner_core::episode::{Label, Outcome};

    use super::*;

    const ID: &str = "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV";

    fn sent(body: &Value) -> Result<(Vec<(EpisodeId, i64)>, NewLabel)> {
        read::<Sent>(body.to_string().as_bytes())?.read("ann")
    }

    #[test]
    fn a_label_names_the_seen_versions() {
        let body = json!({ "episodes": [{ "id": ID, "version": 3 }], "outcome": "success", "reason": "held it" });
        let (labelled, label) = sent(&body).unwrap();
        assert_eq!((labelled[0].0.as_str(), labelled[0].1), (ID, 3));
        assert_eq!((label.outcome, label.cohort, label.author.as_str()), (Some(Outcome::Success), None, "ann"));
    }

    #[test]
    fn invalid_labels_are_named() {
        let labelled = json!([{ "id": ID, "version": 3 }]);
        for (field, body) in [
            ("episodes: ", json!({ "episodes": [], "outcome": "success" })),
            ("episodes[0].id: ", json!({ "episodes": [{ "id": "7", "version": 1 }], "outcome": "success" })),
            ("outcome: ", json!({ "episodes": labelled, "outcome": "won" })),
            ("cohort: ", json!({ "episodes": labelled, "outcome": "success", "cohort": "a\nb" })),
            ("reason: ", json!({ "episodes": labelled, "outcome": "success", "reason": "x".repeat(300) })),
            ("body: ", json!({ "episodes": labelled, "outcome": "success", "author": "another person" })),
        ] {
            let error = sent(&body).unwrap_err();
            assert!(error.message().starts_with(field), "{field} {error}");
        }
    }

    #[tokio::test]
    async fn an_outdated_label_returns_the_newer_one() {
        let label = Label {
            outcome: Outcome::Failure,
            cohort: "weak".into(),
            author: "ben".into(),
            reason: String::new(),
            created_at: Millis(1_800_000_000_000),
        };
        let changed = [Overtaken { episode_id: EpisodeId::parse("id", ID).unwrap(), label_version: 9, label }];
        let response = overtaken(&changed);
        assert_eq!(response.status(), StatusCode::CONFLICT);
        let answer: Value = serde_json::from_slice(&to_bytes(response.into_body(), 1 << 16).await.unwrap()).unwrap();
        let expected = json!([{
            "id": ID, "version": 9, "outcome": "failure", "cohort": "weak", "by": "ben", "at": "2027-01-15 08:00",
        }]);
        assert_eq!(answer["changed"], expected);
    }
}
