//! A tensor's values, raw or typed, as the bytes or numbers of its role.

use bytes::{Buf as _, Bytes};
use gleaner_proto::inference::InferTensorContents;

use super::{quoted, tensors::Tensor};
use crate::{
    domain::observation::{Image, ImageFormat},
    error::{Error, Result},
};

const BYTES: &str = "BYTES";

/// The field of a tensor's values.
#[derive(Debug)]
pub(super) enum Values {
    Raw(Bytes),
    Typed(Box<InferTensorContents>),
}

/// One input as received.
#[derive(Debug)]
pub(super) struct Input {
    pub(super) name: String,
    pub(super) datatype: String,
    pub(super) shape: Vec<i64>,
    pub(super) values: Values,
}

/// An image: pixels, or one element of BYTES that is a JPEG or PNG.
pub(super) fn image(tensor: &Tensor, input: Input) -> Result<Image> {
    let field = tensor.field();
    if input.datatype == BYTES {
        expect_shape(&field, &input.shape, &[1])?;
        let data = element(&field, input.values)?;
        return Ok(Image { format: ImageFormat::Any, data });
    }
    expect_datatype(tensor, &input.datatype)?;
    expect_shape(&field, &input.shape, &tensor.shape)?;
    let count = elements(tensor);
    let width = if tensor.datatype() == "UINT8" { 1 } else { 2 };
    let data = match input.values {
        Values::Raw(data) => {
            expect_size(&field, data.len(), count * width, "bytes")?;
            data
        }
        Values::Typed(contents) => {
            expect_field(&field, &contents, "uint_contents")?;
            expect_size(&field, contents.uint_contents.len(), count, "values")?;
            narrow(&field, &contents.uint_contents, width)?
        }
    };
    Ok(Image { format: ImageFormat::Raw, data })
}

/// A list of numbers.
pub(super) fn vector(tensor: &Tensor, input: Input) -> Result<Vec<f32>> {
    let field = tensor.field();
    expect_datatype(tensor, &input.datatype)?;
    expect_shape(&field, &input.shape, &tensor.shape)?;
    let count = elements(tensor);
    match input.values {
        Values::Raw(mut data) => {
            expect_size(&field, data.len(), count * size_of::<f32>(), "bytes")?;
            Ok((0..count).map(|_| data.get_f32_le()).collect())
        }
        Values::Typed(contents) => {
            expect_field(&field, &contents, "fp32_contents")?;
            expect_size(&field, contents.fp32_contents.len(), count, "values")?;
            Ok(contents.fp32_contents)
        }
    }
}

/// The only element of a BYTES tensor.
fn element(field: &str, values: Values) -> Result<Bytes> {
    match values {
        Values::Raw(mut data) => {
            let length = data.try_get_u32_le().ok().and_then(|length| usize::try_from(length).ok());
            if length != Some(data.len()) {
                return Err(Error::invalid(
                    field,
                    "must be one element: its length in 4 little-endian bytes, then as many bytes",
                ));
            }
            Ok(data)
        }
        Values::Typed(contents) => {
            expect_field(field, &contents, "bytes_contents")?;
            expect_size(field, contents.bytes_contents.len(), 1, "values")?;
            Ok(contents.bytes_contents.into_iter().next().unwrap_or_default())
        }
    }
}

/// Little-endian bytes of values that must fit in `width` of them.
fn narrow(field: &str, values: &[u32], width: usize) -> Result<Bytes> {
    let mut bytes = Vec::with_capacity(values.len() * width);
    for (index, value) in values.iter().enumerate() {
        let whole = value.to_le_bytes();
        let (kept, lost) = whole.split_at(width);
        if lost.iter().any(|&byte| byte != 0) {
            let most = if width == 1 { u32::from(u8::MAX) } else { u32::from(u16::MAX) };
            return Err(Error::invalid(&format!("{field}[{index}]"), format!("is {value}, must be at most {most}")));
        }
        bytes.extend_from_slice(kept);
    }
    Ok(bytes.into())
}

/// The number of values of a tensor. Its dimensions come from a task, so the product is small.
fn elements(tensor: &Tensor) -> usize {
    tensor.shape.iter().map(|&dimension| usize::try_from(dimension).unwrap_or(0)).product()
}

fn expect_datatype(tensor: &Tensor, found: &str) -> Result<()> {
    let expected = tensor.datatype();
    if found == expected {
        return Ok(());
    }
    let or = if tensor.is_image() { ", or BYTES for one encoded image" } else { "" };
    Err(Error::invalid(&tensor.field(), format!("has datatype {}, must be {expected}{or}", quoted(found))))
}

/// Batches have one element: a leading 1 is optional.
fn expect_shape(field: &str, found: &[i64], expected: &[i64]) -> Result<()> {
    if found == expected || found.split_first().is_some_and(|(&batch, rest)| batch == 1 && rest == expected) {
        return Ok(());
    }
    // Shortened: a client may send any number of dimensions.
    let shown = &found[..found.len().min(8)];
    Err(Error::invalid(field, format!("has shape {shown:?}, must be {expected:?}, with or without a leading 1")))
}

fn expect_size(field: &str, found: usize, expected: usize, what: &str) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::invalid(field, format!("has {found} {what}, its shape asks for {expected}")))
}

/// Rejects values in any other list.
fn expect_field(field: &str, contents: &InferTensorContents, expected: &str) -> Result<()> {
    match filled(contents).find(|&name| name != expected) {
        None => Ok(()),
        Some(found) => Err(Error::invalid(field, format!("has values in {found}, they belong in {expected} alone"))),
    }
}

/// The lists that hold values.
pub(super) fn filled(contents: &InferTensorContents) -> impl Iterator<Item = &'static str> {
    let InferTensorContents {
        bool_contents,
        int_contents,
        int64_contents,
        uint_contents,
        uint64_contents,
        fp32_contents,
        fp64_contents,
        bytes_contents,
    } = contents;
    let lists = [
        ("bool_contents", bool_contents.is_empty()),
        ("int_contents", int_contents.is_empty()),
        ("int64_contents", int64_contents.is_empty()),
        ("uint_contents", uint_contents.is_empty()),
        ("uint64_contents", uint64_contents.is_empty()),
        ("fp32_contents", fp32_contents.is_empty()),
        ("fp64_contents", fp64_contents.is_empty()),
        ("bytes_contents", bytes_contents.is_empty()),
    ];
    lists.into_iter().filter(|(_, empty)| !empty).map(|(name, _)| name)
}
