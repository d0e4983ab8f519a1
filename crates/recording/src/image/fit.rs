//! From the picture of a camera to the pixels of a step: the crop, resized.
//!
//! The one definition of it: recordings, observations of robots and live scores all pass here. Independent of formats and
//! messages.

use fast_image_resize::images::{TypedCroppedImage, TypedImage, TypedImageRef};
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer, pixels::U8x3};
use gleaner_core::{Crop, PictureSizes};

use super::broken;
use crate::error::RecordingError;

/// Whether a picture of this (height, width) can become one of a step.
pub(crate) fn check_size(sizes: &PictureSizes, found: (u32, u32)) -> Result<(), RecordingError> {
    if found == sizes.recorded() || found == sizes.step() {
        return Ok(());
    }
    let (height, width) = sizes.recorded();
    Err(RecordingError::WrongSize { height, width, found_height: found.0, found_width: found.1 })
}

/// RGB of a step from RGB of the (height, width) `found`: the crop, with each new pixel the weighted mean of those under it
/// (linear weights, as wide as the reduction, so nothing is left out).
///
/// # Errors
/// [`RecordingError::WrongSize`].
pub(crate) fn color(pixels: Vec<u8>, found: (u32, u32), sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let Some(crop) = crop(sizes, found)? else { return Ok(pixels) };
    // `Resizer::resize` selects the kind of pixel at run time, and would compile all thirteen into this crate.
    let source = TypedImageRef::<U8x3>::from_buffer(found.1, found.0, &pixels).map_err(|error| unfit(&error))?;
    // A view of the crop, because the library's own option reads beyond its border.
    let crop = TypedCroppedImage::new(source, crop.left, crop.top, crop.width, crop.height);
    let crop = crop.map_err(|error| unfit(&error))?;
    let mut step = vec![0; sizes.height as usize * sizes.width as usize * 3];
    let mut view =
        TypedImage::<U8x3>::from_buffer(sizes.width, sizes.height, &mut step).map_err(|error| unfit(&error))?;
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(FilterType::Bilinear));
    Resizer::new().resize_typed(&crop, &mut view, &options).map_err(|error| unfit(&error))?;
    Ok(step)
}

/// Depth of a step from 16-bit depth of the (height, width) `found`: the crop, with each new pixel the old one at its
/// centre. A mean would measure where nothing is, between an edge and what is behind it.
///
/// # Errors
/// [`RecordingError::WrongSize`].
pub(crate) fn depth(pixels: Vec<u8>, found: (u32, u32), sizes: &PictureSizes) -> Result<Vec<u8>, RecordingError> {
    let Some(crop) = crop(sizes, found)? else { return Ok(pixels) };
    let rows = centres(crop.top, crop.height, sizes.height);
    let columns: Vec<usize> = centres(crop.left, crop.width, sizes.width).collect();
    let (pixels, wide) = (pixels.as_chunks::<2>().0, found.1 as usize);
    let at = |row: usize, column: usize| pixels.get(row * wide + column).copied().unwrap_or_default();
    Ok(rows.flat_map(|row| columns.iter().flat_map(move |&column| at(row, column))).collect())
}

/// The part to resize, or nothing if the picture already is one of a step.
fn crop(sizes: &PictureSizes, found: (u32, u32)) -> Result<Option<Crop>, RecordingError> {
    check_size(sizes, found)?;
    Ok((found != sizes.step()).then_some(sizes.crop()))
}

fn unfit(error: &dyn std::fmt::Display) -> RecordingError {
    broken(error.to_string())
}

/// The old places at the centres of `count` new ones, which divide `length` places from `first` on evenly.
fn centres(first: u32, length: u32, count: u32) -> impl Iterator<Item = usize> {
    let [first, length, count] = [first, length, count].map(|number| number as usize);
    (0..count).map(move |at| first + (2 * at + 1) * length / (2 * count))
}

#[cfg(test)]
mod tests {
    use gleaner_core::RecordedSize;

    use super::*;

    const CROP: Crop = Crop { top: 3, left: 20, height: 90, width: 96 };
    const FOUND: (u32, u32) = (96, 128);
    const PLAIN: u32 = 0xa6e3_90e8;

    fn sizes() -> PictureSizes {
        let recorded = RecordedSize { height: FOUND.0, width: FOUND.1, crop: Some(CROP) };
        PictureSizes { height: 20, width: 36, recorded: Some(recorded) }
    }

    /// A picture with edges and gradients, `channels` bytes a pixel.
    fn picture(channels: usize) -> Vec<u8> {
        let bytes = FOUND.0 as usize * FOUND.1 as usize * channels;
        (0..bytes).map(|at| u8::try_from((at * at / 7 + at / 384 * 31) % 256).unwrap()).collect()
    }

    /// One new value in double precision, by the definition.
    fn mean(pixels: &[u8], channel: usize, row: usize, column: usize) -> f64 {
        let weights = |at: usize, count: u32, first: u32, length: u32| {
            let scale = f64::from(length) / f64::from(count);
            let reach = scale.max(1.0);
            let centre = (f64::from(u32::try_from(at).unwrap()) + 0.5) * scale;
            let weight = move |place: u32| (1.0 - ((f64::from(place) + 0.5 - centre) / reach).abs()).max(0.0);
            (0..length).map(move |place| ((first + place) as usize, weight(place))).collect::<Vec<_>>()
        };
        let rows = weights(row, 20, CROP.top, CROP.height);
        let columns = weights(column, 36, CROP.left, CROP.width);
        let (mut sum, mut all) = (0.0, 0.0);
        for (y, a) in &rows {
            for (x, b) in &columns {
                sum += a * b * f64::from(pixels[(y * FOUND.1 as usize + x) * 3 + channel]);
                all += a * b;
            }
        }
        sum / all
    }

    #[test]
    fn every_color_value_is_the_weighted_mean_of_its_crop() {
        let pixels = picture(3);
        let step = color(pixels.clone(), FOUND, &sizes()).unwrap();
        assert_eq!(step.len(), 20 * 36 * 3);
        for row in 0..20 {
            for column in 0..36 {
                for channel in 0..3 {
                    let found = f64::from(step[(row * 36 + column) * 3 + channel]);
                    let expected = mean(&pixels, channel, row, column);
                    assert!((found - expected).abs() <= 1.0, "{row} {column} {channel}: {found}, not {expected}");
                }
            }
        }
    }

    /// The checksum is of the library's plain arithmetic, without the vector instructions of any processor.
    #[test]
    fn every_processor_gives_the_same_bytes() {
        assert_eq!(crc32fast::hash(&color(picture(3), FOUND, &sizes()).unwrap()), PLAIN);
    }

    #[test]
    fn every_depth_value_is_the_one_at_its_centre() {
        let pixels = picture(2);
        let step = depth(pixels.clone(), FOUND, &sizes()).unwrap();
        for (row, column) in (0..20).flat_map(|row| (0..36).map(move |column| (row, column))) {
            // 90 / 20 = 4.5 rows and 96 / 36 = 2.67 columns to a pixel.
            let (y, x) = (3 + (2 * row + 1) * 90 / 40, 20 + (2 * column + 1) * 96 / 72);
            let (old, new) = ((y * 128 + x) * 2, (row * 36 + column) * 2);
            assert_eq!(step[new..new + 2], pixels[old..old + 2], "{row} {column}");
        }
        assert_eq!(step.len(), 20 * 36 * 2);
    }

    #[test]
    fn a_crop_of_the_size_of_a_step_is_copied() {
        let crop = Crop { top: 0, left: 0, height: 90, width: 96 };
        let recorded = Some(RecordedSize { height: FOUND.0, width: FOUND.1, crop: Some(crop) });
        let sizes = PictureSizes { height: 90, width: 96, recorded };
        let rows = |pixels: &[u8], bytes: usize| -> Vec<u8> {
            pixels.chunks(128 * bytes).take(90).flat_map(|row| row[..96 * bytes].to_vec()).collect()
        };
        assert_eq!(color(picture(3), FOUND, &sizes).unwrap(), rows(&picture(3), 3));
        assert_eq!(depth(picture(2), FOUND, &sizes).unwrap(), rows(&picture(2), 2));
    }

    #[test]
    fn a_picture_of_a_step_is_unchanged_and_another_size_is_refused() {
        let small = vec![7; 20 * 36 * 3];
        assert_eq!(color(small.clone(), (20, 36), &sizes()).unwrap(), small);
        assert_eq!(color(picture(3), FOUND, &PictureSizes::new(96, 128)).unwrap(), picture(3));
        let error = color(vec![0; 36 * 20 * 3], (36, 20), &sizes()).unwrap_err().to_string();
        assert!(error.contains("36×20") && error.contains("96×128"), "{error}");
        assert!(depth(vec![0; 12], (2, 3), &sizes()).is_err());
    }
}
