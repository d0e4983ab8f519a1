//! Progress bars on standard error; none unless it is a terminal.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Progress {
    shown: bool,
}

impl Progress {
    pub(crate) fn new(shown: bool) -> Self {
        Self { shown }
    }

    /// A bar over bytes.
    pub(crate) fn bytes(self, what: &str, total: u64) -> ProgressBar {
        self.bar(what, Some(total), "{prefix} {wide_bar} {bytes}/{total_bytes} {bytes_per_sec} {eta}")
    }

    /// A bar over things that are counted.
    pub(crate) fn count(self, what: &str, total: u64) -> ProgressBar {
        self.bar(what, Some(total), "{prefix} {wide_bar} {pos}/{len} {eta} {msg}")
    }

    /// A sign of life when nobody knows how long it takes.
    pub(crate) fn spinner(self, what: &str) -> ProgressBar {
        self.bar(what, None, "{spinner} {prefix} {elapsed} {msg}")
    }

    fn bar(self, what: &str, total: Option<u64>, template: &str) -> ProgressBar {
        let target = if self.shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::with_draw_target(total, target).with_style(style).with_prefix(what.to_owned());
        if self.shown {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        bar
    }
}
