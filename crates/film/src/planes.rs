//! RGB to the planes of video: BT.601 in limited range with halved chroma, which players assume of video that states nothing.

/// Bits behind the point of the coefficients.
const BITS: u32 = 16;
const HALF: i32 = 1 << (BITS - 1);
/// Luma of red, green and blue: 0.299, 0.587 and 0.114 of 219 / 255.
const LUMA: [i32; 3] = [16_829, 33_039, 6_416];
/// The differences to blue and to red, of 224 / 255.
const BLUE: [i32; 3] = [-9_714, -19_070, 28_784];
const RED: [i32; 3] = [28_784, -24_103, -4_681];

/// Luma, and the differences to blue and red, each row after row without padding.
pub(crate) struct Planes {
    pub(crate) luma: Vec<u8>,
    pub(crate) chroma: [Vec<u8>; 2],
    pub(crate) chroma_width: usize,
}

/// Converts height × width × 3 bytes of RGB. Chroma is that of the mean color of two by two pixels.
pub(crate) fn planes(rgb: &[u8], width: usize) -> Planes {
    let luma = rgb.as_chunks::<3>().0.iter().map(|pixel| value(LUMA, pixel.map(i32::from), 16)).collect();
    let chroma_width = width.div_ceil(2);
    let mut chroma = [Vec::new(), Vec::new()];
    let rows: Vec<&[u8]> = rgb.chunks_exact(width.max(1) * 3).collect();
    for pair in rows.chunks(2) {
        for at in 0..chroma_width {
            let mut sum = [0_i32; 3];
            let mut count = 0;
            for row in pair {
                for pixel in row.as_chunks::<3>().0.iter().skip(at * 2).take(2) {
                    sum.iter_mut().zip(pixel).for_each(|(sum, &color)| *sum += i32::from(color));
                    count += 1;
                }
            }
            let mean = sum.map(|sum| (sum + count / 2) / count.max(1));
            chroma[0].push(value(BLUE, mean, 128));
            chroma[1].push(value(RED, mean, 128));
        }
    }
    Planes { luma, chroma, chroma_width }
}

fn value(coefficients: [i32; 3], color: [i32; 3], zero: i32) -> u8 {
    let sum: i32 = coefficients.iter().zip(color).map(|(coefficient, color)| coefficient * color).sum();
    u8::try_from((((sum + HALF) >> BITS) + zero).clamp(0, 255)).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_have_the_values_of_the_standard() {
        // Y, Cb and Cr of ITU-R BT.601 in 8 bits.
        for (rgb, expected) in [
            ([0, 0, 0], [16, 128, 128]),
            ([255, 255, 255], [235, 128, 128]),
            ([255, 0, 0], [81, 90, 240]),
            ([0, 255, 0], [145, 54, 34]),
            ([0, 0, 255], [41, 240, 110]),
        ] {
            let found = planes(&rgb.repeat(4), 2);
            assert_eq!(found.luma, [expected[0]; 4], "{rgb:?}");
            assert_eq!(found.chroma, [vec![expected[1]], vec![expected[2]]], "{rgb:?}");
        }
    }

    #[test]
    fn odd_sides_have_a_value_for_the_last_pixel() {
        let found = planes(&[9; 3 * 5 * 3], 5);
        assert_eq!((found.luma.len(), found.chroma_width), (15, 3));
        assert!(found.chroma.iter().all(|plane| plane.len() == 2 * 3));
    }
}
