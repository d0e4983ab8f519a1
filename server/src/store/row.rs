//! Values of the domain in rows. The domain does not depend on sqlx, so its types are mapped here: each has one form in a
//! column, for reading and for binding, and a struct names its columns once.
//!
//! An unreadable column is sqlx's `ColumnDecode` error, which names the column.

use std::result::Result;

use gleaner_core::ScoreSpec;
use gleaner_recording::{Report, TaskSpec};
use sqlx::error::BoxDynError;

use super::{
    packed::{pack, unpack},
    sql::{self, Argument, Form, Index, Row, Statement, Value},
};
use crate::domain::{
    access,
    client::Client,
    episode::Outcome,
    evaluation::SeedResult,
    id::{
        BlobId, DatasetId, EncoderId, EpisodeId, EvaluationId, ExportId, JobId, PolicyId, ScheduleId, ScoreRunId,
        SnapshotId, TaskId, TokenId, UploadId,
    },
    job::{JobKind, JobSpec, JobState},
    order::KeyedOrder,
    remote::RemotePolicy,
    schedule::PipelineSpec,
    selection::SelectionShape,
    snapshot::{Role, RoleRule},
    time::Millis,
};

/// A value of one column.
pub(super) trait Column: Sized {
    /// The type that both databases read and bind.
    type Form: Form;

    fn decode(form: Self::Form) -> Result<Self, BoxDynError>;
    fn encode(&self) -> Result<Self::Form, BoxDynError>;

    /// The value as a parameter of a query.
    fn param(&self) -> Param<'_, Self> {
        Param(self)
    }
}

/// A value of several columns: a row, or a part of one.
pub(super) trait Record: Sized {
    fn decode(row: &Row) -> sqlx::Result<Self>;
}

/// A statement whose rows are read as values of `T`.
pub(super) fn query_as<T: Record>(text: impl sqlx::SqlSafeStr) -> Statement<fn(Row) -> sqlx::Result<T>> {
    sql::query(text).try_map(read::<T> as fn(Row) -> sqlx::Result<T>)
}

/// Reads a row; for `try_map`.
pub(super) fn read<T: Record>(row: Row) -> sqlx::Result<T> {
    T::decode(&row)
}

/// Reads the column of this name or position.
pub(super) fn column<T: Column>(row: &Row, index: impl Index) -> sqlx::Result<T> {
    let form = T::Form::read(row, index)?;
    T::decode(form).or_else(|source| Err(unreadable(row.name(index)?, source)))
}

/// The error of a column with a value that its type does not have.
pub(super) fn unreadable(column: &str, source: impl Into<BoxDynError>) -> sqlx::Error {
    sqlx::Error::ColumnDecode { index: format!("{column:?}"), source: source.into() }
}

/// A parameter of a query.
#[derive(Debug)]
pub(super) struct Param<'a, T>(&'a T);

impl<T: Column> Argument for Param<'_, T> {
    const NULL: Value = <T::Form as Argument>::NULL;

    fn value(self) -> Result<Value, BoxDynError> {
        self.0.encode()?.value()
    }
}

/// Maps types to a form: how a value is read from it, and written to it.
macro_rules! columns {
    ($form:ty: $($value:ty)+; $decode:expr; $encode:expr) => {$(
        impl Column for $value {
            type Form = $form;

            fn decode(form: $form) -> Result<Self, BoxDynError> {
                let decode: fn($form) -> Result<Self, BoxDynError> = $decode;
                decode(form)
            }

            fn encode(&self) -> Result<$form, BoxDynError> {
                let encode: fn(&Self) -> Result<$form, BoxDynError> = $encode;
                encode(self)
            }
        }
    )+};
    ($($plain:ty)+) => {$(
        columns!($plain: $plain; Ok; |value| Ok(value.clone()));
    )+};
}

columns!(String i64 f64 bool);
columns!(i64: u32 i32; |number| Ok(number.try_into()?); |number| Ok(i64::from(*number)));
columns!(i64: u64; |count| Ok(u64::try_from(count)?); |count| Ok(i64::try_from(*count).unwrap_or(i64::MAX)));
columns!(i64: Millis; |time| Ok(Millis(time)); |time| Ok(time.0));
columns!(String: BlobId DatasetId EncoderId EpisodeId EvaluationId ExportId JobId PolicyId ScheduleId ScoreRunId
    SnapshotId TaskId TokenId UploadId; |text| Ok(text.try_into()?); |id| Ok(id.as_str().to_owned()));
columns!(String: Outcome Role JobKind JobState access::Role;
    |word| Self::from_word(&word).ok_or_else(|| format!("{word:?} is an unknown word").into());
    |value| Ok(value.as_str().to_owned()));
columns!(String: Client; |text| Self::parse(&text).ok_or_else(|| format!("{text:?} is not a client").into());
    |client| Ok(client.to_string()));
columns!(String: TaskSpec RemotePolicy Report RoleRule JobSpec KeyedOrder ScoreSpec PipelineSpec Vec<SeedResult> Vec<EpisodeId> Vec<String>;
    |json| Ok(serde_json::from_str(&json)?); |value| Ok(serde_json::to_string(value)?));
columns!(Option<String>: Vec<JobId>;
    |ids| ids.iter().flat_map(|ids| ids.split(',')).map(|id| Ok(id.to_owned().try_into()?)).collect();
    |ids| Ok(Some(ids.iter().map(JobId::as_str).collect::<Vec<_>>().join(","))));
columns!(Option<String>: SelectionShape;
    |json| json.map_or_else(|| Ok(Self::default()), |json| Ok(serde_json::from_str(&json)?));
    |shape| if shape.is_off() { Ok(None) } else { Ok(Some(serde_json::to_string(&shape.changed())?)) });
columns!(Vec<u8>: Vec<f64> Vec<f32> Vec<u32> Vec<[f32; 3]>; |bytes| unpack(&bytes); |values| Ok(pack(values)));

impl<T: Column> Column for Option<T> {
    type Form = Option<T::Form>;

    fn decode(form: Self::Form) -> Result<Self, BoxDynError> {
        form.map(T::decode).transpose()
    }

    fn encode(&self) -> Result<Self::Form, BoxDynError> {
        self.as_ref().map(T::encode).transpose()
    }
}

/// The columns of a struct, each of its field's name unless another is given; after `;` the fields of several columns.
macro_rules! record {
    ($record:ident: $($field:ident $(= $column:literal)?),+ $(; $($part:ident),+)?) => {
        impl $crate::store::row::Record for $record {
            fn decode(row: &$crate::store::sql::Row) -> sqlx::Result<Self> {
                Ok(Self {
                    $($field: $crate::store::row::column(row, $crate::store::row::record!(@ $field $($column)?))?,)+
                    $($($part: $crate::store::row::Record::decode(row)?,)+)?
                })
            }
        }
    };
    (@ $field:ident) => { stringify!($field) };
    (@ $field:ident $column:literal) => { $column };
}
pub(super) use record;

impl<T: Column> Record for T {
    fn decode(row: &Row) -> sqlx::Result<Self> {
        column(row, 0)
    }
}

macro_rules! tuples {
    ($(($($value:ident $index:literal),+))+) => {$(
        impl<$($value: Column),+> Record for ($($value),+) {
            fn decode(row: &Row) -> sqlx::Result<Self> {
                Ok(($(column(row, $index)?),+))
            }
        }
    )+};
}

tuples!((A 0, B 1)(A 0, B 1, C 2)(A 0, B 1, C 2, D 3));
