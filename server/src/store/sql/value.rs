//! Arguments of statements and columns of rows, in the five kinds that both databases have.

use sqlx::{Column as _, ColumnIndex, Row as _, TypeInfo as _, error::BoxDynError, postgres::PgRow, sqlite::SqliteRow};

/// The value of an argument. Each kind has its own null, because PostgreSQL needs the type of every parameter.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::store) enum Value {
    Integer(Option<i64>),
    Real(Option<f64>),
    Text(Option<String>),
    Bytes(Option<Vec<u8>>),
    Boolean(Option<bool>),
}

/// A row of either database.
pub(in crate::store) enum Row {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

impl Row {
    /// The name of a column.
    pub(in crate::store) fn name(&self, index: impl Index) -> sqlx::Result<&str> {
        match self {
            Self::Sqlite(row) => Ok(row.try_column(index)?.name()),
            Self::Postgres(row) => Ok(row.try_column(index)?.name()),
        }
    }
}

/// The name or the position of a column.
pub(in crate::store) trait Index: ColumnIndex<SqliteRow> + ColumnIndex<PgRow> + Copy {}

impl<I: ColumnIndex<SqliteRow> + ColumnIndex<PgRow> + Copy> Index for I {}

/// An argument of a statement.
pub(in crate::store) trait Argument: Sized {
    /// The null of its kind.
    const NULL: Value;

    fn value(self) -> Result<Value, BoxDynError>;
}

/// A type of columns.
pub(in crate::store) trait Form: Argument {
    fn read(row: &Row, index: impl Index) -> sqlx::Result<Self>;

    /// The same, or nothing for a null.
    fn read_optional(row: &Row, index: impl Index) -> sqlx::Result<Option<Self>>;
}

impl<F: Form> Form for Option<F> {
    fn read(row: &Row, index: impl Index) -> sqlx::Result<Self> {
        F::read_optional(row, index)
    }

    fn read_optional(row: &Row, index: impl Index) -> sqlx::Result<Option<Self>> {
        F::read_optional(row, index).map(Some)
    }
}

macro_rules! forms {
    ($($form:ty: $kind:ident, $postgres:path;)+) => {$(
        impl Argument for $form {
            const NULL: Value = Value::$kind(None);

            fn value(self) -> Result<Value, BoxDynError> {
                Ok(Value::$kind(Some(self)))
            }
        }

        impl Form for $form {
            fn read(row: &Row, index: impl Index) -> sqlx::Result<Self> {
                match row {
                    Row::Sqlite(row) => row.try_get(index),
                    Row::Postgres(row) => $postgres(row, index),
                }
            }

            fn read_optional(row: &Row, index: impl Index) -> sqlx::Result<Option<Self>> {
                match row {
                    Row::Sqlite(row) => row.try_get(index),
                    Row::Postgres(row) => $postgres(row, index),
                }
            }
        }
    )+};
}

forms! {
    i64: Integer, integer;
    f64: Real, plain;
    String: Text, plain;
    Vec<u8>: Bytes, plain;
    bool: Boolean, plain;
}

fn plain<T>(row: &PgRow, index: impl Index) -> sqlx::Result<T>
where
    T: for<'r> sqlx::Decode<'r, sqlx::Postgres> + sqlx::Type<sqlx::Postgres>,
{
    row.try_get(index)
}

/// PostgreSQL has integers of three sizes: literals and lengths are of four bytes, columns of eight. sqlx decodes each as
/// `i64`, and objects to the type of the shorter ones only.
fn integer<T>(row: &PgRow, index: impl Index) -> sqlx::Result<T>
where
    T: for<'r> sqlx::Decode<'r, sqlx::Postgres> + sqlx::Type<sqlx::Postgres>,
{
    match row.try_column(index)?.type_info().name() {
        "INT2" | "INT4" => row.try_get_unchecked(index),
        _ => row.try_get(index),
    }
}

/// Values that become one of the five kinds.
macro_rules! arguments {
    ($($value:ty: $kind:ident, $into:expr;)+) => {$(
        impl Argument for $value {
            const NULL: Value = Value::$kind(None);

            fn value(self) -> Result<Value, BoxDynError> {
                Ok(Value::$kind(Some(self).map($into)))
            }
        }
    )+};
}

arguments! {
    u32: Integer, i64::from;
    i32: Integer, i64::from;
    &f64: Real, |value| *value;
    &str: Text, str::to_owned;
    &String: Text, String::clone;
}

impl<A: Argument> Argument for Option<A> {
    const NULL: Value = A::NULL;

    fn value(self) -> Result<Value, BoxDynError> {
        self.map_or(Ok(A::NULL), A::value)
    }
}
