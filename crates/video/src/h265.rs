//! H.265: pictures in the order of presentation, one access unit a message.

mod syntax;

use rusty_h265::nal::{NalHeader, NalType, unescape};
use rusty_h265::ps::{Sps, parse_sps};
use rusty_h265::{Decoder as Pictures, Error, Frame};

use crate::annex_b::units;
use crate::codec::Codec;
use crate::decoder::{Decoded, Decoder};
use crate::error::VideoError;
use crate::glance::{Glance, Part};
use crate::picture::{Color, Picture, Plane};

/// Reads the types of the NAL units of a message.
pub(crate) fn glance(data: &[u8]) -> Result<Glance, VideoError> {
    let mut glance = Glance { part: Part::None, pictures: 0, parameters: false };
    for unit in units(Codec::H265, data)? {
        let Some(header) = NalHeader::parse(unit).filter(|header| header.layer_id == 0) else { continue };
        let kind = header.nal_type;
        glance.parameters |= is_set(kind);
        if !begins_picture(kind, unit) {
            continue;
        }
        glance.pictures += 1;
        if glance.pictures > 1 {
            continue;
        }
        glance.part = if kind.is_irap() {
            Part::Key
        } else if kind.is_rasl() {
            Part::Leading
        } else {
            Part::Follows
        };
    }
    Ok(glance)
}

fn is_set(kind: NalType) -> bool {
    matches!(kind, NalType::Vps | NalType::Sps | NalType::Pps)
}

/// Whether it is the first slice of a picture.
fn begins_picture(kind: NalType, unit: &[u8]) -> bool {
    kind.is_vcl() && unit.get(2).is_some_and(|byte| byte & 0x80 != 0)
}

/// A decoder of H.265.
pub(crate) struct H265 {
    /// (height, width) of the camera.
    size: (u32, u32),
    pictures: Pictures,
    /// The newest sequence parameter set that was read: its colors, or why its pictures are not decoded.
    sequence: Result<Color, VideoError>,
    /// Pictures so far that the decoder made up for missing ones.
    missing: u64,
}

impl H265 {
    pub(crate) fn new(size: (u32, u32)) -> Self {
        Self { size, pictures: Pictures::new(), sequence: Ok(Color::DEFAULT), missing: 0 }
    }

    fn unit(&mut self, unit: &[u8], message: usize) -> Result<(), VideoError> {
        let Some(header) = NalHeader::parse(unit).filter(|header| header.layer_id == 0) else { return Ok(()) };
        if header.nal_type == NalType::Sps
            && let Some(body) = unit.get(2..)
        {
            let body = unescape(body).data;
            self.sequence = parse_sps(&body).map_err(failed).and_then(|set| check(&body, &set, self.size));
        }
        if header.nal_type.is_vcl() {
            self.sequence.as_ref().map_err(Clone::clone)?;
        }
        let message = i64::try_from(message).unwrap_or(i64::MAX);
        self.pictures.push_nal(unit, Some(message)).map_err(failed)?;
        if matches!(header.nal_type, NalType::Eos | NalType::Eob) {
            // A key frame after the end of a sequence discards the pictures before it that were not shown yet.
            self.pictures.flush();
        }
        Ok(())
    }

    fn take(&mut self, out: &mut Vec<Decoded>) {
        let color = self.sequence.clone().unwrap_or(Color::DEFAULT);
        while let Ok(frame) = self.pictures.next_frame() {
            if let Some(message) = frame.pts.and_then(|message| usize::try_from(message).ok()) {
                out.push((message, picture(&frame, color)));
            }
        }
    }
}

impl Decoder for H265 {
    fn push(&mut self, message: usize, data: &[u8], out: &mut Vec<Decoded>) -> Result<(), VideoError> {
        let units = units(Codec::H265, data)?;
        // A sequence that begins may discard the pictures before it that were not shown yet.
        let begins = |unit: &&[u8]| {
            NalHeader::parse(unit).is_some_and(|header| header.nal_type.is_idr() || header.nal_type.is_bla())
        };
        if units.iter().any(begins) {
            self.flush(out);
        }
        units.into_iter().try_for_each(|unit| self.unit(unit, message))?;
        self.take(out);
        let missing = self.pictures.stats.generated_refs;
        if missing != std::mem::replace(&mut self.missing, missing) {
            return Err(VideoError::damaged("a picture before it is missing; check the recorder's connection"));
        }
        Ok(())
    }

    fn parameters(&mut self, data: &[u8]) {
        for unit in units(Codec::H265, data).unwrap_or_default() {
            if NalHeader::parse(unit).is_some_and(|header| is_set(header.nal_type)) {
                // A damaged set is found by the pictures that need it.
                let _ = self.unit(unit, 0);
            }
        }
    }

    fn flush(&mut self, out: &mut Vec<Decoded>) {
        self.pictures.flush();
        self.take(out);
        self.missing = self.pictures.stats.generated_refs;
    }
}

/// Compares a sequence with the camera before it is decoded; returns its colors.
fn check(body: &[u8], set: &Sps, (height, width): (u32, u32)) -> Result<Color, VideoError> {
    if syntax::has_fields(body, set).map_err(|error| failed(error.into()))? {
        return Err(VideoError::fields(Codec::H265, "weave,yadif"));
    }
    let (found_width, found_height) = set.output_size();
    // Cropping hides at most a block of 64 pixels in a stream of this size; more would be memory without a use.
    let hidden = |coded: u32, shown: u32| coded.saturating_sub(shown) <= 64;
    if (found_height, found_width) != (height, width) {
        return Err(VideoError::WrongSize { height, width, found_height, found_width });
    }
    if !hidden(set.height, height) || !hidden(set.width, width) {
        return Err(VideoError::WrongSize { height, width, found_height: set.height, found_width: set.width });
    }
    match &set.vui {
        // The parser has 0 for a matrix that is not coded; the one that is coded as 0 needs 4:4:4.
        Some(vui) if vui.matrix_coeffs == 0 => Ok(Color { full_range: vui.video_full_range_flag, ..Color::DEFAULT }),
        Some(vui) => Color::coded(vui.matrix_coeffs, vui.video_full_range_flag),
        None => Ok(Color::DEFAULT),
    }
}

fn picture(frame: &Frame, color: Color) -> Picture {
    let picture = &frame.picture;
    let (left, top, width, height) = picture.crop;
    let [luma, chroma @ ..] = &picture.planes;
    let cut = |plane: &rusty_h265::Plane, (left, top, width, height): (usize, usize, usize, usize)| {
        let row = |row: usize| plane.row(row).get(left..left + width).unwrap_or_default();
        let samples = (top..top + height).flat_map(|at| row(at).iter().copied()).collect();
        Plane { width, height, samples }
    };
    let halves = (left / 2, top / 2, width.div_ceil(2), height.div_ceil(2));
    Picture {
        luma: cut(luma, picture.crop),
        chroma: Some(chroma.each_ref().map(|plane| cut(plane, halves))),
        depth: frame.bit_depth(),
        color,
        order: frame.poc.into(),
    }
}

fn failed(error: Error) -> VideoError {
    if let Error::Unsupported(what) = &error {
        return unsupported(what);
    }
    if let Error::Unimplemented(what) = error {
        return unsupported(what);
    }
    VideoError::damaged(format!("H.265: {error}; check the recorder's connection"))
}

fn unsupported(what: &str) -> VideoError {
    VideoError::Unsupported(format!(
        "H.265 with {what} is not decoded; encode with the profile Main or Main 10 (4:2:0, 8 or 10 bits)"
    ))
}
