//! Reports of running jobs: progress on the job's row, and a row for each metric.

mod plotted;

use std::collections::HashMap;

use futures::TryStreamExt as _;

use self::plotted::Plotted;
use super::{
    Store, attempt, fault,
    row::{self, Column as _, record},
    sql::{self, Transaction},
};
use crate::{
    domain::{attempt::Attempt, id::JobId, job::Metric, work::Progress},
    error::Result,
};

impl Store {
    /// Stores a worker's report; returns whether the job was asked to stop.
    ///
    /// # Errors
    /// Precondition when the attempt has ended.
    pub(crate) async fn report_progress(&self, attempt: &Attempt, progress: &Progress) -> Result<bool> {
        let mut tx = self.write().await?;
        let job = attempt::running(&mut tx, attempt).await?.ok_or_else(attempt::attempt_is_over)?;
        sql::query(
            "update jobs set done = $1, total = $2, message = case when cancel_requested then message else $3 end, \
             peak_memory_bytes = case when peak_memory_bytes < $4 then $4 else peak_memory_bytes end where id = $5",
        )
        .bind(progress.done.param())
        .bind(progress.total.param())
        .bind(&progress.message)
        .bind(progress.peak_memory_bytes.param())
        .bind(job.id.param())
        .execute(&mut tx)
        .await
        .map_err(fault("keeping progress"))?;
        for (step, name, value) in &progress.metrics {
            sql::query("insert into job_metrics (job_id, step, name, value) values ($1, $2, $3, $4)")
                .bind(job.id.param())
                .bind(step.param())
                .bind(name)
                .bind(value)
                .execute(&mut tx)
                .await
                .map_err(fault("keeping a metric"))?;
        }
        crate::fail_point::pass("progress.rows_written");
        self.commit(tx).await?;
        crate::fail_point::pass("progress.committed");
        Ok(job.cancel_requested)
    }

    /// At most `limit` metrics of a job that arrived after `sequence`, in order of arrival.
    pub(crate) async fn metrics(&self, job: &JobId, sequence: i64, limit: u32) -> Result<Vec<Metric>> {
        sql::query("select id, step, name, value from job_metrics where job_id = $1 and id > $2 order by id limit $3")
            .bind(job.param())
            .bind(sequence)
            .bind(limit)
            .try_map(row::read)
            .fetch_all(self.read())
            .await
            .map_err(fault("reading metrics"))
    }
}

impl Store {
    /// Some of a job's metrics, in order of arrival: about `points` of each name, which are the extremes of
    /// evenly spaced stretches, so that a plot has every peak, with the first and the newest.
    ///
    /// Rows are read one by one, because a sort by value takes longer than to read them all.
    pub(crate) async fn plotted_metrics(&self, job: &JobId, points: u32) -> Result<Vec<Metric>> {
        let mut rows = sql::query("select id, step, name, value from job_metrics where job_id = $1 order by id")
            .bind(job.param())
            .try_map(row::read::<Metric>)
            .fetch(self.read());
        let mut names: HashMap<String, Plotted> = HashMap::new();
        while let Some(metric) = rows.try_next().await.map_err(fault("reading the metrics of a plot"))? {
            match names.get_mut(&metric.name) {
                Some(plotted) => plotted.add(metric),
                None => {
                    names.insert(metric.name.clone(), Plotted::new(points, metric));
                }
            }
        }
        let mut metrics: Vec<Metric> = names.into_values().flat_map(Plotted::metrics).collect();
        metrics.sort_by_key(|metric| metric.sequence);
        Ok(metrics)
    }
}

record! { Metric: sequence = "id", step, name, value }

/// Removes the metrics of steps that the next attempt will repeat.
pub(super) async fn cut_back(tx: &mut Transaction, job: &JobId, checkpoint_step: Option<u64>) -> Result<()> {
    sql::query("delete from job_metrics where job_id = $1 and step > $2")
        .bind(job.param())
        .bind(checkpoint_step.map_or(-1, |step| i64::try_from(step).unwrap_or(i64::MAX)))
        .execute(&mut *tx)
        .await
        .map_err(fault("cutting metrics back"))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::testing;

    #[tokio::test]
    async fn a_plot_has_every_peak_of_each_name_in_order_of_arrival() {
        let (_dir, store) = testing::store().await;
        let attempt = testing::claimed(&store, &testing::task(&store).await.id, "local").await;
        let id = attempt.job_id.clone();
        let loss = |step| if step == 42 { 9.0 } else { 0.5 };
        let both = |step: u64| [(step, "loss".to_owned(), loss(step)), (step, "rate".to_owned(), -loss(step))];
        let late = [(95, "share".to_owned(), 0.25)];
        let progress = Progress { metrics: (1..=95).flat_map(both).chain(late).collect(), ..Progress::default() };
        store.report_progress(&attempt, &progress).await.unwrap();

        let metrics = store.plotted_metrics(&id, 10).await.unwrap();
        assert!(metrics.is_sorted_by(|one, next| one.sequence < next.sequence), "each once");
        let of = |name: &str| metrics.iter().filter(|one| one.name == name).map(|one| one.step).collect::<Vec<_>>();
        for name in ["loss", "rate"] {
            let steps = of(name);
            assert!(steps.contains(&42) && steps.len() <= 12, "{steps:?}");
            assert_eq!((steps.first(), steps.last()), (Some(&1), Some(&95)));
        }
        assert_eq!(of("share"), [95], "there are few");
        assert_eq!(store.plotted_metrics(&id, 1000).await.unwrap(), store.metrics(&id, 0, 1000).await.unwrap());
        assert_eq!(store.plotted_metrics(&JobId::new(), 10).await.unwrap(), []);
    }
}
