//! Evaluations of policies.

use super::{
    Store, fault,
    page::newest_first,
    row::{self, Column as _, record},
    sql::{self, QueryBuilder, Transaction},
};
use crate::{
    domain::{
        evaluation::Evaluation,
        id::{EvaluationId, PolicyId},
        job::JobKind,
        page::Page,
    },
    error::Result,
};

record! { Evaluation: id, policy_id, job_id, simulation, seeds, created_at }

/// Adds an evaluation.
pub(super) async fn insert(tx: &mut Transaction, evaluation: &Evaluation) -> Result<()> {
    sql::query(
        "insert into evaluations (id, policy_id, job_id, simulation, seeds, created_at) values ($1, $2, $3, $4, $5, $6)",
    )
    .bind(evaluation.id.param())
    .bind(evaluation.policy_id.param())
    .bind(evaluation.job_id.param())
    .bind(&evaluation.simulation)
    .bind(evaluation.seeds.param())
    .bind(evaluation.created_at.param())
    .execute(&mut *tx)
    .await
    .map_err(fault("adding an evaluation"))?;
    Ok(())
}

impl Store {
    /// Stores an evaluation that ran elsewhere; its policy must exist.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn insert_evaluation(&self, evaluation: &Evaluation) -> Result<()> {
        let mut tx = self.write().await?;
        insert(&mut tx, evaluation).await?;
        self.commit(tx).await
    }

    /// A finished evaluation.
    ///
    /// # Errors
    /// NotFound, or Precondition naming its job when that has not succeeded.
    pub(crate) async fn evaluation(&self, id: &EvaluationId) -> Result<Evaluation> {
        let found = sql::query("select * from evaluations where id = $1")
            .bind(id.param())
            .try_map(row::read)
            .fetch_optional(self.read())
            .await
            .map_err(fault("reading an evaluation"))?;
        match found {
            Some(found) => Ok(found),
            None => Err(self.missing(JobKind::Evaluate, "evaluation", id.as_str()).await),
        }
    }

    /// A policy's evaluations, newest first.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn evaluations(&self, policy: &PolicyId) -> Result<Vec<Evaluation>> {
        Ok(self.evaluations_page(policy, &Page::whole()).await?.0)
    }

    /// A page of a policy's evaluations, newest first, and the evaluation that the next one follows.
    ///
    /// # Errors
    /// Internal.
    pub(crate) async fn evaluations_page(
        &self,
        policy: &PolicyId,
        page: &Page<EvaluationId>,
    ) -> Result<(Vec<Evaluation>, Option<EvaluationId>)> {
        let mut query = QueryBuilder::new("select * from evaluations where policy_id = ");
        query.push_bind(policy.param());
        let found = newest_first(self.read(), query, page, |evaluation: &Evaluation| evaluation.id.clone()).await;
        found.map_err(fault("reading evaluations"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        domain::{episode::Outcome, evaluation::SeedResult, time::Millis},
        error::Kind,
        store::testing::{self, results},
    };

    #[tokio::test]
    async fn evaluations_are_listed_newest_first() {
        let (_dir, store) = testing::store().await;
        let task = testing::task(&store).await;
        testing::episode(&store, &task, Outcome::Success, "").await;
        testing::episode(&store, &task, Outcome::Failure, "").await;
        let encoder = results::encoder(&store, &task).await;
        let policy = results::policy(&store, &task, &encoder, blake3::hash(b"policy").into()).await;
        let mut made = Vec::new();
        for successes in [3, 7] {
            let evaluation = Evaluation {
                id: EvaluationId::new(),
                policy_id: policy.id.clone(),
                job_id: None,
                simulation: "a robot".into(),
                seeds: vec![SeedResult { seed: u64::MAX, episodes: 10, successes, mean_steps: 0.1 }],
                created_at: Millis::now(),
            };
            store.insert_evaluation(&evaluation).await.unwrap();
            made.insert(0, evaluation);
        }
        assert_eq!(store.evaluations(&policy.id).await.unwrap(), made);
        assert_eq!(store.evaluation(&made[1].id).await.unwrap(), made[1]);
        assert_eq!(store.evaluation(&EvaluationId::new()).await.unwrap_err().kind(), Kind::NotFound);
        assert!(store.evaluations(&PolicyId::new()).await.unwrap().is_empty());
    }
}
