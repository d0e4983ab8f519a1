//! The snapshots of an episode; their pages show the results made from them.

use gleaner_core::curation::SnapshotUse;
use maud::{Markup, html};

use super::View;
use crate::{link, text};

/// The most snapshots named.
pub(super) const MOST: u32 = 8;

/// The snapshots, newest first, each with the episode's role and label; empty without snapshots.
pub(super) fn panel(view: &View) -> Markup {
    let (uses, of) = &view.uses;
    if uses.is_empty() {
        return html! {};
    }
    html! {
        section.panel aria-labelledby="uses-head" {
            h2 #uses-head { "Used in snapshots" }
            ul.uses { @for held in uses { (one(held)) } }
            @if *of > u64::from(MOST) { p.soft { "and " (text::counted(of - u64::from(MOST), "older snapshot")) } }
        }
    }
}

fn one(held: &SnapshotUse) -> Markup {
    let (id, outcome) = (held.snapshot_id.as_str(), held.outcome.as_str());
    html! {
        li {
            (link::brief(id, link::page(id).as_deref())) " as " (held.role.as_str()) ", labelled "
            span class=(format!("tag {outcome}")) { (outcome) }
            @if !held.cohort.is_empty() { " " (held.cohort) }
            br; span.soft { (text::time(held.created_at)) " UTC" }
        }
    }
}
