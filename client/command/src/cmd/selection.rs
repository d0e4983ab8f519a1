//! Selections: from arguments, and as text. Must not depend on a server.

use clap::Args;
use gleaner_client::Client;
use gleaner_core::proto::selection::{shape_from_proto, shape_to_proto};
use gleaner_core::selection::{Rule, Selection, SelectionShape};
use gleaner_proto::v1::{self, GetScoreRunRequest};

use crate::failure::{Result, present};

/// The selection of one dataset.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct SelectionArgs {
    /// Keep segments with a quality above this threshold, 0 to 1. Default: that of the run's normaliser: 0.5 of
    /// calibrated, 0.8 of quantile, 0.9 of minmax.
    #[arg(long, allow_negative_numbers = true)]
    beta: Option<f64>,
    /// Instead of --beta, keep this fraction of the segments, the best ones.
    #[arg(long, value_name = "FRACTION", conflicts_with = "beta")]
    top: Option<f64>,
    #[command(flatten)]
    shape: SelectionShape,
}

impl SelectionArgs {
    /// The rule, if one was given.
    pub(crate) fn rule(&self) -> Option<Rule> {
        self.top.map(Rule::TopFraction).or(self.beta.map(Rule::Beta))
    }

    pub(crate) fn shape(&self) -> SelectionShape {
        self.shape
    }

    /// The selection as it is sent, without a rule where the run's default holds.
    pub(crate) fn to_proto(self) -> v1::Selection {
        let rule = self.rule().map(|rule| match rule {
            Rule::Beta(beta) => v1::selection::Rule::Beta(beta),
            Rule::TopFraction(fraction) => v1::selection::Rule::TopFraction(fraction),
        });
        v1::Selection { rule, shape: shape_to_proto(self.shape) }
    }
}

/// The threshold of a command about one score run: the given one, or the run's default.
pub(crate) async fn beta_of(client: &Client, run: &str, given: Option<f64>) -> Result<f64> {
    if let Some(beta) = given {
        return Ok(beta);
    }
    let request = GetScoreRunRequest { score_run_id: run.to_owned() };
    let reply = client.scores().get_score_run(request).await?.into_inner();
    Ok(present(reply.score_run, "a score run")?.default_beta)
}

/// Reads a threshold on q.
pub(crate) fn threshold(text: &str) -> std::result::Result<f64, String> {
    let beta: f64 = text.parse().map_err(|_| "expected a number between 0 and 1".to_owned())?;
    if (0.0..=1.0).contains(&beta) { Ok(beta) } else { Err(format!("is {beta}, must be between 0 and 1")) }
}

/// A threshold in a table: two decimals, or as many as it has.
pub(super) fn decimals(beta: f64) -> String {
    let two = format!("{beta:.2}");
    if two.parse::<f64>() == Ok(beta) { two } else { beta.to_string() }
}

/// A fraction in percent, without the digits that the multiplication adds.
fn percent(fraction: f64) -> f64 {
    (fraction * 1e8).round() / 1e6
}

/// A selection as options of a command.
pub(crate) fn options(Selection { rule, shape }: Selection) -> String {
    let rule = match rule {
        Rule::Beta(beta) => format!("--beta {beta}"),
        Rule::TopFraction(fraction) => format!("--top {fraction}"),
    };
    let shape = shape.changed().into_iter().map(|(name, value)| format!(" --{} {value}", name.replace('_', "-")));
    std::iter::once(rule).chain(shape).collect()
}

/// A selection in words.
pub(crate) fn selected(selection: Option<&v1::Selection>) -> String {
    let Some(v1::Selection { rule: Some(rule), shape }) = selection else { return "-".into() };
    let rule = match rule {
        v1::selection::Rule::Beta(beta) => format!("q > {beta}"),
        v1::selection::Rule::TopFraction(fraction) => format!("top {} %", percent(*fraction)),
    };
    match shape_from_proto("shape", *shape) {
        Ok(shape) if shape.is_off() => rule,
        Ok(shape) => format!("{rule}, {shape}"),
        // From a server with another range.
        Err(_) => format!("{rule}, with a shape"),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use gleaner_core::proto::selection::selection_to_proto;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: SelectionArgs,
    }

    fn parse(options: &str) -> std::result::Result<SelectionArgs, String> {
        let words = std::iter::once("x").chain(options.split_whitespace());
        Line::try_parse_from(words).map(|line| line.args).map_err(|error| error.to_string())
    }

    #[test]
    fn options_are_a_selection_and_back() {
        assert_eq!(parse("").unwrap().to_proto(), v1::Selection::default(), "the server takes the run's default");
        let given = "--top 0.1 --close-gaps 2 --max-per-phase 200 --max-share-of-episode 0.5 --phases 4";
        let args = parse(given).unwrap();
        let selection = Selection { rule: args.rule().unwrap(), shape: args.shape() };
        assert_eq!(args.to_proto(), selection_to_proto(selection));
        assert_eq!(options(selection), given);
        let text = "top 10 %, close_gaps 2, max_share_of_episode 0.5, phases 4, max_per_phase 200";
        assert_eq!(selected(Some(&selection_to_proto(selection))), text);
        assert_eq!(selected(Some(&selection_to_proto(Selection::beta(0.5)))), "q > 0.5");
        assert_eq!(selected(None), "-");
        for (fraction, text) in [(0.07, "top 7 %"), (0.29, "top 29 %"), (0.001_234, "top 0.1234 %"), (1.0, "top 100 %")]
        {
            assert_eq!(selected(Some(&selection_to_proto(Selection::top_fraction(fraction)))), text);
        }
    }

    #[test]
    fn a_threshold_is_between_0_and_1_and_shown_with_its_decimals() {
        assert_eq!(["0", "0.5", "1"].map(threshold), [Ok(0.0), Ok(0.5), Ok(1.0)]);
        for text in ["3", "-0.1", "nan", "inf", "half", ""] {
            assert!(threshold(text).unwrap_err().contains("between 0 and 1"), "{text}");
        }
        assert_eq!([0.5, 0.05, 0.995, 0.0001].map(decimals), ["0.50", "0.05", "0.995", "0.0001"]);
    }

    #[test]
    fn a_wrong_option_is_rejected_by_name() {
        assert!(parse("--phases 0").unwrap_err().contains("--phases: is 0, must be between 1 and 1000"));
        assert!(parse("--max-share-of-episode 1.5").unwrap_err().contains("--max-share-of-episode: is 1.5"));
        assert!(parse("--beta 0.5 --top 0.1").is_err());
    }
}
