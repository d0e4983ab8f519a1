//! Statements for either database, SQLite or PostgreSQL: one text with `$1`, `$2` …, and arguments and rows that are
//! converted for the database in use.
//!
//! `sqlx::Any` is not used: it copies every value of a row once more, has no `bool` on SQLite, and hides what SQLite's
//! connections must be asked (docs/decisions/0048).

mod builder;
mod connection;
mod silence;
mod value;

use futures::{StreamExt as _, TryStreamExt as _, stream::BoxStream};
use sqlx::{
    Arguments as _, AssertSqlSafe, Encode, Postgres, SqlSafeStr, SqlStr, Sqlite, Type,
    error::BoxDynError,
    postgres::{PgArguments, PgRow},
    query::{Map, Query},
    sqlite::{SqliteArguments, SqliteRow},
};

pub(super) use self::{
    builder::QueryBuilder,
    connection::{CHANGES, Pool, Target, Transaction},
    silence::within,
    value::{Argument, Form, Index, Row, Value},
};

/// A statement with its arguments; `M`: what reads its rows.
#[must_use]
pub(super) struct Statement<M = ()> {
    text: SqlStr,
    /// Whether the text has numbered values, and not those of [`QueryBuilder`].
    numbered: bool,
    arguments: Result<Vec<Value>, BoxDynError>,
    read: M,
}

/// A statement with this text.
pub(super) fn query(text: impl SqlSafeStr) -> Statement {
    Statement { text: text.into_sql_str(), numbered: true, arguments: Ok(Vec::new()), read: () }
}

/// Runs a statement on the database of the target, by the method of this name of sqlx's queries.
macro_rules! run {
    ($statement:expr, $on:expr, $method:ident) => {
        match $on.into() {
            Target::SqlitePool(pool) => $statement.sqlite()?.$method(pool).await,
            Target::Sqlite(connection) => $statement.sqlite()?.$method(connection).await,
            Target::PostgresPool(pool) => {
                let mut connection = pool.acquire().await?;
                within(silence::limit(pool), $statement.postgres()?.$method(&mut *connection)).await
            }
            Target::Postgres(connection, limit) => within(limit, $statement.postgres()?.$method(connection)).await,
        }
    };
}

impl<M> Statement<M> {
    /// Adds the next argument.
    pub(super) fn bind(mut self, argument: impl Argument) -> Self {
        self.arguments = self.arguments.and_then(|mut arguments| {
            arguments.push(argument.value()?);
            Ok(arguments)
        });
        self
    }
}

impl Statement {
    /// Reads each row by `read`.
    pub(super) fn try_map<T, F: FnMut(Row) -> sqlx::Result<T>>(self, read: F) -> Statement<F> {
        Statement { text: self.text, numbered: self.numbered, arguments: self.arguments, read }
    }

    /// Runs the statement; returns the number of rows that it changed.
    pub(super) async fn execute(self, on: impl Into<Target<'_>>) -> sqlx::Result<u64> {
        let Self { text, numbered, arguments, read: () } = self;
        let values = arguments.map_err(sqlx::Error::Encode)?;
        match on.into() {
            Target::SqlitePool(pool) => Ok(sqlite(text, values)?.execute(pool).await?.rows_affected()),
            Target::Sqlite(connection) => Ok(sqlite(text, values)?.execute(connection).await?.rows_affected()),
            Target::PostgresPool(pool) => {
                let mut connection = pool.acquire().await?;
                let done = postgres(text, numbered, values)?.execute(&mut *connection);
                Ok(within(silence::limit(pool), done).await?.rows_affected())
            }
            Target::Postgres(connection, limit) => {
                let done = postgres(text, numbered, values)?.execute(connection);
                Ok(within(limit, done).await?.rows_affected())
            }
        }
    }
}

impl<M> Statement<M> {
    /// The first row.
    pub(super) async fn fetch_one<T>(self, on: impl Into<Target<'_>>) -> sqlx::Result<T>
    where
        M: FnMut(Row) -> sqlx::Result<T> + Send,
        T: Send + Unpin,
    {
        run!(self, on, fetch_one)
    }

    /// The first row, if there is one.
    pub(super) async fn fetch_optional<T>(self, on: impl Into<Target<'_>>) -> sqlx::Result<Option<T>>
    where
        M: FnMut(Row) -> sqlx::Result<T> + Send,
        T: Send + Unpin,
    {
        run!(self, on, fetch_optional)
    }

    /// Every row.
    pub(super) async fn fetch_all<T>(self, on: impl Into<Target<'_>>) -> sqlx::Result<Vec<T>>
    where
        M: FnMut(Row) -> sqlx::Result<T> + Send,
        T: Send + Unpin,
    {
        match on.into() {
            Target::SqlitePool(pool) => self.sqlite()?.fetch_all(pool).await,
            Target::Sqlite(connection) => self.sqlite()?.fetch_all(connection).await,
            Target::PostgresPool(pool) => {
                let mut connection = pool.acquire().await?;
                let limit = silence::limit(pool);
                silence::rows_within(limit, limit, self.postgres()?.fetch(&mut *connection)).try_collect().await
            }
            Target::Postgres(connection, limit) => {
                silence::rows_within(limit, limit, self.postgres()?.fetch(connection)).try_collect().await
            }
        }
    }

    /// Row after row, as they arrive.
    pub(super) fn fetch<'e, T>(self, on: impl Into<Target<'e>>) -> BoxStream<'e, sqlx::Result<T>>
    where
        M: FnMut(Row) -> sqlx::Result<T> + Send + 'e,
        T: Send + Unpin + 'e,
    {
        let rows = match on.into() {
            Target::SqlitePool(pool) => self.sqlite().map(|query| query.fetch(pool)),
            Target::Sqlite(connection) => self.sqlite().map(|query| query.fetch(connection)),
            Target::PostgresPool(pool) => {
                let limit = silence::limit(pool);
                // The wait for a connection, which has the same limit, comes first.
                self.postgres().map(|query| silence::rows_within(limit * 2, limit, query.fetch(pool)))
            }
            Target::Postgres(connection, limit) => {
                self.postgres().map(|query| silence::rows_within(limit, limit, query.fetch(connection)))
            }
        };
        rows.unwrap_or_else(|error| futures::stream::iter([Err(error)]).boxed())
    }

    fn sqlite<T>(
        self,
    ) -> sqlx::Result<Map<'static, Sqlite, impl FnMut(SqliteRow) -> sqlx::Result<T> + Send, SqliteArguments>>
    where
        M: FnMut(Row) -> sqlx::Result<T> + Send,
        T: Send + Unpin,
    {
        let Self { text, numbered: _, arguments, mut read } = self;
        let values = arguments.map_err(sqlx::Error::Encode)?;
        Ok(sqlite(text, values)?.try_map(move |row| read(Row::Sqlite(row))))
    }

    fn postgres<T>(
        self,
    ) -> sqlx::Result<Map<'static, Postgres, impl FnMut(PgRow) -> sqlx::Result<T> + Send, PgArguments>>
    where
        M: FnMut(Row) -> sqlx::Result<T> + Send,
        T: Send + Unpin,
    {
        let Self { text, numbered, arguments, mut read } = self;
        let values = arguments.map_err(sqlx::Error::Encode)?;
        Ok(postgres(text, numbered, values)?.try_map(move |row| read(Row::Postgres(row))))
    }
}

fn sqlite(text: SqlStr, values: Vec<Value>) -> sqlx::Result<Query<'static, Sqlite, SqliteArguments>> {
    Ok(sqlx::query_with(text, encoded::<Sqlite>(values)?))
}

fn postgres(text: SqlStr, numbered: bool, values: Vec<Value>) -> sqlx::Result<Query<'static, Postgres, PgArguments>> {
    let text = if numbered { text } else { AssertSqlSafe(builder::numbered(text.as_str())).into_sql_str() };
    Ok(sqlx::query_with(text, encoded::<Postgres>(values)?))
}

/// Values as arguments of a database.
fn encoded<D: sqlx::Database>(values: Vec<Value>) -> sqlx::Result<D::Arguments>
where
    Option<i64>: for<'t> Encode<'t, D> + Type<D>,
    Option<f64>: for<'t> Encode<'t, D> + Type<D>,
    Option<String>: for<'t> Encode<'t, D> + Type<D>,
    Option<Vec<u8>>: for<'t> Encode<'t, D> + Type<D>,
    Option<bool>: for<'t> Encode<'t, D> + Type<D>,
{
    let mut arguments = D::Arguments::default();
    for value in values {
        match value {
            Value::Integer(value) => arguments.add(value),
            Value::Real(value) => arguments.add(value),
            Value::Text(value) => arguments.add(value),
            Value::Bytes(value) => arguments.add(value),
            Value::Boolean(value) => arguments.add(value),
        }
        .map_err(sqlx::Error::Encode)?;
    }
    Ok(arguments)
}
