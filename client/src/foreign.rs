//! What others recorded: which paths are datasets that are pushed as they are, and which files a program of theirs converts,
//! with the command.
//!
//! Must not read more of a file than its beginning.

use std::io::Read as _;
use std::path::Path;

use crate::file::open_regular;

/// The endings of files of these formats, how they begin, what they are, and whether the whole folder is converted.
const FORMATS: [(&str, &[u8], &str, bool); 2] =
    [("bag", b"#ROSBAG V", "a ROS 1 bag", false), ("db3", b"SQLite format 3\0", "a rosbag2 recording in SQLite", true)];
/// Files of TensorFlow's records have no common beginning.
const RECORDS: &str = ".tfrecord";

/// The file that describes a dataset of LeRobot, in its folder.
const INFO: &str = "meta/info.json";
/// Endings of HDF5 files.
const ENDINGS: [&str; 2] = ["hdf5", "h5"];

/// Whether a path may be a dataset of another program, by its name: a folder with `meta/info.json`, or a file with an ending
/// of HDF5, whatever it contains.
#[must_use]
pub fn is_dataset(path: &Path) -> bool {
    let ending = path.extension().is_some_and(|ending| ENDINGS.iter().any(|known| ending == *known));
    path.join(INFO).is_file() || (ending && path.is_file())
}

/// Why a file cannot be sent and how to convert it, if it is in one of these formats.
pub(crate) fn remedy(path: &Path) -> Option<String> {
    let (name, ending) = (path.file_name()?.to_string_lossy(), path.extension().unwrap_or_default());
    if name.contains(RECORDS) && ending != "mcap" {
        return Some(format!(
            "{} is a file of an RLDS dataset; make a LeRobot dataset of it, for which LeRobot's repository has converters \
             in examples/port_datasets, and push that",
            path.display()
        ));
    }
    let (_, begins, what, folder) = FORMATS.iter().find(|(known, ..)| ending == *known)?;
    let mut beginning = Vec::new();
    open_regular(path).ok()?.take(16).read_to_end(&mut beginning).ok()?;
    if !beginning.starts_with(begins) {
        return None;
    }
    let parent = path.parent().map(|parent| if parent == Path::new("") { Path::new(".") } else { parent });
    let source = parent.filter(|_| *folder).unwrap_or(path);
    Some(format!(
        "{} is {what}; convert it with `rosbags-convert --src {} --dst NEW_FOLDER --dst-storage mcap` (Python package \
         rosbags), and push NEW_FOLDER",
        path.display(),
        source.display()
    ))
}
