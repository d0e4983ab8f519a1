//! H.264: pictures in decoding order, one access unit a message.
//!
//! The decoder neither reports pictures that are missing before one nor a slice that ends early, so both are found here:
//! the first by `frame_num`, the second by decoding twice. Bytes behind the end of an intact CABAC slice have no effect;
//! a slice that ends early makes the decoder read them, and two decoders that find different bytes there differ.

mod syntax;

use std::collections::BTreeMap;

use rust_h264::decoder::{ChromaFormat, Decoder as Pictures, Frame};
use rust_h264::error::DecodeError;
use rust_h264::nal::{NalUnit, NalUnitType, parse_annex_b};

use rusty_h265::bits::OutOfData;

use crate::annex_b::units;
use crate::codec::Codec;
use crate::decoder::{Decoded, Decoder};
use crate::error::VideoError;
use crate::glance::{Glance, Part};
use crate::picture::{Picture, Plane};
use syntax::{PictureSet, SequenceSet, Slice};

/// Bytes behind a slice, for the second decoder.
const BEHIND: [u8; 32] = [0xff; 32];

/// Reads the types of the NAL units of a message.
pub(crate) fn glance(data: &[u8]) -> Result<Glance, VideoError> {
    let mut glance = Glance { part: Part::None, pictures: 0, parameters: false };
    for unit in units(Codec::H264, data)? {
        // The first bit of a slice header is set if it begins the picture.
        let begins = unit.get(1).is_some_and(|byte| byte & 0x80 != 0);
        let part = match unit.first().map(|header| header & 0x1f) {
            Some(5) if begins => Part::Key,
            Some(1 | 2) if begins => Part::Follows,
            kind => {
                glance.parameters |= matches!(kind, Some(7 | 8));
                continue;
            }
        };
        glance.pictures += 1;
        glance.part = if glance.pictures == 1 { part } else { glance.part };
    }
    Ok(glance)
}

/// A decoder of H.264.
pub(crate) struct H264 {
    /// (height, width) of the camera.
    size: (u32, u32),
    pictures: Pictures,
    /// The second decoder.
    probe: Pictures,
    sequences: BTreeMap<u32, SequenceSet>,
    sets: BTreeMap<u32, PictureSet>,
    /// `frame_num` of the last reference picture.
    reference: Option<u32>,
}

impl H264 {
    pub(crate) fn new(size: (u32, u32)) -> Self {
        Self {
            size,
            pictures: Pictures::new(),
            probe: Pictures::new(),
            sequences: BTreeMap::new(),
            sets: BTreeMap::new(),
            reference: None,
        }
    }

    /// Decodes a unit; `last` is whether it is the last slice of its picture. Returns the parameters of a slice.
    fn unit(&mut self, unit: &mut NalUnit<'_>, last: bool) -> Result<Option<SequenceSet>, VideoError> {
        let (mut of, mut ends) = (None, false);
        if unit.nal_unit_type == NalUnitType::Sps {
            let set = SequenceSet::parse(&unit.rbsp).map_err(damaged)?;
            self.sequences.insert(set.id, set);
        } else if unit.nal_unit_type == NalUnitType::Pps {
            let set = PictureSet::parse(&unit.rbsp).map_err(damaged)?;
            self.sets.insert(set.id, set);
        } else if is_slice(unit) {
            let (sequence, set) = self.slice(unit)?;
            // A CAVLC slice that is not the last ends where its bytes do.
            (of, ends) = (Some(sequence), set.cabac || last);
        }
        self.pictures.decode_nal(unit).map_err(failed)?;
        if ends {
            unit.rbsp.to_mut().extend(BEHIND);
        }
        self.probe.decode_nal(unit).map_err(failed)?;
        Ok(of)
    }

    /// Checks a slice before it is decoded.
    fn slice(&mut self, unit: &NalUnit<'_>) -> Result<(SequenceSet, PictureSet), VideoError> {
        let missing = || VideoError::damaged("its parameter sets are missing; write them before each key frame");
        let set = Slice::set(&unit.rbsp).map_err(damaged)?;
        let set = *self.sets.get(&set).ok_or_else(missing)?;
        let sequence = *self.sequences.get(&set.sequence).ok_or_else(missing)?;
        sequence.check(self.size)?;
        let slice = Slice::parse(&unit.rbsp, &sequence).map_err(damaged)?;
        if slice.field {
            return Err(VideoError::fields(Codec::H264, "yadif"));
        }
        let (reference, key) = (unit.nal_ref_idc > 0, unit.nal_unit_type == NalUnitType::SliceIdr);
        if slice.first && !key && !sequence.gaps {
            let next = self.reference.map(|last| (last + 1) % sequence.frame_numbers());
            if slice.frame_num != self.reference.unwrap_or_default() && Some(slice.frame_num) != next {
                return Err(VideoError::damaged("a picture before it is missing; check the recorder's connection"));
            }
        }
        if slice.first && reference {
            self.reference = Some(slice.frame_num);
        }
        Ok((sequence, set))
    }
}

impl Decoder for H264 {
    fn push(&mut self, message: usize, data: &[u8], out: &mut Vec<Decoded>) -> Result<(), VideoError> {
        units(Codec::H264, data)?;
        let mut units = parse_annex_b(data);
        let begins = |unit: &NalUnit<'_>| unit.rbsp.first().is_some_and(|byte| byte & 0x80 != 0);
        // Of each unit, whether the next slice after it begins a picture or is missing.
        let (mut last, mut ends) = (vec![true; units.len()], true);
        for (unit, last) in units.iter().zip(&mut last).rev() {
            *last = ends;
            ends = if is_slice(unit) { begins(unit) } else { ends };
        }
        let mut open = None;
        for (unit, last) in units.iter_mut().zip(last) {
            if is_slice(unit)
                && begins(unit)
                && let Some(sequence) = open.take()
            {
                out.push((message, self.finish(&sequence)?));
            }
            open = self.unit(unit, last)?.or(open);
        }
        if let Some(sequence) = open {
            out.push((message, self.finish(&sequence)?));
        }
        Ok(())
    }

    fn parameters(&mut self, data: &[u8]) {
        for mut unit in parse_annex_b(data) {
            if matches!(unit.nal_unit_type, NalUnitType::Sps | NalUnitType::Pps) {
                // A damaged set is found by the pictures that need it.
                let _ = self.unit(&mut unit, false);
            }
        }
    }

    fn flush(&mut self, _: &mut Vec<Decoded>) {
        self.pictures.flush();
        self.probe.flush();
        self.reference = None;
    }
}

impl H264 {
    /// Ends the picture in both decoders.
    fn finish(&mut self, sequence: &SequenceSet) -> Result<Picture, VideoError> {
        let (frame, probe) = (self.pictures.flush(), self.probe.flush());
        match (frame, probe) {
            (Some(frame), Some(probe)) if frame.y == probe.y && frame.u == probe.u && frame.v == probe.v => {
                picture(frame, sequence)
            }
            (None, None) => Err(VideoError::damaged("H.264: the decoder returned no picture")),
            (Some(_) | None, Some(_) | None) => {
                Err(VideoError::damaged("H.264: a slice ends early; check the recorder's connection"))
            }
        }
    }
}

fn is_slice(unit: &NalUnit<'_>) -> bool {
    matches!(unit.nal_unit_type, NalUnitType::Slice | NalUnitType::SliceIdr)
}

/// The picture of a frame.
fn picture(frame: Frame, sequence: &SequenceSet) -> Result<Picture, VideoError> {
    let whole = |pixels: u32| usize::try_from(pixels).unwrap_or(usize::MAX);
    let (width, height) = (whole(frame.width), whole(frame.height));
    let rows = match frame.chroma_format {
        ChromaFormat::Yuv420 => height.div_ceil(2),
        ChromaFormat::Yuv422 => height,
    };
    let plane = |bytes: &[u8], width, height| {
        if frame.bit_depth > 8 {
            let samples = bytes.as_chunks().0.iter().map(|pair| u16::from_le_bytes(*pair)).collect();
            Plane { width, height, samples }
        } else {
            Plane::of_bytes(width, height, bytes)
        }
    };
    let chroma = [&frame.u, &frame.v].map(|bytes| plane(bytes, width.div_ceil(2), rows));
    Ok(Picture {
        luma: plane(&frame.y, width, height),
        chroma: Some(chroma),
        depth: frame.bit_depth,
        color: sequence.color()?,
        order: frame.pic_order_cnt.into(),
    })
}

fn damaged(_: OutOfData) -> VideoError {
    VideoError::damaged("a header ends early; check the recorder's connection")
}

fn failed(error: DecodeError) -> VideoError {
    match error {
        DecodeError::Unsupported(what) => VideoError::Unsupported(format!(
            "H.264 with {what} is not decoded; encode with 4:2:0 and 8 or 10 bits, or as h265 or av1"
        )),
        DecodeError::UnexpectedEof | DecodeError::InvalidSyntax(_) => {
            VideoError::damaged(format!("H.264: {error}; check the recorder's connection"))
        }
    }
}
