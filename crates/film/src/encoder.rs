//! Pictures to packets of AV1, one for each picture in its order.

use rav1e::color::{ColorDescription, ColorPrimaries, MatrixCoefficients, PixelRange, TransferCharacteristics};
use rav1e::prelude::{ChromaSampling, EncoderStatus, FrameType, Rational};
use rav1e::{Config, Context, EncoderConfig};

use crate::error::FilmError;
use crate::planes::planes;
use crate::size::Size;

/// Of 0 to 255: lower is better and larger. Robots' pictures of this one differ by less than people see.
const QUANTIZER: usize = 70;
/// The encoder's fastest preset: AV1 in Rust is slow, and datasets have many pictures.
const SPEED: u8 = 10;
/// Pictures from one key frame to the next, as in LeRobot's own videos: training reads single pictures.
const KEY_INTERVAL: u64 = 2;
/// A unit that begins the packets of streams, which files leave out.
const DELIMITER: [u8; 2] = [0x12, 0x00];

/// A packet: one picture.
pub(crate) struct Packet {
    pub(crate) data: Vec<u8>,
    pub(crate) key: bool,
}

pub(crate) struct Encoder {
    context: Context<u8>,
    size: Size,
    /// Packets so far.
    packets: u64,
}

impl Encoder {
    pub(crate) fn new(size: Size, fps: u32) -> Result<Self, FilmError> {
        let mut config = EncoderConfig::with_speed_preset(SPEED);
        (config.width, config.height) = (size.width as usize, size.height as usize);
        config.time_base = Rational::new(1, fps.into());
        config.chroma_sampling = ChromaSampling::Cs420;
        config.pixel_range = PixelRange::Limited;
        config.color_description = Some(ColorDescription {
            color_primaries: ColorPrimaries::Unspecified,
            transfer_characteristics: TransferCharacteristics::Unspecified,
            matrix_coefficients: MatrixCoefficients::BT601,
        });
        // Every packet is the next picture.
        config.low_latency = true;
        config.quantizer = QUANTIZER;
        config.set_key_frame_interval(0, KEY_INTERVAL);
        // Pictures that wait for later ones take memory.
        config.speed_settings.rdo_lookahead_frames = 1;
        let context = Config::new().with_encoder_config(config).with_threads(1).new_context();
        let Size { height, width } = size;
        let context = context.map_err(|error| FilmError::Unfit { height, width, fps, problem: error.to_string() })?;
        Ok(Self { context, size, packets: 0 })
    }

    /// Takes the next picture, height × width × 3 bytes of RGB; returns the packets that are complete.
    pub(crate) fn push(&mut self, rgb: &[u8]) -> Result<Vec<Packet>, FilmError> {
        let width = self.size.width as usize;
        let expected = width * self.size.height as usize * 3;
        if rgb.len() != expected {
            return Err(FilmError::Picture { found: rgb.len(), expected });
        }
        let planes = planes(rgb, width);
        let mut frame = self.context.new_frame();
        frame.planes[0].copy_from_raw_u8(&planes.luma, width, 1);
        for (plane, chroma) in frame.planes[1..].iter_mut().zip(&planes.chroma) {
            plane.copy_from_raw_u8(chroma, planes.chroma_width, 1);
        }
        self.context.send_frame(frame).map_err(|error| FilmError::Encoder(error.to_string()))?;
        self.packets()
    }

    /// The packets of the pictures that are left.
    pub(crate) fn finish(&mut self) -> Result<Vec<Packet>, FilmError> {
        self.context.flush();
        self.packets()
    }

    fn packets(&mut self) -> Result<Vec<Packet>, FilmError> {
        let mut packets = Vec::new();
        loop {
            match self.context.receive_packet() {
                Ok(packet) if packet.input_frameno == self.packets => {
                    self.packets += 1;
                    let data = packet.data.strip_prefix(&DELIMITER).unwrap_or(&packet.data).to_vec();
                    packets.push(Packet { data, key: packet.frame_type == FrameType::KEY });
                }
                Ok(packet) => {
                    let problem = format!("picture {} came in the place of {}", packet.input_frameno, self.packets);
                    return Err(FilmError::Encoder(problem));
                }
                Err(EncoderStatus::Encoded) => {}
                Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(packets),
                Err(error) => return Err(FilmError::Encoder(error.to_string())),
            }
        }
    }
}

/// The sequence header with which a key frame begins.
pub(crate) fn sequence_header(packet: &[u8]) -> Option<&[u8]> {
    let (&head, rest) = packet.split_first()?;
    // A unit of type 1 with a size and without an extension.
    if head & 0b0111_1110 != 0b0000_1010 {
        return None;
    }
    let bytes = rest.iter().position(|byte| byte & 0x80 == 0)? + 1;
    let size = rest.get(..bytes)?.iter().rev().fold(0_usize, |size, byte| size << 7 | usize::from(byte & 0x7f));
    packet.get(..1 + bytes + size)
}
