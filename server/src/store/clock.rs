//! The time that passed while the database was in use. A clock that jumps, or a machine that was off for weeks, makes files
//! look older than they are: ages are compared after the jumps within them are subtracted.

use std::time::Duration;

use super::{
    Store, fault,
    row::{self, Column as _},
    sql,
};
use crate::{domain::time::Millis, error::Result};

/// Longest time without a server that is not a jump: a night is plausible, and a longer gap may be a wrongly set clock.
const OFF: Duration = Duration::from_secs(24 * 60 * 60);
/// A clock that is corrected by less does not jump.
const CORRECTION: Duration = Duration::from_secs(60);

impl Store {
    /// Records the clock's present time. `ran` is the time since the previous record by a monotonic clock; `None` when the
    /// process has just started. Returns the jump, if there was one.
    pub(crate) async fn note_time(&self, now: Millis, ran: Option<Duration>) -> Result<Option<Duration>> {
        let mut tx = self.write().await?;
        let seen: Option<i64> = row::query_as("select seen_at from lab")
            .fetch_one(&mut tx)
            .await
            .map_err(fault("reading when the clock was noted"))?;
        let passed = seen.and_then(|seen| u64::try_from(now.0.saturating_sub(seen)).ok());
        let passed = Duration::from_millis(passed.unwrap_or_default());
        let (elapsed, jump) = match ran {
            Some(ran) if passed > ran + CORRECTION => (ran, Some(passed - ran)),
            None if passed > OFF => (Duration::ZERO, Some(passed)),
            Some(_) | None => (passed, None),
        };
        if let Some(jump) = jump {
            sql::query("insert into clock_jumps (elapsed_ms, jump_ms) select elapsed_ms + $1, $2 from lab")
                .bind(millis(elapsed))
                .bind(millis(jump))
                .execute(&mut tx)
                .await
                .map_err(fault("noting a jump of the clock"))?;
        }
        sql::query("update lab set elapsed_ms = elapsed_ms + $1, seen_at = $2")
            .bind(millis(elapsed))
            .bind(now.param())
            .execute(&mut tx)
            .await
            .map_err(fault("noting the clock"))?;
        self.commit(tx).await?;
        Ok(jump)
    }

    /// Sum of the clock's jumps within the newest `age` of the time during which the database was in use.
    pub(crate) async fn jumped_within(&self, age: Duration) -> Result<Duration> {
        let jumped = sql::query(
            "select cast(coalesce(sum(jump_ms), 0) as bigint) from clock_jumps, lab where clock_jumps.elapsed_ms > lab.elapsed_ms - $1",
        )
        .bind(millis(age))
        .try_map(row::read)
        .fetch_one(self.read())
        .await
        .map_err(fault("reading the jumps of the clock"))?;
        Ok(Duration::from_millis(jumped))
    }
}

fn millis(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::{super::testing, *};

    const DAY: Duration = Duration::from_secs(24 * 60 * 60);

    #[tokio::test]
    async fn a_jump_counts_until_the_measured_time_reaches_it() {
        let (_dir, store) = testing::store().await;
        let start = Millis(1_800_000_000_000);
        assert_eq!(store.note_time(start, None).await.unwrap(), None, "a new database has seen nothing");
        let night = start.after(DAY / 2);
        assert_eq!(store.note_time(night, None).await.unwrap(), None);
        let wrong = night.after(DAY * 40);
        assert_eq!(store.note_time(wrong, None).await.unwrap(), Some(DAY * 40));
        assert_eq!(store.jumped_within(DAY * 30).await.unwrap(), DAY * 40);
        // A month of days, each recorded by a running server.
        for day in 1..=29 {
            assert_eq!(store.note_time(wrong.after(DAY * day), Some(DAY)).await.unwrap(), None);
        }
        assert_eq!(store.jumped_within(DAY * 30).await.unwrap(), DAY * 40);
        store.note_time(wrong.after(DAY * 30), Some(DAY)).await.unwrap();
        assert_eq!(store.jumped_within(DAY * 30).await.unwrap(), Duration::ZERO);
    }

    #[tokio::test]
    async fn a_clock_set_under_a_running_server_jumps_by_the_difference() {
        let (_dir, store) = testing::store().await;
        let start = Millis(1_800_000_000_000);
        store.note_time(start, None).await.unwrap();
        let hour = DAY / 24;
        assert_eq!(store.note_time(start.after(DAY + hour), Some(hour)).await.unwrap(), Some(DAY));
        // The clock is set back: ages are not overstated.
        assert_eq!(store.note_time(start.after(hour * 2), Some(hour)).await.unwrap(), None);
        assert_eq!(store.jumped_within(hour * 3).await.unwrap(), DAY);
    }
}
