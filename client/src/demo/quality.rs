//! How well q tells the steps before an episode went wrong from the steps after: against the simulator's own
//! mark, which no job ever saw.

use gleaner_sim::AgentKind;
use gleaner_sim::statistics::{auroc, precision_recall};
use serde::Serialize;

/// One imperfect episode: its q and from where on it went wrong.
#[derive(Clone, Debug)]
pub(crate) struct MarkedEpisode {
    pub(crate) id: String,
    pub(crate) kind: AgentKind,
    /// The mark; `None` when it never did.
    pub(crate) went_wrong: Option<u32>,
    /// One value a step.
    pub(crate) q: Vec<f32>,
}

impl MarkedEpisode {
    /// Each step's q, and whether the step was still good.
    pub(crate) fn steps(&self) -> impl Iterator<Item = (f64, bool)> {
        let good = |step: u32| self.went_wrong.is_none_or(|wrong| step < wrong);
        (0..).zip(&self.q).map(move |(step, q)| (f64::from(*q), good(step)))
    }
}

/// Quality over some imperfect episodes.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Separation {
    /// A kind of agent, or `all`.
    pub(crate) agent: String,
    pub(crate) episodes: usize,
    pub(crate) good_steps: usize,
    pub(crate) wrong_steps: usize,
    /// Mean q of either.
    pub(crate) mean_q_good: Option<f64>,
    pub(crate) mean_q_wrong: Option<f64>,
    /// Chance that a good step has a higher q than a wrong one.
    pub(crate) auroc: Option<f64>,
}

/// What a threshold keeps.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Threshold {
    pub(crate) beta: f64,
    pub(crate) kept: usize,
    pub(crate) share: f64,
    /// Share of the kept steps that are good.
    pub(crate) precision: Option<f64>,
    /// Share of the good steps that are kept.
    pub(crate) recall: Option<f64>,
}

/// Overall, then for each kind that there is.
pub(crate) fn separations(episodes: &[MarkedEpisode]) -> Vec<Separation> {
    let all: Vec<&MarkedEpisode> = episodes.iter().collect();
    let mut rows = vec![separation("all", &all)];
    for kind in AgentKind::ALL {
        let of_kind: Vec<&MarkedEpisode> = episodes.iter().filter(|episode| episode.kind == kind).collect();
        if !of_kind.is_empty() {
            rows.push(separation(kind.name(), &of_kind));
        }
    }
    rows
}

fn separation(agent: &str, episodes: &[&MarkedEpisode]) -> Separation {
    let steps: Vec<(f64, bool)> = episodes.iter().flat_map(|episode| episode.steps()).collect();
    let of = |good: bool| -> Vec<f64> { steps.iter().filter(|step| step.1 == good).map(|step| step.0).collect() };
    let (good, wrong) = (of(true), of(false));
    Separation {
        agent: agent.to_owned(),
        episodes: episodes.len(),
        good_steps: good.len(),
        wrong_steps: wrong.len(),
        mean_q_good: mean(&good),
        mean_q_wrong: mean(&wrong),
        auroc: auroc(&steps),
    }
}

#[expect(clippy::cast_precision_loss, reason = "counts of steps are far below 2^52")]
fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// What each β keeps (q > β), and how good that is.
#[expect(clippy::cast_precision_loss, reason = "counts of steps are far below 2^52")]
pub(crate) fn thresholds(episodes: &[MarkedEpisode], betas: &[f64]) -> Vec<Threshold> {
    let steps: Vec<(f64, bool)> = episodes.iter().flat_map(MarkedEpisode::steps).collect();
    let good: Vec<bool> = steps.iter().map(|step| step.1).collect();
    let row = |&beta: &f64| {
        let kept: Vec<bool> = steps.iter().map(|step| step.0 > beta).collect();
        let (precision, recall) = precision_recall(&kept, &good);
        let count = kept.iter().filter(|kept| **kept).count();
        Threshold { beta, kept: count, share: count as f64 / steps.len().max(1) as f64, precision, recall }
    };
    betas.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episodes() -> Vec<MarkedEpisode> {
        let episode = |kind, went_wrong, q: &[f32]| MarkedEpisode { id: "ep".into(), kind, went_wrong, q: q.to_vec() };
        vec![
            episode(AgentKind::Freeze, Some(2), &[1.0, 0.75, 0.25, 0.0]),
            episode(AgentKind::Wander, Some(1), &[0.5, 0.75]),
            episode(AgentKind::Noise, None, &[0.5]),
        ]
    }

    #[test]
    fn steps_before_the_mark_are_good_and_an_unmarked_episode_is_all_good() {
        let rows = separations(&episodes());
        let counts: Vec<_> = rows.iter().map(|r| (r.agent.as_str(), r.good_steps, r.wrong_steps, r.auroc)).collect();
        // Over all: good 1, .75, .5, .5 against wrong .25, 0, .75: 9.5 of 12 pairs.
        assert_eq!(
            counts,
            [
                ("all", 4, 3, Some(9.5 / 12.0)),
                ("freeze", 2, 2, Some(1.0)),
                ("wander", 1, 1, Some(0.0)),
                ("noise", 1, 0, None),
            ]
        );
        assert_eq!(rows[1].mean_q_good, Some(0.875));
        assert_eq!(rows[3].mean_q_wrong, None);
    }

    #[test]
    fn thresholds_keep_what_is_strictly_above() {
        let rows = thresholds(&episodes(), &[0.5, 1.0]);
        assert_eq!((rows[0].kept, rows[0].precision, rows[0].recall), (3, Some(2.0 / 3.0), Some(0.5)));
        assert_eq!((rows[1].kept, rows[1].precision, rows[1].recall), (0, None, Some(0.0)));
        assert!((rows[0].share - 3.0 / 7.0).abs() < 1e-12);
    }
}
