//! One snapshot: its episodes, their roles and labels then, and their labels now.

use axum::{extract::Path, response::IntoResponse as _};
use gleaner_core::{
    curation::{FrozenEpisode, LabelSeen, SnapshotChanges, Standing},
    id::SnapshotId,
    snapshot::Snapshot,
};
use maud::{Markup, html};
use serde_json::json;

use super::{episodes, of_snapshot};
use crate::{
    link,
    page_request::PageRequest,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
    standing, text,
};

/// Episodes shown on the page; the table for programs has all.
const SHOWN: u32 = 200;

pub(crate) async fn show(request: PageRequest, Path(id): Path<String>) -> Answer {
    let format = sheet::format(&request)?;
    let backend = request.backend();
    let snapshot = backend.snapshot(&SnapshotId::parse("id", &id)?).await?;
    if format != Format::Html {
        let held = backend.snapshot_episodes(&snapshot.id, None).await?;
        return Ok(table_sheet(&snapshot, held).answer(format)?);
    }
    let held = backend.snapshot_episodes(&snapshot.id, Some(SHOWN)).await?;
    let changes = backend.snapshot_changes(&snapshot.id).await?;
    let count = snapshot.expert_episodes + snapshot.imperfect_episodes;
    let task = backend.task_by_id(&snapshot.task_id).await?;
    let body = html! {
        h1 { "Snapshot " (link::tail(snapshot.id.as_str())) }
        p.lead { "The episodes of " (task.spec.name) ", frozen " (text::time(snapshot.created_at)) " UTC: " (episodes(&snapshot)) }
        (figures(&snapshot, changes))
        h2 { "Episodes" }
        (table(&held))
        @if count > u64::from(SHOWN) {
            p.formats { "The first " (SHOWN) " of " (text::counted(count, "episode")) ", in the order in which jobs see them." }
        }
        (sheet::links(&request))
        h2 { "Lineage" }
        (of_snapshot(backend, &snapshot).await?)
        h2 { "Facts" }
        (facts(&snapshot))
    };
    let head = Head { title: "Snapshot", tab: Tab::Runs, task: Some(&task.spec.name), script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

fn figures(snapshot: &Snapshot, changes: SnapshotChanges) -> Markup {
    let SnapshotChanges { relabelled, deleted } = changes;
    html! {
        dl.figures {
            div { dt { "Experts" } dd { (text::count(snapshot.expert_episodes)) } }
            div { dt { "Imperfect" } dd { (text::count(snapshot.imperfect_episodes)) } }
            div { dt { "Relabelled since" } dd { (text::count(relabelled)) } }
            @if deleted > 0 { div { dt { "Recordings deleted" } dd { (text::count(deleted)) } } }
        }
        @if deleted > 0 {
            p.note.bad { "Recordings were permanently deleted, so jobs cannot use this snapshot. Create a new snapshot, or push the recordings again." }
        }
    }
}

fn table(held: &[FrozenEpisode]) -> Markup {
    html! {
        div.scroll.tall tabindex="0" role="region" aria-label="Episodes" { table {
            thead { tr { th { "Episode" } th { "Role" } th { "Label then" } th.number { "Version" } th { "Label now" } } }
            tbody { @for held in held { (row(held)) } }
        } }
    }
}

fn row(held: &FrozenEpisode) -> Markup {
    let id = held.episode_id.as_str();
    html! { tr {
        td.name {
            @if held.standing == Standing::Deleted { (held.file_name) } @else { a href=(format!("/episodes/{id}")) { (held.file_name) } }
            " " span.id.soft title=(id) { (link::short(id)) }
            (standing::tag(held.standing))
        }
        td { (held.role.as_str()) }
        td { (label(&held.then)) }
        td.number { @match held.then.version { Some(version) => (version), None => "–" } }
        td { @if held.relabelled() { span.tag.warned { "now" } " " (label(&held.now)) } @else { span.soft { "unchanged" } } }
    } }
}

fn label(seen: &LabelSeen) -> Markup {
    let outcome = seen.outcome.as_str();
    html! {
        span class=(format!("tag {outcome}")) { (outcome) }
        " " @if seen.cohort.is_empty() { span.soft { "no cohort" } } @else { (seen.cohort) }
    }
}

/// Every episode, for programs.
fn table_sheet(snapshot: &Snapshot, held: Vec<FrozenEpisode>) -> Sheet {
    let row = |held: FrozenEpisode| {
        let FrozenEpisode { episode_id, file_name, role, then, now, standing } = held;
        vec![
            json!(episode_id),
            json!(file_name),
            json!(role.as_str()),
            json!(then.outcome.as_str()),
            json!(then.cohort),
            json!(then.version),
            json!(now.outcome.as_str()),
            json!(now.cohort),
            json!(now.version),
            json!(standing.as_str()),
        ]
    };
    let columns = &[
        "episode_id",
        "file_name",
        "role",
        "outcome",
        "cohort",
        "label_version",
        "outcome_now",
        "cohort_now",
        "label_version_now",
        "standing",
    ];
    Sheet { name: snapshot.id.to_string(), columns, rows: held.into_iter().map(row).collect() }
}

fn facts(snapshot: &Snapshot) -> Markup {
    let rule = &snapshot.rule;
    html! {
        dl.facts.panel {
            dt { "Snapshot" } dd.id { (snapshot.id) }
            dt { "Created" } dd { (text::time(snapshot.created_at)) " UTC" }
            dt { "Rule" } dd { (episodes(snapshot)) }
            @if rule.max_experts > 0 || rule.imperfect_per_expert > 0.0 { dt { "Sampling seed" } dd { (rule.seed) } }
        }
    }
}

#[cfg(test)]
mod tests {
    use gleaner_core::{episode::Outcome, id::EpisodeId, snapshot::Role};

    use super::*;

    #[test]
    fn a_row_has_the_labels_then_and_now() {
        let seen = LabelSeen { outcome: Outcome::Failure, cohort: String::new(), version: None };
        let one = || FrozenEpisode {
            episode_id: EpisodeId::new(),
            file_name: "a.mcap".into(),
            role: Role::Imperfect,
            then: seen.clone(),
            now: LabelSeen { version: Some(1), ..seen.clone() },
            standing: Standing::Present,
        };
        let held: Vec<FrozenEpisode> = (0..3).map(|_| one()).collect();
        let shown = table(&held).into_string();
        assert_eq!(shown.matches("<tr>").count(), 1 + 3);
        assert!(shown.contains("unchanged") && shown.contains("<td class=\"number\">–</td>"));
        let snapshot = Snapshot {
            id: SnapshotId::new(),
            task_id: gleaner_core::id::TaskId::new(),
            rule: gleaner_core::snapshot::RoleRule::default(),
            expert_episodes: 0,
            imperfect_episodes: 3,
            created_at: gleaner_core::time::Millis(0),
        };
        assert_eq!(table_sheet(&snapshot, held).rows.len(), 3);
    }
}
