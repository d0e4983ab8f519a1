//! One camera's part of a step's frame as a JPEG: colour as recorded, depth as grey.

use gleaner_recording::{CameraSpec, TaskSpec, encode_jpeg};

use crate::{
    domain::steps::FrameView,
    error::{Error, Result},
};

/// JPEG quality: sufficient to judge a grasp, at a tenth of the bytes.
const QUALITY: u8 = 85;
/// The brightness of the farthest pixel; black is for pixels without a reading.
const FARTHEST: u32 = 32;

/// RGB pixels, row-major.
struct Picture {
    rgb: Vec<u8>,
    height: usize,
    width: usize,
}

/// The image of a step's frame, which holds all cameras one after the other, as JPEG.
pub(super) fn picture(spec: &TaskSpec, frame: &[u8], view: &FrameView) -> Result<Vec<u8>> {
    let (camera, [color, depth]) = images(spec, frame, &view.camera)?;
    let (height, width) = (camera.height as usize, camera.width as usize);
    let rgb = match (view.depth, camera.depth) {
        (false, _) => color.to_vec(),
        (true, true) => grey(depth),
        (true, false) => {
            return Err(Error::invalid("depth", format!("camera {} has no depth in this task; omit it", camera.name)));
        }
    };
    let picture = match view.size {
        Some(0) => return Err(Error::invalid("size", "is 0, must be at least 1")),
        Some(most) => Picture { rgb, height, width }.within(most as usize),
        None => Picture { rgb, height, width },
    };
    let side = |pixels: usize| u32::try_from(pixels).map_err(|error| Error::internal("drawing a frame", error));
    encode_jpeg(&picture.rgb, side(picture.height)?, side(picture.width)?, QUALITY)
        .map_err(|error| Error::internal("drawing a frame", error))
}

/// The camera of this name with its color and depth bytes in a step's frame.
fn images<'a>(spec: &'a TaskSpec, frame: &'a [u8], name: &str) -> Result<(&'a CameraSpec, [&'a [u8]; 2])> {
    let mut rest = frame;
    for camera in &spec.cameras {
        let pixels = camera.height as usize * camera.width as usize;
        let split = |bytes: usize| {
            let short = || Error::internal("drawing a frame", "the frame is shorter than its cameras");
            rest.split_at_checked(bytes).ok_or_else(short)
        };
        let (own, after) = split(pixels * if camera.depth { 5 } else { 3 })?;
        if camera.name == name {
            let (color, depth) = own.split_at(pixels * 3);
            return Ok((camera, [color, depth]));
        }
        rest = after;
    }
    let known: Vec<&str> = spec.cameras.iter().map(|camera| camera.name.as_str()).collect();
    let known = if known.is_empty() { "it has none".to_owned() } else { format!("it has {}", known.join(", ")) };
    Err(Error::not_found("camera", format!("{name:?} of task {}; {known}", spec.name)))
}

/// 16-bit little-endian millimetres as grey pixels.
fn grey(depth: &[u8]) -> Vec<u8> {
    let all = || depth.as_chunks().0.iter().map(|bytes| u32::from(u16::from_le_bytes(*bytes)));
    let measured = || all().filter(|millimetres| *millimetres > 0);
    let (near, far) = (measured().min().unwrap_or(0), measured().max().unwrap_or(0));
    let light = |millimetres: u32| match millimetres {
        0 => 0,
        _ => 255 - (millimetres - near) * (255 - FARTHEST) / (far - near).max(1),
    };
    all().map(|millimetres| u8::try_from(light(millimetres)).unwrap_or(u8::MAX)).flat_map(|grey| [grey; 3]).collect()
}

impl Picture {
    /// Scales down to at most this width and height: each new pixel is the mean of a square of old ones.
    fn within(self, most: usize) -> Self {
        let square = self.height.max(self.width).div_ceil(most.max(1)).max(1);
        if square == 1 {
            return self;
        }
        let (height, width) = ((self.height / square).max(1), (self.width / square).max(1));
        let mut rgb = Vec::with_capacity(height * width * 3);
        for (row, column) in (0..height).flat_map(|row| (0..width).map(move |column| (row, column))) {
            rgb.extend(self.mean(row * square, column * square, square));
        }
        Self { rgb, height, width }
    }

    /// The mean colour of the square with this first pixel, as far as it is inside.
    fn mean(&self, top: usize, left: usize, square: usize) -> [u8; 3] {
        let (bottom, right) = ((top + square).min(self.height), (left + square).min(self.width));
        let (mut sums, mut pixels) = ([0_usize; 3], 0);
        for row in top..bottom {
            let line = &self.rgb[(row * self.width + left) * 3..(row * self.width + right) * 3];
            for pixel in line.as_chunks::<3>().0 {
                sums.iter_mut().zip(pixel).for_each(|(sum, &value)| *sum += usize::from(value));
                pixels += 1;
            }
        }
        sums.map(|sum| u8::try_from((sum + pixels / 2) / pixels.max(1)).unwrap_or(u8::MAX))
    }
}

#[cfg(test)]
mod tests;
