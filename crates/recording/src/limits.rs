//! The most that a recording may hold, and ask of who reads it.
//!
//! Lengths and counts in a file are only claims. Each is held against one of these before memory is reserved for it.

/// Most of everything; what is over is refused with the limit's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one chunk, as it is stored and as it unpacks.
    pub chunk_bytes: usize,
    /// Bytes of one record; at most those of a chunk.
    pub record_bytes: usize,
    /// Records of one file, those inside its chunks among them.
    pub records: u64,
    /// Channels of one file, and schemas of one file.
    pub channels: usize,
    /// Bytes of a topic, of an encoding's and of a schema's name.
    pub name_bytes: usize,
    /// How deep arrays and objects of a JSON message may lie in one another.
    pub json_depth: usize,
    /// Pixels of one image.
    pub image_pixels: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            chunk_bytes: 256 << 20,
            record_bytes: 256 << 20,
            records: 100_000_000,
            channels: 4096,
            name_bytes: 1024,
            json_depth: 64,
            image_pixels: 1 << 26,
        }
    }
}

impl Limits {
    /// For what was let in before, maybe under wider limits than today's.
    pub const ADMITTED: Self = Self {
        chunk_bytes: 4 << 30,
        record_bytes: 4 << 30,
        records: u64::MAX,
        channels: usize::MAX,
        name_bytes: usize::MAX,
        json_depth: MOST_JSON_DEPTH,
        image_pixels: u64::MAX,
    };
}

/// Beyond this the JSON reader itself stops.
pub const MOST_JSON_DEPTH: usize = 127;
