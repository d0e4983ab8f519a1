//! Changes by other servers: each write notifies every connection that listens. Must not depend on what changed.

use std::{convert::Infallible, time::Duration};

use sqlx::{
    PgPool,
    postgres::{PgListener, PgPoolOptions},
};
use tokio::sync::Notify;

use super::super::{
    Store,
    sql::{CHANGES, Pool, within},
};

/// Longest time without a look: a notification can be lost with its connection.
const POLL: Duration = Duration::from_secs(5);
/// Shortest time between two looks, so that a busy leader does not keep its standbys busy.
const PAUSE: Duration = Duration::from_millis(100);

impl Store {
    /// Acts after each change of the database by any server, or several at once, until it is dropped.
    pub(crate) async fn each_change<F: Future<Output = ()> + Send>(&self, act: impl Fn() -> F + Send + Sync) {
        self.each_change_or_after(POLL, act).await;
    }

    /// The same with another time without a look.
    async fn each_change_or_after<F: Future<Output = ()> + Send>(
        &self,
        poll: Duration,
        act: impl Fn() -> F + Send + Sync,
    ) {
        let Pool::Postgres(readers) = &self.readers else { return };
        let changed = Notify::new();
        let listening = async {
            loop {
                let Err(error) = listen(readers, poll, &changed).await;
                tracing::warn!(%error, "changes by other servers are not notified and are polled");
                changed.notify_one();
                tokio::time::sleep(poll).await;
            }
        };
        let acting = async {
            loop {
                changed.notified().await;
                act().await;
                tokio::time::sleep(PAUSE).await;
            }
        };
        tokio::select! {
            () = listening => {}
            () = acting => {}
        }
    }
}

/// Passes each notification on until the connection fails.
async fn listen(readers: &PgPool, poll: Duration, changed: &Notify) -> sqlx::Result<Infallible> {
    let limit = readers.options().get_acquire_timeout();
    // A pool of its own, which ends with a connection that hangs.
    let options = readers.connect_options().as_ref().clone();
    let pool = PgPoolOptions::new().max_connections(1).acquire_timeout(limit).connect_lazy_with(options);
    let mut listener = PgListener::connect_with(&pool).await?;
    within(limit, listener.listen(CHANGES)).await?;
    loop {
        changed.notify_one();
        match tokio::time::timeout(poll, listener.try_recv()).await {
            Ok(received) => drop(received?),
            // A connection that is silent may hang.
            Err(_) => {
                within(limit, sqlx::query("select 1").execute(&mut listener)).await?;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tokio::sync::mpsc;

    use super::*;
    use crate::store::testing;

    /// Far longer than a notification takes, and far shorter than the time without a look.
    const PATIENCE: Duration = Duration::from_secs(60);

    #[tokio::test]
    async fn a_write_of_the_leader_is_notified_and_not_only_polled() {
        if !testing::postgres_selected() {
            return;
        }
        let at = testing::postgres().await;
        let leader = Store::serve_postgres(&at).await.unwrap();
        let standby = Store::follow_postgres(&at).await.unwrap();
        let (looks, mut looked) = mpsc::unbounded_channel();
        let following = standby.each_change_or_after(PATIENCE * 60, || async { looks.send(()).unwrap() });
        let changing = async {
            // The first look comes once the standby listens.
            looked.recv().await.unwrap();
            testing::task(&leader).await;
            looked.recv().await.unwrap();
        };
        tokio::select! {
            () = following => panic!("it follows until it is dropped"),
            changed = tokio::time::timeout(PATIENCE, changing) => changed.unwrap(),
        }
        assert_eq!(standby.tasks().await.unwrap().len(), 1);
    }
}
