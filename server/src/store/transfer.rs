//! A lab's rows from SQLite to PostgreSQL or back: copied in one transaction, and compared row by row before it is
//! committed. The database of the copy belongs to the same blobs.

use futures::{StreamExt as _, TryStreamExt as _, stream::BoxStream};
use sqlx::AssertSqlSafe;

use super::{
    Store, fault, row,
    sql::{self, Form as _, Pool, QueryBuilder, Row, Target, Transaction, Value},
};
use crate::error::{Error, Result};

/// The tables in an order in which every row is copied after those that it names, with the order of their rows. The last
/// two are filled by triggers too, and are replaced.
const TABLES: [(&str, &str); 25] = [
    ("tasks", "id"),
    ("episodes", "id"),
    ("labels", "id"),
    ("uploads", "id"),
    ("snapshots", "id"),
    ("snapshot_episodes", "snapshot_id, position"),
    ("jobs", "id"),
    ("job_dependencies", "job_id, needs"),
    ("job_metrics", "id"),
    ("encoders", "id"),
    ("score_runs", "id"),
    ("episode_scores", "score_run_id, position"),
    ("datasets", "id"),
    ("exports", "id"),
    ("export_files", "export_id, position"),
    ("policies", "id"),
    ("deployments", "name"),
    ("deployment_changes", "id"),
    ("schedules", "id"),
    ("evaluations", "id"),
    ("tokens", "id"),
    ("audit", "id"),
    ("clock_jumps", "elapsed_ms, jump_ms"),
    ("lab", "id"),
    ("sidecar_queue", "seq"),
];
const REPLACED: [&str; 2] = ["lab", "sidecar_queue"];

/// Tables whose numbers PostgreSQL continues behind the newest row.
const NUMBERED: [(&str, &str); 5] =
    [("labels", "id"), ("job_metrics", "id"), ("deployment_changes", "id"), ("audit", "id"), ("sidecar_queue", "seq")];

/// Rows, and bytes of values, of one insertion.
const BATCH_ROWS: usize = 200;
const BATCH_BYTES: usize = 4 << 20;

/// A column with the kind of its values.
#[derive(Debug, Clone)]
struct Column {
    name: String,
    kind: Value,
}

type Cells = Vec<Value>;

/// The number of rows of each table.
pub(crate) type Counts = Vec<(&'static str, u64)>;

impl Store {
    /// Copies every row of this database to another one of the other kind, which must be empty, and compares them.
    ///
    /// # Errors
    /// Precondition when the target has rows; Internal names a table whose rows differ.
    pub(crate) async fn transfer(&self, target: &Self) -> Result<Counts> {
        target.expect_empty().await?;
        // Commands that write beside a server wait, and then find the moved database.
        let _held = self.writer.begin_write().await.map_err(fault("holding the database"))?;
        let postgres = if matches!(target.writer, Pool::Postgres(_)) { &target.readers } else { &self.readers };
        let mut tx = target.write().await?;
        let mut counts = Counts::new();
        for (table, order) in TABLES {
            let columns = columns(postgres, table).await?;
            if REPLACED.contains(&table) {
                execute(&mut tx, format!("delete from {table}")).await?;
            }
            let select = select(table, order, &columns);
            copy(rows(self.read(), &select, &columns), &mut tx, table, &columns).await?;
            let copied = rows(&mut tx, &select, &columns);
            counts.push((table, compare(rows(self.read(), &select, &columns), copied, table).await?));
        }
        if let Transaction::Postgres(..) = tx {
            for (table, number) in NUMBERED {
                let last = format!("(select max({number}) from {table})");
                let sequence = format!("pg_get_serial_sequence('{table}', '{number}')");
                execute(&mut tx, format!("select setval({sequence}, coalesce({last}, 1), {last} is not null)")).await?;
            }
        }
        target.commit(tx).await?;
        Ok(counts)
    }

    async fn expect_empty(&self) -> Result<()> {
        for (table, _) in TABLES.into_iter().filter(|(table, _)| !REPLACED.contains(table)) {
            let query = AssertSqlSafe(format!("select exists (select 1 from {table})"));
            let found: bool =
                row::query_as(query).fetch_one(self.read()).await.map_err(fault("looking at the target"))?;
            if found {
                return Err(Error::precondition(format!(
                    "the database to migrate to is not empty: it has rows in {table}; name an empty one"
                )));
            }
        }
        Ok(())
    }
}

async fn execute(tx: &mut Transaction, text: String) -> Result<()> {
    sql::query(AssertSqlSafe(text)).execute(tx).await.map_err(fault("migrating rows"))?;
    Ok(())
}

/// The columns of a table with the kinds that PostgreSQL gives them, which knows all five.
async fn columns(postgres: &Pool, table: &str) -> Result<Vec<Column>> {
    let listed: Vec<(String, String)> = row::query_as(
        "select column_name::text, data_type::text from information_schema.columns \
         where table_schema = current_schema() and table_name = $1 order by ordinal_position",
    )
    .bind(table)
    .fetch_all(postgres)
    .await
    .map_err(fault("reading the columns of a table"))?;
    let column = |(name, kind): (String, String)| {
        let kind = match kind.as_str() {
            "bigint" => Value::Integer(None),
            "double precision" => Value::Real(None),
            "text" => Value::Text(None),
            "bytea" => Value::Bytes(None),
            "boolean" => Value::Boolean(None),
            other => return Err(Error::internal("reading the columns of a table", format!("{table}.{name}: {other}"))),
        };
        Ok(Column { name, kind })
    };
    listed.into_iter().map(column).collect()
}

fn names(columns: &[Column]) -> String {
    columns.iter().map(|column| format!("\"{}\"", column.name)).collect::<Vec<_>>().join(", ")
}

fn select(table: &str, order: &str, columns: &[Column]) -> String {
    format!("select {} from {table} order by {order}", names(columns))
}

/// The rows of a table.
fn rows<'e>(on: impl Into<Target<'e>>, select: &str, columns: &[Column]) -> BoxStream<'e, Result<Cells>> {
    let columns = columns.to_vec();
    let cells = move |row: Row| columns.iter().enumerate().map(|(place, column)| cell(&row, place, column)).collect();
    let rows = sql::query(AssertSqlSafe(select.to_owned())).try_map(cells).fetch(on);
    rows.map_err(|error| fault("migrating rows")(error)).boxed()
}

fn cell(row: &Row, place: usize, column: &Column) -> sqlx::Result<Value> {
    Ok(match column.kind {
        Value::Integer(_) => Value::Integer(Option::read(row, place)?),
        Value::Real(_) => Value::Real(Option::read(row, place)?),
        Value::Text(_) => Value::Text(Option::read(row, place)?),
        Value::Bytes(_) => Value::Bytes(Option::read(row, place)?),
        Value::Boolean(_) => Value::Boolean(Option::read(row, place)?),
    })
}

/// Inserts the rows of a table in batches.
async fn copy(
    mut from: BoxStream<'_, Result<Cells>>,
    tx: &mut Transaction,
    table: &str,
    columns: &[Column],
) -> Result<()> {
    let (mut batch, mut bytes) = (Vec::new(), 0);
    loop {
        let next = from.try_next().await?;
        let last = next.is_none();
        if let Some(cells) = next {
            bytes += cells.iter().map(size).sum::<usize>();
            batch.push(cells);
        }
        if batch.is_empty() {
            return Ok(());
        }
        if last || batch.len() == BATCH_ROWS || bytes >= BATCH_BYTES {
            let mut query = QueryBuilder::new(&format!("insert into {table} ({}) values ", names(columns)));
            for (place, cells) in batch.drain(..).enumerate() {
                query.push(if place == 0 { "(" } else { ", (" }).push_values(cells).push(")");
            }
            query.build().execute(&mut *tx).await.map_err(fault("migrating rows"))?;
            bytes = 0;
        }
    }
}

fn size(value: &Value) -> usize {
    match value {
        Value::Text(Some(text)) => text.len(),
        Value::Bytes(Some(bytes)) => bytes.len(),
        Value::Integer(_) | Value::Real(_) | Value::Boolean(_) | Value::Text(None) | Value::Bytes(None) => 8,
    }
}

/// Compares the rows of both databases, and returns their number.
async fn compare(
    mut source: BoxStream<'_, Result<Cells>>,
    mut copied: BoxStream<'_, Result<Cells>>,
    table: &str,
) -> Result<u64> {
    let mut count = 0;
    loop {
        match (source.try_next().await?, copied.try_next().await?) {
            (None, None) => return Ok(count),
            (Some(source), Some(copied)) if source == copied => count += 1,
            (Some(_) | None, Some(_) | None) => {
                let place = count + 1;
                return Err(Error::internal("comparing the copied rows", format!("row {place} of {table} differs")));
            }
        }
    }
}

#[cfg(test)]
mod tests;
