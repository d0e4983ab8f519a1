//! The name of a dataset: that of its folder or file, with the folders above where it is a common one.

use std::ffi::OsStr;
use std::path::{Component, Path};

/// The name of the file of a robomimic export (`crates/formats`), without its ending.
const EXPORTED: &str = "dataset";
/// Words of the files and folders that robomimic and robosuite publish and write: `lift/ph/low_dim_v15.hdf5`.
const COMMON: [&str; 18] = [
    "low", "dim", "image", "images", "depth", "raw", "demo", "data", "dataset", "obs", "sparse", "dense", "ph", "mh",
    "mg", "paired", "states", "hdf5",
];
/// Most folders above a file with a common name.
const FOLDERS: usize = 3;
/// The most characters.
const LONGEST: usize = 100;
/// The folder of the commits of a repository in the cache of the Hugging Face Hub, and how that of the repository begins:
/// `datasets--ORG--NAME/snapshots/COMMIT`.
const SNAPSHOTS: &str = "snapshots";
const REPOSITORY: &str = "datasets--";

/// The name of a dataset, as a name of a task and of a cohort may be.
pub(super) fn of(path: &Path) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let resolved = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let is_folder = resolved.is_dir();
    // A file in the cache of the Hugging Face Hub is a link to one that is named by its digest.
    let named = if is_folder || resolved.extension() == absolute.extension() { resolved } else { absolute };
    of_path(&named, is_folder)
}

/// The name of a task of a dataset: that of the environment if the dataset states one, or its own.
pub(super) fn of_task(path: &Path, environment: Option<&str>) -> String {
    environment.map_or_else(|| of(path), plain)
}

fn of_path(path: &Path, is_folder: bool) -> String {
    let name = if is_folder { folder(path) } else { file(path) };
    plain(name.as_deref().unwrap_or_default())
}

/// A name without the characters that a task or a cohort may not have.
fn plain(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' };
    let name: String = name.chars().take(LONGEST).map(plain).collect();
    if name.is_empty() { EXPORTED.to_owned() } else { name }
}

/// The name of a folder; of a commit in the cache of the Hub, that of its dataset.
fn folder(path: &Path) -> Option<String> {
    let repository = path
        .parent()
        .filter(|snapshots| snapshots.file_name() == Some(OsStr::new(SNAPSHOTS)))
        .and_then(|snapshots| text(snapshots.parent()?));
    let hub = repository.as_deref().and_then(|repository| repository.strip_prefix(REPOSITORY));
    let of_hub = |rest: &str| rest.split_once("--").map_or(rest, |(_, name)| name).to_owned();
    hub.map(of_hub).or_else(|| text(path))
}

/// The name of a file. One with a common name has that of its folders before it, up to the first that is not common.
fn file(path: &Path) -> Option<String> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    // The file of an export here always has one name; its folder has the person's.
    let exported = stem == EXPORTED;
    if !exported && !is_common(&stem) {
        return Some(stem);
    }
    let mut names = if exported { Vec::new() } else { vec![stem.clone()] };
    for above in path.ancestors().skip(1).take(FOLDERS) {
        let Some(name) = folder(above) else { break };
        names.insert(0, name.clone());
        if !is_common(&name) {
            break;
        }
    }
    if names.is_empty() { Some(stem) } else { Some(names.join("_")) }
}

/// Whether files of many tasks have this name.
fn is_common(name: &str) -> bool {
    let number = |word: &str| word.strip_prefix('v').unwrap_or(word).bytes().all(|byte| byte.is_ascii_digit());
    let mut words = name.split(['_', '-', '.']).filter(|word| !word.is_empty());
    words.all(|word| COMMON.contains(&word.to_ascii_lowercase().as_str()) || number(word))
}

/// The last part of a path; `None` for `/`, and where the path ends with `..`.
fn text(path: &Path) -> Option<String> {
    let named = matches!(path.components().next_back(), Some(Component::Normal(_)));
    path.file_name().filter(|_| named).map(|name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dataset_in_the_cache_of_the_hub_has_the_name_of_its_repository() {
        let hub = "/home/me/.cache/huggingface/hub";
        let commit = "87ad4b2a1d2c9aef4dbc7f5c1c1f6b0e0a5d9c11";
        for (place, folder, name) in [
            (format!("datasets--lerobot--pusht/snapshots/{commit}"), true, "pusht"),
            (format!("datasets--pusht/snapshots/{commit}"), true, "pusht"),
            (format!("datasets--lab--multi/snapshots/{commit}/kitchen"), true, "kitchen"),
            (format!("models--lab--act/snapshots/{commit}"), true, commit),
            ("datasets--lab--kitchen".to_owned(), true, "datasets--lab--kitchen"),
            (format!("datasets--lab--lift/snapshots/{commit}/image.hdf5"), false, "lift_image"),
            (format!("datasets--lab--lift/snapshots/{commit}/ph/image_v15.hdf5"), false, "lift_ph_image_v15"),
            (format!("datasets--lab--lift/snapshots/{commit}/dataset.hdf5"), false, "lift"),
        ] {
            assert_eq!(of_path(&Path::new(hub).join(&place), folder), name, "{place}");
        }
    }

    #[test]
    fn a_file_with_a_common_name_has_that_of_its_folders_too() {
        for (path, name) in [
            ("/data/lift/ph/low_dim_v15.hdf5", "lift_ph_low_dim_v15"),
            ("/data/lift/mh/demo.hdf5", "lift_mh_demo"),
            ("/runs/can/image.hdf5", "can_image"),
            ("/runs/can/image_84.h5", "can_image_84"),
            ("/runs/can/dataset.hdf5", "can"),
            ("/runs/lift/ph/square.hdf5", "square"),
            ("/runs/demos/lift-demos 2.hdf5", "lift-demos_2"),
            ("/demo.hdf5", "demo"),
            ("/dataset.hdf5", "dataset"),
        ] {
            assert_eq!(of_path(Path::new(path), false), name, "{path}");
        }
    }

    #[test]
    fn a_name_has_plain_characters() {
        assert_eq!(plain("Nut Assembly/é"), "Nut_Assembly__");
        assert_eq!(plain(""), "dataset");
        assert_eq!(plain(&"x".repeat(200)).len(), 100);
        assert_eq!(of_path(Path::new("/"), true), "dataset");
    }

    #[test]
    fn a_file_in_the_cache_of_the_hub_has_its_own_name() {
        let folder = tempfile::tempdir().unwrap();
        let repository = folder.path().join("datasets--lab--lift");
        let commit = repository.join("snapshots/0a1b2c");
        for folder in [&repository.join("blobs"), &commit] {
            std::fs::create_dir_all(folder).unwrap();
        }
        std::fs::write(repository.join("blobs/f00d"), "").unwrap();
        std::os::unix::fs::symlink("../../blobs/f00d", commit.join("image.hdf5")).unwrap();
        assert_eq!(of(&commit.join("image.hdf5")), "lift_image");
        assert_eq!(of(&commit), "lift");
        // The environment that the file states comes first.
        assert_eq!(of_task(&commit.join("image.hdf5"), Some("Nut Assembly")), "Nut_Assembly");
        assert_eq!(of_task(&commit.join("image.hdf5"), Some("dataset")), "dataset");
        assert_eq!(of_task(&commit.join("image.hdf5"), None), "lift_image");
    }
}
