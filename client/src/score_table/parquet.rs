//! The columns of a Parquet file, as pandas, polars and pyarrow write them: of any integer and floating-point type, with
//! any compression that they use by default. Must not know what a score is.

use std::fs::File;
use std::sync::Arc;

use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::record::Field;
use parquet::schema::types::Type;

use super::{COLUMNS, Episodes, Row};

/// Adds every row of the file.
pub(super) fn read(file: File, episodes: &mut Episodes) -> Result<(), String> {
    let broken = |error: parquet::errors::ParquetError| format!("is not a readable Parquet file: {error}");
    let reader = SerializedFileReader::new(file).map_err(broken)?;
    let schema = reader.metadata().file_metadata().schema();
    let mut columns = Vec::with_capacity(COLUMNS.len());
    for needed in COLUMNS {
        let column = schema.get_fields().iter().find(|field| field.name() == needed && field.is_primitive());
        columns.push(Arc::clone(column.ok_or_else(|| {
            format!("column {needed:?} is missing; the columns must include {}", COLUMNS.join(", "))
        })?));
    }
    let projection = Type::group_type_builder(schema.name()).with_fields(columns).build().map_err(broken)?;
    for (number, fields) in reader.get_row_iter(Some(projection)).map_err(broken)?.enumerate() {
        let fields = fields.map_err(broken)?;
        let mut row = Row { episode: String::new(), step: 0, q: 0.0 };
        for (column, field) in fields.get_column_iter() {
            let taken = match column.as_str() {
                "episode" => text(field).map(|episode| row.episode = episode),
                "step" => whole_number(field).map(|step| row.step = step),
                _ => number_of(field).map(|q| row.q = q),
            };
            taken.ok_or_else(|| format!("row {number}, column {column}: {field} is not a value of this column"))?;
        }
        episodes.add(row);
    }
    Ok(())
}

#[expect(clippy::wildcard_enum_match_arm, reason = "of many types of values these few fit")]
fn text(field: &Field) -> Option<String> {
    match field {
        Field::Str(text) => Some(text.clone()),
        Field::Bytes(bytes) => bytes.as_utf8().ok().map(str::to_owned),
        _ => None,
    }
}

#[expect(clippy::wildcard_enum_match_arm, reason = "of many types of values these few fit")]
fn whole_number(field: &Field) -> Option<u64> {
    match *field {
        Field::Byte(number) => number.try_into().ok(),
        Field::Short(number) => number.try_into().ok(),
        Field::Int(number) => number.try_into().ok(),
        Field::Long(number) => number.try_into().ok(),
        Field::UByte(number) => Some(number.into()),
        Field::UShort(number) => Some(number.into()),
        Field::UInt(number) => Some(number.into()),
        Field::ULong(number) => Some(number),
        _ => None,
    }
}

#[expect(clippy::wildcard_enum_match_arm, reason = "of many types of values these few fit")]
fn number_of(field: &Field) -> Option<f64> {
    match *field {
        Field::Float16(number) => Some(number.into()),
        Field::Float(number) => Some(number.into()),
        Field::Double(number) => Some(number),
        // An oracle's 0 and 1.
        _ => whole_number(field).and_then(|number| u32::try_from(number).ok()).map(f64::from),
    }
}

#[cfg(test)]
mod tests {
    use parquet::basic::{Compression, ZstdLevel};
    use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, FloatType, Int32Type, Int64Type};
    use parquet::file::properties::WriterProperties;
    use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
    use parquet::schema::parser::parse_message_type;

    use super::super::{ScoredEpisode, read_scores};
    use crate::error::Result;

    type Column<'a> = &'a dyn Fn(&mut SerializedRowGroupWriter<'_, std::fs::File>);

    /// The scores of a file with this schema and these columns, twice: once in each of two row groups.
    fn written(schema: &str, compression: Compression, groups: &[&[Column<'_>]]) -> Result<Vec<ScoredEpisode>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.parquet");
        let schema = parse_message_type(schema).unwrap().into();
        let properties = WriterProperties::builder().set_compression(compression).build().into();
        let mut writer = SerializedFileWriter::new(std::fs::File::create(&path).unwrap(), schema, properties).unwrap();
        for columns in groups {
            let mut group = writer.next_row_group().unwrap();
            for column in *columns {
                column(&mut group);
            }
            group.close().unwrap();
        }
        writer.close().unwrap();
        read_scores(&path)
    }

    macro_rules! column {
        ($kind:ty, $values:expr) => {
            &|group: &mut SerializedRowGroupWriter<'_, std::fs::File>| {
                let mut column = group.next_column().unwrap().unwrap();
                column.typed::<$kind>().write_batch(&$values, None, None).unwrap();
                column.close().unwrap();
            }
        };
    }

    fn names(names: &[&str]) -> Vec<ByteArray> {
        names.iter().map(|name| ByteArray::from(*name)).collect()
    }

    #[test]
    fn columns_of_any_width_are_read_in_every_order_of_rows() {
        let zstd = Compression::ZSTD(ZstdLevel::default());
        let wide = "message m { required double note; required int64 step; required double q; \
                    required binary episode (STRING); }";
        let first: &[Column<'_>] = &[
            column!(DoubleType, [9.0, 9.0]),
            column!(Int64Type, [1, 0]),
            column!(DoubleType, [0.5, 0.25]),
            column!(ByteArrayType, names(&["b.mcap", "b.mcap"])),
        ];
        let second: &[Column<'_>] = &[
            column!(DoubleType, [9.0]),
            column!(Int64Type, [0]),
            column!(DoubleType, [1.0]),
            column!(ByteArrayType, names(&["a.mcap"])),
        ];
        let of = |episode: &str, q: &[f64]| ScoredEpisode { episode: episode.into(), q: q.to_vec() };
        let expected = [of("b.mcap", &[0.25, 0.5]), of("a.mcap", &[1.0])];
        for compression in [Compression::UNCOMPRESSED, Compression::SNAPPY, zstd] {
            assert_eq!(written(wide, compression, &[first, second]).unwrap(), expected);
        }
        let narrow = "message m { required binary episode (STRING); required int32 step (UINT_8); required float q; }";
        let columns: &[Column<'_>] =
            &[column!(ByteArrayType, names(&["a"])), column!(Int32Type, [0]), column!(FloatType, [0.5])];
        assert_eq!(written(narrow, Compression::SNAPPY, &[columns]).unwrap(), [of("a", &[0.5])]);
    }

    #[test]
    fn a_wrong_column_or_value_is_named() {
        let snappy = Compression::SNAPPY;
        let missing = "message m { required binary episode (STRING); required int32 step; required float w; }";
        let columns: &[Column<'_>] =
            &[column!(ByteArrayType, names(&["a"])), column!(Int32Type, [-1]), column!(FloatType, [0.5])];
        let message = written(missing, snappy, &[columns]).unwrap_err().to_string();
        assert!(message.contains("scores.parquet: column \"q\" is missing"), "{message}");
        let negative = missing.replace("float w", "float q");
        let message = written(&negative, snappy, &[columns]).unwrap_err().to_string();
        assert!(message.contains("row 0, column step: -1 is not a value of this column"), "{message}");
        let message = written(&negative, snappy, &[]).unwrap_err().to_string();
        assert!(message.contains("has no scores"), "{message}");
    }
}
