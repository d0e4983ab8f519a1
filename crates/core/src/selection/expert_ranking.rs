//! How often q ranks experts above the imperfect segments of a run and of each of its cohorts, and the warnings where it
//! does not. Scores that cannot tell the two apart select segments at random.

use std::collections::BTreeMap;

use super::Candidate;

/// Share of pairs below which a cohort has a warning. Chance is 0.5.
const HARDLY: f64 = 0.55;

/// The AUROC of q between the segments of experts and imperfect ones: the share of pairs in which the expert's q is
/// higher, ties counted half. Below 0.5 the scores favour imperfect episodes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExpertRanking {
    /// Over all imperfect segments; `None` without any, or without scores of experts.
    pub all: Option<f64>,
    /// Over those of each cohort, by name.
    pub cohorts: Vec<(String, f64)>,
}

impl ExpertRanking {
    /// Of the q of each imperfect episode with its cohort, and those of experts.
    pub fn new<'a>(imperfect: impl Iterator<Item = (&'a str, &'a [f32])>, mut experts: Vec<f32>) -> Self {
        experts.sort_unstable_by(f32::total_cmp);
        let mut cohorts: BTreeMap<&str, Vec<f32>> = BTreeMap::new();
        for (cohort, q) in imperfect {
            cohorts.entry(cohort).or_default().extend(q);
        }
        let (mut doubled, mut pairs) = (0, 0);
        let mut ranked = Vec::new();
        for (cohort, mut q) in cohorts {
            q.sort_unstable_by(f32::total_cmp);
            let (wins, of) = (doubled_wins(&experts, &q), (experts.len() * q.len()) as u128);
            (doubled, pairs) = (doubled + wins, pairs + of);
            ranked.extend(share(wins, of).map(|share| (cohort.to_owned(), share)));
        }
        Self { all: share(doubled, pairs), cohorts: ranked }
    }

    /// Of the imperfect episodes of a run, and the q of its experts' segments.
    pub fn of_candidates(candidates: &[Candidate], experts: Vec<f32>) -> Self {
        Self::new(candidates.iter().map(|one| (one.cohort.as_str(), one.q.as_slice())), experts)
    }

    /// The cohorts of which an expert's segment has the higher q in less than this share of pairs.
    pub fn below(&self, share: f64) -> impl Iterator<Item = &str> {
        self.cohorts.iter().filter(move |(_, of_cohort)| *of_cohort < share).map(|(name, _)| name.as_str())
    }

    /// A sentence for each thing that a user should look at before they select segments by these scores, with a selection
    /// that leaves out the cohorts of [`ExpertRanking::below`] this share (0: none).
    #[must_use]
    pub fn warnings(&self, left_out_below: f64) -> Vec<String> {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        if let Some(all) = self.all.filter(|all| *all < 0.5) {
            let left_out: Vec<String> = self.below(left_out_below).map(these).collect();
            let left_out =
                if left_out.is_empty() { String::new() } else { format!("; it leaves out {}", left_out.join(", ")) };
            return vec![format!(
                "the scores favour imperfect episodes over experts: the expert's segment has the higher q in {} of pairs. \
                 Check the labels and some episodes, or choose another scorer, before a dataset is used{left_out}",
                percent(all)
            )];
        }
        let of_cohort = |(cohort, share): &(String, f64)| {
            let (their, them) = if cohort.is_empty() { ("their", "them") } else { ("its", "its episodes") };
            let fact = format!("an expert's step has the higher q in {} of pairs", percent(*share));
            let these = these(cohort);
            let leave_out = |below: f64| {
                let command = format!("`gleaner dataset create --min-expert-auroc {below}`");
                format!("If steps with a high q are bad, leave {them} out: {command}")
            };
            match *share {
                share if share < left_out_below => Some(format!(
                    "the dataset leaves out {these}: {fact}, so the scores may not see what is wrong there. \
                     `--min-expert-auroc 0` keeps {their} steps with a high q"
                )),
                share if share < 0.5 => Some(format!(
                    "the scores favour {these} over experts: {fact}. Check {their} labels, and look at some of {them}. {}",
                    leave_out(0.5)
                )),
                share if share < HARDLY => Some(format!(
                    "the scores hardly tell {these} from experts: {fact}. Either {their} steps are as good, or the scorer does \
                     not see what is wrong with them. {}",
                    leave_out(HARDLY)
                )),
                _ => None,
            }
        };
        self.cohorts.iter().filter_map(of_cohort).collect()
    }
}

/// A cohort in a sentence.
fn these(cohort: &str) -> String {
    if cohort.is_empty() { "episodes without a cohort".to_owned() } else { format!("cohort {cohort:?}") }
}

/// Twice the number of pairs that the expert wins, a tie counted as half a win. Both are sorted.
fn doubled_wins(experts: &[f32], imperfect: &[f32]) -> u128 {
    let (mut below, mut upto, mut doubled) = (0, 0, 0_u128);
    for q in experts {
        below += imperfect[below..].iter().take_while(|other| *other < q).count();
        upto = upto.max(below);
        upto += imperfect[upto..].iter().take_while(|other| *other <= q).count();
        doubled += (below + upto) as u128;
    }
    doubled
}

#[expect(clippy::cast_precision_loss, reason = "a share to read")]
fn share(doubled: u128, pairs: u128) -> Option<f64> {
    (pairs > 0).then(|| doubled as f64 / (2 * pairs) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cohorts: &[(&str, &[f32])], experts: &[f32]) -> ExpertRanking {
        ExpertRanking::new(cohorts.iter().copied(), experts.to_vec())
    }

    #[test]
    fn the_share_is_that_of_pairs_that_experts_win() {
        let share = |imperfect: &[f32], experts: &[f32]| of(&[("a", imperfect)], experts).all;
        assert_eq!(share(&[0.1, 0.2], &[0.3, 0.9]), Some(1.0));
        assert_eq!(share(&[0.5, 0.5], &[0.5]), Some(0.5));
        assert_eq!(share(&[0.1, 0.5, 0.9], &[0.2, 0.5]), Some(2.5 / 6.0));
        assert_eq!(share(&[1.0], &[0.0]), Some(0.0));
        // An outlier leaves the others close together.
        assert_eq!(share(&[0.0, 0.999_998, 0.999_997], &[1.0, 0.999_999]), Some(1.0));
        assert_eq!((share(&[0.1], &[]), share(&[], &[0.1])), (None, None));
    }

    #[test]
    fn cohorts_add_up_to_all() {
        let ranking = of(&[("late", &[0.9]), ("early", &[0.1, 0.5]), ("late", &[0.2]), ("empty", &[])], &[0.3, 0.5]);
        assert_eq!(ranking.cohorts, [("early".to_owned(), 2.5 / 4.0), ("late".to_owned(), 0.5)]);
        assert_eq!(ranking.all, Some(4.5 / 8.0));
        assert_eq!(of(&[], &[0.1]), ExpertRanking::default());
    }

    #[test]
    fn scores_that_do_not_rank_experts_higher_have_a_warning() {
        let ranking = |all, cohorts: &[(&str, f64)]| ExpertRanking {
            all: Some(all),
            cohorts: cohorts.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect(),
        };
        assert!(ranking(0.7, &[("a", 0.6), ("b", 0.99)]).warnings(0.0).is_empty());
        assert!(ExpertRanking::default().warnings(0.0).is_empty());
        let warnings = ranking(0.6, &[("a", 0.48), ("b", 0.52), ("c", 0.9)]).warnings(0.0);
        let [favoured, alike] = warnings.as_slice() else { panic!("{warnings:?}") };
        let begin = "the scores favour cohort \"a\" over experts: an expert's step has the higher q in 48 % of pairs. Check its";
        assert!(favoured.starts_with(begin), "{favoured}");
        assert!(
            favoured.ends_with("leave its episodes out: `gleaner dataset create --min-expert-auroc 0.5`"),
            "{favoured}"
        );
        assert!(alike.starts_with("the scores hardly tell cohort \"b\" from experts: an expert's step has"), "{alike}");
        assert!(alike.ends_with("--min-expert-auroc 0.55`"), "{alike}");
        let left_out = ranking(0.6, &[("a", 0.48), ("b", 0.52), ("c", 0.9)]).warnings(0.5);
        assert!(left_out[0].starts_with("the dataset leaves out cohort \"a\": an expert's step has"), "{left_out:?}");
        assert!(left_out[0].contains("`--min-expert-auroc 0` keeps its steps"), "{left_out:?}");
        assert!(left_out.len() == 2 && left_out[1].contains("hardly tell cohort \"b\""), "{left_out:?}");
        let left_out = ranking(0.4, &[("a", 0.4), ("", 0.3), ("c", 0.5)]).warnings(0.5);
        let ending = "it leaves out cohort \"a\", episodes without a cohort";
        assert!(left_out.len() == 1 && left_out[0].ends_with(ending), "{left_out:?}");
        let unnamed = ranking(0.6, &[("", 0.48)]).warnings(0.0);
        assert!(unnamed[0].contains("favour episodes without a cohort over experts: an expert's step"), "{unnamed:?}");
        assert!(unnamed[0].contains("Check their labels, and look at some of them"), "{unnamed:?}");
        let unnamed = ranking(0.6, &[("", 0.52)]).warnings(0.0);
        assert!(unnamed[0].contains("hardly tell episodes without a cohort from experts"), "{unnamed:?}");
        let reversed = ranking(0.4, &[("a", 0.4)]).warnings(0.0);
        assert!(reversed.len() == 1 && reversed[0].contains("favour imperfect episodes over experts"), "{reversed:?}");
        assert!(reversed[0].ends_with("before a dataset is used"), "{reversed:?}");
    }
}
