//! ROS 2 message definitions in text (`ros2msg`): the top definition, then each dependency after a line of
//! `=` and a `MSG: package/Type` line.
//!
//! Only the layout is kept: names, types and array kinds. Constants, default values and comments take no
//! bytes in a message and are dropped; bounds are not enforced, since a longer array is still readable.

use std::collections::BTreeMap;

/// All message types of one schema; the first is the top one.
#[derive(Debug)]
pub(crate) struct Definitions {
    pub(crate) messages: Vec<MessageDefinition>,
}

/// The fields of one message type.
#[derive(Debug, Default)]
pub(crate) struct MessageDefinition {
    pub(crate) fields: Vec<FieldDefinition>,
}

/// One field of a message type.
#[derive(Debug)]
pub(crate) struct FieldDefinition {
    pub(crate) name: String,
    pub(crate) kind: Kind,
    pub(crate) count: Count,
}

/// The type of one element of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Scalar(Scalar),
    Text,
    WideText,
    /// Index into [`Definitions::messages`].
    Message(usize),
}

/// A primitive number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    Bool,
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

/// The number of elements of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Count {
    One,
    Fixed(usize),
    /// Counted in the message.
    Counted,
}

/// A definition as text: its full name and its lines.
struct Section<'a> {
    name: String,
    lines: Vec<&'a str>,
}

impl Definitions {
    /// Parses a schema whose top type is called `name`.
    pub(crate) fn parse(name: &str, text: &str) -> Result<Self, String> {
        let mut sections = split(name, text);
        for (missing, fields) in WELL_KNOWN {
            if !sections.iter().any(|section| section.name == *missing) {
                sections.push(Section { name: (*missing).to_owned(), lines: fields.to_vec() });
            }
        }
        let mut index = BTreeMap::new();
        for (at, section) in sections.iter().enumerate() {
            index.entry(section.name.as_str()).or_insert(at);
        }
        let messages = sections.iter().map(|section| message(section, &index)).collect::<Result<Vec<_>, _>>()?;
        Ok(Self { messages })
    }
}

/// Types that some recorders leave out of their schemas.
const WELL_KNOWN: &[(&str, &[&str])] = &[
    ("builtin_interfaces/Time", &["int32 sec", "uint32 nanosec"]),
    ("builtin_interfaces/Duration", &["int32 sec", "uint32 nanosec"]),
    ("std_msgs/Header", &["builtin_interfaces/Time stamp", "string frame_id"]),
];

fn split<'a>(name: &str, text: &'a str) -> Vec<Section<'a>> {
    let mut sections = vec![Section { name: short(name), lines: Vec::new() }];
    let mut begun = true;
    for line in text.lines().map(str::trim) {
        if line.len() >= 40 && line.bytes().all(|byte| byte == b'=') {
            begun = false;
        } else if let (false, Some(name)) = (begun, line.strip_prefix("MSG:")) {
            sections.push(Section { name: short(name.trim()), lines: Vec::new() });
            begun = true;
        } else if let (true, Some(section)) = (begun, sections.last_mut()) {
            section.lines.push(line);
        }
    }
    sections
}

/// `pkg/msg/Type` and `pkg/Type` are the same type.
fn short(name: &str) -> String {
    name.replace("/msg/", "/")
}

fn message(section: &Section<'_>, index: &BTreeMap<&str, usize>) -> Result<MessageDefinition, String> {
    let mut definition = MessageDefinition::default();
    for line in &section.lines {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let bad = |what: &str| format!("the definition of {} has the line `{line}`: {what}", section.name);
        let (type_text, rest) = line.split_once(char::is_whitespace).ok_or_else(|| bad("no field name"))?;
        let end = rest.trim_start();
        let name: String = end.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
        let after = end.get(name.len()..).unwrap_or_default();
        if name.is_empty() || !(after.is_empty() || after.starts_with([' ', '\t', '='])) {
            return Err(bad("no field name"));
        }
        if after.trim_start().starts_with('=') {
            continue;
        }
        let (kind, count) = field_type(type_text, &section.name, index).map_err(|what| bad(&what))?;
        definition.fields.push(FieldDefinition { name, kind, count });
    }
    Ok(definition)
}

fn field_type(text: &str, within: &str, index: &BTreeMap<&str, usize>) -> Result<(Kind, Count), String> {
    let (element, count) = match text.split_once('[') {
        None => (text, Count::One),
        Some((element, size)) => {
            let size = size.strip_suffix(']').ok_or("a bracket is not closed")?;
            if size.is_empty() || size.starts_with("<=") {
                (element, Count::Counted)
            } else {
                let size: usize = size.parse().map_err(|_| "the array size is not a number")?;
                // An array of nothing would let a small schema cost much time without using up any bytes.
                if size == 0 {
                    return Err("an array of size 0".to_owned());
                }
                (element, Count::Fixed(size))
            }
        }
    };
    let element = element.split("<=").next().unwrap_or_default();
    Ok((kind(element, within, index)?, count))
}

fn kind(element: &str, within: &str, index: &BTreeMap<&str, usize>) -> Result<Kind, String> {
    Ok(match element {
        "bool" => Kind::Scalar(Scalar::Bool),
        "byte" | "char" | "uint8" => Kind::Scalar(Scalar::U8),
        "int8" => Kind::Scalar(Scalar::I8),
        "uint16" => Kind::Scalar(Scalar::U16),
        "int16" => Kind::Scalar(Scalar::I16),
        "uint32" => Kind::Scalar(Scalar::U32),
        "int32" => Kind::Scalar(Scalar::I32),
        "uint64" => Kind::Scalar(Scalar::U64),
        "int64" => Kind::Scalar(Scalar::I64),
        "float32" => Kind::Scalar(Scalar::F32),
        "float64" => Kind::Scalar(Scalar::F64),
        "string" => Kind::Text,
        "wstring" => Kind::WideText,
        other => {
            let package = within.split('/').next().unwrap_or_default();
            let names = [short(other), format!("{package}/{other}"), format!("std_msgs/{other}")];
            let found = names.iter().find_map(|name| index.get(name.as_str()));
            Kind::Message(*found.ok_or_else(|| {
                format!("the type `{other}` is not defined in the schema; record with complete definitions")
            })?)
        }
    })
}

#[cfg(test)]
mod tests;
