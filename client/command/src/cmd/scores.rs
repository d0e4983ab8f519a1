//! `runs`, `scores`: quality, seen.

use clap::Args;
use gleaner_core::selection::Filter;
use gleaner_proto::v1::{EpisodeScores, GetEpisodeScoresRequest, ScoreRun};

use super::selection::{beta_of, threshold};
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
        let reply = client.every_score_run(&context.task(&client, self.task.as_deref()).await?).await?;
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
            None => context.output.next("gleaner pipeline --quick --wait"),
        }
        Ok(())
    }
}

#[derive(Args, Debug)]
pub(crate) struct ScoresArgs {
    /// Id of the score run; `latest` is the newest of the episode's task.
    run: String,
    /// Id of the episode, or the file name of its recording.
    episode: String,
    /// Threshold that the chart shows as a line, 0 to 1. Default: that of the run.
    #[arg(long, value_parser = threshold)]
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
    let kept = q.iter().filter(|&&q| Filter::Above(beta).keeps(0.0, q)).count();
    let (mut low, mut high, mut sum) = (f32::INFINITY, f32::NEG_INFINITY, 0.0_f64);
    for &value in q {
        low = low.min(value);
        high = high.max(value);
        sum += f64::from(value);
    }
    #[expect(clippy::cast_precision_loss, reason = "an episode's steps are far below 2^52")]
    let mean = sum / q.len().max(1) as f64;
    let spread = if q.is_empty() { "no steps".into() } else { format!("mean {mean:.3}, min {low:.3}, max {high:.3}") };
    let stretches = stretches(q, beta);
    let stretches = if stretches.is_empty() { String::new() } else { format!(" (at {})", words::some(&stretches)) };
    format!(
        "q of {what}, {}: {spread}; {} above β = {beta}{stretches}\n{}",
        words::counted(q.len(), "step", "steps"),
        words::counted(kept, "step", "steps"),
        chart::curve(q, width, CHART_ROWS, Some(beta))
    )
}

/// The steps above β as stretches, such as `3 to 9`; a step alone is its number.
fn stretches(q: &[f32], beta: f64) -> Vec<String> {
    let kept: Vec<bool> = q.iter().map(|&q| Filter::Above(beta).keeps(0.0, q)).collect();
    let mut first = 0;
    let runs = kept.chunk_by(|one, next| one == next).map(|run| {
        first += run.len();
        (run[0], first - run.len(), first - 1)
    });
    let shown = |(first, last)| if first == last { format!("{first}") } else { format!("{first} to {last}") };
    runs.filter(|(kept, ..)| *kept).map(|(_, first, last)| shown((first, last))).collect()
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
            Some("q of ep_7 (imperfect), 2 steps: mean 0.750, min 0.500, max 1.000; 1 step above β = 0.9 (at 0)")
        );
        assert_eq!(drawn.lines().count(), 1 + CHART_ROWS + 2);
    }

    #[test]
    fn steps_above_the_threshold_are_stretches() {
        let of = |q: &[f32]| stretches(q, 0.5);
        assert_eq!(of(&[0.9, 0.5, 0.6, 0.7, 0.1, 0.8]), ["0", "2 to 3", "5"]);
        assert_eq!(of(&[0.6, 0.6]), ["0 to 1"]);
        assert!(of(&[0.5]).is_empty() && of(&[]).is_empty());
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
