//! `runs`, `scores`, `histogram`: quality, seen.

use clap::Args;
use gleaner_proto::v1::{
    EpisodeScores, GetEpisodeScoresRequest, GetHistogramRequest, GetHistogramResponse, KeptCount, ListScoreRunsRequest,
    ScoreRun,
};

use super::selection::beta_of;
use crate::context::Context;
use crate::failure::{Result, present};
use crate::output::terminal_width;
use crate::table::Column::{Left, Right};
use crate::table::table;
use crate::{chart, json, words};

const CHART_ROWS: usize = 8;

#[derive(Args, Debug)]
pub(crate) struct RunsArgs {
    /// Name or id of the task. Default: the only task of the server.
    #[arg(long)]
    task: Option<String>,
}

impl RunsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let client = context.client().await?;
        let request = ListScoreRunsRequest { task: context.task(&client, self.task.as_deref()).await? };
        let reply = client.scores().list_score_runs(request).await?.into_inner();
        let columns = [
            Left("ID"),
            Left("ENCODER"),
            Left("SCORED BY"),
            Right("IMPERFECT"),
            Right("SEGMENTS"),
            Right("EXPERT SEGMENTS"),
            Right("LO"),
            Right("HI"),
            Left("CREATED"),
        ];
        let row = |run: &ScoreRun| {
            [
                run.id.clone(),
                run.encoder_id.clone(),
                scored_by(run),
                run.imperfect_episodes.to_string(),
                run.imperfect_segments.to_string(),
                run.expert_segments.to_string(),
                format!("{:.4}", run.lo),
                format!("{:.4}", run.hi),
                words::moment(run.create_time.as_ref()),
            ]
        };
        context.output.result(|| json::value(&reply), || table(columns, reply.score_runs.iter().map(row)))?;
        match reply.score_runs.first() {
            Some(run) => context.output.next(format_args!("gleaner histogram {}", run.id)),
            None => context.output.next("gleaner score --encoder ENCODER --wait"),
        }
        Ok(())
    }
}

#[derive(Args, Debug)]
pub(crate) struct ScoresArgs {
    /// Id of the score run.
    run: String,
    /// Id of the episode.
    episode: String,
    /// Threshold that the chart shows as a line, 0 to 1. Default: that of the run.
    #[arg(long)]
    beta: Option<f64>,
    /// Also list the nearest expert step of each step with its distances.
    #[arg(long)]
    matches: bool,
}

impl ScoresArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = GetEpisodeScoresRequest { score_run_id: self.run.clone(), episode_id: self.episode };
        let client = context.client().await?;
        let reply = client.scores().get_episode_scores(request).await?.into_inner();
        let scores = present(reply.scores.as_ref(), "scores")?;
        let beta = beta_of(&client, &self.run, self.beta).await?;
        let what = format!("{} ({})", scores.episode_id, words::role(scores.role()));
        let text = || shown(&what, scores, beta, self.matches);
        context.output.result(|| json::value(&reply), text)?;
        context.output.next(if self.matches {
            format!("gleaner dataset create --run {} --beta {beta}", self.run)
        } else {
            format!("gleaner scores {} {} --matches", self.run, scores.episode_id)
        });
        Ok(())
    }
}

/// What was scored as a person looks at it; with its matches below if `listed`.
pub(super) fn shown(what: &str, scores: &EpisodeScores, beta: f64, listed: bool) -> String {
    let drawn = drawing(what, scores, beta, terminal_width());
    if listed { format!("{drawn}\n\n{}", matches(scores)) } else { drawn }
}

/// The curve of q over the steps of what was scored, and the facts of it.
fn drawing(what: &str, scores: &EpisodeScores, beta: f64, width: usize) -> String {
    let q = &scores.q;
    let kept = q.iter().filter(|&&q| f64::from(q) > beta).count();
    let (mut low, mut high, mut sum) = (f32::INFINITY, f32::NEG_INFINITY, 0.0_f64);
    for &value in q {
        low = low.min(value);
        high = high.max(value);
        sum += f64::from(value);
    }
    #[expect(clippy::cast_precision_loss, reason = "an episode's steps are far below 2^52")]
    let mean = sum / q.len().max(1) as f64;
    let spread = if q.is_empty() { "no steps".into() } else { format!("mean {mean:.3}, min {low:.3}, max {high:.3}") };
    format!(
        "q of {what}, {} steps: {spread}; {kept} steps above β = {beta}\n{}",
        q.len(),
        chart::curve(q, width, CHART_ROWS, Some(beta))
    )
}

/// Each step with its nearest expert step.
fn matches(scores: &EpisodeScores) -> String {
    let columns = [
        Right("STEP"),
        Right("Q"),
        Right("W"),
        Left("NEAREST EXPERT"),
        Right("ITS STEP"),
        Right("D IMAGE"),
        Right("D PROPRIO"),
        Right("D ACTION"),
    ];
    fn at<T: Copy>(values: &[T], step: usize, show: impl Fn(T) -> String) -> String {
        values.get(step).map_or_else(|| "-".into(), |value| show(*value))
    }
    let three = |value: f32| format!("{value:.3}");
    let expert = |index: u32| {
        let id = usize::try_from(index).ok().and_then(|index| scores.expert_ids.get(index));
        id.cloned().unwrap_or_else(|| "-".into())
    };
    let row = |step: usize| {
        [
            step.to_string(),
            at(&scores.q, step, three),
            at(&scores.w, step, |w| format!("{w:.3}")),
            at(&scores.match_episode, step, expert),
            at(&scores.match_step, step, |matched| matched.to_string()),
            at(&scores.distance_o, step, three),
            at(&scores.distance_m, step, three),
            at(&scores.distance_a, step, three),
        ]
    };
    table(columns, (0..scores.q.len()).map(row))
}

#[derive(Args, Debug)]
pub(crate) struct HistogramArgs {
    /// Id of the score run.
    run: String,
    /// Thresholds, 0 to 1, for which kept segments are counted.
    #[arg(long, value_delimiter = ',', default_value = "0.1,0.3,0.5,0.7,0.9")]
    beta: Vec<f64>,
    /// Number of bins of the histogram, at most 1000. More bins show finer detail.
    #[arg(long, default_value_t = 20)]
    bins: u32,
}

impl HistogramArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let request = GetHistogramRequest { score_run_id: self.run.clone(), bins: self.bins, betas: self.beta };
        let reply = context.client().await?.scores().get_histogram(request).await?.into_inner();
        context.output.result(|| json::value(&reply), || histogram(&reply, terminal_width()))?;
        context.output.next(format_args!("gleaner dataset create --run {}", self.run));
        Ok(())
    }
}

/// Bars of the counts, and what each threshold keeps.
pub(crate) fn histogram(histogram: &GetHistogramResponse, width: usize) -> String {
    let most = histogram.counts.iter().copied().max().unwrap_or(0);
    let room = width.saturating_sub(26).clamp(10, 60);
    #[expect(clippy::cast_precision_loss, reason = "there are at most 1000 bins")]
    let edge = |bin: usize| bin as f64 / histogram.counts.len() as f64;
    let mut lines = vec![format!("q of {} segments", histogram.segments)];
    for (bin, &count) in histogram.counts.iter().enumerate() {
        let bar = chart::bar(count, most, room);
        lines.push(format!("{:.2}–{:.2} {count:>8} {bar}", edge(bin), edge(bin + 1)).trim_end().to_owned());
    }
    let columns = [Right("β"), Right("KEPT"), Right("SHARE"), Right("FROM EPISODES")];
    let row = |kept: &KeptCount| {
        [
            format!("{:.2}", kept.beta),
            kept.segments.to_string(),
            words::percent(kept.segments, histogram.segments),
            kept.episodes.to_string(),
        ]
    };
    if let Some(auroc) = histogram.expert_auroc {
        lines.push(String::new());
        lines
            .push(format!("an expert's segment has the higher q in {:.0} % of pairs (ties count half)", 100.0 * auroc));
        if auroc < 0.5 {
            lines.push("warning: the scores favour imperfect episodes over experts".to_owned());
        }
    }
    lines.push(String::new());
    lines.push(table(columns, histogram.kept.iter().map(row)));
    lines.join("\n")
}

/// The scorer and its settings in words.
fn scored_by(run: &ScoreRun) -> String {
    let settings = gleaner_core::proto::from_struct(run.settings.clone());
    let text = |value: &serde_json::Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let other = ["scorer", "normaliser", "device"];
    let own = settings.iter().filter(|(name, _)| !other.contains(&name.as_str()));
    let own = own.map(|(name, value)| format!("{name}={}", text(value)));
    let scorer = settings.get("scorer").map(text).unwrap_or_default();
    std::iter::once(scorer).chain(own).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_histogram_is_drawn() {
        let reply = GetHistogramResponse {
            counts: vec![0, 5, 10, 1],
            segments: 16,
            kept: vec![
                KeptCount { beta: 0.5, segments: 11, episodes: 3 },
                KeptCount { beta: 0.9, segments: 0, episodes: 0 },
            ],
            expert_counts: vec![1, 0, 0, 1],
            expert_auroc: Some(0.4),
        };
        assert_eq!(
            histogram(&reply, 36),
            "q of 16 segments\n\
             0.00–0.25        0\n\
             0.25–0.50        5 █████\n\
             0.50–0.75       10 ██████████\n\
             0.75–1.00        1 █\n\
             \n\
             an expert's segment has the higher q in 40 % of pairs (ties count half)\n\
             warning: the scores favour imperfect episodes over experts\n\
             \n   \
             β  KEPT   SHARE  FROM EPISODES\n\
             0.50    11  68.8 %              3\n\
             0.90     0   0.0 %              0"
        );
    }

    fn scores() -> EpisodeScores {
        EpisodeScores {
            episode_id: "ep_7".into(),
            role: gleaner_proto::v1::Role::Imperfect.into(),
            q: vec![1.0, 0.5],
            w: vec![-0.25, -2.0],
            match_episode: vec![0, 9],
            match_step: vec![4, 5],
            distance_o: vec![0.125, 1.0],
            distance_m: vec![0.0625, 0.5],
            distance_a: vec![0.0625],
            expert_ids: vec!["ep_1".into()],
        }
    }

    #[test]
    fn an_episode_is_drawn_with_its_facts() {
        let drawn = drawing("ep_7 (imperfect)", &scores(), 0.9, 80);
        let first = drawn.lines().next();
        assert_eq!(
            first,
            Some("q of ep_7 (imperfect), 2 steps: mean 0.750, min 0.500, max 1.000; 1 steps above β = 0.9")
        );
        assert_eq!(drawn.lines().count(), 1 + CHART_ROWS + 2);
    }

    #[test]
    fn matches_show_the_expert_step_and_leave_gaps_empty() {
        let listed = matches(&scores());
        let rows: Vec<Vec<&str>> = listed.lines().skip(1).map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[0], ["0", "1.000", "-0.250", "ep_1", "4", "0.125", "0.062", "0.062"]);
        assert_eq!(rows[1], ["1", "0.500", "-2.000", "-", "5", "1.000", "0.500", "-"]);
    }

    #[test]
    fn an_episode_without_steps_does_not_panic() {
        let drawn = drawing("ep_7", &EpisodeScores::default(), 0.9, 80);
        assert!(drawn.contains("no steps"), "{drawn}");
        assert!(matches(&EpisodeScores::default()).contains("NEAREST EXPERT"));
    }
}
