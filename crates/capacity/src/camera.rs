//! Cameras of a robot and the size of their pictures.

use std::str::FromStr;

use serde::Serialize;

use crate::{codec::Codec, rate};

/// Equal cameras of a robot, written `COUNTxHEIGHTxWIDTH[@CODEC]`: `2x480x640@jpeg`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Camera {
    /// Number of them.
    pub count: u32,
    /// Height of a picture in pixels.
    pub height: u32,
    /// Width of a picture in pixels.
    pub width: u32,
    /// Form of the recording.
    pub codec: Codec,
}

impl Camera {
    /// Bytes that all of them record at one step.
    #[must_use]
    pub fn recorded_bytes(&self) -> f64 {
        self.pixels() * rate::bytes_a_pixel(self.codec)
    }

    /// Seconds of one processor to decode what all of them record at one step.
    #[must_use]
    pub fn inspection_seconds(&self) -> f64 {
        self.pixels() / rate::pixels_a_second(self.codec)
    }

    fn pixels(&self) -> f64 {
        f64::from(self.count) * f64::from(self.height) * f64::from(self.width)
    }
}

impl FromStr for Camera {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is no COUNTxHEIGHTxWIDTH[@CODEC], such as 2x480x640@jpeg");
        let (size, codec) = text.split_once('@').unwrap_or((text, "jpeg"));
        let numbers: Vec<u32> =
            size.split('x').map(|number| number.parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
        let [count, height, width] = numbers[..] else { return Err(wrong()) };
        if [count, height, width].contains(&0) {
            return Err(format!("{text:?} has a 0; leave out a camera that does not exist"));
        }
        let names = Codec::ALL.map(|(name, _)| name).join(", ");
        let known = Codec::ALL.iter().find(|(name, _)| *name == codec);
        let (_, codec) = known.ok_or_else(|| format!("{codec:?} is an unknown codec; supported: {names}"))?;
        Ok(Self { count, height, width, codec: *codec })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_is_its_count_size_and_codec() {
        let camera: Camera = "2x480x640@h264".parse().unwrap();
        assert_eq!(camera, Camera { count: 2, height: 480, width: 640, codec: Codec::H264 });
        assert_eq!("1x48x64".parse::<Camera>().unwrap().codec, Codec::Jpeg);
        for (text, reason) in [
            ("480x640", "COUNTxHEIGHTxWIDTH"),
            ("2x480x640x3", "COUNTxHEIGHTxWIDTH"),
            ("twox480x640", "COUNTxHEIGHTxWIDTH"),
            ("0x480x640", "has a 0"),
            ("2x480x640@gif", "supported: jpeg, h264, h265, av1"),
        ] {
            assert!(text.parse::<Camera>().unwrap_err().contains(reason), "{text}");
        }
    }
}
