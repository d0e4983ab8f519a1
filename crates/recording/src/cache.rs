//! The frame cache: a decoded episode as one file that is mapped rather than read.
//!
//! Layout, all little-endian: 8 magic bytes, version (u32), length of the header (u32), a JSON header, zeros
//! up to a multiple of 64, stamps (i64), proprioception (f32), action (f32), frames. A cache is derived from
//! a recording and can be made again at any time.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use memmap2::Mmap;
use serde::{Deserialize, Serialize};

use crate::error::RecordingError;
use crate::frames::{Bytes, Episode, FrameBytes};
use crate::whole_file::write_whole;

const MAGIC: &[u8; 8] = b"GLEANFRM";
const VERSION: u32 = 1;
const ALIGNMENT: usize = 64;

/// The sizes of the arrays in the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    stamps: usize,
    proprioception: usize,
    action: usize,
    frame_bytes: usize,
}

impl Episode {
    /// Opens a frame cache. The numbers are read; the frames stay on disk until they are touched.
    ///
    /// # Errors
    /// [`RecordingError::Io`], or [`RecordingError::Cache`] if the file is no whole cache of this version.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|source| io(path, source))?;
        #[expect(
            unsafe_code,
            reason = "a cache is written beside its name, renamed once whole, and never changed after"
        )]
        let map = unsafe { Mmap::map(&file) }.map_err(|source| io(path, source))?;
        parse(map).map_err(|problem| RecordingError::Cache { problem: format!("{}: {problem}", path.display()) })
    }

    /// Writes the episode as a frame cache. The file appears under its name only once it is whole.
    ///
    /// # Errors
    /// [`RecordingError::Io`].
    pub fn write_cache(&self, path: &Path) -> Result<(), RecordingError> {
        write_whole(path, |mut out| match self.write_to(&mut out) {
            Ok(()) => Ok(out),
            Err(source) => Err(io(path, source)),
        })
    }

    fn write_to(&self, out: &mut impl Write) -> std::io::Result<()> {
        let header = Header {
            stamps: self.stamps.len(),
            proprioception: self.proprioception.len(),
            action: self.action.len(),
            frame_bytes: self.frames.as_ref().len(),
        };
        let header = serde_json::to_vec(&header)?;
        let length = u32::try_from(header.len()).map_err(std::io::Error::other)?;
        out.write_all(MAGIC)?;
        out.write_all(&VERSION.to_le_bytes())?;
        out.write_all(&length.to_le_bytes())?;
        out.write_all(&header)?;
        let so_far = 16 + header.len();
        out.write_all(&vec![0; so_far.next_multiple_of(ALIGNMENT) - so_far])?;
        self.stamps.iter().try_for_each(|stamp| out.write_all(&stamp.to_le_bytes()))?;
        self.proprioception.iter().chain(&self.action).try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
        out.write_all(self.frames.as_ref())
    }
}

fn parse(map: Mmap) -> Result<Episode, String> {
    let cut = || "it ends in the middle".to_owned();
    let (magic, rest) = map.split_first_chunk::<8>().ok_or_else(cut)?;
    let (version, rest) = rest.split_first_chunk::<4>().ok_or_else(cut)?;
    let (length, rest) = rest.split_first_chunk::<4>().ok_or_else(cut)?;
    if magic != MAGIC {
        return Err("it is not a frame cache".to_owned());
    }
    if u32::from_le_bytes(*version) != VERSION {
        return Err(format!("it is of version {}, not {VERSION}", u32::from_le_bytes(*version)));
    }
    let length = usize::try_from(u32::from_le_bytes(*length)).map_err(|_| cut())?;
    let header = rest.get(..length).ok_or_else(cut)?;
    let header: Header = serde_json::from_slice(header).map_err(|error| format!("its header is broken ({error})"))?;
    let mut at = (16 + length).next_multiple_of(ALIGNMENT);
    let mut array = |count: usize, bytes: usize| {
        let end = count.checked_mul(bytes).and_then(|size| at.checked_add(size)).ok_or_else(cut)?;
        let part = map.get(at..end).ok_or_else(cut)?;
        at = end;
        Ok::<&[u8], String>(part)
    };
    let stamps = array(header.stamps, 8)?.as_chunks().0.iter().map(|bytes| i64::from_le_bytes(*bytes)).collect();
    let floats = |bytes: &[u8]| bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let proprioception = floats(array(header.proprioception, 4)?);
    let action = floats(array(header.action, 4)?);
    let frames = array(header.frame_bytes, 1)?.len();
    if at != map.len() {
        return Err("it is longer than its header says".to_owned());
    }
    let begin = map.len() - frames;
    Ok(Episode { stamps, proprioception, action, frames: FrameBytes(Bytes::Mapped(Arc::new(map), begin)) })
}

fn io(path: &Path, source: std::io::Error) -> RecordingError {
    RecordingError::Io { path: path.to_path_buf(), source }
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::frames::frame_bytes_per_step;
    use crate::testing::arm;

    fn episode() -> Episode {
        let spec = arm();
        let frames = (0..3 * frame_bytes_per_step(&spec)).map(|at| u8::try_from(at % 251).unwrap()).collect();
        let action = vec![f32::MIN_POSITIVE, -1.0, 0.1, 0.2, 0.3, 0.4];
        Episode::new(&spec, vec![-5, 0, i64::MAX], (0..9u8).map(f32::from).collect(), action, frames).unwrap()
    }

    #[test]
    fn cache_preserves_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.frames");
        let written = episode();
        written.write_cache(&path).unwrap();
        written.write_cache(&path).unwrap();
        let read = Episode::open(&path).unwrap();
        assert_eq!(read.stamps(), written.stamps());
        assert_eq!(read.proprioception(), written.proprioception());
        assert_eq!(read.action(), written.action());
        assert_eq!(read.frames().as_ref(), written.frames().as_ref());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let frames = read.frames();
        drop(read);
        assert_eq!(frames.as_ref().len(), written.frames().as_ref().len());
    }

    #[test]
    fn truncated_extended_or_foreign_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.frames");
        episode().write_cache(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let opens = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Episode::open(&path).map(|_| ()).map_err(|error| error.to_string())
        };
        for cut in [0, 7, 15, 40, 130, whole.len() - 1] {
            assert!(opens(&whole[..cut]).is_err(), "cut at {cut}");
        }
        assert!(opens(&[&whole[..], &[0]].concat()).unwrap_err().contains("longer"));
        let mut other = whole.clone();
        other[8] = 9;
        assert!(opens(&other).unwrap_err().contains("version 9"));
        assert!(opens(b"something else entirely").unwrap_err().contains("not a frame cache"));
        assert!(opens(&whole).is_ok());
    }
}
