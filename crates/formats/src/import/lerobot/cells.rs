//! Values of a table's cells: numbers, pictures, and anything else as JSON. Must not know files.

#![expect(clippy::wildcard_enum_match_arm, reason = "tables of datasets have few of Arrow's many types")]

use arrow_array::cast::AsArray as _;
use arrow_array::types::{
    Float16Type, Float32Type, Float64Type, Int8Type, Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type,
    UInt32Type, UInt64Type,
};
use arrow_array::{Array, ArrayRef};
use arrow_schema::DataType;
use serde_json::Value;

/// Appends the numbers of a cell, lists in lists one after the other; `None` if it has something else, or nothing.
pub(super) fn numbers(array: &dyn Array, row: usize, out: &mut Vec<f32>) -> Option<()> {
    if array.is_null(row) {
        return None;
    }
    if let Some(items) = items(array, row) {
        return (0..items.len()).try_for_each(|item| numbers(&items, item, out));
    }
    match array.data_type() {
        DataType::Float32 => out.push(array.as_primitive::<Float32Type>().value(row)),
        DataType::Float64 => out.push(narrow(array.as_primitive::<Float64Type>().value(row))),
        DataType::Boolean => out.push(f32::from(u8::from(array.as_boolean().value(row)))),
        _ => out.push(narrow(json(array, row).as_f64()?)),
    }
    Some(())
}

#[expect(clippy::cast_possible_truncation, reason = "steps hold 32-bit floats; the exact value is kept beside them")]
fn narrow(value: f64) -> f32 {
    value as f32
}

/// A cell as JSON: exact, but for numbers that are not finite, which JSON does not have.
pub(super) fn json(array: &dyn Array, row: usize) -> Value {
    if array.is_null(row) {
        return Value::Null;
    }
    if let Some(items) = items(array, row) {
        return (0..items.len()).map(|item| json(&items, item)).collect();
    }
    match array.data_type() {
        DataType::Boolean => array.as_boolean().value(row).into(),
        DataType::Float16 => f32::from(array.as_primitive::<Float16Type>().value(row)).into(),
        DataType::Float32 => array.as_primitive::<Float32Type>().value(row).into(),
        DataType::Float64 => array.as_primitive::<Float64Type>().value(row).into(),
        DataType::Int8 => array.as_primitive::<Int8Type>().value(row).into(),
        DataType::Int16 => array.as_primitive::<Int16Type>().value(row).into(),
        DataType::Int32 => array.as_primitive::<Int32Type>().value(row).into(),
        DataType::Int64 => array.as_primitive::<Int64Type>().value(row).into(),
        DataType::UInt8 => array.as_primitive::<UInt8Type>().value(row).into(),
        DataType::UInt16 => array.as_primitive::<UInt16Type>().value(row).into(),
        DataType::UInt32 => array.as_primitive::<UInt32Type>().value(row).into(),
        DataType::UInt64 => array.as_primitive::<UInt64Type>().value(row).into(),
        DataType::Utf8 => array.as_string::<i32>().value(row).into(),
        DataType::LargeUtf8 => array.as_string::<i64>().value(row).into(),
        DataType::Binary => String::from_utf8_lossy(array.as_binary::<i32>().value(row)).into(),
        _ => Value::Null,
    }
}

/// The bytes of a picture: those of the struct that LeRobot writes.
pub(super) fn picture(array: &dyn Array, row: usize) -> Option<&[u8]> {
    let bytes: &ArrayRef = array.as_struct_opt()?.column_by_name("bytes")?;
    if bytes.is_null(row) {
        return None;
    }
    match bytes.data_type() {
        DataType::Binary => Some(bytes.as_binary::<i32>().value(row)),
        DataType::LargeBinary => Some(bytes.as_binary::<i64>().value(row)),
        _ => None,
    }
}

fn items(array: &dyn Array, row: usize) -> Option<ArrayRef> {
    match array.data_type() {
        DataType::List(_) => Some(array.as_list::<i32>().value(row)),
        DataType::LargeList(_) => Some(array.as_list::<i64>().value(row)),
        DataType::FixedSizeList(..) => Some(array.as_fixed_size_list().value(row)),
        _ => None,
    }
}
