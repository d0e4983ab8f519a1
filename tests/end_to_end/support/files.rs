//! Folders and their files: what is in them, how old they are, and the sources of the workspace.

use std::{
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

/// The root of the workspace.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap()
}

/// Every file and folder below a folder whose name passes, sorted. A folder that does not pass is not entered, nor is a
/// symbolic link to a folder.
pub fn tree(folder: &Path, passes: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(folder) = folders.pop() {
        for entry in folder.read_dir().unwrap() {
            let entry = entry.unwrap();
            if passes(entry.file_name().to_str().unwrap_or_default()) {
                if entry.file_type().unwrap().is_dir() {
                    folders.push(entry.path());
                }
                found.push(entry.path());
            }
        }
    }
    found.sort();
    found
}

/// Every file below a folder, sorted.
pub fn files(folder: &Path) -> Vec<PathBuf> {
    tree(folder, |_| true).into_iter().filter(|path| !path.is_dir()).collect()
}

/// The project's own files with this extension below a path of the workspace: no build outputs, generated code,
/// environments or caches. The
/// path of a file gives that file.
pub fn sources(path: &str, extension: &str) -> Vec<PathBuf> {
    let path = root().join(path);
    if path.is_file() {
        return vec![path];
    }
    let own =
        |name: &str| !name.starts_with('.') && !matches!(name, "target" | "node_modules" | "build" | "dist" | "_proto");
    let found = tree(&path, own).into_iter();
    found.filter(|path| path.is_file() && path.extension().is_some_and(|found| found == extension)).collect()
}

/// A file's path from the root of the workspace, and its text.
pub fn source(path: &Path) -> (String, String) {
    let name = path.strip_prefix(root()).unwrap().to_str().unwrap();
    (name.to_owned(), std::fs::read_to_string(path).unwrap())
}

/// Sets a file's modification time to some days ago.
pub fn backdate(file: &Path, days: u32) {
    let age = Duration::from_secs(24 * 60 * 60) * days;
    std::fs::File::open(file).unwrap().set_modified(SystemTime::now() - age).unwrap();
}

/// The path of a blob by its digest.
pub fn blob(data: &Path, blake3: &str) -> PathBuf {
    data.join("blobs").join(&blake3[..2]).join(&blake3[2..])
}

/// Whether a file has the name of a draft, which a running server is about to rename and a kill leaves to the sweep.
pub fn is_draft(name: &str) -> bool {
    name.starts_with(".draft-")
}

/// The files of all blobs, without sidecars, stamp and trash.
pub fn blobs(data: &Path) -> Vec<PathBuf> {
    let all = blob_folders(data).into_iter().flat_map(|folder| tree(&folder, |name| !is_draft(name)));
    all.filter(|file| file.extension().is_none() && file.is_file()).collect()
}

/// The folders of blobs, which are named by the first two characters of the digests.
pub fn blob_folders(data: &Path) -> Vec<PathBuf> {
    let folders = data.join("blobs").read_dir().unwrap().map(|entry| entry.unwrap().path());
    folders.filter(|path| path.is_dir() && path.file_name().is_some_and(|name| name.len() == 2)).collect()
}

/// Removes the kept features of episodes, which spare score runs the encoding, from a data folder.
pub fn forget_features(data: &Path) {
    let features = files(&data.join("cache")).into_iter();
    let features = features.filter(|file| file.extension().is_some_and(|extension| extension == "features"));
    let removed = features.map(|file| std::fs::remove_file(file).unwrap()).count();
    assert!(removed > 0, "no features are kept");
}
