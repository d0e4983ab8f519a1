//! The film that is being written: its packets first, its tables at the end.

use std::io::{Seek, SeekFrom, Write};

use crate::container::{self, HEADER, Samples};
use crate::encoder::{Encoder, Packet, sequence_header};
use crate::error::FilmError;
use crate::size::Size;

/// A film that is being written. It is complete after [`FilmWriter::finish`] only.
pub struct FilmWriter<W> {
    out: W,
    size: Size,
    fps: u32,
    encoder: Encoder,
    samples: Samples,
    sequence_header: Vec<u8>,
    /// Where the packets' header is.
    packets_at: u64,
    /// Bytes of the packets.
    packet_bytes: u64,
    /// Pictures so far.
    pictures: u64,
}

impl<W> std::fmt::Debug for FilmWriter<W> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FilmWriter").field("size", &self.size).field("pictures", &self.pictures).finish_non_exhaustive()
    }
}

impl<W: Write + Seek> FilmWriter<W> {
    /// Begins a film of pictures of one size, `fps` a second.
    ///
    /// # Errors
    /// [`FilmError::Unfit`] for a size or rate that cannot be encoded; [`FilmError::Io`].
    pub fn create(mut out: W, size: Size, fps: u32) -> Result<Self, FilmError> {
        let encoder = Encoder::new(size, fps)?;
        let beginning = container::beginning()?;
        out.write_all(&beginning)?;
        out.write_all(&container::packets_header(0))?;
        Ok(Self {
            out,
            size,
            fps,
            encoder,
            samples: Samples::default(),
            sequence_header: Vec::new(),
            packets_at: beginning.len() as u64,
            packet_bytes: 0,
            pictures: 0,
        })
    }

    /// Takes the next picture, height × width × 3 bytes of RGB. Picture n is shown at n / `fps` seconds.
    ///
    /// # Errors
    /// [`FilmError`].
    pub fn push(&mut self, rgb: &[u8]) -> Result<(), FilmError> {
        let packets = self.encoder.push(rgb)?;
        self.pictures += 1;
        self.write(packets)
    }

    /// Pictures so far.
    pub fn pictures(&self) -> u64 {
        self.pictures
    }

    /// Bytes of the file so far, but for the pictures that are being encoded.
    pub fn bytes(&self) -> u64 {
        self.packets_at + HEADER as u64 + self.packet_bytes
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`FilmError`], also when there was no picture.
    pub fn finish(mut self) -> Result<W, FilmError> {
        let packets = self.encoder.finish()?;
        self.write(packets)?;
        if self.samples.sizes.len() as u64 != self.pictures || self.sequence_header.is_empty() {
            let found = self.samples.sizes.len();
            return Err(FilmError::Encoder(format!("{found} packets for {} pictures", self.pictures)));
        }
        let offset = self.packets_at + HEADER as u64;
        let tables = container::tables(self.size, self.fps, &self.sequence_header, &self.samples, offset)?;
        self.out.write_all(&tables)?;
        self.out.seek(SeekFrom::Start(self.packets_at))?;
        self.out.write_all(&container::packets_header(self.packet_bytes))?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn write(&mut self, packets: Vec<Packet>) -> Result<(), FilmError> {
        for Packet { data, key } in packets {
            if key && self.sequence_header.is_empty() {
                self.sequence_header = sequence_header(&data).unwrap_or_default().to_vec();
            }
            self.out.write_all(&data)?;
            let size = u32::try_from(data.len());
            self.samples.sizes.push(size.map_err(|_| FilmError::Encoder("a picture is too large".to_owned()))?);
            if key {
                self.samples.keys.push(u32::try_from(self.samples.sizes.len()).unwrap_or(u32::MAX));
            }
            self.packet_bytes += data.len() as u64;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    const SIZE: Size = Size { height: 16, width: 20 };

    fn film(pictures: u8) -> Result<Vec<u8>, FilmError> {
        let mut film = FilmWriter::create(Cursor::new(Vec::new()), SIZE, 7)?;
        for picture in 0..pictures {
            film.push(&[picture * 40; 16 * 20 * 3])?;
        }
        Ok(film.finish()?.into_inner())
    }

    #[test]
    fn the_same_pictures_are_the_same_bytes_with_whole_tables() {
        let file = film(5).unwrap();
        assert!(file == film(5).unwrap());
        let at = |name: &[u8]| file.windows(name.len()).position(|window| window == name).unwrap();
        let (packets, tables) = (at(b"mdat") - 4, at(b"moov") - 4);
        let size = u64::from_be_bytes(file[packets + 8..packets + HEADER].try_into().unwrap());
        assert_eq!(packets as u64 + size, tables as u64, "the size of the packets was written");
        // 5 pictures of 1000 ticks; the first, third and fifth are key frames.
        let numbers = |name: &[u8], count: usize| -> Vec<u32> {
            let from = at(name) + 8;
            file[from..from + 4 * count].as_chunks().0.iter().map(|&bytes| u32::from_be_bytes(bytes)).collect()
        };
        assert_eq!(numbers(b"stts", 3), [1, 5, 1000]);
        assert_eq!(numbers(b"stss", 4), [3, 1, 3, 5]);
    }

    #[test]
    fn pictures_that_do_not_fit_are_refused() {
        let small = FilmWriter::create(Cursor::new(Vec::new()), Size { height: 12, width: 16 }, 10).unwrap_err();
        assert!(small.to_string().contains("12×16 pixels at 10 Hz"), "{small}");
        let mut film = FilmWriter::create(Cursor::new(Vec::new()), SIZE, 10).unwrap();
        assert!(matches!(film.push(&[0; 7]), Err(FilmError::Picture { found: 7, expected: 960 })));
        assert!(matches!(film.finish(), Err(FilmError::Encoder(_))), "there is no picture");
    }
}
