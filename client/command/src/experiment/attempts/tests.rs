//! Commands that make attempts, as shell scripts.

use super::*;

fn attempts(command: &[&str]) -> Attempts {
    let command = command.iter().map(|word| (*word).to_owned()).collect();
    Attempts { simulation: "sim/task".into(), command }
}

fn trial(attempts: &Attempts, episodes: u32) -> Trial<'_> {
    Trial { attempts, policy_id: "pol_1", hide_history: false, seed: 7, episodes }
}

/// Runs a shell script that has the four arguments as `$0` to `$3`.
async fn script(text: &str, episodes: u32) -> (Result<SeedResult>, String) {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join(LOG);
    let attempts = attempts(&["sh", "-c", text, SERVER, DEPLOYMENT, SEED, EPISODES]);
    attempts.check().unwrap();
    let trial = trial(&attempts, episodes);
    let result = run(&Reach::open("http://h:1"), "experiment@pol_1", &log, trial).await;
    (result, std::fs::read_to_string(log).unwrap())
}

#[tokio::test]
async fn a_command_gets_its_values_and_its_attempts_are_counted() {
    let text = "echo begins; echo \"$0 $1 $2 $3\" >&2; echo '{\"success\": true, \"steps\": 4}'; \
                echo '{\"success\": false, \"steps\": 7, \"seed\": 3}'";
    let (result, log) = script(text, 2).await;
    assert_eq!(log, "http://h:1 experiment@pol_1 7 2\n");
    assert_eq!(result.unwrap(), SeedResult { seed: 7, episodes: 2, successes: 1, mean_steps: 5.5 });
}

#[tokio::test]
async fn a_command_that_fails_or_tries_less_is_an_error() {
    for (text, parts) in [
        ("echo '{\"success\": true, \"steps\": 4}'; exit 3", ["sh ended with", "3"]),
        ("echo '{\"success\": true, \"steps\": 4}'", ["printed 1 attempts", "not 2"]),
        ("echo '{\"success\": 1}'", ["{\\\"success\\\": 1}", "expected a boolean"]),
    ] {
        let problem = script(text, 2).await.0.unwrap_err().to_string();
        assert!(problem.starts_with("attempts.command: sh ") && problem.contains(LOG), "{problem}");
        assert!(parts.iter().all(|part| problem.contains(part)), "{problem}");
    }
    let missing = attempts(&["/nowhere/at/all"]);
    let folder = tempfile::tempdir().unwrap();
    let result = run(&Reach::open(""), "", &folder.path().join(LOG), trial(&missing, 1)).await;
    assert!(result.unwrap_err().to_string().contains("/nowhere/at/all did not start"));
}

#[test]
fn a_command_names_a_place_for_each_value() {
    let problem = attempts(&["run", SERVER, DEPLOYMENT, SEED]).check().unwrap_err();
    assert!(problem.starts_with("command: ") && problem.contains(EPISODES), "{problem}");
    let unnamed = Attempts { simulation: String::new(), ..attempts(&["run", SERVER, DEPLOYMENT, SEED, EPISODES]) };
    assert!(unnamed.check().unwrap_err().starts_with("simulation: "));
}
