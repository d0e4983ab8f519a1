//! Tests of what a command line leaves open, and of its words with full ids.

use clap::CommandFactory as _;

use super::*;
use crate::cli::Cli;

#[test]
fn what_is_to_be_deleted_is_not_looked_up_by_file_name() {
    let by_file = |line: &str| -> Vec<bool> {
        let matches = Cli::command().try_get_matches_from(line.split(' ')).unwrap();
        incomplete(&matches).ids.iter().map(|given| given.by_file).collect()
    };
    assert_eq!(by_file("gleaner delete ep_01 ep_demo.mcap"), [false, false]);
    assert_eq!(by_file("gleaner restore ep_01 ep_demo.mcap"), [true, true]);
}

fn found(line: &str) -> Vec<(Kind, String)> {
    let matches = Cli::command().try_get_matches_from(line.split(' ')).unwrap();
    incomplete(&matches).ids.into_iter().map(|given| (given.kind, given.text)).collect()
}

#[test]
fn incomplete_ids_are_found_with_their_kind() {
    let full = "run_01ARZ3NDEKTSV4RRFFQ69G5FAV";
    assert_eq!(found(&format!("gleaner scores {full} latest")), [(Kind::Episode, "latest".into())]);
    assert_eq!(found("gleaner train --dataset ds_01 --policy act"), [(Kind::Dataset, "ds_01".into())]);
    assert_eq!(found("gleaner deploy a@b --policy=c@d"), [(Kind::Policy, "c@d".into())]);
    assert_eq!(found("gleaner evaluate --policy c"), [(Kind::Policy, "c".into())]);
    assert_eq!(found(&full.replace("run_", "gleaner evaluations pol_")), []);
    assert_eq!(found(&format!("gleaner scores {full} dir/a.mcap")), [(Kind::Episode, "dir/a.mcap".into())]);
    assert_eq!(found(&full.replace("run_", "gleaner episode ep_")), []);
    assert_eq!(found(&full.replace("run_", "gleaner restore ep_")), []);
    assert_eq!(found("gleaner restore a.mcap"), [(Kind::Deleted, "a.mcap".into())]);
    assert_eq!(found("gleaner delete a.mcap"), []);
    // As long as an id, and none.
    let name = "ep_of_the_second_afternoon_01";
    assert_eq!(found(&format!("gleaner episode {name}")), [(Kind::Episode, name.into())]);
    assert_eq!(found("gleaner dataset show latest"), [(Kind::Dataset, "latest".into())]);
    assert_eq!(found("gleaner compare-scorers snap_1"), [(Kind::Snapshot, "snap_1".into())]);
    assert_eq!(found("gleaner episodes --task latest"), []);
}

/// `latest` is searched in the task of the episode, so the episode is completed before it, or is full already.
#[test]
fn a_score_run_is_completed_after_the_episode_beside_it() {
    let of = |line: &str| incomplete(&Cli::command().try_get_matches_from(line.split(' ')).unwrap());
    for line in [
        "gleaner scores latest a.mcap",
        "gleaner open a.mcap --in rerun --scores latest",
        "gleaner export --scores latest --episode a.mcap --out x",
    ] {
        let given = of(line).ids;
        let order: Vec<Kind> = runs_last(&given).into_iter().map(|(_, given)| given.kind).collect();
        assert_eq!(order, [Kind::Episode, Kind::Run], "{line}");
        assert!(runs_last(&given).iter().all(|(place, one)| given[*place] == **one), "{line}");
    }
    let full = "ep_01ARZ3NDEKTSV4RRFFQ69G5FAV";
    assert_eq!(of(&format!("gleaner scores latest {full}")).episode.as_deref(), Some(full));
    assert_eq!(of("gleaner histogram latest").episode, None);
}

/// The words of a line with `FULL0`, `FULL1`, … for its ids.
fn completed(line: &str) -> String {
    let words: Vec<OsString> = line.split(' ').map(OsString::from).collect();
    let matches = Cli::command().try_get_matches_from(&words).unwrap_or_else(|error| panic!("{line}: {error}"));
    let given = incomplete(&matches).ids;
    let full: Vec<String> = (0..given.len()).map(|at| format!("FULL{at}")).collect();
    let words = replaced((Cli::command(), words), &given, &full).unwrap();
    words.iter().map(|word| word.to_str().unwrap()).collect::<Vec<_>>().join(" ")
}

#[test]
fn an_id_is_replaced_in_its_own_place() {
    for (line, expected) in [
        ("gleaner scores latest latest --beta 0.5", "gleaner scores FULL0 FULL1 --beta 0.5"),
        ("gleaner score --encoder=enc_0 --wait", "gleaner score --encoder=FULL0 --wait"),
        // The same text before it, as another value.
        (
            "gleaner label --reason latest --outcome failure latest",
            "gleaner label --reason latest --outcome failure FULL0",
        ),
        (
            "gleaner label --reason=latest --outcome=failure -- latest b.mcap",
            "gleaner label --reason=latest --outcome=failure -- FULL0 FULL1",
        ),
        (
            "gleaner label latest --cohort latest --outcome failure b.mcap --reason b.mcap",
            "gleaner label FULL0 --cohort latest --outcome failure FULL1 --reason b.mcap",
        ),
        ("gleaner --author latest episode latest --json", "gleaner --author latest episode FULL0 --json"),
        ("gleaner episode episode --author episode", "gleaner episode FULL0 --author episode"),
        ("gleaner download -o latest latest", "gleaner download -o latest FULL0"),
        ("gleaner download -olatest latest", "gleaner download -olatest FULL0"),
        ("gleaner dataset show latest", "gleaner dataset show FULL0"),
        (
            "gleaner evaluate --task latest --policy latest --episodes 5",
            "gleaner evaluate --task latest --policy FULL0 --episodes 5",
        ),
        (
            "gleaner deploy latest --policy=latest --score-run latest",
            "gleaner deploy latest --policy=FULL0 --score-run FULL1",
        ),
        (
            "gleaner compare-scorers enc_1 --scorer ssdf enc_2 --scorer deminf",
            "gleaner compare-scorers FULL0 --scorer ssdf FULL1 --scorer deminf",
        ),
    ] {
        assert_eq!(completed(line), expected, "{line}");
    }
}

#[test]
fn an_id_without_its_place_is_refused() {
    let words = ["gleaner", "episode", "latest"].map(OsString::from).to_vec();
    let given = Given { index: 2, kind: Kind::Episode, text: "latest".into(), by_file: true };
    let problem = replaced((Cli::command(), words), &[given], &["ep_1".into()]).unwrap_err();
    assert!(problem.ends_with("give the full id ep_1"), "{problem}");
}

#[test]
fn commands_with_a_task_limit_the_search() {
    let limits = |line: &str| incomplete(&Cli::command().try_get_matches_from(line.split(' ')).unwrap()).limits;
    assert!(limits("gleaner score --encoder latest") && limits("gleaner evaluate --policy latest"));
    assert!(!limits("gleaner label a.mcap --outcome success"));
    assert!(!limits("gleaner episode latest") && !limits("gleaner deploy a --policy latest"));
}

#[test]
fn every_argument_for_an_id_has_a_kind() {
    fn check(top: &str, command: &clap::Command, missing: &mut Vec<String>) {
        for argument in command.get_arguments() {
            let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
            let of_id = help.starts_with("Id of") || help.starts_with("Ids of");
            if of_id && kind(top, argument.get_id().as_str()).is_none() {
                missing.push(format!("{top} {}", argument.get_id()));
            }
        }
        command.get_subcommands().for_each(|inner| check(top, inner, missing));
    }
    let (cli, mut missing) = (Cli::command(), Vec::new());
    cli.get_subcommands().for_each(|command| check(command.get_name(), command, &mut missing));
    assert!(missing.is_empty(), "{missing:?}");
}
