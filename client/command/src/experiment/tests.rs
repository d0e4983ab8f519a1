//! The command line of an experiment: the folder and the command of a run with larger sizes.

use clap::Parser;

use super::*;

const FILE: &str = "name = \"x\"\ntask = \"pick_cube\"\n[data]\nexperts = 3\n\
    cohorts = [{ agent = \"noise:1\", count = 2 }]\n[scale]\ndevice = \"cuda\"\n[[study]]\ntable = \"beta\"\n";

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: ExperimentArgs,
}

/// The folder of a run, and the command in its report.
fn run(flags: &str) -> (String, String) {
    let args = Line::try_parse_from(["x", "x.toml"].into_iter().chain(flags.split_whitespace())).unwrap().args;
    let experiment = Experiment::parse_with(FILE, Sizes::of_flag(args.scale)).unwrap();
    let out = args.out(&experiment);
    (out.display().to_string(), args.command(&experiment, &out))
}

#[test]
fn a_scaled_run_has_a_folder_and_a_command_of_its_own() {
    let expected = |out: &str, command: &str| (out.to_owned(), format!("gleaner experiment x.toml {command}"));
    assert_eq!(run(""), expected("x", "--out x"));
    assert_eq!(run("--scale"), expected("x_scaled", "--scale --out x_scaled"));
    assert_eq!(run("--scale --out y"), expected("y", "--scale --out y"));
}

#[test]
fn the_command_names_a_device_other_than_the_files() {
    assert_eq!(run("--device cpu").1, "gleaner experiment x.toml --out x");
    assert_eq!(run("--device cuda").1, "gleaner experiment x.toml --out x --device cuda");
    assert_eq!(run("--scale --device cuda").1, "gleaner experiment x.toml --scale --out x_scaled");
    assert_eq!(run("--scale --device cpu").1, "gleaner experiment x.toml --scale --out x_scaled --device cpu");
}

#[test]
fn words_that_a_shell_would_change_are_quoted() {
    for word in ["raw", "train.steps=5", "results/a-1", "λ=0.3"] {
        assert_eq!(words::shell_word(word), word);
    }
    assert_eq!(words::shell_word("raw local_scale=false"), "'raw local_scale=false'");
    assert_eq!(words::shell_word("objectives=[\"tr\"]"), "'objectives=[\"tr\"]'");
    assert_eq!(words::shell_word("a'b$c"), r"'a'\''b$c'");
    assert_eq!(words::shell_word(""), "''");
    assert_eq!(run("--out a(b").1, "gleaner experiment x.toml --out 'a(b'");
}
