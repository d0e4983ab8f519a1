//! The kinds of jobs, policies, weightings, objectives and scorers, with every setting: its allowed values, default and
//! documentation.

use axum::response::IntoResponse as _;
use gleaner_core::{
    Setting, Shape,
    kinds::{Family, Kind, Needs},
};
use maud::{Markup, html};
use serde_json::{Value, json};

use super::{
    page_request::PageRequest,
    refusal::Answer,
    sheet::{self, Format, Sheet},
    shell::{self, Head, Tab},
};

/// The title of a family, its word, and its kinds.
type Section = (&'static str, &'static str, Vec<Kind>);

pub(super) async fn show(request: PageRequest) -> Answer {
    let format = sheet::format(&request)?;
    let sections = sections();
    if format != Format::Html {
        return Ok(table(&sections).answer(format)?);
    }
    let body = html! {
        h1 { "Kinds" }
        p.lead { "The jobs, policies, weightings, objectives and scorers of this server, with their settings. The first of a family is its default." }
        @for (title, family, kinds) in &sections {
            h2 { (title) }
            p { @for kind in kinds { a.tag href=(format!("#{family}-{}", kind.name)) { (kind.name) } " " } }
            @for kind in kinds { (panel(family, kind)) }
        }
        (sheet::links(&request))
    };
    let head = Head { title: "Kinds", tab: Tab::Kinds, task: None, script: None };
    Ok(shell::page(&request, &head, &body).into_response())
}

fn sections() -> [Section; 5] {
    let family = |title, family: Family| (title, family.as_str(), family.kinds().to_vec());
    [
        ("Jobs", "job", gleaner_core::job_kinds()),
        family("Policies", Family::Policy),
        family("Weightings", Family::Weighting),
        family("Objectives", Family::Objective),
        family("Scorers", Family::Scorer),
    ]
}

fn panel(family: &str, kind: &Kind) -> Markup {
    let needs = needs(kind.needs);
    html! {
        section.panel.kind id=(format!("{family}-{}", kind.name)) {
            h3 { (kind.name) @if kind.title != kind.name { " " small.soft { (kind.title) } } }
            p { (kind.about) @if !needs.is_empty() { span.soft { " Needs " (needs.join(", ")) "." } } }
            @if !kind.settings.is_empty() {
                div.scroll { table {
                    thead { tr { th { "Setting" } th { "Values" } th { "Default" } th { "Effect" } } }
                    tbody { @for setting in &kind.settings { (row(setting)) } }
                } }
            }
        }
    }
}

fn row(setting: &Setting) -> Markup {
    html! { tr {
        td { code { (setting.name) } }
        td { (allowed(&setting.shape)) }
        td { code { (text(&setting.default)) } }
        td.effect {
            (setting.about)
            @let words = setting.shape.words();
            @if !words.is_empty() { dl.facts { @for known in words { dt { (known.word) } dd { (known.about) } } } }
        }
    } }
}

/// What a kind requires besides recordings.
fn needs(needs: Needs) -> Vec<&'static str> {
    let Needs { encoder, history, images, all_episodes } = needs;
    let named = [
        (encoder, "a pretrained encoder"),
        (history, "earlier steps"),
        (images, "camera images"),
        (all_episodes, "all episodes at once"),
    ];
    named.into_iter().filter_map(|(needed, name)| needed.then_some(name)).collect()
}

/// The allowed values of a setting.
fn allowed(shape: &Shape) -> String {
    let words = || shape.words().iter().map(|known| known.word.as_str()).collect::<Vec<_>>().join(", ");
    match shape {
        Shape::Integer { least, most } => format!("whole number, {least} to {most}"),
        Shape::Number { least, most } => format!("number, {least} to {most}"),
        Shape::Flag => "true or false".to_owned(),
        Shape::Word { .. } => format!("one of {}", words()),
        Shape::Words { .. } => format!("some of {}", words()),
        Shape::Numbers { names, least, most } => format!("numbers for {}, {least} to {most} each", names.join(", ")),
        Shape::Integers { most, count } => format!("up to {count} whole numbers, up to {most} each"),
        Shape::Text => "text".to_owned(),
    }
}

/// A default, for display.
fn text(value: &Value) -> String {
    match value {
        Value::String(text) if text.is_empty() => "(empty)".to_owned(),
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join(", "),
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::Object(_) => value.to_string(),
    }
}

/// A row of each kind, followed by a row of each of its settings.
fn table(sections: &[Section]) -> Sheet {
    let mut rows = Vec::new();
    for (family, kind) in sections.iter().flat_map(|(_, family, kinds)| kinds.iter().map(move |kind| (family, kind))) {
        rows.push(vec![json!(family), json!(kind.name), Value::Null, Value::Null, Value::Null, json!(kind.about)]);
        rows.extend(kind.settings.iter().map(|Setting { name, about, shape, default }| {
            vec![json!(family), json!(kind.name), json!(name), json!(allowed(shape)), default.clone(), json!(about)]
        }));
    }
    Sheet { name: "kinds".to_owned(), columns: &["family", "kind", "setting", "values", "default", "about"], rows }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_and_setting_is_shown_with_its_documentation() {
        for (_, family, kinds) in &sections() {
            assert!(!kinds.is_empty(), "{family}");
            for kind in kinds {
                let shown = panel(family, kind).into_string();
                for text in
                    kind.settings.iter().flat_map(|setting| [&setting.name, &setting.about]).chain([&kind.about])
                {
                    let escaped = html! { (text) }.into_string();
                    assert!(shown.contains(&escaped), "{family} {}: {text}", kind.name);
                }
            }
        }
    }

    #[test]
    fn a_kind_is_shown_as_text() {
        let setting = Setting { name: "<i>".into(), about: "<u>".into(), shape: Shape::Text, default: json!("<s>") };
        let (name, about) = ("<b>".to_owned(), "a & b".to_owned());
        let kind = Kind { title: name.clone(), name, about, needs: Needs::default(), settings: vec![setting] };
        let shown = panel("policy", &kind).into_string();
        assert!(shown.contains("&lt;b&gt;") && shown.contains("a &amp; b"), "{shown}");
        assert!(["<b>", "<i>", "<u>", "<s>"].iter().all(|raw| !shown.contains(raw)), "{shown}");
    }

    #[test]
    fn values_and_defaults_are_readable() {
        let (least, most) = (0.0, 0.5);
        assert_eq!(allowed(&Shape::Integer { least: 1, most: 9 }), "whole number, 1 to 9");
        assert_eq!(allowed(&Shape::Number { least, most }), "number, 0 to 0.5");
        let names = vec!["x".to_owned(), "y".to_owned()];
        assert_eq!(allowed(&Shape::Numbers { names, least, most }), "numbers for x, y, 0 to 0.5 each");
        assert_eq!([text(&json!("")), text(&json!(["a", 1])), text(&json!(true))], ["(empty)", "a, 1", "true"]);
    }
}
