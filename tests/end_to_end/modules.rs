//! No circles between the modules of a crate, and the floors of the server: every path in the sources is resolved to the
//! module it leads to, and among the files and folders of one folder the paths must lead one way.

use std::collections::{BTreeMap, BTreeSet};

use syn::visit::{self, Visit};

use crate::support::files;

/// The crates, by their folders of sources.
const CRATES: [&str; 15] = [
    "client/command/src",
    "client/src",
    "crates/core/src",
    "crates/data-folder/src",
    "crates/edge/src",
    "crates/inspector/src",
    "crates/learn/src",
    "crates/logs/src",
    "crates/recording/src",
    "crates/search/src",
    "crates/sim/src",
    "crates/web/src",
    "crates/worker/src",
    "proto/src",
    "server/src",
];

/// A module by its path from the root of the crate.
type Module = Vec<String>;

/// The paths that a module names, from the root of its crate.
struct Paths<'a> {
    module: &'a [String],
    modules: &'a BTreeSet<Module>,
    found: BTreeSet<Module>,
}

impl Paths<'_> {
    /// Resolves `crate`, `self`, `super` and the module's own children; a path of another crate leads nowhere.
    fn add(&mut self, path: &[String]) {
        let mut at: Module = match path.first().map(String::as_str) {
            Some("crate") => Vec::new(),
            Some("self" | "super") => self.module.to_vec(),
            Some(first) if self.modules.contains(&[self.module, &[first.to_owned()]].concat()) => self.module.to_vec(),
            Some(_) | None => return,
        };
        for part in path.iter().filter(|part| !["crate", "self"].contains(&part.as_str())) {
            if part == "super" {
                at.pop();
            } else {
                at.push(part.clone());
            }
        }
        while !self.modules.contains(&at) && at.pop().is_some() {}
        if !at.is_empty() {
            self.found.insert(at);
        }
    }

    fn add_tree(&mut self, before: &[String], tree: &syn::UseTree) {
        match tree {
            syn::UseTree::Path(path) => self.add_tree(&[before, &[path.ident.to_string()]].concat(), &path.tree),
            syn::UseTree::Group(group) => group.items.iter().for_each(|tree| self.add_tree(before, tree)),
            syn::UseTree::Name(name) => self.add(&[before, &[name.ident.to_string()]].concat()),
            syn::UseTree::Rename(name) => self.add(&[before, &[name.ident.to_string()]].concat()),
            syn::UseTree::Glob(_) => self.add(before),
        }
    }
}

fn is_test(attributes: &[syn::Attribute]) -> bool {
    let test = |attribute: &syn::Attribute| match &attribute.meta {
        syn::Meta::List(list) => list.path.is_ident("cfg") && list.tokens.to_string() == "test",
        syn::Meta::Path(_) | syn::Meta::NameValue(_) => false,
    };
    attributes.iter().any(test)
}

impl<'ast> Visit<'ast> for Paths<'_> {
    fn visit_item(&mut self, item: &'ast syn::Item) {
        let test = match item {
            syn::Item::Mod(item) => is_test(&item.attrs),
            syn::Item::Use(item) => is_test(&item.attrs),
            syn::Item::Fn(item) => is_test(&item.attrs),
            syn::Item::Impl(item) => is_test(&item.attrs),
            _ => false,
        };
        if !test {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.add_tree(&[], &item.tree);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.add(&path.segments.iter().map(|segment| segment.ident.to_string()).collect::<Vec<_>>());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        let text = called.tokens.to_string().replace(" :: ", "::");
        for path in text.split(|c: char| !(c.is_alphanumeric() || "_:".contains(c))).filter(|path| path.contains("::"))
        {
            self.add(&path.split("::").map(str::to_owned).collect::<Vec<_>>());
        }
    }
}

/// The modules of a crate, each with the modules that it names. Tests may name anything.
fn modules(folder: &str) -> BTreeMap<Module, BTreeSet<Module>> {
    let mut sources = BTreeMap::new();
    for path in files::sources(folder, "rs") {
        let (name, source) = files::source(&path);
        let within = name.strip_prefix(folder).unwrap().trim_start_matches('/').trim_end_matches(".rs");
        let mut module: Module = within.split('/').map(str::to_owned).collect();
        if module.iter().any(|part| ["tests", "testing"].contains(&part.as_str())) {
            continue;
        }
        if module.last().is_some_and(|last| ["lib", "main", "mod"].contains(&last.as_str())) {
            module.pop();
        }
        sources.insert(module, syn::parse_file(&source).unwrap());
    }
    let all: BTreeSet<Module> = sources.keys().cloned().collect();
    let named = sources.iter().map(|(module, source)| {
        let mut paths = Paths { module, modules: &all, found: BTreeSet::new() };
        paths.visit_file(source);
        (module.clone(), paths.found)
    });
    named.collect()
}

/// The circles among the modules of every folder of a crate, and how many modules it has.
fn circles(folder: &str) -> (usize, Vec<String>) {
    let modules = modules(folder);
    // For each folder, its members and what they lead to among the members.
    let mut graphs: BTreeMap<&[String], BTreeMap<&str, BTreeSet<&str>>> = BTreeMap::new();
    for (from, named) in &modules {
        for to in named {
            let shared = from.iter().zip(to).take_while(|(a, b)| a == b).count();
            if let (Some(a), Some(b)) = (from.get(shared), to.get(shared)) {
                graphs.entry(&from[..shared]).or_default().entry(a).or_default().insert(b);
            }
        }
    }
    let mut found = Vec::new();
    for (parent, graph) in &graphs {
        for from in graph.keys() {
            let (mut reached, mut open) = (BTreeSet::new(), vec![*from]);
            while let Some(next) = open.pop() {
                open.extend(graph.get(next).into_iter().flatten().filter(|to| reached.insert(**to)));
            }
            if reached.contains(from) {
                let step = graph[from].iter().find(|to| **to == *from || leads(graph, to, from));
                found.push(format!("{folder}/{}: {from} → {}", parent.join("/"), step.unwrap()));
            }
        }
    }
    (modules.len(), found)
}

fn leads(graph: &BTreeMap<&str, BTreeSet<&str>>, from: &str, to: &str) -> bool {
    let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(next) = open.pop() {
        open.extend(graph.get(next).into_iter().flatten().filter(|to| reached.insert(**to)));
    }
    reached.contains(to)
}

#[test]
fn modules_have_no_circle() {
    let (mut count, mut found) = (0, Vec::new());
    for folder in CRATES {
        let (modules, circles) = circles(folder);
        count += modules;
        found.extend(circles);
    }
    assert!(count > 400, "the walk found too little: {count} modules");
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// The floors of the server, from the ground: a module may name those of lower floors, and of its own as long as there
/// is no circle.
const FLOORS: [&[&str]; 5] = [
    &["config", "model_cache", "program", "shutdown", "telemetry"],
    &["store"],
    &["curation", "ingest", "jobs", "maintenance", "policies", "rollouts", "scorers"],
    &["access", "connections", "wire"],
    &["pages", "service"],
];

#[test]
fn the_floors_of_the_server_hold() {
    let floor = |module: &str| FLOORS.iter().position(|floor| floor.contains(&module));
    let mut broken = Vec::new();
    for (from, named) in modules("server/src").iter().filter(|(module, _)| !module.is_empty()) {
        let Some(own) = floor(&from[0]) else {
            broken.push(format!("{} has no floor", from[0]));
            continue;
        };
        let above = named.iter().filter(|to| floor(&to[0]).is_none_or(|floor| floor > own));
        broken.extend(above.map(|to| format!("{} names {}, which is above it", from.join("::"), to.join("::"))));
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}
