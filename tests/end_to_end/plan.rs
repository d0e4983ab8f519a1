//! `gleaner-server plan`, and the plans that docs/scale.md shows: each is what the command prints.

use serde_json::Value;
use tokio::process::Command;

use crate::support::{
    command::{Output, run},
    files::root,
    process::SERVER,
};

async fn plan(words: &[&str]) -> Output {
    run(Command::new(SERVER).arg("plan").args(words).env("GLEANER_LOG", "warn")).await
}

#[tokio::test]
async fn plans_in_the_documentation_are_what_the_command_prints() {
    let text = std::fs::read_to_string(root().join("docs/scale.md")).unwrap();
    let blocks: Vec<&str> =
        text.split("```").filter_map(|block| block.strip_prefix("text\n$ gleaner-server plan ")).collect();
    assert!(blocks.len() >= 3, "a plan for each size of lab");
    for block in blocks {
        let (words, shown) = block.split_once('\n').unwrap();
        let printed = plan(&words.split(' ').collect::<Vec<_>>()).await;
        assert!(printed.success, "{}", printed.errors);
        let printed: Vec<&str> = printed.out.lines().map(str::trim_end).collect();
        assert_eq!(shown.lines().collect::<Vec<_>>(), printed, "docs/scale.md, plan {words}:\n{}", printed.join("\n"));
    }
}

#[tokio::test]
async fn a_plan_is_json_for_programs_and_rejects_values_by_name() {
    let printed = plan(&["--robots", "3", "--cameras", "1x48x64@av1", "--json"]).await;
    let value: Value = serde_json::from_str(&printed.out).unwrap();
    assert_eq!((&value["lab"]["robots"], &value["lab"]["cameras"][0]["codec"]), (&3.into(), &"av1".into()));
    let shares: Vec<f64> =
        value["parts"].as_array().unwrap().iter().map(|part| part["share"].as_f64().unwrap()).collect();
    assert!(shares.len() == 8 && shares.is_sorted_by(|a, b| a >= b), "{shares:?}");
    for (words, reason) in [
        (vec![], "--robots"),
        (vec!["--robots", "0"], "--robots"),
        (vec!["--robots", "3", "--cameras", "2x480x640@gif"], "supported: jpeg"),
        (vec!["--robots", "3", "--hours-a-day", "30"], "at most 24"),
    ] {
        let refused = plan(&words).await;
        assert!(!refused.success && refused.errors.contains(reason), "{words:?}: {}", refused.errors);
    }
}
