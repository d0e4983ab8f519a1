//! The programs as commands: `gleaner` against a server, and the commands of `gleaner-server` on a data folder.

use std::{ffi::OsStr, path::Path, process::Stdio};

use serde_json::Value;
use tokio::process::Command;

use super::{
    database,
    process::{GLEANER, SERVER},
    wait::within,
};

/// The output of a command, and whether it succeeded.
pub struct Output {
    pub success: bool,
    pub out: String,
    pub errors: String,
}

impl Output {
    /// Standard output and standard error.
    pub fn text(&self) -> String {
        format!("{}{}", self.out, self.errors)
    }
}

/// Runs a command to its end.
pub async fn run(command: &mut Command) -> Output {
    let output = command.stdin(Stdio::null()).kill_on_drop(true).output();
    let output = within("the command ends", output).await.unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Output { success: output.status.success(), out: text(output.stdout), errors: text(output.stderr) }
}

/// Runs `gleaner` against the server at an address.
pub async fn gleaner(url: &str, words: &[impl AsRef<OsStr>]) -> Output {
    run(Command::new(GLEANER).args(words).env("GLEANER_SERVER", url)).await
}

/// Runs `gleaner --json`, which must succeed.
pub async fn json(url: &str, words: &[&str]) -> Value {
    let output = gleaner(url, &[&["--json"], words].concat()).await;
    assert!(output.success, "{words:?}: {}", output.errors);
    serde_json::from_str(&output.out).unwrap_or_else(|error| panic!("{words:?}: {error}: {}", output.out))
}

/// Runs a command of `gleaner-server` on a data folder.
pub async fn server(words: &[&str], data: &Path) -> Output {
    run(Command::new(SERVER)
        .args(words)
        .arg("--data-dir")
        .arg(data)
        .envs(database::of(data))
        .env("AWS_ACCESS_KEY_ID", gleaner_bucket::testing::KEY_ID)
        .env("AWS_SECRET_ACCESS_KEY", gleaner_bucket::testing::KEY)
        .env("GLEANER_LOG", "warn"))
    .await
}

/// Like [`server`]: whether it succeeded, and everything that it printed.
pub async fn server_text(words: &[&str], data: &Path) -> (bool, String) {
    let output = server(words, data).await;
    (output.success, output.text())
}

/// Runs `gleaner-server check`, which must find nothing wrong; returns its text.
pub async fn expect_sound(data: &Path) -> String {
    let (sound, text) = server_text(&["check"], data).await;
    assert!(sound, "{text}");
    text
}
