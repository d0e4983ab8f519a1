//! Grids: axes in, drafts of cells out; and settings laid over settings. Must not know the meaning of a setting.

use toml::{Table, Value};

use super::method::Method;

/// One setting that varies.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Axis {
    /// The setting, with dots between its parts.
    pub(crate) key: String,
    pub(crate) values: Vec<Value>,
}

/// A cell's label, and the settings that it has of its own.
pub(crate) type Draft = (String, Vec<(String, Value)>);

/// Every combination, the last axis fastest.
pub(crate) fn grid(axes: &[Axis]) -> Vec<Draft> {
    let mut combinations: Vec<Vec<(String, Value)>> = if axes.is_empty() { Vec::new() } else { vec![Vec::new()] };
    for axis in axes {
        let extend = |combination: &Vec<(String, Value)>| {
            let combination = combination.clone();
            axis.values.iter().map(move |value| {
                let mut longer = combination.clone();
                longer.push((axis.key.clone(), value.clone()));
                longer
            })
        };
        combinations = combinations.iter().flat_map(extend).collect();
    }
    combinations.into_iter().map(|varied| (label(&varied), varied)).collect()
}

fn label(varied: &[(String, Value)]) -> String {
    let part = |(key, value): &(String, Value)| match (key.as_str(), value) {
        ("method", value) => value.clone().try_into().map_or_else(|_| word(value), |method: Method| method.title()),
        ("rule.imperfect_per_expert", ratio) => format!("1:{}", word(ratio)),
        (_, value) => word(value),
    };
    varied.iter().map(part).collect::<Vec<_>>().join(" ")
}

fn word(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(items) => items.iter().map(word).collect::<Vec<_>>().join("+"),
        Value::Integer(_) | Value::Float(_) | Value::Boolean(_) | Value::Datetime(_) | Value::Table(_) => {
            value.to_string().trim_end_matches(".0").to_owned()
        }
    }
}

/// Axes may be written with dots or as tables within tables; what is a list is an axis.
pub(crate) fn flat(axes: &Table) -> Result<Vec<Axis>, String> {
    let mut found = Vec::new();
    for (key, value) in axes {
        match value {
            Value::Array(values) if !values.is_empty() => {
                found.push(Axis { key: key.clone(), values: values.clone() });
            }
            Value::Table(inner) => {
                let inner = flat(inner)?.into_iter();
                found.extend(inner.map(|axis| Axis { key: format!("{key}.{}", axis.key), ..axis }));
            }
            Value::Array(_)
            | Value::String(_)
            | Value::Integer(_)
            | Value::Float(_)
            | Value::Boolean(_)
            | Value::Datetime(_) => return Err(format!("axes.{key}: must be a list of the values to try")),
        }
    }
    Ok(found)
}

/// Sets a dotted key; a table is merged into what is there.
pub(crate) fn set(table: &mut Table, key: &str, value: Value) -> Result<(), String> {
    if let Some((first, rest)) = key.split_once('.') {
        let inner = table.entry(first).or_insert_with(|| Value::Table(Table::new()));
        let inner = inner.as_table_mut().ok_or_else(|| format!("{key}: {first} has no parts"))?;
        return set(inner, rest, value);
    }
    let mut one = Table::new();
    one.insert(key.to_owned(), value);
    merge(table, &one);
    Ok(())
}

/// Lays settings over others, table into table.
pub(crate) fn merge(into: &mut Table, from: &Table) {
    for (key, value) in from {
        match (into.get_mut(key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            _ => {
                into.insert(key.clone(), value.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Table {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn dotted_axes_equal_nested_tables() {
        let dotted = flat(&table("beta = [1]\nrule.seed = [1, 2]")).unwrap();
        assert_eq!(dotted, flat(&table("beta = [1]\n\"rule.seed\" = [1, 2]")).unwrap());
        let labels: Vec<String> = grid(&dotted).into_iter().map(|draft| draft.0).collect();
        assert_eq!(labels, ["1 1", "1 2"]);
        assert!(grid(&[]).is_empty());
    }

    #[test]
    fn overriding_a_setting_keeps_the_others() {
        let mut base = table("a = 1\n[rule]\nseed = 1\nexperts = 2");
        set(&mut base, "rule.seed", 5.into()).unwrap();
        merge(&mut base, &table("a = 3\n[rule]\ncohorts = []"));
        assert_eq!(base, table("a = 3\n[rule]\nseed = 5\nexperts = 2\ncohorts = []"));
        assert!(set(&mut base, "a.b", 1.into()).unwrap_err().contains("a has no parts"));
    }
}
