//! The names of the values of features, in the order of the file: values have that order.
//!
//! An object of `serde_json` would have its lists in the order of their keys.

use std::collections::BTreeMap;
use std::fmt::{Formatter, Result as Written};

use serde::de::{IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::Value;

/// As much of `meta/info.json` as has names.
#[derive(Deserialize)]
struct Info {
    features: BTreeMap<String, Feature>,
}

#[derive(Deserialize)]
struct Feature {
    #[serde(default)]
    names: Option<Names>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Names {
    List(Vec<Value>),
    Lists(Lists),
    Other(IgnoredAny),
}

/// The lists of an object, in the order of the file.
struct Lists(Vec<Value>);

impl<'de> Deserialize<'de> for Lists {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct InOrder;
        impl<'de> Visitor<'de> for InOrder {
            type Value = Lists;

            fn expecting(&self, to: &mut Formatter<'_>) -> Written {
                to.write_str("lists of names")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Lists, A::Error> {
                let mut lists = Vec::new();
                while let Some((_, list)) = map.next_entry::<IgnoredAny, Value>()? {
                    lists.push(list);
                }
                Ok(Lists(lists))
            }
        }
        from.deserialize_map(InOrder)
    }
}

/// The names of each feature's values in `meta/info.json`: a list, or the lists of an object one after the other. A
/// feature of another form has none.
pub(super) fn names(info: &[u8]) -> BTreeMap<String, Vec<String>> {
    let features = serde_json::from_slice(info).map_or_else(|_| BTreeMap::new(), |Info { features }| features);
    let texts = |names: &[Value]| names.iter().filter_map(|name| Some(name.as_str()?.to_owned())).collect();
    let of = |Feature { names }: Feature| match names {
        Some(Names::List(names)) => texts(&names),
        Some(Names::Lists(Lists(lists))) => {
            texts(&lists.iter().filter_map(Value::as_array).flatten().cloned().collect::<Vec<_>>())
        }
        Some(Names::Other(_)) | None => Vec::new(),
    };
    features.into_iter().map(|(name, feature)| (name, of(feature))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_in_the_order_of_the_file() {
        let info = br#"{"fps": 30, "features": {
            "a": {"names": {"motors": ["pan", "lift"], "gripper": ["jaw"]}},
            "b": {"names": ["x", "y"]},
            "c": {"names": null}, "d": {}, "e": {"names": "x"}, "f": {"names": {"motors": ["pan"], "count": 1}}
        }}"#;
        let found = names(info);
        let of = |name: &str| found[name].join(" ");
        assert_eq!(["a", "b", "c", "d", "e", "f"].map(of), ["pan lift jaw", "x y", "", "", "", "pan"]);
        assert!(names(b"{}").is_empty());
    }
}
