//! The smallest experiment, and `gleaner experiment`.

use std::path::Path;

use super::command::gleaner;

/// Its recordings and sizes, to which a test adds its studies.
pub const SETTINGS: &str = r#"
name = "smallest"
task = "pick_cube"

[data]
image = 16
max_steps = 30
experts = 3
cohorts = [{ agent = "freeze:1", count = 2 }, { agent = "wrong_goal:1", count = 2 }]

[base]
seeds = [0]
episodes = 2
segment_length = 2
pretrain = { steps = 3, batch = 8 }
train = { steps = 2, batch = 8 }
"#;

/// Runs a file on the server at an address. Returns whether it succeeded, and its text.
pub async fn experiment(url: &str, file: &Path, out: &Path, flags: &[&str]) -> (bool, String) {
    let (file, out) = (file.to_str().unwrap(), out.to_str().unwrap());
    let output = gleaner(url, &[&["experiment", file, "--out", out], flags].concat()).await;
    (output.success, output.text())
}
