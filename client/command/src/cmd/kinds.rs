//! `kinds`: the policies, weightings, objectives and scorers of the server, and the settings of each job.

use clap::Args;
use gleaner_proto::v1::{Kind, ListKindsRequest, ListKindsResponse, Setting};

use crate::context::Context;
use crate::failure::{Failure, Result};
use crate::json;
use crate::table::Column::Left;
use crate::table::table;

#[derive(Args, Debug)]
pub(crate) struct KindsArgs {
    /// Show the settings of this job, policy, weighting, objective or scorer only, such as `act`.
    kind: Option<String>,
}

impl KindsArgs {
    pub(crate) async fn run(self, context: &Context) -> Result<()> {
        let mut reply = context.client().await?.jobs().list_kinds(ListKindsRequest {}).await?.into_inner();
        if let Some(name) = &self.kind {
            reply = named(reply, name).map_err(Failure::message)?;
        }
        let families = [
            ("job", &reply.jobs),
            ("policy", &reply.policies),
            ("weighting", &reply.weightings),
            ("objective", &reply.objectives),
            ("scorer", &reply.scorers),
        ];
        let all = || families.iter().flat_map(|(family, kinds)| kinds.iter().map(move |kind| (*family, kind)));
        let text = || match &self.kind {
            None => listing(all()),
            Some(_) => all().map(|(family, kind)| settings(family, kind)).collect::<Vec<_>>().join("\n"),
        };
        context.output.result(|| json::value(&reply), text)?;
        context.output.next(if self.kind.is_some() { "gleaner train --help" } else { "gleaner kinds act" });
        Ok(())
    }
}

/// The kinds of one name alone.
fn named(mut reply: ListKindsResponse, name: &str) -> std::result::Result<ListKindsResponse, String> {
    let ListKindsResponse { jobs, policies, weightings, objectives, scorers } = &mut reply;
    let mut found = false;
    for kinds in [jobs, policies, weightings, objectives, scorers] {
        kinds.retain(|kind| kind.name == name);
        found |= !kinds.is_empty();
    }
    if found { Ok(reply) } else { Err(format!("{name}: unknown kind; `gleaner kinds` lists them")) }
}

fn listing<'a>(kinds: impl Iterator<Item = (&'a str, &'a Kind)>) -> String {
    let row = |(family, kind): (&str, &Kind)| [family.to_owned(), kind.name.clone(), kind.about.clone()];
    table([Left("FAMILY"), Left("NAME"), Left("ABOUT")], kinds.map(row))
}

fn settings(family: &str, kind: &Kind) -> String {
    let row = |setting: &Setting| [setting.name.clone(), allowed(setting), setting.about.clone()];
    let rows = table([Left("SETTING"), Left("VALUES"), Left("ABOUT")], kind.settings.iter().map(row));
    format!("{family} {}: {}\n{rows}", kind.name, kind.about)
}

fn allowed(setting: &Setting) -> String {
    let words: Vec<&str> = setting.words.iter().map(|known| known.word.as_str()).collect();
    match setting.r#type.as_str() {
        "word" | "words" => words.join(", "),
        "integer" | "number" => format!("{} to {}", setting.least, setting.most),
        "numbers" => setting.names.join(", "),
        other => other.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_kind_is_shown_alone_and_an_unknown_one_is_an_error() {
        let kinds =
            |names: &[&str]| names.iter().map(|name| Kind { name: (*name).into(), ..Kind::default() }).collect();
        let reply = ListKindsResponse {
            jobs: kinds(&["train"]),
            policies: kinds(&["bc", "act"]),
            scorers: kinds(&["raw"]),
            ..ListKindsResponse::default()
        };
        let act = named(reply.clone(), "act").unwrap();
        assert_eq!(act, ListKindsResponse { policies: kinds(&["act"]), ..ListKindsResponse::default() });
        assert!(named(reply, "atc").unwrap_err().starts_with("atc: unknown kind"));
    }
}
