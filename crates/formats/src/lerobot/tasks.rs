//! The table of tasks: the text is the index that pandas makes of it, without which every frame's task is the number 0.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use serde_json::{Value, json};

use super::Begun;
use crate::problem::Problem;

/// Writes the table with this one task.
pub(super) fn write(begun: Begun, task: &str) -> Result<(), Problem> {
    let Begun { file, path } = begun;
    let fields = vec![Field::new("task_index", DataType::Int64, true), Field::new("task", DataType::Utf8, true)];
    let column = |name: &str, pandas: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": pandas, "numpy_type": numpy, "metadata": Value::Null});
    let pandas = json!({
        "index_columns": ["task"],
        "column_indexes": [{
            "name": Value::Null, "field_name": Value::Null, "pandas_type": "unicode", "numpy_type": "object",
            "metadata": {"encoding": "UTF-8"},
        }],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "pandas_version": "2.3.0",
    });
    // Readers by Arrow look into its schema, others into the file's own metadata.
    let schema = Schema::new_with_metadata(fields, HashMap::from([("pandas".to_owned(), pandas.to_string())]));
    let schema = Arc::new(schema);
    let index = KeyValue::new("pandas".to_owned(), pandas.to_string());
    let properties =
        WriterProperties::builder().set_compression(Compression::SNAPPY).set_key_value_metadata(Some(vec![index]));
    let fault = Problem::encoding(&path);
    let mut writer = ArrowWriter::try_new(file, Arc::clone(&schema), Some(properties.build())).map_err(&fault)?;
    let arrays: Vec<arrow_array::ArrayRef> =
        vec![Arc::new(Int64Array::from(vec![0])), Arc::new(StringArray::from(vec![task]))];
    let batch = RecordBatch::try_new(schema, arrays).map_err(Problem::encoding(&path))?;
    writer.write(&batch).map_err(&fault)?;
    writer.close().map(|_| ()).map_err(&fault)
}
