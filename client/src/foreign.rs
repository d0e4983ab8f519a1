//! Recordings in formats of others that a kept program converts: which files they are, and the command.
//!
//! Must not read more of a file than its beginning.

use std::io::Read as _;
use std::path::Path;

use crate::file::open_regular;

/// How files of these formats begin, what they are, and whether the whole folder is converted.
const BEGINNINGS: [(&[u8], &str, bool); 2] =
    [(b"#ROSBAG V", "a ROS 1 bag", false), (b"SQLite format 3\0", "a rosbag2 recording in SQLite", true)];
/// Files of TensorFlow's records have no common beginning.
const RECORDS: &str = ".tfrecord";
/// Endings of files whose beginning is read in a folder.
const ENDINGS: [&str; 2] = ["bag", "db3"];

/// Why a file cannot be sent and how to convert it, if it is in one of these formats.
pub(crate) fn remedy(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_string_lossy();
    if name.contains(RECORDS) {
        return Some(format!(
            "{} is a file of an RLDS dataset; make a LeRobot dataset of it, for which LeRobot's repository has converters \
             in examples/port_datasets, and push that",
            path.display()
        ));
    }
    let mut beginning = Vec::new();
    open_regular(path).ok()?.take(16).read_to_end(&mut beginning).ok()?;
    let (_, what, folder) = BEGINNINGS.iter().find(|(known, ..)| beginning.starts_with(known))?;
    let source = if *folder { path.parent().filter(|parent| *parent != Path::new("")).unwrap_or(path) } else { path };
    Some(format!(
        "{} is {what}; convert it with `rosbags-convert --src {} --dst NEW_FOLDER --dst-storage mcap` (Python package \
         rosbags), and push NEW_FOLDER",
        path.display(),
        source.display()
    ))
}

/// The same for a file that lies in a folder of recordings, where only files with a usual name are looked at.
pub(crate) fn remedy_in_folder(path: &Path) -> Option<String> {
    let usual = path.extension().is_some_and(|ending| ENDINGS.iter().any(|known| ending == *known));
    let records = path.file_name().is_some_and(|name| name.to_string_lossy().contains(RECORDS));
    (usual || records).then(|| remedy(path))?
}
