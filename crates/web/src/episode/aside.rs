//! The panel beside the cameras: the matched expert, labels, report, facts.

use gleaner_core::{Finding, Report, Severity, curation::Standing, episode::Label, id::EpisodeId};
use maud::{Markup, html};

use super::{Scored, View, uses};
use crate::{
    episodes::{buttons, live},
    frames, link, sheet, standing, text,
};

/// The whole panel.
pub(super) fn aside(view: &View) -> Markup {
    html! {
        div.beside {
            @if view.labels() { (labelling()) }
            (matched(view))
            (history(view))
            (uses::panel(view))
            (report(view))
            (facts(view))
        }
    }
}

fn labelling() -> Markup {
    html! {
        section.panel aria-label="Label" {
            h2 { "Label" }
            div.row {
                (buttons("focused"))
                button #undo type="button" disabled { "Undo " kbd { "z" } }
            }
            label.wide { "Reason " input #reason maxlength="255"; }
            (live())
        }
    }
}

/// The expert's step matched with the current step. A script updates it.
fn matched(view: &View) -> Markup {
    let Some(scored) = &view.scored else { return html! {} };
    let first = usize::try_from(view.step).ok().and_then(|step| nearest(scored, step));
    html! {
        section.panel aria-labelledby="match-head" {
            h2 #match-head { "Matched expert" }
            @match first {
                None => p.soft { "This run's scorer has no matches." },
                Some((expert, step, distances)) => {
                    @let shown = view.experts.has_page(expert);
                    div #match {
                        div.cameras {
                            @for camera in &view.task.spec.cameras {
                                figure.camera {
                                    img data-match=(camera.name) hidden[!shown]
                                        src=[shown.then(|| format!("{}{step}", frames::before_step(expert, &camera.name)))]
                                        width=(camera.width) height=(camera.height)
                                        alt=(format!("{} of the expert at the matched step", camera.name));
                                    figcaption { (camera.name) }
                                }
                            }
                        }
                        p {
                            a #match-link href=[shown.then(|| format!("/episodes/{expert}?step={step}&run={}", scored.run.id))] {
                                (link::short(expert.as_str())) " at step " (step)
                            }
                            span #match-deleted hidden[shown] { (standing::tag(Standing::Deleted)) }
                        }
                        h3 { "Distances of features" }
                        dl.facts {
                            @for ((name, text), distance) in MODALITIES.iter().zip(distances) {
                                dt { (text) }
                                dd.number data-distance=(name) { (format!("{distance:.3}")) }
                            }
                            dt { "q here" } dd #q-here.number { (q_at(scored, view.step)) }
                        }
                    }
                }
            }
        }
    }
}

/// The names of the modalities, in the order of distances.
const MODALITIES: [(&str, &str); 3] = [("o", "Images o"), ("m", "Proprioception m"), ("a", "Action a")];

fn nearest(scored: &Scored, step: usize) -> Option<(&EpisodeId, u32, [f32; 3])> {
    let scores = &scored.scores;
    let expert = usize::try_from(*scores.match_episode.get(step)?).ok()?;
    Some((scored.run.expert_ids.get(expert)?, *scores.match_step.get(step)?, *scores.distances.get(step)?))
}

fn q_at(scored: &Scored, step: u64) -> String {
    let q = usize::try_from(step).ok().and_then(|step| scored.scores.q.get(step));
    q.map_or("–".to_owned(), |q| format!("{q:.3}"))
}

fn history(view: &View) -> Markup {
    html! {
        section.panel aria-labelledby="labels-head" {
            h2 #labels-head { "Labels" }
            ol #labels.labels reversed { @for label in view.labels.iter().rev() { (given(label)) } }
            (sheet::links(&view.request))
        }
    }
}

fn given(label: &Label) -> Markup {
    let outcome = label.outcome.as_str();
    html! {
        li {
            span class=(format!("tag {outcome}")) { (outcome) } " "
            @if !label.cohort.is_empty() { (label.cohort) " " }
            span.soft { @if !label.author.is_empty() { "by " (label.author) ", " } (text::time(label.created_at)) " UTC" }
            @if !label.reason.is_empty() { br; "“" (label.reason) "”" }
        }
    }
}

fn report(view: &View) -> Markup {
    let report = &view.inspected.report;
    html! {
        section.panel aria-labelledby="report-head" {
            h2 #report-head { "Report" }
            @if report.findings.is_empty() {
                p { span.tag.success { "clean" } " No findings." }
            }
            ul.findings { @for finding in &report.findings { (found(view, finding)) } }
            dl.facts {
                dt { "Rate" } dd { (format!("{:.2}", report.rate_hz)) " Hz; the task declares " (view.task.spec.rate_hz) " Hz" }
                dt { "Messages" } dd { (text::count(report.messages)) }
                @if report.dropped_ticks > 0 { dt { "Ticks dropped" } dd { (text::count(report.dropped_ticks)) } }
            }
            (topics(report))
        }
    }
}

fn found(view: &View, finding: &Finding) -> Markup {
    let class = match finding.severity {
        Severity::Error => "tag failure",
        Severity::Warning => "tag warned",
        Severity::Note => "tag",
    };
    let code = serde_json::to_value(finding.code).unwrap_or_default();
    html! {
        li {
            span class=(class) { (code.as_str().unwrap_or_default().replace('_', " ")) } " " code { (finding.subject) } " "
            @if let Some(step) = finding.first_step {
                a data-step=(step) href=(view.request.with("step", Some(&step.to_string()))) { "step " (step) }
            }
            br; (finding.detail)
        }
    }
}

fn topics(report: &Report) -> Markup {
    html! {
        details {
            summary { (text::counted(u64::try_from(report.topics.len()).unwrap_or(u64::MAX), "topic")) }
            ul.topics { @for topic in &report.topics {
                li {
                    code { (topic.topic) } " " span.soft { (text::counted(topic.messages, "message")) ", " (topic.encoding)
                        @if !topic.schema.is_empty() { " " (topic.schema) }
                        @if !topic.used { ", not read" } }
                }
            } }
        }
    }
}

fn facts(view: &View) -> Markup {
    let episode = &view.inspected.episode;
    html! {
        section.panel aria-labelledby="facts-head" {
            h2 #facts-head { "Recording" }
            dl.facts {
                dt { "Id" } dd.id { (episode.id) }
                dt { "Task" } dd { (view.task.spec.name) }
                dt { "File" } dd { (episode.file_name) }
                dt { "Size" } dd { (text::bytes(episode.size_bytes)) }
                dt { "Mapping" } dd { (episode.mapping) }
                dt { "BLAKE3" } dd.id { (episode.recording) }
            }
            p { a.button href=(format!("/episodes/{}/recording.mcap", episode.id)) download { "Download the MCAP" } }
            @if let Some(scored) = &view.scored {
                p { a.button download
                    href=(format!("/episodes/{}/scored.mcap?run={}&beta={}", episode.id, scored.run.id, view.beta))
                    { "Download it with scores" } }
            }
        }
    }
}
