//! A real browser without a window: Chromium over WebDriver. Where it is not installed, its tests print SKIPPED and pass.

use std::{path::PathBuf, process::Stdio};

use fantoccini::{
    Client, ClientBuilder, Locator,
    actions::{InputSource as _, KeyAction, KeyActions},
    elements::Element,
    wd::WebDriverCompatibleCommand,
};
use hyper_util::client::legacy::connect::HttpConnector;
use serde_json::{Value, json};
use tokio::{
    io::{AsyncBufReadExt as _, BufReader},
    process::{Child, Command},
};

use super::{skipped::skipped, wait::LIMIT};

/// How often the driver is started before a test fails.
const STARTS: usize = 5;

/// A browser; ended on drop.
pub struct Browser {
    client: Client,
    _driver: Child,
}

impl Browser {
    /// Starts a browser. `None`, with a line that the test is skipped, where Chromium or its driver is not installed.
    pub async fn start() -> Option<Self> {
        let Some((driver, port)) = start_driver().await else {
            skipped("chromedriver is not installed (Debian: chromium and chromium-driver)");
            return None;
        };
        let args =
            ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1280,900"];
        let capabilities = [
            ("goog:chromeOptions".to_owned(), json!({ "args": args })),
            ("goog:loggingPrefs".to_owned(), json!({ "browser": "WARNING" })),
            // The authorities of the tests are unknown to it.
            ("acceptInsecureCerts".to_owned(), json!(true)),
        ];
        let capabilities = capabilities.into_iter().collect();
        let client = ClientBuilder::new(HttpConnector::new())
            .capabilities(capabilities)
            .connect(&format!("http://127.0.0.1:{port}"))
            .await
            .expect("chromedriver starts Chromium");
        Some(Self { client, _driver: driver })
    }

    /// Opens an address.
    pub async fn open(&self, address: &str) {
        self.client.goto(address).await.unwrap();
    }

    /// Waits for an element.
    pub async fn find(&self, css: &str) -> Element {
        let waited = self.client.wait().at_most(LIMIT).for_element(Locator::Css(css)).await;
        waited.unwrap_or_else(|error| panic!("no {css}: {error}"))
    }

    /// Every element that exists now.
    pub async fn all(&self, css: &str) -> Vec<Element> {
        self.client.find_all(Locator::Css(css)).await.unwrap()
    }

    /// The text of an element.
    pub async fn text(&self, css: &str) -> String {
        self.find(css).await.text().await.unwrap()
    }

    /// Waits until a script returns a value other than null and false; returns it.
    pub async fn until(&self, event: &str, script: &str) -> Value {
        let polling = async {
            loop {
                let value = self.run(script).await;
                if value != Value::Null && value != Value::Bool(false) {
                    return value;
                }
            }
        };
        let Ok(value) = tokio::time::timeout(LIMIT, polling).await else {
            self.keep("failed").await;
            panic!("never: {event}\n{}", self.client.source().await.unwrap_or_default());
        };
        value
    }

    /// Runs a script; returns its value.
    pub async fn run(&self, script: &str) -> Value {
        self.client.execute(script, Vec::new()).await.unwrap()
    }

    /// Types keys into the element that has the focus.
    pub async fn keys(&self, keys: &str) {
        let typed = keys.chars().fold(KeyActions::new("keyboard".into()), |typed, key| {
            typed.then(KeyAction::Down { value: key }).then(KeyAction::Up { value: key })
        });
        self.client.perform_actions(typed).await.unwrap();
    }

    /// Emulates a telephone whose screen has this width, in pixels.
    pub async fn narrow(&self, width: u32) {
        let params = json!({ "width": width, "height": 844, "deviceScaleFactor": 1, "mobile": true });
        let command = Devtools { cmd: "Emulation.setDeviceMetricsOverride", params };
        self.client.issue_cmd(command).await.unwrap();
    }

    /// The warnings and errors of the console.
    pub async fn console(&self) -> Vec<String> {
        let log = self.client.issue_cmd(ConsoleLog).await.unwrap();
        let entries = log.as_array().cloned().unwrap_or_default();
        entries.iter().filter_map(|entry| entry["message"].as_str().map(str::to_owned)).collect()
    }

    /// Saves a picture of the page in the output folder of the tests.
    pub async fn keep(&self, name: &str) {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("pages");
        std::fs::create_dir_all(&folder).unwrap();
        let picture = self.client.screenshot().await.unwrap();
        std::fs::write(folder.join(format!("{name}.png")), picture).unwrap();
    }

    /// Ends the browser.
    pub async fn close(self) {
        self.client.close().await.unwrap();
    }
}

/// Starts the driver on a free port and returns it with that port. `None` where it is not installed.
///
/// The driver chooses a port for IPv4 and then needs the same one for IPv6; where a program beside it took that one, it
/// ends, and is started again.
async fn start_driver() -> Option<(Child, String)> {
    for _ in 0..STARTS {
        let driver = Command::new("chromedriver").arg("--port=0").stdout(Stdio::piped()).kill_on_drop(true).spawn();
        let mut driver = driver.ok()?;
        let mut lines = BufReader::new(driver.stdout.take().unwrap()).lines();
        while let Some(line) = lines.next_line().await.unwrap() {
            if let Some((_, port)) = line.split_once("started successfully on port ") {
                // The driver blocks if its output is not read.
                tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
                return Some((driver, port.trim_end_matches('.').to_owned()));
            }
            eprintln!("chromedriver: {line}");
        }
    }
    panic!("chromedriver ended {STARTS} times before it listened")
}

/// A command of Chromium's own developer tools.
#[derive(Debug)]
struct Devtools {
    cmd: &'static str,
    params: Value,
}

impl WebDriverCompatibleCommand for Devtools {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/goog/cdp/execute", session.unwrap_or_default()))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        (http::Method::POST, Some(json!({ "cmd": self.cmd, "params": self.params }).to_string()))
    }
}

/// Requests the warnings and errors of the console.
#[derive(Debug)]
struct ConsoleLog;

impl WebDriverCompatibleCommand for ConsoleLog {
    fn endpoint(&self, base: &url::Url, session: Option<&str>) -> Result<url::Url, url::ParseError> {
        base.join(&format!("session/{}/se/log", session.unwrap_or_default()))
    }

    fn method_and_body(&self, _: &url::Url) -> (http::Method, Option<String>) {
        (http::Method::POST, Some(json!({ "type": "browser" }).to_string()))
    }
}
