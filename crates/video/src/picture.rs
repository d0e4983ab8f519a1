//! A decoded picture: its planes as the stream has them, and their conversion to RGB.
//!
//! The conversion follows the stream's own matrix and range. A stream without them is BT.601 with limited range, as in
//! FFmpeg. Each chroma sample is used for every pixel it covers, without interpolation, as FFmpeg does by default.

use crate::error::VideoError;

/// The samples of one component, row-major, at the stream's depth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plane {
    /// Samples of a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// width × height samples.
    pub samples: Vec<u16>,
}

/// The weights of red and blue in luma.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Matrix {
    /// The planes are green, blue and red.
    Identity,
    /// BT.601, and streams without a matrix.
    Bt601,
    /// BT.709.
    Bt709,
    /// FCC.
    Fcc,
    /// SMPTE 240M.
    Smpte240,
    /// BT.2020 with non-constant luminance.
    Bt2020,
}

/// How samples stand for colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Color {
    /// The matrix.
    pub matrix: Matrix,
    /// Whether samples use the full range rather than 16 to 235 (luma) and 16 to 240 (chroma), at 8 bits.
    pub full_range: bool,
}

/// A decoded picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Luma.
    pub luma: Plane,
    /// Cb and Cr; `None` of a monochrome stream.
    pub chroma: Option<[Plane; 2]>,
    /// Bits of a sample.
    pub depth: u8,
    /// The meaning of the samples.
    pub color: Color,
    /// Place in the order of presentation since the last key frame that begins a sequence.
    pub order: i64,
}

impl Color {
    /// A stream without a description of its colors.
    pub(crate) const DEFAULT: Self = Self { matrix: Matrix::Bt601, full_range: false };

    /// From the codes that the three codecs share (ISO/IEC 23091-2).
    pub(crate) fn coded(matrix: u8, full_range: bool) -> Result<Self, VideoError> {
        let matrix = match matrix {
            0 => Matrix::Identity,
            1 => Matrix::Bt709,
            2 | 3 | 5 | 6 => Matrix::Bt601,
            4 => Matrix::Fcc,
            7 => Matrix::Smpte240,
            9 => Matrix::Bt2020,
            other => {
                return Err(VideoError::Unsupported(format!(
                    "the colors are coded by matrix {other}; encode with BT.601 or BT.709"
                )));
            }
        };
        Ok(Self { matrix, full_range })
    }
}

impl Matrix {
    /// The weights of red and blue.
    fn weights(self) -> (f64, f64) {
        match self {
            Self::Identity => (0.0, 0.0),
            Self::Bt601 => (0.299, 0.114),
            Self::Bt709 => (0.2126, 0.0722),
            Self::Fcc => (0.30, 0.11),
            Self::Smpte240 => (0.212, 0.087),
            Self::Bt2020 => (0.2627, 0.0593),
        }
    }
}

/// Bits behind the point in the conversion.
const POINT: u32 = 16;

/// The conversion of one stream in whole numbers.
struct Conversion {
    black: i32,
    middle: i32,
    luma: i32,
    red: i32,
    green: [i32; 2],
    blue: i32,
}

impl Conversion {
    fn new(color: Color, depth: u8) -> Self {
        let (red, blue) = color.matrix.weights();
        let (scale, top) = (f64::from(1_u32 << (depth - 8)), f64::from((1_u32 << depth) - 1));
        let (luma_range, chroma_range) = if color.full_range { (top, top) } else { (219.0 * scale, 224.0 * scale) };
        #[expect(clippy::cast_possible_truncation, reason = "the factors are below 3 × 255")]
        let fixed = |factor: f64| (factor * 255.0 * f64::from(1_u32 << POINT)).round() as i32;
        let green = 1.0 - red - blue;
        Self {
            black: if color.full_range { 0 } else { 16 << (depth - 8) },
            middle: 1 << (depth - 1),
            luma: fixed(1.0 / luma_range),
            red: fixed(2.0 * (1.0 - red) / chroma_range),
            green: [
                fixed(2.0 * blue * (1.0 - blue) / green / chroma_range),
                fixed(2.0 * red * (1.0 - red) / green / chroma_range),
            ],
            blue: fixed(2.0 * (1.0 - blue) / chroma_range),
        }
    }

    fn pixel(&self, luma: u16, chroma: [u16; 2]) -> [u8; 3] {
        let luma = self.level(luma);
        let [blue, red] = chroma.map(|sample| i32::from(sample) - self.middle);
        [
            byte(luma + self.red * red),
            byte(luma - self.green[0] * blue - self.green[1] * red),
            byte(luma + self.blue * blue),
        ]
    }

    fn level(&self, sample: u16) -> i32 {
        (i32::from(sample) - self.black) * self.luma + (1 << (POINT - 1))
    }
}

#[expect(clippy::cast_sign_loss, reason = "the range is clamped first")]
fn byte(fixed: i32) -> u8 {
    (fixed >> POINT).clamp(0, 255) as u8
}

impl Picture {
    /// (height, width) in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.luma.height, self.luma.width)
    }

    /// height × width × 3 bytes of RGB, row-major.
    pub fn rgb(&self) -> Vec<u8> {
        let conversion = Conversion::new(self.color, self.depth);
        let (height, width) = self.size();
        let mut out = Vec::with_capacity(height * width * 3);
        for (row, luma) in self.luma.samples.chunks_exact(width.max(1)).enumerate() {
            match &self.chroma {
                None => {
                    out.extend(luma.iter().flat_map(|&sample| [byte(conversion.level(sample)); 3]));
                }
                Some([blue, red]) => {
                    let (blue, red) = (blue.row(row, height), red.row(row, height));
                    append(&mut out, &conversion, self.color.matrix, luma, blue, red);
                }
            }
        }
        out
    }
}

/// Appends one row of pixels; chroma has a sample a pixel or a sample for two.
fn append(out: &mut Vec<u8>, conversion: &Conversion, matrix: Matrix, luma: &[u16], blue: &[u16], red: &[u16]) {
    if matrix == Matrix::Identity {
        let pixels = luma.iter().zip(blue.iter().zip(red));
        out.extend(pixels.flat_map(|(&g, (&b, &r))| [r, g, b].map(|sample| byte(conversion.level(sample)))));
    } else if blue.len() == luma.len() {
        let pixels = luma.iter().zip(blue.iter().zip(red));
        out.extend(pixels.flat_map(|(&luma, (&blue, &red))| conversion.pixel(luma, [blue, red])));
    } else {
        for (pair, (&blue, &red)) in luma.chunks(2).zip(blue.iter().zip(red)) {
            for &luma in pair {
                out.extend(conversion.pixel(luma, [blue, red]));
            }
        }
    }
}

impl Plane {
    pub(crate) fn of_bytes(width: usize, height: usize, bytes: &[u8]) -> Self {
        Self { width, height, samples: bytes.iter().map(|&byte| byte.into()).collect() }
    }

    /// The row of chroma that covers a row of a picture of this height.
    fn row(&self, row: usize, height: usize) -> &[u16] {
        let at = if self.height < height { row / 2 } else { row };
        self.samples.get(at * self.width..(at + 1) * self.width).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one(matrix: Matrix, full_range: bool, depth: u8, samples: [u16; 3]) -> [u8; 3] {
        let plane = |sample| Plane { width: 1, height: 1, samples: vec![sample] };
        let [luma, blue, red] = samples.map(plane);
        let picture = Picture { luma, chroma: Some([blue, red]), depth, color: Color { matrix, full_range }, order: 0 };
        picture.rgb().try_into().unwrap()
    }

    #[test]
    fn black_white_and_red_are_right_in_each_matrix_and_range() {
        for (matrix, red) in [(Matrix::Bt601, [81, 90, 240]), (Matrix::Bt709, [63, 102, 240])] {
            assert_eq!(one(matrix, false, 8, [16, 128, 128]), [0, 0, 0]);
            assert_eq!(one(matrix, false, 8, [235, 128, 128]), [255, 255, 255]);
            let found = one(matrix, false, 8, red);
            assert!(found[0] >= 253 && found[1] <= 2 && found[2] <= 2, "{matrix:?}: {found:?}");
        }
        assert_eq!(one(Matrix::Bt601, true, 8, [255, 128, 128]), [255, 255, 255]);
        assert_eq!(one(Matrix::Bt601, true, 8, [16, 128, 128]), [16, 16, 16]);
        assert_eq!(one(Matrix::Bt709, false, 10, [940, 512, 512]), [255, 255, 255]);
        assert_eq!(one(Matrix::Bt709, true, 12, [4095, 2048, 2048]), [255, 255, 255]);
        assert_eq!(one(Matrix::Identity, true, 8, [2, 3, 1]), [1, 2, 3]);
    }

    #[test]
    fn a_chroma_sample_colors_each_pixel_it_covers() {
        let plane = |width, height, samples: &[u16]| Plane { width, height, samples: samples.to_vec() };
        let picture = Picture {
            luma: plane(3, 3, &[81; 9]),
            chroma: Some([plane(2, 2, &[90, 128, 128, 128]), plane(2, 2, &[240, 128, 128, 128])]),
            depth: 8,
            color: Color::DEFAULT,
            order: 0,
        };
        let rgb = picture.rgb();
        let (red, gray) = (&rgb[..3], &rgb[6..9]);
        assert!(red[0] > 250 && red[1] < 3, "{red:?}");
        assert_eq!(gray, [76; 3]);
        let is_red = |pixel: &[u8]| pixel == red;
        let found: Vec<bool> = rgb.chunks(3).map(is_red).collect();
        assert_eq!(found, [true, true, false, true, true, false, false, false, false]);
    }

    #[test]
    fn monochrome_is_gray_and_unknown_matrices_are_refused() {
        let luma = Plane { width: 2, height: 1, samples: vec![16, 235] };
        let picture = Picture { luma, chroma: None, depth: 8, color: Color::DEFAULT, order: 0 };
        assert_eq!(picture.rgb(), [0, 0, 0, 255, 255, 255]);
        assert!(Color::coded(8, false).unwrap_err().to_string().contains("matrix 8"));
    }
}
