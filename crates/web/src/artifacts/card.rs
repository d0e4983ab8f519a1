//! Cards in a row: each stage from episodes to robots, with the results of one lineage.

use gleaner_core::job::JobState;
use maud::{Markup, html};

use crate::link;

/// The most cards of a stage shown.
const MOST: usize = 6;

/// A stage of the way, in its order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stage {
    Episodes,
    Encoder,
    Scores,
    Dataset,
    Policy,
    Use,
}

impl Stage {
    const ALL: [Self; 6] = [Self::Episodes, Self::Encoder, Self::Scores, Self::Dataset, Self::Policy, Self::Use];

    fn name(self) -> &'static str {
        match self {
            Self::Episodes => "Episodes",
            Self::Encoder => "Encoder",
            Self::Scores => "Score run",
            Self::Dataset => "Dataset",
            Self::Policy => "Policy",
            Self::Use => "Evaluations and deployments",
        }
    }
}

/// One result, or a use of one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Card {
    pub(super) stage: Stage,
    /// Its id; cards with equal ids are merged.
    pub(super) id: String,
    /// The link of the card.
    pub(super) to: Option<String>,
    /// A short description.
    pub(super) summary: String,
    /// The state of its job, while the result does not exist.
    pub(super) state: Option<JobState>,
}

/// The cards by stage, left to right; `here` is the id of the page's own result.
pub(super) fn row(cards: &[Card], here: &str) -> Markup {
    html! {
        ol.lineage {
            @for stage in Stage::ALL {
                @let of: Vec<&Card> = cards.iter().filter(|card| card.stage == stage).collect();
                @if !of.is_empty() {
                    li {
                        h3 { (stage.name()) }
                        ul {
                            @for card in shown(&of, here) { (one(card, card.id == here)) }
                            @if of.len() > MOST { li.soft { "and " (of.len() - MOST) " more" } }
                        }
                    }
                }
            }
        }
    }
}

/// The first few, including the page's own.
fn shown<'a>(cards: &[&'a Card], here: &str) -> Vec<&'a Card> {
    let mut cards = cards.to_vec();
    cards.sort_by_key(|card| card.id != here);
    cards.truncate(MOST);
    cards
}

fn one(card: &Card, here: bool) -> Markup {
    html! {
        li.link-card.here[here] {
            @if here { span.id title=(card.id) aria-current="true" { (link::short(&card.id)) } }
            @else { (link::brief(&card.id, card.to.as_deref())) }
            @if let Some(state) = card.state { " " span class=(format!("tag {}", state.as_str())) { (state.as_str()) } }
            @if !card.summary.is_empty() { div.soft { (card.summary) } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn card(stage: Stage, id: &str) -> Card {
        Card { stage, id: id.into(), to: Some(format!("/x/{id}")), summary: String::new(), state: None }
    }

    #[test]
    fn stages_are_in_order_and_the_page_itself_is_not_a_link() {
        let row = row(&[card(Stage::Policy, "pol"), card(Stage::Episodes, "snap")], "pol").into_string();
        assert!(row.find("Episodes").is_some_and(|at| Some(at) < row.find("Policy")));
        assert!(row.contains("href=\"/x/snap\"") && !row.contains("href=\"/x/pol\""));
        assert!(!row.contains("Dataset"), "an empty stage is left out");
    }

    #[test]
    fn the_pages_own_card_is_always_shown() {
        let cards: Vec<Card> = (0..10).map(|n| card(Stage::Dataset, &format!("ds{n}"))).collect();
        let row = row(&cards, "ds9").into_string();
        assert!(row.contains("ds9") && row.contains("and 4 more") && !row.contains("/x/ds8"));
    }
}
