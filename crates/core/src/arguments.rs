//! Settings as command-line options: one for each setting of a job, with its documentation, values and default.

mod shape;

use std::marker::PhantomData;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser as _, ValueParser};
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use serde_json::Value;

use crate::schema::{Setting, Shape, Values};
use crate::spec::schema_of;

/// Other names of options, short to type.
const ALIASES: [(&str, &str); 3] = [("learning_rate", "lr"), ("objectives", "objective"), ("seeds", "trial-seeds")];

/// A setting, and the kinds that it is limited to.
type Of = (Setting, Vec<&'static str>);

/// A set of options.
pub trait Options {
    /// Their heading in the help.
    const HEADING: &'static str = "Settings";

    /// The settings, and the prefix of their options' names.
    fn settings() -> Vec<(Of, &'static str)>;
}

/// The settings given on the command line, by option.
#[derive(Debug, Clone)]
pub struct Given<O> {
    /// The given settings; one that is left out takes the server's default. An option with a prefix keeps it, as in
    /// `train_steps`.
    pub values: Values,
    options: PhantomData<O>,
}

impl<O> Given<O> {
    /// The given settings that a job of this kind has.
    #[must_use]
    pub fn of_job(&self, job: &str) -> Values {
        let schema = schema_of(job);
        let has = |name: &str| schema.iter().any(|(setting, _)| setting.name == name);
        self.values.iter().filter(|(name, _)| has(name)).map(|(name, value)| (name.clone(), value.clone())).collect()
    }
}

macro_rules! options {
    ($($(#[doc = $about:literal])+ $name:ident = $job:literal;)+) => {
        $($(#[doc = $about])+
        #[derive(Debug, Clone, Copy)]
        pub struct $name;

        impl Options for $name {
            fn settings() -> Vec<(Of, &'static str)> {
                schema_of($job).into_iter().map(|of| (of, "")).collect()
            }
        })+
    };
}

options! {
    /// The settings of a pretraining.
    Pretrain = "pretrain";
    /// The settings of a scoring.
    Score = "score";
    /// The settings of a training.
    Train = "train";
    /// The settings of an evaluation.
    Evaluate = "evaluate";
}

/// The settings of all stages of a pipeline. Optimiser settings are those of pretraining; those of training start with
/// `train`.
#[derive(Debug, Clone, Copy)]
pub struct Pipeline;

/// Prefix of the options of a pipeline's training.
pub const TRAIN: &str = "train_";

impl Options for Pipeline {
    fn settings() -> Vec<(Of, &'static str)> {
        let mut all: Vec<(Of, &'static str)> = Vec::new();
        for job in ["pretrain", "score", "train", "evaluate"] {
            for of in schema_of(job) {
                match all.iter_mut().find(|((known, _), _)| known.name == of.0.name) {
                    Some(((known, _), _)) if known.default != of.0.default => {
                        known.about += &format!(" Default of {job}: {}.", of.0.default);
                    }
                    Some(_) => (),
                    None => all.push((of, "")),
                }
            }
        }
        let optimiser = <crate::OptimSpec as crate::Group>::schema();
        let of_training = |(setting, _): &Of| {
            setting.name == "validation_share" || optimiser.iter().any(|known| known.name == setting.name)
        };
        all.extend(schema_of("train").into_iter().filter(of_training).map(|of| (of, TRAIN)));
        all
    }
}

impl<O: Options> Args for Given<O> {
    fn augment_args(command: Command) -> Command {
        let settings = O::settings();
        let option = |((setting, kinds), prefix): &(Of, &'static str)| option(setting, kinds, prefix, O::HEADING);
        settings.iter().fold(command, |command, one| command.arg(option(one)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<O: Options> FromArgMatches for Given<O> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut values = Values::new();
        for ((setting, _), prefix) in O::settings() {
            let name = format!("{prefix}{}", setting.name);
            let given: Vec<Value> = matches.get_many(&name).into_iter().flatten().cloned().collect();
            let value = if several(&setting.shape) && !given.is_empty() {
                given.iter().filter_map(Value::as_array).flatten().cloned().collect::<Vec<_>>().into()
            } else {
                match given.into_iter().next_back() {
                    Some(value) => value,
                    None => continue,
                }
            };
            let checked = setting.check(&value).map_err(|problem| {
                let option = format!("{prefix}{}", problem.field).replace('_', "-");
                clap::Error::raw(clap::error::ErrorKind::ValueValidation, format!("--{option}: {}\n", problem.message))
            })?;
            values.insert(name, checked);
        }
        Ok(Self { values, options: PhantomData })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.values.extend(Self::from_arg_matches(matches)?.values);
        Ok(())
    }
}

fn option(setting: &Setting, kinds: &[&str], prefix: &str, heading: &'static str) -> Arg {
    let name = format!("{prefix}{}", setting.name);
    let heading = if prefix.is_empty() { heading } else { "Settings of the training's optimiser" };
    let option = Arg::new(name.clone())
        .long(name.replace('_', "-"))
        .help(help(setting, kinds))
        .help_heading(heading)
        .value_name(value_name(&setting.shape))
        .allow_negative_numbers(true)
        .value_parser(parser(&setting.shape))
        .action(if several(&setting.shape) { ArgAction::Append } else { ArgAction::Set });
    let alias = ALIASES.iter().find(|(of, _)| *of == setting.name);
    match alias {
        Some((_, alias)) => option.visible_alias(format!("{}{alias}", prefix.replace('_', "-"))),
        None => option,
    }
}

fn several(shape: &Shape) -> bool {
    matches!(shape, Shape::Words { .. } | Shape::Integers { .. })
}

fn help(setting: &Setting, kinds: &[&str]) -> String {
    let only = if kinds.is_empty() { String::new() } else { format!(" Only for {}.", kinds.join(", ")) };
    let default = match &setting.default {
        Value::String(text) if text.is_empty() => return format!("{}{only}", setting.about),
        Value::String(text) => text.clone(),
        Value::Array(values) => {
            let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
            values.iter().map(text).collect::<Vec<_>>().join(",")
        }
        other @ (Value::Null | Value::Bool(_) | Value::Number(_) | Value::Object(_)) => other.to_string(),
    };
    format!("{}{only} [default: {default}]", setting.about)
}

fn value_name(shape: &Shape) -> String {
    match shape {
        Shape::Integer { .. } => "N".to_owned(),
        Shape::Number { .. } => "X".to_owned(),
        Shape::Flag => "BOOL".to_owned(),
        Shape::Word { .. } => "WORD".to_owned(),
        Shape::Words { .. } => "WORD,WORD".to_owned(),
        Shape::Numbers { names, .. } => names.join(",").to_uppercase(),
        Shape::Integers { .. } => "N,N".to_owned(),
        Shape::Text => "TEXT".to_owned(),
    }
}

fn parser(shape: &Shape) -> ValueParser {
    match shape {
        Shape::Integer { .. } => ValueParser::from(|text: &str| text.parse::<u64>().map(Value::from)),
        Shape::Number { .. } => ValueParser::from(number),
        Shape::Flag => ValueParser::from(|text: &str| text.parse::<bool>().map(Value::from)),
        Shape::Word { words } => {
            let known = words.iter().map(|known| PossibleValue::new(known.word.clone()).help(known.about.clone()));
            PossibleValuesParser::new(known).map(Value::from).into()
        }
        Shape::Words { .. } => ValueParser::from(|text: &str| {
            Ok::<_, std::convert::Infallible>(text.split(',').map(|word| Value::from(word.trim())).collect::<Value>())
        }),
        Shape::Numbers { .. } => {
            ValueParser::from(|text: &str| text.split(',').map(number).collect::<Result<Value, _>>())
        }
        Shape::Integers { .. } => ValueParser::from(|text: &str| {
            text.split(',').map(|one| one.trim().parse::<u64>().map(Value::from)).collect::<Result<Value, _>>()
        }),
        Shape::Text => ValueParser::from(|text: &str| Ok::<_, std::convert::Infallible>(Value::from(text))),
    }
}

fn number(text: &str) -> Result<Value, String> {
    let number: f64 = text.trim().parse().map_err(|_| format!("{text:?} is not a number"))?;
    serde_json::Number::from_f64(number).map(Value::Number).ok_or_else(|| format!("{text:?} is not a finite number"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use serde_json::json;

    use super::*;

    #[derive(Debug, Parser)]
    struct Line<O: Options + Clone + Send + Sync + 'static> {
        #[command(flatten)]
        given: Given<O>,
    }

    fn parse<O: Options + Clone + Send + Sync + 'static>(text: &str) -> Result<Values, String> {
        let words = std::iter::once("x").chain(text.split_whitespace());
        Line::<O>::try_parse_from(words).map(|line| line.given.values).map_err(|error| error.to_string())
    }

    #[test]
    fn given_options_become_settings_and_omitted_ones_do_not() {
        let values = parse::<Train>("--policy act --chunk-length 4 --lr 0.5 --shift-pixels 2").unwrap();
        let expected = json!({"policy": "act", "chunk_length": 4, "learning_rate": 0.5, "shift_pixels": 2});
        assert_eq!(Value::Object(values), expected);
        assert_eq!(parse::<Train>("").unwrap(), Values::new());
        let values = parse::<Pretrain>("--objective mtp,aa --objectives tr").unwrap();
        assert_eq!(values["objectives"], json!(["mtp", "aa", "tr"]));
        assert_eq!(parse::<Evaluate>("--seeds 1,2 --trial-seeds 7").unwrap()["seeds"], json!([1, 2, 7]));
        assert_eq!(parse::<Score>("--scale 1,0.5,2").unwrap()["scale"], json!([1.0, 0.5, 2.0]));
    }

    #[test]
    fn a_value_that_is_not_allowed_is_rejected_by_its_option() {
        for (options, expected) in [
            ("--history-dropout 1.5", "--history-dropout: is 1.5, must be between 0 and 1"),
            ("--preset huge", "tiny"),
            ("--steps many", "invalid digit"),
            ("--policy dagger", "bc"),
        ] {
            let message = parse::<Train>(options).unwrap_err();
            assert!(message.contains(expected), "{options}: {message}");
        }
        let message = parse::<Score>("--scale 1,2").unwrap_err();
        assert!(message.contains("3 numbers: image, proprioception, action"), "{message}");
        assert!(parse::<Score>("--scale 1,two,3").unwrap_err().contains("is not a number"));
    }

    #[test]
    fn the_training_of_a_pipeline_has_a_separate_optimiser() {
        let given = parse::<Pipeline>("--steps 7 --train-steps 9 --train-lr 0.1").unwrap();
        assert_eq!(
            (&given["steps"], &given["train_steps"], &given["train_learning_rate"]),
            (&json!(7), &json!(9), &json!(0.1))
        );
    }

    #[test]
    fn help_names_defaults_and_the_kinds_that_have_a_setting() {
        use clap::CommandFactory;
        let help = Line::<Train>::command().render_long_help().to_string();
        assert!(help.contains("[default: 0.3]") && help.contains("Only for act."), "{help}");
    }
}
