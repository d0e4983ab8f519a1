//! Pages of rows whose ids grow with time, by a key: a row that is added or deleted between two pages moves no other row.

use super::{
    row::{self, Column, Record},
    sql::{Pool, QueryBuilder},
};
use crate::domain::page::Page;

/// The page of the rows of a query, which ends within its conditions, newest first; and the key that the next page follows.
pub(super) async fn newest_first<T, K>(
    from: &Pool,
    mut query: QueryBuilder,
    page: &Page<K>,
    key: impl FnOnce(&T) -> K,
) -> sqlx::Result<(Vec<T>, Option<K>)>
where
    T: Record + Send + Unpin,
    K: Column,
{
    if let Some(after) = &page.after {
        query.push(" and id < ").push_bind(after.param());
    }
    query.push(" order by id desc limit ").push_bind(page.rows());
    Ok(page.cut(query.build().try_map(row::read).fetch_all(from).await?, key))
}
