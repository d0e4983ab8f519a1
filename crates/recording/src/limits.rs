//! Limits on the content of a recording and on the work of its reader.
//!
//! Lengths and counts in a file are untrusted. Each is compared with a limit before memory is reserved for it.

/// The limits. A recording above one is rejected with the name of the limit.
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
    /// Nesting depth of arrays and objects in a JSON message.
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
    /// For recordings that were accepted before, possibly under wider limits.
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

/// The threads that decode images.
#[derive(Clone, Copy, Debug)]
pub struct ImageThreads {
    /// Their number, beside the caller's thread; below 2, the caller's decodes all.
    pub count: usize,
    /// The most memory in bytes of messages and pictures under way, apart from one that takes more.
    pub bytes: usize,
}

impl ImageThreads {
    /// The caller's thread alone.
    pub const NONE: Self = Self { count: 0, bytes: 0 };
}
