//! Links of ids: each result shown on a page links to its own page, if it has one.

use gleaner_core::{
    id::{DatasetId, EncoderId, EpisodeId, JobId, PolicyId, ScoreRunId, SnapshotId},
    selection::{Rule, Selection},
};
use maud::{Markup, html};

/// The page of an id; `None` without a page.
pub(crate) fn page(id: &str) -> Option<String> {
    let found = |is: bool, folder: &str| is.then(|| format!("/{folder}/{id}"));
    found(JobId::parse("id", id).is_ok(), "jobs")
        .or_else(|| found(ScoreRunId::parse("id", id).is_ok(), "runs"))
        .or_else(|| found(DatasetId::parse("id", id).is_ok(), "datasets"))
        .or_else(|| found(PolicyId::parse("id", id).is_ok(), "policies"))
        .or_else(|| found(EncoderId::parse("id", id).is_ok(), "encoders"))
        .or_else(|| found(SnapshotId::parse("id", id).is_ok(), "snapshots"))
        .or_else(|| found(EpisodeId::parse("id", id).is_ok(), "episodes"))
}

/// An id in full, as a link if it has a page.
pub(crate) fn whole(id: &str) -> Markup {
    match page(id) {
        Some(to) => html! { a.id href=(to) { (id) } },
        None => html! { span.id { (id) } },
    }
}

/// An id by its kind and its last characters, because ids of one day begin alike; linked to `to`.
pub(crate) fn brief(id: &str, to: Option<&str>) -> Markup {
    html! {
        @match to {
            Some(to) => a.id href=(to) title=(id) { (short(id)) },
            None => span.id title=(id) { (short(id)) },
        }
    }
}

/// `run…4RRFFQ69`.
pub(crate) fn short(id: &str) -> String {
    match id.split_once('_') {
        Some((kind, rest)) if rest.len() > 8 && rest.is_ascii() => format!("{kind}…{}", &rest[rest.len() - 8..]),
        Some(_) | None => id.to_owned(),
    }
}

/// `…4RRFFQ69`, after a word for the kind.
pub(crate) fn tail(id: &str) -> String {
    short(id).split_once('…').map_or_else(|| id.to_owned(), |(_, tail)| format!("…{tail}"))
}

/// A text with its ids as links.
pub(crate) fn text(source: &str) -> Markup {
    text_where(source, |_| true)
}

/// A text with its ids as links, apart from those of episodes without a page.
pub(crate) fn text_where(source: &str, has_page: impl Fn(&EpisodeId) -> bool) -> Markup {
    let to = |part: &str| page(part).filter(|_| EpisodeId::parse("id", part).ok().is_none_or(|id| has_page(&id)));
    html! {
        @for part in parts(source) {
            @match to(part) {
                Some(to) => a.id href=(to) { (part) },
                None if is_id(part) => span.id { (part) },
                None => (part),
            }
        }
    }
}

/// The episodes that a text names.
pub(crate) fn episodes(source: &str) -> Vec<EpisodeId> {
    parts(source).into_iter().filter_map(|part| EpisodeId::parse("id", part).ok()).collect()
}

/// The words of a text, which ids are, and what is between them.
fn parts(source: &str) -> Vec<&str> {
    let inside = |character: char| character.is_ascii_alphanumeric() || character == '_';
    let mut parts = Vec::new();
    let mut rest = source;
    while !rest.is_empty() {
        let word = rest.find(|character| !inside(character)).unwrap_or(rest.len());
        let (now, later) =
            if word == 0 { rest.split_at(rest.find(inside).unwrap_or(rest.len())) } else { rest.split_at(word) };
        parts.push(now);
        rest = later;
    }
    parts
}

/// Whether a word looks like an id of any kind.
fn is_id(word: &str) -> bool {
    word.split_once('_')
        .is_some_and(|(_, rest)| rest.len() == 26 && rest.bytes().all(|byte| byte.is_ascii_alphanumeric()))
}

/// A short description of a selection.
pub(crate) fn selection(Selection { rule, shape }: Selection) -> String {
    let rule = match rule {
        Rule::Beta(beta) => format!("q > {beta}"),
        Rule::TopFraction(part) => {
            format!("best {:.4}", part * 100.0).trim_end_matches('0').trim_end_matches('.').to_owned() + " %"
        }
    };
    if shape.is_off() { rule } else { format!("{rule}, {shape}") }
}

#[cfg(test)]
mod tests {
    use gleaner_core::{id::ExportId, selection::SelectionShape};

    use super::*;

    #[test]
    fn ids_link_to_their_pages() {
        let (job, run, export) = (JobId::new(), ScoreRunId::new(), ExportId::new());
        let (encoder, snapshot) = (EncoderId::new(), SnapshotId::new());
        assert_eq!(page(job.as_str()), Some(format!("/jobs/{job}")));
        assert_eq!(page(run.as_str()), Some(format!("/runs/{run}")));
        assert_eq!(page(encoder.as_str()), Some(format!("/encoders/{encoder}")));
        assert_eq!(page(snapshot.as_str()), Some(format!("/snapshots/{snapshot}")));
        assert_eq!((page(export.as_str()), page("job_../../etc"), page("")), (None, None, None));
        assert!(
            short(job.as_str()).starts_with("job…") && job.as_str().ends_with(&short(job.as_str())["job…".len()..])
        );
        assert!(tail(job.as_str()).starts_with('…') && job.as_str().ends_with(&tail(job.as_str())["…".len()..]));
        assert_eq!((short("job_ü").as_str(), tail("job_ü").as_str()), ("job_ü", "job_ü"));
    }

    #[test]
    fn ids_in_a_text_are_links_and_the_rest_is_text() {
        let job = JobId::new();
        let markup = text(&format!("{job}, which this job waits for, <failed>: é")).into_string();
        assert!(markup.starts_with(&format!("<a class=\"id\" href=\"/jobs/{job}\">{job}</a>, which")), "{markup}");
        assert!(markup.ends_with("&lt;failed&gt;: é"), "{markup}");
        assert_eq!(text("").into_string(), "");
        let export = ExportId::new();
        assert_eq!(text(export.as_str()).into_string(), format!("<span class=\"id\">{export}</span>"));
    }

    #[test]
    fn episodes_without_a_page_are_not_links() {
        let (kept, gone, job) = (EpisodeId::new(), EpisodeId::new(), JobId::new());
        let source = format!("episodes {kept} and {gone} of {job}");
        assert_eq!(episodes(&source), [kept.clone(), gone.clone()]);
        let markup = text_where(&source, |id| *id != gone).into_string();
        for shown in [
            format!("href=\"/episodes/{kept}\""),
            format!("href=\"/jobs/{job}\""),
            format!("<span class=\"id\">{gone}<"),
        ] {
            assert!(markup.contains(&shown), "{markup}");
        }
        assert!(!markup.contains(&format!("/episodes/{gone}")), "{markup}");
    }

    #[test]
    fn selections_are_described_briefly() {
        assert_eq!(selection(Selection::beta(0.85)), "q > 0.85");
        assert_eq!(selection(Selection::top_fraction(0.125)), "best 12.5 %");
        assert_eq!(selection(Selection::top_fraction(0.1)), "best 10 %");
        let shape = SelectionShape { min_run: 5, ..SelectionShape::default() };
        assert_eq!(selection(Selection { shape, ..Selection::beta(0.9) }), "q > 0.9, min_run 5");
    }
}
