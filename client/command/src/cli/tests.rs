//! The definition of the command line, and combinations of options that it takes and refuses.

use super::*;
use clap::CommandFactory as _;

#[test]
fn definition_is_valid() {
    Cli::command().debug_assert();
}

#[test]
fn debug_hides_tokens() {
    let cli = Cli::try_parse_from(["gleaner", "--token", "secret123", "jobs"]).unwrap();
    assert!(!format!("{cli:?}").contains("secret123"));
}

#[test]
fn valid_combinations_of_options_parse() {
    for line in [
        "gleaner train --dataset ds_1 --task t --policy act --chunk-length 4 --preset small --key mine",
        "gleaner score --extends run_1 --device cuda",
        "gleaner evaluate --policy pol_1 --task t --episodes 5 --trial-seeds 0,1",
        "gleaner what-if run_1 --top 0.1,0.2 --episodes",
        "gleaner report-evaluation pol_1 --simulation x --result 0:10:4 --result 1:10:5:30.5",
        "gleaner pretrain --objective mtp,aa --max-experts 5 --contrast 0.2",
        "gleaner experiment a.toml --out x --device cuda --plan",
        "gleaner experiment a.toml --report",
        "gleaner schedule create --name n --after-labels 50 --top 0.1 --until dataset",
        "gleaner score --encoder enc_1 --feature-scale plain --local-scale false",
        "gleaner rollback pick_cube@prod",
        "gleaner undeploy pick_cube@prod pick_cube@test",
        "gleaner score",
        "gleaner train --policy bc",
        "gleaner dataset create --top 0.1",
        "gleaner register-policy --protocol openpi --address ws://gpu:8000 --input prompt=text:pick --chunk-length 10",
        "gleaner register-policy --protocol open-inference --address http://gpu:8001 --model arm --sequences",
        "gleaner deploy a@b --policy pol_1 --score-run run_1",
        "gleaner score-recording run_1 a.mcap --matches --beta 0.5",
        "gleaner import-scores snap_1 scores.csv --source oracle --encoder enc_1",
        "gleaner drive a@b --real-time --deadline-ms 40 --hold-ms 0",
        "gleaner drive a@b --episodes 5 --report",
        "gleaner pretrain --max-experts 20 --imperfect-per-expert 3 --rule-seed 1",
        "gleaner task create --sim pick_cube --image 64",
        "gleaner delete ep_1 ep_2 --force",
        "gleaner restore ep_1",
        "gleaner jobs export --task t",
        "gleaner metrics latest --tensorboard runs",
        "gleaner episodes --deleted",
        "gleaner export ds_1 --format lerobot --depth --out a",
        "gleaner export ds_1 --format lerobot --video --out a",
        "gleaner export --episode ep_1 --out a.mcap",
        "gleaner export --episode ep_1 --scores run_1 --beta 0.5 --out a.mcap",
        "gleaner open ep_1 --in rerun",
        "gleaner open latest --in foxglove --scores latest --beta 0.5 --out a.mcap",
        "gleaner compare-scorers snap_1 --seeds 2",
        "gleaner compare-scorers enc_1 enc_2 --scorer ssdf --scorer deminf --train bc --evaluations 5",
    ] {
        assert!(Cli::try_parse_from(line.split(' ')).is_ok(), "{line}");
    }
}

#[test]
fn invalid_arguments_are_rejected() {
    for line in [
        "gleaner",
        "gleaner push",
        "gleaner train --dataset ds_1 --experts-of enc_1",
        "gleaner schedule create --task t --name n",
        "gleaner schedule create --task t --name n --after-labels 5 --cron x",
        "gleaner label ep_1",
        "gleaner label --outcome success",
        "gleaner push a.mcap --outcome great",
        "gleaner pipeline --until never",
        "gleaner train --dataset ds_1 --experts-in snap_1",
        "gleaner train --dataset ds_1 --policy gpt",
        "gleaner score --extends run_1 --similarity last_l2",
        "gleaner score --extends run_1 --lookahead 0.5",
        "gleaner evaluate --task t",
        "gleaner evaluate --policy pol_1 --deployment a@b",
        "gleaner dataset create --run run_1 --beta 0.5 --top 0.1",
        "gleaner report-evaluation pol_1 --simulation x",
        "gleaner experiment",
        "gleaner experiment a.toml --report --plan",
        "gleaner pipeline --beta 0.5 --top 0.1",
        "gleaner rollback",
        "gleaner undeploy",
        "gleaner register-policy --protocol http --address http://gpu:8001",
        "gleaner register-policy --protocol openpi --address ws://gpu:8000 --input x=y",
        "gleaner register-policy --protocol openpi --address ws://gpu:8000 --chunk-length 0",
        "gleaner delete",
        "gleaner restore",
        "gleaner score-recording run_1",
        "gleaner import-scores snap_1",
        "gleaner task create",
        "gleaner task create a.toml --sim pick_cube",
        "gleaner task create a.toml --image 64",
        "gleaner drive a@b --deadline-ms 40",
        "gleaner drive a@b --hold-ms 40",
        "gleaner drive a@b --real-time --deadline-ms 0",
        "gleaner drive a@b --real-time --rate 20",
        "gleaner export --out a",
        "gleaner export ds_1 --scores run_1 --out a",
        "gleaner export ds_1 --episode ep_1 --scores run_1 --out a",
        "gleaner export ds_1 --beta 0.5 --out a",
        "gleaner export ds_1 --format zarr --out a",
        "gleaner export --episode ep_1 --scores run_1 --engine-options=--mem=1G --out a",
        "gleaner export --episode ep_1 --scores run_1 --beta 7 --out a",
        "gleaner open ep_1 --in rerun --beta nan",
        "gleaner scores run_1 ep_1 --beta 3",
        "gleaner score-recording run_1 a.mcap --beta=-1",
        "gleaner open ep_1",
        "gleaner open ep_1 --in vlc",
        "gleaner compare-scorers",
        "gleaner compare-scorers enc_1 --evaluations 5",
        "gleaner compare-scorers enc_1 --seeds 0",
        "gleaner compare-scorers enc_1 --train bc --evaluations 0",
    ] {
        let refused = Cli::try_parse_from(line.split(' ')).unwrap_err();
        assert_eq!(refused.exit_code(), 2, "{line}");
    }
}
