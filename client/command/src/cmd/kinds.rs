//! `kinds`: the policies, weightings, objectives and scorers of the server, and the settings of each job.

use clap::Args;
use gleaner_proto::v1::{Kind, ListKindsRequest, Setting};

use crate::context::Context;
use crate::failure::Result;
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
        let reply = context.client().await?.jobs().list_kinds(ListKindsRequest {}).await?.into_inner();
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
            Some(name) => {
                let named: Vec<String> =
                    all().filter(|(_, kind)| kind.name == *name).map(|(family, kind)| settings(family, kind)).collect();
                if named.is_empty() {
                    format!("{name}: unknown kind; `gleaner kinds` lists them")
                } else {
                    named.join("\n")
                }
            }
        };
        context.output.result(|| json::value(&reply), text)?;
        context.output.next(if self.kind.is_some() { "gleaner train --help" } else { "gleaner kinds act" });
        Ok(())
    }
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
