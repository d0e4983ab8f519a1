//! Episodes by their id, or by the file name of their recording as it was pushed.
//!
//! Pure functions on listings.

use gleaner_proto::v1::Episode;

use super::choice::{SHOWN, limit, tasks};
use super::listed::{Tasks, of_episodes};
use super::{Kind, LATEST};
use crate::words;

/// A file name as people and episodes have it in common.
pub(crate) fn stem(name: &str) -> &str {
    name.strip_suffix(".mcap").unwrap_or(name)
}

/// The file name of the only recording in a rosbag2 folder of this name, without its ending.
pub(crate) fn of_bag(folder: &str) -> String {
    format!("{folder}_0")
}

/// The id of the episode that a text names: by its beginning, as the newest, or by the file name of its recording. `None`
/// for the beginning of an id that no episode has, which the server rejects. A path is refused, because recordings in
/// several folders often share a name. `kind` is that of episodes, or of deleted ones; `limits`: whether the command has
/// `--task`.
pub(super) fn choose(
    kind: Kind,
    text: &str,
    episodes: &[Episode],
    searched: &Tasks,
    limits: bool,
) -> Result<Option<String>, String> {
    let ids = of_episodes(searched, episodes);
    let name = stem(text);
    let of =
        |name: &str| -> Vec<&Episode> { episodes.iter().filter(|episode| stem(&episode.file_name) == name).collect() };
    let mut named = of(name);
    if named.is_empty() {
        named = of(&of_bag(name));
    }
    match (super::choice::choose(kind, text, &ids, limits), named.as_slice()) {
        (Ok(Some(id)), _) => return Ok(Some(id)),
        // Several ids begin so, and one recording has just this name.
        (Err(_), [one]) if text != LATEST => return Ok(Some(one.id.clone())),
        (Err(problem), _) => return Err(problem),
        (Ok(None), _) => {}
    }
    let lists = if kind == Kind::Deleted { "gleaner episodes --deleted" } else { "gleaner episodes" };
    let noun = kind.words().0;
    if text.contains('/') {
        return Err(format!("{text}: give the file name without its folder, or an id; `{lists}` lists both"));
    }
    match named.as_slice() {
        [] if text.starts_with(kind.prefix()) => Ok(None),
        [] => Err(format!("{text}: no {noun} has this id or file name; `{lists}` lists them")),
        [one] => Ok(Some(one.id.clone())),
        many => {
            let shown = |episode: &&Episode| {
                let task = searched.name(&episode.task_id).map(|task| format!(" of {task}")).unwrap_or_default();
                format!("{}{task} ({})", episode.id, words::outcome(episode.outcome()))
            };
            let ids: Vec<String> = many.iter().take(SHOWN).map(shown).collect();
            let more = if many.len() > SHOWN { ", …" } else { "" };
            let limit = limit(&tasks(many.iter().filter_map(|episode| searched.name(&episode.task_id))), limits);
            let count = many.len();
            Err(format!("{text}: {count} {noun}s have this file name: {}{more}; give an id{limit}", ids.join(", ")))
        }
    }
}

#[cfg(test)]
mod tests {
    use gleaner_proto::v1::Outcome;

    use super::*;

    fn choose(text: &str, episodes: &[Episode]) -> Result<Option<String>, String> {
        super::choose(Kind::Episode, text, episodes, &Tasks::one("lift"), false)
    }

    fn episode(id: &str, file_name: &str) -> Episode {
        let outcome = Outcome::Failure.into();
        Episode { id: id.into(), file_name: file_name.into(), outcome, ..Episode::default() }
    }

    #[test]
    fn an_id_comes_before_a_file_name() {
        let episodes = [episode("ep_1", "x.mcap"), episode("ep_2", "ep_1.mcap")];
        for (text, id) in [("ep_1", "ep_1"), ("latest", "ep_2"), ("ep_1.mcap", "ep_2")] {
            assert_eq!(choose(text, &episodes), Ok(Some(id.into())), "{text}");
        }
    }

    #[test]
    fn a_file_name_is_found_although_several_ids_begin_so() {
        let episodes = [episode("ep_01A", "ep_01.mcap"), episode("ep_01B", "b.mcap")];
        assert_eq!(choose("ep_01", &episodes), Ok(Some("ep_01A".into())));
        assert!(choose("ep_0", &episodes).unwrap_err().contains("2 ids begin so"));
    }

    #[test]
    fn a_deleted_episode_is_named_by_its_file_name_too() {
        let episodes = [episode("ep_1", "a.mcap"), episode("ep_2", "b.mcap"), episode("ep_3", "b.mcap")];
        let deleted = |text| super::choose(Kind::Deleted, text, &episodes, &Tasks::one("lift"), false);
        assert_eq!(deleted("a.mcap"), Ok(Some("ep_1".into())));
        assert!(deleted("b").unwrap_err().starts_with("b: 2 deleted episodes have this file name: ep_2"));
        let missing = "c.mcap: no deleted episode has this id or file name; `gleaner episodes --deleted` lists them";
        assert_eq!(deleted("c.mcap"), Err(missing.into()));
    }

    #[test]
    fn a_file_name_is_one_episode() {
        let episodes = [
            episode("ep_1", "a.mcap"),
            episode("ep_2", "b.mcap"),
            episode("ep_3", "b.mcap"),
            episode("ep_4", "ep_0001.mcap"),
        ];
        assert!(choose("recordings/a.mcap", &episodes).unwrap_err().contains("without its folder"));
        for text in ["a.mcap", "a"] {
            assert_eq!(choose(text, &episodes), Ok(Some("ep_1".into())), "{text}");
        }
        assert_eq!(choose("ep_0001.mcap", &episodes), Ok(Some("ep_4".into())));
        let bags = [episode("ep_5", "run_0.mcap"), episode("ep_6", "run_1_0.mcap")];
        for (folder, id) in [("run", "ep_5"), ("run_1", "ep_6"), ("run_0", "ep_5")] {
            assert_eq!(choose(folder, &bags), Ok(Some(id.into())), "{folder}");
        }
        assert_eq!(choose("ep_7", &episodes), Ok(None));
        let several = choose("b.mcap", &episodes).unwrap_err();
        assert_eq!(several, "b.mcap: 2 episodes have this file name: ep_2 (failure), ep_3 (failure); give an id");
        assert!(choose("c.mcap", &episodes).unwrap_err().contains("no episode has this id or file name"));
    }

    #[test]
    fn episodes_of_one_file_name_are_listed_with_their_tasks() {
        let of = |id: &str, task: &str| Episode { task_id: task.into(), ..episode(id, "0001.mcap") };
        let episodes = [of("ep_1", "task_1"), of("ep_2", "task_2")];
        let tasks = Tasks::test(&[("task_1", "lift"), ("task_2", "can"), ("task_3", "pick")]);
        let choose = |limits| super::choose(Kind::Episode, "0001.mcap", &episodes, &tasks, limits).unwrap_err();
        let listed = "2 episodes have this file name: ep_1 of lift (failure), ep_2 of can (failure); give an id";
        assert_eq!(choose(false), format!("0001.mcap: {listed}"));
        assert_eq!(choose(true), format!("0001.mcap: {listed}, or add --task with one of: can, lift"));
        let several = super::choose(Kind::Episode, "ep_", &episodes, &tasks, false).unwrap_err();
        assert!(several.contains("(ep_1 of lift, ep_2 of can)"), "{several}");
    }
}
