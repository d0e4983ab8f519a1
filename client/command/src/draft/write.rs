//! The draft as a TOML file: the task with a comment for each guess.

use std::collections::BTreeSet;
use std::fmt::{self, Display, Formatter, Write};

use gleaner_recording::printable;
use gleaner_recording::{Bound, CameraSource, CameraSpec, FieldSource, FieldSpec, Transform};

use super::Draft;
use super::candidate::LeftOut;

/// The beginnings of reasons that stand at the first of the tables that share them.
const SHARED: [&str; 4] = ["Models read it scaled", "Its unit is by", "To leave out a joint", "Commented out beside"];
/// Width of a line of comments.
const WIDTH: usize = 118;

impl Display for Draft {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        comment(out, &format!("Drafted by `gleaner task draft` from {}.", self.origin))?;
        let decide = self.decisions().join(", ");
        comment(
            out,
            &format!("To look at: {decide}. The rest rarely needs a change; `gleaner help task` has every key."),
        )?;
        writeln!(out, "name = {}\n", text(&self.spec.name))?;
        if !self.spec.instruction.is_empty() {
            comment(out, "The text of the dataset's task.")?;
            writeln!(out, "instruction = {}\n", text(&self.spec.instruction))?;
        }
        comment(out, &self.rate)?;
        writeln!(out, "rate_hz = {:?}", self.spec.rate_hz)?;
        let mut shared = BTreeSet::new();
        let mut is_new = |reason: &&String| {
            !SHARED.iter().any(|known| reason.starts_with(known)) || shared.insert((*reason).clone())
        };
        for camera in &self.cameras {
            writeln!(out)?;
            let mut reasons = camera.reasons.iter().filter(&mut is_new);
            reasons.try_for_each(|reason| comment(out, reason))?;
            camera_spec(out, &camera.spec)?;
        }
        for action in [false, true] {
            for field in self.fields.iter().filter(|field| field.action == action) {
                writeln!(out)?;
                let mut reasons = field.reasons.iter().filter(&mut is_new);
                reasons.try_for_each(|reason| comment(out, reason))?;
                let table = if action { "action" } else { "proprioception" };
                if field.is_aside {
                    commented(out, |text| field_spec(text, table, &field.spec))?;
                } else {
                    field_spec(out, table, &field.spec)?;
                }
            }
        }
        for (at, mapping) in self.spec.mappings.iter().enumerate() {
            writeln!(out, "\n# {}", "-".repeat(40))?;
            writeln!(out, "[[mappings]]\nname = {}", text(&mapping.name))?;
            if let Some(clock) = &mapping.clock {
                comment(out, "A step begins with each message of this topic.")?;
                writeln!(out, "clock = {}", text(clock))?;
            }
            mapping.cameras.iter().try_for_each(|source| camera_source(out, source))?;
            mapping.fields.iter().try_for_each(|source| field_source(out, source))?;
            let mut aside = self.fields.iter().filter(|field| field.is_aside).filter_map(|field| field.sources.get(at));
            aside.try_for_each(|source| commented(out, |text| field_source(text, source)))?;
        }
        if !self.left_out.is_empty() {
            writeln!(out)?;
            comment(out, "Left out:")?;
            let mut reasons = BTreeSet::new();
            for LeftOut { reason, .. } in self.left_out.iter().filter(|left| reasons.insert(left.reason.as_str())) {
                let alike = self.left_out.iter().filter(|left| left.reason == *reason);
                let what: Vec<&str> = alike.map(|left| left.what.as_str()).collect();
                comment(out, &format!("- {}: {reason}", what.join(", ")))?;
            }
        }
        Ok(())
    }
}

/// A comment, wrapped; what comes from recordings is escaped.
fn comment(out: &mut Formatter<'_>, sentence: &str) -> fmt::Result {
    let sentence = printable::field(sentence);
    let mut line = String::from("#");
    for word in sentence.split(' ') {
        if line.chars().count() + 1 + word.chars().count() > WIDTH && line.len() > 1 {
            writeln!(out, "{line}")?;
            line = String::from("#");
        }
        line.push(' ');
        line += word;
    }
    writeln!(out, "{line}")
}

/// Lines of the file as comments, without a space behind the `#`, which a reader deletes to use them.
fn commented(out: &mut Formatter<'_>, lines: impl FnOnce(&mut String) -> fmt::Result) -> fmt::Result {
    let mut text = String::new();
    lines(&mut text)?;
    text.lines().try_for_each(|line| if line.is_empty() { writeln!(out) } else { writeln!(out, "#{line}") })
}

fn text(value: &str) -> String {
    toml::Value::from(value).to_string()
}

fn list(values: &[String]) -> String {
    let values: Vec<String> = values.iter().map(|value| text(value)).collect();
    let line = format!("[{}]", values.join(", "));
    if line.len() < WIDTH {
        return line;
    }
    format!("[\n  {},\n]", values.join(",\n  "))
}

fn camera_spec(out: &mut Formatter<'_>, camera: &CameraSpec) -> fmt::Result {
    let CameraSpec { name, height, width, depth, recorded } = camera;
    writeln!(out, "[[cameras]]\nname = {}\nheight = {height}\nwidth = {width}", text(name))?;
    if *depth {
        writeln!(out, "depth = true")?;
    }
    match recorded {
        Some(size) => writeln!(out, "recorded = {{ height = {}, width = {} }}", size.height, size.width),
        None => Ok(()),
    }
}

fn field_spec(out: &mut impl Write, table: &str, field: &FieldSpec) -> fmt::Result {
    let FieldSpec { name, size, unit, minimum, maximum, binary } = field;
    writeln!(out, "[[{table}]]\nname = {}\nsize = {size}", text(name))?;
    if !unit.is_empty() {
        writeln!(out, "unit = {}", text(unit))?;
    }
    for (key, bound) in [("minimum", minimum), ("maximum", maximum)] {
        if let Some(bound) = bound {
            writeln!(out, "{key} = {}", number_or_list(bound))?;
        }
    }
    if *binary { writeln!(out, "binary = true") } else { Ok(()) }
}

fn number_or_list(bound: &Bound) -> String {
    match bound {
        Bound::All(bound) => format!("{bound:?}"),
        Bound::Each(bounds) => format!("{bounds:?}"),
    }
}

fn camera_source(out: &mut Formatter<'_>, source: &CameraSource) -> fmt::Result {
    let CameraSource { camera, color, depth } = source;
    writeln!(out, "\n[[mappings.cameras]]\ncamera = {}\ncolor = {}", text(camera), text(color))?;
    match depth {
        Some(depth) => writeln!(out, "depth = {}", text(depth)),
        None => Ok(()),
    }
}

fn field_source(out: &mut impl Write, source: &FieldSource) -> fmt::Result {
    let FieldSource { field, topic, paths, names, transform } = source;
    writeln!(out, "\n[[mappings.fields]]\nfield = {}\ntopic = {}", text(field), text(topic))?;
    if let Some(Transform { parent, child, static_topic }) = transform {
        let [parent, child, static_topic] = [parent, child, static_topic].map(|part| text(part));
        return writeln!(out, "transform = {{ parent = {parent}, child = {child}, static_topic = {static_topic} }}");
    }
    writeln!(out, "paths = {}", list(paths))?;
    if names.is_empty() { Ok(()) } else { writeln!(out, "names = {}", list(names)) }
}
