//! Progress bars on standard error; none unless it is a terminal. Their texts come from servers and are escaped here.

use std::time::Duration;

use gleaner_recording::printable;
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
    pub(crate) fn bytes(self, what: &str, total: u64) -> Bar {
        self.bar(what, Some(total), "{prefix} {wide_bar} {bytes}/{total_bytes} {bytes_per_sec} {eta}")
    }

    /// A bar over a count.
    pub(crate) fn count(self, what: &str, total: u64) -> Bar {
        self.bar(what, Some(total), "{prefix} {wide_bar} {pos}/{len} {eta} {msg}")
    }

    /// A spinner for work of unknown length.
    pub(crate) fn spinner(self, what: &str) -> Bar {
        self.bar(what, None, "{spinner} {prefix} {elapsed} {msg}")
    }

    fn bar(self, what: &str, total: Option<u64>, template: &str) -> Bar {
        let target = if self.shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::with_draw_target(total, target).with_style(style).with_prefix(shown(what));
        if self.shown {
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Bar(bar)
    }
}

/// One bar; clones draw the same.
#[derive(Clone, Debug)]
pub(crate) struct Bar(ProgressBar);

impl Bar {
    /// One that is never drawn.
    #[cfg(test)]
    pub(crate) fn hidden() -> Self {
        Self(ProgressBar::hidden())
    }

    pub(crate) fn set_length(&self, length: u64) {
        self.0.set_length(length);
    }

    pub(crate) fn set_position(&self, position: u64) {
        self.0.set_position(position);
    }

    pub(crate) fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    pub(crate) fn inc(&self, more: u64) {
        self.0.inc(more);
    }

    pub(crate) fn dec(&self, less: u64) {
        self.0.dec(less);
    }

    /// The text at the end of the bar.
    pub(crate) fn set_message(&self, text: &str) {
        self.0.set_message(shown(text));
    }

    /// A line above the bar.
    pub(crate) fn println(&self, line: &str) {
        self.0.println(shown(line));
    }

    pub(crate) fn finish_and_clear(&self) {
        self.0.finish_and_clear();
    }
}

fn shown(text: &str) -> String {
    printable::field(text).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_a_bar_are_escaped() {
        let bar = Progress::new(false).count("job\u{1b}[2J", 3);
        bar.set_message("loss\u{202e}\n0.1");
        assert_eq!((bar.0.prefix(), bar.0.message()), ("job\\u{1b}[2J".into(), "loss\\u{202e}\\n0.1".into()));
    }
}
