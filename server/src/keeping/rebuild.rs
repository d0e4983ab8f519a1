//! `rebuild`: the database again from the sidecars beside the blobs. What a sidecar does not repeat is lost: the history
//! of labels, jobs, snapshots, scores and datasets. Recordings are not: each becomes an episode again or is put where
//! nothing removes it.

use std::{
    collections::HashSet,
    fs, io,
    path::{Path, PathBuf},
};

use super::{describe::describe_queued, files::Pace};
use crate::{
    blobs::{self, Blobs, Found, sync_folder},
    config::RebuildConfig,
    data_folder::{BLOBS, DATABASE, beside_database, database, stamp::Stamp},
    domain::{
        description::{Description, Recording},
        id::BlobId,
        time::Millis,
    },
    error::{Error, Kind, Result},
    lock::DataLock,
    store::{Look, Store},
};

/// The first bytes of an MCAP file.
const MCAP: &[u8] = b"\x89MCAP0\r\n";
/// Where blobs go that cannot become rows again. Nothing sweeps it.
const UNCLAIMED: &str = "unclaimed";

/// What came of the blobs.
#[derive(Debug, Default, PartialEq, Eq)]
struct Outcome {
    tasks: u64,
    episodes: u64,
    taken_back: u64,
    problems: Vec<String>,
    unclaimed: Vec<PathBuf>,
}

/// Rebuilds or completes the database of a data folder and writes to `out` what came of it; true when every recording is
/// an episode again.
///
/// # Errors
/// Precondition when a server runs on the folder or there are no blobs; Exhausted or Internal when the disk refuses.
pub(super) async fn rebuild(config: &RebuildConfig, out: &mut impl io::Write) -> Result<bool> {
    let data_dir = config.data_dir.as_path();
    if !data_dir.join(BLOBS).is_dir() {
        return Err(Error::precondition(format!(
            "{} holds no blobs; --data-dir names a server's data folder",
            data_dir.display()
        )));
    }
    let _lock = DataLock::take(data_dir)?;
    let blobs = Blobs::open(data_dir)?;
    let aside = set_aside(data_dir, &blobs).await?;
    let store = Store::open_with_blobs(data_dir, &blobs, true).await?;
    let mut outcome = Outcome::default();
    restore_tasks(&store, &blobs, &mut outcome).await?;
    let named: HashSet<BlobId> = store.named_blobs().await?.into_iter().map(|named| named.blob).collect();
    let trash = blobs.list_trash()?.into_iter().map(|found| (found, true));
    let found: Vec<_> = blobs.list()?.into_iter().map(|found| (found, false)).chain(trash).collect();
    let mut pace = Pace::new("blobs looked at", found.len());
    for (found, in_trash) in found {
        pace.one_more();
        let Some(id) = found.id.clone().filter(|id| !named.contains(id)) else { continue };
        let restored = restore_blob(config, &store, &blobs, (&id, &found, in_trash), &mut outcome).await?;
        if !restored && !in_trash {
            outcome.unclaimed.extend(set_unclaimed(data_dir, &blobs, &id)?);
        }
    }
    describe_queued(&store, &blobs).await?;
    store.close().await;
    write_outcome(out, &outcome, &aside).map_err(|error| Error::internal("writing what was rebuilt", error))?;
    Ok(outcome.problems.is_empty() && outcome.unclaimed.is_empty())
}

/// Moves a database that cannot be read, or belongs to another folder, to another name, and gives the names.
async fn set_aside(data_dir: &Path, blobs: &Blobs) -> Result<Vec<PathBuf>> {
    let path = database(data_dir);
    if !path.exists() || usable(&path, data_dir, blobs).await {
        return Ok(Vec::new());
    }
    let mark = Millis::now().0;
    let mut moved = Vec::new();
    for suffix in ["", "-wal", "-shm"] {
        let (from, to) =
            (beside_database(data_dir, suffix), data_dir.join(format!("replaced-{mark}-{DATABASE}{suffix}")));
        match fs::rename(&from, &to) {
            Ok(()) => moved.push(to),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(Error::internal(format!("moving {}", from.display()), error)),
        }
    }
    sync_folder(data_dir)?;
    Ok(moved)
}

/// Whether the database is sound and an older copy of the blobs' own, so that it is worth completing.
async fn usable(path: &Path, data_dir: &Path, blobs: &Blobs) -> bool {
    let Ok(look) = Look::open(path).await else { return false };
    let stamp = Stamp::read(data_dir).ok().flatten();
    let sound = look.store.integrity().await.is_ok_and(|findings| findings.is_empty());
    // One without a name for its folder is judged by its rows.
    let same = match (look.store.belongs_to(stamp.as_ref()).await, look.store.named_blobs().await) {
        (Ok(true), _) => true,
        (_, Ok(named)) => named.iter().any(|named| blobs.contains(&named.blob)),
        (_, Err(_)) => false,
    };
    look.store.close().await;
    sound && same
}

async fn restore_tasks(store: &Store, blobs: &Blobs, outcome: &mut Outcome) -> Result<()> {
    for json in blobs.task_descriptions()? {
        match Description::read(&json) {
            Some(Description::Task { id, spec, created_at }) => {
                outcome.tasks += u64::from(store.restore_task(&id, &spec, created_at).await?);
            }
            Some(_) | None => outcome.problems.push("a task's sidecar does not read".to_owned()),
        }
    }
    Ok(())
}

/// Makes the episodes of a blob again; false when there is none to make.
async fn restore_blob(
    config: &RebuildConfig,
    store: &Store,
    blobs: &Blobs,
    (id, found, in_trash): (&BlobId, &Found, bool),
    outcome: &mut Outcome,
) -> Result<bool> {
    let mut mine = Vec::new();
    for json in blobs.descriptions(&found.path)? {
        match Description::read(&json) {
            Some(Description::Recording(described)) if described.recording == *id => mine.push(*described),
            Some(_) => {}
            None => outcome.problems.push(format!("a sidecar of blob {id} does not read")),
        }
    }
    // Of two that a crash left for one task, the later one was acknowledged.
    mine.sort_by(|one, other| other.id.cmp(&one.id));
    if mine.is_empty() {
        return Ok(false);
    }
    if let Some(damage) = damage(config, id, found, &mine)? {
        outcome.problems.push(format!("blob {id}: {damage}"));
        return Ok(false);
    }
    if in_trash {
        outcome.taken_back += u64::from(blobs.take_back(id)?);
    }
    for described in mine {
        let (episode, task) = (described.id.clone(), described.task_id.clone());
        match store.restore_episode(described).await {
            Ok(restored) => outcome.episodes += u64::from(restored),
            Err(error) if error.kind() == Kind::NotFound => {
                outcome.problems.push(format!("{episode}: its task {task} has no sidecar"));
                return Ok(false);
            }
            Err(error) => return Err(error),
        }
    }
    Ok(true)
}

/// What is wrong with a recording, if anything.
fn damage(config: &RebuildConfig, id: &BlobId, found: &Found, described: &[Recording]) -> Result<Option<String>> {
    let sized = described.iter().all(|described| described.size_bytes == found.size_bytes);
    Ok(match sized && (config.fast || blobs::digest(&found.path)? == *id) {
        true => None,
        false => Some("is damaged: its content is not what its name says".to_owned()),
    })
}

/// Moves a blob that has no row and whose sidecars give none to where nothing removes it.
fn set_unclaimed(data_dir: &Path, blobs: &Blobs, id: &BlobId) -> Result<Option<PathBuf>> {
    let (from, folder) = (blobs.path(id), data_dir.join(UNCLAIMED));
    let fault = |error| Error::internal(format!("moving {}", from.display()), error);
    let mut begin = [0; MCAP.len()];
    let recording = fs::File::open(&from).and_then(|mut file| io::Read::read_exact(&mut file, &mut begin)).is_ok();
    let extension = if recording && begin == MCAP { "mcap" } else { "blob" };
    let to = folder.join(format!("{id}.{extension}"));
    fs::create_dir_all(&folder).map_err(fault)?;
    for (number, json) in blobs.descriptions(&from)?.iter().enumerate() {
        fs::write(folder.join(format!("{id}.{number}.json")), json).map_err(fault)?;
    }
    blobs.move_out(id, &to)?;
    sync_folder(&folder)?;
    Ok(Some(to))
}

fn write_outcome(out: &mut impl io::Write, outcome: &Outcome, aside: &[PathBuf]) -> io::Result<()> {
    for path in aside {
        writeln!(out, "note: the database that was there is now {}", path.display())?;
    }
    for problem in &outcome.problems {
        writeln!(out, "problem: {problem}")?;
    }
    for path in &outcome.unclaimed {
        let remedy = match path.extension().is_some_and(|extension| extension == "mcap") {
            true => "has no usable sidecar: push it again",
            false => "is not a recording; the job that made it is lost with the database",
        };
        writeln!(out, "unclaimed: {} {remedy}", path.display())?;
    }
    let Outcome { tasks, episodes, taken_back, unclaimed, .. } = outcome;
    let back = if *taken_back > 0 { format!(", {taken_back} blobs taken back from the trash") } else { String::new() };
    writeln!(out, "rebuilt {tasks} tasks and {episodes} episodes{back}; {} blobs are unclaimed", unclaimed.len())
}
